"""`arena export` and `arena import-deepmimo`: other tools' formats, on the small campaign."""

import json
from pathlib import Path

import numpy as np
import pytest
import shapely
import trimesh
import xarray as xr

from isac_arena.campaign.directory import open_campaign
from isac_arena.exchange.mat import read_measurement
from scenes.walks.tum import parse_tum
from sim.propagation.deepmimo.folder import read_deepmimo
from tests.command_line import arena_here as arena

CAMPAIGN = """
name = "small"
scene = "box_room"
[waveform]
comb = 12
[propagation]
diffuse_samples = 0
"""


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("exchange")
    (folder / "small.toml").write_text(CAMPAIGN)
    done = arena("run", folder / "small.toml", "--out", folder / "run")
    assert done.returncode == 0, done.stderr
    return folder / "run"


@pytest.fixture(scope="module")
def exported(run: Path) -> Path:
    for name in ("mat", "tum", "geojson", "deepmimo", "glb"):
        done = arena("export", run, "--format", name, "--out", run.parent / "export")
        assert done.returncode == 0, done.stderr
    return run.parent / "export"


def test_every_campaign_file_opens_in_xarray(run: Path) -> None:
    files = list(run.rglob("*.nc"))
    assert {file.parent.name for file in files} >= {"truth", "channel", "map", "run"}
    for file in files:
        with xr.open_datatree(file, engine="h5netcdf") as tree:
            assert any(node.data_vars for node in tree.subtree), file


def test_trajectories(run: Path, exported: Path) -> None:
    _, position, heading = parse_tum((exported / "truth.tum").read_text())
    truths = [open_campaign(run).truth(stop) for stop in range(len(position))]
    np.testing.assert_allclose(position, [truth.rx_pose.position_m for truth in truths], rtol=1e-8)
    np.testing.assert_allclose(np.cos(heading), [np.cos(truth.rx_pose.heading_rad) for truth in truths])
    _, found, _ = parse_tum((exported / "slam.tum").read_text())
    np.testing.assert_allclose(found, position, atol=0.3)


def test_maps(exported: Path) -> None:
    for name in ("mapping", "slam"):
        features = json.loads((exported / f"{name}.geojson").read_text())["features"]
        layers = {feature["properties"]["layer"] for feature in features}
        assert layers >= {"truth", "pose", "ip"}
        assert all(shapely.from_geojson(json.dumps(feature)).is_valid for feature in features)


def test_measurement_file(run: Path, exported: Path) -> None:
    back = read_measurement(exported / "small.mat", tx_offset_deg=0.0)
    assert len(back.truths) == len(list((run / "channel").glob("stop_*.nc")))
    assert sum(truth.is_single_bounce.sum() for truth in back.truths) > 4


def test_rays(exported: Path) -> None:
    nodes = trimesh.load_scene(exported / "stop_000.glb").geometry
    assert "line of sight 1" in nodes and "one reflection 1" in nodes and "pillar" in nodes


def test_a_scenario_goes_out_and_comes_back_as_a_campaign(run: Path, exported: Path, tmp_path: Path) -> None:
    scenario = read_deepmimo(exported / "small")
    given = open_campaign(run).truth(1).paths
    strongest = given.take("path", np.argsort(-given.power, kind="stable")[:25])
    np.testing.assert_allclose(scenario.paths[1].gain, strongest.gain, rtol=1e-12)
    done = arena("import-deepmimo", exported / "small", "--out", tmp_path / "in", "--stops", 2)
    assert done.returncode == 0, done.stderr
    again = arena("import-deepmimo", exported / "small", "--out", tmp_path / "in")
    assert again.returncode == 2 and "must be a new or an empty directory" in again.stderr
    text = (tmp_path / "in" / "campaign.toml").read_text()
    (tmp_path / "in" / "campaign.toml").write_text(text.replace("[waveform]", "[waveform]\ncomb = 12"))
    done = arena("run", tmp_path / "in" / "campaign.toml", "--out", tmp_path / "out")
    assert done.returncode == 0, done.stderr
    np.testing.assert_allclose(open_campaign(tmp_path / "out").truth(0).paths.gain, scenario.paths[0].gain)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("export", "{run}", "--format", "gpx"), "'gpx' is not one of"),
        (("export", "{run}", "--format", "glb", "--stop", "99"), "--stop = 99: the walk has stops 0 to 3"),
        (("export", "nowhere", "--format", "tum"), "nowhere"),
        (("import-deepmimo", "{run}", "--out", "{run}/x"), "holds no DeepMIMO v4 scenario"),
    ],
)
def test_mistakes_are_told_in_a_line(run: Path, arguments: tuple[str, ...], message: str) -> None:
    done = arena(*(argument.format(run=run) for argument in arguments))
    assert done.returncode != 0 and message in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1
