"""Choose the likelihood of a sweep: test whether the phases of its beam pairs are coherent.

A coherent fit gains resolution and 2 dB of detection, but unknown phases ruin it. So the incoherent fit comes
first, of the strongest paths, or of all paths if these are not conclusive. It estimates the phase of every beam
pair that a path illuminates. A constant frequency offset makes these phases a linear ramp over the TX beams and
over the RX beams, in either order of a sweep. The rms residual of that ramp, corrected for noise, decides: if it
is small, the ramp is removed and the sweep is fitted coherently. Phases that wander are not tracked: the phases of
the paths would absorb them, and the coherent covariance would take them as known.

Where many paths share beam pairs and delays, a few of them do not explain the phases. Then all paths of a coherent
fit are the reference, and the phases of the pairs against their sum decide. What even this fit leaves out turns
phases and scales magnitudes alike; unknown phases leave the magnitudes as they are.
"""

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import scipy.fft

from estimation.channel.coherent.diffuse import fit_over_background
from estimation.channel.coherent.plan import nominal_manifold
from estimation.channel.config import MaximumLikelihoodConfig
from estimation.channel.fit import PathFit
from estimation.channel.incoherent.clock_drift import without_drift
from estimation.channel.incoherent.paths import IncoherentFit, fit_incoherent
from scenes.pose import wrap_angle
from scenes.record import BoolArray, FloatArray, IntArray
from sim.observation import BeamSweep
from sim.signal.waveform.prs import PREFIX_SHARE

LARGEST_RESIDUAL_RAD = np.deg2rad(10.0)  # rms without noise, of phases that count as coherent
DOUBTFUL_RAD = np.deg2rad(45.0)  # residual of a few paths up to which all paths decide; random phases show 104 deg
_TELLING_PATHS = 12  # strongest paths that are fitted first: the others change little if phases are coherent
_LEAST_SNR = 6.0  # of a pair whose phase is used: its phase noise has a standard deviation of at most 17 deg
_LEAST_PAIRS = 4  # degrees of freedom of the residual
_CONFIDENCE = 1.64  # standard deviations by which the residual must be below its limit: 95 %
_ZERO_PADDING = 4
_REFINEMENTS = 6
_LEAST_VARIANCE = np.deg2rad(1.0) ** 2  # of the residual, in the weights


@dataclass(frozen=True)
class PhaseRamp:
    """A linear phase ramp over the beam pairs, and the residual phases.

    Attributes
    ----------
    tx_step_rad, rx_step_rad : phase step from one TX beam, and from one RX beam, to the next
    residual_rad : rms of the residual phases, corrected for noise and for undetected paths
    upper_rad : its upper confidence limit
    walk_rad : rms change of the residual from one RX beam to the next, corrected for noise
    n_pairs : beam pairs whose phases were used; if they are too few, 0, and all other attributes are NaN
    """

    tx_step_rad: float
    rx_step_rad: float
    residual_rad: float
    upper_rad: float
    walk_rad: float
    n_pairs: int

    @property
    def is_coherent(self) -> bool:
        """Whether the phases fit the ramp well enough for a coherent fit."""
        return self.n_pairs > 0 and self.upper_rad <= LARGEST_RESIDUAL_RAD

    def frequency_offset_hz(self, n_rx: int, pair_s: float) -> float:
        """Frequency offset that causes the ramp if each pair takes `pair_s`, all RX beams of a TX beam in turn.

        The step between TX beams, `n_rx` pairs apart, is precise but ambiguous; that between RX beams resolves it.
        """
        turns = np.rint((n_rx * self.rx_step_rad - self.tx_step_rad) / (2 * np.pi))
        return float((self.tx_step_rad / (2 * np.pi) + turns) / (n_rx * pair_s))


@dataclass(frozen=True)
class AutoFit:
    """A fit, the chosen mode, and the reason."""

    fit: PathFit
    mode: Literal["coherent", "incoherent"]
    ramp: PhaseRamp
    frequency_offset_hz: float  # that causes the ramp, if each pair takes one symbol of the sounded spacing
    reason: str


