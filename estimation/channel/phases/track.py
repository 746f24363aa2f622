"""Phases of beam pairs that wander over a sweep, tracked against the paths of a fit.

The phase of a pair is the sum of a phase of its TX beam and one of its RX beam (frequency offsets, hardware), of a
random walk from pair to pair in the order of the sweep (the oscillators), and of a part of its own (phase noise
within a symbol). Steps of the walk and own parts are Gaussian; their variances are those of largest likelihood of
what each pair adds to the pairs before it. Pairs that the paths light well tell their phases, and the model
gives those of the others (Rauch, Tung and Striebel, 1965).
"""

from dataclasses import dataclass, replace

import numpy as np

from estimation.channel.incoherent.clock_drift import DRIFTING, WANDERING
from estimation.channel.phases.pairs import LEAST_SNR, PairPhases, phase_variance
from estimation.execution import compiled
from scenes.pose import wrap_angle
from scenes.record import BoolArray, FloatArray, IntArray

STEPS_RAD = np.deg2rad(np.geomspace(0.1, 51.2, 14))  # trial standard deviations of a step of the walk,
OWN_RAD = np.deg2rad(np.geomspace(0.4, 51.2, 13))  # and of a pair's own phase
FIRST_STEP_RAD, FIRST_OWN_RAD = np.deg2rad([4.0, 4.0])  # before they are learned
WANDERING_RATIO = 3.0  # of the deviations of phases to those of magnitudes, above which oscillators wander
_MOST_VARIANCE = 1.0  # in rad^2, of a phase that is used
_COARSE_TURNS = 10  # of smoothing over less and less of the sweep
_FINE_TURNS = 20
_LEARNING = 4  # turns between two choices of the variances
_DIFFUSE = 1e3  # variance in rad^2 of a phase before the first pair


@dataclass(frozen=True)
class PhaseTrack:
    """Phases of all beam pairs of a sweep.

    Attributes
    ----------
    phase_rad : (tx_beam, rx_beam) the phases
    variance : (tx_beam, rx_beam) of what the beams and the other pairs tell of them
    step_rad, own_rad : standard deviations of a step of the walk and of a pair's own phase
    n_pairs : pairs whose phases were used
    """

    phase_rad: FloatArray
    variance: FloatArray
    step_rad: float
    own_rad: float
    n_pairs: int

    @property
    def error_rad(self) -> float:
        """Median error of the phases that the beams and other pairs tell; infinite if no pair was used."""
        return float(np.sqrt(np.median(self.variance))) if self.n_pairs else np.inf

    @property
    def drift_odds(self) -> float:
        """Odds that the clock drifts: an oscillator whose phase is lost over the sweep is likely to."""
        return WANDERING if self.step_rad * np.sqrt(self.phase_rad.size) > 1 else DRIFTING


def wanders(pairs: PairPhases) -> bool:
    """Whether phases change more from pair to pair, or beside that, than the logarithms of the magnitudes.

    Paths that are not found change both alike, an oscillator the phases alone. Phases of too few pairs do not.
    """
    if pairs.log_magnitude is None:
        return False
    phase, magnitude = track_phases(pairs), track_phases(replace(pairs, phase_rad=pairs.log_magnitude))
    walks = phase.step_rad > WANDERING_RATIO * magnitude.step_rad
    differs = phase.own_rad > WANDERING_RATIO * magnitude.own_rad
    return phase.n_pairs > 0 and (walks or differs)


def track_phases(pairs: PairPhases) -> PhaseTrack:
    """The phases of all beam pairs, from those that fitted paths show.

    Beam phases, phases between reference paths and the walk are estimated in turn: first by means of phasors over
    shorter and shorter parts of the sweep, then by smoothing of what is left, whose variances are learned.
    """
    noise, seen = _noise(pairs)
    if not seen.any():
        return PhaseTrack(np.zeros(seen.shape), np.full(seen.shape, np.inf), np.inf, np.inf, 0)
    weight = np.where(seen, 1 / (noise + FIRST_OWN_RAD**2), 0.0)
    beams, walk, reference = np.zeros((3, *seen.shape))
    step, own = FIRST_STEP_RAD**2, FIRST_OWN_RAD**2
    variance = np.zeros(seen.shape)
    for turn in range(_COARSE_TURNS + _FINE_TURNS):
        beams = _beam_phases(pairs.phase_rad - reference - walk, weight, beams)
        reference = _reference_phases(pairs.phase_rad - beams - walk, weight, pairs.path)
        left = pairs.phase_rad - beams - reference
        if turn < _COARSE_TURNS:
            walk = _running_phase(weight * np.exp(1j * left), 1 - turn / _COARSE_TURNS)
            continue
        near = (walk + wrap_angle(left - walk)).ravel()
        if turn % _LEARNING == 0:
            step, own = _learned(near, noise.ravel())
        smooth, smooth_variance, _ = smooth_walk(near, (noise + own).ravel(), step)
        walk, variance = smooth.reshape(seen.shape), smooth_variance.reshape(seen.shape)
    share = np.where(seen, own / (own + noise), 0.0)  # of what is left that is the pair's own
    rest = wrap_angle(pairs.phase_rad - beams - reference - walk)
    return PhaseTrack(
        phase_rad=np.asarray(wrap_angle(beams + walk + share * rest)),
        variance=variance + own + _beam_variance(noise + own),
        step_rad=float(np.sqrt(step)),
        own_rad=float(np.sqrt(own)),
        n_pairs=int(seen.sum()),
    )


