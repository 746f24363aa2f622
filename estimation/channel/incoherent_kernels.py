"""Compiled loops of the phase-incoherent method: amplitudes over the cube, and the marginal likelihood."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from scenes.record import ComplexArray, FloatArray, IntArray


@njit(cache=True, fastmath=True)  # type: ignore[untyped-decorator]
def cell_amplitudes(
    value: ComplexArray, scale: FloatArray, sign: float, out: FloatArray
) -> None:  # pragma: no cover
    """Amplitudes over the noise at delay bins and half way to the next, minus the mean of noise alone.

    `value` (tx_beam, rx_beam, n + 1) holds one more bin than `out` (tx_beam, rx_beam, 2, n); `scale` (rx_beam,)
    is 1 over the noise amplitude. A path half way between bins is equally strong in both, and of the same phase
    but for the `sign`, +1 or -1.
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


@njit(cache=True)  # type: ignore[untyped-decorator]
def column_maxima(values: FloatArray) -> tuple[FloatArray, IntArray]:  # pragma: no cover
    """Largest value of every column of a matrix, and its row."""
    largest, row = values[0].copy(), np.zeros(values.shape[1], np.int64)
    for i in range(1, values.shape[0]):
        for k in range(values.shape[1]):
            if values[i, k] > largest[k]:
                largest[k] = values[i, k]
                row[k] = i
    return largest, row


@njit(cache=True)  # type: ignore[untyped-decorator]
def log_bessel(x: float) -> tuple[float, float]:  # pragma: no cover
    """Log I0(x) and I1(x) / I0(x) of x >= 0; Abramowitz and Stegun 9.8.1 to 9.8.4, errors below 3e-7."""
    if x < 3.75:
        t = (x / 3.75) ** 2
        i0 = 1.0 + t * (
            3.5156229 + t * (3.0899424 + t * (1.2067492 + t * (0.2659732 + t * (0.0360768 + t * 0.0045813))))
        )
        i1 = x * (
            0.5
            + t
            * (
                0.87890594
                + t * (0.51498869 + t * (0.15084934 + t * (0.02658733 + t * (0.00301532 + t * 0.00032411))))
            )
        )
        return math.log(i0), i1 / i0
    t = 3.75 / x
    i0 = 0.39894228 + t * (
        0.01328592
        + t
        * (
            0.00225319
            + t
            * (
                -0.00157565
                + t * (0.00916281 + t * (-0.02057706 + t * (0.02635537 + t * (-0.01647633 + t * 0.00392377))))
            )
        )
    )
    i1 = 0.39894228 + t * (
        -0.03988024
        + t
        * (
            -0.00362018
            + t
            * (
                0.00163801
                + t * (-0.01031555 + t * (0.02282967 + t * (-0.02895312 + t * (0.01787654 - t * 0.00420059))))
            )
        )
    )
    return x - 0.5 * math.log(x) + math.log(i0), i1 / i0


@njit(cache=True)  # type: ignore[untyped-decorator]
def _weigh(
    matched: ComplexArray,
    gram: FloatArray,
    tx: ComplexArray,
    rx: ComplexArray,
    amplitude: ComplexArray,
    weight: ComplexArray,
    along: ComplexArray,
) -> tuple[complex, float]:  # pragma: no cover
    """Inner product of the samples of one pair with its signal, and the energy of the signal over the noise.

    Filled in are the derivatives of the signal by the parameters of every path, `weight` (path, parameter), and
    their inner products with the signal, `along`. `matched`, `tx` and `rx` are those of the pair, see
    `pair_scores`; `amplitude` (path,) is that of each path in the pair.
    """
    n_paths, n_tx, n_rx = tx.shape[0], tx.shape[1] - 1, rx.shape[1] - 1
    size = 3 + n_tx + n_rx
    z, snr = 0j, 0.0
    for i in range(n_paths):
        a = amplitude[i]
        wave_re, wave_im, slope_re, slope_im = 0.0, 0.0, 0.0, 0.0
        for r in range(n_paths):
            b, g, h = amplitude[r], gram[i, r], gram[n_paths + i, r]
            wave_re += g * b.real
            wave_im += g * b.imag
            slope_re += h * b.real
            slope_im += h * b.imag
        z += a.conjugate() * matched[i]
        snr += a.real * wave_re + a.imag * wave_im
        weight[i, 0] = a
        for k in range(n_tx):
            weight[i, 1 + k] = tx[i, 1 + k] * rx[i, 0]
        for k in range(n_rx):
            weight[i, 1 + n_tx + k] = tx[i, 0] * rx[i, 1 + k]
        weight[i, size - 2] = a
        weight[i, size - 1] = 1j * a
        along[i, 0] = complex(slope_re, -slope_im) * a
        for k in range(1, size):
            along[i, k] = complex(wave_re, -wave_im) * weight[i, k]
    return z, snr


