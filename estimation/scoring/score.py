"""Scores of a whole campaign: truths streamed once, tables small enough to keep."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import astuple, dataclass, fields

import numpy as np

from estimation.results import CampaignResults, MapResult
from estimation.scoring.channel_scores import channel_metrics, score_stop
from estimation.scoring.config import ScoringConfig, Significance
from estimation.scoring.map_scores import close_counts, find_clusters, is_ghost, map_metrics, score_ips
from estimation.scoring.metric import Metric
from estimation.scoring.pose_scores import pose_metrics, score_poses
from estimation.scoring.provenance import cluster_origin
from estimation.scoring.record import (
    ClusterScores,
    IpScores,
    MapScores,
    PathKind,
    PathScores,
    PoseScores,
    ScoreTables,
    SignificantPaths,
    StopScores,
)
from estimation.scoring.shape_scores import ShapeErrors, shape_errors, shape_metrics
from scenes.pose import Pose
from scenes.record import FloatArray, concatenate
from scenes.scene import Scene
from sim.truth import Truth


@dataclass(frozen=True)
class Scores:
    """All metrics of a campaign, and the tables they were drawn from."""

    metrics: tuple[Metric, ...]
    tables: ScoreTables

    def value(self, key: str) -> float:
        """Value of one metric; `KeyError` where there is none of that key."""
        for metric in self.metrics:
            if metric.key == key:
                return metric.value
        raise KeyError(key)


def score_campaign(
    scene: Scene,
    truths: Iterable[Truth],
    results: CampaignResults,
    *,
    true_power_dbm: Callable[[Truth], FloatArray],
    significance: Significance,
    config: ScoringConfig | None = None,
) -> Scores:
    """Score every stage of a campaign against the truth.

    `truths` is read once, one stop at a time. `true_power_dbm` gives the received power (path,) in dBm of the true
    paths of a stop in their best beam pairs.

    Raises
    ------
    ValueError
        Where a stop has a truth but no estimate or the other way round, or no stop is given at all.
    """
    config = config or ScoringConfig()
    paths, significant, stops, poses = _score_stops(
        scene, truths, results, true_power_dbm, significance, config
    )
    tables = ScoreTables(
        paths=paths,
        significant=significant,
        stops=stops,
        poses=poses,
        mapping=score_map(scene, results.mapping, paths, significant, config),
        slam=score_map(scene, results.slam, paths, significant, config),
    )
    return Scores(score_metrics(scene, tables), tables)


def score_metrics(scene: Scene, tables: ScoreTables) -> tuple[Metric, ...]:
    """All metrics of a campaign, always the same keys for the same scene."""
    metrics = channel_metrics(tables.stops, tables.paths, tables.significant)
    metrics += pose_metrics(tables.poses)
    for name, one_map in (("mapping", tables.mapping), ("slam", tables.slam)):
        metrics += map_metrics(name, scene, one_map.ips, one_map.clusters)
        metrics += shape_metrics(name, scene, one_map.clusters)
    return tuple(metrics)


def _score_stops(
    scene: Scene,
    truths: Iterable[Truth],
    results: CampaignResults,
    true_power_dbm: Callable[[Truth], FloatArray],
    significance: Significance,
    config: ScoringConfig,
) -> tuple[PathScores, SignificantPaths, StopScores, PoseScores]:
    estimates = {estimate.stop: estimate for estimate in results.channel}
    stops: list[int] = []
    poses: list[Pose] = []
    biases_s: list[float] = []
    path_parts: list[PathScores] = []
    true_parts: list[SignificantPaths] = []
    stop_parts: list[StopScores] = []
    for truth in truths:
        if truth.stop not in estimates:
            raise ValueError(f"results.channel: stop {truth.stop} has a truth but no channel estimate")
        paths, significant, stop = score_stop(
            truth, estimates[truth.stop], scene.tx, true_power_dbm(truth), significance, config
        )
        path_parts.append(paths)
        true_parts.append(significant)
        stop_parts.append(stop)
        stops.append(truth.stop)
        poses.append(truth.rx_pose)
        biases_s.append(truth.clock_bias_s)
    unscored = sorted(set(estimates) - set(stops))
    if unscored or not stops:
        raise ValueError(f"truths: no truth for stop {unscored[0]}" if unscored else "truths: no stop given")
    significant = concatenate(true_parts, "true_path")
    has_los = np.isin(stops, significant.stop[significant.kind == PathKind.LOS])
    pose_scores = score_poses(np.array(stops), poses, np.array(biases_s), has_los, results.slam.poses)
    return concatenate(path_parts, "estimate"), significant, concatenate(stop_parts, "stop"), pose_scores


def score_map(
    scene: Scene, result: MapResult, paths: PathScores, significant: SignificantPaths, config: ScoringConfig
) -> MapScores:
    """Tables of one map: its incidence points and its clusters."""
    ips = score_ips(scene, result, paths)
    return MapScores(ips, _score_clusters(scene, result, ips, significant, config))


def _score_clusters(
    scene: Scene, result: MapResult, ips: IpScores, significant: SignificantPaths, config: ScoringConfig
) -> ClusterScores:
    n_clusters = len(result.shapes.center_m)
    origin = cluster_origin(ips.label, ips.object, n_clusters, config.found_share)
    n_close = close_counts(scene, result, ips, origin, config.found_distance_m)
    errors = []
    for cluster, name in enumerate(origin.object):
        if name not in scene.object_names:
            errors.append(ShapeErrors())
            continue
        members_m = result.ips.position_m[ips.label == cluster]
        lit_m = significant.vertex_m[significant.object == name]
        contour = scene.object(str(name)).contour
        errors.append(shape_errors(result.shapes, cluster, members_m, contour, lit_m, config))
    columns = np.array([astuple(error) for error in errors]).reshape(-1, len(fields(ShapeErrors))).T
    return ClusterScores(
        object=origin.object,
        purity=origin.purity,
        n_ips=np.bincount(ips.label[ips.label >= 0], minlength=n_clusters),
        n_close=n_close,
        is_found=find_clusters(origin, n_close, config),
        is_ghost=is_ghost(ips, n_clusters),
        **{field.name: column for field, column in zip(fields(ShapeErrors), columns, strict=True)},
    )