def _noise(pairs: PairPhases) -> tuple[FloatArray, BoolArray]:
    """Variance (tx_beam, rx_beam) of the phases that paths show, infinite where unused, and which are used.

    What the paths leave out of their delays may turn the phase of a pair.
    """
    used = (pairs.snr > LEAST_SNR) & pairs.is_usable
    snr = np.where(used, pairs.snr, 1.0)
    if pairs.excess is None or pairs.hidden is None:
        variance = phase_variance(snr) + 0.5 * pairs.residual / snr
    else:
        variance = phase_variance(snr / (1 + pairs.excess)) + 0.5 * pairs.hidden / snr
    seen = used & (variance < _MOST_VARIANCE)
    return np.where(seen, variance, np.inf), seen


def _beam_phases(left_rad: FloatArray, weight: FloatArray, before_rad: FloatArray) -> FloatArray:
    """Phases (tx_beam, rx_beam), a sum of one per TX beam and one per RX beam, that explain what is `left_rad`."""
    phasor = weight * np.exp(1j * left_rad)
    tx_rad = before_rad[:, :1] - before_rad[:1, :1]
    rx_rad = np.angle((phasor * np.exp(-1j * tx_rad)).sum(axis=0, keepdims=True))
    tx_rad = np.angle((phasor * np.exp(-1j * rx_rad)).sum(axis=1, keepdims=True))
    return np.asarray(tx_rad + rx_rad)


def _beam_variance(variance: FloatArray) -> FloatArray:
    """Variance (tx_beam, rx_beam) of the sum of both beam phases, from that of the phases of their pairs."""
    weight = 1 / variance
    tx, rx = weight.sum(axis=1, keepdims=True), weight.sum(axis=0, keepdims=True)
    return np.asarray(1 / np.maximum(tx, 1 / _DIFFUSE) + 1 / np.maximum(rx, 1 / _DIFFUSE))


def _reference_phases(left_rad: FloatArray, weight: FloatArray, path: IntArray) -> FloatArray:
    """Phase (tx_beam, rx_beam) of the reference of each pair, that of the reference of most weight zero."""
    index = path + 1  # -1 is none
    total = np.zeros(index.max() + 1, complex)
    np.add.at(total, index, weight * np.exp(1j * left_rad))
    most = int(np.argmax(np.bincount(index.ravel(), weight.ravel())))
    return np.asarray(np.angle(total * total[most].conj())[index])


def _running_phase(phasor: FloatArray, share: float) -> FloatArray:
    """Continuous phase of the running mean of phasors (tx_beam, rx_beam) over three RX sweeps times `share`."""
    half = max(4, round(3 * share * phasor.shape[1]))
    mean = np.convolve(phasor.ravel(), np.hanning(2 * half + 1), "full")[half:-half]
    return np.asarray(np.unwrap(np.angle(mean)).reshape(phasor.shape))


def _learned(phase_rad: FloatArray, noise: FloatArray) -> tuple[float, float]:
    """Variances of a step and of own phases of largest likelihood of phases (pair,) with this noise variance."""
    trials = [(step, own) for step in np.square(STEPS_RAD) for own in np.square(OWN_RAD)]
    return max(trials, key=lambda trial: smooth_walk(phase_rad, noise + trial[1], trial[0])[2])


@compiled
def smooth_walk(phase_rad: FloatArray, variance: FloatArray, step: float) -> tuple[FloatArray, FloatArray, float]:
    """Mean and variance (pair,) of a random walk, seen with a variance (pair,), infinite where unseen.

    The third result is the log-likelihood of the phases, each given those before it, up to a constant; differences
    count modulo a turn.
    """
    n = len(phase_rad)
    mean, spread = np.empty(n), np.empty(n)
    before = np.empty(n)  # the variance before a pair is seen
    at, width, log_likelihood = 0.0, _DIFFUSE, 0.0
    for i in range(n):
        if i > 0:
            width += step
        before[i] = width
        if np.isfinite(variance[i]):
            total = width + variance[i]
            off = phase_rad[i] - at
            off -= 2 * np.pi * np.round(off / (2 * np.pi))
            if width < _DIFFUSE / 2:
                log_likelihood -= 0.5 * (off * off / total + np.log(total))
            at += width / total * off
            width *= variance[i] / total
        mean[i], spread[i] = at, width
    for i in range(n - 2, -1, -1):
        gain = spread[i] / before[i + 1]
        mean[i] += gain * (mean[i + 1] - mean[i])
        spread[i] += gain * gain * (spread[i + 1] - before[i + 1])
    return mean, spread, log_likelihood
