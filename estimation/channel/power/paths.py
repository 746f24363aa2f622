"""The power-only, delay-resolved method: paths from beam powers over delay, without phases between beams.

Idea as in Rastorgueva-Foi et al., arXiv 2312.13741 (beam powers and their singular vectors): at its delay, the
power of one path over the beam pairs is the product of a TX and an RX profile, so the dominant singular pair
separates the two angles. The nominal beam patterns give the angles of the profiles, and the side lobes.
"""

from dataclasses import dataclass

import numpy as np

from estimation.channel.config import LosConfig, PowerMethodConfig
from estimation.channel.los import line_of_sight, los_probability
from estimation.channel.model.delay import OVERSAMPLING, DelayPower, delay_power, match_delay
from estimation.channel.power.beams import AngleFit, BeamAxis
from estimation.channel.power.detect import Peaks, SideLobeEnvelope, local_maxima, noise_threshold
from estimation.channel.record import UNKNOWN_ANGLE_VARIANCE, AngleKind, ChannelEstimate
from scenes.record import FloatArray
from sim.observation import BeamSweep


@dataclass(frozen=True)
class _Path:
    """One accepted path while the list grows."""

    snr: float
    tx_beam: int
    rx_beam: int
    delay_bin: float
    delay_misfit: float
    aod: AngleFit
    aoa: AngleFit


def estimate_power(
    sweep: BeamSweep, config: PowerMethodConfig | None = None, los: LosConfig | None = None
) -> ChannelEstimate:
    """Paths of one stop by the power-only, delay-resolved method.

    Peaks of the beam power over delay are processed from the strongest down. A peak is kept if it exceeds the
    noise threshold, the dynamic range and the side lobes of all kept paths, and fits the beam patterns. The
    estimate may be empty.
    """
    config = config or PowerMethodConfig()
    power = delay_power(sweep)
    tx, rx = BeamAxis(sweep.tx_codebook), BeamAxis(sweep.rx_codebook)
    threshold = noise_threshold(power.snr.size / OVERSAMPLING, config.false_alarm_probability)
    floor = max(threshold, float(power.snr.max()) * 10 ** (-config.dynamic_range_db / 10))
    peaks = local_maxima(power, tx, rx, floor)
    envelope = SideLobeEnvelope(tx, rx, power.snr.shape[2])
    paths = _accept(peaks, power, (tx, rx), envelope, threshold, config)
    return _assemble(sweep, power, paths, (tx, rx), envelope, config, los or LosConfig())


def _accept(
    peaks: Peaks,
    power: DelayPower,
    axes: tuple[BeamAxis, BeamAxis],
    envelope: SideLobeEnvelope,
    threshold: float,
    config: PowerMethodConfig,
) -> list[_Path]:
    margin = 10 ** (config.side_lobe_margin_db / 20)
    amplitude, explained = np.sqrt(peaks.snr), np.zeros(len(peaks))
    paths: list[_Path] = []
    for index in range(len(peaks)):
        if len(paths) == config.max_paths:
            break
        side_lobes = explained[index]
        if amplitude[index] <= max(margin * side_lobes, side_lobes + np.sqrt(threshold)):
            continue
        path = _refine(peaks, index, power, *axes, use_patterns=config.use_patterns)
        if max(path.aod.residual, path.aoa.residual) > config.max_misfit:
            continue
        paths.append(path)
        envelope.add(path.snr, path.aod.azimuth_rad, path.aoa.azimuth_rad, path.delay_bin)
        explained += envelope.contributions(peaks.tx_beam, peaks.rx_beam, peaks.delay.astype(float))[-1]
    return paths


def _refine(
    peaks: Peaks, index: int, power: DelayPower, tx: BeamAxis, rx: BeamAxis, *, use_patterns: bool
) -> _Path:
    """Delay by a parabola on the log power, angles from the singular vectors of the beam powers around a peak."""
    m, n, d = int(peaks.tx_beam[index]), int(peaks.rx_beam[index]), int(peaks.delay[index])
    tx_beams, rx_beams = tx.neighbourhood(m), rx.neighbourhood(n)
    offset, misfit = match_delay(power, m, n, d)
    local = np.maximum(power.snr[tx_beams[:, None], rx_beams, d].astype(float) - 1, 0)
    left, values, right = np.linalg.svd(local)
    aod, aoa = (
        (axis.match if use_patterns else axis.match_without_patterns)(beams, np.sqrt(np.abs(profile) * values[0]))
        for axis, beams, profile in ((tx, tx_beams, left[:, 0]), (rx, rx_beams, right[0]))
    )
    return _Path(float(peaks.snr[index]), m, n, d + offset, misfit, aod, aoa)


