import numpy as np
import pytest

from scenes.config import SceneConfig
from scenes.pose import SPEED_OF_LIGHT_M_S
from scenes.scene import Scene
from scenes.tables import scene_tables
from scenes.targets.standard import target_class
from sim.config import PropagationConfig
from sim.propagation.paths import BounceKind, Paths
from sim.propagation.propagator import Propagator
from sim.propagation.targets.rcs import mean_rcs_dbsm

CARRIER_HZ = 60e9
ADULT = {"name": "person", "type": "adult", "position_m": [4.0, 2.0], "heading_deg": 0.0, "rcs_model": 1}
WALL = {
    "name": "wall", "kind": "wall", "material": "metal", "z_max_m": 3.0,
    "contour": {"type": "rectangle", "x_m": [-5.0, 15.0], "y_m": [-3.0, -2.8]},
}  # fmt: skip


def _scene(*targets: dict, objects: tuple = ()) -> Scene:
    return SceneConfig.model_validate(
        {
            "name": "free",
            "bounds_m": [-6.0, -6.0, 16.0, 6.0],
            "tx": {"position_m": [0.0, 0.0, 0.875]},
            "walk": {"waypoints_m": [[8.0, 0.0], [8.5, 0.0]], "n_stops": 2, "height_m": 0.875},
            "materials": {"metal": {"itu": "metal", "thickness_m": 0.01}},
            "objects": objects,
            "targets": targets,
        }
    ).build(CARRIER_HZ)


def _paths(scene: Scene, seed: int | None = None) -> Paths:
    solver = Propagator(scene, CARRIER_HZ, PropagationConfig(diffuse_samples=0))
    solver = solver if seed is None else solver.drawn(np.random.default_rng(seed))
    return solver.paths(scene.stops[0].position_m)


def _over_targets(paths: Paths) -> Paths:
    return paths.take("path", (paths.bounce_kind == BounceKind.TARGET).any(axis=1))


def test_an_echo_follows_the_radar_equation() -> None:
    echo = _over_targets(_paths(_scene(ADULT)))
    leg = np.hypot(4.0, 2.0)
    bistatic = np.pi - 2 * np.arctan2(2.0, 4.0)
    sigma = 10 ** ((-1.37 - 3 * np.sin(bistatic / 2)) / 10)
    wavelength = SPEED_OF_LIGHT_M_S / CARRIER_HZ
    assert len(echo) == 1 and np.isclose(echo.length_m[0], 2 * leg)
    assert np.isclose(echo.power[0], wavelength**2 * sigma / ((4 * np.pi) ** 3 * leg**4))
    assert np.isclose(echo.aod_azimuth_rad[0], np.arctan2(2.0, 4.0))
    assert np.isclose(echo.aoa_azimuth_rad[0], np.arctan2(2.0, -4.0))


def test_echoes_come_by_way_of_a_wall_before_and_after() -> None:
    echoes = _over_targets(_paths(_scene(ADULT, objects=(WALL,))))
    image = np.hypot(4.0, 2.0 + 2 * 2.8) + np.hypot(4.0, 2.0)
    kinds = sorted(tuple(row[:2]) for row in echoes.bounce_kind)
    assert kinds == [(1, 5), (5, 0), (5, 1)]
    assert np.allclose(np.sort(echoes.length_m)[1:], image)
    assert (echoes.power[echoes.n_bounces == 2] < echoes.power[echoes.n_bounces == 1]).all()


def test_a_target_between_tx_and_rx_blocks() -> None:
    apart, between = _paths(_scene(ADULT)), _paths(_scene(ADULT | {"position_m": [4.0, 0.0]}))
    assert apart.is_los.sum() == 1 and between.is_los.sum() == 0
    assert len(_over_targets(between)) == 1  # its own box is transparent to its own point


def test_targets_neither_reflect_nor_diffract() -> None:
    paths = _paths(_scene(ADULT, objects=(WALL,)))
    on_target = paths.bounce_object == len(_scene(ADULT, objects=(WALL,)).objects) - 1
    assert (paths.bounce_kind[on_target] == BounceKind.TARGET).all()


def test_large_targets_have_a_point_on_every_side() -> None:
    agv = {"name": "agv", "type": "agv_large", "position_m": [4.0, 3.0], "heading_deg": 90.0}
    one = _over_targets(_paths(_scene(agv)))
    several = _over_targets(_paths(_scene(agv | {"scattering_points": "multiple"})))
    assert len(one) == 1 and len(several) == 5
    front = several.vertex_m[several.vertex_m[:, 0, 1].argmax(), 0]
    assert np.allclose(front, [4.0, 4.5, 0.75])


def test_draws_differ_between_stops_and_are_the_same_for_a_seed() -> None:
    first, again, other = (_over_targets(_paths(_scene(ADULT), seed)).gain for seed in (1, 1, 2))
    assert first == again and first != other


def test_a_scene_with_targets_is_its_tables() -> None:
    motion = {"type": "velocity", "speed_m_s": 1.0, "heading_deg": 30.0}
    scene = _scene(ADULT | {"motion": motion}, {"name": "cart", "type": "agv_small", "position_m": [1.0, 4.0]})
    again = SceneConfig.model_validate(scene_tables(scene, CARRIER_HZ)).build(CARRIER_HZ)
    assert again.objects[0].target == scene.objects[0].target and again.has_targets
    later = again.at(2.0).objects[0]
    assert np.allclose(later.pivot_m[:2], [4.0 + 2 * np.cos(np.pi / 6), 3.0])


@pytest.mark.parametrize("kind", ["vehicle", "agv_small", "uav_large"])
def test_rcs_is_reciprocal_and_turns_with_the_target(kind) -> None:
    standard = target_class(kind, 2, "single")
    rng = np.random.default_rng(1)
    one, other = (rng.standard_normal((50, 3)) for _ in range(2))
    one, other = (each / np.linalg.norm(each, axis=1, keepdims=True) for each in (one, other))
    there = mean_rcs_dbsm(standard, 0.4, one, other, None)
    assert np.allclose(there, mean_rcs_dbsm(standard, 0.4, other, one, None))
    c, s = np.cos(0.7), np.sin(0.7)
    turn = np.array([(c, s, 0.0), (-s, c, 0.0), (0.0, 0.0, 1.0)])
    assert np.allclose(there, mean_rcs_dbsm(standard, 1.1, one @ turn, other @ turn, None))


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"type": "vehicle", "rcs_model": 1}, "rcs_model = 1: the standard has none for 'vehicle'"),
        ({"type": "uav_small", "rcs_model": 2}, "rcs_model = 2: the standard has none for 'uav_small'"),
        ({"rcs_model": 2, "scattering_points": "multiple"}, "the standard has them for AGVs and vehicles"),
    ],
)
def test_what_the_standard_does_not_have_is_refused(values: dict, words: str) -> None:
    with pytest.raises(ValueError, match=f"targets.person.*{words}"):
        _scene(ADULT | values)
