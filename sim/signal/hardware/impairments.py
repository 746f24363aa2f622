"""Hardware impairments: array errors, oscillators, clocks and the front end of the receiver.

Pure functions on arrays. `sim.signal.hardware.apply_impairments` applies them where they arise and gives each one
its own random generator. Angles are in radians. A positive phase multiplies by exp(+j phase).
"""

from dataclasses import replace

import numpy as np

from scenes.pose import SPEED_OF_LIGHT_M_S, Pose
from scenes.record import ComplexArray, FloatArray, IntArray
from sim.signal.arrays.codebook import Codebook


def with_element_errors(
    codebook: Codebook, gain_std_db: float, phase_std_rad: float, rng: np.random.Generator
) -> Codebook:
    """The codebook of an array whose elements have Gaussian gain (dB) and phase errors."""
    n_elements = codebook.size("element")
    gain_db, phase_rad = rng.standard_normal((2, n_elements)) * [[gain_std_db], [phase_std_rad]]
    return replace(codebook, weights=codebook.weights * 10 ** (gain_db / 20) * np.exp(1j * phase_rad))


def coupling_matrix(position_m: FloatArray, carrier_hz: float, coupling_db: float) -> ComplexArray:
    """Coupling (element, element): 1 on the diagonal, c (lambda / 2 d) exp(-j k (d - lambda / 2)) elsewhere.

    `coupling_db` is |c|, between elements half a wavelength apart; Balanis, Antenna Theory, section 8.7.
    """
    distance_m = np.linalg.norm(position_m[:, None] - position_m, axis=2)
    half_m = SPEED_OF_LIGHT_M_S / carrier_hz / 2
    np.fill_diagonal(distance_m, 1.0)
    coupling = 10 ** (coupling_db / 20) * half_m / distance_m * np.exp(-1j * np.pi * (distance_m / half_m - 1))
    np.fill_diagonal(coupling, 1.0)
    return np.asarray(coupling)


def with_mutual_coupling(codebook: Codebook, coupling_db: float) -> Codebook:
    """The codebook of an array with mutual coupling: w -> C w, with C symmetric."""
    matrix = coupling_matrix(codebook.element_position_m, codebook.carrier_hz, coupling_db)
    return replace(codebook, weights=codebook.weights @ matrix)


def with_beam_phases(codebook: Codebook, std_rad: float, rng: np.random.Generator) -> Codebook:
    """The codebook with a random Gaussian phase for every beam."""
    phase_rad = std_rad * rng.standard_normal(len(codebook))
    return replace(codebook, weights=codebook.weights * np.exp(1j * phase_rad)[:, None])


def apply_clock_drift(
    samples: ComplexArray, time_s: FloatArray, drift_ppm: float, frequency_hz: FloatArray
) -> None:
    """Apply the growing delay of a fast clock to samples (tx_beam, rx_beam, subcarrier), in place."""
    delay_s = drift_ppm * 1e-6 * time_s
    for beam, delays in enumerate(delay_s):
        samples[beam] *= np.exp(-2j * np.pi * delays[:, None] * frequency_hz).astype(np.complex64)


def random_walk_phase_rad(time_s: FloatArray, step_rad: float, rng: np.random.Generator) -> FloatArray:
    """Phase of an oscillator at times of any shape: a random walk with one Gaussian step per time."""
    walk = np.empty(time_s.size)
    walk[np.argsort(time_s, axis=None, kind="stable")] = np.cumsum(rng.standard_normal(time_s.size))
    return np.asarray(step_rad * walk.reshape(time_s.shape))


def wiener_phase_rad(
    n_symbols: int, n_fft: int, linewidth_hz: float, sample_rate_hz: float, rng: np.random.Generator
) -> FloatArray:
    """Phase (symbol, sample) of a free-running oscillator relative to the start of each symbol.

    Steps of variance 2 pi linewidth / sample rate; Demir, Mehrotra and Roychowdhury (2000).
    """
    steps = rng.standard_normal((n_symbols, n_fft), np.float32)
    return np.asarray(np.sqrt(2 * np.pi * linewidth_hz / sample_rate_hz) * np.cumsum(steps, axis=1))


