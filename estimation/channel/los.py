"""Which path is the line of sight (LOS)? A probability from delays, powers and, if poses are known, angles.

Hypotheses: path i is the LOS and earlier paths are ghosts, or there is no LOS. With the clock bias b and the
length l_j = c (tau_j - b) of path j, its loss beyond free space is

    L_j(b) = level - 20 log10(l_j / 1 m) - P_j,

about zero for a LOS, about `reflection_loss_db` for any other path, and never much below zero. M_i is the smallest
loss of the paths after i. The evidence for path i is the Bayes factor

    B_i = int p(b) N(L_i; 0, s) f(M_i; m, s_m) db / int p(b) f(L_i; r, s_r) f(M_i; m, s_m) db

with f a normal density whose part below zero is damped by exp(-L^2 / 2 s^2). It is multiplied by the factor of the
angles, a normal density about the known direction over a uniform one on the circle. If the clock is unknown,
powers are nearly uninformative, except for later paths that are too strong; if it is known, power is compared with
distance. The later paths enter as one factor, of the strongest: losses of paths over the same walls are dependent.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from estimation.channel.config import LosConfig
from scenes.pose import SPEED_OF_LIGHT_M_S, wrap_angle
from scenes.record import BoolArray, FloatArray

CANDIDATES = 3  # earliest paths that are tested
MASKED_DB = 10.0  # a path this far below another one in its delay cell is no line of sight
CLOCK_POINTS = 3001
MIN_LENGTH_M = 0.1
NONE_FOR_SURE = -700.0  # log of a likelihood that is zero in double precision


@dataclass(frozen=True)
class LosDirection:
    """Direction of the line of sight for a receiver of known pose; rad in the device frames."""

    aod_azimuth_rad: float
    aoa_azimuth_rad: float


def los_probability(
    delay_s: FloatArray,
    power_dbm: FloatArray,
    config: LosConfig,
    *,
    angles_rad: FloatArray | None = None,
    angle_variance: FloatArray | None = None,
    direction: LosDirection | None = None,
    cell_s: float = 0.0,
) -> FloatArray:
    """Probability (path,) that each path is the line of sight; paths are sorted by delay.

    Parameters
    ----------
    delay_s
        (path,) with the unknown clock bias.
    power_dbm
        (path,) that the peaks of two beams would receive: corrected for the gain of the beams towards the path.
    angles_rad, angle_variance
        (path, 2) azimuths of departure and arrival and their variances; used if `direction` is known.
    cell_s
        Resolution in delay. Within a cell the order of paths is uninformative, and a path far below another one is
        its side lobe by wrong beam patterns, or a later path: neither a line of sight nor evidence against one.
    """
    seen = ~_masked(delay_s, power_dbm, cell_s)
    if not seen.all():
        probability = np.zeros(len(delay_s))
        angles, spread = (None if part is None else part[seen] for part in (angles_rad, angle_variance))
        probability[seen] = los_probability(
            delay_s[seen], power_dbm[seen], config, angles_rad=angles, angle_variance=spread, direction=direction
        )
        return probability
    n = len(delay_s)
    candidates = range(min(n, CANDIDATES))
    log_odds = [_log_bayes_factor(delay_s[i:], power_dbm[i:], config) for i in candidates]
    if direction is not None and angles_rad is not None:
        variance = np.zeros((n, 2)) if angle_variance is None else angle_variance
        log_odds = [
            odds + _angle_factor(angles_rad[i], variance[i], direction, config)
            for i, odds in zip(candidates, log_odds, strict=True)
        ]
    prior = _order_log_prior(len(log_odds), config)
    score = np.array([np.log(config.blocked_share), *(prior + np.array(log_odds))])
    weight = np.exp(score - score.max())
    probability = np.zeros(n)
    probability[: len(log_odds)] = weight[1:] / weight.sum()
    return probability


def _masked(delay_s: FloatArray, power_dbm: FloatArray, cell_s: float) -> BoolArray:
    """Mask (path,) of the paths with a much stronger one in their delay cell."""
    near = np.abs(delay_s[:, None] - delay_s) < cell_s
    louder = power_dbm[None] > power_dbm[:, None] + MASKED_DB
    return np.asarray((near & louder).any(axis=1))


def loss_beyond_free_space_db(length_m: FloatArray, below_db: FloatArray) -> FloatArray:
    """Loss of paths beyond free space, from lengths and powers below that of a line of sight at 1 m."""
    return np.asarray(below_db - 20 * np.log10(length_m))


def line_of_sight(probability: FloatArray) -> BoolArray:
    """Mask (path,) of the path whose probability to be the line of sight exceeds 0.5: at most one."""
    return np.asarray(probability > 0.5)


def _log_bayes_factor(delay_s: FloatArray, power_dbm: FloatArray, config: LosConfig) -> float:
    """Log of B for the first of these paths."""
    bias_s, log_prior = _clock(config)
    bias_s, log_prior = (
        values[delay_s[0] - bias_s >= MIN_LENGTH_M / SPEED_OF_LIGHT_M_S] for values in (bias_s, log_prior)
    )
    if not len(bias_s):
        return NONE_FOR_SURE
    length_m = SPEED_OF_LIGHT_M_S * (delay_s - bias_s[:, None])
    loss_db = loss_beyond_free_space_db(length_m, config.power_at_1m_dbm - power_dbm)
    own, least = loss_db[:, 0], loss_db[:, 1:].min(axis=1, initial=np.inf)
    later = np.zeros(len(bias_s))
    if len(delay_s) > 1:
        later = _log_loss(least, config.least_loss_db, config.least_loss_std_db, config.tolerance_db)
    sight = -0.5 * (own / config.tolerance_db) ** 2 - np.log(config.tolerance_db)
    bounce = _log_loss(own, config.reflection_loss_db, config.reflection_std_db, config.tolerance_db)
    return float(np.logaddexp.reduce(log_prior + sight + later) - np.logaddexp.reduce(log_prior + bounce + later))


def sight_log_prior(delay_s: FloatArray, power_dbm: FloatArray, config: LosConfig, cell_s: float) -> FloatArray:
    """Log prior (path,) that a path is the line of sight, by order alone; paths are sorted by delay."""
    prior = np.full(len(delay_s), -np.inf)
    seen = np.flatnonzero(~_masked(delay_s, power_dbm, cell_s))[:CANDIDATES]
    prior[seen] = _order_log_prior(len(seen), config)
    return prior


def _order_log_prior(n: int, config: LosConfig) -> FloatArray:
    """Log prior (path,) that each of the first `n` paths is the line of sight and those before it are ghosts."""
    return np.asarray(np.log1p(-config.blocked_share) + np.log(config.ghost_share) * np.arange(n))


def clock_log_likelihood(
    delay_s: FloatArray,
    power_dbm: FloatArray,
    config: LosConfig,
    bias_s: FloatArray,
    *,
    log_prior: FloatArray,
    sight_std_db: float,
    sight_loss_db: Callable[[FloatArray], FloatArray],
) -> FloatArray:
    """Log-likelihood (clock,) of clock biases (clock,) by the powers of the first paths, in order of delay.

    One of them is the line of sight, or the first one is a reflection: `log_prior` (path,) is that of
    `sight_log_prior`. A line of sight of length l has the loss `sight_loss_db(l)`, with the standard deviation
    `sight_std_db`. The other arguments are those of `los_probability`; a clock bias that leaves a path no length
    does not allow it.
    """
    total = np.full(len(bias_s), -np.inf)
    for rank, path in enumerate(np.flatnonzero(np.isfinite(log_prior))):
        length_m = SPEED_OF_LIGHT_M_S * (delay_s[path] - bias_s)
        is_possible = length_m >= MIN_LENGTH_M
        length_m = np.maximum(length_m, MIN_LENGTH_M)
        loss_db = loss_beyond_free_space_db(length_m, config.power_at_1m_dbm - power_dbm[path])
        excess = (loss_db - sight_loss_db(length_m)) / sight_std_db
        either = log_prior[path] - 0.5 * excess**2 - np.log(sight_std_db)
        if rank == 0:
            bounce = _log_loss(loss_db, config.reflection_loss_db, config.reflection_std_db, config.tolerance_db)
            either = np.logaddexp(either, np.log(config.blocked_share) + bounce)
        total = np.where(is_possible, np.logaddexp(total, either), total)
    return total


def _clock(config: LosConfig) -> tuple[FloatArray, FloatArray]:
    """Evenly spaced clock biases in s, and the log of their prior, not normalised."""
    if config.clock_std_ns is None:
        bias_ns = np.linspace(-config.max_clock_bias_ns, config.max_clock_bias_ns, CLOCK_POINTS)
        return 1e-9 * bias_ns, np.zeros(CLOCK_POINTS)
    deviation = np.linspace(-6.0, 6.0, CLOCK_POINTS)
    return 1e-9 * config.clock_std_ns * deviation, -0.5 * deviation**2


def _log_loss(loss_db: FloatArray, mean_db: float, std_db: float, tolerance_db: float) -> FloatArray:
    """Log density, up to a constant, of the loss of a reflection: at least that of a perfect mirror."""
    gain_db = np.minimum(loss_db, 0.0)
    return np.asarray(
        -0.5 * ((loss_db - mean_db) / std_db) ** 2 - 0.5 * (gain_db / tolerance_db) ** 2 - np.log(std_db)
    )


def _angle_factor(
    angles_rad: FloatArray, variance: FloatArray, direction: LosDirection, config: LosConfig
) -> float:
    """Log ratio of the density about the known direction to the uniform density."""
    known = np.array([direction.aod_azimuth_rad, direction.aoa_azimuth_rad])
    spread = variance + np.deg2rad(config.angle_std_deg) ** 2
    error = wrap_angle(angles_rad - known)
    return float((-0.5 * error**2 / spread - 0.5 * np.log(2 * np.pi * spread) + np.log(2 * np.pi)).sum())
