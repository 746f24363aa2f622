"""Powers of versions: what beams lose towards an elevation that they do not observe."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from estimation.channel.coherent.plan import nominal_manifold
from estimation.channel.config import LosConfig
from estimation.channel.hall.paths import RangedPaths
from estimation.channel.los import MIN_LENGTH_M, clock_log_likelihood, loss_beyond_free_space_db, sight_log_prior
from estimation.channel.model.apparent import apparent_angles
from estimation.channel.record import ChannelEstimate
from scenes.pose import SPEED_OF_LIGHT_M_S
from scenes.record import FloatArray, IntArray
from sim.signal.arrays.codebook import Codebook

SIGHT_STD_DB = 2.5  # spread of the power of a line of sight once the loss by elevation is known
FIRST_LENGTH_M = 8.0  # of first paths in halls
TINY_VARIANCE = 1e-20
LEAST_GAIN = 1e-4  # amplitude; beams lose no more than this


def elevation_loss_db(codebook: Codebook, azimuth_rad: FloatArray, elevation_rad: FloatArray) -> FloatArray:
    """Loss (direction,) of the best beams at an elevation against elevation 0 at the same cone angle."""
    _, gain = apparent_angles(codebook, nominal_manifold(codebook), azimuth_rad, elevation_rad)
    return np.asarray(-20 * np.log10(np.maximum(np.abs(gain), LEAST_GAIN)))


class ElevationLoss:
    """What horizontal beams lose towards elevations, at both ends: a table ahead of the first panels."""

    def __init__(self, codebooks: Sequence[Codebook]) -> None:
        self.elevation_rad = np.linspace(0.0, np.deg2rad(85.0), 171)
        self.loss_db = np.zeros((len(codebooks), len(self.elevation_rad)))
        for end, codebook in enumerate(codebooks):
            if nominal_manifold(codebook).n_angles == 1:
                ahead = np.full(len(self.elevation_rad), codebook.panel_azimuth_rad[0])
                self.loss_db[end] = elevation_loss_db(codebook, ahead, self.elevation_rad)

    def __call__(self, sine: FloatArray) -> FloatArray:
        """Loss in dB at both ends towards elevations with these sines."""
        elevation = np.arcsin(np.minimum(np.abs(sine), 1.0))
        return np.asarray(np.interp(elevation, self.elevation_rad, self.loss_db.sum(axis=0)))


@dataclass(frozen=True)
class StopPowers:
    """Powers of the paths of a stop, what else tells classes apart, and which may be the line of sight.

    Attributes
    ----------
    below_db : (path,) power of a line of sight at 1 m over the path's power between peaks of beams
    elevation_loss : of beams that do not observe elevation
    features : (path, 2) log10 of the standard deviation of the range in m, and of the mean one of both azimuths in
        rad: diffuse paths are known less well than others of their power
    sight_log_prior : (path,) that a path is the line of sight, by its order; -inf for late ones
    """

    below_db: FloatArray
    elevation_loss: ElevationLoss
    features: FloatArray
    sight_log_prior: FloatArray

    def take(self, index: IntArray) -> StopPowers:
        """Those of some of the paths."""
        below, features, prior = self.below_db[index], self.features[index], self.sight_log_prior[index]
        return StopPowers(below, self.elevation_loss, features, prior)

    def plain_loss_db(self, paths: RangedPaths, clock_m: float) -> FloatArray:
        """Loss (path,) beyond free space if the path is horizontal."""
        return loss_beyond_free_space_db(np.maximum(paths.range_m - clock_m, MIN_LENGTH_M), self.below_db)

    def loss_as_weak_db(self, paths: RangedPaths) -> FloatArray:
        """The same (path,) at the clock bias of a usual first path: the many weak paths tell no clock."""
        return self.plain_loss_db(paths, float(paths.range_m.min(initial=np.inf)) - FIRST_LENGTH_M)

    def loss_db(self, paths: RangedPaths, clock_m: float, differences_m: FloatArray) -> FloatArray:
        """Loss (path, version) beyond free space and beyond what beams lose by the elevation of each version."""
        length_m = np.maximum(paths.range_m - clock_m, MIN_LENGTH_M)[:, None]
        return self.plain_loss_db(paths, clock_m)[:, None] - self.elevation_loss(differences_m / length_m)


def stop_powers(
    estimate: ChannelEstimate, paths: RangedPaths, elevation_loss: ElevationLoss, config: LosConfig, cell_s: float
) -> StopPowers:
    """Powers and features of an estimate."""
    power_dbm = estimate.power_dbm + estimate.beam_loss_db
    log_variance = np.log10(np.maximum(paths.variance[:, :3], TINY_VARIANCE))
    return StopPowers(
        below_db=config.power_at_1m_dbm - power_dbm,
        elevation_loss=elevation_loss,
        features=np.stack([log_variance[:, 0] / 2, log_variance[:, 1:].mean(axis=1) / 2], axis=1),
        sight_log_prior=sight_log_prior(estimate.delay_s, estimate.power_dbm, config, cell_s),
    )


class SightPower:
    """Prior of clock biases from the powers of the first paths at all stops, for every difference in height."""

    def __init__(
        self,
        estimates: Sequence[ChannelEstimate],
        powers: Sequence[StopPowers],
        clock_m: Sequence[FloatArray],
        config: LosConfig,
    ) -> None:
        self.estimates, self.powers, self.clock_m, self.config = estimates, powers, clock_m, config

    def log_prior(self, difference_m: float) -> list[FloatArray]:
        """Normalised log prior (clock,) of every stop if the heights of the devices differ by this."""
        priors = []
        for estimate, powers, clock_m in zip(self.estimates, self.powers, self.clock_m, strict=True):

            def loss(length_m: FloatArray, powers: StopPowers = powers) -> FloatArray:
                return powers.elevation_loss(difference_m / length_m)

            likelihood = clock_log_likelihood(
                estimate.delay_s,
                self.config.power_at_1m_dbm - powers.below_db,
                self.config,
                clock_m / SPEED_OF_LIGHT_M_S,
                log_prior=powers.sight_log_prior,
                sight_std_db=SIGHT_STD_DB,
                sight_loss_db=loss,
            )
            priors.append(likelihood - np.logaddexp.reduce(likelihood))
        return priors
