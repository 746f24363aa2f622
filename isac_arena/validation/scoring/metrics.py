"""`arena validate scoring`: every metric against closed forms and brute force, and its monotonicity."""

from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise, permutations

import numpy as np
from scipy.integrate import quad
from scipy.stats import norm

from estimation.shape.reflection.rows import no_contours
from estimation.slam.record import SolveStatus
from isac_arena.campaign.results import CampaignResults, MapResult
from isac_arena.scoring.association import assign
from isac_arena.scoring.chain import score_campaign
from isac_arena.scoring.config import Gate, Significance
from isac_arena.scoring.metrics import contours
from isac_arena.scoring.metrics.consistency import gaussian_crps, normalised_nees, region_coverage
from isac_arena.scoring.metrics.metric import Metric
from isac_arena.scoring.metrics.sets import gospa, ospa
from isac_arena.scoring.metrics.trajectories import absolute_errors, relative_errors
from isac_arena.validation.measurement import Measurement, at_most
from isac_arena.validation.scenarios.estimates import moved_poses, shift_estimate
from isac_arena.validation.scenarios.perfect_campaign import MadeCampaign, made_view, make_campaign, power_dbm
from scenes.record import FloatArray, IntArray

LIMITS = Significance(dynamic_range_db=28.0, noise_threshold_dbm=-150.0)
ANGLE = np.linspace(-np.pi, np.pi, 3600, endpoint=False)
UNIT = np.stack([np.cos(ANGLE), np.sin(ANGLE)], axis=-1)
WHOLE = {"channel.detection_rate", "channel.los.decision_accuracy", "slam.solved_share"}  # 1 for the perfect


def check_closed_forms(seed: int, quick: bool) -> list[Measurement]:
    """Outlines, trajectories and consistency where the answer is known."""
    shift, ratio = 0.7, 1.3
    lens = 2 * np.arccos(shift / 2) - shift / 2 * np.sqrt(4 - shift**2)
    beside, around = UNIT + np.array([shift, 0.0]), ratio * UNIT
    concentric = contours.outline_distances(UNIT, around)
    wall = np.outer(np.linspace(-2, 3, 50), [0.6, 0.8])
    lit, aside = np.outer(np.linspace(0, 4, 50), [0.6, 0.8]), wall + np.array([-0.8, 0.6])
    return [
        _error("iou.circles", contours.intersection_over_union(UNIT, beside) - lens / (2 * np.pi - lens), 1e-5),
        _error("hausdorff.circles", contours.hausdorff_m(*contours.outline_distances(UNIT, beside)) - shift, 1e-5),
        _error("modified_hausdorff.circles", contours.modified_hausdorff_m(*concentric) - (ratio - 1), 1e-5),
        _error("chamfer.circles", contours.chamfer_m(*concentric) - (ratio - 1), 1e-5),
        _error("perpendicular_rmse.wall", contours.perpendicular_rmse_m(aside, *wall[[0, -1]]) - 1, 1e-12),
        _error("extent_iou.wall", contours.extent_iou(wall, lit) - 3 / 6, 1e-12),
        *_trajectory_rows(np.random.default_rng(seed)),
        *_consistency_rows(np.random.default_rng(seed), 20_000 if quick else 400_000),
    ]


def check_assignments(seed: int, quick: bool) -> list[Measurement]:
    """OSPA, GOSPA, the scene's GOSPA and the path assignment against all assignments one by one."""
    rng = np.random.default_rng(seed)
    worst = dict.fromkeys(("ospa", "gospa", "scene_gospa", "path_assignment"), 0.0)
    for _ in range(60 if quick else 600):
        n, m = rng.integers(0, 5, 2)
        cutoff, order = float(rng.uniform(0.2, 3)), float(rng.choice([1.0, 2.0]))
        distance = np.abs(rng.normal(0, 1, (n, m)))
        base = _cheapest(np.minimum(distance, cutoff) ** order)
        extra = cutoff**order * abs(n - m)
        expected = ((base + extra) / max(n, m)) ** (1 / order) if max(n, m) else 0.0
        _keep(worst, "ospa", ospa(distance, cutoff, order) - expected)
        _keep(worst, "gospa", gospa(distance, cutoff, order).value - (base + extra / 2) ** (1 / order))
        _keep(worst, "path_assignment", _assignment_excess(rng, n, m))
    for _ in range(3 if quick else 20):
        n, m = rng.integers(0, 4, 2)
        ours, truths = (rng.uniform(0, 3, (k, 1, 2)) + UNIT[::60] for k in (n, m))
        loss = np.array([[1 - contours.intersection_over_union(a, b) for b in truths] for a in ours]).reshape(n, m)
        expected = np.sqrt(_cheapest(loss**2) + abs(n - m) / 2)
        _keep(worst, "scene_gospa", contours.scene_gospa(ours, truths).value - expected)
    return [_error(f"brute_force.{name}", value, 1e-9) for name, value in worst.items()]


