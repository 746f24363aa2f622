"""`arena bench channel`: the coherent fit of `auto` over the number of paths, in FFT passes over the sweep.

The stops are those of campus_arena, with the beams of its campaign. The fit finds about 120 paths at a traced
stop, too few for the largest limit. So a dense stop is made of the traced paths and drawn ones: delays uniform
behind the first path, departures uniform in their sine, arrivals from all sides, SNRs uniform in dB. There every
limit is reached. Each row is the worst of both stops. One thread, processor times.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy.fft

from estimation.channel.coherent.diffuse import fit_over_background
from estimation.channel.config import MaximumLikelihoodConfig
from estimation.channel.fit import PathFit
from estimation.execution import one_blas_thread
from isac_arena.campaign.campaign import load_campaign
from isac_arena.campaign.driver import CampaignRun
from isac_arena.validation.benches.timing import paired_ratios
from isac_arena.validation.channel.arena import seen_paths
from isac_arena.validation.measurement import InfoTable, Measured, Measurement, at_most
from isac_arena.validation.scenarios.paths import made_paths
from scenes.record import FloatArray, concatenate
from sim.observation import BeamSweep
from sim.propagation.paths import Paths
from sim.simulate import observe
from sim.truth import Truth

LIMITS = (30, 60, 120, 240)
TRACED_LIMITS = LIMITS[:3]  # the fit finds 123 paths at the traced stop
STOP = 0
N_DRAWN = 240
DRAWN_SNR_DB = (20.0, 40.0)  # in the best beam pair, all subcarriers summed
EDGE_SINE = 0.9  # of departures: inside the sector of the beams
SPREAD_S = 250e-9
N_PASSES, PAIRS = 20, 3  # FFT passes beside each fit: one alone is too short to time
MOST_PASSES, MOST_PER_PATH, MOST_GROWTH, MOST_RATIO = 40.0, 0.4, 1.15, 5.0
FEW_BOUNCES: dict[str, Any] = {
    "propagation.max_bounces": 1, "propagation.diffuse_samples": 0, "propagation.diffraction": False,
    "propagation.compare_planar": False,
}  # fmt: skip


@dataclass(frozen=True)
class FitCost:
    """The time of a fit: how many paths were allowed and found, and its FFT passes (pair,)."""

    stop: str
    limit: int
    n_paths: int
    passes: FloatArray
    fit_ms: float
    pass_ms: float

    @property
    def median(self) -> float:
        """Median of the FFT passes."""
        return float(np.median(self.passes))

    @property
    def per_path(self) -> float:
        """FFT passes per path that is found."""
        return self.median / max(self.n_paths, 1)

    @property
    def words(self) -> str:
        """The times in words."""
        spread = f"{self.passes.min():.3g} to {self.passes.max():.3g}"
        return f"{self.n_paths} paths, {self.stop}: {self.fit_ms:.0f} ms over {self.pass_ms:.1f} ms, {spread}"


def bench_dense_room(seed: int, quick: bool) -> Measured:
    """The fit at several limits of the number of paths; quick: at 30 and 60, at a dense stop of simpler rays."""
    run = load_campaign("campus_arena", seed=seed, **(FEW_BOUNCES if quick else {})).chain()
    settings = run.config.channel.maximum_likelihood
    truth = run.truth(STOP)
    dense = dense_stop(run, truth, np.random.default_rng([seed, STOP]))
    with one_blas_thread():
        if quick:
            costs = [fit_cost("dense stop", dense, settings, limit, 1) for limit in LIMITS[:2]]
        else:
            traced = run.sweep(truth)
            costs = [fit_cost("traced stop", traced, settings, limit, PAIRS) for limit in TRACED_LIMITS]
            costs += [fit_cost("dense stop", dense, settings, limit, PAIRS) for limit in LIMITS]
    return Measured(dense_rows(costs), (cost_table(costs),))


def dense_stop(run: CampaignRun, truth: Truth, rng: np.random.Generator) -> BeamSweep:
    """The sweep of a stop with `N_DRAWN` paths beside its own, through the campaign's simulator."""
    own = truth.paths
    departure = (own.aod_azimuth_rad, own.aod_elevation_rad)
    bare = made_paths(own.gain, own.delay_s, departure, (own.aoa_azimuth_rad, own.aoa_elevation_rad))
    both = concatenate([bare, drawn_paths(run, truth, rng)], "path")
    return observe(run.config, run.link, run.scene, replace(truth, paths=both))


