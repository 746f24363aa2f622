"""Scores of the tracks of movers: which mover each follows, GOSPA over time, and velocities over their bound."""

from collections.abc import Collection, Mapping, Sequence

import numpy as np

from estimation.channel.record import ChannelEstimate
from estimation.tracks.bounds import velocity_bounds
from estimation.tracks.config import TrackConfig
from estimation.tracks.record import Tracks
from isac_arena.campaign.results import MapResult
from isac_arena.scoring.metrics.metric import Metric
from isac_arena.scoring.metrics.sets import gospa
from isac_arena.scoring.metrics.statistics import mean, ratio, rms
from isac_arena.scoring.record import TrackScores
from isac_arena.scoring.true_stop import TrueStop
from scenes.record import BoolArray, FloatArray, IntArray
from scenes.scene import Scene, SceneObject

CUTOFF_M = 1.0  # c of GOSPA; its order p is 2, alpha is 2


def score_tracks(
    scene: Scene,
    result: MapResult,
    channel: Sequence[ChannelEstimate],
    in_view: Mapping[int, Collection[str]],
    config: TrackConfig,
) -> TrackScores | None:
    """Every mover at every stop, with the track that follows it; None without tracks.

    `in_view` are the names of `objects_in_view` by stop. GOSPA assigns tracks to all movers; a track that follows
    one out of view is neither found nor false.
    """
    tracks = result.tracks
    if tracks is None:
        return None
    movers = [item for item in scene.objects if item.motion is not None]
    names, n_stops = np.array([item.name for item in movers], str), len(tracks.survey.stop)
    state = mover_states(movers, tracks.survey.time_s)
    seen = np.zeros((len(movers), n_stops), bool)
    for column, stop in enumerate(tracks.survey.stop.tolist()):
        seen[:, column] = np.isin(names, list(in_view.get(stop, ())))
    bound = velocity_bounds(channel, result.poses, tracks.survey, config, state)
    row, in_view_m, all_m, n_false = _assigned(tracks, state[..., [0, 2]], seen)
    shape = row.shape
    error = np.full((*shape, 2), np.nan)
    follows = row >= 0
    error[follows, 0] = np.linalg.norm(tracks.position_m[row[follows]] - state[follows][:, [0, 2]], axis=1)
    error[follows, 1] = np.linalg.norm(tracks.velocity_m_s[row[follows]] - state[follows][:, [1, 3]], axis=1)
    return TrackScores(
        mover=np.repeat(names, n_stops),
        mover_stop=np.tile(tracks.survey.stop, len(movers)),
        true_position_m=state[..., [0, 2]].reshape(-1, 2),
        true_velocity_m_s=state[..., [1, 3]].reshape(-1, 2),
        is_in_view=seen.ravel(),
        track=np.where(follows, tracks.track[row] if len(tracks.track) else -1, -1).ravel(),
        position_error_m=error[..., 0].ravel(),
        velocity_error_m_s=error[..., 1].ravel(),
        velocity_bound_m_s=bound.ravel(),
        stop=tracks.survey.stop,
        gospa_m=in_view_m,
        gospa_all_m=all_m,
        n_false=n_false,
    )


def objects_in_view(stop: TrueStop) -> set[str]:
    """Names of the objects that a path of one bounce meets whose best beam pair exceeds the noise threshold."""
    loud = stop.power_dbm >= stop.limits.noise_threshold_dbm
    return set(stop.origin.object[loud & ~stop.truth.paths.is_diffuse].tolist())


def mover_states(movers: Sequence[SceneObject], time_s: FloatArray) -> FloatArray:
    """States (mover, stop, 5) as `estimation.tracks.law` has them, of the middles of the movers."""
    states = np.zeros((len(movers), len(time_s), 5))
    for state, item in zip(states, movers, strict=True):
        assert item.motion is not None
        shift, rate, _ = item.motion.over(time_s)
        state[:, [0, 2]] = item.pivot_m[:2] + shift[:, :2]
        state[:, [1, 3]] = rate[:, :2]
        state[:, 4] = (item.z_min_m + item.z_max_m) / 2 + shift[:, 2]
    return states


def _assigned(
    tracks: Tracks, place_m: FloatArray, in_view: BoolArray
) -> tuple[IntArray, FloatArray, FloatArray, IntArray]:
    """States (mover, stop) that follow movers, else -1; GOSPA (stop,) in view, of all; false tracks (stop,)."""
    row = np.full(in_view.shape, -1)
    (in_view_m, all_m), n_false = np.zeros((2, in_view.shape[1])), np.zeros(in_view.shape[1], int)
    for column, stop in enumerate(tracks.survey.stop.tolist()):
        here = np.flatnonzero(tracks.stop == stop)
        distance = np.linalg.norm(tracks.position_m[here][:, None] - place_m[:, column], axis=2)
        every, seen = gospa(distance, CUTOFF_M), in_view[:, column]
        follows = every.true_index >= 0
        row[every.true_index[follows], column] = here[follows]
        kept = ~follows | np.append(seen, False)[every.true_index]
        in_view_m[column] = gospa(distance[np.ix_(kept, seen)], CUTOFF_M).value
        all_m[column], n_false[column] = every.value, every.n_false
    return row, in_view_m, all_m, n_false


def track_metrics(scores: TrackScores | None) -> list[Metric]:
    """Metrics of the tracks; none of a campaign where nothing moves."""
    if scores is None:
        return []
    seen, followed = scores.is_in_view, scores.track >= 0
    judged = followed & seen & np.isfinite(scores.velocity_bound_m_s)
    speed, bound = rms(scores.velocity_error_m_s[judged]), rms(scores.velocity_bound_m_s[judged])
    return [
        Metric("tracks.gospa.mean_m", mean(scores.gospa_m), "m", "lower"),
        Metric("tracks.gospa_all.mean_m", mean(scores.gospa_all_m), "m", "lower"),
        Metric("tracks.in_view_per_stop", ratio(int(seen.sum()), len(scores.stop)), "1", "info"),
        Metric("tracks.found_share", ratio(int((seen & followed).sum()), int(seen.sum())), "1", "higher"),
        Metric("tracks.false_per_stop", mean(scores.n_false), "1", "lower"),
        Metric("tracks.most_switches", float(max(switches(scores).values(), default=0)), "1", "lower"),
        Metric("tracks.position.rmse_m", rms(scores.position_error_m[followed & seen]), "m", "lower"),
        Metric("tracks.velocity.rmse_m_s", speed, "m/s", "lower"),
        Metric("tracks.velocity.bound_m_s", bound, "m/s", "info"),
        Metric("tracks.velocity.over_bound", ratio(speed, bound), "1", "lower"),
    ]


def switches(scores: TrackScores) -> dict[str, int]:
    """How often the track that follows a mover is another one than before, by its name."""
    found = {}
    for name in np.unique(scores.mover).tolist():
        own = scores.track[(scores.mover == name) & (scores.track >= 0)]
        found[str(name)] = int((np.diff(own) != 0).sum())
    return found
