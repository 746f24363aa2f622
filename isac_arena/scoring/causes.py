"""Causes of false paths, missed paths, ghost incidence points and ghost clusters.

Each cause is a test on the data of a stop. The first test that holds, in the order written, gives the cause; it is
`unknown` where no test holds. docs/metrics.md has the definitions.
"""

from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from isac_arena.scoring.metrics.statistics import rows_of_groups
from isac_arena.scoring.record import ON_SURFACE_M, OutlineScores, PathKind, PathStatus
from scenes.record import BoolArray, FloatArray, IntArray, TextArray

WEAK_MARGIN_DB = 6.0  # true energy explains an estimate up to 6 dB stronger: it may add up to twice the amplitude
NEAR_GATES = 2.0  # an estimate within this many gates of a path counts as an inaccurate estimate of it
THRESHOLD_MARGIN_DB = 3.0  # this close to a threshold, noise decides whether a path exceeds it
RIGHT_SURFACE = "right surface, wrong path"
LEVEL = ("floor", "ceiling")  # no plan shows in place what they scattered
PHANTOM = "phantom"  # a closed contour where no object stands
LEVEL_WORDS = "off floor or ceiling, in place only with elevations"
OUTSIDE_BEAMS_DB = 10.0  # no beam points to where the best gain is this far below the highest gain


class Cause(StrEnum):
    """Names of causes; NONE for a detected path or a correct point."""

    NONE = ""
    DUPLICATE = "duplicate"  # inside the gate of a path that is assigned to another estimate
    MERGED = "merged"  # false: near several paths, one of them missed; missed: near another significant path
    INACCURATE = "inaccurate"  # false: near a missed path, outside its gate; missed: a false path is near
    SIDE_LOBE = "side_lobe"  # side lobes of beams or band explain the power
    NOISE = "noise"  # close to the noise threshold
    WEAK = "weak"  # true energy that is not significant
    DIFFUSE = "diffuse"  # diffuse energy; missed: the diffuse power in its gate is at least its own
    INSEPARABLE = "inseparable"  # no estimator could tell it from its neighbours: counted apart
    UNRESOLVED = "unresolved"  # inside the gate of a detected path
    OUTSIDE_CODEBOOK = "outside_codebook"  # no beam of the TX or of the RX points there
    BELOW_THRESHOLD = "below_threshold"  # close to the threshold of significance
    MASKED = "masked"  # below the side lobes of other paths
    PATH_LIMIT = "path_limit"  # the estimator reported its largest number of paths, all of them stronger
    REFUSED = "refused"  # the estimator gave no estimate for the stop
    DOUBLE_BOUNCE = "double_bounce"  # several bounces taken as one
    LINE_OF_SIGHT = "line_of_sight"  # the line of sight taken as a bounce
    REJECTED = "rejected"  # a true single bounce that is not an inlier of the map
    UNKNOWN = "unknown"


FALSE_CAUSES = (
    Cause.DUPLICATE, Cause.MERGED, Cause.INACCURATE, Cause.SIDE_LOBE, Cause.NOISE, Cause.UNKNOWN,
)  # fmt: skip
MISS_CAUSES = (
    Cause.REFUSED, Cause.INSEPARABLE, Cause.UNRESOLVED, Cause.INACCURATE, Cause.OUTSIDE_CODEBOOK,
    Cause.BELOW_THRESHOLD, Cause.MASKED, Cause.DIFFUSE, Cause.MERGED, Cause.PATH_LIMIT, Cause.UNKNOWN,
)  # fmt: skip
GHOST_CAUSES = (
    Cause.DOUBLE_BOUNCE, Cause.LINE_OF_SIGHT, Cause.WEAK, Cause.DIFFUSE, *FALSE_CAUSES,
)  # fmt: skip


