"""Bounds of poses and contours along a walk from several TX, together and each alone.

Poses are those of stops alone, with unknown incidence points and clocks. Contours are those of mapping: poses have
the errors of the survey, and shapes the priors of the contour stage (`estimation.shape.reflection.bounds`). Paths
are the line of sight and single bounces, with their bounds for joint estimation of all paths that the links have.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from estimation.laws.plane import tx_row
from estimation.shape.config import ContourConfig
from estimation.shape.reflection.bounds import ContourBounds, ContourInformation, KnownContour, link_information
from estimation.shape.reflection.reflections import Reflections
from estimation.slam.bounds import state_covariance
from isac_arena.insight.bounds.known_contour import SPACING_M, known_contour, pillars
from isac_arena.insight.bounds.signal import LinkBounds, Track
from isac_arena.scoring.metrics.statistics import rms
from isac_arena.scoring.stages.poses import from_node, plane_paths, pose_information, true_state
from isac_arena.scoring.stages.shapes import SEEN_MARGIN_RAD, seen_samples
from scenes.pose import Pose
from scenes.record import BoolArray, FloatArray

_LEAST = 1e-300  # information on a clock, where no path is heard


@dataclass(frozen=True)
class TxWalk:
    """What one TX shows to the receiver along a walk."""

    name: str
    tx: Pose
    pose: FloatArray  # (stop, 3, 3) information on x, y and heading of every stop alone
    contour: FloatArray  # (unknown, unknown) information of `ContourInformation`
    point_m: tuple[FloatArray, ...]  # per object (path, xy): incidence points


@dataclass(frozen=True)
class WalkBounds:
    """Bounds from some TX: position (stop,) and contours, and which parts of every outline are lit."""

    position_m: FloatArray  # (stop,)
    heading_rad: FloatArray  # (stop,)
    contours: ContourBounds
    lit: tuple[BoolArray, ...]  # per object (sample,) of its outline

    @property
    def lit_share(self) -> FloatArray:
        """Share (object,) of every outline that is lit."""
        return np.array([part.mean() for part in self.lit])

    @property
    def pose_m(self) -> float:
        """RMS of the position bound over the stops that have one."""
        return rms(self.position_m)

    @property
    def contour_m(self) -> float:
        """RMS over the objects of the bound of their outlines; NaN without any."""
        return rms(self.contours.outline_m)


class SeveralTx:
    """A walk in a scene, its pillars, and what every one of several TX shows of both.

    `links` are the TX and `stops` stops of the walk. `track` shows the progress over the TX.
    """

    def __init__(
        self, links: Sequence[LinkBounds], stops: Sequence[int], config: ContourConfig, track: Track[int] = iter
    ) -> None:
        self.scene, self.stops = links[0].run.scene, tuple(stops)
        self.objects = [known_contour(item) for item in pillars(self.scene)]
        poses = [self.scene.stops[stop] for stop in stops]
        self.walks = tuple(tx_walk(links[row], poses, self.objects, config) for row in track(range(len(links))))
        self.outline_m = [self.scene.object(each.name).contour.sample(SPACING_M) for each in self.objects]
        self.information = ContourInformation(self.objects, [walk.contour for walk in self.walks], config)

    def bounds(self, chosen: Sequence[int] | None = None) -> WalkBounds:
        """Bounds from the chosen TX, by default from all."""
        rows = range(len(self.walks)) if chosen is None else chosen
        covariance = np.array(
            [state_covariance(total) for total in np.sum([self.walks[row].pose for row in rows], axis=0)]
        )
        variance = np.diagonal(covariance, axis1=1, axis2=2)
        lit = [
            lit_samples(outline, np.concatenate([self.walks[row].point_m[k] for row in rows]))
            for k, outline in enumerate(self.outline_m)
        ]
        return WalkBounds(
            np.sqrt(variance[:, 0] + variance[:, 1]),
            np.sqrt(variance[:, 2]),
            self.information.bounds(rows),
            tuple(lit),
        )


def tx_walk(
    link: LinkBounds, stops: Iterable[Pose], objects: Sequence[KnownContour], config: ContourConfig
) -> TxWalk:
    """What one TX shows at the stops."""
    scene = link.run.scene
    pose, states = [], []
    paths: list[list[tuple[int, FloatArray]]] = [[] for _ in range(len(objects) + 1)]  # the last: lines of sight
    points: list[list[FloatArray]] = [[] for _ in objects]
    for index, at in enumerate(stops):
        stop = from_node(link.at(at))
        pose.append(_without_clock(pose_information(scene, stop)))
        states.append(true_state(stop.truth))
        covariance, is_los, bounce = plane_paths(scene, stop)
        name = stop.origin.object[stop.significant]
        for k, each in enumerate(objects):
            for row in np.flatnonzero(bounce & (name == each.name))[:1]:  # a contour has one path per stop
                paths[k].append((index, covariance[row]))
                points[k].append(stop.origin.vertex_m[stop.significant[row]])
        paths[-1] += [(index, covariance[row]) for row in np.flatnonzero(is_los)[:1]]
    state = np.array(states)
    *bounces, los = [_reflections(scene.tx, state, each) for each in paths]
    information = link_information(objects, bounces, los, state, config)
    lit = tuple(np.array(each).reshape(-1, 2) for each in points)
    return TxWalk(scene.tx_name, scene.tx, np.array(pose), information, lit)


def _reflections(tx: Pose, state: FloatArray, paths: Sequence[tuple[int, FloatArray]]) -> Reflections:
    """Paths, given by their stop and covariance, at true states (stop, 4); what they measure does not count."""
    n, stop = len(paths), np.array([index for index, _ in paths], int)
    return Reflections(
        measured=np.zeros((n, 3)),
        covariance=np.array([covariance for _, covariance in paths]).reshape(-1, 3, 3),
        tx=np.tile(tx_row(tx), (n, 1)),
        rx_state=state[stop],
        rx_covariance=np.zeros((n, 4, 4)),
        session=np.zeros(n, int),
        stop=stop,
    )


def _without_clock(information: FloatArray) -> FloatArray:
    """Information (3, 3) on the pose from that (4, 4) on pose and clock, where the clock is unknown."""
    shared = information[:3, 3]
    return np.asarray(information[:3, :3] - np.outer(shared, shared) / max(information[3, 3], _LEAST))


def lit_samples(outline_m: FloatArray, point_m: FloatArray) -> BoolArray:
    """Samples (sample,) of an outline within the margin of an incidence point (path, xy), seen from its middle."""
    middle = outline_m.mean(axis=0)
    angle, lit = (np.arctan2(*(points - middle).T[::-1]) for points in (outline_m, point_m))
    return seen_samples(angle, lit, SEEN_MARGIN_RAD)
