"""Public tasks: what is sealed, what is given, and grades in closed form."""

from __future__ import annotations

import json
import tarfile
from pathlib import Path

import numpy as np
import pytest

import isac_arena as ia
from isac_arena.campaign.driver import CampaignRun
from isac_arena.exchange.path_columns import read_columns
from isac_arena.exchange.path_table import read_table
from isac_arena.public_tasks import baselines, making
from isac_arena.public_tasks.baselines import BASELINES, baseline_rows
from isac_arena.public_tasks.board import BoardRow, enter, page, read_board
from isac_arena.public_tasks.grading import bounce_points, channel_tables, grade, with_interval
from isac_arena.public_tasks.making import SealedScene, Stage, TaskSpec, make_task, read_task
from isac_arena.public_tasks.scenes import CLEAR_M, task_scene
from isac_arena.public_tasks.submissions import submission_of
from sim.observation import BeamSweep
from sim.propagation.occlusion import sees_tx
from tests.command_line import ROOT, arena_here, failure

ARRAY = {"rows": 1, "columns": 8, "beams_per_panel": 8}
SMALL = {
    "waveform": {"n_rb": 64, "comb": 4}, "tx_array": ARRAY,
    "rx_array": ARRAY | {"panel_azimuth_deg": [0.0, 180.0]},
    "channel": {"method": "power"}, "propagation": {"diffuse_samples": 0, "compare_planar": False},
}  # fmt: skip
N_SCENES, N_STOPS = 2, 2


def task(folder: Path, stage: Stage) -> Path:
    make_task(TaskSpec("a task", "pillar", stage, N_SCENES, N_STOPS, 5), folder)
    return folder


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A task of every stage with small arrays."""
    folder = tmp_path_factory.mktemp("tasks")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(making, "SETTINGS", SMALL)
        patch.setattr(making, "LEAST_STOPS", {})
        for stage in making.TASK_STAGES:
            task(folder / stage, stage)
    return folder


@pytest.fixture(scope="module")
def sealed(made: Path) -> list[SealedScene]:
    return read_task(made / "slam")[1]


def columns(stage: Stage, rows: list[tuple[float, ...]]) -> dict[str, np.ndarray]:
    names = {"slam": ("scene", "stop", "x_m", "y_m"), "contours": ("scene", "contour", "x_m", "y_m")}
    wanted = names.get(stage, ("scene", "stop", "delay_s", "aod_azimuth_rad", "aoa_azimuth_rad", "power_dbm"))
    return dict(zip(wanted, np.array(rows, float).reshape(-1, len(wanted)).T, strict=True))


def graded(stage: Stage, scenes: list[SealedScene], rows: list[tuple[float, ...]]) -> float:
    return grade(stage, scenes, submission_of(columns(stage, rows), stage, N_SCENES, N_STOPS, "mine")).mean


def test_nothing_public_tells_the_truth(made: Path, sealed: list[SealedScene]) -> None:
    about = json.loads((made / "slam/public/task.json").read_text())
    assert "seed" not in about and "seed" not in json.dumps(about["settings"])
    table = read_table(made / "slam/public/scene_000/paths.csv")
    assert not table.has("rx_x_m", "clock_bias_s", "label", "ip_x_m")
    assert read_table(made / "contours/public/scene_000/paths.csv").has("rx_x_m")
    sweep = ia.read_record(made / "channel/public/scene_001/stop_001.nc", BeamSweep)
    assert np.array_equal(sweep.samples, sealed[1].run.sweep(sealed[1].truths[1]).samples)


@pytest.mark.parametrize("stage", ["slam", "contours"])
def test_the_page_makes_a_submission_of_a_table(
    made: Path, tmp_path: Path, stage: Stage, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = made / stage / "public/scene_000"
    done = arena_here(
        "import-paths", folder / "paths.csv", "--scene", folder / "hall.toml", "--out", "mine", cwd=tmp_path
    )
    assert done.returncode == 0 and "2 stops imported" in done.stdout and "doubtful" not in done.stdout, (
        done.stderr
    )
    for command in ("estimate", "score"):
        assert arena_here(command, "mine", cwd=tmp_path).returncode == 0
    monkeypatch.chdir(tmp_path)
    page_text = (ROOT / "docs/tasks.md").read_text(encoding="utf-8")
    exec(compile(page_text.split("```python\n")[1].split("```")[0], "tasks.md", "exec"), {})
    if stage == "slam":
        rows = submission_of(read_columns(tmp_path / "slam.csv"), stage, N_SCENES, N_STOPS, "slam.csv")
        assert len(rows.keys) and np.isfinite(rows.values).all()  # a stop that was not solved is left out
    else:
        assert (tmp_path / "contours.csv").read_text().startswith("scene,contour,x_m,y_m")


def test_an_interrupted_command_is_given_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It left half of the observations, and was then refused because of them."""

    def interrupt(number: int) -> None:
        if number:
            raise KeyboardInterrupt

    monkeypatch.setattr(making, "SETTINGS", SMALL)
    spec = TaskSpec("a task", "pillar", "channel", N_SCENES, 1, 5)
    with pytest.raises(KeyboardInterrupt):
        make_task(spec, tmp_path, interrupt)
    assert not (tmp_path / "public").exists() and not (tmp_path / "seal.tar").exists()
    make_task(spec, tmp_path)
    assert {one.name for one in (tmp_path / "public").iterdir()} == {"task.json", "scene_000", "scene_001"}


