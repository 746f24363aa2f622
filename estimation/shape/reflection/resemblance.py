"""Pillars of one scene resemble each other: what the others show is the prior of each.

The logarithms of the radii are taken as normal about a common mean m with a common spread t, and the kinds of
contour as drawn with common shares. Of the variance of a single pillar's logarithm half is m's, half the
spread's; the prior spread counts as one pillar, and the prior shares do too (conjugate priors: Gelman et al.,
"Bayesian Data Analysis", 3rd edition, sections 2.6 and 3.4). Pillars count by how far their own paths narrowed
their radius.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from estimation.shape.fit import ShapeFit
from estimation.shape.reflection.choice import CLASSES, Choice
from estimation.shape.reflection.reflections import ReflectionConfig
from scenes.record import FloatArray

_PILLAR_KINDS = tuple(CLASSES["pillar"])
_PRIOR_COUNT = 1.0


def prior_from_others(
    choices: Sequence[Choice], k: int, config: ReflectionConfig
) -> tuple[ReflectionConfig, Mapping[str, float]]:
    """Settings with the radius prior, and the shares of the pillar kinds, that all objects but `k` suggest."""
    others = [choice for j, choice in enumerate(choices) if j != k]
    weight = np.array([_weight(choice, config) for choice in others])
    log_radius = np.array([_log_radius(choice)[0] for choice in others])
    mean, std = radius_prior(log_radius, weight, config)
    told = {kind: _PRIOR_COUNT * CLASSES["pillar"][kind] for kind in _PILLAR_KINDS}
    for choice, each in zip(others, weight, strict=True):
        for kind in _PILLAR_KINDS:
            told[kind] += each * choice.probability[kind]
    total = sum(told.values())
    settings = config.model_copy(update={"radius_median_m": float(np.exp(mean)), "radius_log_std": std})
    return settings, {kind: value / total for kind, value in told.items()}


def radius_prior(log_radius: FloatArray, weight: FloatArray, config: ReflectionConfig) -> tuple[float, float]:
    """Mean and standard deviation of the logarithm of one more radius, after logarithms (n,) of weights (n,).

    A weight is 1 for a radius that is known and 0 for one of which nothing is.
    """
    prior_mean, prior_variance = float(np.log(config.radius_median_m)), config.radius_log_std**2 / 2
    count = float(weight.sum())
    if count == 0:
        return prior_mean, config.radius_log_std
    middle = float(weight @ log_radius / count)
    spread = float(weight @ (log_radius - middle) ** 2)
    variance = (_PRIOR_COUNT * prior_variance + spread) / (_PRIOR_COUNT + count)
    precision = 1 / prior_variance + count / variance
    mean = (prior_mean / prior_variance + count * middle / variance) / precision
    return mean, float(np.sqrt(variance + 1 / precision))


def _log_radius(choice: Choice) -> tuple[float, float]:
    """Logarithm of the mean radius of the most probable pillar, and its variance."""
    best = max(_PILLAR_KINDS, key=lambda kind: choice.probability[kind])
    shape: ShapeFit = choice.fits[best]
    if not shape.is_usable:
        return 0.0, np.inf
    return float(shape.parameter[2]), float(shape.parameter_covariance[2, 2])


def _weight(choice: Choice, config: ReflectionConfig) -> float:
    """How much an object tells of the scene's pillars: as far as it is one and its radius is known."""
    share = choice.class_probability["pillar"]
    _, variance = _log_radius(choice)
    return float(share * max(1 - variance / config.radius_log_std**2, 0.0))
