"""DeepMIMO v4 scenarios: paths come back as they were written, and other folders are refused."""

import json
from dataclasses import replace

import numpy as np
import pytest

from isac_arena.exchange.deepmimo import scene_facets, write_deepmimo
from scenes.config import load_scene
from scenes.pose import Pose
from sim.config import PropagationConfig, SimulationConfig
from sim.propagation.deepmimo.folder import Facets, read_deepmimo, read_facets, scenario_digest
from sim.propagation.deepmimo.scenario import PathScenario, path_matrices, paths_of_matrices
from sim.propagation.paths import BounceKind, Paths, empty_paths
from sim.simulate import simulate_truth

CARRIER_HZ = 60e9
KINDS = [
    [],
    [BounceKind.SPECULAR],
    [BounceKind.SPECULAR, BounceKind.DIFFRACTION],
    [BounceKind.REFRACTION, BounceKind.SPECULAR, BounceKind.DIFFUSE],
]


def some_paths(rng, n=4):
    kind = np.full((n, 3), BounceKind.NONE)
    for path in range(n):
        kind[path, : len(KINDS[path % len(KINDS)])] = KINDS[path % len(KINDS)]
    vertex = np.where(kind[..., None] != BounceKind.NONE, rng.uniform(-5, 5, (n, 3, 3)), np.nan)
    return Paths(
        gain=rng.normal(size=n) * 1e-4 * np.exp(1j * rng.uniform(0, 6, n)),
        delay_s=rng.uniform(1e-8, 1e-7, n),
        aod_azimuth_rad=rng.uniform(-3, 3, n),
        aod_elevation_rad=rng.uniform(-1, 1, n),
        aoa_azimuth_rad=rng.uniform(-3, 3, n),
        aoa_elevation_rad=rng.uniform(-1, 1, n),
        bounce_kind=kind,
        bounce_object=np.where(kind != BounceKind.NONE, 0, -1),
        vertex_m=vertex,
        object_name=np.array(["thing"]),
    )


@pytest.fixture
def scenario(rng):
    paths = some_paths(rng), empty_paths(["thing"], 3), some_paths(rng, 7)
    position = np.array([[4.0, 2.0, 1.5], [5.5, 2.0, 1.5], [7.0, 3.0, 1.5]])
    return PathScenario(np.array([1.5, 4.0, 1.5]), position, CARRIER_HZ, paths)


@pytest.fixture
def rng():
    return np.random.default_rng(7)


@pytest.fixture
def folder(scenario, tmp_path):
    scene = load_scene("box_room", CARRIER_HZ)
    return write_deepmimo(tmp_path / "made_up", scenario, scene_facets(scene), 25).parent


def assert_same(found, given):
    given = given.take("path", np.argsort(-given.power, kind="stable"))
    assert len(found) == len(given)
    slots = found.bounce_kind.shape[1]
    for name in ("gain", "delay_s", "aod_azimuth_rad", "aod_elevation_rad", "aoa_azimuth_rad",
                 "aoa_elevation_rad"):  # fmt: skip
        np.testing.assert_allclose(getattr(found, name), getattr(given, name), rtol=1e-12, atol=1e-15)
    assert np.array_equal(found.bounce_kind, given.bounce_kind[:, :slots])
    np.testing.assert_array_equal(found.vertex_m, given.vertex_m[:, :slots])
    assert np.all(found.bounce_object == -1)


def test_paths_come_back(folder, scenario):
    back = read_deepmimo(folder)
    assert back.carrier_hz == CARRIER_HZ
    np.testing.assert_array_equal(back.tx_position_m, scenario.tx_position_m)
    np.testing.assert_array_equal(back.rx_position_m, scenario.rx_position_m)
    for found, given in zip(back.paths, scenario.paths, strict=True):
        assert_same(found, given)


def test_conventions_of_the_matrices(rng):
    paths = some_paths(rng)
    matrices = path_matrices([paths, empty_paths(["thing"])], 3)
    order = np.argsort(-paths.power)[:3]
    assert matrices["power"].shape == (2, 3) and matrices["inter_pos"].shape[:2] == (2, 3)
    assert np.isnan(matrices["delay"][1]).all()
    np.testing.assert_allclose(matrices["power"][0], 10 * np.log10(paths.power[order]))
    np.testing.assert_allclose(matrices["aod_el"][0], 90 - np.rad2deg(paths.aod_elevation_rad[order]))
    codes = np.array([0, 1, 12, 413])
    assert matrices["inter"][0].tolist() == codes[order].tolist()


def test_an_unknown_interaction_is_named(rng):
    matrices = path_matrices([some_paths(rng)], 4)
    matrices["inter"][0, 0] = 17
    with pytest.raises(ValueError, match=r"inter = 17: 7 is no interaction of DeepMIMO"):
        paths_of_matrices(matrices, 0)


