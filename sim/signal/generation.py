"""Equation (1): beam-swept OFDM samples of a set of paths, without noise.

The sum over paths is a matrix product of beam responses and waves exp(-j 2 pi f tau). Many paths are first spread
on a uniform delay grid with a Kaiser-Bessel kernel, the spreading step of a non-uniform Fourier transform (Fessler
and Sutton 2003; Barnett, Magland and af Klinteberg 2019). The grid delays then replace the paths in the product.
The beams of one array are rarely linearly independent (32 horizontal beams of 16 columns span 16 dimensions). So
the product is computed for a basis of the beams, and the last step combines the basis into beams.
"""

from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise

import numpy as np

from scenes.pose import Pose
from scenes.record import ComplexArray, FloatArray, concatenate
from sim.propagation.paths import Paths
from sim.signal.arrays.array import phasors
from sim.signal.arrays.codebook import Codebook, beam_response

OVERSAMPLING = 2.5  # grid delays per 1 / bandwidth
KERNEL_WIDTH = 8  # grid delays; with an oversampling of 2.5, aliases at the band edges are below 1.4e-7
KERNEL_BETA = np.pi * KERNEL_WIDTH * (1 - 1 / (2 * OVERSAMPLING))
CELLS_PER_GROUP = 8  # grid intervals whose paths are spread in one product
GROUP_ENTRIES = 1 << 18  # largest product of paths and beam pairs held at once
PATHS_AT_ONCE = 1024  # paths whose responses are computed together
MANY_SUBCARRIERS = 64  # from here on products of waves are faster than their sines
EQUAL_STEPS = 1e-9  # relative difference of equal steps of frequency
RANK_TOLERANCE = 1e-12  # relative to the largest singular value; smaller values are rounding errors


def beam_channel(
    paths: Paths,
    *,
    tx_codebook: Codebook,
    rx_codebook: Codebook,
    tx_pose: Pose,
    rx_pose: Pose,
    frequency_offset_hz: FloatArray,
    clock_bias_s: float,
) -> ComplexArray:
    """Channel (tx_beam, rx_beam, subcarrier) in complex64: sum_i xi_i G_TX G_RX exp(-j 2 pi f (tau_i + bias)).

    The path gain includes the carrier phase, so the delay phase here uses only the offset from the carrier. No
    array has the size paths x samples. The error is below 1e-6 of the largest sample.
    """
    blocks = beam_channel_blocks(
        paths,
        tx_codebook=tx_codebook,
        rx_codebook=rx_codebook,
        tx_pose=tx_pose,
        rx_pose=rx_pose,
        frequency_offset_hz=frequency_offset_hz,
        clock_bias_s=clock_bias_s,
        tx_beams_per_block=len(tx_codebook),
    )
    return next(blocks)


def beam_channel_blocks(
    paths: Paths,
    *,
    tx_codebook: Codebook,
    rx_codebook: Codebook,
    tx_pose: Pose,
    rx_pose: Pose,
    frequency_offset_hz: FloatArray,
    clock_bias_s: float,
    tx_beams_per_block: int,
) -> Iterator[ComplexArray]:
    """`beam_channel` as consecutive blocks of TX beams, for sweeps that do not fit in memory.

    Raises `ValueError` for a block of no beams.
    """
    if tx_beams_per_block < 1:
        raise ValueError(f"tx_beams_per_block = {tx_beams_per_block}: must be at least 1")
    tx_basis, tx = _responses(tx_codebook, paths.aod_azimuth_rad - tx_pose.heading_rad, paths.aod_elevation_rad)
    rx_basis, rx = _responses(rx_codebook, paths.aoa_azimuth_rad - rx_pose.heading_rad, paths.aoa_elevation_rad)
    sums = sum_over_paths(tx * paths.gain[:, None], rx, paths.delay_s + clock_bias_s, frequency_offset_hz)
    for start in range(0, len(tx_basis), tx_beams_per_block):
        weights = tx_basis[start : start + tx_beams_per_block]
        block = np.empty((len(weights), len(rx_basis), len(frequency_offset_hz)), np.complex64)
        for beam, row in enumerate(weights):  # one by one: the same bits in blocks of any size
            np.matmul(rx_basis, np.tensordot(row, sums, 1), out=block[beam])
        yield block


