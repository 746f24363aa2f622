"""Scores of a whole campaign. It reads the truths once, stop by stop, and keeps only small tables."""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from itertools import groupby

import numpy as np
import shapely

from estimation.channel.record import ChannelEstimate
from estimation.tracks.config import TrackConfig
from isac_arena.campaign.results import CampaignResults, MapResult
from isac_arena.scoring.config import DEFAULT_GATE, Gate, Significance
from isac_arena.scoring.link_view import LinkView
from isac_arena.scoring.metrics.metric import Metric
from isac_arena.scoring.record import (
    IpScores,
    MapScores,
    OutlineScores,
    PathKind,
    PathScores,
    PoseScores,
    ScoreTables,
    SignificantPaths,
    StopScores,
)
from isac_arena.scoring.score import Scores
from isac_arena.scoring.stages.channel import score_stop
from isac_arena.scoring.stages.channel_metrics import channel_metrics
from isac_arena.scoring.stages.contours import contour_metrics, score_contours
from isac_arena.scoring.stages.maps import map_metrics, score_ips
from isac_arena.scoring.stages.outlines import outline_columns, visible_metrics
from isac_arena.scoring.stages.poses import pose_bounds, pose_metrics, published_metrics, score_both_poses
from isac_arena.scoring.stages.scene import scene_metrics, score_scene
from isac_arena.scoring.stages.shapes import ShapeErrors, contour_points_m, shape_errors, shape_metrics
from isac_arena.scoring.stages.tracks import objects_in_view, score_tracks, track_metrics
from isac_arena.scoring.true_stop import TrueStop, significant_alone, true_stop
from scenes.record import FloatArray, concatenate, empty_record
from scenes.scene import Scene, SceneObject
from sim.truth import Truth


def score_campaign(
    scene: Scene,
    truths: Iterable[Truth],
    results: CampaignResults,
    *,
    true_power_dbm: Callable[[Truth], FloatArray],
    significance: Significance,
    view: LinkView | None = None,
    gate: Gate = DEFAULT_GATE,
) -> Scores:
    """Score every stage of a campaign against the truth.

    `truths` is read once, one stop at a time. `true_power_dbm` gives the received power (path,) in dBm of the true
    paths of a stop in their best beam pairs. Without a `view` of the link, causes that need the beams are not
    tested, and bounds are NaN.

    Raises `ValueError` where a stop has a truth but no estimate, an estimate but no truth, or where there is no
    stop.
    """
    prepared = (true_stop(truth, scene.tx, true_power_dbm(truth), significance, view) for truth in truths)
    return score_stops(scene, prepared, results, gate)


def score_stops(
    scene: Scene,
    stops: Iterable[TrueStop],
    results: CampaignResults,
    gate: Gate = DEFAULT_GATE,
    motion: TrackConfig | None = None,
) -> Scores:
    """As `score_campaign`, of truths that are prepared; of several TX at a stop one after the other.

    `motion` are the settings of the tracks, whose motion model is part of the bound of velocities.
    """
    in_view: dict[int, set[str]] = {}
    tables, bare = _score_stops(_noting_views(stops, in_view), results.channel, gate)
    poses, published = _score_poses(scene, bare, tables, results.slam)
    tables = replace(
        tables,
        poses=poses,
        published=published,
        mapping=score_map(scene, results.mapping, tables.paths, tables.significant),
        slam=score_map(scene, results.slam, tables.paths, tables.significant),
        tracks=score_tracks(scene, results.slam, results.channel, in_view, motion or TrackConfig()),
    )
    return Scores(score_metrics(scene, tables), tables)


def score_channel(
    scene: Scene,
    truths: Iterable[Truth],
    channel: Iterable[ChannelEstimate],
    *,
    true_power_dbm: Callable[[Truth], FloatArray],
    significance: Significance,
    view: LinkView | None = None,
    gate: Gate = DEFAULT_GATE,
) -> Scores:
    """The scores of the channel estimates alone; tables of the later stages are empty.

    Arguments and errors as in `score_campaign`.
    """
    prepared = (true_stop(truth, scene.tx, true_power_dbm(truth), significance, view) for truth in truths)
    return channel_scores_of(prepared, channel, gate)


def channel_scores_of(
    stops: Iterable[TrueStop], channel: Iterable[ChannelEstimate], gate: Gate = DEFAULT_GATE
) -> Scores:
    """As `score_channel`, of truths that are prepared."""
    tables, _ = _score_stops(stops, channel, gate)
    return Scores(tuple(channel_metrics(tables.stops, tables.paths, tables.significant)), tables)


