"""From the paths of a maximum-likelihood fit to the channel estimate that mapping and SLAM read."""

from dataclasses import replace

import numpy as np

from estimation.channel.config import LosConfig
from estimation.channel.correlation import CorrelatedPaths
from estimation.channel.fit import PathFit
from estimation.channel.los import line_of_sight, los_probability
from estimation.channel.model.manifold import Manifold
from estimation.channel.record import (
    UNKNOWN_ANGLE_VARIANCE,
    AngleKind,
    ChannelEstimate,
    EstimateStatus,
    PathMotion,
)
from scenes.record import FloatArray, IntArray
from sim.observation import BeamSweep

GRID_PER_CELL = 4.0  # directions per Rayleigh cell in the search for the highest gain of a codebook


def assemble_estimate(
    sweep: BeamSweep, fit: PathFit, tx: Manifold, rx: Manifold, los: LosConfig, method: str, reason: str
) -> ChannelEstimate:
    """The channel estimate of a fit that used the manifolds `tx` and `rx`.

    Powers and losses are those of the best beams. An unobservable angle gets the variance of a uniform one.
    """
    n = len(fit)
    tx_gain, tx_peak = _best_gains(tx, fit.aod_rad)
    rx_gain, rx_peak = _best_gains(rx, fit.aoa_rad)
    power_dbm = 20 * np.log10(fit.amplitude * tx_gain * rx_gain)
    loss_db = 20 * np.log10(tx_peak * rx_peak / (tx_gain * rx_gain))
    covariance = ordered_covariance(fit.covariance, tx.n_angles, rx.n_angles)
    angles = np.stack([fit.aod_rad[:, 0], fit.aoa_rad[:, 0]], axis=1)
    cell_s = 1 / float(np.ptp(sweep.frequency_offset_hz))
    probability, strong = np.zeros(n), ~fit.is_weak
    probability[strong] = los_probability(fit.delay_s[strong], (power_dbm + loss_db)[strong], los, cell_s=cell_s)
    return ChannelEstimate(
        stop=sweep.stop,
        delay_s=fit.delay_s,
        aod_azimuth_rad=angles[:, 0],
        aoa_azimuth_rad=angles[:, 1],
        power_dbm=power_dbm,
        beam_loss_db=loss_db,
        snr_db=fit.snr_db,
        covariance=covariance,
        is_los=line_of_sight(probability),
        los_probability=probability,
        gain_amplitude=fit.amplitude,
        gain_phase_rad=fit.phase_rad,
        aod_elevation_rad=_elevation(fit.aod_rad),
        aoa_elevation_rad=_elevation(fit.aoa_rad),
        is_weak=fit.is_weak,
        unresolved_probability=fit.unresolved_probability,
        aod_angle_kind=angle_kind(tx),
        aoa_angle_kind=angle_kind(rx),
        method=method,
        status=EstimateStatus.OK if n else EstimateStatus.NO_PATHS,
        reason=reason,
        motion=_motion(fit),
        correlated=_ordered(fit, tx.n_angles, rx.n_angles),
    )


def _ordered(fit: PathFit, n_aod_angles: int, n_aoa_angles: int) -> CorrelatedPaths | None:
    """The correlations of a fit in the order of `ordered_covariance`; unobservable angles have none."""
    if (pairs := fit.correlated) is None:
        return None
    index = _places(n_aod_angles, n_aoa_angles)
    is_wide = np.einsum("paa->pa", fit.covariance) > UNKNOWN_ANGLE_VARIANCE
    is_wide[:, 0] = False
    lost = is_wide[pairs.first][:, :, None] | is_wide[pairs.second][:, None]
    cross = np.where(lost, 0.0, pairs.cross_covariance)[:, index[:, None], index]
    cross[:, index < 0] = cross[:, :, index < 0] = np.nan
    return replace(pairs, cross_covariance=cross)


def _motion(fit: PathFit) -> PathMotion | None:
    """The Doppler shifts of a fit; None if it estimated none."""
    if not fit.size("doppler"):
        return None
    doppler_hz = fit.doppler_hz[:, 0]
    std_hz = np.sqrt(fit.covariance[:, -1, -1])
    moves = doppler_hz != 0
    return PathMotion(moves, doppler_hz, np.where(moves, std_hz, np.nan), fit.seen_s)


def angle_kind(manifold: Manifold) -> AngleKind:
    """Whether the azimuths of a device are azimuths, or cone angles because elevation is unobservable."""
    return AngleKind.AZIMUTH if manifold.n_angles == 2 else AngleKind.CONE


def ordered_covariance(covariance: FloatArray, n_aod_angles: int, n_aoa_angles: int) -> FloatArray:
    """Covariance (path, 3 or 5, 3 or 5) of delay, azimuths and elevations from one in the order of a fit.

    A fit orders delay, departure angles, arrival angles. If one end has no elevation, its row and column are NaN.
    """
    index = _places(n_aod_angles, n_aoa_angles)
    covariance = covariance[:, index[:, None], index]
    unknown = index < 0
    covariance[:, unknown] = np.nan
    covariance[:, :, unknown] = np.nan
    for axis in range(1, len(index)):
        variance = covariance[:, axis, axis]
        wide = variance > UNKNOWN_ANGLE_VARIANCE
        covariance[wide, axis, :] = covariance[wide, :, axis] = 0.0
        covariance[wide, axis, axis] = UNKNOWN_ANGLE_VARIANCE
    return np.asarray(covariance)


def _places(n_aod_angles: int, n_aoa_angles: int) -> IntArray:
    """Places (3 or 5,) of delay, azimuths and elevations in the order of a fit, -1 for an elevation not fitted."""
    place = [0, 1, 1 + n_aod_angles]
    if n_aod_angles + n_aoa_angles > 2:
        place += [2 if n_aod_angles == 2 else -1, 2 + n_aod_angles if n_aoa_angles == 2 else -1]
    return np.array(place)


def _elevation(angles_rad: FloatArray) -> FloatArray:
    return angles_rad[:, 1] if angles_rad.shape[1] == 2 else np.full(len(angles_rad), np.nan)


def _best_gains(manifold: Manifold, angles_rad: FloatArray) -> tuple[FloatArray, float]:
    """Amplitude gain (direction,) of the best beam, and the highest gain of any beam in any direction."""
    peak = float(np.abs(manifold.response(manifold.grid(GRID_PER_CELL))).max())
    return np.abs(manifold.response(angles_rad)).max(axis=1, initial=0.0), peak
