"""What paths do not explain: the background over delay, and errors from an incomplete model of the paths.

An undetected neighbour (too weak or too close) of relative amplitude rho and offset d adds rho d times the
derivative of the path's response. Its part in phase with the path shifts the estimate and is invisible in the
residual. No shift explains its part in quadrature: it remains in the residual. Phases of true paths are
independent and uniform, so both parts have one distribution: the energy of the derivatives in quadrature, over its
value in noise, measures the squared error over the bound. In noise it is chi-square, with one degree of freedom
per parameter. These are few; so all paths of a stop together say how large errors are (empirical Bayes).
"""

from dataclasses import dataclass

import numpy as np

from estimation.channel.coherent.refine import Reference, Solution
from estimation.channel.model.cholesky import regular_inverse
from estimation.channel.model.path_model import PathParameters, gram_matrix
from estimation.distributions import chi_square_log_density, f_log_density
from scenes.record import BoolArray, ComplexArray, FloatArray, IntArray

LEAST_SEEN = 1e-9  # information on a shift, relative to the amplitude, below which it is unobservable
N_TYPICAL = 40  # trial values of the typical scale of a stop
SMOOTHING_BINS = 2  # to either side, for the background's power over delay
NOISE_STD = 5.0  # deviation of a smoothed bin's power up to which it counts as noise
KEPT_SHARE = 0.95  # of the directions, from the weakest up, that the background is estimated from
OWN_BINS, FIELD_BINS = 2, 12  # to either side of a path: filled by itself, and where a field shows
FREEDOM = 2 + np.geomspace(0.5, 200, 20)  # trial degrees of freedom: few where scales differ much


@dataclass(frozen=True)
class PathErrors:
    """What is known of the errors of a solution.

    Attributes
    ----------
    by_noise : (path, parameter, path, parameter) of delays in bins and angles in rad by the nominal noise
    scale : (path,) of that noise
    beside : (path, parameter, parameter) covariance by everything else
    unresolved_probability : (path,) that a path stands for two within half a resolution cell
    is_redundant : (path,) that the others explain the path but for errors of the model
    """

    by_noise: FloatArray
    scale: FloatArray
    beside: FloatArray
    unresolved_probability: FloatArray
    is_redundant: BoolArray

    @property
    def joint(self) -> FloatArray:
        """Covariance (path, parameter, path, parameter) of delays in bins and angles in rad."""
        root, every = np.sqrt(self.scale), np.arange(len(self.scale))
        joint = root[:, None, None, None] * root[:, None] * self.by_noise
        joint[every, :, every] += self.beside
        return np.asarray(joint)


def background_over_delay(residual: ComplexArray) -> FloatArray:
    """Smoothed power (bin,) of the residual (tx_rank, rx_rank, bin) of the paths; 1 if noise explains it.

    The strongest directions are left out: power only there, such as of unresolved paths, is no dense background.
    The mean of an exponential variable below its quantile p is 1 + (1 - p) log(1 - p) / p.
    """
    directions = np.sort(np.square(np.abs(residual)).reshape(-1, residual.shape[2]), axis=0)
    n_kept = max(1, int(np.ceil(KEPT_SHARE * len(directions))))
    share = n_kept / len(directions)
    expected = 1 + (1 - share) * np.log(1 - share) / share if share < 1 else 1.0
    power = directions[:n_kept].mean(axis=0, dtype=float) / expected
    width = 2 * SMOOTHING_BINS + 1
    smooth = np.convolve(np.pad(power, SMOOTHING_BINS, mode="edge"), np.ones(width) / width, "valid")
    n_cells = residual.shape[0] * residual.shape[1] * width
    return np.where(smooth > 1 + NOISE_STD / np.sqrt(n_cells), smooth, 1.0)


