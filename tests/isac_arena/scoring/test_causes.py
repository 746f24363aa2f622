"""One made case per cause, and the order in which they are told."""

from dataclasses import fields, replace

import numpy as np
import pytest

from isac_arena.scoring.causes import (
    FALSE_CAUSES,
    GHOST_CAUSES,
    MISS_CAUSES,
    RIGHT_SURFACE,
    Cause,
    Evidence,
    cause_words,
    cluster_causes,
    false_causes,
    ghost_words,
    miss_causes,
    point_causes,
    weak_causes,
)
from isac_arena.scoring.record import ContourScores, PathKind, PathStatus

FAR = 9.0


@pytest.fixture
def evidence():
    """One false estimate and three true paths, the first detected, all far from each other."""
    return Evidence(
        status=np.array([PathStatus.FALSE]),
        distance=np.full((1, 3), FAR),
        true_distance=np.where(np.eye(3, dtype=bool), 0.0, FAR),
        is_detected=np.array([True, False, False]),
        is_separable=np.ones(3, bool),
        estimate_dbm=np.array([-60.0]),
        true_dbm=np.array([-40.0, -50.0, -55.0]),
        leaked_dbm=np.full((1, 3), -200.0),
        crosstalk_dbm=np.where(np.eye(3, dtype=bool), -40.0, -200.0),
        beam_loss_db=np.zeros(3),
        diffuse_dbm=np.full(3, -300.0),
        noise_threshold_dbm=-90.0,
        significance_dbm=-70.0,
        is_limited=False,
        is_refused=False,
    )


@pytest.mark.parametrize(
    ("cause", "changes"),
    [
        (Cause.UNKNOWN, {}),
        (Cause.DUPLICATE, {"distance": np.array([[0.9, FAR, FAR]])}),
        (Cause.MERGED, {"distance": np.array([[1.5, 1.9, FAR]])}),
        (Cause.INACCURATE, {"distance": np.array([[FAR, 1.9, FAR]])}),
        (Cause.SIDE_LOBE, {"leaked_dbm": np.array([[-65.9, -200.0, -200.0]])}),
        (Cause.UNKNOWN, {"leaked_dbm": np.array([[-66.1, -200.0, -200.0]])}),
        (Cause.NOISE, {"noise_threshold_dbm": -62.9}),
        (Cause.UNKNOWN, {"distance": np.array([[1.5, FAR, FAR]])}),  # near a path that is detected
        (Cause.NONE, {"status": np.array([PathStatus.DETECTED])}),
    ],
)
def test_a_false_path_is_named(evidence, cause, changes):
    assert false_causes(replace(evidence, **changes)).tolist() == [cause]


@pytest.mark.parametrize(
    ("cause", "changes"),
    [
        (Cause.UNKNOWN, {}),
        (Cause.REFUSED, {"is_refused": True}),
        (Cause.INACCURATE, {"distance": np.array([[FAR, 1.9, FAR]])}),
        (Cause.OUTSIDE_CODEBOOK, {"beam_loss_db": np.array([0.0, 10.0, 0.0])}),
        (Cause.BELOW_THRESHOLD, {"significance_dbm": -52.9}),
        (Cause.DIFFUSE, {"diffuse_dbm": np.array([-300.0, -50.0, -300.0])}),
        (Cause.PATH_LIMIT, {"is_limited": True, "estimate_dbm": np.array([-49.0])}),
        (Cause.UNKNOWN, {"is_limited": True, "estimate_dbm": np.array([-51.0])}),
        (Cause.UNKNOWN, {"beam_loss_db": np.full(3, np.nan), "leaked_dbm": np.full((1, 3), np.nan)}),
    ],
)
def test_a_missed_path_is_named(evidence, cause, changes):
    found = miss_causes(replace(evidence, **changes))
    assert found[0] == Cause.NONE
    assert found[1] == cause


def test_misses_beside_other_paths(evidence):
    close = evidence.true_distance.copy()
    close[1, 2] = close[2, 1] = 1.9
    assert miss_causes(replace(evidence, true_distance=close)).tolist() == ["", "merged", "merged"]
    close[0, 1] = close[1, 0] = 1.0
    found = miss_causes(replace(evidence, true_distance=close))
    assert found.tolist() == ["", "unresolved", "merged"]
    leak = evidence.crosstalk_dbm.copy()
    leak[1, 0] = -55.9
    assert miss_causes(replace(evidence, crosstalk_dbm=leak))[1] == "masked"


