"""Equation (1) with paths that change from symbol to symbol: gain, delay and directions at the time of each pair.

The paths of a beam pair are spread on the delay grid of `sim.signal.generation`, each with the amplitude and at
the delay of that time; one FFT over the grid gives the samples of all pairs. The response of a
beam follows the directions by interpolation between Chebyshev times.
"""

from collections.abc import Callable
from functools import lru_cache

import numpy as np
from numba import njit

from scenes.pose import SPEED_OF_LIGHT_M_S, Pose
from scenes.record import ComplexArray, FloatArray, IntArray
from sim.propagation.motion.tracks import SweepMotion, angle_at, carrier_phase, lengths_at
from sim.signal.arrays.codebook import Codebook, beam_response
from sim.signal.generation import KERNEL_WIDTH, OVERSAMPLING, bandwidth_hz, beam_channel, grid_waves, kernel_at

STRETCHES_AT_ONCE = 64
PAIRS_AT_ONCE = 8  # of beams, transformed while they are in the cache
KERNEL_PLACES = 1 << 12  # of the table of the kernel, per grid delay
EVEN = 1e-6  # relative difference of the steps of subcarriers that is rounding
LEAST_TIMES, MOST_TIMES = 4, 40  # Chebyshev times of a response
TIMES_PER_RAD = 1.5  # of phase over half of the aperture

Heading = Callable[[float], float]


def moving_channel(
    motion: SweepMotion,
    time_s: FloatArray,
    *,
    tx_codebook: Codebook,
    rx_codebook: Codebook,
    tx_heading_rad: Heading,
    rx_pose: Pose,
    frequency_offset_hz: FloatArray,
    clock_bias_s: float,
    later_s: float = 0.0,
) -> ComplexArray:
    """Channel (tx_beam, rx_beam, subcarrier) in complex64 of beam pairs at times (tx_beam, rx_beam) of a sweep.

    Every path counts at the times of its stretches, as it is `later_s` after them. `tx_heading_rad` gives the
    heading of the TX at a time. Paths that do not change at all are summed as in a frozen world.
    """
    shape = (*time_s.shape, len(frequency_offset_hz))
    still = motion.is_still() & (np.array([tx_heading_rad(t) for t in (time_s.min(), time_s.max())]).std() == 0)
    channel = None
    if still.any() or not len(motion):
        channel = beam_channel(
            motion.states.take("path", motion.middle[still]),
            tx_codebook=tx_codebook,
            rx_codebook=rx_codebook,
            tx_pose=Pose(np.zeros(3), tx_heading_rad(0.0)),
            rx_pose=rx_pose,
            frequency_offset_hz=frequency_offset_hz,
            clock_bias_s=clock_bias_s,
        )
    motion = motion.stretches(~still)
    if channel is not None and not len(motion):
        return channel
    times = time_s.ravel()
    centre_hz = (frequency_offset_hz.min() + frequency_offset_hz.max()) / 2
    spacing_s = 1 / (OVERSAMPLING * bandwidth_hz(frequency_offset_hz))
    grid = _DelayGrid(motion, clock_bias_s, spacing_s, len(times))
    for begin_s, end_s in np.unique(np.stack([motion.from_s, motion.to_s], axis=1), axis=0):
        pairs = np.flatnonzero((times >= begin_s) & (times < end_s))
        alike = np.flatnonzero((motion.from_s == begin_s) & (motion.to_s == end_s))
        for first in range(0, len(alike) if len(pairs) else 0, STRETCHES_AT_ONCE):
            part = motion.stretches(alike[first : first + STRETCHES_AT_ONCE])
            now_s = times[pairs] + later_s
            length_m, amplitude = lengths_at(part, now_s, tx_codebook.carrier_hz)
            delay_s = length_m / SPEED_OF_LIGHT_M_S + clock_bias_s
            amplitude = amplitude * carrier_phase(length_m, tx_codebook.carrier_hz)
            amplitude *= np.exp(-2j * np.pi * centre_hz * delay_s)
            sent, received = np.divmod(pairs, time_s.shape[1])
            amplitude *= _responses(tx_codebook, part, now_s, sent, "aod", tx_heading_rad)
            amplitude *= _responses(rx_codebook, part, now_s, received, "aoa", lambda _: rx_pose.heading_rad)
            grid.add(pairs, delay_s, amplitude.astype(np.complex64))
    moving = grid.samples(frequency_offset_hz - centre_hz).reshape(shape)
    return moving if channel is None else channel + moving


