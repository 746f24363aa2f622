from dataclasses import replace

import numpy as np
import pytest

from estimation.shape.config import ContourConfig
from estimation.slam.record import SolveStatus
from isac_arena.insight.budget.chain import make_chain
from isac_arena.insight.budget.outcome import (
    POSE_CUTOFF_M,
    SHAPE_CUTOFF_M,
    LitObject,
    Outline,
    object_errors,
    outline_error_m,
    outlines_of_contours,
    outlines_of_shapes,
    pose_errors,
)
from isac_arena.insight.budget.record import Budget, attributions, table_rows
from isac_arena.insight.budget.stages import STAGE_GROUPS, Stage, coalitions
from scenes.contours import Circle

EVERYTHING = frozenset(Stage)
ANGLE = np.linspace(-np.pi, np.pi, 720, endpoint=False)
UNIT = np.stack([np.cos(ANGLE), np.sin(ANGLE)], axis=1)


@pytest.fixture(scope="module")
def variants(chain):
    return {parts: [chain.final_errors(parts)] for parts in coalitions(STAGE_GROUPS)}


def test_nothing_is_left_when_truth_stands_everywhere(chain):
    errors = chain.final_errors(EVERYTHING)
    assert errors.pose_error_m.max() <= 1e-9
    assert errors.shape_error_m.max() <= 1e-9
    assert len(errors.shape_error_m) == 4
    assert len(errors.contour_error_m) == 0


def test_nothing_is_left_of_our_contours_either(chain):
    config = chain.run.config.model_copy(update={"contours": ContourConfig()})
    ours = replace(chain, run=replace(chain.run, config=config), _maps={})
    assert len(ours.final_errors(frozenset()).contour_error_m) == 4
    assert ours.final_errors(EVERYTHING).contour_error_m.max() <= 1e-9


def test_true_paths_leave_the_solver_next_to_no_error(variants):
    paths = frozenset({Stage.DETECTION, Stage.GEOMETRY, Stage.ASSOCIATION})
    assert variants[paths][0].pose_error_m.max() <= 1e-5
    assert variants[frozenset()][0].pose_error_m.mean() > 1e-2


def test_true_poses_have_no_error_whatever_the_paths(variants):
    assert variants[frozenset({Stage.POSE})][0].pose_error_m.max() <= 1e-12


def test_stages_downstream_do_not_touch_the_poses(variants):
    before = variants[frozenset()][0].pose_error_m
    for stage in (Stage.CLUSTERS, Stage.FIT):
        np.testing.assert_array_equal(variants[frozenset({stage})][0].pose_error_m, before)


def test_the_parts_add_up(variants):
    found = attributions(variants, STAGE_GROUPS, np.random.default_rng(1))
    assert set(found) == {"pose", "shape"}
    for one in found.values():
        assert one.rest <= 1e-18
        assert one.contribution.sum() == pytest.approx(one.total, abs=1e-15)


def test_a_budget_becomes_rows_of_finite_numbers_or_none(variants):
    found = attributions(variants, STAGE_GROUPS, np.random.default_rng(1))
    budget = Budget("made", (0, 1), ("a",), 1, {(name, "stages"): one for name, one in found.items()})
    rows = list(table_rows(budget))
    assert len(rows) == 2 * (len(Stage) + 2)
    values = [value for row in rows for value in row.values() if not isinstance(value, str)]
    assert all(value is None or np.isfinite(value) for value in values)
    pose = [row for row in rows if row["outcome"] == "pose"]
    assert pose[-1]["part"] == "all errors" and pose[-1]["share"] == 1
    assert sum(row["share"] for row in pose[:-1]) == pytest.approx(1)


