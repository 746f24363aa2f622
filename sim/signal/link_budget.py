"""The link budget of a campaign at every stop: received powers, noise levels and the weakest visible path.

Three effects limit the weakest path next to a line of sight:

- Thermal noise, kTBF.
- Converter noise of the receiver. The powers of different beams are comparable only at one fixed gain. So the full
  scale is set once, for the strongest signal of the campaign, and the converter noise is the same at every stop,
  with or without a line of sight.
- Side lobes of strong paths, which appear as crosses in a beam power map. They follow these paths; delay
  resolution or a taper reduces them.

A beam power map has no coherent gain against the first two effects: they limit the weakest path that it shows. In
the real hall the weakest reported paths are at -52 dBm at every stop, with and without a line of sight. This is a
constant noise level, as of a converter, 25 dB below the strongest line of sight. 6 effective bits and 12 dB of
back-off for the peaks of an OFDM signal are common for such wideband receivers and give this level within 2 dB.
One bit changes it by 6 dB.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from scenes.pose import Pose, wrap_angle
from scenes.record import FloatArray, IntArray, Record, array
from sim.config import LinkConfig, WaveformConfig
from sim.propagation.paths import Paths
from sim.signal.arrays.codebook import Codebook, beam_response
from sim.signal.link import Link, best_beam_power_dbm
from sim.signal.power import dbm_to_mw
from sim.signal.waveform.occasions import measurements_per_sample
from sim.truth import Truth

MAP_SNR_DB = 3.0  # a path is visible in the beam power map if its power is at least twice the noise power
FULL_SCALE_SINE_DB = 1.76  # SNR of an ideal converter with b bits: 6.02 b + 1.76 dB, of a sine at full scale
DB_PER_BIT = 20 * np.log10(2.0)


@dataclass(frozen=True)
class LinkBudget(Record):
    """Link budget of a campaign and its stops. Powers are those of the best beam pair of a path."""

    eirp_dbm: float = array(unit="dBm", doc="transmit power plus the highest gain of any TX beam")
    tx_gain_dbi: float = array(unit="dB", doc="highest gain of any TX beam")
    rx_gain_dbi: float = array(unit="dB", doc="highest gain of any RX beam")
    thermal_noise_dbm: float = array(unit="dBm", doc="kTBF per sample, B of the occupied subcarriers, averaged")
    converter_noise_dbm: float = array(unit="dBm", doc="converter noise per sample; -inf without any path")
    processing_gain_db: float = array(unit="dB", doc="coherent sum over the samples of a beam pair")
    stop: IntArray = array("stop", dtype=int, doc="index of the receiver stop")
    distance_m: FloatArray = array("stop", unit="m", doc="TX to RX")
    los_dbm: FloatArray = array("stop", unit="dBm", doc="line of sight; NaN where blocked")
    single_bounce_dbm: FloatArray = array("stop", unit="dBm", doc="strongest single bounce; NaN for none")
    processed_snr_db: FloatArray = array("stop", unit="dB", doc="strongest path after processing, over kTBF")
    cross_db: FloatArray = array("stop", unit="dB", doc="LOS side lobe in one angle, below the LOS")
    off_cross_db: FloatArray = array("stop", unit="dB", doc="LOS side lobe in both angles, below the LOS")

    @property
    def weakest_dbm(self) -> float:
        """Power of the weakest path that is visible in a beam power map, at any stop."""
        noise_mw = dbm_to_mw(self.thermal_noise_dbm) + dbm_to_mw(self.converter_noise_dbm)
        return float(10 * np.log10(noise_mw)) + MAP_SNR_DB

    @property
    def dynamic_range_db(self) -> FloatArray:
        """Usable dynamic range (stop,) in dB from the line of sight to the weakest path; NaN where blocked."""
        return np.asarray(self.los_dbm - self.weakest_dbm)


def link_budget(
    truths: Iterable[Truth], link: Link, tx_pose: Pose, settings: LinkConfig, converter_share: float
) -> LinkBudget:
    """The budget of the given stops. The strongest path among them sets the full scale of the converters.

    `converter_share` is the part of the converter noise in one sample.
    """
    rows = [_stop_row(truth, link, tx_pose) for truth in truths]
    table = np.array(rows, float).reshape(-1, 7)
    strongest_dbm = np.max(table[:, 4], initial=-np.inf)
    processing_db = 10 * np.log10(link.prs_symbol.shape[1])
    thermal_dbm = float(10 * np.log10(link.noise_power_mw.max()))
    tx_dbi, rx_dbi = peak_gain_dbi(link.tx_codebook), peak_gain_dbi(link.rx_codebook)
    return LinkBudget(
        eirp_dbm=float(10 * np.log10(link.tx_power_mw)) + tx_dbi,
        tx_gain_dbi=tx_dbi,
        rx_gain_dbi=rx_dbi,
        thermal_noise_dbm=thermal_dbm,
        converter_noise_dbm=converter_noise_dbm(float(strongest_dbm), settings, converter_share),
        processing_gain_db=float(processing_db),
        stop=table[:, 0],
        distance_m=table[:, 1],
        los_dbm=table[:, 2],
        single_bounce_dbm=table[:, 3],
        processed_snr_db=table[:, 4] - thermal_dbm + processing_db,
        cross_db=table[:, 5],
        off_cross_db=table[:, 6],
    )


def converter_noise_dbm(strongest_dbm: float, settings: LinkConfig, converter_share: float = 1.0) -> float:
    """Converter noise per sample, at the fixed gain with the given back-off above `strongest_dbm`.

    A full-scale sine is 6.02 ENOB + 1.76 dB above the converter noise of the whole sampled band. The strongest
    signal is below this sine by the back-off, so that the peaks of an OFDM signal are not clipped.
    """
    ratio_db = DB_PER_BIT * settings.adc_effective_bits + FULL_SCALE_SINE_DB - settings.adc_back_off_db
    return float(strongest_dbm - ratio_db + 10 * np.log10(converter_share))


def converter_share(waveform: WaveformConfig, n_fft: int = 4096) -> float:
    """Part of the converter noise in a sample: the noise on occupied subcarriers, reduced by averaging."""
    return waveform.prs.n_subcarriers / waveform.comb / n_fft / measurements_per_sample(waveform)


def peak_gain_dbi(codebook: Codebook) -> float:
    """Highest gain of any beam in its pointing direction, including the element."""
    response = beam_response(codebook, codebook.azimuth_rad, codebook.elevation_rad)
    return float(20 * np.log10(np.abs(response).max()))


def side_lobe_db(codebook: Codebook, azimuth_rad: float, elevation_rad: float) -> float:
    """Strongest side lobe of a path over the beams, relative to its best beam; -inf for none.

    Among beams with the same azimuth the strongest counts. A side lobe is stronger than both neighbours in azimuth
    and is not the best beam. The first and last azimuth of the codebook are never side lobes.
    """
    amplitudes = np.abs(beam_response(codebook, azimuth_rad, elevation_rad))[:, 0]
    azimuth, place = np.unique(np.round(codebook.azimuth_rad, 6), return_inverse=True)
    amplitude = np.zeros(len(azimuth))
    np.maximum.at(amplitude, place, amplitudes)
    is_peak = (amplitude[1:-1] > amplitude[:-2]) & (amplitude[1:-1] > amplitude[2:])
    peaks = np.sort(amplitude[1:-1][is_peak & (amplitude[1:-1] < amplitude.max())])
    return float(20 * np.log10(peaks[-1] / amplitude.max())) if len(peaks) else -np.inf


def _stop_row(truth: Truth, link: Link, tx_pose: Pose) -> tuple[float, ...]:
    """Stop, distance, powers of LOS, single bounce and strongest path, LOS side lobes in one and both angles."""
    paths = truth.paths
    power_dbm = best_beam_power_dbm(paths, link, tx_pose, truth.rx_pose)
    distance_m = float(np.linalg.norm(truth.rx_pose.position_m - tx_pose.position_m))
    cross_db, off_cross_db = _los_side_lobes_db(paths, link, tx_pose, truth.rx_pose)
    los_dbm, bounce_dbm = (
        float(np.max(power_dbm[kind])) if kind.any() else np.nan for kind in (paths.is_los, paths.is_single_bounce)
    )
    strongest_dbm = float(np.max(power_dbm, initial=-np.inf))
    return truth.stop, distance_m, los_dbm, bounce_dbm, strongest_dbm, cross_db, off_cross_db


def _los_side_lobes_db(paths: Paths, link: Link, tx_pose: Pose, rx_pose: Pose) -> tuple[float, float]:
    if not paths.is_los.any():
        return np.nan, np.nan
    los = int(np.flatnonzero(paths.is_los)[0])
    departure = wrap_angle(paths.aod_azimuth_rad[los] - tx_pose.heading_rad)
    arrival = wrap_angle(paths.aoa_azimuth_rad[los] - rx_pose.heading_rad)
    tx_db = side_lobe_db(link.tx_codebook, departure, paths.aod_elevation_rad[los])
    rx_db = side_lobe_db(link.rx_codebook, arrival, paths.aoa_elevation_rad[los])
    return max(tx_db, rx_db), tx_db + rx_db
