"""`arena validate channel`: how often noise alone makes a path, against the nominal probability.

Coherent trials draw the noise after compression: white, of unit power, on the span of the beams and all delay
bins. Everything after that is the estimator's own code. One row uses whole sweeps, to show that both agree. The
1e-3 row needs 100,000 trials and has them on 432 subcarriers, not 3,168: the period, and the share of it where
paths are expected, are the same. Incoherent trials, and a user's estimator, get whole sweeps.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from estimation.channel.coherent.diffuse import fit_over_background
from estimation.channel.coherent.paths import fit_paths
from estimation.channel.coherent.plan import SearchPlan, delay_window, nominal_manifold, search_plan
from estimation.channel.config import MaximumLikelihoodConfig
from estimation.channel.fit import PathFit
from estimation.channel.incoherent.paths import fit_incoherent
from estimation.channel.model.compress import DelayCube, compress, noise_scale_of
from isac_arena.validation.channel.efficiency import TRIALS, make_estimator
from isac_arena.validation.measurement import Measurement, at_most
from isac_arena.validation.monte_carlo import most_by_chance
from isac_arena.validation.scenarios.link_bench import LinkBench, make_bench, noise_stop, with_bandwidth
from scenes.record import ComplexArray
from sim.observation import BeamSweep

FEW_RB = 36

Fit = Callable[[BeamSweep, MaximumLikelihoodConfig], PathFit]


@dataclass(frozen=True)
class NoiseRow:
    """Trials of a method at a nominal probability; coherent ones are compressed unless `whole` sweeps."""

    method: str
    probability: float
    n_trials: int
    n_rb: int = 264
    whole: bool = False

    @property
    def key(self) -> str:
        """Name of the row."""
        return f"{self.method}.false_alarm_{self.probability:g}{'_whole_sweeps' if self.whole else ''}"

    def hits(self, seed: int, n_trials: int) -> int:
        """Trials with a path."""
        bench, rng = with_bandwidth(make_bench(seed), self.n_rb), np.random.default_rng([seed, 5])
        if self.method == "coherent" and not self.whole:
            return compressed_hits(bench, rng, self.probability, n_trials)
        return sweep_hits(bench, rng, METHODS[self.method], self.probability, n_trials)


METHODS: dict[str, Fit] = {"coherent": fit_over_background, "incoherent": fit_incoherent}
QUICK = (
    NoiseRow("coherent", 0.1, 20), NoiseRow("coherent", 0.1, 10, whole=True), NoiseRow("incoherent", 0.1, 10),
)  # fmt: skip
FULL = (
    NoiseRow("coherent", 1e-2, 10_000), NoiseRow("coherent", 1e-3, 100_000, FEW_RB),
    NoiseRow("coherent", 0.1, 1_000, whole=True), NoiseRow("incoherent", 1e-2, 2_000),
)  # fmt: skip


def check_false_alarms(seed: int, quick: bool, trials: int = 0, estimator: str = "") -> list[Measurement]:
    """Rate of stops with a path in noise alone, over the nominal one: 0.5 to 1.5."""
    if estimator:
        return [_user_rate(make_bench(seed), trials or (QUICK[0].n_trials if quick else 1000), estimator)]
    rows = []
    for row in QUICK if quick else FULL:
        n = max(1, round(row.n_trials * trials / TRIALS)) if trials else row.n_trials
        rows.append(false_alarm_row(row.key, row.hits(seed, n), n, row.probability, quick))
    return rows


def compressed_hits(bench: LinkBench, rng: np.random.Generator, probability: float, n_trials: int) -> int:
    """Trials in which the coherent method finds a path in noise that is drawn compressed."""
    plan, template = noise_template(bench)
    config = MaximumLikelihoodConfig(false_alarm_probability=probability)
    shape = template.spectrum.shape
    hits = 0
    for _ in range(n_trials):
        spectrum = white_noise(rng, shape)
        cube = replace(template, spectrum=spectrum, noise_scale=noise_scale_of(spectrum))
        window = delay_window(cube, plan, config)
        if window is not None:
            hits += len(fit_paths(cube.window(window.position), window, plan, config).paths) > 0
    return hits


def sweep_hits(bench: LinkBench, rng: np.random.Generator, fit: Fit, probability: float, n_trials: int) -> int:
    """Trials in which a method finds a path in whole sweeps of noise."""
    config = MaximumLikelihoodConfig(false_alarm_probability=probability)
    template = noise_stop(bench, 0)
    scale = np.sqrt(bench.link.noise_power_mw)[:, None].astype(np.float32)
    hits = 0
    for _ in range(n_trials):
        samples = white_noise(rng, template.samples.shape) * scale
        hits += len(fit(replace(template, samples=samples), config)) > 0
    return hits


def noise_template(bench: LinkBench) -> tuple[SearchPlan, DelayCube]:
    """The search plan of a link, and a compressed sweep of noise on its beams."""
    link = bench.link
    manifolds = nominal_manifold(link.tx_codebook), nominal_manifold(link.rx_codebook)
    noise_mw = tuple(link.noise_power_mw.tolist())
    plan = search_plan(*manifolds, noise_mw, MaximumLikelihoodConfig().oversampling)
    return plan, compress(noise_stop(bench, 0), plan.tx, plan.rx)


def white_noise(rng: np.random.Generator, shape: tuple[int, ...]) -> ComplexArray:
    """Circular Gaussian noise of unit power, complex64."""
    parts = rng.standard_normal((*shape, 2), dtype=np.float32)
    parts *= np.float32(np.sqrt(0.5))
    return np.asarray(parts.view(np.complex64)[..., 0])


def false_alarm_row(key: str, hits: int, n_trials: int, probability: float, quick: bool) -> Measurement:
    """Deviation of the rate over the nominal one from 1, at most 0.5."""
    over = hits / n_trials / probability
    expected = n_trials * probability
    bar = most_by_chance(1.5 * expected) / expected - 1 if quick else 0.5
    reason = f"{over:.2f} of nominal: {hits} in {n_trials} trials"
    return at_most(f"{key}_deviation", abs(over - 1), bar, reason)


def _user_rate(bench: LinkBench, n_trials: int, estimator: str) -> Measurement:
    """A user's estimator has its own nominal probability, which must be 1e-2 at most."""
    estimate = make_estimator("coherent", estimator)
    hits = sum(len(estimate(noise_stop(bench, stop))) > 0 for stop in range(n_trials))
    rate = hits / n_trials
    return at_most("estimator.false_alarm_rate", rate, 1e-2, f"{hits} in {n_trials} stops of noise")