def test_a_perfect_channel_leaves_no_error_to_detection_and_geometry(campaign, stops, chain):
    """What is left of the poses is the double bounce that SLAM cannot tell from a single one."""
    perfect = make_chain(chain.run, stops, campaign.results.channel, chain.objects)
    variants = {parts: [perfect.final_errors(parts)] for parts in coalitions(STAGE_GROUPS)}
    found = attributions(variants, STAGE_GROUPS, np.random.default_rng(2))["pose"]
    shares = dict(zip(found.part, found.contribution / found.total, strict=True))
    assert abs(shares[Stage.GEOMETRY]) < 1e-9
    assert shares[Stage.DETECTION] + shares[Stage.ASSOCIATION] == pytest.approx(1)


def test_stops_without_estimates_count_as_missed_and_are_made_good_by_truth(campaign, stops, chain):
    silent = [estimate.take("path", slice(0, 0)) for estimate in campaign.results.channel]
    empty = make_chain(chain.run, stops, silent, chain.objects)
    for parts in coalitions(STAGE_GROUPS):
        errors = empty.final_errors(parts)
        blind = not parts & {Stage.DETECTION, Stage.POSE}
        assert (errors.pose_error_m == POSE_CUTOFF_M).all() == blind
        if Stage.DETECTION not in parts:
            assert (errors.shape_error_m == SHAPE_CUTOFF_M).all()
    assert empty.final_errors(EVERYTHING).shape_error_m.max() <= 1e-9


def test_failed_and_far_stops_count_as_the_cutoff(campaign, stops):
    poses = campaign.results.slam.poses
    status, position = poses.status.copy(), poses.position_m.copy()
    status[0], position[0] = SolveStatus.FAILED, np.nan
    position[1] += 50
    position[2] += [0.3, 0.4]
    errors = pose_errors(replace(poses, status=status, position_m=position), stops)
    np.testing.assert_allclose(errors[:3], [POSE_CUTOFF_M, POSE_CUTOFF_M, 0.5])
    np.testing.assert_allclose(errors[3:], 0)


def test_outline_error_of_a_ring_about_a_circle_is_its_distance():
    lit = LitObject("pillar", Circle(np.zeros(2), 1.0), UNIT[:360])
    ring = Outline(1.1 * UNIT, np.ones(720, bool), True)
    assert outline_error_m([ring], lit) == pytest.approx(0.1, abs=1e-4)


def test_outline_error_asks_for_all_that_was_lit_and_for_nothing_else():
    lit = LitObject("pillar", Circle(np.zeros(2), 1.0), UNIT[:360])
    same = Outline(UNIT[:360], np.ones(360, bool), False)
    dot = Outline(np.tile(UNIT[180], (3, 1)), np.ones(3, bool), False)
    wide = Outline(np.concatenate([UNIT[:360], 3 * UNIT[360:]]), np.arange(720) < 360, True)
    assert outline_error_m([same], lit) == pytest.approx(0, abs=1e-9)
    assert outline_error_m([dot], lit) > 0.3
    assert outline_error_m([wide], lit) == pytest.approx(0, abs=1e-9)
    halves = [Outline(UNIT[:200], np.ones(200, bool), False), Outline(UNIT[199:360], np.ones(161, bool), False)]
    assert outline_error_m(halves, lit) == pytest.approx(0, abs=1e-9)


def test_objects_without_a_contour_count_as_the_cutoff():
    lit = LitObject("pillar", Circle(np.zeros(2), 1.0), UNIT[:360])
    far = Outline(UNIT + 40, np.ones(720, bool), True)
    np.testing.assert_allclose(object_errors([lit], {}), SHAPE_CUTOFF_M)
    np.testing.assert_allclose(object_errors([lit], {"pillar": [far]}), SHAPE_CUTOFF_M)


def test_exact_contours_of_both_methods_have_no_error(campaign, chain):
    mapping = campaign.results.mapping
    names = np.array([item.name for item in campaign.scene.objects])
    ours = outlines_of_contours(mapping.contours, mapping.ips.position_m, names)
    np.testing.assert_allclose(object_errors(chain.objects, ours), 0, atol=2e-4)
    paper = outlines_of_shapes(mapping.shapes, mapping.ips.position_m, names)
    np.testing.assert_allclose(object_errors(chain.objects, paper)[:2], 0, atol=2e-4)
