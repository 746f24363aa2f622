"""Scores of a measured campaign: poses, maps and shapes; scores that need true paths are NaN."""

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from estimation.channel.record import ChannelEstimate
from isac_arena.campaign.measured import MeasuredTruth
from isac_arena.campaign.results import CampaignResults
from isac_arena.scoring.causes import Cause
from isac_arena.scoring.chain import score_map, score_metrics
from isac_arena.scoring.metrics.metric import Metric
from isac_arena.scoring.record import PathKind, PathScores, PathStatus, ScoreTables, SignificantPaths, StopScores
from isac_arena.scoring.score import Scores
from isac_arena.scoring.stages.channel import reported_angles
from isac_arena.scoring.stages.maps import FOUND_DISTANCE_M
from isac_arena.scoring.stages.poses import score_both_poses, unknown_bound
from scenes.record import FloatArray, TextArray, concatenate, empty_record
from scenes.scene import Scene

OF_LABELS = (".ghost", ".false", ".objects_found", ".cluster_purity", ".scene_gospa")  # in keys of metrics


def score_measured(scene: Scene, truths: Iterable[MeasuredTruth], results: CampaignResults) -> Scores:
    """Score maps, poses and shapes against the survey, the labels of the paths and the scene.

    A labelled single bounce stems from the object that is nearest to its labelled point, if that is within
    `FOUND_DISTANCE_M`.

    Raises `ValueError` where a stop has labels but no channel estimate of the same paths.
    """
    known = list(truths)
    estimates = {estimate.stop: estimate for estimate in results.channel}
    parts = [_label_scores(scene, truth, estimates.get(truth.stop)) for truth in known]
    if not parts:
        raise ValueError("truths: no stop given")
    paths, significant = concatenate(parts, "estimate"), empty_record(SignificantPaths)
    stops = np.array([truth.stop for truth in known])
    poses, published = score_both_poses(
        results.slam,
        stop=stops,
        true_pose=[truth.rx_pose for truth in known],
        true_clock_bias_s=np.array([truth.clock_bias_s for truth in known]),
        has_los=np.array([truth.is_los.any() for truth in known]),
        bound=unknown_bound(len(stops)),
    )
    tables = ScoreTables(
        paths=paths,
        significant=significant,
        stops=StopScores(stops, *np.full((4, len(stops)), np.nan)),
        poses=poses,
        published=published,
        mapping=score_map(scene, results.mapping, paths, significant),
        slam=score_map(scene, results.slam, paths, significant),
    )
    return Scores(measured_metrics(scene, tables), tables)


def measured_metrics(scene: Scene, tables: ScoreTables) -> tuple[Metric, ...]:
    """All metrics with the keys of a simulated campaign.

    Metrics of the channel need true paths and are NaN; so are those of objects that were found where no label
    tells which path came from which object.
    """
    unlabelled = not (tables.paths.object != "").any()
    return tuple(
        replace(one, value=np.nan) if _is_unknown(one.key, unlabelled=unlabelled) else one
        for one in score_metrics(scene, tables)
    )


def _is_unknown(key: str, *, unlabelled: bool) -> bool:
    if key.startswith("channel."):
        return key != "channel.estimated_per_stop"
    return unlabelled and any(part in key for part in OF_LABELS)


def nearest_objects(scene: Scene, points_m: FloatArray, reach_m: float) -> TextArray:
    """Name (point,) of the object whose boundary is nearest to each point (point, xy); empty beyond `reach_m`."""
    if not scene.fixtures:
        return np.full(len(points_m), "", dtype=str)
    distance = np.stack([np.abs(item.contour.signed_distance(points_m)) for item in scene.fixtures])
    nearest = np.array(scene.object_names)[distance.argmin(axis=0)]
    return np.asarray(np.where(distance.min(axis=0) <= reach_m, nearest, ""))


def unlabelled(truth: MeasuredTruth, n_paths: int) -> MeasuredTruth:
    """A stop whose paths were not labelled, with empty labels for so many paths."""
    none = np.zeros(n_paths, bool)
    return replace(truth, is_los=none, is_single_bounce=none, landmark_m=np.full((n_paths, 2), np.nan))


def _label_scores(scene: Scene, truth: MeasuredTruth, estimate: ChannelEstimate | None) -> PathScores:
    n = truth.size("path")
    if not n and estimate is not None:
        truth = unlabelled(truth, len(estimate))
        n = len(estimate)
    if estimate is None or len(estimate) != n:
        raise ValueError(f"results.channel: stop {truth.stop} has {n} labelled paths but no estimate of as many")
    single = truth.is_single_bounce
    name = np.full(n, "", dtype=object)
    known = single & np.isfinite(truth.landmark_m).all(axis=1)
    name[known] = nearest_objects(scene, truth.landmark_m[known], FOUND_DISTANCE_M)
    unknown = np.full(n, np.nan)
    return PathScores(
        stop=np.full(n, truth.stop),
        path=np.arange(n),
        status=np.where(truth.is_los | single, PathStatus.DETECTED, PathStatus.FALSE),
        cause=np.where(truth.is_los | single, Cause.NONE.value, Cause.UNKNOWN.value),
        is_los=estimate.is_los,
        true_path=np.full(n, -1),
        kind=np.select([truth.is_los, single], [PathKind.LOS, PathKind.SINGLE_BOUNCE], PathKind.NONE),
        object=name.astype(str),
        vertex_m=np.where(single[:, None], truth.landmark_m, np.nan),
        vertex_height_m=unknown,
        delay_error_s=unknown,
        aod_error_rad=unknown,
        aoa_error_rad=unknown,
        **reported_angles(estimate),
        power_error_db=unknown,
        nees=unknown,
    )