def drawn_paths(run: CampaignRun, truth: Truth, rng: np.random.Generator) -> Paths:
    """Level paths from everywhere that the beams see, of SNRs within `DRAWN_SNR_DB`."""
    heading_rad, level = run.scene.tx.heading_rad, np.zeros(N_DRAWN)
    delay_s = truth.paths.delay_s.min() + rng.uniform(0.0, SPREAD_S, N_DRAWN)
    departure_rad = heading_rad + np.arcsin(rng.uniform(-EDGE_SINE, EDGE_SINE, N_DRAWN))
    arrival_rad = rng.uniform(-np.pi, np.pi, N_DRAWN)
    phase = np.exp(1j * rng.uniform(-np.pi, np.pi, N_DRAWN))
    paths = made_paths(phase, delay_s, (departure_rad, level), (arrival_rad, level))
    snr_db = seen_paths(run.link, replace(truth, paths=paths), heading_rad).snr_db
    return replace(paths, gain=phase * 10 ** ((rng.uniform(*DRAWN_SNR_DB, N_DRAWN) - snr_db) / 20))


def fit_cost(stop: str, sweep: BeamSweep, settings: MaximumLikelihoodConfig, limit: int, pairs: int) -> FitCost:
    """The fit of at most `limit` paths beside FFT passes over the sweep, in turns, after a first call of each."""
    limited = settings.model_copy(update={"max_paths": limit})
    found: list[PathFit] = []

    def fit() -> None:
        found[:] = [fit_over_background(sweep, limited)]

    def passes() -> None:
        for _ in range(N_PASSES):
            scipy.fft.fft(sweep.samples, axis=-1)

    ratios, times_s = paired_ratios(fit, passes, pairs)
    fit_ms, passes_ms = (1e3 * np.median(times_s, axis=0)).tolist()
    return FitCost(stop, limit, len(found[0]), N_PASSES * ratios, fit_ms, passes_ms / N_PASSES)


def dense_rows(costs: list[FitCost]) -> list[Measurement]:
    """The rows of the measured limits: those of 120 paths only where these were fitted."""
    first = {cost.stop: cost for cost in costs if cost.limit == LIMITS[0]}
    growth = {cost.per_path / first[cost.stop].per_path: cost for cost in costs if cost.limit > LIMITS[0]}
    highest, most = max(costs, key=lambda cost: cost.per_path), max(growth)
    linear = f"time per path over that of {LIMITS[0]} paths; {growth[most].words}"
    rows = [
        at_most("channel.dense.passes_per_path", highest.per_path, MOST_PER_PATH, highest.words, "FFT passes"),
        at_most("channel.dense.growth_over_linear", most, MOST_GROWTH, linear),
    ]
    many = [cost for cost in costs if cost.limit == 120]
    if many:
        slowest = max(many, key=lambda cost: cost.median)
        ratio = {cost.median / first[cost.stop].median: cost for cost in many}
        worst = ratio[max(ratio)]
        beside = f"{worst.words}, beside {first[worst.stop].words}"
        rows += [
            at_most("channel.dense.passes_120", slowest.median, MOST_PASSES, slowest.words, "FFT passes"),
            at_most("channel.dense.120_over_30", max(ratio), MOST_RATIO, beside),
        ]
    return rows


def cost_table(costs: list[FitCost]) -> InfoTable:
    """Every fit with its times and their spread."""
    columns = ("stop", "limit", "paths", "fit in ms", "FFT pass in ms", "passes", "least", "most", "per path")
    rows = tuple(
        (
            cost.stop, cost.limit, cost.n_paths, cost.fit_ms, cost.pass_ms, cost.median,
            float(cost.passes.min()), float(cost.passes.max()), cost.per_path,
        )
        for cost in costs
    )  # fmt: skip
    return InfoTable("The coherent fit over the number of its paths", columns, rows)