def _assemble(
    sweep: BeamSweep,
    power: DelayPower,
    paths: list[_Path],
    axes: tuple[BeamAxis, BeamAxis],
    envelope: SideLobeEnvelope,
    config: PowerMethodConfig,
    los: LosConfig,
) -> ChannelEstimate:
    n_bins = power.snr.shape[2]
    bin_s = float(power.delay_s[1])
    delay_bin = np.array([p.delay_bin for p in paths])
    # A clock bias can make the first delay negative: the last eighth of the circle counts as negative.
    delay_bin = (delay_bin + n_bins / 8) % n_bins - n_bins / 8
    order = np.argsort(delay_bin, kind="stable")
    paths, delay_s = [paths[i] for i in order], delay_bin[order] * bin_s
    snr = np.array([p.snr for p in paths])
    noise_mw = power.noise_power_mw[[p.rx_beam for p in paths]] if paths else np.zeros(0)
    power_dbm = 10 * np.log10(snr * noise_mw)
    tx, rx = axes
    loss_db = np.array([tx.loss_db(p.aod.azimuth_rad) + rx.loss_db(p.aoa.azimuth_rad) for p in paths])
    probability = los_probability(delay_s, power_dbm + loss_db, los)
    beam_gain_db = tx.peak_gain_db + rx.peak_gain_db - loss_db
    return ChannelEstimate(
        stop=sweep.stop,
        delay_s=delay_s,
        aod_azimuth_rad=np.array([p.aod.azimuth_rad for p in paths]),
        aoa_azimuth_rad=np.array([p.aoa.azimuth_rad for p in paths]),
        power_dbm=power_dbm,
        beam_loss_db=loss_db,
        snr_db=10 * np.log10(snr),
        covariance=_covariances(paths, envelope, power, config),
        is_los=line_of_sight(probability),
        los_probability=probability,
        gain_amplitude=10 ** ((power_dbm - beam_gain_db) / 20),
        aod_angle_kind=AngleKind.CONE,
        aoa_angle_kind=AngleKind.CONE,
        method="power",
    )


def _covariances(
    paths: list[_Path], envelope: SideLobeEnvelope, power: DelayPower, config: PowerMethodConfig
) -> FloatArray:
    """Covariance (path, 3, 3) of delay, AoD and AoA, from noise, the other paths' side lobes and the misfit.

    Noise and the amplitudes of the other paths, of random phase, disturb a beam's real amplitude with half their
    power. The misfit to the beam patterns adds what neither explains (unresolved and diffuse paths).
    """
    covariance = np.zeros((len(paths), 3, 3))
    if not paths:
        return covariance
    snr = np.array([p.snr for p in paths])
    cells = (np.array([p.tx_beam for p in paths]), np.array([p.rx_beam for p in paths]))
    leaked = envelope.contributions(*cells, np.array([p.delay_bin for p in paths])) ** 2
    # The envelope lists all accepted paths; leave out each path's own contribution, the largest in its cell.
    interference = np.maximum(leaked.sum(axis=0) - leaked.max(axis=0), 0.0)
    disturbance = 0.5 * (1 + interference) / snr
    misfit = np.array([max(p.delay_misfit, p.aod.residual, p.aoa.residual) for p in paths])
    delay_information = 2 * (2 * np.pi * power.rms_bandwidth_hz) ** 2
    covariance[:, 0, 0] = (disturbance + misfit) / delay_information + (config.delay_std_floor_ns * 1e-9) ** 2
    angle_floor = np.deg2rad(config.angle_std_floor_deg) ** 2
    for axis, fits in ((1, [p.aod for p in paths]), (2, [p.aoa for p in paths])):
        information = np.array([f.information for f in fits])
        spread = (disturbance + misfit) / np.maximum(information, 1e-12) + angle_floor
        covariance[:, axis, axis] = np.minimum(spread, UNKNOWN_ANGLE_VARIANCE)
    return covariance
