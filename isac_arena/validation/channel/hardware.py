"""`arena validate channel`: effects of hardware and rooms: element errors, a CFO, dense diffuse multipath."""

from collections.abc import Iterator
from dataclasses import replace
from itertools import islice

import numpy as np

from estimation.channel.calibration.self_calibration import self_calibrate
from estimation.channel.record import ChannelEstimate
from isac_arena.scoring.metrics.statistics import mean, squared_mahalanobis
from isac_arena.validation.channel import matching
from isac_arena.validation.channel.efficiency import UNIFORM_DEG, make_estimator, scaled, scene_paths
from isac_arena.validation.measurement import Measurement, at_most
from isac_arena.validation.monte_carlo import most_by_chance, quick_bar
from isac_arena.validation.scenarios import link_bench
from isac_arena.validation.scenarios.link_bench import ChannelStop, LinkBench
from scenes.record import FloatArray
from sim.observation import BeamSweep
from sim.signal.hardware.apply_impairments import impaired_codebooks

CALIBRATION_STOPS = 20
QUICK_STOPS = 6  # of the 20 that are calibrated on, estimated in a quick run
ELEMENT_ERRORS = {"element_phase_std_deg": 10.0, "element_gain_std_db": 1.0}
CFO_HZ = 150.0
BACKGROUND_DB = 10.0  # below the path
PATH_DB = 30.0  # SNR of the path before the background
CALIBRATED_MIN_DB = 15.0
CHOICES: dict[str, tuple[dict[str, float], ...]] = {
    "coherent": (
        {}, {"cfo_hz": CFO_HZ}, {"cfo_hz": -2000.0}, {"cfo_hz": 2000.0, "phase_noise_linewidth_hz": 500.0}
    ),
    "incoherent": (
        *({"phase_noise_pair_deg": step} for step in (5.0, 25.0, UNIFORM_DEG)), {"beam_phase_std_deg": 60.0}
    ),
}  # fmt: skip
# a linewidth of 500 Hz gives 5 deg rms, a walk of 5 deg from pair to pair 25 deg; the limit is 10 deg