def test_a_seal_is_that_of_its_task(made: Path, tmp_path: Path) -> None:
    again = tmp_path / "again"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(making, "SETTINGS", SMALL)
        task(again, "slam")
    assert (again / "seal.tar").read_bytes() == (made / "slam/seal.tar").read_bytes()
    with tarfile.open(again / "seal.tar", "a") as seal:
        seal.add(again / "public/task.json", "more.json")
    with pytest.raises(ValueError, match="is not the seal of this task"):
        read_task(again)
    (again / "seal.tar").unlink()
    with pytest.raises(ValueError, match="only who made the task can grade"):
        read_task(again)
    assert "holds other files" in failure(
        "task", "make", "--out", again, "--tier", "halls", "--stage", "slam", "--scenes", "1"
    )


def test_positions_off_by_so_much_have_that_loss(sealed: list[SealedScene]) -> None:
    places = [
        (number, truth.stop, truth.rx_pose.position_m[0] + 0.3, truth.rx_pose.position_m[1] - 0.4)
        for number, one in enumerate(sealed)
        for truth in one.truths
    ]
    assert graded("slam", sealed, places) == pytest.approx(0.5)
    assert graded("slam", sealed, places[1:]) == pytest.approx((3 * 0.5 + 1) / 4)


def test_true_contours_lose_nothing_and_none_lose_most(sealed: list[SealedScene]) -> None:
    rows: list[tuple[float, ...]] = []
    for number, one in enumerate(sealed):
        for contour, item in enumerate(one.scene.objects):
            outline = item.contour.body().exterior.coords
            rows += [(number, contour, x, y) for x, y in outline]
    assert graded("contours", sealed, rows) == pytest.approx(0.0, abs=1e-3)  # circles have corners here
    assert graded("contours", sealed, []) == pytest.approx(0.5)
    assert len(bounce_points(sealed[0])) > 0


def test_a_contour_of_one_place_is_a_point(sealed: list[SealedScene]) -> None:
    once = [(scene, 0, 3.0, 3.0) for scene in range(N_SCENES)]
    assert graded("contours", sealed, once) == graded("contours", sealed, [*once, *once])


def test_lines_drawn_often_do_not_hide_guesses(sealed: list[SealedScene]) -> None:
    """A thousand scribbles along a true wall, and one line where nothing is."""
    (x_0, y_0, x_1, _), guess_m = sealed[0].scene.bounds_m, 3.0
    wall = [(x_0 + (x_1 - x_0) * (k % 2), y_0) for k in range(1000)]
    line = [(x_0 + guess_m, y_0 + 2.0 + y) for y in (0.0, 1.0)]
    once, often = (
        graded("contours", sealed, [(0, 0, *point) for point in some] + [(0, 1, *point) for point in line])
        for some in (wall[:2], wall)
    )
    assert often == pytest.approx(once)
    assert once > graded("contours", sealed, [(0, 0, *point) for point in wall])
    with pytest.raises(ValueError, match=r"scene 0: contours are 2e\+06 m long, at most 10000 m"):
        graded("contours", sealed, [(0, 0, -1e6, 0), (0, 0, 1e6, 0)])