def test_npz_matrices_are_read_without_pickle(folder, scenario):
    for file in folder.glob("delay_*.mat"):
        matrix = path_matrices(scenario.paths, 25)["delay"]
        np.savez(file.with_suffix(".npz"), delay=matrix)
        file.unlink()
    assert_same(read_deepmimo(folder).paths[2], scenario.paths[2])
    np.savez(next(folder.glob("delay_*.npz")), delay=np.array([{"a": 1}], dtype=object))
    with pytest.raises(ValueError, match="holds no matrix 'delay'"):
        read_deepmimo(folder)


def test_the_scene_is_kept(folder):
    facets = read_facets(folder)
    names = [item["name"] for item in facets.objects]
    assert "pillar (curved)" in names and len(names) == len(set(names))
    corners = {index for item in facets.objects for face in item["face_vertex_idxs"] for index in face}
    assert corners == set(range(len(facets.vertices_m)))
    assert {each["name"] for each in facets.materials.values()} >= {"concrete", "metal"}
    (folder / "objects.json").unlink()
    assert read_facets(folder).objects == []


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda f: (f / "params.json").unlink(), "holds no DeepMIMO v4 scenario"),
        (lambda f: (f / "params.json").write_text("{"), "no parameters of a DeepMIMO v4 scenario"),
        (lambda f: (f / "params.json").write_text("[]"), "no parameters of a DeepMIMO v4 scenario"),
        (lambda f: next(f.glob("power_*")).unlink(), "power_t000_tx000_r001.mat .* is missing"),
        (lambda f: next(f.glob("power_*")).write_bytes(b"MATLAB"), "holds no matrix 'power'"),
    ],
)
def test_damaged_folders_are_refused(folder, damage, message):
    damage(folder)
    with pytest.raises(ValueError, match=message):
        read_deepmimo(folder)


def test_sets_that_are_not_there_are_named(folder):
    with pytest.raises(ValueError, match="rx_set = 0: the scenario has 1"):
        read_deepmimo(folder, rx_set=0)
    with pytest.raises(ValueError, match="tx_set = 4: the scenario has 0"):
        read_deepmimo(folder, tx_set=4)
    with pytest.raises(ValueError, match="tx003"):
        read_deepmimo(folder, tx=3)


def test_a_matrix_of_another_shape_is_named(folder, scenario):
    params = json.loads((folder / "params.json").read_text())
    other = replace(scenario, paths=scenario.paths[:2], rx_position_m=scenario.rx_position_m[:2])
    write_deepmimo(folder / "b", other, Facets(np.zeros((0, 3)), [], {}), 25)
    (folder / "b" / "phase_t000_tx000_r001.mat").replace(folder / "phase_t000_tx000_r001.mat")
    with pytest.raises(ValueError, match=r"phase has shape \(2, 7\)|phase has shape \(2, 4\)"):
        read_deepmimo(folder)
    assert params["scene"]["num_scenes"] == 1


def config_with(folder, carrier_ghz=60.0):
    return SimulationConfig(
        scene="box_room",
        waveform={"carrier_ghz": carrier_ghz},
        propagation=PropagationConfig(deepmimo=str(folder)),
    )


def test_a_campaign_takes_its_paths_from_a_scenario(folder, scenario):
    room = load_scene("box_room", CARRIER_HZ)
    scene = replace(room, walk=replace(room.walk, waypoints_m=scenario.rx_position_m[:, :2], n_stops=None),
                    tx=Pose(scenario.tx_position_m, 0.0))  # fmt: skip
    truths = list(simulate_truth(config_with(folder), scene, [2, 0]))
    assert [truth.stop for truth in truths] == [2, 0]
    assert_same(truths[0].paths, scenario.paths[2])
    with pytest.raises(ValueError, match=r"waveform.carrier_ghz = 28: .* was traced at 60 GHz"):
        list(simulate_truth(config_with(folder, 28.0), scene, [0]))
    with pytest.raises(ValueError, match=r"its TX stands at \(1.5, 4, 1.5\) m"):
        list(simulate_truth(config_with(folder), replace(scene, tx=room.stops[0]), [0]))
    moved = replace(scene, walk=replace(scene.walk, waypoints_m=scenario.rx_position_m[:, :2] + 0.2))
    with pytest.raises(ValueError, match=r"no receiver at \(4.2, 2.2, 1.5\) m, the nearest is 0.283 m"):
        list(simulate_truth(config_with(folder), moved, [0]))


def test_the_checksum_follows_the_content(folder, tmp_path):
    first = scenario_digest(folder)
    folder.rename(tmp_path / "other_name")
    assert scenario_digest(tmp_path / "other_name") == first
    (tmp_path / "other_name" / "params.json").write_text("{}")
    assert scenario_digest(tmp_path / "other_name") != first
