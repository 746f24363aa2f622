"""`arena validate multistatic`: `arena place` against what is achieved, and against exhaustive search."""

import time
from dataclasses import dataclass

import numpy as np

from estimation.shape.record import Contours
from estimation.slam.record import PoseEstimates
from estimation.slam.stops import run_slam
from isac_arena.campaign.campaign import Campaign
from isac_arena.campaign.chain.inputs import all_tx
from isac_arena.campaign.chain.maps import make_map
from isac_arena.insight.bounds.signal import LinkBounds
from isac_arena.insight.placement.criterion import Criterion
from isac_arena.insight.placement.placement import Placement, place, with_tx
from isac_arena.insight.placement.search import exhaustive
from isac_arena.validation.measurement import Measurement, at_least, at_most
from isac_arena.validation.monte_carlo import band_rows, generators
from isac_arena.validation.multistatic.arenas import draw_arena, drawn_paths
from isac_arena.validation.slam.trials import MAPPING, MATCHED, MAX_PEB_M
from scenes.record import FloatArray

COUNT = 3
MAX_OUTLINE_M = 0.1  # beyond it the prior of the shape, not the paths, decides
FOUND_M = 0.5  # of the centre of a contour from that of its pillar
_LONGER = 4  # times as many candidates, where time is compared


@dataclass(frozen=True)
class PlacedArena:
    """Achieved over expected errors of stops and of pillars, and the criterion of the best set over that found."""

    pose: FloatArray  # (stop,) NaN where not solved
    outline: FloatArray  # (pillar,) NaN where not found
    of_best: float
    above_best: float


def check_placement(seed: int, quick: bool) -> list[Measurement]:
    """Random arenas with TX placed by the bounds: expected over achieved errors; greedy search against all."""
    n_arenas, n_candidates, n_stops = (1, 5, 5) if quick else (20, 12, 8)
    arenas = [_placed(rng, n_candidates, n_stops) for rng in generators(seed, n_arenas, 31)]
    key = "multistatic.placement"
    rows = []
    for name, of in (("pose", "stops solved within 1 m"), ("contours", "pillars found")):
        ratio = np.concatenate([one.pose if name == "pose" else one.outline for one in arenas])
        known = ratio[np.isfinite(ratio)]
        value = float(np.mean(known**2)) ** -0.5
        reason = f"expected over achieved RMS errors, {len(known)} of {len(ratio)} {of}"
        rows += band_rows(f"{key}.{name}", value, (0.9, 1.15), value / np.sqrt(len(known)), quick, reason)
        rows.append(at_least(f"{key}.{name}.share", np.isfinite(ratio).mean(), 0.9, of))
    best = [one.of_best for one in arenas[:10]]
    certificate = np.median([one.above_best for one in arenas])
    reason = f"smallest of {len(best)} arenas; median certificate: at most {certificate:.2f} times the best"
    rows.append(at_least(f"{key}.greedy_of_best", min(best), 0.95, reason))
    return rows


def check_placement_time(seed: int, quick: bool) -> list[Measurement]:
    """Time of the bounds of candidates over their number."""
    seconds = []
    for n_candidates in (3, 3 * _LONGER):
        rng = next(iter(generators(seed, 1, 32)))
        campaign, candidates = draw_arena(rng, n_candidates, 2 if quick else 8)
        started = time.process_time()
        place(campaign, candidates, 2)
        seconds.append(time.process_time() - started)
    ratio = seconds[1] / seconds[0] / _LONGER
    return [at_most("multistatic.placement.time", ratio, 1.5, f"of {_LONGER} times the candidates, over that")]


def _placed(rng: np.random.Generator, n_candidates: int, n_stops: int) -> PlacedArena:
    campaign, candidates = draw_arena(rng, n_candidates, n_stops)
    placement = place(campaign, candidates, COUNT)
    best = exhaustive(Criterion(placement.several), range(n_candidates), COUNT)
    runs = with_tx(campaign, [candidates[row] for row in placement.chosen], range(n_stops)).links
    links = [LinkBounds(run, single=True) for run in runs]
    plain, shifted, surveyed = drawn_paths(rng, links, campaign.stops, campaign.config.contours)
    tx = all_tx([run.config for run in runs], [run.scene.tx for run in runs])
    poses, _ = run_slam(plain, tx, MATCHED, MAPPING)
    contours = make_map(campaign.config, shifted, tx, surveyed).contours
    return PlacedArena(
        _pose_ratio(campaign, placement, poses),
        _outline_ratio(campaign, placement, contours),
        float(np.exp(best.log_error[-1] - placement.found.log_error[-1])),
        placement.above_best,
    )


def _pose_ratio(campaign: Campaign, placement: Placement, poses: PoseEstimates) -> FloatArray:
    """Position errors over their bounds (stop,), of the stops that are bounded."""
    true = np.array([pose.position_m[:2] for pose in campaign.stops])
    error, bound = np.linalg.norm(poses.position_m - true, axis=1), placement.bounds().position_m
    return np.where(error < 1.0, error / bound, np.nan)[bound < MAX_PEB_M]


def _outline_ratio(campaign: Campaign, placement: Placement, contours: Contours) -> FloatArray:
    """RMS errors of outlines over their bounds (pillar,), of the pillars that paths determine."""
    found = []
    expected = placement.bounds().contours.outline_m
    for each, bound in zip(placement.several.objects, expected, strict=True):
        if bound < MAX_OUTLINE_M:
            error = _outline_error(campaign, each.name, each.parameter[:2], contours)
            found.append(error / bound)
    return np.array(found)


def _outline_error(campaign: Campaign, name: str, center_m: FloatArray, contours: Contours) -> float:
    """RMS distance of the closed contour at a pillar from its outline; NaN without one."""
    away = np.linalg.norm(contours.center_m - center_m, axis=1)
    away[~contours.is_closed] = np.inf
    if not len(away) or away.min() > FOUND_M:
        return np.nan
    outline = contours.contour_m[int(np.argmin(away))]
    return float(np.sqrt(np.mean(campaign.scene.object(name).contour.signed_distance(outline) ** 2)))
