"""`arena validate chain`: its campaigns, its statistics on constructed tables, and its rows of a small run."""

import tomllib
from dataclasses import replace

import numpy as np
import pytest
from rich.console import Console

from estimation.slam.config import TrajectoryConfig
from estimation.slam.record import SolveStatus
from isac_arena.scoring.chain import score_campaign
from isac_arena.scoring.config import Significance
from isac_arena.scoring.record import PoseScores
from isac_arena.validation.chain.campaigns import (
    COLUMN_ROOMS,
    FEWEST_STOPS,
    MOST_STOPS,
    THICK_M,
    ChainGroup,
    ChainOptions,
    column_campaign,
    library_campaign,
    our_campaigns,
    room_campaign,
    walk_length,
)
from isac_arena.validation.chain.check import chain_rows, check_chain
from isac_arena.validation.chain.run import ChainFailure, ChainResult
from isac_arena.validation.chain.statistics import ChainStops, slam_objects
from isac_arena.validation.chain.tables import object_table, stop_table
from isac_arena.validation.chain.trials import check_exact_paths, check_wrong_covariances
from isac_arena.validation.scenarios.perfect_campaign import make_campaign, power_dbm
from isac_arena.validation.scenarios.random_halls import LEAST_DISTANCE_M, N_STOPS, draw_hall
from scenes.config import SceneConfig


def walk_of(hall):
    return tomllib.loads(hall.scene_text)["walk"]["waypoints_m"]


def test_longer_walks_go_on_from_the_same_stops_and_leave_the_room_as_it_is():
    short, long = draw_hall(100, 3), draw_hall(100, 3, n_stops=MOST_STOPS)
    assert walk_of(long)[:N_STOPS] == walk_of(short) and len(walk_of(long)) == MOST_STOPS
    assert draw_hall(100, 3, n_stops=MOST_STOPS) == long
    assert long.config == short.config
    here, there = (tomllib.loads(hall.scene_text) for hall in (short, long))
    assert {**here, "walk": None} == {**there, "walk": None}
    scene = SceneConfig.model_validate(there).build(60e9)  # it refuses stops inside objects
    stops, tx = scene.walk.positions_m(), scene.tx.position_m
    steps = np.linalg.norm(np.diff(stops[:, :2], axis=0), axis=1)
    np.testing.assert_allclose(steps, steps[0])
    assert np.linalg.norm((stops - tx)[:, :2], axis=1).min() >= LEAST_DISTANCE_M
    for item in scene.objects:
        if item.z_min_m <= stops[0, 2]:
            assert np.abs(item.contour.signed_distance(stops[:, :2])).min() >= 0.4


def test_rooms_columns_and_the_whole_library_have_the_same_settings():
    options = ChainOptions()
    columns = column_campaign(100, COLUMN_ROOMS.index(THICK_M), options)
    library = [library_campaign(name, 100, options) for name in our_campaigns()]
    assert [one.case.config.seed for one in library] == [100] * len(library)
    for one in (*library, columns, room_campaign(100, 0, options)):
        config = one.case.config
        likelihood = config.channel.maximum_likelihood
        assert (config.channel.method, likelihood.max_paths) == ("auto", 120)
        is_walk = config.name != "trp_to_trp"  # its receivers stand on the walls
        assert (config.trajectory == TrajectoryConfig()) == is_walk and config.heights.use
        assert config.contours.method == "reflection" and one.case.stages == "all_kept"
        if one.group != ChainGroup.LIBRARY:
            n_stops = len(tomllib.loads(one.case.scene.text)["walk"]["waypoints_m"])
            assert FEWEST_STOPS <= n_stops <= MOST_STOPS
    objects = columns.case.scene.build(columns.case.config).objects
    radii = np.sqrt([item.contour.area_m2() / np.pi for item in objects if item.kind == "pillar"])
    assert len(radii) >= 2 and (radii > 0.5).all() and (radii < 2).all()


def test_the_length_of_a_walk_is_that_of_its_room():
    lengths = [walk_length(1, room) for room in range(200)]
    assert min(lengths) == FEWEST_STOPS and max(lengths) == MOST_STOPS
    assert lengths[7] == walk_length(1, 7) != walk_length(1, 8)


def made_stops(**changes):
    """Ten stops with a bound of 1 cm, errors of 2 cm and stated deviations of 2 cm."""
    n, ones = 10, np.ones(10)
    columns = {
        "error_m": 0.02 * ones, "bound_m": 0.01 * ones, "std_m": 0.02 * ones, "nees": 4 * ones,
        "has_los": ones > 0, "is_solved": ones > 0, "is_flagged": ones < 0,
    }  # fmt: skip
    for name, values in changes.items():
        columns[name] = columns[name].copy()
        columns[name][: len(values)] = values
    assert all(len(column) == n for column in columns.values())
    return ChainStops(**columns)


def test_statistics_of_stops_count_known_stops_and_flags():
    stops = made_stops()
    assert (stops.over_bound, stops.normalised_nees, stops.solved()) == (2, 1, 1)
    assert stops.far_flagged == 1 and not stops.is_unflagged_gross.any()
    # a stop that its paths do not determine counts only where all stops do
    unknown = made_stops(bound_m=[3.0], error_m=[3.0], std_m=[3.0])
    assert unknown.over_bound == 2
    assert unknown.over_any_bound == pytest.approx(np.sqrt((9 + 9 * 4e-4) / (9 + 9e-4)))
    failed = made_stops(error_m=[np.nan, np.nan], nees=[np.nan, np.nan], is_solved=[False, False], bound_m=[9.0])
    assert failed.solved() == 8 / 9 and failed.over_bound == 2 and failed.normalised_nees == 1
    off = made_stops(error_m=[0.11, 0.11, 1.1, 0.07], std_m=[0.02, 0.02, 2.0, 0.02], is_flagged=[False, True])
    assert off.is_unflagged_gross.tolist() == [True, False, True] + 7 * [False]
    assert off.far_flagged == pytest.approx(1 / 3)  # the third states 2 m
    both = ChainStops.joined([stops, off])
    assert len(both.error_m) == 20 and both.is_unflagged_gross.sum() == 2