@dataclass(frozen=True)
class Evidence:
    """Data of one stop for the tests of causes. Leaked powers and beam losses are NaN without a view of the link.

    `distance` (estimate, true) is the largest of the errors in units of the gate: 1 at the edge of the gate.
    """

    status: IntArray  # (estimate,) PathStatus
    distance: FloatArray  # (estimate, true) to the significant paths
    true_distance: FloatArray  # (true, true) between significant paths
    is_detected: BoolArray  # (true,)
    is_separable: BoolArray  # (true,)
    estimate_dbm: FloatArray  # (estimate,)
    true_dbm: FloatArray  # (true,)
    leaked_dbm: FloatArray  # (estimate, true) power of a true path in the cell of the estimate
    crosstalk_dbm: FloatArray  # (true, true) power of the second path in the cell of the first
    beam_loss_db: FloatArray  # (true,) best gain below the highest gain of all beams, at the worse device
    diffuse_dbm: FloatArray  # (true,) diffuse power inside the gate of the path
    noise_threshold_dbm: float
    significance_dbm: float  # weakest significant power at this stop
    is_limited: bool  # the estimator reported its largest number of paths
    is_refused: bool


def false_causes(evidence: Evidence) -> TextArray:
    """Cause (estimate,) of every false path, empty for other paths."""
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
    """Cause (true,) of every missed significant path, empty for detected paths."""
    missed, power = ~evidence.is_detected, evidence.true_dbm
    false = evidence.status == PathStatus.FALSE
    weakest_dbm = evidence.estimate_dbm.min(initial=np.inf)
    itself = np.eye(len(power), dtype=bool)
    others_dbm = np.where(itself, -np.inf, evidence.crosstalk_dbm)
    tests = {
        Cause.REFUSED: np.full(len(power), evidence.is_refused),
        Cause.INSEPARABLE: ~evidence.is_separable,
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
    """Cause (estimate,) of every weak path: whether the true path that explains it is diffuse."""
    found = np.where(is_diffuse, Cause.DIFFUSE.value, Cause.WEAK.value)
    return np.asarray(np.where(status == PathStatus.WEAK, found, Cause.NONE.value))


def point_causes(is_inlier: BoolArray, ip_object: TextArray, kind: IntArray, path_cause: TextArray) -> TextArray:
    """Cause (ip,) of inliers without an object, and of true single bounces that are not inliers.

    `kind` (ip,) is the PathKind of the true path and `path_cause` (ip,) the cause of the estimated path.
    """
    is_ghost = is_inlier & (ip_object == "")
    named = np.select(
        [kind == PathKind.MULTI_BOUNCE, kind == PathKind.LOS, path_cause != Cause.NONE],
        [Cause.DOUBLE_BOUNCE.value, Cause.LINE_OF_SIGHT.value, path_cause],
        Cause.UNKNOWN.value,
    )
    is_rejected = ~is_inlier & (kind == PathKind.SINGLE_BOUNCE)
    return np.select([is_ghost, is_rejected], [named, Cause.REJECTED.value], Cause.NONE.value)


def cluster_causes(label: IntArray, ip_object: TextArray, ip_cause: TextArray, is_ghost: BoolArray) -> TextArray:
    """Cause (cluster,) of every ghost: the most frequent cause of its points without object; empty for others."""
    causes = np.full(len(is_ghost), Cause.NONE.value, dtype=object)
    members = rows_of_groups(label, len(is_ghost))
    for cluster in np.flatnonzero(is_ghost):
        rows = members[cluster]
        names, counts = np.unique(ip_cause[rows[ip_object[rows] == ""]], return_counts=True)
        causes[cluster] = names[counts.argmax()]
    return causes.astype(str)


def cause_words(cause: TextArray, surface_m: FloatArray | None = None) -> list[str]:
    """Causes (item,) in words; with distances to the nearest true surface, whether a double bounce lies on one."""
    surface = np.full(len(cause), np.inf) if surface_m is None else surface_m
    is_right = (cause == Cause.DOUBLE_BOUNCE) & (surface <= ON_SURFACE_M)
    return [
        RIGHT_SURFACE if right else str(one).replace("_", " ") for one, right in zip(cause, is_right, strict=True)
    ]


def ghost_words(table: OutlineScores) -> list[str]:
    """What each outline (outline,) is called if it is a ghost."""
    called = [f"ghost ({cause})" if cause else "ghost" for cause in cause_words(table.cause)]
    return [RIGHT_SURFACE if right else one for one, right in zip(called, table.is_right_surface, strict=True)]


def _first(tests: dict[Cause, BoolArray], applies: BoolArray) -> TextArray:
    """Name (row,) of the first test that holds, in the rows where `applies` is true."""
    named = np.select(list(tests.values()), [cause.value for cause in tests], Cause.UNKNOWN.value)
    return np.asarray(np.where(applies, named, Cause.NONE.value))