def with_iq_imbalance(samples: ComplexArray, gain_db: float, phase_rad: float) -> ComplexArray:
    """Time samples after a receiver mixer with gain g of Q over I and quadrature error phi.

    I does not change and Q becomes g (Q cos phi - I sin phi); Schenk, RF Imperfections (2008), section 5.
    """
    gain = 10 ** (gain_db / 20)
    q = gain * (samples.imag * np.cos(phase_rad) - samples.real * np.sin(phase_rad))
    return np.asarray((samples.real + 1j * q).astype(np.complex64))


def clipped_iq(samples: ComplexArray, level: float) -> ComplexArray:
    """Samples with I and Q limited to +-level."""
    parts = np.clip(np.ascontiguousarray(samples).view(np.float32), np.float32(-level), np.float32(level))
    return np.asarray(parts.view(np.complex64))


def quantised_iq(samples: ComplexArray, bits: int, full_scale: float) -> ComplexArray:
    """Samples after mid-rise quantisation of I and Q with `bits` bits each over +-full_scale."""
    step = full_scale / 2 ** (bits - 1)
    parts = np.floor(np.ascontiguousarray(samples).view(np.float32) / step)
    parts = (np.clip(parts, -(2 ** (bits - 1)), 2 ** (bits - 1) - 1) + 0.5) * step
    return np.asarray(parts.astype(np.float32).view(np.complex64))


def quantiser_gain(std_over_step: FloatArray, bits: int) -> FloatArray:
    """Mean slope of a mid-rise quantiser for Gaussian input of this standard deviation over its step.

    It is the gain of a weak signal among others (Bussgang, 1952): 1 for input of several steps, large where the
    input is well below one, since the output is never less than half a step.
    """
    threshold = np.arange(1 - 2 ** (bits - 1), 2 ** (bits - 1))
    ratio = np.asarray(std_over_step, float)[..., None]
    return np.asarray(
        np.exp(-0.5 * np.square(threshold / ratio)).sum(axis=-1) / (np.sqrt(2 * np.pi) * ratio[..., 0])
    )


def fft_bins(frequency_hz: FloatArray, subcarrier_spacing_hz: float) -> tuple[IntArray, int]:
    """FFT bin of every occupied subcarrier, and an FFT size (a power of 2) that includes all of them."""
    bins = np.rint(frequency_hz / subcarrier_spacing_hz).astype(int)
    n_fft = 1 << int(2 * np.abs(bins).max() + 1).bit_length()
    return bins % n_fft, n_fft


def to_time_samples(samples: ComplexArray, bins: IntArray, n_fft: int) -> ComplexArray:
    """Useful part (..., sample) of OFDM symbols, of the power of their subcarriers (unitary transform)."""
    from scipy.fft import ifft  # noqa: PLC0415  (slow to import)

    grid = np.zeros((*samples.shape[:-1], n_fft), np.complex64)
    grid[..., bins] = samples
    return np.asarray(ifft(grid, axis=-1, norm="ortho", overwrite_x=True))


def to_subcarriers(time_samples: ComplexArray, bins: IntArray) -> ComplexArray:
    """Occupied subcarriers (..., subcarrier) of OFDM symbols."""
    from scipy.fft import fft  # noqa: PLC0415  (slow to import)

    return np.asarray(fft(time_samples, axis=-1, norm="ortho")[..., bins])


def surveyed_pose(pose: Pose, placement_std_m: float, heading_std_rad: float, rng: np.random.Generator) -> Pose:
    """The surveyed pose of a device, with Gaussian errors of the horizontal position and the heading."""
    error = rng.standard_normal(3)
    moved_m = np.array([placement_std_m * error[0], placement_std_m * error[1], 0.0])
    return Pose(pose.position_m + moved_m, float(pose.heading_rad + heading_std_rad * error[2]))