def sum_over_paths(
    tx_amplitude: ComplexArray, rx_amplitude: ComplexArray, delay_s: FloatArray, frequency_hz: FloatArray
) -> ComplexArray:
    """Sums over paths a_m b_n exp(-j 2 pi f_k tau), (tx_beam, rx_beam, subcarrier) in complex64.

    Amplitudes are (path, tx_beam) and (path, rx_beam). The function uses the delay grid if it has fewer delays
    than there are paths.
    """
    centre_hz = (frequency_hz.min() + frequency_hz.max()) / 2
    turn = np.exp(-2j * np.pi * centre_hz * delay_s)
    order = np.argsort(delay_s, kind="stable")
    tx = (tx_amplitude * turn[:, None])[order].astype(np.complex64)
    rx = rx_amplitude[order].astype(np.complex64)
    pairs, waves = _terms(tx, rx, delay_s[order], frequency_hz - centre_hz)
    return np.asarray((pairs.T @ waves).reshape(tx.shape[1], rx.shape[1], len(frequency_hz)))


def _responses(
    codebook: Codebook, azimuth_rad: FloatArray, elevation_rad: FloatArray
) -> tuple[ComplexArray, ComplexArray]:
    """Basis (beam, rank), in complex64, and responses (path, rank); their product is the response of every beam.

    The element responses are computed for a few paths at a time to limit the memory.
    """
    basis, spanning = _spanning(codebook)
    response = np.empty((len(azimuth_rad), len(spanning)), complex)
    for first in range(0, len(azimuth_rad), PATHS_AT_ONCE):
        part = slice(first, first + PATHS_AT_ONCE)
        response[part] = beam_response(spanning, azimuth_rad[part], elevation_rad[part]).T
    if len(response) < len(spanning):
        directions, amplitude = np.linalg.qr(response.T)
        basis, response = basis @ directions, amplitude.T
    return basis.astype(np.complex64), response


def _spanning(codebook: Codebook) -> tuple[ComplexArray, Codebook]:
    """Basis (beam, rank) and the smallest set of beams that spans those of a codebook, for each panel."""
    panels = np.stack([codebook.panel_azimuth_rad, codebook.panel_tilt_rad], axis=1)
    columns, spanning = [], []
    for panel in np.unique(panels, axis=0):
        beams = np.flatnonzero((panels == panel).all(axis=1))
        left, size, right = np.linalg.svd(codebook.weights[beams], full_matrices=False)
        kept = size > RANK_TOLERANCE * size[0]
        column = np.zeros((len(codebook), int(kept.sum())), complex)
        column[beams] = left[:, kept] * size[kept]
        columns.append(column)
        spanning.append(replace(codebook.take("beam", beams[: column.shape[1]]), weights=right[kept]))
    return np.concatenate(columns, axis=1), concatenate(spanning, "beam")


def _terms(
    tx: ComplexArray, rx: ComplexArray, delay_s: FloatArray, frequency_hz: FloatArray
) -> tuple[ComplexArray, ComplexArray]:
    """Amplitudes (term, beam pair) and waves (term, subcarrier): a term is a path or a grid delay."""
    spacing_s = 1 / (OVERSAMPLING * bandwidth_hz(frequency_hz))
    n_grid = int(np.ptp(delay_s) / spacing_s) + KERNEL_WIDTH + 1 if len(delay_s) else 0
    if n_grid >= len(delay_s):
        return _pairs(tx, rx), path_waves(delay_s, frequency_hz).astype(np.complex64)
    position = (delay_s - delay_s[0]) / spacing_s + KERNEL_WIDTH / 2
    first_s = delay_s[0] - KERNEL_WIDTH / 2 * spacing_s
    return _spread(tx, rx, position, n_grid), grid_waves(n_grid, first_s, spacing_s, frequency_hz)