@pytest.mark.parametrize(
    ("rows", "problem"),
    [
        ([(0, 0, 1, 1), (0, 1, 1, 1), (0, 0, 2, 2)], "row 3: stop = 0: is in the scene already"),
        ([(0, 0, 1, np.nan)], "row 1: y_m = nan: must be finite"),
        ([(0, 0, 1, 1e9)], "row 1: y_m = 1e\\+09: must be within -1e\\+06 and 1e\\+06"),
        ([(0, 0.5, 1, 1)], "row 1: stop = 0.5: must be a whole number from 0 to 1"),
    ],
)
def test_a_bad_row_is_named(rows: list[tuple[float, ...]], problem: str) -> None:
    with pytest.raises(ValueError, match=problem):
        submission_of(columns("slam", rows), "slam", N_SCENES, N_STOPS, "mine")


def test_submitted_estimates_have_the_gospa_of_a_campaign(sealed: list[SealedScene]) -> None:
    rows: list[tuple[float, ...]] = []
    expected = []
    for number, one in enumerate(sealed):
        expected.append(channel_tables(one, one.channel).stops.gospa)
        for found in one.channel:
            values = (found.delay_s, found.aod_azimuth_rad, found.aoa_azimuth_rad, found.power_dbm)
            rows += [(number, found.stop, *map(float, row)) for row in zip(*values, strict=True)]
    assert graded("channel", sealed, rows) == pytest.approx(np.mean(expected), rel=1e-6)


def test_intervals_hold_the_mean_of_many_scenes() -> None:
    """Scenes with a common part: the interval is that over scenes, not over stops."""
    rng = np.random.default_rng(3)
    hits, n_tasks = 0, 1000
    for _ in range(n_tasks):
        losses = [9.0 + rng.standard_normal() + 0.01 * rng.standard_normal(20) for _ in range(5)]
        found = with_interval(losses)
        hits += found.low <= 9.0 <= found.high
    assert abs(hits / n_tasks - 0.95) < 0.02  # three standard deviations


def test_few_values_have_intervals_of_what_there_is(tmp_path: Path) -> None:
    of_stops = with_interval([np.array([1.0, 3.0]), np.array([2.0, 4.0])])
    assert (of_stops.low + of_stops.high) / 2 == pytest.approx(of_stops.mean) == 2.5
    about = {
        "name": "t", "tier": "halls", "stage": "contours", "n_scenes": 1, "n_stops": 8, "seal_sha256": "0",
    }  # fmt: skip
    (row,) = enter(tmp_path, about, [BoardRow.of("one", "submission", with_interval([np.array([0.2])]))])
    assert (row.low, row.high, row.interval) == (None, None, "none") and read_board(tmp_path) == [row]
    text = (tmp_path / "leaderboard.html").read_text()
    assert "1 scene of 8 stops" in text and "One value has no interval." in text


