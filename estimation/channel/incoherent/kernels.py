"""Compiled loops of the phase-incoherent method for the marginal likelihood of paths."""

import math

import numpy as np

from estimation.execution import compiled
from scenes.record import ComplexArray, FloatArray, IntArray


@compiled
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


@compiled
def _weigh(
    sent: ComplexArray, tx: ComplexArray, rx: ComplexArray, weight: ComplexArray, along: ComplexArray
) -> None:  # pragma: no cover
    """Derivatives of one pair's signal by the parameters of every path, and their products with the signal.

    Writes to `weight` and `along` (path, parameter); `sent`, `tx` and `rx` are those of the pair, see
    `pair_scores`.
    """
    n_paths, n_tx, n_rx = tx.shape[0], tx.shape[1] - 1, rx.shape[1] - 1
    size = 3 + n_tx + n_rx
    for i in range(n_paths):
        a, wave = tx[i, 0] * rx[i, 0], sent[i].conjugate()
        weight[i, 0] = a
        for k in range(n_tx):
            weight[i, 1 + k] = tx[i, 1 + k] * rx[i, 0]
        for k in range(n_rx):
            weight[i, 1 + n_tx + k] = tx[i, 0] * rx[i, 1 + k]
        weight[i, size - 2] = a
        weight[i, size - 1] = 1j * a
        along[i, 0] = sent[n_paths + i].conjugate() * a
        for k in range(1, size):
            along[i, k] = wave * weight[i, k]


@compiled
def pair_scores(
    inner: ComplexArray,
    pair_snr: FloatArray,
    matched: ComplexArray,
    sent: ComplexArray,
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
    pair_phasor: ComplexArray,
) -> None:  # pragma: no cover
    """Marginal log-likelihood of every pair over that of noise, its phase, and the summed score and information.

    Parameters
    ----------
    inner, pair_snr : (pair,) inner product of the signal with the samples, and its energy over the noise
    matched : (2 path, pair) inner products of the samples with the waves and slopes of all paths
    sent : (2 path, pair) the same of the signal
    gram : (2 path, 2 path) inner products among waves and slopes
    tx, rx : (path, 1 + angle, beam) responses and derivatives; `tx` holds the gain, `rx` 1 / noise amplitude
    table : (3, n) log SNR, A / SNR and B of `phase_information`
    faint : SNR of a path in a pair below which the pair is left out of the path's information
    gradient, information : (path * parameter,) and squared, added to; parameters are delay, AoD angles, AoA
        angles, log amplitude, phase; of the information the blocks on and above the diagonal
    pair_value, pair_phasor : (pair,) log-likelihood, and the expectation of exp(j psi) given the samples
    """
    n_paths, n_tx, n_rx = tx.shape[0], tx.shape[1] - 1, rx.shape[1] - 1
    size = 3 + n_tx + n_rx
    weight = np.empty((n_paths, size), np.complex128)
    along = np.empty((n_paths, size), np.complex128)
    bright = np.empty(n_paths, np.int64)
    for p in range(len(tx_beam)):
        m, j = tx_beam[p], rx_beam[p]
        n_bright = 0
        for i in range(n_paths):
            a = tx[i, 0, m] * rx[i, 0, j]
            if (a.real * a.real + a.imag * a.imag) * gram[i, i] > faint:
                bright[n_bright] = i
                n_bright += 1
        _weigh(sent[:, p], tx[:, :, m], rx[:, :, j], weight, along)
        z, snr = inner[p], pair_snr[p]
        strength = abs(z)
        value, ratio = log_bessel(2 * strength)
        phasor = ratio * z / strength if strength > 0 else 0j
        pair_value[p], pair_phasor[p] = value - snr, phasor
        for i in range(n_paths):
            slope = phasor * matched[n_paths + i, p].conjugate()
            wave = phasor * matched[i, p].conjugate()
            pull = slope * weight[i, 0]
            gradient[i * size] += 2 * (pull.real - along[i, 0].real)
            for k in range(1, size):
                pull = wave * weight[i, k]
                gradient[i * size + k] += 2 * (pull.real - along[i, k].real)
        if n_bright and snr > 0:
            _add_information(information, gram, weight, along, bright[:n_bright], snr, table)


@compiled
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
                row[j * size] += first * (wk.real * wl.real + wk.imag * wl.imag) + tre * tl.real - tim * tl.imag
                for el in range(1, size):
                    wl, tl = weight[j, el], along[j, el]
                    row[j * size + el] += (
                        rest * (wk.real * wl.real + wk.imag * wl.imag) + tre * tl.real - tim * tl.imag
                    )


@compiled
def likelihoods_without(
    inner: ComplexArray,
    pair_snr: FloatArray,
    matched: ComplexArray,
    sent: ComplexArray,
    amplitude: ComplexArray,
    energy: FloatArray,
    chosen: IntArray,
) -> FloatArray:  # pragma: no cover
    """Marginal log-likelihood (chosen,) of all paths but one, summed over the pairs as in `pair_scores`.

    `matched`, `sent` and `amplitude` (path, pair) are products with the waves; `energy` (path,) is that of a wave.
    """
    total = np.zeros(len(chosen))
    for p in range(len(inner)):
        for q in range(len(chosen)):
            i = chosen[q]
            conjugate = amplitude[i, p].conjugate()
            own = (amplitude[i, p] * conjugate).real * energy[i]
            rest = pair_snr[p] - 2 * (conjugate * sent[i, p]).real + own
            total[q] += log_bessel(2 * abs(inner[p] - conjugate * matched[i, p]))[0] - rest
    return total


@compiled
def fill_lower_blocks(information: FloatArray, size: int) -> None:  # pragma: no cover
    """Fill the lower blocks of a symmetric matrix whose upper ones `pair_scores` has computed."""
    for i in range(information.shape[0]):
        for j in range((i // size + 1) * size, information.shape[1]):
            information[j, i] = information[i, j]
