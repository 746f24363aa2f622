"""False alarms of a continuous search: the probability that noise alone exceeds a threshold anywhere.

The matched filter to a normalised path response turns white noise into a chi-square field of 2 degrees of freedom
over delay and angles. The number of its excursions above a high level t (power over noise power) follows from the
expected Euler characteristic of the excursion set,

    E = exp(-t) sum_d L_d He_d(sqrt(2 t)) / (2 pi)^(d/2)

(Worsley 1994; Adler and Taylor, Random Fields and Geometry, 2007, theorem 15.10.1), with the Hermite polynomials
He_d and the Lipschitz-Killing curvatures L_d of the searched region in the metric of the field: Euler
characteristic, lengths, areas. Separate excursions are rare and independent: the probability is 1 - exp(-E).
"""

from functools import reduce

import numpy as np
from numpy.polynomial.hermite_e import hermeval

from estimation.channel.model.manifold import CELL, FLAT, Manifold
from scenes.record import FloatArray

HIGHEST_LEVEL = 700.0


def exceedance_probability(level: FloatArray | float, curvatures: FloatArray) -> FloatArray:
    """Probability that noise of unit power exceeds `level` anywhere in a region of `curvatures` (dimension,)."""
    level = np.asarray(level, float)
    dimension = np.arange(len(curvatures))
    expected = np.exp(-level) * hermeval(np.sqrt(2 * level), curvatures / (2 * np.pi) ** (dimension / 2))
    return np.asarray(-np.expm1(-np.maximum(expected, 0.0)))


def detection_level(probability: float, curvatures: FloatArray) -> float:
    """Power over noise power that noise exceeds anywhere in a region with the given probability.

    Raises `ValueError` for a probability outside (0, 1).
    """
    from scipy.optimize import brentq  # noqa: PLC0415  (slow to import)

    if not 0 < probability < 1:
        raise ValueError(f"false_alarm_probability = {probability:g}: must be between 0 and 1")
    # The Euler characteristic falls with the level above the largest root of its polynomial: search from above.
    levels = np.linspace(HIGHEST_LEVEL, 0.0, 7001)
    first = int(np.argmax(exceedance_probability(levels, curvatures) >= probability))
    if first == 0:
        return 0.0
    return float(
        brentq(
            lambda level: float(exceedance_probability(level, curvatures)) - probability,
            levels[first],
            levels[first - 1],
        )
    )


def region_curvatures(*factors: FloatArray) -> FloatArray:
    """Lipschitz-Killing curvatures (dimension,) of a product of regions."""
    return np.asarray(reduce(np.convolve, factors))


def delay_curvatures(n_bins: float, n_subcarriers: int) -> FloatArray:
    """Curvatures of an interval of `n_bins` delay bins, or of the closed circle if it is the whole period."""
    length = n_bins * CELL * np.sqrt(1 - 1 / n_subcarriers**2)
    return np.array([0.0 if n_bins >= n_subcarriers else 1.0, length])


def direction_curvatures(manifold: Manifold) -> FloatArray:
    """Curvatures of all directions that the beams cover: of a curve for one angle, of a surface for two."""
    azimuth = manifold.azimuths()
    if manifold.n_angles == 1:
        speed = manifold.rates(azimuth[:, None])[:, 0]
        length = _integral(speed, azimuth, is_closed=manifold.is_closed)
        return np.array([0.0 if manifold.is_closed and length > FLAT else 1.0, length])
    elevation = manifold.elevations()
    area_rows, edge_rows, side = [], [], []
    for level in elevation:
        metric = manifold.metric(np.stack([azimuth, np.full(len(azimuth), level)], axis=1))
        density = np.sqrt(np.maximum(np.linalg.det(metric), 0.0))
        area_rows.append(_integral(density, azimuth, is_closed=manifold.is_closed))
        edge_rows.append(_integral(np.sqrt(metric[:, 0, 0]), azimuth, is_closed=manifold.is_closed))
        side.append(np.sqrt(metric[[0, -1], 1, 1]))
    area = float(np.trapezoid(area_rows, elevation))
    boundary = edge_rows[0] + edge_rows[-1]
    if not manifold.is_closed:
        boundary += float(np.trapezoid(np.array(side), elevation, axis=0).sum())
    return np.array([0.0 if manifold.is_closed else 1.0, boundary / 2, area])


def _integral(values: FloatArray, azimuth: FloatArray, *, is_closed: bool) -> float:
    if is_closed:
        return float(values.mean() * 2 * np.pi)
    return float(np.trapezoid(values, azimuth))
