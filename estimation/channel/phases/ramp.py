"""A linear ramp of the phases over TX and RX beams, as a constant frequency offset makes it."""

from dataclasses import dataclass

import numpy as np
import scipy.fft

from estimation.channel.phases.pairs import LEAST_SNR, PairPhases, phase_variance, without_phases
from scenes.pose import wrap_angle
from scenes.record import FloatArray, IntArray
from sim.observation import BeamSweep

LARGEST_RESIDUAL_RAD = np.deg2rad(10.0)  # rms without noise, of phases that count as coherent
_LEAST_PAIRS = 4  # degrees of freedom of the residual
_CONFIDENCE = 1.64  # standard deviations by which the residual must be below its limit: 95 %
_ZERO_PADDING = 4
_STRONG_SHARE = 0.1  # of the pairs: the strongest, whose phases undetected paths hardly turn
_LEAST_STRONG = 100  # of them: paths would follow the phases of fewer, whatever these are
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


def without_phase_ramp(sweep: BeamSweep, tx_step_rad: float, rx_step_rad: float) -> BeamSweep:
    """The sweep with a linear phase ramp over its TX beams and RX beams removed."""
    n_tx, n_rx = sweep.samples.shape[:2]
    return without_phases(sweep, tx_step_rad * np.arange(n_tx)[:, None] + rx_step_rad * np.arange(n_rx))


def fit_phase_ramp(pairs: PairPhases) -> PhaseRamp:
    """The linear phase ramp that explains most of the phases of beam pairs.

    Phases of different paths have no common reference, so every path has a constant of its own. The ramp is the
    maximum over both steps nu of sum_i |sum over the pairs p of path i of w_p exp(j psi_p - j nu^T p)|, refined by
    least squares. Weights follow the noise and the variance of the previous iteration. Pairs with a large residual
    count less: undetected paths in it can change their phases. They change the magnitudes as much, for their own
    phases are independent: the variance of the logarithms of the magnitudes is taken off that of the phases. In
    weak pairs it is not enough, where undetected paths are as strong as the others. An oscillator turns strong
    pairs too, so the smaller of two residuals holds: of all pairs, and of the strongest.
    """
    n_rx = pairs.snr.shape[1]
    used = np.flatnonzero(((pairs.snr > LEAST_SNR) & pairs.is_usable).ravel())
    path = pairs.path.ravel()[used]
    several = np.bincount(path, minlength=1)[path] > 1  # one pair determines only its path's constant
    used, path = used[several], path[several]
    pair = np.stack(np.divmod(used, n_rx), axis=1)
    phase, snr = pairs.phase_rad.ravel()[used], pairs.snr.ravel()[used]
    noise, hidden = phase_variance(snr), 0.5 * pairs.residual.ravel()[used] / snr
    n_free = len(used) - len(np.unique(path)) - 2
    if n_free < _LEAST_PAIRS:
        return PhaseRamp(np.nan, np.nan, np.nan, np.nan, np.nan, 0)
    variance = LARGEST_RESIDUAL_RAD**2
    step = _strongest_ramp(pair, phase, path, 1 / (noise + hidden + variance), pairs.snr.shape)
    groups: list[slice | IntArray] = [slice(None)]
    n_strong = int(_STRONG_SHARE * len(used))
    if pairs.log_magnitude is not None and n_strong >= _LEAST_STRONG:
        groups.append(np.argsort(-snr, kind="stable")[:n_strong])
    for _ in range(_REFINEMENTS):
        weight = 1 / (noise + hidden + max(variance, _LEAST_VARIANCE))
        centred = pair - np.stack([_path_means(axis.astype(float), path, weight) for axis in pair.T], axis=1)
        residual = _remainder(pair, phase, path, weight, step)
        # An unobservable step, as with a single beam, stays.
        step = step + np.linalg.pinv((centred * weight[:, None]).T @ centred) @ (centred.T @ (weight * residual))
        residual = _remainder(pair, phase, path, weight, step)
        square = residual**2 * len(used) / n_free - noise
        variance = min(float(np.average(square[some], weights=weight[some])) for some in groups)
    squares = [square]
    if pairs.log_magnitude is not None:
        log_magnitude = pairs.log_magnitude.ravel()[used]
        off = log_magnitude - _path_means(log_magnitude, path, weight)
        squares.append(off**2 * len(used) / n_free - noise)
    found = [_beyond(weight[some], [one[some] for one in squares], noise[some]) for some in groups]
    variance, error = min(found, key=lambda one: one[0] + _CONFIDENCE * one[1])
    return PhaseRamp(
        tx_step_rad=float(wrap_angle(step[0])),
        rx_step_rad=float(wrap_angle(step[1])),
        residual_rad=float(np.sqrt(max(variance, 0.0))),
        upper_rad=float(np.sqrt(max(variance + _CONFIDENCE * error, 0.0))),
        walk_rad=_walk(used, path, residual, noise),
        n_pairs=len(used),
    )


def _beyond(weight: FloatArray, squares: list[FloatArray], noise: FloatArray) -> tuple[float, float]:
    """Variance of phases, beyond that of log magnitudes where these are given, and its error.

    `squares` are those of phases (pair,), then of log magnitudes, without noise.
    """
    share = weight / weight.sum()
    variance, *unmodelled = (float(share @ square) for square in squares)
    error = np.sqrt(2 * len(squares) * np.square(share * (noise + max(variance, 0.0))).sum())
    return variance - max([0.0, *unmodelled]), float(error)


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