def test_a_submission_is_graded_and_entered(made: Path, sealed: list[SealedScene], tmp_path: Path) -> None:
    place = sealed[0].truths[0].rx_pose.position_m
    (tmp_path / "mine.csv").write_text(f"scene,stop,x_m,y_m\n0,0,{place[0]},{place[1]}\n")
    done = arena_here("task", "grade", "mine.csv", "--task", made / "slam", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    (row,) = read_board(made / "slam")
    assert (row.name, row.kind, row.mean) == ("mine", "submission", 0.75)
    text = (made / "slam/leaderboard.html").read_text()
    assert "mine" in text and "0.75" in text and "<script" not in text
    (tmp_path / "mine.csv").write_text("scene,stop,x_m,y_m\n0,7,1,1\n")
    assert "row 1: stop = 7: must be a whole number from 0 to 1" in failure(
        "task", "grade", "mine.csv", "--task", made / "slam", cwd=tmp_path
    )


@pytest.mark.slow
def test_baselines_and_the_bound_are_rows(made: Path) -> None:
    done = arena_here("task", "baselines", made / "slam")
    assert done.returncode == 0, done.stderr
    kinds = [row.kind for row in read_board(made / "slam")]
    assert kinds.count("baseline") == 3 and kinds.count("bound") == 1


def test_stops_without_a_bound_are_not_in_that_of_the_task(
    sealed: list[SealedScene], monkeypatch: pytest.MonkeyPatch
) -> None:
    """They had the largest loss of 1 m: the bound was worse than every method."""
    losses = iter([np.array([0.01, np.nan]), np.array([np.nan, np.nan]), np.full(2, np.nan), np.full(2, np.nan)])
    monkeypatch.setattr(baselines, "_slam_bound", lambda _: next(losses))
    found = baselines.bound("slam", sealed)
    assert found is not None and found.mean == 0.01
    assert baselines.bound("slam", sealed) is None


def test_both_ends_see_all_around() -> None:
    """A path behind the only panel of a TX would look as if it left in front: whole walks were mirrored."""
    around_deg = np.arange(0.0, 360.0, 0.5)
    for array in making.task_config(1).end_arrays:
        away_deg = (around_deg[:, None] - np.array(array.panel_azimuth_deg) + 180) % 360 - 180
        assert np.abs(away_deg).min(axis=1).max() <= array.sector_deg / 2


@pytest.mark.slow
def test_a_walk_behind_the_tx_is_found(tmp_path: Path) -> None:
    make_task(TaskSpec("behind", "pillar", "slam", 1, 3, 1), tmp_path)
    (scene,) = read_task(tmp_path)[1]
    tx = scene.scene.tx
    offset_m = scene.scene.walk.positions_m()[:, :2] - tx.position_m[:2]
    assert (offset_m @ [np.cos(tx.heading_rad), np.sin(tx.heading_rad)] < 0).all()
    for method in BASELINES["slam"]:
        table = baseline_rows("slam", [scene], method)
        assert grade("slam", [scene], submission_of(table, "slam", 1, 3, method.name)).mean < 0.2


def test_names_on_the_page_are_text(tmp_path: Path) -> None:
    about = {
        "name": "t", "tier": "halls", "stage": "slam", "n_scenes": 1, "n_stops": 1, "seal_sha256": "0",
    }  # fmt: skip
    rows = enter(tmp_path, about, [BoardRow("<script>", "submission", 0.5, 0.4, 0.6)])
    rows = enter(tmp_path, about, [BoardRow("better", "submission", 0.2, 0.1, 0.3)])
    assert [row.name for row in rows] == ["better", "<script>"]
    assert "<script>" not in page(about, rows)


def test_half_of_the_stops_see_the_tx(monkeypatch: pytest.MonkeyPatch) -> None:
    """Scene 2 of seed 100: from the first walk that is drawn, no stop sees the TX."""
    spec = TaskSpec("t", "halls", "slam", 3, 4, 100)
    first = task_scene("halls", np.random.default_rng([100, 2]), 4)
    assert not sees_tx(first).any()
    monkeypatch.setattr(CampaignRun, "truths", lambda run: iter(()))
    assert sees_tx(making._simulated(spec, 2).scene).sum() >= 2


def test_too_few_stops_for_contours_are_refused(tmp_path: Path) -> None:
    options = ("--tier", "pillar", "--stage", "contours", "--stops", "5")
    assert "--stops = 5: must be at least 6 for contours" in failure(
        "task", "make", "--out", tmp_path / "t", *options
    )
    assert not (tmp_path / "t").exists()


def test_people_walk_where_nothing_stands() -> None:
    scene = task_scene("people", np.random.default_rng(2), 3)
    people = [item for item in scene.objects if item.motion is not None]
    assert people and scene.is_moving
    for person in people:
        assert person.motion is not None
        shift_m = person.motion.over(np.linspace(0, 3, 40))[0][:, :2]
        for item in scene.objects:
            if item.motion is None:
                places = person.contour.body().centroid.coords[0] + shift_m
                assert item.contour.signed_distance(places).min() > CLEAR_M
