"""A campaign over a scene with files of its own: it keeps them, takes the TX and walk it names, and resumes."""

import json
import shutil
from pathlib import Path

import pytest
import trimesh

from isac_arena.campaign.files import read_record
from scenes.config import LIBRARY
from sim.propagation.paths import BounceKind
from sim.truth import Truth
from tests.command_line import arena_here as arena
from tests.command_line import failure

pytestmark = pytest.mark.whole  # whole commands: `.ci/run` runs them after the quick tests

ENDS = """
[[txs]]
name = "west"
position_m = [1.5, 4.0, 1.5]

[[txs]]
name = "south"
position_m = [5.0, 0.7, 1.6]
heading_deg = 90.0

[[walks]]
name = "long"
waypoints_m = [[4.0, 2.0], [8.5, 2.0]]
n_stops = 4
height_m = 1.5

[[walks]]
name = "short"
waypoints_m = [[2.5, 6.5], [4.0, 6.5]]
n_stops = 2
height_m = 1.4
"""
FILES = """
[[meshes]]
file = "../models/crate.ply"
material = "wood"
position_m = [3.0, 3.5, 0.6]

[[floorplans]]
name = "screen"
file = "screens.csv"
material = "plasterboard"
z_max_m = 2.2
"""
CAMPAIGN = """
name = "mine"
scene = "plans/mine.toml"
tx = "{tx}"
walk = "{walk}"

[propagation]
transmission = true
specular_samples = 20_000
diffuse_samples = 200

[shapes]
min_samples = 3
"""


@pytest.fixture
def project(tmp_path: Path) -> Path:
    """A folder with a campaign, its scene, and the files that the scene names."""
    room = (LIBRARY / "box_room.toml").read_text()
    head, rest = room[: room.index("[tx]")], room[room.index("[floor]") :]
    folder = tmp_path / "project"
    for name in ("plans", "models"):
        (folder / name).mkdir(parents=True)
    (folder / "plans" / "mine.toml").write_text(head + ENDS + rest + FILES)
    trimesh.creation.box((1.0, 0.6, 1.2)).export(folder / "models" / "crate.ply")
    (folder / "plans" / "screens.csv").write_text("x0_m,y0_m,x1_m,y1_m\n2.0,5.2,5.0,5.2\n")
    (folder / "mine.toml").write_text(CAMPAIGN.format(tx="south", walk="short"))
    return folder


def test_a_run_is_whole_by_itself_and_resumes_without_its_sources(project: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    result = arena("run", project / "mine.toml", "--out", out)
    assert result.returncode == 0, result.stderr
    [line] = [line for line in result.stdout.splitlines() if line.startswith("lines of sight and reflections: ")]
    assert int(line.split(": ")[1].split()[0]) > 20 and "ray tracer" in line
    truth = read_record(out / "truth" / "stop_001.nc", Truth)
    assert truth.n_planar_compared > 10
    assert truth.rx_pose.position_m.tolist() == [4.0, 6.5, 1.4]
    paths = truth.paths
    crosses = (paths.bounce_kind == BounceKind.REFRACTION).any(axis=1)
    assert crosses.any() and (crosses & (paths.n_bounces == 0)).sum() == 1 and not paths.is_los.any()
    assert "crate" in paths.object_name[paths.bounce_object[~paths.is_diffuse]]
    scores = json.loads((out / "scores.json").read_text())
    kept = out.rename(tmp_path / "elsewhere")
    shutil.rmtree(project)
    for stale in ("truth", "channel"):
        (kept / stale / "stop_001.nc").unlink()
    for verb in ("estimate", "score", "report"):
        again = arena(verb, kept)
        assert again.returncode == 0, again.stderr
    assert json.loads((kept / "scores.json").read_text()) == scores


@pytest.mark.parametrize(
    ("tx", "walk", "message"),
    [
        ("north", "short", "tx = 'north': must be one of west, south"),
        ("west", "far", "walk = 'far': must be one of long, short"),
    ],
)
def test_unknown_tx_and_walk(project: Path, tmp_path: Path, tx: str, walk: str, message: str) -> None:
    (project / "mine.toml").write_text(CAMPAIGN.format(tx=tx, walk=walk))
    assert message in failure("run", project / "mine.toml", "--out", tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_a_scene_in_place_of_a_campaign_is_told_from_one(tmp_path: Path) -> None:
    scene = shutil.copy(LIBRARY / "box_room.toml", tmp_path / "mine.toml")
    line = failure("run", scene, "--out", tmp_path / "out")
    assert line == f"arena: {scene}: is a scene; 'arena new campaign NAME --scene {scene}' writes a campaign in it"
    assert not (tmp_path / "out").exists()