def check_element_errors(seed: int, quick: bool, trials: int = 0, estimator: str = "") -> list[Measurement]:
    """Arrays with 10 deg and 1 dB element errors, calibrated on the 20 stops that are then estimated.

    Angle errors are errors of the sine, less their mean over a campaign and device: a phase that is linear over
    the aperture shifts all sines by the same amount and is unobservable. The reference are the errors of the same
    stops with the true responses.
    """
    estimate = make_estimator("coherent", estimator)
    campaigns = 1 if quick else max(1, scaled(trials, quick, 0.04) // CALIBRATION_STOPS)
    errors: list[FloatArray] = []
    n_false: list[int] = []
    for campaign in range(campaigns):
        bench = link_bench.make_bench(seed + campaign, **ELEMENT_ERRORS)
        calibration = self_calibrate(stop.sweep for stop in _campaign(bench, seed, campaign))
        tx, rx = impaired_codebooks(bench.config, bench.link)
        pairs = []
        for stop in islice(_campaign(bench, seed, campaign), QUICK_STOPS if quick else CALIBRATION_STOPS):
            known = replace(stop.sweep, tx_codebook=tx, rx_codebook=rx)
            places, false = _two_errors(bench, stop, estimate, [calibration.applied(stop.sweep), known])
            pairs.append(places)
            n_false.append(false)
        sine_errors = np.concatenate(pairs)
        errors.append(sine_errors - sine_errors.mean(axis=0))  # less the constant offset of either device
    rms = np.sqrt(np.mean(np.square(np.concatenate(errors)), axis=0))
    n = sum(map(len, errors))
    rows = [matching.false_row("element_errors.false_per_stop", np.array(n_false), 0.02, quick)]
    for name, ratio in zip(("aod", "aoa"), rms[0] / rms[1], strict=True):
        bar = quick_bar(1.1, 1.1 / np.sqrt(n), quick)
        reason = f"{n} paths from {CALIBRATED_MIN_DB:g} dB on"
        rows.append(at_most(f"element_errors.{name}_rmse_over_known", ratio, bar, reason))
    return rows


def check_cfo(seed: int, quick: bool, trials: int = 0, estimator: str = "") -> list[Measurement]:
    """A carrier frequency offset of 150 Hz to either side over the sweep, against the bound without it."""
    estimate, plain = make_estimator("auto", estimator), link_bench.make_bench(seed)
    count = scaled(trials, quick, 0.15 if quick else 0.04)

    def stops() -> Iterator[ChannelStop]:
        for index in range(count):
            bench = link_bench.with_settings(plain, cfo_hz=CFO_HZ if index % 2 else -CFO_HZ)
            yield link_bench.observe_paths(bench, scene_paths(bench, seed, index), index)

    table = matching.run_stops(plain, stops(), estimate, coherent=True)
    return matching.efficiency_rows("cfo150", table, min_snr_db=12, bars=(1.10, 1.10), quick=quick)


def check_choice(seed: int, quick: bool, trials: int = 0, estimator: str = "") -> list[Measurement]:
    """Whether `auto` fits coherently if phases are kept or rotate evenly, and only then.

    Scenes with no impairment, with frequency offsets, and with phases of pairs or beams that no offset explains.
    """
    estimate, plain = make_estimator("auto", estimator), link_bench.make_bench(seed)
    count = scaled(trials, quick, 0.1 if quick else 0.02)
    rows = []
    for mode, cases in CHOICES.items():
        right = []
        for case, impairments in enumerate(cases):
            bench = link_bench.with_settings(plain, **impairments)
            for index in range(count):
                paths = scene_paths(bench, seed + 2, case * count + index)
                found = estimate(link_bench.observe_paths(bench, paths, index).sweep)
                right.append(found.reason.startswith(mode))
        reason = f"{mode} is right: {', '.join(map(_words, cases))}"
        rows.append(matching.rate_row(f"auto.chooses_{mode}", np.array(right), 0.95, reason, quick))
    return rows


def check_diffuse(seed: int, quick: bool, trials: int = 0, estimator: str = "") -> list[Measurement]:
    """One path over dense diffuse multipath 10 dB below it in total power, with phases kept and lost."""
    rows = []
    cases = (("coherent", 0.0, 1.0), ("incoherent", UNIFORM_DEG, 0.5), ("auto", 0.0, 0.5))
    for method, phase_deg, share in cases:
        estimate = make_estimator(method, estimator)
        bench = link_bench.make_bench(seed, phase_noise_pair_deg=phase_deg)
        rng = np.random.default_rng([seed, 4])
        extra, nees = [], []
        for index in range(scaled(trials, quick, share * (0.25 if quick else 0.08))):
            paths = link_bench.single_path(rng, PATH_DB)
            background = link_bench.diffuse_background(rng, bench, paths, below_db=BACKGROUND_DB)
            stop = link_bench.observe_paths(bench, paths, index, background)
            found = estimate(stop.sweep)
            nees += _nees(bench, stop, found)
            extra.append(len(found) - 1)
        rows += _diffuse_rows("" if method == "coherent" else f".{method}", extra, nees, quick)
    return rows


def _diffuse_rows(suffix: str, extra: list[int], nees: list[float], quick: bool) -> list[Measurement]:
    key, n = f"diffuse10db{suffix}", len(extra)
    most = most_by_chance(0.3 * n) / n if quick else 0.3
    nees_bar = quick_bar(1.5, 1.5 * np.sqrt(2 / 3 / n), quick)
    reason = f"NEES over 3 of {len(nees)} found paths; the background adds to the noise"
    return [
        at_most(f"{key}.extra_per_stop", np.mean(extra), most, f"{n} stops", "per stop"),
        at_most(f"{key}.nees", mean(nees) / 3, nees_bar, reason),
    ]


def _words(impairments: dict[str, float]) -> str:
    return " and ".join(f"{name} {value:g}" for name, value in impairments.items()) or "ideal"


def _campaign(bench: LinkBench, seed: int, campaign: int) -> Iterator[ChannelStop]:
    """The stops of one campaign, one after the other, because they do not fit in memory together."""
    for stop in range(CALIBRATION_STOPS):
        paths = scene_paths(bench, seed, campaign * CALIBRATION_STOPS + stop)
        yield link_bench.observe_paths(bench, paths, stop)


def _two_errors(
    bench: LinkBench, stop: ChannelStop, estimate: matching.Estimator, sweeps: list[BeamSweep]
) -> tuple[FloatArray, int]:
    """Errors (path, sweep, 2) in both sines of separated paths found in every sweep; false paths in the first."""
    bounds = link_bench.true_bounds(bench, stop, coherent=True)
    errors, n_false = [], []
    for sweep in sweeps:
        found = estimate(sweep)
        match, false = matching.match_stop(bench, stop, found, bounds)
        hit, error = match >= 0, np.full((len(match), 2), np.nan)
        error[hit] = (matching.estimate_places(found)[match[hit]] - stop.paths.cells[hit])[:, 1:]
        errors.append(error)
        n_false.append(false)
    both = np.stack(errors, axis=1)
    use = np.isfinite(both).all(axis=(1, 2)) & (stop.paths.snr_db >= CALIBRATED_MIN_DB)
    return both[use & (bounds.separation >= link_bench.SEPARATED_CELLS)], n_false[0]


def _nees(bench: LinkBench, stop: ChannelStop, found: ChannelEstimate) -> list[float]:
    """Squared error in units of the reported covariance, of the path where it was found."""
    match, _ = matching.match_stop(bench, stop, found, link_bench.true_bounds(bench, stop, coherent=True))
    if match[0] < 0:
        return []
    error = found.plane_parameters[match] - stop.paths.parameters
    return list(squared_mahalanobis(error, found.covariance[match, :3, :3]))
