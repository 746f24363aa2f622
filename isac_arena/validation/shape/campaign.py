"""`arena validate shape`: whole synthetic campaigns from paths to contours, our mode beside the paper's mode.

Three round pillars, a wall and an edge beside the Campus Arena's walk, with the line of sight and two ghosts per
stop: paths over two random points, like double bounces. Poses have the errors of a survey, or SLAM finds them.
Delays and departures have a constant error, except for SLAM, where it is unobservable. SLAM runs once more with a
TX heading that jumps during the walk, which is unobservable from a single stop.
"""

from dataclasses import astuple, dataclass

import numpy as np

from estimation.channel.record import ChannelEstimate
from estimation.slam.record import PoseEstimates
from isac_arena.campaign.chain.maps import make_map
from isac_arena.campaign.config import CampaignConfig
from isac_arena.campaign.results import MapResult
from isac_arena.scoring.metrics.contours import intersection_over_union
from isac_arena.scoring.stages.shapes import contour_points_m
from isac_arena.validation.measurement import Measurement, at_least, at_most
from isac_arena.validation.monte_carlo import generators
from isac_arena.validation.scenarios import reflections
from isac_arena.validation.scenarios.estimates import made_estimate, made_poses
from isac_arena.validation.scenarios.paths import over_points
from scenes.contours.smooth import Circle
from scenes.pose import SPEED_OF_LIGHT_M_S, Pose
from scenes.record import FloatArray, IntArray

N_PILLARS = 3
N_GHOSTS = 2  # per stop
LEVEL = 0.3  # of the noise, in ns, deg and deg
SURVEY = np.array([0.05, 0.05, np.deg2rad(1.0)])
DELAY_OFFSET_NS, DEPARTURE_OFFSET_DEG = 0.3, 1.0
JUMP_DEG, JUMP_STOP = 2.0, 20  # of the TX heading, in the rows of two sessions
CLEARANCE_M = 1.5
CLUTTER_BOX_M = np.array([[-8.0, 10.0], [-10.0, 3.0]])
WALL, EDGE, LOS, GHOST = range(N_PILLARS, N_PILLARS + 4)  # sources of paths, after the pillars
OUTLINE_SPACING_M = 0.005


@dataclass(frozen=True)
class MadeArena:
    """Channel estimates of a campaign, the true source of each path, and the receivers."""

    pillars: tuple[Circle, ...]
    channel: tuple[ChannelEstimate, ...]
    source: tuple[IntArray, ...]  # per stop (path,): pillar number, WALL, EDGE, LOS or GHOST
    poses: PoseEstimates  # as surveyed


@dataclass(frozen=True)
class MapScore:
    """Scores of one map."""

    iou: float  # mean over all pillars, 0 for one without contour
    paper_iou: float
    class_right: float
    coverage: float  # of the 95 % bands of pillars
    ghosts: int  # accepted contours most of whose paths are ghosts


def check_campaign_contours(seed: int, quick: bool) -> list[Measurement]:
    """Mean pillar overlap beside the paper mode's, ghosts accepted and classes, in mapping and in SLAM.

    A quick run leaves SLAM without a jump of the TX heading out.
    """
    n = 1 if quick else 6
    config = CampaignConfig(name="made", scene="-", seed=0)
    rows: list[Measurement] = []
    cases = (("mapping", True, 0.0), ("slam", False, 0.0), ("slam_jump", False, JUMP_DEG))
    for name, offset, jump_deg in cases[:: 2 if quick else 1]:
        scores = []
        for rng in generators(seed, n):
            made = make_arena(rng, offset=offset, jump_deg=jump_deg)
            tx = Pose(np.array([*reflections.TX[:2], 0.0]), float(reflections.TX[2]))
            result = make_map(config, made.channel, tx, made.poses if name == "mapping" else None)
            scores.append(score(made, result))
        rows += _rows(f"campaign.{name}", scores, quick)
    return rows


def score(made: MadeArena, result: MapResult) -> MapScore:
    """Scores of one map of a made campaign."""
    source = dict(zip(result.poses.stop.tolist(), made.source, strict=True))
    ips, contours = result.ips, result.contours
    kind = np.array([source[s][p] for s, p in zip(ips.stop.tolist(), ips.path.tolist(), strict=True)], int)
    iou, paper, covered = np.zeros(N_PILLARS), np.zeros(N_PILLARS), []
    ghosts, right = 0, []
    for row in range(len(contours)):
        main = int(np.bincount(kind[contours.object == row], minlength=GHOST + 1).argmax())
        ghosts += main == GHOST
        if main in (GHOST, LOS):
            continue
        name = str(contours.class_name[contours.class_probability[row].argmax()])
        right.append(name == {WALL: "wall", EDGE: "edge"}.get(main, "pillar"))
        if main < N_PILLARS:
            if contours.is_closed[row]:
                iou[main] = max(iou[main], _iou(made, main, contours.contour_m[row]))
            distance = np.abs(made.pillars[main].signed_distance(contours.contour_m[row]))
            covered.append(np.mean(distance <= 1.96 * contours.std_m[row]))
    for cluster in range(len(result.shapes.center_m)):
        main = int(np.bincount(kind[result.shapes.label == cluster], minlength=GHOST + 1).argmax())
        if main < N_PILLARS:
            paper[main] = max(paper[main], _iou(made, main, contour_points_m(result.shapes, cluster)))
    overlap, of_paper, class_right, coverage = (float(np.mean(part)) for part in (iou, paper, right, covered))
    return MapScore(overlap, of_paper, class_right, coverage, ghosts)


