"""Random halls keep their rules, and `arena validate halls` measures them by the sweep engine."""

import json
import tomllib
from dataclasses import replace

import numpy as np
import pytest
from rich.console import Console

from isac_arena.campaign.chain.inputs import significance
from isac_arena.campaign.driver import CampaignRun
from isac_arena.scoring.chain import score_channel
from isac_arena.scoring.link_view import link_view
from isac_arena.scoring.record import ScoreTables, StopScores
from isac_arena.scoring.true_stop import true_stop
from isac_arena.validation import case_runs
from isac_arena.validation.halls.check import check_halls, hall_rows
from isac_arena.validation.halls.run import HallResult
from isac_arena.validation.halls.statistics import height_error_m, trimmed_rms
from isac_arena.validation.scenarios.drawn_estimates import drawn_estimate
from isac_arena.validation.scenarios.random_halls import (
    EQUAL_HEIGHTS_M,
    LEAST_DIFFERENCE_M,
    LEAST_DISTANCE_M,
    LEAST_SEEN,
    LONGEST_M,
    N_STOPS,
    SHORTEST_M,
    draw_hall,
)
from scenes.config import SceneConfig
from scenes.record import empty_record
from sim.config import PropagationConfig
from sim.propagation.occlusion import sees_tx
from tests.command_line import arena


@pytest.fixture(scope="module")
def halls():
    return [draw_hall(100, room) for room in range(16)]


def scene_of(hall):
    return SceneConfig.model_validate(tomllib.loads(hall.scene_text)).build(60e9)


def test_sixteen_rooms_hold_every_combination(halls):
    kinds = {(hall.has_equal_heights, hall.n_elevations, hall.has_hardware) for hall in halls}
    assert len(kinds) == 16
    for hall in halls:
        arrays = hall.config.tx_array, hall.config.rx_array
        assert {len(array.beam_elevation_deg) for array in arrays} == {hall.n_elevations}
        assert bool(hall.config.impairments.switched_on) == hall.has_hardware


def test_a_room_is_the_same_alone_and_another_seed_another(halls):
    assert draw_hall(100, 5) == halls[5]
    few = tomllib.loads(draw_hall(100, 5, n_stops=2).scene_text)["walk"]["waypoints_m"]
    assert few == tomllib.loads(halls[5].scene_text)["walk"]["waypoints_m"][:2]
    assert draw_hall(101, 5).scene_text != halls[5].scene_text


def test_rooms_follow_the_rules(halls):
    n_seen = []
    for hall in halls:
        scene = scene_of(hall)  # it refuses overlaps and devices inside objects
        size = np.array(scene.bounds_m[2:])
        assert SHORTEST_M <= size[0] <= LONGEST_M and size[1] <= size[0]
        stops, tx = scene.walk.positions_m(), scene.tx.position_m
        assert len(stops) == N_STOPS
        apart_m = abs(stops[0, 2] - tx[2])
        assert apart_m <= EQUAL_HEIGHTS_M if hall.has_equal_heights else apart_m >= LEAST_DIFFERENCE_M
        assert np.linalg.norm((stops - tx)[:, :2], axis=1).min() >= LEAST_DISTANCE_M
        for item in scene.objects:
            if item.z_min_m <= stops[0, 2]:
                assert np.abs(item.contour.signed_distance(stops[:, :2])).min() >= 0.4
        n_seen.append(int(sees_tx(scene).sum()))
    assert min(n_seen) >= LEAST_SEEN
    assert min(n_seen) < N_STOPS  # some stops have no line of sight


def test_the_trimmed_rms_of_a_gaussian_is_one_whatever_its_outliers():
    ratio = np.abs(np.random.default_rng(1).standard_normal(200_000))
    assert trimmed_rms(ratio) == pytest.approx(1, abs=0.01)
    ratio[::50] = 1e6  # 2 % gross errors: the others keep all their small values
    assert trimmed_rms(ratio) == pytest.approx(1, abs=0.06)
    assert np.isnan(trimmed_rms(np.zeros(0)))