def test_a_path_does_not_leak_into_itself(evidence):
    own = np.where(np.eye(3, dtype=bool), evidence.true_dbm, -200.0)
    assert miss_causes(replace(evidence, crosstalk_dbm=own))[1] == "unknown"
    inside = replace(evidence, distance=np.array([[0.5, FAR, FAR]]), leaked_dbm=np.array([[-60.0, -200, -200]]))
    assert false_causes(inside).tolist() == ["duplicate"]


def test_stops_without_paths_have_no_causes(evidence):
    empty = {
        field.name: getattr(evidence, field.name)[(slice(0, 0),) * getattr(evidence, field.name).ndim]
        for field in fields(Evidence)
        if isinstance(getattr(evidence, field.name), np.ndarray)
    }
    assert len(false_causes(replace(evidence, **empty))) == 0
    assert len(miss_causes(replace(evidence, **empty))) == 0


def test_every_cause_told_has_a_metric():
    assert set(FALSE_CAUSES) | set(MISS_CAUSES) | set(GHOST_CAUSES) | {Cause.NONE, Cause.REJECTED} == set(Cause)


def test_weak_paths_are_diffuse_or_weak():
    status = np.array([PathStatus.WEAK, PathStatus.WEAK, PathStatus.FALSE, PathStatus.DETECTED])
    assert weak_causes(status, np.array([True, False, False, False])).tolist() == ["diffuse", "weak", "", ""]


def test_points_of_no_object_are_named_by_what_they_were_made_from():
    found = point_causes(
        is_inlier=np.array([True, True, True, True, True, False, False]),
        ip_object=np.array(["pillar", "", "", "", "", "pillar", ""]),
        kind=np.array(
            [PathKind.SINGLE_BOUNCE, PathKind.MULTI_BOUNCE, PathKind.LOS, PathKind.NONE, PathKind.SINGLE_BOUNCE,
             PathKind.SINGLE_BOUNCE, PathKind.NONE]
        ),
        path_cause=np.array(["", "", "", "side_lobe", "", "", "noise"]),
    )  # fmt: skip
    expected = ["", "double_bounce", "line_of_sight", "side_lobe", "unknown", "rejected", ""]
    assert found.tolist() == expected


def test_a_ghost_cluster_takes_the_most_frequent_cause():
    label = np.array([0, 0, 0, 0, 1, 1, -1])
    names = np.array(["", "", "", "pillar", "wall", "", ""])
    causes = np.array(["double_bounce", "double_bounce", "side_lobe", "", "", "noise", "noise"])
    found = cluster_causes(label, names, causes, np.array([True, False]))
    assert found.tolist() == ["double_bounce", ""]


def test_double_bounces_on_a_true_surface_are_told_from_ghosts():
    causes, surface_m = (
        np.array(["double_bounce", "double_bounce", "side_lobe", ""]),
        np.array([0.02, 0.5, 0.0, 0.0]),
    )
    assert cause_words(causes, surface_m) == [RIGHT_SURFACE, "double bounce", "side lobe", ""]
    assert cause_words(causes)[0] == "double bounce"


def test_ghosts_whose_points_lie_on_a_true_surface_are_told_from_others() -> None:
    n = 5
    columns = {one.name: np.full(n, 0.0).astype(one.metadata["dtype"]) for one in fields(ContourScores)}
    table = ContourScores(
        **columns | {
            "is_ghost": np.array([True, True, True, False, True]),
            "is_phantom": np.array([False, False, False, False, True]),
            "cause": np.array(["side_lobe", "double_bounce", "", "", "double_bounce"]),
            "surface_m": np.array([0.02, 3.0, np.nan, 0.0, 0.02]),
        }
    )  # fmt: skip
    assert table.is_right_surface.tolist() == [True, False, False, False, False]
    assert ghost_words(table)[:3] == [RIGHT_SURFACE, "ghost (double bounce)", "ghost"]
    assert ghost_words(table)[4] == "ghost (double bounce)"
