"""Log evidence of the modes of one stop, with and without a line of sight, by which they are ranked; compiled."""

import math
from typing import NamedTuple

import numpy as np

from estimation.execution import compiled
from estimation.slam.config import PathLoss, SnapshotConfig
from scenes.record import FloatArray

_DISTANCES = np.geomspace(0.05, 2.0, 12)  # of the reach
_MIN_LENGTH_M = 1e-3


class PowerLaw(NamedTuple):
    """`estimation.slam.config.PathLoss` in the form that the compiled functions take; variances in dB^2."""

    intercept_dbm: float
    slope_db: float
    los_std_db: float
    loss_db: float
    own_variance: float
    level_variance: float


class SnapshotPrior(NamedTuple):
    """Prior of a state and of clutter."""

    reach_m: float
    max_clock_m: float
    information: FloatArray  # (4,) inverse variances
    clutter_share: float
    log_clutter_volume: float  # log of the volume, in m rad^2, over which clutter is spread


def power_law(loss: PathLoss) -> PowerLaw:
    """Constants of the powers of lines of sight and of all other paths."""
    return PowerLaw(
        loss.intercept_dbm,
        loss.slope_db,
        loss.std_db,
        loss.reflection_loss_db,
        loss.reflection_std_db**2,
        loss.level_std_db**2,
    )


def prior_of(config: SnapshotConfig) -> SnapshotPrior:
    """The prior: Gaussian about the TX, any heading, any credible clock; clutter has any two angles."""
    volume = (2 * math.pi) ** 2 * config.mixture.clutter_width_m
    information = config.prior_std**-2.0
    reach, clock = config.reach_m, config.max_clock_bias_m
    return SnapshotPrior(reach, clock, information, config.mixture.clutter_share, math.log(volume))


@compiled
def log_evidence(
    range_m: FloatArray,
    power_dbm: FloatArray,
    los: int,
    los_covariance: FloatArray,
    state: FloatArray,
    information: FloatArray,
    log_likelihood: float,
    law: PowerLaw,
    prior: SnapshotPrior,
) -> tuple[float, FloatArray]:
    """Laplace approximation of the log evidence of one mode, and its covariance (4, 4).

    The likelihood of delays and angles (`log_likelihood` with its information (4, 4)) and of powers, integrated
    over the state (4,). `los` is the index of the line of sight with covariance (3, 3), -1 for none. Both cases
    have the same prior probability, so their evidences can be compared.
    """
    full = information + np.diag(prior.information)
    distance = math.hypot(state[0], state[1])
    evidence = log_likelihood - 0.5 * np.linalg.slogdet(full)[1]
    evidence -= 0.5 * (distance / prior.reach_m) ** 2
    evidence -= math.log(2 * prior.reach_m**2 * prior.max_clock_m)
    evidence += log_powers(power_dbm, range_m - state[3], distance, los, law)
    if los >= 0:
        evidence -= 0.5 * np.linalg.slogdet(2 * math.pi * los_covariance)[1]
        evidence += prior.log_clutter_volume
    return float(evidence), np.asarray(np.linalg.inv(full))


@compiled
def log_clutter(range_m: FloatArray, power_dbm: FloatArray, law: PowerLaw, prior: SnapshotPrior) -> float:
    """Log evidence of all paths being clutter; the straight line has any length up to twice the reach."""
    first = range_m.min()
    density = np.empty(len(_DISTANCES))
    for k in range(len(_DISTANCES)):
        length = range_m - first + prior.reach_m * _DISTANCES[k]
        density[k] = log_power_of_others(power_dbm, length, -1, law)
    most = density.max()
    share = len(range_m) * math.log(prior.clutter_share)
    return float(most + math.log(np.mean(np.exp(density - most))) + share)


@compiled
def log_powers(power_dbm: FloatArray, length_m: FloatArray, distance_m: float, los: int, law: PowerLaw) -> float:
    """Log density of the powers of all paths (path,) of lengths (path,).

    The path `los`, -1 for none, is the line of sight over `distance_m`. No other true path is shorter than that.
    """
    total = log_power_of_others(power_dbm, np.maximum(length_m, distance_m), los, law)
    if los >= 0:
        deviation = (power_dbm[los] - _expected_dbm(distance_m, law)) / law.los_std_db
        total -= 0.5 * deviation**2 + math.log(math.sqrt(2 * math.pi) * law.los_std_db)
    return float(total)


@compiled
def log_power_of_others(power_dbm: FloatArray, length_m: FloatArray, los: int, law: PowerLaw) -> float:
    """Log density of the powers of all paths (path,) of lengths (path,) but the line of sight, -1 for none."""
    n, total, square = 0, 0.0, 0.0
    for j in range(len(power_dbm)):
        if j != los:
            excess = power_dbm[j] - _expected_dbm(length_m[j], law) + law.loss_db
            n, total, square = n + 1, total + excess, square + excess * excess
    if n == 0:
        return 0.0
    own, level, both = law.own_variance, total / n, law.own_variance + n * law.level_variance
    chi2 = max(square - n * level * level, 0.0) / own + n * level * level / both
    return float(-0.5 * (chi2 + n * math.log(2 * math.pi * own) + math.log(both / own)))


@compiled
def _expected_dbm(length_m: float, law: PowerLaw) -> float:
    return float(law.intercept_dbm + law.slope_db * math.log10(max(length_m, _MIN_LENGTH_M)))