def path_waves(delay_s: FloatArray, frequency_hz: FloatArray) -> ComplexArray:
    """exp(-j 2 pi f tau) (delay, subcarrier) in double precision.

    Where the subcarriers have equal steps, products of coarse and fine steps: sines take most of the time.
    """
    n = len(frequency_hz)
    step_hz = np.ptp(frequency_hz) / max(n - 1, 1)
    if n < MANY_SUBCARRIERS or np.abs(np.diff(frequency_hz) - step_hz).max() > EQUAL_STEPS * step_hz:
        return _turns(delay_s, frequency_hz)
    fine = int(np.ceil(np.sqrt(n)))
    coarse = _turns(delay_s, frequency_hz[::fine])[:, :, None]
    waves = coarse * _turns(delay_s, step_hz * np.arange(fine))[:, None]
    return np.asarray(waves.reshape(len(delay_s), coarse.shape[1] * fine)[:, :n])


def _turns(delay_s: FloatArray, frequency_hz: FloatArray) -> ComplexArray:
    return phasors(-2 * np.pi * delay_s[:, None] * frequency_hz)


def grid_waves(n_grid: int, first_s: float, spacing_s: float, frequency_hz: FloatArray) -> ComplexArray:
    """Waves of the grid delays, divided by the spectrum of the kernel to correct for the spreading."""
    from scipy.special import i0  # noqa: PLC0415  (slow to import)

    fine = int(np.ceil(np.sqrt(n_grid)))
    root = np.sqrt(KERNEL_BETA**2 - (np.pi * KERNEL_WIDTH * frequency_hz * spacing_s) ** 2)
    spectrum = KERNEL_WIDTH * np.sinh(root) / (root * i0(KERNEL_BETA))
    steps = path_waves(spacing_s * np.arange(fine, dtype=float), frequency_hz)
    waves = np.empty((n_grid, len(frequency_hz)), np.complex64)
    for first in range(0, n_grid, fine):
        rows = waves[first : first + fine]
        start = path_waves(np.array([first_s + first * spacing_s]), frequency_hz) / spectrum
        np.multiply(steps[: len(rows)], start, out=rows, casting="same_kind")
    return waves


def _pairs(tx: ComplexArray, rx: ComplexArray) -> ComplexArray:
    """Amplitude (path, beam pair) of every path in every beam pair."""
    return np.asarray((tx[:, :, None] * rx[:, None, :]).reshape(len(tx), tx.shape[1] * rx.shape[1]))


def _spread(tx: ComplexArray, rx: ComplexArray, position: FloatArray, n_grid: int) -> ComplexArray:
    """Amplitude (grid delay, beam pair) of paths sorted by `position`, in units of the grid."""
    n_pairs = tx.shape[1] * rx.shape[1]
    grid = np.zeros((n_grid, n_pairs), np.complex64)
    group = np.floor(position).astype(int) // CELLS_PER_GROUP
    bounds = np.flatnonzero(np.diff(group, prepend=-1, append=-1))
    longest = max(1, GROUP_ENTRIES // n_pairs)
    for begin, end in pairwise(bounds):
        low = group[begin] * CELLS_PER_GROUP - KERNEL_WIDTH // 2 + 1
        bins = np.arange(max(0, low), min(n_grid, low + CELLS_PER_GROUP + KERNEL_WIDTH - 1))
        for first in range(begin, end, longest):
            part = slice(first, min(end, first + longest))
            kernel = kernel_at(bins[:, None] - position[part]).astype(np.float32)
            pairs = _pairs(tx[part], rx[part]).view(np.float32)
            grid[bins[0] : bins[-1] + 1] += (kernel @ pairs).view(np.complex64)
    return grid


def kernel_at(distance: FloatArray) -> FloatArray:
    """Kaiser-Bessel kernel at a distance in grid delays, largest 1, zero outside its width."""
    from scipy.special import i0  # noqa: PLC0415  (slow to import)

    inside = np.maximum(1 - (2 * distance / KERNEL_WIDTH) ** 2, 0)
    value = i0(KERNEL_BETA * np.sqrt(inside)) / i0(KERNEL_BETA)
    return np.where(inside > 0, value, 0.0)


def bandwidth_hz(frequency_hz: FloatArray) -> float:
    """Span of the subcarriers, with half a step at each end."""
    steps = max(1, len(frequency_hz) - 1)
    span_hz = float(np.ptp(frequency_hz))
    return span_hz * (steps + 1) / steps if span_hz else 1.0
