"""Compiled inner loops of the path model: responses along every axis, and the Gram matrices of their derivatives.

Every function writes out one formula over small arrays, where the overhead of array operations exceeds the work.
"""

import numpy as np

from estimation.execution import compiled, compiled_fast
from scenes.record import ComplexArray, FloatArray, IntArray

NEAR_BINS = 1e-3  # distance from its peak below which the series of the Dirichlet kernel is used


@compiled
def dirichlet(position: IntArray, delay_bins: FloatArray, n: int) -> FloatArray:
    """Dirichlet kernel sin(pi x) / (n sin(pi x / n)) of `n` subcarriers and its slope over x, (delay, 2, bin).

    x is the distance in bins of the integer `position` (bin,) from the delays (delay,).
    """
    kernel = np.empty((len(delay_bins), 2, len(position)))
    second = np.pi**2 / 3 * (1 - 1 / n**2)
    fourth = np.pi**4 / 5 * (1 - 1 / n**2) * (1 - 7 / (3 * n**2))
    bin_sine, bin_cosine = np.sin(np.pi / n * position), np.cos(np.pi / n * position)
    for i in range(len(delay_bins)):
        delay = delay_bins[i]
        turn_sine, turn_cosine = np.sin(np.pi * delay), np.cos(np.pi * delay)
        slow_sine, slow_cosine = np.sin(np.pi / n * delay), np.cos(np.pi / n * delay)
        for j in range(len(position)):
            sign = -1.0 if position[j] % 2 else 1.0
            sine = bin_sine[j] * slow_cosine - bin_cosine[j] * slow_sine
            cosine = bin_cosine[j] * slow_cosine + bin_sine[j] * slow_sine
            if abs(sine) < np.pi / n * NEAR_BINS:
                x = n / np.pi * np.arctan(sine / cosine)
                peak = sign * turn_cosine / (np.cos(np.pi * x) * np.sign(cosine))
                kernel[i, 0, j] = peak * (1 - second * x**2 / 2 + fourth * x**4 / 24)
                kernel[i, 1, j] = peak * (-second * x + fourth * x**3 / 6)
            else:
                value = -sign * turn_sine / (n * sine)
                kernel[i, 0, j] = value
                kernel[i, 1, j] = np.pi * (sign * turn_cosine - cosine * value) / (n * sine)
    return kernel


@compiled
def unit_vectors(azimuth_rad: FloatArray, elevation_rad: FloatArray) -> FloatArray:
    """Unit vectors of directions and their derivatives over azimuth and elevation, (direction, 3, xyz)."""
    vectors = np.zeros((len(azimuth_rad), 3, 3))
    for p in range(len(azimuth_rad)):
        sine, cosine = np.sin(azimuth_rad[p]), np.cos(azimuth_rad[p])
        height, level = np.sin(elevation_rad[p]), np.cos(elevation_rad[p])
        vectors[p, 0, 0], vectors[p, 0, 1], vectors[p, 0, 2] = level * cosine, level * sine, height
        vectors[p, 1, 0], vectors[p, 1, 1] = -level * sine, level * cosine
        vectors[p, 2, 0], vectors[p, 2, 1], vectors[p, 2, 2] = -height * cosine, -height * sine, level
    return vectors


@compiled
def element_tangents(
    vectors: FloatArray, amplitude: FloatArray, slope: FloatArray, wave_vector: FloatArray, panel: IntArray
) -> ComplexArray:
    """Waves at the elements of all panels and their derivatives, (direction, 1 + angle, element).

    `vectors` (direction, 1 + angle or more, xyz) are unit vectors and their derivatives; `amplitude` (panel,
    direction) of the elements has the `slope` (panel, angle, direction); `wave_vector` (element, xyz); `panel`
    (element,) of every element.
    """
    n_directions, n_angles = len(vectors), slope.shape[1]
    out = np.empty((n_directions, 1 + n_angles, len(panel)), np.complex128)
    for p in range(n_directions):
        for e in range(len(panel)):
            phase, of = 0.0, panel[e]
            for axis in range(3):
                phase += wave_vector[e, axis] * vectors[p, 0, axis]
            wave = complex(np.cos(phase), np.sin(phase))
            out[p, 0, e] = amplitude[of, p] * wave
            for a in range(n_angles):
                rate = 0.0
                for axis in range(3):
                    rate += wave_vector[e, axis] * vectors[p, 1 + a, axis]
                out[p, 1 + a, e] = complex(slope[of, a, p], amplitude[of, p] * rate) * wave
    return out