def fit_auto(sweep: BeamSweep, config: MaximumLikelihoodConfig | None = None) -> AutoFit:
    """Paths of one stop by the likelihood that its phases allow; errors are those of `fit_incoherent`."""
    config = config or MaximumLikelihoodConfig()
    few = config.model_copy(update={"max_paths": min(config.max_paths, _TELLING_PATHS)})
    incoherent = fit_incoherent(sweep, few)
    ramp = fit_phase_ramp(phases_of(incoherent))
    if ramp.is_coherent or ramp.residual_rad <= DOUBTFUL_RAD:
        steady = without_drift(sweep, incoherent.drift_s)
        joint = ramp if ramp.is_coherent else _joint_ramp(steady, ramp, few)
        coherent = fit_over_background(without_phase_ramp(steady, joint.tx_step_rad, joint.rx_step_rad), config)
        if not ramp.is_coherent:
            joint = fit_phase_ramp(phases_against(steady, coherent))
        if len(coherent) and joint.is_coherent:
            offset_hz = _frequency_offset_hz(sweep, joint)
            return AutoFit(coherent, "coherent", joint, offset_hz, "coherent: " + _words(joint, offset_hz))
    if few.max_paths <= len(incoherent) < config.max_incoherent_paths:
        incoherent = fit_incoherent(sweep, config)
    offset_hz = _frequency_offset_hz(sweep, ramp)
    words = "; ".join(part for part in (_words(ramp, offset_hz), incoherent.caveat) if part)
    return AutoFit(incoherent, "incoherent", ramp, offset_hz, "incoherent: " + words)


def _joint_ramp(sweep: BeamSweep, ramp: PhaseRamp, few: MaximumLikelihoodConfig) -> PhaseRamp:
    """The ramp against the sum of a few coherent paths; they are fitted without it, and without any ramp.

    A ramp that turns the phases over the whole sweep by less than the limit is left: undetected paths make such
    ramps.
    """
    found = []
    for steps in ((0.0, 0.0), (ramp.tx_step_rad, ramp.rx_step_rad)):
        back = without_phase_ramp(sweep, *steps)
        rest = fit_phase_ramp(phases_against(back, fit_over_background(back, few)))
        found.append(
            replace(rest, tx_step_rad=rest.tx_step_rad + steps[0], rx_step_rad=rest.rx_step_rad + steps[1])
        )
    best = min(found, key=lambda one: one.residual_rad if one.n_pairs else np.inf)
    best = best if best.n_pairs else ramp
    over_sweep = np.abs([best.tx_step_rad, best.rx_step_rad]) * sweep.samples.shape[:2]
    return best if over_sweep.max() > LARGEST_RESIDUAL_RAD else replace(best, tx_step_rad=0.0, rx_step_rad=0.0)


def _frequency_offset_hz(sweep: BeamSweep, ramp: PhaseRamp) -> float:
    """Frequency offset that causes a ramp if each pair takes one symbol of the sounded spacing."""
    spacing_hz = float(np.ptp(sweep.frequency_offset_hz)) / (sweep.samples.shape[2] - 1)
    return ramp.frequency_offset_hz(sweep.samples.shape[1], (1 + PREFIX_SHARE["normal"]) / spacing_hz)


@dataclass(frozen=True)
class PairPhases:
    """Phases of beam pairs (tx_beam, rx_beam) against a reference path, with their SNR.

    Attributes
    ----------
    path : (tx_beam, rx_beam) reference of each pair; phases of different ones have no common zero
    residual : (tx_beam, rx_beam) energy that the reference does not explain, over the noise
    is_usable : (tx_beam, rx_beam) the reference is not one of several ambiguous directions
    log_magnitude : (tx_beam, rx_beam) logarithm of the amplitude over the reference's, None where that is fitted
    """

    phase_rad: FloatArray
    snr: FloatArray
    residual: FloatArray
    path: IntArray
    is_usable: BoolArray
    log_magnitude: FloatArray | None = None


def phases_of(fit: IncoherentFit) -> PairPhases:
    """The phases of an incoherent fit."""
    usable = ~fit.is_ambiguous[fit.pair_path] if len(fit) else np.zeros(fit.pair_path.shape, bool)
    return PairPhases(fit.pair_phase_rad, fit.pair_snr, fit.pair_residual, fit.pair_path, usable)