@lru_cache(maxsize=1)
def _kernel_table() -> FloatArray:
    """The kernel at places so close that it is straight to 1e-7 between them."""
    return np.asarray(kernel_at(np.arange((KERNEL_WIDTH // 2 + 2) * KERNEL_PLACES) / KERNEL_PLACES), np.float32)


class _DelayGrid:
    """Amplitudes (pair, delay) on a uniform grid of delays."""

    def __init__(self, motion: SweepMotion, bias_s: float, spacing_s: float, n_pairs: int) -> None:
        used = np.unique(np.concatenate([motion.first, motion.middle, motion.last]))
        delay_s = motion.states.delay_s[used] + bias_s
        self.spacing_s = spacing_s
        self.first_s = float(delay_s.min() - KERNEL_WIDTH * spacing_s)
        self.n_delays = int(np.ptp(delay_s) / spacing_s) + 2 * KERNEL_WIDTH + 1
        self.amplitude = np.zeros((n_pairs, self.n_delays), np.complex64)

    def samples(self, frequency_hz: FloatArray) -> ComplexArray:
        """Samples (pair, subcarrier) at frequencies about zero, by an FFT over the delays where these are even.

        The grid has `OVERSAMPLING` delays per sample of the band, so the FFT has as many times its subcarriers.
        """
        n = len(frequency_hz)
        steps = np.diff(frequency_hz)
        if (
            OVERSAMPLING * n % 1
            or self.n_delays > OVERSAMPLING * n
            or np.ptp(steps) > EVEN * np.abs(steps).min(initial=np.inf)
        ):
            return self.amplitude @ grid_waves(self.n_delays, self.first_s, self.spacing_s, frequency_hz)
        from scipy.fft import fft  # noqa: PLC0415  (slow to import)

        turn = -2 * np.pi * frequency_hz[0] * self.spacing_s * np.arange(self.n_delays)
        self.amplitude *= np.exp(1j * turn).astype(np.complex64)
        first = grid_waves(1, self.first_s, self.spacing_s, frequency_hz)
        made = np.empty((len(self.amplitude), n), np.complex64)
        for start in range(0, len(made), PAIRS_AT_ONCE):
            rows = slice(start, start + PAIRS_AT_ONCE)
            spectrum = fft(self.amplitude[rows], int(OVERSAMPLING * n), axis=1)
            np.multiply(spectrum[:, :n], first, out=made[rows])
        return made

    def add(self, pairs: IntArray, delay_s: FloatArray, amplitude: ComplexArray) -> None:
        """Spread paths with delays and amplitudes (pair, path)."""
        position = (delay_s - self.first_s) / self.spacing_s
        _spread(self.amplitude, pairs, position, amplitude, _kernel_table())


@njit(cache=True, error_model="numpy")
def _spread(grid, pairs, position, amplitude, kernel):  # type: ignore[no-untyped-def]
    """Add amplitudes (pair, path) at positions (pair, path) in grid delays to their neighbours in `grid`."""
    for row in range(len(pairs)):
        line = grid[pairs[row]]
        for path in range(position.shape[1]):
            low = int(np.floor(position[row, path])) - KERNEL_WIDTH // 2 + 1
            for column in range(low, low + KERNEL_WIDTH):
                place = abs(column - position[row, path]) * KERNEL_PLACES
                index = int(place)
                share = kernel[index] + np.float32(place - index) * (kernel[index + 1] - kernel[index])
                line[min(max(column, 0), len(line) - 1)] += amplitude[row, path] * share


def _responses(
    codebook: Codebook, motion: SweepMotion, time_s: FloatArray, beam: IntArray, end: str, heading_rad: Heading
) -> ComplexArray:
    """Responses (time, stretch) of beams (time,) at one end, "aod" or "aoa", of paths."""
    low_s, high_s = float(time_s.min()), float(time_s.max())
    turned = _directions(motion, np.linspace(low_s, high_s, 3), end, heading_rad)
    nodes, weight = _chebyshev(codebook, time_s, max(float(np.ptp(each, axis=0).max()) for each in turned))
    azimuth, elevation = _directions(motion, nodes, end, heading_rad)
    response = beam_response(codebook, azimuth.ravel(), elevation.ravel()).reshape(len(codebook), *azimuth.shape)
    total = np.zeros((len(time_s), len(motion)), complex)
    for node in range(len(nodes)):
        total += weight[:, node, None] * response[beam, node]
    return total


def _directions(
    motion: SweepMotion, time_s: FloatArray, end: str, heading_rad: Heading
) -> tuple[FloatArray, FloatArray]:
    """Azimuth and elevation (time, stretch) in the frame of the device."""
    heading = np.array([heading_rad(float(time)) for time in time_s])[:, None]
    return angle_at(motion, time_s, f"{end}_azimuth") - heading, angle_at(motion, time_s, f"{end}_elevation")


def _chebyshev(codebook: Codebook, time_s: FloatArray, turn_rad: float) -> tuple[FloatArray, FloatArray]:
    """Times (node,) and weights (time, node) of interpolation between them, for directions that turn so far."""
    low, high = float(time_s.min()), float(time_s.max())
    reach = np.linalg.norm(codebook.element_position_m, axis=1).max() * 2 * np.pi * codebook.carrier_hz
    n = LEAST_TIMES + int(TIMES_PER_RAD * reach / SPEED_OF_LIGHT_M_S * turn_rad)
    if high == low:
        return np.array([low]), np.ones((len(time_s), 1))
    n = min(n, MOST_TIMES)
    k = np.arange(n)
    nodes = (low + high) / 2 + (high - low) / 2 * np.cos((2 * k + 1) * np.pi / (2 * n))
    sign = (-1.0) ** k * np.sin((2 * k + 1) * np.pi / (2 * n))
    gap = time_s[:, None] - nodes
    exact = gap == 0
    ratio = sign / np.where(exact, 1.0, gap)
    weight = ratio / ratio.sum(axis=1, keepdims=True)
    return nodes, np.where(exact.any(axis=1, keepdims=True), exact.astype(float), weight)