def make_arena(rng: np.random.Generator, *, offset: bool, jump_deg: float = 0.0) -> MadeArena:
    """A random campaign; `offset` puts the constant errors on delays and departures.

    `jump_deg` is an error of the TX heading at the stops before `JUMP_STOP`.
    """
    pillars: list[Circle] = []
    truths: list[reflections.TruePaths] = []
    while len(pillars) < N_PILLARS:
        pillar, true = reflections.lit_pillar(reflections.draw_circle, rng)
        if all(np.linalg.norm(pillar.center_m - other.center_m) > CLEARANCE_M for other in pillars):
            pillars.append(pillar)
            truths.append(true)
    truths += [reflections.lit_wall(rng)[1], reflections.lit_edge(rng)]
    walk = reflections.walk_positions()
    heading = rng.uniform(-np.pi, np.pi, len(walk))
    clock_m = rng.normal(10.0, 1.0, len(walk))
    shift = np.zeros(3)
    if offset:
        size = [1e-9 * SPEED_OF_LIGHT_M_S * DELAY_OFFSET_NS, np.deg2rad(DEPARTURE_OFFSET_DEG)]
        shift[:2] = rng.choice([-1.0, 1.0], 2) * size
    channel, source = [], []
    for stop, position in enumerate(walk):
        rx = np.array([*position, heading[stop]])
        exact, kind = _true_paths(truths, rx, rng)
        jump = np.deg2rad(jump_deg) if stop < JUMP_STOP else 0.0
        estimate, order = _estimate(stop, exact + shift + np.array([clock_m[stop], jump, 0]), kind, rng)
        channel.append(estimate)
        source.append(kind[order])
    surveyed = np.column_stack([walk, heading]) + rng.standard_normal((len(walk), 3)) * SURVEY
    poses = made_poses(np.column_stack([surveyed, clock_m / SPEED_OF_LIGHT_M_S]))
    return MadeArena(tuple(pillars), tuple(channel), tuple(source), poses)


def _true_paths(
    truths: list[reflections.TruePaths], rx: FloatArray, rng: np.random.Generator
) -> tuple[FloatArray, IntArray]:
    """Range, departure and arrival (path, 3) of the paths of one stop, and the source of each."""
    rows, kind = [_over(np.zeros((0, 2)), rx)], [LOS]
    for number, true in enumerate(truths):
        mine = np.flatnonzero(np.linalg.norm(true.rx[:, :2] - rx[:2], axis=1) < 1e-9)
        if len(mine):
            same = reflections.TruePaths(true.point_m[mine[:1]], rx[None])
            rows.append(reflections.true_measurements(same)[0])
            kind.append(number)
    for _ in range(N_GHOSTS):
        rows.append(_over(rng.uniform(CLUTTER_BOX_M[:, 0], CLUTTER_BOX_M[:, 1], (2, 2)), rx))
        kind.append(GHOST)
    return np.array(rows), np.array(kind)


def _over(points_m: FloatArray, rx: FloatArray) -> FloatArray:
    """Range, departure and arrival (3,) of the path over points (point, xy)."""
    length, departure, arrival = over_points(np.vstack([reflections.TX[:2], points_m, rx[:2]]))
    return np.array([length, departure - reflections.TX[2], arrival - rx[2]])


def _estimate(
    stop: int, measured: FloatArray, kind: IntArray, rng: np.random.Generator
) -> tuple[ChannelEstimate, IntArray]:
    n = len(measured)
    std = LEVEL * np.array([1e-9, np.deg2rad(1.0), np.deg2rad(1.0)])
    noisy = measured / np.array([SPEED_OF_LIGHT_M_S, 1.0, 1.0]) + std * rng.standard_normal((n, 3))
    order = np.argsort(noisy[:, 0], kind="stable")
    length = measured[order, 0]
    power = -13.0 - 20 * np.log10(length - length.min() + 3.0) - np.where(kind[order] == LOS, 0.0, 10.0)
    noisy[:, 1:] = (noisy[:, 1:] + np.pi) % (2 * np.pi) - np.pi
    return made_estimate(stop, noisy[order], power, np.diag(std**2), kind[order] == LOS), order


def _iou(made: MadeArena, pillar: int, contour_m: FloatArray) -> float:
    return intersection_over_union(contour_m, made.pillars[pillar].sample(OUTLINE_SPACING_M))


def _rows(key: str, scores: list[MapScore], quick: bool) -> list[Measurement]:
    iou, paper, right, coverage, _ = np.mean([astuple(one) for one in scores], axis=0)
    reason = f"{len(scores)} campaigns; paper mode {paper:.2f}"
    return [
        at_least(f"{key}.pillar_iou", iou, 0.7 if quick else 0.85, reason),
        at_least(f"{key}.pillar_iou_over_paper", iou - paper, 0.5 if quick else 0.6, reason),
        at_most(f"{key}.ghosts", sum(one.ghosts for one in scores), 0.0, reason),
        at_least(f"{key}.class_right", right, 0.8 if quick else 0.9, reason),
        at_least(f"{key}.pillar_coverage", coverage, 0.7 if quick else 0.85, reason),
    ]
