"""Compiled loops of the phase-incoherent method over the cube, the delays and the search grid."""

import math

import numpy as np

from estimation.channel.incoherent.kernels import log_bessel
from estimation.execution import compiled, compiled_fast
from scenes.record import ComplexArray, FloatArray, IntArray


@compiled_fast
def cell_amplitudes(
    value: ComplexArray, scale: FloatArray, sign: float, out: FloatArray
) -> None:  # pragma: no cover
    """Amplitudes over the noise at delay bins and half way to the next, minus the mean of noise alone.

    `value` (tx_beam, rx_beam, n + 1) holds one more bin than `out` (tx_beam, rx_beam, 2, n); `scale` (rx_beam,)
    is 1 over the noise amplitude. A path half way between bins is equally strong in both, with phases equal up to
    the `sign`, +1 or -1.
    """
    mean = np.float32(math.sqrt(math.pi) / 2)
    half = np.float32(math.sqrt(0.5))
    turn = np.float32(sign)
    n = out.shape[3]
    for m in range(value.shape[0]):
        for j in range(value.shape[1]):
            row = value[m, j]
            s = scale[j]
            for k in range(n):
                re, im = row[k].real, row[k].imag
                out[m, j, 0, k] = s * np.sqrt(re * re + im * im) - mean
            s *= half
            for k in range(n):
                re, im = row[k].real + turn * row[k + 1].real, row[k].imag + turn * row[k + 1].imag
                out[m, j, 1, k] = s * np.sqrt(re * re + im * im) - mean


@compiled
def waves_and_slopes(
    bins: IntArray, delay_bins: FloatArray, n_bins: int
) -> tuple[FloatArray, FloatArray]:  # pragma: no cover
    """`delay_waves` of `spectrum.py`: sin and cos of pi (n - x) / K are computed from those of n and of x."""
    root, step = math.sqrt(n_bins), math.pi / n_bins
    curvature = math.pi**2 / 3 * (1 - 1 / n_bins**2)  # of the wave at its peak
    value, slope = np.empty((len(bins), len(delay_bins))), np.empty((len(bins), len(delay_bins)))
    sin_x, cos_x = np.sin(step * delay_bins), np.cos(step * delay_bins)
    turns, turns_cosine = np.sin(math.pi * delay_bins), np.cos(math.pi * delay_bins)
    for k in range(len(bins)):
        sin_n, cos_n = math.sin(step * bins[k]), math.cos(step * bins[k])
        sign = 1.0 - 2.0 * (bins[k] % 2)
        for x in range(len(delay_bins)):
            offset = bins[k] - delay_bins[x]
            if abs(offset) < 1e-4:
                value[k, x] = root * (1 - curvature / 2 * offset**2)
                slope[k, x] = root * curvature * offset
                continue
            over = 1 / (root * (sin_n * cos_x[x] - cos_n * sin_x[x]))
            cosine = cos_n * cos_x[x] + sin_n * sin_x[x]
            value[k, x] = -sign * turns[x] * over
            slope[k, x] = over * math.pi * (value[k, x] * cosine / root - sign * turns_cosine[x])
    return value, slope


@compiled
def candidate_ratios(
    tx: ComplexArray,
    rx: ComplexArray,
    matched: ComplexArray,
    phasor: ComplexArray,
    factors: FloatArray,
    weakest: float,
    phase_known: float,
) -> tuple[FloatArray, FloatArray, FloatArray]:  # pragma: no cover
    """Amplitude over all pairs, phase and log-likelihood ratio (candidate,) of candidates on a grid.

    tx, rx : (candidate, beam) responses of unit norm
    matched : (pair, candidate) samples matched to the candidates' delays
    phasor : (pair,) phase of every pair as far as it is known; updated by every candidate that is more informative
    factors : trial amplitudes, relative to the mean over the pairs
    weakest : share of the strongest pair's power below which pairs are left out
    phase_known : |mu^H y| above which a pair's phase is known
    """
    n, n_rx = len(tx), rx.shape[1]
    amplitude, phase, ratio = np.zeros(n), np.zeros(n), np.zeros(n)
    trial = np.empty(len(factors))
    for i in range(n):
        power = np.abs(tx[i]) ** 2
        power_rx = np.abs(rx[i]) ** 2
        least = weakest * power.max() * power_rx.max()
        total, along, in_phase = 0.0, 0.0, 0j
        for p in range(len(phasor)):
            share = power[p // n_rx] * power_rx[p % n_rx]
            if share > least:
                total += share
                along += math.sqrt(share) * abs(matched[p, i])
                shape = tx[i, p // n_rx] * rx[i, p % n_rx] * phasor[p]
                in_phase += shape.conjugate() * matched[p, i]
        trial[:] = 0.0
        for p in range(len(phasor)):
            share = power[p // n_rx] * power_rx[p % n_rx]
            if share > least:
                for t in range(len(factors)):
                    signal = along / total * factors[t] * math.sqrt(share)
                    trial[t] += log_bessel(2 * signal * abs(matched[p, i]))[0] - signal * signal
        best = int(np.argmax(trial))
        amplitude[i], ratio[i] = along / total * factors[best], trial[best]
        if abs(in_phase) ** 2 > ratio[i]:
            amplitude[i], ratio[i] = abs(in_phase), abs(in_phase) ** 2
        phase[i] = math.atan2(in_phase.imag, in_phase.real)
        gain = amplitude[i] * complex(math.cos(phase[i]), math.sin(phase[i]))
        for p in range(len(phasor)):
            if power[p // n_rx] * power_rx[p % n_rx] > least:
                signal = gain * tx[i, p // n_rx] * rx[i, p % n_rx]
                strength = signal.conjugate() * matched[p, i]
                known = strength / (abs(strength) + phase_known)
                if abs(known) > abs(phasor[p]):
                    phasor[p] = known
    return amplitude, phase, ratio


@compiled
def column_maxima(values: FloatArray) -> tuple[FloatArray, IntArray]:  # pragma: no cover
    """Largest value of every column of a matrix, and its row."""
    largest, row = values[0].copy(), np.zeros(values.shape[1], np.int64)
    for i in range(1, values.shape[0]):
        for k in range(values.shape[1]):
            if values[i, k] > largest[k]:
                largest[k] = values[i, k]
                row[k] = i
    return largest, row
