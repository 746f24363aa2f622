"""Alternation between the association of paths to landmarks and least squares for the trajectory."""

from dataclasses import replace

import numpy as np
from scipy.stats import chi2

from estimation.slam.config import TrajectoryConfig
from estimation.slam.snapshot.refine import bounce_terms
from estimation.slam.walk.association import classify_paths, drop_unused_landmarks, reclassify_paths
from estimation.slam.walk.residuals import (
    Association,
    Observations,
    PathClass,
    TrajectoryState,
    without_heading_offsets,
)
from estimation.slam.walk.sessions import split_sessions
from estimation.slam.walk.smoother import minimise_robust_cost, normal_equations
from scenes.record import BoolArray

_ROUGH_ITERATIONS = 6  # enough where the association will change
_MAX_ROUNDS = 10


def smooth_walk(
    seen: Observations, is_los: BoolArray, start: TrajectoryState, config: TrajectoryConfig
) -> tuple[TrajectoryState, Association]:
    """Motion prior alone, then with landmarks, then with sessions, each until the association is constant."""
    now, _ = _alternate(seen, is_los, start, config.model_copy(update={"use_landmarks": False}))
    now, link = _alternate(seen, is_los, now, config)
    now, link = _confirm_bounces(seen, link, now, config)
    while config.use_sessions:
        split = split_sessions(seen, link, now, config)
        if len(split.offset_rad) == len(now.offset_rad):
            break
        now, link = _alternate(seen, is_los, split, config)
        now, link = _confirm_bounces(seen, link, now, config)
    return now, link


def _confirm_bounces(
    seen: Observations, link: Association, now: TrajectoryState, config: TrajectoryConfig
) -> tuple[TrajectoryState, Association]:
    """Keep a single bounce without a landmark only where the other paths of its stop do not contradict it.

    Lines of sight and shared landmarks are far more certain. Where a stop has two of them, its other bounces are
    gated against the solution without these bounces, with its covariance.
    """
    certain = np.isin(link.kind, [PathClass.LOS, PathClass.WALL, PathClass.OBJECT])
    counted = np.bincount(seen.row[certain], minlength=seen.n_stops) >= 2
    doubted = np.flatnonzero((link.kind == PathClass.BOUNCE) & counted[seen.row])
    kind = link.kind.copy()
    kind[doubted] = PathClass.UNUSED
    without = replace(link, kind=kind)
    alone = minimise_robust_cost(seen, without, now, config)
    covariance, _ = normal_equations(seen, without, alone, config).covariance()
    row = seen.row[doubted]
    terms = bounce_terms(
        seen.tx, without_heading_offsets(seen, alone, doubted), seen.covariance[doubted], alone.state[row]
    )
    spread = np.einsum("pi,pij,pj->p", terms.jacobian, covariance[row], terms.jacobian)
    gate = chi2.ppf(config.confirm_probability, 1)
    agrees = terms.is_feasible & (terms.value_m**2 <= gate * (terms.variance_m2 + spread))
    kind[doubted[agrees]] = PathClass.BOUNCE
    return minimise_robust_cost(seen, replace(link, kind=kind), alone, config), replace(link, kind=kind)


def _alternate(
    seen: Observations, is_los: BoolArray, now: TrajectoryState, config: TrajectoryConfig
) -> tuple[TrajectoryState, Association]:
    """Alternate association and least squares until the association is constant.

    First landmarks are found from clusters in every round. Then paths are assigned to the estimated landmarks,
    which are more accurate than the clusters they come from.
    """
    link, now, spans = classify_paths(seen, now, is_los, config)
    for _ in range(_MAX_ROUNDS):
        now = minimise_robust_cost(seen, link, now, config, _ROUGH_ITERATIONS)
        before = link
        link, now, spans = classify_paths(seen, now, is_los, config)
        if _same(link, before):
            break
    for _ in range(_MAX_ROUNDS):
        now = minimise_robust_cost(seen, link, now, config, _ROUGH_ITERATIONS)
        before = link
        link = reclassify_paths(seen, now, is_los, spans, config)
        if _same(link, before):
            break
    return drop_unused_landmarks(minimise_robust_cost(seen, link, now, config), link)


def _same(link: Association, other: Association) -> bool:
    return np.array_equal(link.kind, other.kind) and np.array_equal(link.landmark, other.landmark)
