"""What a campaign will hold in memory: beam weights, and the samples of a stop; asked for before it is made."""

import math

from scenes.memory import ask_memory
from sim.config import ArrayConfig, SimulationConfig

WEIGHT_BYTES = 16 * 3  # complex128: of a panel, of all panels, and shaped
PATTERN_BYTES = 16 * 3
SAMPLE_BYTES = 8 * 4  # complex64: made, received, and twice in an estimator
CAMPUS_AZIMUTHS = 63


def ask_beam_memory(config: SimulationConfig) -> None:
    """Raise `MemoryLimitError`, with the fields to change, where the beams do not fit into the memory."""
    for name in ("tx_array", "rx_array"):
        array = getattr(config, name)
        n_beams, n_elements = len(array.panel_azimuth_deg) * beams_of_panel(array), array.rows * array.columns
        field = "beams_per_panel" if array.codebook == "steered" else "codebook"
        ask_memory(
            WEIGHT_BYTES * n_beams * n_elements,
            f"the weights of {n_beams} beams over {n_elements} elements",
            f"{name}.rows, columns, {field} and panel_azimuth_deg",
        )
        ask_memory(
            PATTERN_BYTES * n_beams**2,
            f"the patterns of {n_beams} beams at their own directions",
            f"{name}.{field}, panel_azimuth_deg and beam_elevation_deg",
        )


def ask_sample_memory(config: SimulationConfig) -> None:
    """Raise `MemoryLimitError`, with the fields to change, where the samples of a stop do not fit."""
    n_tx, n_rx, n_subcarriers = _sample_shape(config)
    ask_memory(
        sample_bytes(config),
        f"the samples of {n_tx} x {n_rx} beam pairs over {n_subcarriers} subcarriers",
        "tx_array and rx_array.beams_per_panel and panel_azimuth_deg, or waveform.n_rb",
    )


def sample_bytes(config: SimulationConfig) -> float:
    """Bytes that the samples of a stop take, with their copies."""
    return SAMPLE_BYTES * math.prod(_sample_shape(config))


def _sample_shape(config: SimulationConfig) -> tuple[int, int, int]:
    """Number of beams of TX and RX, and of subcarriers."""
    n_tx, n_rx = (len(a.panel_azimuth_deg) * beams_of_panel(a) for a in (config.tx_array, config.rx_array))
    waveform = config.waveform
    return n_tx, n_rx, 12 * waveform.n_rb // (1 if waveform.combine_symbols else waveform.comb)


def beams_of_panel(array: ArrayConfig) -> int:
    """Beams of one panel; a file of weights has at least one."""
    n_elevations = len(array.beam_elevation_deg)
    match array.codebook:
        case "dft":
            return array.rows * array.columns
        case "hierarchical":
            return int(2**array.hierarchy_levels) - 1
        case "campus_63":
            return CAMPUS_AZIMUTHS * n_elevations
        case "file":
            return 1
        case _:
            return array.beams_per_panel * n_elevations
