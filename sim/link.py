"""A link: what stays the same over a campaign, the waveform, the beams and the power budget."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from scenes.pose import Pose
from scenes.record import ComplexArray, FloatArray, Record, array
from sim.array import upa_positions_m
from sim.codebook import Codebook, beam_response, steered_codebook
from sim.config import ArrayConfig, SimulationConfig
from sim.paths import Paths
from sim.prs import PrsConfig, prs_subcarriers, prs_symbols, subcarrier_frequency_hz
from sim.receiver import dbm_to_mw, noise_power_mw


@dataclass(frozen=True)
class Link(Record):
    """What stays the same over a campaign: the waveform, the beams and the power."""

    tx_codebook: Codebook
    rx_codebook: Codebook
    prs_symbol: ComplexArray = array("tx_beam", "subcarrier", dtype="complex64", doc="transmitted, |x| = 1")
    frequency_offset_hz: FloatArray = array("subcarrier", unit="Hz", doc="subcarrier offset from the carrier")
    carrier_hz: float = array(unit="Hz", doc="carrier frequency")
    tx_power_mw: float = array(unit="mW", doc="power into the TX array")
    noise_power_mw: FloatArray = array("rx_beam", unit="mW", doc="noise power per sample")


def make_link(config: SimulationConfig) -> Link:
    """Waveform, codebooks and link budget of a campaign.

    TX beam m sends PRS sequence m in slot m (modulo the frame); a beam pair takes one OFDM symbol.
    """
    carrier_hz = config.waveform.carrier_ghz * 1e9
    prs = PrsConfig(config.waveform.n_rb, config.waveform.comb, config.waveform.numerology)
    tx_codebook = make_codebook(config.tx_array, carrier_hz)
    rx_codebook = make_codebook(config.rx_array, carrier_hz)
    frequency_hz = subcarrier_frequency_hz(prs, prs_subcarriers(prs))
    slots_per_frame = 10 * 2**prs.numerology
    symbols = [prs_symbols(prs, beam % 4096, beam % slots_per_frame) for beam in range(len(tx_codebook))]
    bandwidth_hz = len(frequency_hz) * prs.subcarrier_spacing_hz
    noise_mw = noise_power_mw(bandwidth_hz, config.link.noise_figure_db)
    return Link(
        tx_codebook=tx_codebook,
        rx_codebook=rx_codebook,
        prs_symbol=np.stack(symbols),
        frequency_offset_hz=frequency_hz,
        carrier_hz=carrier_hz,
        tx_power_mw=dbm_to_mw(config.link.tx_power_dbm),
        noise_power_mw=np.full(len(rx_codebook), noise_mw),
    )


def make_codebook(config: ArrayConfig, carrier_hz: float) -> Codebook:
    """The beams of a device with the given array settings."""
    return steered_codebook(
        upa_positions_m(config.rows, config.columns, carrier_hz),
        carrier_hz,
        panel_azimuth_rad=np.deg2rad(config.panel_azimuth_deg).tolist(),
        beams_per_panel=config.beams_per_panel,
        sector_rad=np.deg2rad(config.sector_deg),
        element_pattern=config.element_pattern,
    )


def best_beam_power_dbm(paths: Paths, link: Link, tx_pose: Pose, rx_pose: Pose) -> FloatArray:
    """Received power (path,) in dBm of every path in its best beam pair."""
    tx = beam_response(link.tx_codebook, paths.aod_azimuth_rad - tx_pose.heading_rad, paths.aod_elevation_rad)
    rx = beam_response(link.rx_codebook, paths.aoa_azimuth_rad - rx_pose.heading_rad, paths.aoa_elevation_rad)
    beam_gain = (np.abs(tx).max(axis=0) * np.abs(rx).max(axis=0)) ** 2
    return np.asarray(10 * np.log10(link.tx_power_mw * paths.power * beam_gain))
