"""Log marginal likelihood of a periodic Gaussian process by its harmonics, with gradient and Hessian, compiled.

The expansion is that of `fourier.py`: B = I + (sigma_f / sigma_n)^2 W^1/2 Phi' Phi W^1/2. With v = B^-1 q of the
residuals eta and N = I - B^-1, the derivatives by the logarithms of the variances d_k of the coefficients are

    dL / d log d_k = (v_k^2 - N_kk) / 2,
    d2L / d log d_k d log d_l = N_kl^2 / 2 - v_k N_kl v_l, and (v_k^2 - N_kk) / 2 more where k = l,

those by sigma_n^2 follow from traces of B^-1 and B^-2, and mu being profiled adds a product of first derivatives.
"""

import numpy as np

from estimation.execution import compiled
from scenes.record import FloatArray

SMALLEST_ORDER = 8
ORDER_TIMES_LENGTH = 6.8
KERNEL_ERROR = 5e-9  # largest error of the kernel at sigma_f = 1, at any angle
LIKELIHOOD_ERROR_NAT = 1e-8
BEYOND = 60  # harmonics above the last one where the downward recurrence of the Bessel functions starts


@compiled
def weights(length_squared: float, order: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Weights w_k of the harmonics 0 .. order, and the first and second derivative of log w_k by log l^2.

    The ratios I_k / I_k-1 of modified Bessel functions come from their downward recurrence (Abramowitz and Stegun
    1964, 9.6.26), the scale from w_0 + w_1 + ... = 1.
    """
    z = 1 / length_squared
    ratio = np.zeros(order + BEYOND + 2)  # I_k / I_k-1 at k
    for k in range(order + BEYOND, 0, -1):
        ratio[k] = 1 / (2 * k / z + ratio[k + 1])
    relative, total = np.ones(order + 1), 1.0
    product = 1.0
    for k in range(1, order + BEYOND + 1):
        product *= ratio[k]
        total += 2 * product
        if k <= order:
            relative[k] = 2 * product
    harmonic = np.arange(order + 1).astype(np.float64)
    growth = harmonic + z * ratio[1 : order + 2]  # z I_k' / I_k
    return relative / total, z - growth, z * z - z + harmonic * harmonic - growth * growth


@compiled
def smallest_order(length_scale: float) -> int:
    """The least number K of harmonics that represents the kernel of a length scale to about 5e-9."""
    return max(SMALLEST_ORDER, int(np.ceil(ORDER_TIMES_LENGTH / length_scale)))


@compiled
def needed_order(length_squared: float, signal_to_noise: float) -> int:
    """The highest harmonic that the likelihood needs.

    Truncation changes the likelihood by about the missing weight times `signal_to_noise` = M sigma_f^2 /
    sigma_n^2. Beyond `smallest_order`, harmonics are kept until that is below 1e-8 nat and the missing weight
    below 5e-9.
    """
    least = smallest_order(np.sqrt(length_squared))
    most = least + least // 2 + 6
    weight, _, _ = weights(length_squared, most + 1)
    tolerance = min(KERNEL_ERROR, LIKELIHOOD_ERROR_NAT / signal_to_noise)
    beyond, order = weight[most + 1], most
    while order > least and beyond + weight[order] <= tolerance:
        beyond += weight[order]
        order -= 1
    return order


@compiled
def harmonic_terms(
    gram: FloatArray, moment: FloatArray, square_m2: float, n_points: int, order: int, log_beta: FloatArray
) -> tuple[float, float, FloatArray, FloatArray]:
    """Log marginal likelihood, the most likely mu - mean r, gradient (3,) and Hessian (3, 3) by log beta.

    Parameters
    ----------
    gram, moment
        Phi' Phi (feature, feature) and Phi' (r - mean r) (feature,), of `order` harmonics or more.
    square_m2
        Sum of the squared residuals r - mean r.
    order
        The highest harmonic to use, see `needed_order`.
    """
    signal_variance, length_squared, noise_variance = np.exp(log_beta)
    weight, slope, bend = weights(length_squared, order)
    size = 2 * order + 1
    scale, by_length, twice_by_length = np.empty(size), np.empty(size), np.empty(size)
    for k in range(size):
        harmonic = (k + 1) // 2
        scale[k] = np.sqrt(signal_variance / noise_variance * weight[harmonic])
        by_length[k], twice_by_length[k] = slope[harmonic], bend[harmonic]
    B = gram[:size, :size] * scale
    for i in range(size):
        for j in range(size):
            B[i, j] *= scale[i]
        B[i, i] += 1.0
    log_determinant = n_points * np.log(noise_variance) + 2 * np.sum(np.log(np.diag(np.linalg.cholesky(B))))
    inverse = np.linalg.inv(B)
    noise_std = np.sqrt(noise_variance)
    q, q_ones = moment[:size] * scale / noise_std, gram[0, :size] * scale / noise_std
    v, v_ones = inverse @ q, inverse @ q_ones
    ones_square = n_points / noise_variance - q_ones @ v_ones
    ones_residual = -(q_ones @ v)  # the residuals sum to zero
    shift = ones_residual / ones_square
    square = square_m2 / noise_variance - q @ v - shift * ones_residual
    v = v - shift * v_ones
    value = -0.5 * (square + log_determinant + n_points * np.log(2 * np.pi))

    of_inverse, squares = np.diag(inverse).copy(), np.zeros(size)  # squares: diagonal of B^-2
    turned = inverse @ v
    by_variance = 0.5 * (v * v - 1 + of_inverse)
    of_rows, of_rows_by_length = np.zeros(size), np.zeros(size)
    for k in range(size):
        for j in range(size):
            squares[k] += inverse[k, j] * inverse[k, j]
            explained = -inverse[k, j] if k != j else 1 - inverse[k, j]
            second = 0.5 * explained * explained - v[k] * explained * v[j]
            of_rows[k] += second
            of_rows_by_length[k] += second * by_length[j]
    of_noise = square - v @ v
    gradient, hessian = np.empty(3), np.empty((3, 3))
    gradient[0], gradient[1] = by_variance.sum(), by_variance @ by_length
    gradient[2] = 0.5 * (of_noise - n_points + np.sum(1 - of_inverse))
    with_noise = 0.5 * (of_inverse - squares) - turned * v
    hessian[0, 0] = of_rows.sum() + gradient[0]
    hessian[0, 1] = hessian[1, 0] = of_rows_by_length.sum() + gradient[1]
    hessian[1, 1] = by_length @ of_rows_by_length + by_variance @ (by_length * by_length + twice_by_length)
    hessian[0, 2] = hessian[2, 0] = with_noise.sum()
    hessian[1, 2] = hessian[2, 1] = with_noise @ by_length
    both = n_points - size + squares.sum()  # tr (sigma_n^2 K_y^-1)^2
    hessian[2, 2] = gradient[2] + 0.5 * both - of_noise + v @ turned
    from_mean = np.array([v_ones @ v, (v_ones * v) @ by_length, -(v_ones @ v)])
    for i in range(3):
        for j in range(3):
            hessian[i, j] += from_mean[i] * from_mean[j] / ones_square
    return value, shift, gradient, hessian