def error_scale(shown: FloatArray, n_seen: IntArray) -> FloatArray:
    """Scale (path,), at least 1, of the squared errors of paths over their bound, from quadrature statistics.

    Each statistic over its scale is chi-square. The scales of a stop have a scaled inverse chi-square distribution
    whose two parameters maximise the likelihood of all statistics; the posterior mean of each path shrinks to it.
    All scales are 1 if noise alone explains the statistics as well, by the Bayesian information criterion.
    """
    seen = n_seen > 0
    if not seen.any():
        return np.ones(len(shown))
    degrees, value = n_seen[seen], np.maximum(shown[seen], np.finfo(float).tiny)
    typical, freedom = np.meshgrid(
        np.geomspace(1, max(2.0, float((value / degrees).max())), N_TYPICAL), FREEDOM, indexing="ij"
    )
    ratio = value / degrees / typical[..., None]
    each = f_log_density(ratio, degrees, freedom[..., None]) - np.log(degrees * typical[..., None])
    likelihood = each.sum(axis=2)
    best = np.unravel_index(int(np.argmax(likelihood)), likelihood.shape)
    if likelihood[best] - chi_square_log_density(value, degrees).sum() < np.log(len(value)):
        return np.ones(len(shown))
    known = freedom[best] * typical[best]
    return np.asarray(np.maximum(1.0, (known + np.where(seen, shown, 0.0)) / (freedom[best] + n_seen - 2)))


def weak_field(reference: Reference, paths: PathParameters, is_weak: BoolArray) -> FloatArray:
    """Noise power (path,) that paths compete with if weak ones are a field; 1 if noise explains it.

    That is the power of the residual and of the weak paths together, in a path's directions, between those on both
    sides of its delay on a logarithmic scale: fields decay, and start with their first path. Weak paths count at
    their own delays alone: the side lobes of a single one are no field.
    """
    sweep, weak = reference.sweep, np.flatnonzero(is_weak)
    tx, rx = sweep.tx.response(paths.aod_rad), sweep.rx.response(paths.aoa_rad)
    energy = np.square(np.abs(tx)).sum(axis=1) * np.square(np.abs(rx)).sum(axis=1)
    half = sweep.n_subcarriers / 2
    apart = (sweep.position - paths.delay_bins[:, None] + half) % sweep.n_subcarriers - half
    lobe = np.where(np.abs(apart[weak]) <= 1, sweep.delay_response(paths.delay_bins[weak])[:, 0], 0.0)
    along = (tx.conj() @ tx[weak].T) * (rx.conj() @ rx[weak].T) * paths.amplitude[weak]
    power = np.ones(len(paths))
    for path in np.flatnonzero(energy > 0):
        for side in (-1, 1):
            beside = (side * apart[path] > OWN_BINS) & (side * apart[path] <= FIELD_BINS)
            rest = reference.parts[..., beside]
            matched = np.einsum("m,mnb,n->b", tx[path].conj(), rest[0] + 1j * rest[1], rx[path].conj())
            n = matched.size
            if n > (FIELD_BINS - OWN_BINS) / 2:
                matched = matched + along[path] @ lobe[:, beside]
                level = float(np.median(np.square(np.abs(matched)))) / energy[path] / np.log(2)
                power[path] *= np.sqrt(level) if level > 1 + NOISE_STD / np.sqrt(n) else 1.0
    return power


def quadrature_statistic(reference: Reference, solution: Solution) -> tuple[FloatArray, IntArray]:
    """Energy (path,) of the residual along each path's derivatives in quadrature: chi-square in noise alone.

    It is the score test of one more amplitude per parameter, imaginary shifts, against the model of all paths. The
    second result is the number (path,) of observable parameters, the degrees of freedom.
    """
    n, n_columns = solution.slope.shape
    amplitude = solution.paths.amplitude
    at = reference.at
    inner, residual = gram_matrix(at, at), reference.residual_products(at)
    energy = np.einsum("papa->pa", inner)[:, 0].real
    tangent = np.maximum(np.arange(n_columns) - 1, 0)  # of every column of the normal equations
    scale = np.repeat(amplitude[:, None], n_columns, axis=1)
    scale[:, :2] = [1.0, 1.0j]
    inverse = solution.inverse
    statistic, n_seen = np.zeros(n), np.zeros(n, int)
    for path in range(n):
        turned = (1j * amplitude[path]).conj()
        cross = (turned * inner[path, 1:][:, :, tangent] * scale).real.reshape(n_columns - 2, -1)
        own = np.square(np.abs(amplitude[path])) * inner[path, 1:, path, 1:].real
        known = cross @ inverse
        score = (turned * residual[path, 1:]).real - known @ solution.slope.ravel()
        information = own - known @ cross.T
        seen = np.diagonal(information) > LEAST_SEEN * np.square(np.abs(amplitude[path])) * energy[path]
        n_seen[path] = seen.sum()
        statistic[path] = 2 * score[seen] @ regular_inverse(information[np.ix_(seen, seen)]) @ score[seen]
    return statistic, n_seen