@pytest.fixture(scope="module")
def perfect():
    """The result of a perfect estimator at twelve stops."""
    made = make_campaign()
    limits = {"dynamic_range_db": 30.0, "noise_threshold_dbm": -80.0}
    scores = score_campaign(
        made.scene, made.truths, made.results, true_power_dbm=power_dbm, significance=Significance(**limits)
    )
    return ChainResult("made", ChainGroup.ROOMS, made.scene, scores.tables, np.ones(12))


def test_a_perfect_map_has_the_best_objects(perfect):
    objects = slam_objects(perfect)
    assert objects.kind.tolist() == ["pillar", "pillar", "wall", "wall"]
    np.testing.assert_allclose(objects.radius_m, [0.3, 0.4, np.nan, np.nan], rtol=1e-6)
    assert (objects.n_lit == 12).all() and objects.is_found.all() and objects.n_walls == 2
    np.testing.assert_allclose(objects.pillar_iou(), 1, atol=0.01)
    assert len(objects.pillar_iou((0.35, 0.5))) == 1
    assert objects.wall_rmse_m < 1e-9 and not objects.is_ghost.any() and objects.class_right.min() == 1


def test_a_pillar_without_a_contour_counts_with_zero(perfect):
    contours = perfect.tables.slam.contours
    lost = contours.take("outline", contours.object != "pillar_a")
    tables = replace(perfect.tables, slam=replace(perfect.tables.slam, contours=lost))
    found = slam_objects(replace(perfect, tables=tables))
    np.testing.assert_allclose(found.pillar_iou(), [0, 1], atol=0.01)
    few = perfect.tables.significant
    few = few.take("true_path", (few.object != "pillar_a") | (few.stop < 4))
    dim = slam_objects(replace(perfect, tables=replace(tables, significant=few)))
    np.testing.assert_allclose(dim.pillar_iou(), [1], atol=0.01)  # four stops show it: no fit is expected


def with_errors(poses: PoseScores, over_bound: float) -> PoseScores:
    n = len(poses.stop)
    return replace(
        poses,
        status=np.full(n, SolveStatus.LOS),
        position_error_m=np.full(n, 0.01 * over_bound),
        position_bound_m=np.full(n, 0.01),
        position_std_m=np.full(n, 0.01),
        nees=np.full(n, 4.0),
    )


def test_rows_and_table_name_every_campaign(perfect):
    results = []
    for number, over_bound in enumerate((1.0, 1.5, 4.0)):
        tables = replace(perfect.tables, poses=with_errors(perfect.tables.poses, over_bound))
        results.append(replace(perfect, name=f"hall_{number}", tables=tables))
    campus = replace(results[0], name="campus_arena", group=ChainGroup.LIBRARY)
    rows = {row.key: row for row in chain_rows([*results, campus], [], quick=False)}
    assert rows["chain.rooms.position_over_bound.median"].value == pytest.approx(1.5)
    assert rows["chain.rooms.position_over_bound.worst"].value == pytest.approx(4)
    assert rows["chain.library.position_over_bound.worst"].value == pytest.approx(1)
    assert rows["chain.rooms.mapping.pillar_iou"].value == pytest.approx(1, abs=0.01)
    assert rows["chain.campus_arena.position.rmse_m"].value == pytest.approx(0.01)
    assert rows["chain.campus_arena.slam.walls_found"].value == 2
    assert rows["chain.runs_with_errors"].met and len(rows) == 1 + 2 * 21 + 4 + 6
    assert rows["chain.rooms.far_flagged"].value == 0  # the third room is four deviations off
    failure = ChainFailure("hall_7", ChainGroup.ROOMS, "ValueError: no such thing")
    (failed, *others) = chain_rows([], [failure], quick=False)
    assert not others and failed.value == 1 and not failed.met and "no such thing" in failed.reason
    table = stop_table(results, [failure])
    for one in (table, object_table(results)):
        assert {len(row) for row in one.rows} == {len(one.columns)}
    assert table.rows[-1][0] == "hall_7" and table.rows[-1][-1] == failure.reason


def test_a_campaign_that_fails_is_a_row_and_stops_no_other(tmp_path):
    """Without its estimator no campaign runs; each says why in one line."""
    options = {"estimator": "no_such:thing", "out": tmp_path, "console": Console(quiet=True)}
    measured = check_chain(100, True, **options)
    (row,) = measured.rows
    assert row.value == 2 and not row.met and "cannot be imported" in row.reason
    assert [line[0] for line in measured.tables[0].rows] == ["box_room", "hall_00"]


@pytest.mark.whole
def test_trials_of_slam_have_every_row():
    exact = {row.key: row for row in check_exact_paths(100, True)}
    assert exact["chain.exact_paths.position_m"].met and exact["chain.exact_paths.solved"].met
    found = check_wrong_covariances(100, True)
    assert len(found.rows) == 6 and all(np.isfinite(row.value) for row in found.rows)
    assert [row[0] for row in found.tables[0].rows] == ["right", "quarter", "fourfold"]
