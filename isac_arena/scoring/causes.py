"""Why an estimated path is false, a true one missed, an incidence point or a cluster a ghost.

Each cause is a test on what is known of the stop; the first that holds, in the order written, is the name. What no
test explains is `unknown`. The definitions stand in docs/metrics.md.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from isac_arena.scoring.record import PathKind, PathStatus
from scenes.record import BoolArray, FloatArray, IntArray, TextArray

WEAK_MARGIN_DB = (
    6.0  # true energy explains an estimate up to 6 dB stronger: it may add up to twice the amplitude
)
NEAR_GATES = 2.0  # an estimate at most this many gates from a path is taken as an inaccurate estimate of it
THRESHOLD_MARGIN_DB = 3.0  # this close to a threshold the noise decides which side a path falls on
OUTSIDE_BEAMS_DB = 10.0  # no beam points to where the best gain is this far below the highest gain


class Cause(StrEnum):
    """Names of causes; NONE where nothing is wrong."""

    NONE = ""
    DUPLICATE = "duplicate"  # within the gate of a path that another estimate has
    MERGED = "merged"  # near several paths, one of them missed; of a miss: near another significant path
    INACCURATE = "inaccurate"  # of a missed path, but outside its gate; of a miss: there is such an estimate
    SIDE_LOBE = "side_lobe"  # beams or band leak so much of a true path there
    NOISE = "noise"  # hardly above the noise threshold
    WEAK = "weak"  # true energy that is not significant
    DIFFUSE = "diffuse"  # diffuse energy; of a miss: it lies under as much of it
    UNRESOLVED = "unresolved"  # within the gate of a detected path
    OUTSIDE_CODEBOOK = "outside_codebook"  # no beam of either end points there
    BELOW_THRESHOLD = "below_threshold"  # hardly above what counts as significant
    MASKED = "masked"  # under the side lobes of other paths
    PATH_LIMIT = "path_limit"  # the estimator reported as many paths as it may, all stronger
    REFUSED = "refused"  # the estimator gave no estimate of the stop
    DOUBLE_BOUNCE = "double_bounce"  # several bounces taken as one
    LINE_OF_SIGHT = "line_of_sight"  # the line of sight taken as a bounce
    REJECTED = "rejected"  # a true single bounce that the map leaves out
    UNKNOWN = "unknown"


FALSE_CAUSES = (
    Cause.DUPLICATE, Cause.MERGED, Cause.INACCURATE, Cause.SIDE_LOBE, Cause.NOISE, Cause.UNKNOWN,
)  # fmt: skip
MISS_CAUSES = (
    Cause.REFUSED, Cause.UNRESOLVED, Cause.INACCURATE, Cause.OUTSIDE_CODEBOOK, Cause.BELOW_THRESHOLD,
    Cause.MASKED, Cause.DIFFUSE, Cause.MERGED, Cause.PATH_LIMIT, Cause.UNKNOWN,
)  # fmt: skip
GHOST_CAUSES = (
    Cause.DOUBLE_BOUNCE, Cause.LINE_OF_SIGHT, Cause.WEAK, Cause.DIFFUSE, *FALSE_CAUSES,
)  # fmt: skip


@dataclass(frozen=True)
class Evidence:
    """What is known of one stop. Leaked powers and beam losses are NaN where nothing is known of the link.

    `distance` (estimate, true) is the largest of the three errors in units of the gate: 1 at its edge.
    """

    status: IntArray  # (estimate,) PathStatus
    distance: FloatArray  # (estimate, true) to the significant paths
    true_distance: FloatArray  # (true, true) between significant paths
    is_detected: BoolArray  # (true,)
    estimate_dbm: FloatArray  # (estimate,)
    true_dbm: FloatArray  # (true,)
    leaked_dbm: FloatArray  # (estimate, true) what a true path leaves in the cell of the estimate
    crosstalk_dbm: FloatArray  # (true, true) what the second leaves in the cell of the first
    beam_loss_db: FloatArray  # (true,) of the worse end, below the highest gain of its beams
    diffuse_dbm: FloatArray  # (true,) diffuse power inside the gate of the path
    noise_threshold_dbm: float
    significance_dbm: float  # weakest significant power at this stop
    is_limited: bool  # the estimator reported as many paths as it may
    is_refused: bool


def false_causes(evidence: Evidence) -> TextArray:
    """Cause (estimate,) of every false path; empty for the others."""
    inside = evidence.distance <= 1
    near = evidence.distance <= NEAR_GATES
    missed_near = near & ~evidence.is_detected
    outside_dbm = np.where(inside, -np.inf, evidence.leaked_dbm)
    tests = {
        Cause.DUPLICATE: inside.any(axis=1),
        Cause.MERGED: (near.sum(axis=1) >= 2) & missed_near.any(axis=1),
        Cause.INACCURATE: missed_near.any(axis=1),
        Cause.SIDE_LOBE: outside_dbm.max(axis=1, initial=-np.inf) >= evidence.estimate_dbm - WEAK_MARGIN_DB,
        Cause.NOISE: evidence.estimate_dbm <= evidence.noise_threshold_dbm + THRESHOLD_MARGIN_DB,
    }
    return _first(tests, evidence.status == PathStatus.FALSE)


def miss_causes(evidence: Evidence) -> TextArray:
    """Cause (true,) of every missed significant path; empty for the others."""
    missed, power = ~evidence.is_detected, evidence.true_dbm
    false = evidence.status == PathStatus.FALSE
    weakest_dbm = evidence.estimate_dbm.min(initial=np.inf)
    itself = np.eye(len(power), dtype=bool)
    others_dbm = np.where(itself, -np.inf, evidence.crosstalk_dbm)
    tests = {
        Cause.REFUSED: np.full(len(power), evidence.is_refused),
        Cause.UNRESOLVED: (evidence.true_distance[:, evidence.is_detected] <= 1).any(axis=1),
        Cause.INACCURATE: (evidence.distance[false] <= NEAR_GATES).any(axis=0),
        Cause.OUTSIDE_CODEBOOK: evidence.beam_loss_db >= OUTSIDE_BEAMS_DB,
        Cause.BELOW_THRESHOLD: power < evidence.significance_dbm + THRESHOLD_MARGIN_DB,
        Cause.MASKED: others_dbm.max(axis=1, initial=-np.inf) >= power - WEAK_MARGIN_DB,
        Cause.DIFFUSE: evidence.diffuse_dbm >= power,
        Cause.MERGED: (~itself & (evidence.true_distance <= NEAR_GATES)).any(axis=1),
        Cause.PATH_LIMIT: evidence.is_limited & (power < weakest_dbm),
    }
    return _first(tests, missed)


def weak_causes(status: IntArray, is_diffuse: BoolArray) -> TextArray:
    """Cause (estimate,) of the weak paths, by whether the true path behind them is diffuse."""
    found = np.where(is_diffuse, Cause.DIFFUSE.value, Cause.WEAK.value)
    return np.asarray(np.where(status == PathStatus.WEAK, found, Cause.NONE.value))


def point_causes(
    is_inlier: BoolArray, ip_object: TextArray, kind: IntArray, path_cause: TextArray
) -> TextArray:
    """Cause (ip,) of inliers that stem from no object, and of true single bounces that are no inliers.

    `kind` (ip,) is the PathKind of the true path and `path_cause` (ip,) the cause of the estimated one.
    """
    is_ghost = is_inlier & (ip_object == "")
    named = np.select(
        [kind == PathKind.MULTI_BOUNCE, kind == PathKind.LOS, path_cause != Cause.NONE],
        [Cause.DOUBLE_BOUNCE.value, Cause.LINE_OF_SIGHT.value, path_cause],
        Cause.UNKNOWN.value,
    )
    is_rejected = ~is_inlier & (ip_object != "")
    return np.select([is_ghost, is_rejected], [named, Cause.REJECTED.value], Cause.NONE.value)


def cluster_causes(
    label: IntArray, ip_object: TextArray, ip_cause: TextArray, is_ghost: BoolArray
) -> TextArray:
    """Cause (cluster,) of every ghost: the most frequent one of its points without object; else empty."""
    causes = np.full(len(is_ghost), Cause.NONE.value, dtype=object)
    for cluster in np.flatnonzero(is_ghost):
        names, counts = np.unique(ip_cause[(label == cluster) & (ip_object == "")], return_counts=True)
        causes[cluster] = names[counts.argmax()]
    return causes.astype(str)


def _first(tests: dict[Cause, BoolArray], applies: BoolArray) -> TextArray:
    """Name (row,) of the first test that holds where a cause is asked for."""
    named = np.select(list(tests.values()), [cause.value for cause in tests], Cause.UNKNOWN.value)
    return np.asarray(np.where(applies, named, Cause.NONE.value))