def phases_against(sweep: BeamSweep, fit: PathFit) -> PairPhases:
    """The phases of a sweep against the sum of all paths of a coherent fit."""
    tx = nominal_manifold(sweep.tx_codebook).response(fit.aod_rad)
    rx = nominal_manifold(sweep.rx_codebook).response(fit.aoa_rad)
    gain = fit.amplitude * np.exp(1j * fit.phase_rad)
    wave = np.exp(-2j * np.pi * fit.delay_s[:, None] * sweep.frequency_offset_hz).astype(np.complex64)
    shape, noise = sweep.samples.shape[:2], sweep.noise_power_mw
    product, model, energy = np.zeros(shape, complex), np.zeros(shape), np.zeros(shape)
    for beam in range(shape[0]):
        expected = ((gain * tx[:, beam])[:, None] * rx).T.astype(np.complex64) @ wave
        samples = sweep.samples[beam] * sweep.prs_symbol[beam].conj()
        product[beam] = (expected.conj() * samples).sum(axis=1) / noise
        model[beam] = np.square(np.abs(expected)).sum(axis=1) / noise
        energy[beam] = np.square(np.abs(samples)).sum(axis=1) / noise
    tiny = np.finfo(float).tiny
    unexplained = energy - np.square(np.abs(product)) / np.maximum(model, tiny)
    return PairPhases(
        phase_rad=np.angle(product),
        snr=model,
        residual=np.maximum(unexplained - sweep.samples.shape[2], 0.0),
        path=np.zeros(shape, int),
        is_usable=np.ones(shape, bool),
        log_magnitude=np.log(np.maximum(np.abs(product), tiny) / np.maximum(model, tiny)),
    )


def without_phase_ramp(sweep: BeamSweep, tx_step_rad: float, rx_step_rad: float) -> BeamSweep:
    """The sweep with a linear phase ramp over its TX beams and RX beams removed."""
    n_tx, n_rx = sweep.samples.shape[:2]
    phase = tx_step_rad * np.arange(n_tx)[:, None] + rx_step_rad * np.arange(n_rx)
    return replace(sweep, samples=sweep.samples * np.exp(-1j * phase).astype(np.complex64)[:, :, None])


def fit_phase_ramp(pairs: PairPhases) -> PhaseRamp:
    """The linear phase ramp that explains most of the phases of beam pairs.

    Phases of different paths have no common reference, so every path has a constant of its own. The ramp is the
    maximum over both steps nu of sum_i |sum over the pairs p of path i of w_p exp(j psi_p - j nu^T p)|, refined by
    least squares. Weights follow the noise and the variance of the previous iteration. Pairs with a large residual
    count less: undetected paths in it can change their phases. They change the magnitudes as much, for their own
    phases are independent: the variance of the logarithms of the magnitudes is taken off that of the phases.
    """
    n_rx = pairs.snr.shape[1]
    used = np.flatnonzero(((pairs.snr > _LEAST_SNR) & pairs.is_usable).ravel())
    path = pairs.path.ravel()[used]
    several = np.bincount(path, minlength=1)[path] > 1  # one pair determines only its path's constant
    used, path = used[several], path[several]
    pair = np.stack(np.divmod(used, n_rx), axis=1)
    phase, snr = pairs.phase_rad.ravel()[used], pairs.snr.ravel()[used]
    noise, hidden = _phase_variance(snr), 0.5 * pairs.residual.ravel()[used] / snr
    n_free = len(used) - len(np.unique(path)) - 2
    if n_free < _LEAST_PAIRS:
        return PhaseRamp(np.nan, np.nan, np.nan, np.nan, np.nan, 0)
    variance = LARGEST_RESIDUAL_RAD**2
    step = _strongest_ramp(pair, phase, path, 1 / (noise + hidden + variance), pairs.snr.shape)
    for _ in range(_REFINEMENTS):
        weight = 1 / (noise + hidden + max(variance, _LEAST_VARIANCE))
        centred = pair - np.stack([_path_means(axis.astype(float), path, weight) for axis in pair.T], axis=1)
        residual = _remainder(pair, phase, path, weight, step)
        # An unobservable step, as with a single beam, stays.
        step = step + np.linalg.pinv((centred * weight[:, None]).T @ centred) @ (centred.T @ (weight * residual))
        residual = _remainder(pair, phase, path, weight, step)
        variance = float((weight * (residual**2 * len(used) / n_free - noise)).sum() / weight.sum())
    error = np.sqrt(2 * (weight**2 * (noise + max(variance, 0.0)) ** 2).sum()) / weight.sum()
    if pairs.log_magnitude is not None:
        log_magnitude = pairs.log_magnitude.ravel()[used]
        off = log_magnitude - _path_means(log_magnitude, path, weight)
        unmodelled = float((weight * (off**2 * len(used) / n_free - noise)).sum() / weight.sum())
        variance, error = variance - max(unmodelled, 0.0), np.sqrt(2) * error
    return PhaseRamp(
        tx_step_rad=float(wrap_angle(step[0])),
        rx_step_rad=float(wrap_angle(step[1])),
        residual_rad=float(np.sqrt(max(variance, 0.0))),
        upper_rad=float(np.sqrt(max(variance + _CONFIDENCE * error, 0.0))),
        walk_rad=_walk(used, path, residual, noise),
        n_pairs=len(used),
    )