def check_perfect_and_empty(seed: int, quick: bool) -> list[Measurement]:
    """A perfect estimator has no error and misses nothing; an empty one finds nothing."""
    del seed, quick
    made = make_campaign()
    perfect, empty = _scores(made, made.results), _scores(made, _emptied(made.results))
    ours, contour = perfect.values(), [metric for metric in perfect.values() if _is_contour(metric.key)]
    finite = [one for one in ours if one.direction == "lower" and np.isfinite(one.value)]
    errors = [abs(metric.value) for metric in finite if not _is_contour(metric.key)]
    pillar = [one for one in contour if one.unit == "m" and "pillar" in one.key and "crps" not in one.key]
    scenes = [metric.value for metric in ours if metric.key.endswith("scene_gospa")]
    shares = [abs(perfect[key].value - 1) for key in WHOLE]
    lit = np.sqrt(sum(item.contour.closed for item in made.scene.objects) / 2)
    unseen = [abs(metric.value - lit) for metric in empty.values() if metric.key.endswith("scene_gospa")]
    pillars = [perfect[f"shapes.{name}.pillar.iou.mean"].value for name in ("mapping", "slam")]
    missed = empty["channel.missed_per_stop"].value - empty["channel.significant_per_stop"].value
    nothing = ("channel.detection_rate", "slam.solved_share", "slam.objects_found")
    worst = np.sqrt(empty["channel.significant_per_stop"].value / 2)
    return [
        _error("perfect.largest_error", max(errors), 1e-6),
        _error("perfect.shares", max(shares), 0.0),
        _error("perfect.pillar_iou", 1 - min(pillars), 1e-3),
        _error("perfect.pillar_outlines", max(one.value for one in pillar), 1e-3),
        _error("perfect.scene_gospa", max(scenes), 2e-3),
        _error("empty.missed", missed, 0.0),
        _error("empty.found", max(empty[key].value for key in nothing), 0.0),
        _error("empty.gospa", empty["channel.gospa.mean"].value - worst, 1e-9),
        _error("empty.scene_gospa", max(unseen), 1e-12),
    ]


def check_monotone(seed: int, quick: bool) -> list[Measurement]:
    """No metric improves when the estimates are moved away from the truth.

    The shapes of walls do not count: the campaign has closed contours about the middle of a wall in their place.
    """
    del seed
    made = make_campaign()
    steps = np.linspace(0, 0.9, 4 if quick else 10)
    previous = _scores(made, made.results)
    keys = [key for key in previous if not (key.startswith("shapes.") and ".wall" in key)]
    improved = 0
    for step in steps[1:]:
        current = _scores(made, _moved(made.results, step))
        improved += sum(_is_better(current[key], previous[key]) for key in keys)
        previous = current
    sets = [_set_distances(step) for step in steps]
    improved += sum(b < a - 1e-12 for one, two in pairwise(sets) for a, b in zip(one, two, strict=True))
    reason = "count of metrics better after a move away from the truth"
    return [at_most("scoring.monotone.improved", improved, 0, reason)]


def _trajectory_rows(rng: np.random.Generator) -> Iterator[Measurement]:
    truth, heading = np.cumsum(rng.normal(0, 1, (30, 2)), axis=0), rng.uniform(-3, 3, 30)
    c, s = np.cos(0.4), np.sin(0.4)
    moved, turned = truth @ np.array([[c, s], [-s, c]]) + np.array([3.0, -1.0]), heading + 0.4
    ape_m, ape_rad = absolute_errors(moved, turned, truth, heading, align=True)
    rpe_m, rpe_rad = relative_errors(moved, turned, truth, heading, delta=2)
    shifted_m, _ = absolute_errors(truth + np.array([0.3, 0.4]), heading, truth, heading, align=False)
    yield _error("ape.rigid_motion", max(np.abs(ape_m).max(), np.abs(ape_rad).max()), 1e-9)
    yield _error("rpe.rigid_motion", max(np.abs(rpe_m).max(), np.abs(rpe_rad).max()), 1e-9)
    yield _error("ape.shift", np.abs(shifted_m - 0.5).max(), 1e-12)


def _consistency_rows(rng: np.random.Generator, count: int) -> Iterator[Measurement]:
    shape = rng.normal(0, 1, (3, 3))
    covariance = shape @ shape.T + np.eye(3)
    errors = rng.multivariate_normal(np.zeros(3), covariance, count)
    tiled = np.broadcast_to(covariance, (count, 3, 3))
    nees, covered = normalised_nees(errors, tiled), region_coverage(errors, tiled)
    deviation = 4 / np.sqrt(count)
    yield _error("nees.gaussian", nees.value - 1, deviation)
    yield _error("coverage.gaussian", covered.value - 0.95, deviation)
    truth, mean, std = 0.8, 0.1, 0.6
    below = quad(lambda x: norm.cdf(x, mean, std) ** 2, -12, truth, limit=200)[0]
    above = quad(lambda x: norm.sf(x, mean, std) ** 2, truth, 12, limit=200)[0]
    found = float(gaussian_crps(np.array(truth), np.array(mean), np.array(std)))
    yield _error("crps.integral", found - below - above, 1e-7)


