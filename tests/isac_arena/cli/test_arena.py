"""The command line end to end: the small campaign, resuming, and bad input."""

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
import trimesh

from isac_arena.campaign.campaign import load_campaign
from tests.command_line import ARENA, ROOT, arena, arena_here, failure


@pytest.fixture(scope="module")
def box_room(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A finished run of the small campaign, made in a process of its own."""
    out = tmp_path_factory.mktemp("run") / "box"
    result = arena("run", "box_room", "--out", out)
    assert result.returncode == 0, result.stderr
    return out


def test_the_small_campaign_is_complete_and_good(box_room: Path) -> None:
    scores = {row["key"]: row for row in json.loads((box_room / "scores.json").read_text())}
    assert set(next(iter(scores.values()))) == {"key", "value", "unit", "direction"}
    assert scores["channel.false_per_stop"]["value"] <= 1
    assert scores["mapping.ip_to_surface.median_m"]["value"] <= 0.05
    assert scores["slam.position.rmse_m"]["value"] <= 0.1
    page = (box_room / "report.html").read_text()
    assert page.count("data:image/png;base64,") >= 5 and "http" not in page.split("<body")[1]
    assert len(list((box_room / "figures").glob("*.png"))) >= 5
    assert not list(box_room.rglob(".*"))


def test_another_seed_gives_other_scores(finished: Path, tmp_path: Path) -> None:
    out = tmp_path / "other"
    assert arena_here("generate", finished / "small.toml", "--out", out, "--seed", 2).returncode == 0
    for verb in ("estimate", "score"):
        assert arena_here(verb, out).returncode == 0
    first, other = (json.loads((each / "scores.json").read_text()) for each in (finished / "run", out))
    assert [row["key"] for row in first] == [row["key"] for row in other] and first != other


@pytest.mark.whole
def test_stages_alone_in_another_directory_give_the_same_scores(finished: Path, tmp_path: Path) -> None:
    out = tmp_path / "stages"
    assert arena_here("generate", finished / "small.toml", "--out", out).returncode == 0
    assert len(list((out / "sweep").glob("*.nc"))) == 4
    assert "'arena estimate'" in failure("score", out)
    for verb in ("estimate", "score", "report"):
        assert arena_here(verb, out).returncode == 0
    assert (out / "scores.json").read_bytes() == (finished / "run" / "scores.json").read_bytes()


@pytest.mark.whole
def test_a_killed_run_leaves_nothing_that_looks_finished_and_resumes(finished: Path, tmp_path: Path) -> None:
    out, campaign = tmp_path / "killed", str(finished / "small.toml")
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    process = subprocess.Popen(
        [*ARENA, "run", campaign, "--out", str(out)], env=environment, stdout=subprocess.DEVNULL
    )
    while not list(out.glob("channel/*.nc")) and process.poll() is None:
        time.sleep(0.02)
    process.send_signal(signal.SIGKILL)
    process.wait()
    assert not (out / "scores.json").exists() and not (out / "report.html").exists()
    kept = {file: file.stat().st_mtime_ns for file in out.glob("truth/*.nc")}
    assert arena_here("run", campaign, "--out", out).returncode == 0
    assert (out / "scores.json").read_bytes() == (finished / "run" / "scores.json").read_bytes()
    assert all(file.stat().st_mtime_ns == written for file, written in kept.items())


def test_a_users_estimator_takes_the_place_of_ours(finished: Path, tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text(
        "from estimation.channel.power.paths import PowerMethodConfig, estimate_power\n"
        "def few(sweep):\n    return estimate_power(sweep, PowerMethodConfig(max_paths=2))\n"
        "def nothing(sweep):\n    return None\n"
        "def broken(sweep):\n    return 1 / 0\n"
    )
    out = tmp_path / "out"
    run = ("run", finished / "small.toml", "--out", out, "--estimator", "mine:few")
    assert arena_here(*run, cwd=tmp_path).returncode == 0
    scores = {row["key"]: row["value"] for row in json.loads((out / "scores.json").read_text())}
    assert scores["channel.estimated_per_stop"] == 2
    message = failure("estimate", out, "--estimator", "mine:nothing", cwd=tmp_path)
    assert "mine:nothing" in message and "ChannelEstimate is needed" in message
    assert json.loads((out / "scores.json").read_text())  # a failed try leaves the run as it was
    message = failure("estimate", out, "--estimator", "mine:broken", cwd=tmp_path)
    assert "channel = 'mine:broken': stop 0: ZeroDivisionError" in message and "mine.py, line 7)" in message
    assert message.endswith(f"traceback in {out}.estimator_error.txt") and not list(out.glob("*error*"))
    trace = (tmp_path / "out.estimator_error.txt").read_text()
    assert "return 1 / 0" in trace and "inputs.py" not in trace
    told = arena_here("estimate", out, "--estimator", "mine:broken", cwd=tmp_path).stdout
    third, last = told.index("stop 2: ZeroDivisionError"), told.rindex("estimate")
    assert third < told.index("it failed at all of the first 3 stops") < last  # before the fourth and last stop


def test_help_answers_without_heavy_imports() -> None:
    heavy = "('numpy', 'xarray', 'matplotlib', 'sionna')"
    code = f"import sys, isac_arena.cli.main; print([name for name in {heavy} if name in sys.modules])"
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT, check=True)
    assert result.stdout.strip() == "[]"


def test_a_command_imports_what_it_runs() -> None:
    unused = {
        "isac_arena.campaign.load": ["numba", "scipy"],
        "isac_arena.campaign.driver": ["numba", "scipy"],
        "isac_arena.campaign.stages": ["numba", "scipy", "isac_arena.scoring.chain", "sim.propagation.propagator"],
    }
    for module, names in unused.items():
        code = f"import sys, {module}; print([name for name in {names} if name in sys.modules])"
        result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT, check=True)
        assert result.stdout.strip() == "[]", module


def campaign_file(folder: Path, text: str) -> Path:
    path = folder / "mine.toml"
    path.write_text('name = "mine"\nscene = "box_room"\n' + text)
    return path


def test_a_campaign_of_three_lines_has_the_slam_of_the_library(tmp_path: Path) -> None:
    short = load_campaign(str(campaign_file(tmp_path, "seed = 1\n"))).config
    library = load_campaign("box_room").config
    assert short.slam == library.slam
    assert short.slam.method == "statistical"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("speed = 3\n", ["mine.toml: speed = 3", "unknown key"]),
        ("[rx_array]\nbeams_per_panel = 0\n", ["rx_array.beams_per_panel = 0", "greater than or equal to 1"]),
        ("[rx_array]\npanel_azimuth_deg = []\n", ["rx_array.panel_azimuth_deg = []"]),
        ('[link]\ntx_power_dbm = "3"\n', ['link.tx_power_dbm = "3"', "number"]),
        ("[waveform]\ncomb = 3\n", ["waveform.comb = 3", "2, 4, 6 or 12"]),
        ("[slam]\nmethod = 'guess'\n", ['slam.method = "guess"', "statistical"]),
        ("[link\n", ["mine.toml: not valid TOML"]),
    ],
)
def test_bad_campaign_files_name_field_and_value(tmp_path: Path, text: str, words: list[str]) -> None:
    message = failure("run", campaign_file(tmp_path, text), "--out", tmp_path / "out")
    assert all(word in message for word in words), message
    assert not (tmp_path / "out").exists()


def test_a_drawn_scene_has_the_name_of_its_file(tmp_path: Path) -> None:
    text = (ROOT / "scenes/library/box_room.toml").read_text()
    (tmp_path / "my_hall.toml").write_text(text.replace('name = "box_room"', 'name = "lab"'))
    for arguments in (("show", "my_hall.toml"), ("export", "my_hall.toml", "--format", "ply")):
        result = arena_here("scene", *arguments, cwd=tmp_path)
        assert result.returncode == 0 and result.stdout.startswith("lab: 6 objects"), result.stderr
    assert {file.name for file in tmp_path.iterdir()} == {"my_hall.toml", "my_hall.png", "my_hall.ply"}


def test_a_shown_scene_lists_its_meshes_and_tells_what_is_doubtful(tmp_path: Path) -> None:
    trimesh.creation.box((0.2, 0.2, 0.4)).export(tmp_path / "cart.stl")
    (tmp_path / "walls.csv").write_text("x0_m,y0_m,x1_m,y1_m\n7,3,8,3\n8,3,9,3\n")
    text = (ROOT / "scenes/library/box_room.toml").read_text()
    inside = '\n[[meshes]]\nfile = "cart.stl"\nmaterial = "metal"\nposition_m = [5.0, 5.5, 0.3]\n'
    plan = '\n[[floorplans]]\nfile = "walls.csv"\nmaterial = "metal"\nz_max_m = 2.0\n'
    (tmp_path / "hall.toml").write_text(text + inside + plan)
    shown = arena_here("scene", "show", "hall.toml", cwd=tmp_path).stdout
    assert re.search(r"cart +clutter +metal +4.9 to 5.1 +5.4 to 5.6 +0.1 to 0.5 +mesh", shown), shown
    assert re.search(r"walls_1 +wall +metal +7 to 9 +3 to 3 +0 to 2 +thin", shown), shown
    assert "doubtful: mesh cart overlaps pillar: move one of them" in shown
    assert "note: floor plan walls.csv: 2 lines make 1 wall, because lines that touch" in shown
    assert "doubtful: no flat facet of mesh cart reflects to a stop" in shown  # as the plan of a run says


@pytest.mark.parametrize("setting", ["scene", "campaign"])
def test_a_wrong_name_is_answered_by_those_of_its_own_setting(tmp_path: Path, setting: str) -> None:
    (tmp_path / "mine.toml").write_text('name = "mine"\nscene = "workshp"\n')
    wrong = ("run", tmp_path / "mine.toml") if setting == "scene" else ("run", "workshp")
    message = failure(*wrong, "--out", tmp_path / "out")
    known = arena_here(setting, "list").stdout.splitlines()
    named = message.partition("must be one of ")[2].removesuffix(", or the path of a .toml file").split(", ")
    assert named == [line.split()[0] for line in known]


def test_missing_things_are_named(tmp_path: Path) -> None:
    assert "none.toml: cannot be read" in failure("run", tmp_path / "none.toml", "--out", tmp_path / "out")
    assert "campaign = 'nowhere'" in failure("run", "nowhere", "--out", tmp_path / "out")
    assert "scene = 'nowhere'" in failure("scene", "show", "nowhere")
    assert "holds no campaign" in failure("score", tmp_path)
    assert "no.module" in failure("run", "box_room", "--out", tmp_path / "out", "--estimator", "no.module:f")
    assert "module:function" in failure("run", "box_room", "--out", tmp_path / "out", "--estimator", "f")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("waypoints_m = [[", "waypoints_m = [[5.0, 5.5], [", ["RX stop 0", "pillar"]),
        ('itu = "concrete"', 'itu = "brick"', ["brick", "60 GHz"]),
    ],
)
def test_bad_scenes_are_refused_before_anything_runs(tmp_path: Path, old: str, new: str, words: list[str]) -> None:
    text = (ROOT / "scenes/library/box_room.toml").read_text()
    assert old in text
    (tmp_path / "room.toml").write_text(text.replace(old, new, 1))
    (tmp_path / "mine.toml").write_text('name = "mine"\nscene = "room.toml"\n')
    message = failure("run", tmp_path / "mine.toml", "--out", tmp_path / "out")
    assert all(word in message for word in ["room.toml", *words]), message
    assert not (tmp_path / "out").exists()


def test_an_output_that_cannot_be_written_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    for name, reason in (("file", "is a file"), ("file/out", "Not a directory")):
        message = failure("run", "box_room", "--out", tmp_path / name)
        assert f"--out = {tmp_path / name}: {reason}; must be a directory that can be written" in message


@pytest.mark.parametrize(
    ("command", "told"),
    [
        (("run", "box_room", "--out", "x", "--seed", "-1"), "--seed = -1: must be greater than or equal to 0"),
        (("sweep", "s.toml", "--out", "x", "--workers", "0"), "--workers = 0: must be greater than or equal to 1"),
        (("verify", "x", "--share", "2"), "--share = 2: must be less than or equal to 1"),
        (("export", "x", "--format", "xyz"), "--format = xyz: 'xyz' is not one of 'mat'"),
    ],
)
def test_a_wrong_option_is_told_with_its_value(command: tuple[str, ...], told: str) -> None:
    assert told in failure(*command)


def test_files_that_are_no_campaign_are_left_alone(tmp_path: Path) -> None:
    mine = {name: tmp_path / name for name in ("report.html", "scene.toml", ".film.mkv.1.part")}
    (tmp_path / "figures").mkdir()
    mine["figure"] = tmp_path / "figures" / "fig1.png"
    for file in mine.values():
        file.write_text("mine")
    assert "holds other files" in failure("run", "box_room", "--out", tmp_path)
    assert all(file.read_text() == "mine" for file in mine.values())


def test_the_line_of_sight_level_follows_the_link(tmp_path: Path) -> None:
    base = load_campaign("box_room").config
    assert base.channel.los.power_at_1m_dbm == pytest.approx(-13, abs=0.3)
    strong = load_campaign(str(campaign_file(tmp_path, "[link]\ntx_power_dbm = 23.0\n"))).config
    assert strong.channel.los.power_at_1m_dbm == pytest.approx(base.channel.los.power_at_1m_dbm + 20)
    assert strong.slam.path_loss.intercept_dbm == strong.channel.los.power_at_1m_dbm
    given = load_campaign(str(campaign_file(tmp_path, "[channel.los]\npower_at_1m_dbm = -7.0\n"))).config
    assert given.channel.los.power_at_1m_dbm == -7


def test_a_directory_of_another_campaign_is_not_overwritten(box_room: Path) -> None:
    before = (box_room / "scores.json").read_bytes()
    message = failure("run", "box_room", "--out", box_room, "--seed", 9)
    assert "holds another campaign (seed = 1 there, 9 here)" in message
    assert (box_room / "scores.json").read_bytes() == before


def test_every_library_campaign_is_valid() -> None:
    for file in (ROOT / "isac_arena/campaign/library").glob("*.toml"):
        campaign = load_campaign(file.stem)
        assert campaign.config.name == file.stem and campaign.stops


def test_the_view_stands_by_itself_and_knows_its_stops(box_room: Path, tmp_path: Path) -> None:
    out = tmp_path / "view.html"
    result = arena_here("view", box_room, "--stop", 2, "--out", out, "--no-open")
    assert result.returncode == 0 and str(out) in result.stdout.replace("\n", ""), result.stderr
    page = out.read_text()
    assert "box_room: 3-D view" in page and '"active":2' in page and "default-src 'none'" in page
    assert "stop = 4: the campaign has stops 0 to 3" in failure("view", box_room, "--stop", 4, "--no-open")
    assert "holds no campaign" in failure("view", tmp_path, "--no-open")


def test_a_truncated_or_foreign_file_is_named_and_refused(box_room: Path, tmp_path: Path) -> None:
    out = tmp_path / "box"
    shutil.copytree(box_room, out)
    file = out / "map" / "slam.nc"
    whole = file.read_bytes()
    for verb in ("report", "view"):
        file.write_bytes(whole[: len(whole) // 2])
        assert f"{file}: damaged" in failure(verb, out)
        file.write_text("not a campaign file")
        assert f"{file}: damaged" in failure(verb, out)
    shutil.copy(out / "provenance.nc", file)
    assert "map/slam.nc" in failure("report", out)
    file.write_bytes(whole)
    shutil.copy(out / "channel" / "stop_000.nc", out / "truth" / "stop_001.nc")
    assert "truth/stop_001.nc" in failure("report", out)