def _phase_variance(snr: FloatArray) -> FloatArray:
    """Variance of the phase of a pair of SNR g, to second order: 1 / (2 g) + 1 / (4 g^2)."""
    return np.asarray(0.5 / snr + 0.25 / snr**2)


def _strongest_ramp(
    pair: IntArray, phase: FloatArray, path: IntArray, weight: FloatArray, shape: tuple[int, ...]
) -> FloatArray:
    """Steps (2,) on a fine grid at which the phases of all paths add up best."""
    size = [scipy.fft.next_fast_len(_ZERO_PADDING * n) for n in shape]
    total = np.zeros(size)
    for i in np.unique(path):
        of_path = path == i
        plane = np.zeros(size, complex)
        plane[pair[of_path, 0], pair[of_path, 1]] = weight[of_path] * np.exp(1j * phase[of_path])
        total += np.abs(scipy.fft.fft2(plane))
    best = np.unravel_index(int(np.argmax(total)), total.shape)
    return np.asarray(2 * np.pi * np.array(best) / size)


def _remainder(
    pair: IntArray, phase: FloatArray, path: IntArray, weight: FloatArray, step: FloatArray
) -> FloatArray:
    """Residual phases after removal of a ramp and of a constant per path."""
    turned = phase - pair @ step
    phasor = np.exp(1j * turned)
    real, imaginary = (_path_means(part, path, weight) for part in (phasor.real, phasor.imag))
    return np.asarray(wrap_angle(turned - np.arctan2(imaginary, real)))


def _path_means(values: FloatArray, path: IntArray, weight: FloatArray) -> FloatArray:
    """Weighted mean over the pairs of the same path, for every pair."""
    return np.asarray((np.bincount(path, weight * values) / np.maximum(np.bincount(path, weight), 1e-300))[path])


def _walk(pair: IntArray, path: IntArray, residual: FloatArray, noise: FloatArray) -> float:
    """Rms change of the residual between neighbouring pairs of a path, corrected for noise; NaN without any."""
    next_to = (np.diff(pair) == 1) & (np.diff(path) == 0)
    if not next_to.any():
        return np.nan
    change = wrap_angle(np.diff(residual))[next_to] ** 2 - (noise[1:] + noise[:-1])[next_to]
    return float(np.sqrt(max(change.mean(), 0.0)))


def _words(ramp: PhaseRamp, offset_hz: float) -> str:
    if not ramp.n_pairs:
        return "too few beam pairs have a phase to test"
    limit = np.rad2deg(LARGEST_RESIDUAL_RAD)
    text = (
        f"phases of {ramp.n_pairs} beam pairs follow a ramp of {np.rad2deg(ramp.tx_step_rad):.3g} deg per TX beam"
        f" and {np.rad2deg(ramp.rx_step_rad):.3g} deg per RX beam ({offset_hz:.4g} Hz at one symbol per pair)"
        f" with a residual of {np.rad2deg(ramp.residual_rad):.2g} deg rms, at most"
        f" {np.rad2deg(ramp.upper_rad):.2g} deg; the limit is {limit:.0f} deg"
    )
    if ramp.upper_rad > LARGEST_RESIDUAL_RAD and np.isfinite(ramp.walk_rad):
        text += f"; from one pair to the next they change by {np.rad2deg(ramp.walk_rad):.2g} deg rms"
    return text