def score_metrics(scene: Scene, tables: ScoreTables) -> tuple[Metric, ...]:
    """All metrics of a campaign, with the same keys for the same scene."""
    metrics = channel_metrics(tables.stops, tables.paths, tables.significant)
    metrics += pose_metrics(tables.poses)
    metrics += published_metrics(tables.published)
    metrics += visible_metrics(scene, tables.significant)
    for name, one_map in (("mapping", tables.mapping), ("slam", tables.slam)):
        metrics += map_metrics(name, scene, one_map.ips, one_map.clusters)
        metrics += shape_metrics(name, scene, one_map.clusters)
        metrics += contour_metrics(name, scene, one_map.contours)
        metrics += scene_metrics(name, one_map.scene)
    metrics += track_metrics(tables.tracks)
    return tuple(metrics)


def _score_stops(
    stops: Iterable[TrueStop], channel: Iterable[ChannelEstimate], gate: Gate
) -> tuple[ScoreTables, list[TrueStop]]:
    """Tables of the channel estimates, the others empty, and the stops with their significant paths only."""
    estimates = {estimate.stop: estimate for estimate in channel}
    parts: list[tuple[PathScores, SignificantPaths, StopScores]] = []
    bare: list[TrueStop] = []  # with significant paths only, to save memory
    for stop in stops:
        index = stop.truth.stop
        if index not in estimates:
            raise ValueError(f"results.channel: stop {index} has a truth but no channel estimate")
        parts.append(_score_link(stop, estimates[index], gate))
        bare.append(significant_alone(stop))
    scored = {stop.truth.stop for stop in bare}
    unscored = sorted(set(estimates) - scored)
    if unscored or not scored:
        raise ValueError(f"truths: no truth for stop {unscored[0]}" if unscored else "truths: no stop given")
    paths, true_paths, sets = zip(*parts, strict=True)
    tables = replace(
        empty_record(ScoreTables),
        paths=concatenate(paths, "estimate"),
        significant=concatenate(true_paths, "true_path"),
        stops=concatenate(sets, "stop"),
    )
    return tables, bare


def _noting_views(stops: Iterable[TrueStop], in_view: dict[int, set[str]]) -> Iterator[TrueStop]:
    """The same stops; notes which objects are in view of each."""
    for stop in stops:
        in_view.setdefault(stop.truth.stop, set()).update(objects_in_view(stop))
        yield stop


def _score_link(
    stop: TrueStop, estimate: ChannelEstimate, gate: Gate
) -> tuple[PathScores, SignificantPaths, StopScores]:
    """Tables of the paths of one TX at a stop; paths are counted over all TX."""
    own = np.flatnonzero(estimate.tx == stop.truth.tx)
    if len(own) == len(estimate) and not stop.truth.tx:
        return score_stop(stop, estimate, gate)
    paths, true_paths, sets = score_stop(stop, estimate.take("path", own), gate)
    paths = replace(paths, path=own[paths.path], tx=np.full(len(own), stop.truth.tx))
    true_paths = replace(true_paths, tx=np.full(len(true_paths.stop), stop.truth.tx))
    return paths, true_paths, replace(sets, tx=np.full(1, stop.truth.tx))


def _score_poses(
    scene: Scene, stops: list[TrueStop], tables: ScoreTables, slam: MapResult
) -> tuple[PoseScores, PoseScores]:
    significant = tables.significant
    links = [list(group) for _, group in groupby(stops, key=lambda stop: stop.truth.stop)]
    scored = np.array([each[0].truth.stop for each in links])
    return score_both_poses(
        slam,
        stop=scored,
        tx={each[0].truth.stop: each[0].truth.tx for each in links},
        true_pose=[each[0].truth.stop_pose for each in links],
        true_clock_bias_s=np.array([each[0].truth.clock_bias_s for each in links]),
        has_los=np.isin(scored, significant.stop[significant.kind == PathKind.LOS]),
        bound=pose_bounds(scene, links),
    )


def score_map(scene: Scene, result: MapResult, paths: PathScores, significant: SignificantPaths) -> MapScores:
    """Tables of one map: its incidence points, its clusters, its contours and the scene as a whole."""
    ips = score_ips(scene, result, paths)
    clusters = _score_clusters(scene, result, ips, significant)
    contours = score_contours(scene, result, ips, significant)
    return MapScores(ips, clusters, contours, score_scene(scene, result, clusters, contours, significant))


def _score_clusters(
    scene: Scene, result: MapResult, ips: IpScores, significant: SignificantPaths
) -> OutlineScores:
    def error_of(cluster: int, item: SceneObject, members_m: FloatArray, lit_m: FloatArray) -> ShapeErrors:
        return shape_errors(result.shapes, cluster, members_m, item.contour, lit_m)

    def line_of(cluster: int) -> shapely.Geometry:
        return shapely.LinearRing(contour_points_m(result.shapes, cluster))

    n_clusters = len(result.shapes.center_m)
    return OutlineScores(**outline_columns(scene, result, ips, n_clusters, significant, error_of, line_of))