@njit(cache=True)  # type: ignore[untyped-decorator]
def pair_scores(
    matched: ComplexArray,
    gram: FloatArray,
    tx: ComplexArray,
    rx: ComplexArray,
    tx_beam: IntArray,
    rx_beam: IntArray,
    table: FloatArray,
    faint: float,
    gradient: FloatArray,
    information: FloatArray,
    pair_value: FloatArray,
    pair_snr: FloatArray,
    pair_phasor: ComplexArray,
) -> None:  # pragma: no cover
    """Marginal log-likelihood of every pair over that of noise, its phase, and the summed score and information.

    matched : (2 path, pair) inner products of the samples with the waves and slopes of all paths
    gram : (2 path, 2 path) inner products among waves and slopes
    tx, rx : (path, 1 + angle, beam) responses and derivatives; `tx` holds the gain, `rx` 1 / noise amplitude
    table : (3, n) log SNR, A / SNR and B of `phase_information`
    faint : SNR of a path in a pair below which the pair is left out of the path's information
    gradient, information : (path * parameter,) and squared, added to; parameters are delay, AoD angles, AoA
        angles, log amplitude, phase; of the information the blocks on and above the diagonal
    pair_value, pair_snr, pair_phasor : (pair,) log-likelihood, energy of the signal over the noise, and the
        expectation of exp(j psi) given the samples
    """
    n_paths, n_tx, n_rx = tx.shape[0], tx.shape[1] - 1, rx.shape[1] - 1
    size = 3 + n_tx + n_rx
    amplitude = np.empty(n_paths, np.complex128)
    weight = np.empty((n_paths, size), np.complex128)
    along = np.empty((n_paths, size), np.complex128)
    bright = np.empty(n_paths, np.int64)
    for p in range(len(tx_beam)):
        m, j = tx_beam[p], rx_beam[p]
        n_bright = 0
        for i in range(n_paths):
            a = tx[i, 0, m] * rx[i, 0, j]
            amplitude[i] = a
            if (a.real * a.real + a.imag * a.imag) * gram[0, 0] > faint:
                bright[n_bright] = i
                n_bright += 1
        z, snr = _weigh(matched[:, p], gram, tx[:, :, m], rx[:, :, j], amplitude, weight, along)
        strength = abs(z)
        value, ratio = log_bessel(2 * strength)
        phasor = ratio * z / strength if strength > 0 else 0j
        pair_value[p], pair_snr[p], pair_phasor[p] = value - snr, snr, phasor
        for i in range(n_paths):
            slope = phasor * matched[n_paths + i, p].conjugate()
            wave = phasor * matched[i, p].conjugate()
            pull = slope * weight[i, 0]
            gradient[i * size] += 2 * (pull.real - along[i, 0].real)
            for k in range(1, size):
                pull = wave * weight[i, k]
                gradient[i * size + k] += 2 * (pull.real - along[i, k].real)
        if snr > faint:
            _add_information(information, gram, weight, along, bright[:n_bright], snr, table)


@njit(cache=True)  # type: ignore[untyped-decorator]
def _add_information(
    information: FloatArray,
    gram: FloatArray,
    weight: ComplexArray,
    along: ComplexArray,
    bright: IntArray,
    snr: float,
    table: FloatArray,
) -> None:  # pragma: no cover
    """Add 4 A Re(alpha) Re(alpha)' + 2 B Re(d'^H d') of one pair for its bright paths, equations of `crb`.

    `weight` and `along` (path, parameter) are the factors of the derivatives d and the products mu^H d.
    """
    n_paths, size = weight.shape
    place = (math.log(snr) - table[0, 0]) / (table[0, 1] - table[0, 0])
    place = min(max(place, 0.0), table.shape[1] - 1.001)
    low = int(place)
    share = place - low
    kept = 4 * ((1 - share) * table[1, low] + share * table[1, low + 1]) / snr
    across = 2 * ((1 - share) * table[2, low] + share * table[2, low + 1])
    real, imaginary = kept - across / snr, across / snr
    for q in range(len(bright)):
        i = bright[q]
        for r in range(q, len(bright)):
            j = bright[r]
            waves, turn = across * gram[i, j], across * gram[n_paths + i, j]
            back, turns = across * gram[i, n_paths + j], across * gram[n_paths + i, n_paths + j]
            for k in range(size):
                wk, tk = weight[i, k], along[i, k]
                tre, tim = real * tk.real, imaginary * tk.imag
                row = information[i * size + k]
                first = turns if k == 0 else back
                rest = turn if k == 0 else waves
                wl, tl = weight[j, 0], along[j, 0]
                row[j * size] += (
                    first * (wk.real * wl.real + wk.imag * wl.imag) + tre * tl.real - tim * tl.imag
                )
                for el in range(1, size):
                    wl, tl = weight[j, el], along[j, el]
                    row[j * size + el] += (
                        rest * (wk.real * wl.real + wk.imag * wl.imag) + tre * tl.real - tim * tl.imag
                    )


@njit(cache=True)  # type: ignore[untyped-decorator]
def mirror(information: FloatArray, size: int) -> None:  # pragma: no cover
    """Fill the lower blocks of a symmetric matrix of which `pair_scores` has made the upper ones."""
    for i in range(information.shape[0]):
        for j in range((i // size + 1) * size, information.shape[1]):
            information[j, i] = information[i, j]