def _cheapest(cost: FloatArray) -> float:
    """Least sum over all one-to-one assignments of the smaller side, each tried."""
    if cost.shape[0] > cost.shape[1]:
        cost = cost.T
    rows = np.arange(cost.shape[0])
    every = permutations(range(cost.shape[1]), len(rows))
    return float(min(cost[rows, list(chosen)].sum() for chosen in every))


def _assignment_excess(rng: np.random.Generator, n: int, m: int) -> float:
    """Cost of the path assignment above the best of all."""
    gate = Gate()
    estimate, truth = (rng.normal(0, 1, (k, 3)) * gate.half_width for k in (n, m))
    error = (estimate[:, None] - truth[None]) / gate.half_width
    cost = np.where((np.abs(error) <= 1).all(axis=2), np.linalg.norm(error, axis=2), np.sqrt(3.0))
    found: IntArray = assign(estimate, truth, gate.half_width)
    paired = np.flatnonzero(found >= 0)
    unpaired = min(n, m) - len(paired)
    return float(cost[paired, found[paired]].sum() + np.sqrt(3.0) * unpaired - _cheapest(cost))


def _keep(worst: dict[str, float], name: str, error: float) -> None:
    worst[name] = max(worst[name], abs(error))


def _error(key: str, error: float, bar: float) -> Measurement:
    return at_most(f"scoring.{key}", abs(float(error)), bar, "distance from the known value")


def _scores(made: MadeCampaign, results: CampaignResults) -> dict[str, Metric]:
    found = score_campaign(
        made.scene, iter(made.truths), results, true_power_dbm=power_dbm, significance=LIMITS, view=made_view(),
    )  # fmt: skip
    return {metric.key: metric for metric in found.metrics}


def _emptied(results: CampaignResults) -> CampaignResults:
    def nothing(result: MapResult) -> MapResult:
        shapes = result.shapes.take("ip", slice(0, 0)).take("cluster", slice(0, 0))
        poses = replace(result.poses, status=np.full(len(result.poses.stop), SolveStatus.FAILED))
        return MapResult(poses, result.ips.take("ip", slice(0, 0)), shapes, no_contours(0, len(poses.stop)))

    silent = tuple(estimate.take("path", slice(0, 0)) for estimate in results.channel)
    return replace(results, channel=silent, mapping=nothing(results.mapping), slam=nothing(results.slam))


def _moved(results: CampaignResults, share: float) -> CampaignResults:
    """All estimates moved away by a share of the gate, or of 1 m and 10 deg."""
    channel = tuple(shift_estimate(estimate, share * Gate().half_width) for estimate in results.channel)
    slam, mapping = _moved_map(results.slam, share), _moved_map(results.mapping, share)
    return replace(results, channel=channel, slam=slam, mapping=mapping)


def _moved_map(result: MapResult, share: float) -> MapResult:
    poses = moved_poses(result.poses, share * np.array([1.0, 0.0, np.deg2rad(10), 1e-9]))
    shapes = replace(result.shapes, radius_m=result.shapes.radius_m * (1 + share))
    outlines = replace(result.contours, contour_m=result.contours.contour_m + np.array([0.0, share]))
    return MapResult(poses, result.ips, shapes, outlines)


def _is_contour(key: str) -> bool:
    """Whether a metric is of contours, which are samples of the true ones at best; walls are lit in part."""
    return key.startswith(("shapes.", "contours."))


def _is_better(current: Metric, previous: Metric) -> bool:
    """Whether a score improved beyond rounding; a score that is not finite does not count."""
    if not np.isfinite([current.value, previous.value]).all():
        return False
    gain = {"higher": 1, "lower": -1}.get(current.direction, 0) * (current.value - previous.value)
    return bool(gain > 1e-9 + 1e-9 * abs(previous.value))


def _set_distances(step: float) -> list[float]:
    """Distances of two circles to two circles `step` away, by every set and outline metric."""
    truth = [UNIT[::20], UNIT[::20] + np.array([6.0, 0.0])]
    away = [outline + np.array([0.0, 3 * step]) for outline in truth]
    distance = np.abs(np.array([[0.0, 2.0], [2.0, 0.0]]) + step * np.eye(2))
    between = contours.outline_distances(away[0], truth[0])
    outlines = contours.hausdorff_m, contours.modified_hausdorff_m, contours.chamfer_m
    sets = ospa(distance, 0.8), gospa(distance, 0.8).value, contours.scene_gospa(away, truth).value
    return [*sets, *(measure(*between) for measure in outlines)]
