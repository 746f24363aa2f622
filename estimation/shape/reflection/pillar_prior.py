"""Pillars of one scene are similar: the fits of the others give the prior of each.

The logarithms of the radii are normal about a common mean with a common spread, and the kinds of contour have
common shares. The prior variance of the logarithm of a radius is half due to the mean and half due to the
spread. The prior spread and the prior shares count as one pillar each (conjugate priors: Gelman et al.,
"Bayesian Data Analysis", 3rd edition, sections 2.6 and 3.4). A pillar has more weight the more its own paths
reduce the variance of its radius.
"""

from collections.abc import Mapping, Sequence

import numpy as np

from estimation.shape.config import ReflectionConfig
from estimation.shape.reflection.choice import CLASSES, Choice
from scenes.record import FloatArray

_PILLAR_KINDS = tuple(CLASSES["pillar"])
_PRIOR_COUNT = 1.0


def prior_from_others(
    choices: Sequence[Choice], k: int, config: ReflectionConfig
) -> tuple[ReflectionConfig, Mapping[str, float]]:
    """Settings with the radius prior, and the shares of the pillar kinds, from all objects except `k`."""
    others = [choice for j, choice in enumerate(choices) if j != k]
    weight = np.array([_weight(choice, config) for choice in others])
    log_radius = np.array([_log_radius(choice)[0] for choice in others])
    mean, std = radius_prior(log_radius, weight, config)
    count = {kind: _PRIOR_COUNT * CLASSES["pillar"][kind] for kind in _PILLAR_KINDS}
    for choice, each in zip(others, weight, strict=True):
        for kind in _PILLAR_KINDS:
            count[kind] += each * choice.probability[kind]
    total = sum(count.values())
    settings = config.model_copy(update={"radius_median_m": float(np.exp(mean)), "radius_log_std": std})
    return settings, {kind: value / total for kind, value in count.items()}


def radius_prior(log_radius: FloatArray, weight: FloatArray, config: ReflectionConfig) -> tuple[float, float]:
    """Mean and standard deviation of the logarithm of one more radius, given logarithms (n,) with weights (n,).

    The weight is 1 for a known radius and 0 for an unknown one.
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
    shape = choice.fits[max(_PILLAR_KINDS, key=lambda kind: choice.probability[kind])]
    if not shape.is_usable:
        return 0.0, np.inf
    return float(shape.parameter[2]), float(shape.parameter_covariance[2, 2])


def _weight(choice: Choice, config: ReflectionConfig) -> float:
    """Probability of being a pillar times the share of the prior variance of the radius that the fit removed."""
    share = choice.class_probability["pillar"]
    _, variance = _log_radius(choice)
    return float(share * max(1 - variance / config.radius_log_std**2, 0.0))
