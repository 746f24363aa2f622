"""Estimates of sweeps with Doppler against their bounds, and which paths are called moving."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import linear_sum_assignment

from estimation.channel.coherent.diffuse import fit_over_background
from estimation.channel.coherent.plan import nominal_manifold, search_plan
from estimation.channel.config import MaximumLikelihoodConfig
from estimation.channel.fit import PathFit
from estimation.channel.model.turns import sweep_turns
from isac_arena.scoring.metrics.statistics import squared_mahalanobis
from isac_arena.validation import monte_carlo
from isac_arena.validation.measurement import Measurement, at_most
from isac_arena.validation.scenarios.link_bench import (
    SEPARATED_CELLS,
    DrawnPaths,
    LinkBench,
    draw_paths,
    single_path,
)
from isac_arena.validation.scenarios.moving_stops import (
    MovingStop,
    clock_of,
    moving_bench,
    moving_bounds,
    moving_stop,
)
from scenes.pose import SPEED_OF_LIGHT_M_S, wrap_angle
from scenes.record import BoolArray, FloatArray
from sim.observation import BeamClock
from sim.signal.waveform.config import ScanOrder

ORDERS: tuple[ScanOrder, ...] = ("linear", "interleaved", "random")
SPEEDS_M_S = (0.2, 1.9)  # length rates of moving paths; a linear scan tells 2.3 m/s apart
SEARCH = MaximumLikelihoodConfig(max_length_rate_m_s=2.0)
STRONGEST_DB = (20.0, 40.0)
SHARP_DB = 15.0  # as well known as a lone path of this SNR: from here on the bound can be reached
GATE_CELLS, GATE_DEVIATIONS = 1.0, 5.0
ABOVE_LEVEL_DB = 10.0
NAMES = ("delay", "aod", "aoa", "doppler")


@dataclass(frozen=True)
class Judged:
    """Moving paths of many stops: errors over bounds, squared errors over covariances."""

    error: FloatArray  # (path, 4) over the bound
    nees: FloatArray  # (path,)


def check_estimates(seed: int, quick: bool, trials: int | None = None) -> list[Measurement]:
    """Random stops with frozen and moving paths: errors of the moving ones, covariances in every scan order."""
    count = trials or (12 if quick else 2000)
    errors, nees = [], []
    for bench, clock, number in _benches(seed, count):
        is_plain = bench.config.waveform.scan_order == "linear"  # the others have other likely shifts
        for stop in range(number):
            made = moving_stop(bench, *_drawn(bench, np.random.default_rng([seed, stop, number])), stop)
            judged = judge(bench, made, clock, fit_over_background(made.sweep, SEARCH))
            errors += [judged.error] if is_plain else []
            nees.append(judged.nees)
    every, squared = np.concatenate(errors), np.concatenate(nees)
    n = max(len(every), 1)
    n_all = max(len(squared), 1)
    ratio = np.sqrt(np.mean(np.square(every), axis=0))
    reason = f"{n} separated moving paths of linear scans; the bound allows 1"
    spread = 1 / np.sqrt(2 * n)
    rows = [
        at_most(f"motion.rmse_over_crb.{name}", value, monte_carlo.quick_bar(bar, error, quick), reason)
        for name, value, bar, error in zip(
            (*NAMES, "mean"),
            (*ratio, ratio.mean()),
            (*4 * (1.10,), 1.05),
            (*4 * (spread,), spread / 2),
            strict=True,
        )
    ]
    cover_bar = monte_carlo.quick_bar(0.01, np.sqrt(0.95 * 0.05 / n_all), quick)
    nees_bar = monte_carlo.quick_bar(0.05, np.sqrt(0.5 / n_all), quick)
    of = f", {n_all} paths of three scan orders"
    return [
        *rows,
        monte_carlo.coverage_row("motion.coverage95_deviation", squared, 4, cover_bar, of),
        monte_carlo.nees_row("motion.nees_deviation", squared, 4, nees_bar, of),
    ]


def check_decision(seed: int, quick: bool, trials: int | None = None) -> list[Measurement]:
    """Lone paths 10 dB over the detection level, frozen or moving: which are called moving."""
    count = trials or (60 if quick else 3000)
    wrong: dict[bool, list[bool]] = {False: [], True: []}
    for bench, _, number in _benches(seed + 1, count):
        level_db = 10 * np.log10(detection_level(bench)) + ABOVE_LEVEL_DB
        for stop in range(number):
            rng = np.random.default_rng([seed, 1, stop, number])
            moves = bool(stop % 2)
            path = single_path(rng, 0.0)
            path = replace(path, snr_db=level_db - _spread_db(bench, path))
            made = moving_stop(bench, path, _shifts(bench, rng, np.array([moves])), stop)
            fit = fit_over_background(made.sweep, SEARCH)
            strongest = fit.take("path", [int(np.argmax(fit.snr_db))]) if len(fit) else fit
            wrong[moves].append(bool(len(strongest)) and bool((strongest.doppler_hz != 0).any()) != moves)
    reason = f"lone paths {ABOVE_LEVEL_DB:g} dB over the detection level, three scan orders"
    return [
        _share_row("motion.static_called_moving", wrong[False], 0.01, reason, quick),
        _share_row("motion.moving_called_static", wrong[True], 0.05, f"{reason}, from 0.2 m/s on", quick),
    ]


def _benches(seed: int, count: int) -> Iterator[tuple[LinkBench, BeamClock, int]]:
    """A link of every scan order, the times of its beams, and its share of the stops."""
    for place, order in enumerate(ORDERS):
        bench = moving_bench(seed, order)
        yield bench, clock_of(bench), len(range(place, count, len(ORDERS)))


def _drawn(bench: LinkBench, rng: np.random.Generator) -> tuple[DrawnPaths, FloatArray]:
    """Paths of a stop, and their Doppler shifts; half of them are frozen."""
    paths = draw_paths(rng, bench.cell, strongest_db=STRONGEST_DB)
    return paths, _shifts(bench, rng, rng.random(len(paths)) < 0.5)


def _shifts(bench: LinkBench, rng: np.random.Generator, moves: BoolArray) -> FloatArray:
    speed = rng.uniform(*SPEEDS_M_S, len(moves)) * rng.choice([-1.0, 1.0], len(moves))
    return np.where(moves, speed / SPEED_OF_LIGHT_M_S * bench.link.carrier_hz, 0.0)


def _spread_db(bench: LinkBench, path: DrawnPaths) -> float:
    """Energy of a lone path in all beam pairs over that in the best one, in dB."""
    ends = bench.tx.response(path.parameters[:, 1:2]), bench.rx.response(path.parameters[:, 2:3])
    power = [np.square(np.abs(end[0])) for end in ends]
    return float(sum(10 * np.log10(each.sum() / each.max()) for each in power))


def _share_row(key: str, wrong: list[bool], bar: float, reason: str, quick: bool) -> Measurement:
    n = max(len(wrong), 1)
    allowed = monte_carlo.most_by_chance(bar * n) / n if quick else bar
    return at_most(key, float(np.mean(wrong)), allowed, f"{len(wrong)} {reason}")


def judge(bench: LinkBench, stop: MovingStop, clock: BeamClock, fit: PathFit) -> Judged:
    """Errors of the moving paths that are separated from others and well known."""
    covariance, loss_db, separation = moving_bounds(bench, stop, clock)
    std = np.sqrt(np.einsum("iaa->ia", covariance))
    truth = np.column_stack([stop.paths.parameters, stop.doppler_hz])
    found = np.column_stack([fit.delay_s, fit.aod_rad, fit.aoa_rad, fit.doppler_hz])
    error = found[None] - truth[:, None]
    error[..., 1:3] = wrap_angle(error[..., 1:3])
    gate = np.maximum(GATE_CELLS * bench.cell, GATE_DEVIATIONS * np.where(np.isfinite(std), std, 0.0)[:, :3])
    distance = np.square(error[..., :3] / gate[:, None]).max(axis=2)
    rows, columns = linear_sum_assignment(np.minimum(distance, 1.0))
    chosen = (stop.doppler_hz != 0) & (separation >= SEPARATED_CELLS) & (stop.paths.snr_db - loss_db >= SHARP_DB)
    use = (distance[rows, columns] < 1) & chosen[rows] & (fit.doppler_hz[columns, 0] != 0)
    rows, columns = rows[use], columns[use]
    own = error[rows, columns]
    return Judged(own / std[rows], squared_mahalanobis(own, fit.covariance[columns]))


def detection_level(bench: LinkBench) -> float:
    """Power over noise power that a path needs near the strongest one."""
    link = bench.link
    made = moving_stop(bench, single_path(np.random.default_rng(0), 20.0), np.zeros(1), 0)
    plan = search_plan(
        nominal_manifold(link.tx_codebook), nominal_manifold(link.rx_codebook),
        tuple(link.noise_power_mw.tolist()), SEARCH.oversampling,
        sweep_turns(made.sweep, SEARCH.max_length_rate_m_s),
    )  # fmt: skip
    n = bench.n_subcarriers
    n_near = round(1e-9 * (SEARCH.delay_before_ns + SEARCH.delay_after_ns) / bench.cell[0])
    return plan.level(0.8 * SEARCH.false_alarm_probability, min(n_near, n), n)