@compiled_fast
def tangent_products(slices: FloatArray, tx: ComplexArray, rx: ComplexArray) -> ComplexArray:
    """Inner products (path, tangent) of tangents with samples already summed over delay.

    `slices` (path, delay factor, part, tx_rank, rx_rank) are the samples times each delay factor; `tx` and `rx`
    (path, 1 + angle, rank). Tangents: value, derivatives over delay (if there is a second factor), `tx`, `rx`.
    """
    n_paths, n_delay, _, n_tx, n_rx = slices.shape
    n_aod, n_aoa = tx.shape[1] - 1, rx.shape[1] - 1
    products = np.zeros((n_paths, n_delay + n_aod + n_aoa), np.complex128)
    real, imaginary = rx.real.copy(), rx.imag.copy()
    along = np.empty(1 + n_aoa, np.complex128)
    for p in range(n_paths):
        for d in range(n_delay):
            for i in range(n_tx):
                for b in range(1 + n_aoa if d == 0 else 1):
                    own, turned = 0.0, 0.0
                    for j in range(n_rx):
                        x, y = slices[p, d, 0, i, j], slices[p, d, 1, i, j]
                        own += x * real[p, b, j] + y * imaginary[p, b, j]
                        turned += y * real[p, b, j] - x * imaginary[p, b, j]
                    along[b] = complex(own, turned)
                products[p, d] += along[0] * tx[p, 0, i].conjugate()
                if d == 0:
                    for a in range(n_aod):
                        products[p, n_delay + a] += along[0] * tx[p, 1 + a, i].conjugate()
                    for b in range(n_aoa):
                        products[p, n_delay + n_aod + b] += along[1 + b] * tx[p, 0, i].conjugate()
    return products


@compiled
def hadamard_gram(tx: ComplexArray, rx: ComplexArray, delay: FloatArray | ComplexArray) -> ComplexArray:
    """Inner products (path, tangent, path, tangent) from those of the factors of each axis (path, factor, ...)."""
    n_paths, n_others = tx.shape[0], tx.shape[2]
    n_aod, n_aoa, n_delay = tx.shape[1] - 1, rx.shape[1] - 1, delay.shape[1]
    m_aod, m_aoa, m_delay = tx.shape[3] - 1, rx.shape[3] - 1, delay.shape[3]
    n, m = n_delay + n_aod + n_aoa, m_delay + m_aod + m_aoa
    gram = np.empty((n_paths, n, n_others, m), np.complex128)
    for p in range(n_paths):
        for a in range(n):
            d = a if a < n_delay else 0
            i = a - n_delay + 1 if n_delay <= a < n_delay + n_aod else 0
            j = a - n_delay - n_aod + 1 if a >= n_delay + n_aod else 0
            for q in range(n_others):
                for b in range(m):
                    e = b if b < m_delay else 0
                    k = b - m_delay + 1 if m_delay <= b < m_delay + m_aod else 0
                    h = b - m_delay - m_aod + 1 if b >= m_delay + m_aod else 0
                    gram[p, a, q, b] = tx[p, i, q, k] * rx[p, j, q, h] * delay[p, d, q, e]
    return gram


@compiled_fast
def normal_matrix(
    tx: ComplexArray, rx: ComplexArray, delay: FloatArray | ComplexArray, amplitude: ComplexArray
) -> FloatArray:
    """Normal matrix (path, column, path, column) in real unknowns, from inner products as in `hadamard_gram`.

    The columns of a path are the derivatives over the real and the imaginary part of its amplitude, then over its
    parameters, one for each tangent but the value.
    """
    n_paths, n_delay, n_aod = len(amplitude), delay.shape[1], tx.shape[1] - 1
    n = n_delay + tx.shape[1] + rx.shape[1] - 1
    factor = np.zeros((3, n), np.int64)  # of delay, departure and arrival that each column has
    for column in range(2, n):
        a = column - 1
        axis = 0 if a < n_delay else (1 if a < n_delay + n_aod else 2)
        factor[axis, column] = a - (0, n_delay - 1, n_delay + n_aod - 1)[axis]
    scale = np.empty((n_paths, n), np.complex128)
    for p in range(n_paths):
        scale[p, 0], scale[p, 1], scale[p, 2:] = 1.0, 1j, amplitude[p]
    matrix = np.empty((n_paths, n, n_paths, n))
    for p in range(n_paths):
        for q in range(p, n_paths):
            for a in range(n):
                d, i, j = factor[0, a], factor[1, a], factor[2, a]
                left = scale[p, a].conjugate()
                for b in range(n):
                    e, k, h = factor[0, b], factor[1, b], factor[2, b]
                    product = left * scale[q, b] * tx[p, i, q, k] * rx[p, j, q, h] * delay[p, d, q, e]
                    matrix[p, a, q, b] = matrix[q, b, p, a] = product.real
    return matrix
