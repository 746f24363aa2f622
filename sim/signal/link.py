"""A link: the waveform, the beams and the power, which are the same at all stops of a campaign."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from scenes.arguments import need
from scenes.pose import SPEED_OF_LIGHT_M_S, Pose
from scenes.record import ComplexArray, FloatArray, IntArray, Record, array
from sim.config import ArrayConfig, SimulationConfig, WaveformConfig
from sim.propagation.paths import Paths
from sim.signal.arrays.array import upa_positions_m, upa_taper
from sim.signal.arrays.beams import (
    PanelBeams,
    beams_from_weights,
    campus_azimuths,
    dft_beams,
    direction_grid,
    hierarchical_beams,
    shaped_beams,
    sine_spaced_azimuths,
    steered_beams,
)
from sim.signal.arrays.codebook import Codebook, beam_response, codebook_on_panels
from sim.signal.arrays.weights_file import read_weights
from sim.signal.demand import ask_beam_memory
from sim.signal.power import dbm_to_mw, noise_power_mw
from sim.signal.waveform.occasions import measurements_per_sample, sweep_occasions
from sim.signal.waveform.prs import (
    SUBCARRIERS_PER_RB,
    prs_comb_pass,
    prs_subcarriers,
    prs_symbols,
    subcarrier_frequency_hz,
)


@dataclass(frozen=True)
class Link(Record):
    """Waveform, beams and power of a campaign, the same at all stops."""

    tx_codebook: Codebook
    rx_codebook: Codebook
    prs_symbol: ComplexArray = array("tx_beam", "subcarrier", dtype="complex64", doc="transmitted, |x| = 1")
    frequency_offset_hz: FloatArray = array("subcarrier", unit="Hz", doc="subcarrier offset from the carrier")
    carrier_hz: float = array(unit="Hz", doc="carrier frequency")
    tx_power_mw: float = array(unit="mW", doc="power into the TX array")
    noise_power_mw: FloatArray = array("rx_beam", unit="mW", doc="noise power per sample")


def make_link(config: SimulationConfig) -> Link:
    """Waveform, codebooks and link budget of a campaign.

    TX beam m sends PRS sequence `sequence_id` + m in slot m (modulo the frame), or in the slot of the schedule. A
    beam pair takes one symbol of the resource, or combines all symbols. Combined samples cover every subcarrier of
    the band. Every symbol has the whole transmit power on its own comb, so the noise per sample is that of one
    symbol, divided by L_PRS / K_comb if subcarriers are measured more than once, and divided by the number of
    repetitions.

    Raises `ValueError` if the beams do not fit into the schedule, or a weights file does not fit the array.
    """
    need("config", config, SimulationConfig)
    ask_beam_memory(config)
    carrier_hz = config.waveform.carrier_ghz * 1e9
    prs = config.waveform.prs
    tx_codebook = make_codebook(config.tx_array, carrier_hz)
    rx_codebook = make_codebook(config.rx_array, carrier_hz)
    occasions = sweep_occasions(config.waveform, len(tx_codebook), len(rx_codebook))
    bandwidth_hz = prs.n_subcarriers // prs.comb * prs.subcarrier_spacing_hz
    noise_mw = noise_power_mw(bandwidth_hz, config.link.noise_figure_db) / measurements_per_sample(config.waveform)
    if config.waveform.combine_symbols:
        subcarrier = prs.rb_offset * SUBCARRIERS_PER_RB + np.arange(prs.n_subcarriers)
    else:
        subcarrier = prs_subcarriers(prs)
    return Link(
        tx_codebook=tx_codebook,
        rx_codebook=rx_codebook,
        prs_symbol=pilots(config.waveform, occasions.slot[0]),
        frequency_offset_hz=subcarrier_frequency_hz(prs, subcarrier),
        carrier_hz=carrier_hz,
        tx_power_mw=dbm_to_mw(config.link.tx_power_dbm),
        noise_power_mw=np.full(len(rx_codebook), noise_mw),
    )


def pilots(waveform: WaveformConfig, slot: IntArray) -> ComplexArray:
    """PRS symbols (tx_beam, subcarrier) of TX beams that are sent in slots (tx_beam,) of the frame."""
    of_slot = prs_comb_pass if waveform.combine_symbols else prs_symbols
    first = waveform.sequence_id
    return np.stack([of_slot(waveform.prs, (first + beam) % 4096, int(at)) for beam, at in enumerate(slot)])


def make_codebook(config: ArrayConfig, carrier_hz: float) -> Codebook:
    """The beams of a device with the given array settings.

    Raises `ValueError` if a weights file does not fit the array, `OSError` if it cannot be read.
    """
    position_m = upa_positions_m(config.rows, config.columns, carrier_hz)
    beams = panel_beams(config, position_m, carrier_hz)
    if config.taper != "uniform" or config.phase_bits is not None:
        taper = upa_taper(config.rows, config.columns, config.taper, config.taper_side_lobe_db)
        beams = shaped_beams(beams, taper, config.phase_bits)
    return codebook_on_panels(
        beams,
        position_m,
        carrier_hz,
        panel_azimuth_rad=np.deg2rad(config.panel_azimuth_deg).tolist(),
        panel_tilt_rad=np.deg2rad(config.panel_tilt_deg).tolist(),
        element_pattern=config.element_pattern,
        polarisation_slant_rad=np.deg2rad(config.polarisation_slant_deg),
    )


def panel_beams(config: ArrayConfig, position_m: FloatArray, carrier_hz: float) -> PanelBeams:
    """The beams of one panel before any taper and phase quantisation."""
    sector_rad = np.deg2rad(config.sector_deg)
    if config.codebook == "dft":
        return dft_beams(position_m, carrier_hz, config.rows, config.columns)
    if config.codebook == "hierarchical":
        return hierarchical_beams(position_m, carrier_hz, config.columns, config.hierarchy_levels, sector_rad)
    if config.weights_file is not None:
        weights = read_weights(config.weights_file)
        try:
            return beams_from_weights(position_m, carrier_hz, weights, config.element_pattern)
        except ValueError as error:
            raise ValueError(f"weights_file = {config.weights_file}: {error}") from error
    if config.codebook == "campus_63":
        azimuth = campus_azimuths(sector_rad)
    else:
        azimuth = sine_spaced_azimuths(config.beams_per_panel, sector_rad)
    elevation_rad = np.deg2rad(config.beam_elevation_deg).tolist()
    return steered_beams(position_m, carrier_hz, *direction_grid(azimuth, elevation_rad))


def best_beam_power_dbm(paths: Paths, link: Link, tx_pose: Pose, rx_pose: Pose) -> FloatArray:
    """Received power (path,) in dBm of every path in its best beam pair."""
    tx = beam_response(link.tx_codebook, paths.aod_azimuth_rad - tx_pose.heading_rad, paths.aod_elevation_rad)
    rx = beam_response(link.rx_codebook, paths.aoa_azimuth_rad - rx_pose.heading_rad, paths.aoa_elevation_rad)
    beam_gain = (np.abs(tx).max(axis=0) * np.abs(rx).max(axis=0)) ** 2
    return np.asarray(10 * np.log10(link.tx_power_mw * paths.power * beam_gain))


def line_of_sight_at_1m_dbm(config: SimulationConfig) -> float:
    """Received power in dBm over 1 m of free space between the peaks of the strongest TX and RX beam."""
    need("config", config, SimulationConfig)
    ask_beam_memory(config)
    carrier_hz = config.waveform.carrier_ghz * 1e9
    peaks = [
        (_known_peak if device.weights_file is None else _peak_response)(device.model_dump_json(), carrier_hz)
        for device in (config.tx_array, config.rx_array)
    ]
    free_space = SPEED_OF_LIGHT_M_S / carrier_hz / (4 * np.pi)
    return float(config.link.tx_power_dbm + 20 * np.log10(peaks[0] * peaks[1] * free_space))


def _peak_response(device: str, carrier_hz: float) -> float:
    """Largest response of the beams of an array, given as JSON."""
    book = make_codebook(ArrayConfig.model_validate_json(device), carrier_hz)
    return float(np.abs(beam_response(book, book.azimuth_rad, book.elevation_rad)).max())


_known_peak = lru_cache(maxsize=64)(_peak_response)  # sweeps have few arrays in thousands of cases
