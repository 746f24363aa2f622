"""Grade a submission: a loss per stop or scene, and its mean with a confidence interval.

- channel: GOSPA between submitted and significant true paths of a stop (order 2, cutoff 1);
- slam: distance of the submitted position to the truth, at most 1 m, which a missing stop has;
- contours: mean of two distances, each at most 0.5 m: of submitted points to the nearest true surface, and of the
  points where true paths bounced once to the nearest submitted contour.

The interval holds 95 %: Student's t of the means of scenes, because stops of one scene are alike; of single stops
where there are less than three scenes, and none of a single value. (A percentile bootstrap of five normal values
holds 85 % only.)
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
import shapely
from scipy.stats import t as student_t

from estimation.channel.record import AngleKind, ChannelEstimate
from isac_arena.campaign.chain.inputs import significance
from isac_arena.public_tasks.making import SealedScene, Stage
from isac_arena.public_tasks.submissions import Submission
from isac_arena.scoring.chain import score_channel
from isac_arena.scoring.link_view import link_view
from isac_arena.scoring.provenance import path_origin
from isac_arena.scoring.record import PathKind, ScoreTables
from scenes.record import FloatArray

UNITS: dict[Stage, str] = {"channel": "GOSPA", "slam": "m", "contours": "m"}
FARTHEST_M: dict[Stage, float] = {"slam": 1.0, "contours": 0.5}
LEAST_SCENES = 3
SAMPLE_M, LONGEST_M = 0.05, 1e4  # between points of a submitted contour, and length of all in a scene


@dataclass(frozen=True)
class Grade:
    """A mean loss, its 95 % interval (NaN where there is none), and the losses (scene, stop) behind it.

    A scene has one loss for contours.
    """

    mean: float
    low: float
    high: float
    losses: list[FloatArray]


def grade(stage: Stage, scenes: list[SealedScene], submission: Submission) -> Grade:
    """The grade of a submission."""
    losses = {"channel": _channel, "slam": _slam, "contours": _contours}[stage]
    return with_interval([losses(sealed, number, submission) for number, sealed in enumerate(scenes)])


def interval_over(stage: Stage, n_scenes: int, n_stops: int) -> Literal["scenes", "stops", ""]:
    """What the interval of a task is over; empty where there is none."""
    if n_scenes >= LEAST_SCENES or (stage == "contours" and n_scenes > 1):
        return "scenes"
    return "stops" if stage != "contours" and n_scenes * n_stops > 1 else ""


def with_interval(losses: list[FloatArray]) -> Grade:
    """The mean over all stops with its interval."""
    every = np.concatenate(losses)
    units = np.array([one.mean() for one in losses]) if len(losses) >= LEAST_SCENES else every
    mean, half = float(every.mean()), np.nan
    if len(units) > 1:
        half = float(student_t.ppf(0.975, len(units) - 1) * units.std(ddof=1) / np.sqrt(len(units)))
    return Grade(mean, float(np.maximum(mean - half, 0.0)), mean + half, losses)


def channel_tables(sealed: SealedScene, channel: list[ChannelEstimate]) -> ScoreTables:
    """The tables of the channel scores of a scene."""
    run = sealed.run
    return score_channel(
        sealed.scene, sealed.truths, channel, true_power_dbm=run.true_power_dbm,
        significance=significance(sealed.config, run.link), view=link_view(sealed.config, run.link, sealed.scene),
    ).tables  # fmt: skip


def _channel(sealed: SealedScene, number: int, submission: Submission) -> FloatArray:
    channel = [_estimate(truth.stop, submission.of(number, truth.stop)) for truth in sealed.truths]
    return channel_tables(sealed, channel).stops.gospa


def _estimate(stop: int, values: FloatArray) -> ChannelEstimate:
    """Submitted paths of a stop as a record: angles that horizontal beams see, powers of the best pairs."""
    values = values[np.argsort(values[:, 0], kind="stable")]
    n = len(values)
    zero = np.zeros(n)
    return ChannelEstimate(
        stop=stop, delay_s=values[:, 0], aod_azimuth_rad=values[:, 1], aoa_azimuth_rad=values[:, 2],
        power_dbm=values[:, 3], beam_loss_db=zero, snr_db=zero, covariance=np.full((n, 3, 3), np.nan),
        is_los=np.zeros(n, bool), aod_angle_kind=AngleKind.CONE, aoa_angle_kind=AngleKind.CONE,
    )  # fmt: skip


def _slam(sealed: SealedScene, number: int, submission: Submission) -> FloatArray:
    losses = []
    for truth in sealed.truths:
        found = submission.of(number, truth.stop)
        away_m = np.linalg.norm(found[0] - truth.rx_pose.position_m[:2]) if len(found) else np.inf
        losses.append(min(float(away_m), FARTHEST_M["slam"]))
    return np.array(losses)


def _contours(sealed: SealedScene, number: int, submission: Submission) -> FloatArray:
    most = FARTHEST_M["contours"]
    lines = [_line(submission.of(number, contour)) for contour in submission.others(number)]
    surfaces = shapely.union_all([shapely.boundary(body) for body in _standing(sealed)])
    seen = shapely.points(bounce_points(sealed))
    if not lines:
        return np.array([most])
    together = shapely.geometrycollections(lines)
    points = _spread(together, number)
    wrong = np.minimum(shapely.distance(shapely.points(points), surfaces), most).mean()
    missed = np.minimum(shapely.distance(seen, together), most).mean() if len(seen) else 0.0
    return np.array([(wrong + missed) / 2])


def _spread(lines: shapely.Geometry, number: int) -> FloatArray:
    """Points (point, xy) along lines, one in each cell of `SAMPLE_M`: a line that is drawn often counts once."""
    if lines.length > LONGEST_M:
        raise ValueError(
            f"scene {number}: contours are {lines.length:.3g} m long, at most {LONGEST_M:g} m are read"
        )
    points = shapely.get_coordinates(shapely.segmentize(lines, SAMPLE_M))
    _, first = np.unique(np.floor(points / SAMPLE_M), axis=0, return_index=True)
    return np.asarray(points[first])


def _standing(sealed: SealedScene) -> list[shapely.Geometry]:
    """Plans of all objects that stand still."""
    return [item.contour.body() for item in sealed.scene.objects if item.motion is None]


def bounce_points(sealed: SealedScene) -> FloatArray:
    """Points (point, xy) where true paths bounced once off an object that stands still."""
    still = {item.name for item in sealed.scene.objects if item.motion is None}
    found = []
    for truth in sealed.truths:
        origin = path_origin(truth.paths)
        single = (origin.kind == PathKind.SINGLE_BOUNCE) & np.isin(origin.object, list(still))
        found.append(origin.vertex_m[single][:, :2])
    return np.concatenate(found)


def _line(points: FloatArray) -> shapely.Geometry:
    """A contour through points in their order; it is closed where the last point is the first."""
    return shapely.linestrings(points) if np.ptp(points, axis=0).any() else shapely.points(points[0])