@pytest.mark.whole
def test_a_quick_run_measures_every_row_and_continues_without_estimating(tmp_path, monkeypatch):
    options = ("--quick", "--method", "power", "--trials", "2", "--seed", "101", "--out", str(tmp_path / "rooms"))
    result = arena("validate", "halls", *options, "--json", str(tmp_path / "rows.json"))
    content = json.loads((tmp_path / "rows.json").read_text())
    rows = {row["key"]: np.nan if row["value"] is None else row["value"] for row in content["metrics"]}
    assert len(rows) == len(content["metrics"]) == 28
    assert rows["halls.detection.equal_heights"] > 0.2 and rows["halls.detection.unequal_heights"] > 0.2
    assert all(row["unit"] and row["bar"] is not None for row in content["metrics"])
    rooms, groups = content["tables"]
    assert [len(rooms["rows"]), groups["rows"][0][0]] == [2, "all (2)"]
    assert result.returncode == 1  # power alone misses bars
    monkeypatch.setattr(case_runs, "run_missing", lambda *arguments: None)
    again = check_halls(101, True, 2, method="power", out=tmp_path / "rooms", console=Console(quiet=True))
    assert {row.key: row.value for row in again.rows} == pytest.approx(rows, nan_ok=True)


def test_a_room_that_fails_is_named(tmp_path):
    with pytest.raises(ValueError, match="cannot be imported"):
        check_halls(100, True, 1, estimator="no_such:thing", out=tmp_path, console=Console(quiet=True))


def test_estimates_drawn_from_the_bounds_meet_every_bar():
    """Separable paths with errors drawn from their joint bound, which is the covariance that they report."""
    rng, results = np.random.default_rng(1), []
    for room in (0, 1):
        hall = draw_hall(100, room, n_stops=4)
        config = hall.config.model_copy(update={"propagation": PropagationConfig(diffuse_samples=0)})
        run = CampaignRun(config, scene_of(hall))
        view, limits = link_view(config, run.link, run.scene), significance(config, run.link)
        truths = list(run.truths())
        stops = [true_stop(truth, run.scene.tx, run.true_power_dbm(truth), limits, view) for truth in truths]
        estimates = [drawn_estimate(stop, rng) for stop in stops]
        scores = score_channel(
            run.scene, truths, estimates, true_power_dbm=run.true_power_dbm, significance=limits, view=view
        )
        results.append(HallResult(hall, scores.tables, np.zeros(0)))
    rows = hall_rows(results, quick=True)
    assert len(rows) == 28 and not [(row.key, row.value, row.bar) for row in rows if not row.met]


def test_a_room_without_a_ceiling_that_shows_has_unknown_heights() -> None:
    hall = draw_hall(101, 0, 1, 14.0)
    scene = tomllib.loads(hall.scene_text)
    tables = empty_record(ScoreTables)
    rx_m, ceiling_m = scene["walk"]["height_m"] + 0.01, scene["ceiling"]["z_m"] - 0.03

    def stops(height_m: float) -> StopScores:
        one = np.ones(1)
        known = {"rx_height_m": np.array([rx_m]), "ceiling_m": np.array([height_m])}
        return StopScores(np.array([0]), one, one, one, one, **known)

    shown, hidden = (
        HallResult(hall, replace(tables, stops=stops(z_m)), np.ones(1)) for z_m in (ceiling_m, np.nan)
    )
    assert height_error_m(shown) == pytest.approx(0.03)
    assert height_error_m(hidden) == np.inf
    elevations = hall.n_elevations
    rows = {row.key: row for row in hall_rows([shown, shown, hidden], quick=False) if "height" in row.key}
    name = "horizontal" if elevations == 1 else "three_elevations"
    assert rows[f"halls.height_error.{name}"].value == pytest.approx(0.03)
