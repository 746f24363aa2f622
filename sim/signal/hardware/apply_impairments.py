"""Application of the hardware impairments of a campaign, each one with its own random generator."""

from collections.abc import Callable
from dataclasses import replace
from enum import IntEnum

import numpy as np

from scenes.pose import Pose
from scenes.record import ComplexArray, FloatArray
from scenes.scene import Scene
from sim.config import LinkKind, SimulationConfig
from sim.signal.arrays.codebook import Codebook
from sim.signal.hardware.impairments import (
    apply_clock_drift,
    clipped_iq,
    fft_bins,
    quantised_iq,
    random_walk_phase_rad,
    surveyed_pose,
    to_subcarriers,
    to_time_samples,
    wiener_phase_rad,
    with_beam_phases,
    with_element_errors,
    with_iq_imbalance,
    with_mutual_coupling,
)
from sim.signal.link import Link, pilots
from sim.signal.waveform.occasions import sweep_occasions
from sim.truth import Truth


class RandomStage(IntEnum):
    """The stages that draw random numbers; the number is part of the seed."""

    CLOCK = 0
    NOISE = 1
    CLOCK_BIAS = 2
    PAIR_PHASE = 3
    SYMBOL_PHASE = 4
    TX_ELEMENTS = 5
    RX_ELEMENTS = 6
    TX_BEAMS = 7
    RX_BEAMS = 8
    SURVEY = 9
    TARGETS = 10
    TX_CLOCK = 11


def stage_generator(seed: int, stage: RandomStage, stop: int = 0, tx_number: int = 0) -> np.random.Generator:
    """The random generator of one stage at one stop; that of a later TX for what each TX has of its own."""
    of_tx = (tx_number,) if tx_number else ()
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(int(stage), stop, *of_tx)))


def impaired_codebooks(config: SimulationConfig, link: Link) -> tuple[Codebook, Codebook]:
    """TX and RX codebooks with the impairments of the arrays; the designed codebooks if there are none.

    A device has the same array in all its links. The receiving panel of a monostatic node is one of its own.
    """
    of_node, of_walk = (
        (RandomStage.TX_ELEMENTS, RandomStage.TX_BEAMS),
        (RandomStage.RX_ELEMENTS, RandomStage.RX_BEAMS),
    )
    role = config.role
    sends, receives = (*of_node, role.node), (*of_walk, 0)
    if role.kind == LinkKind.UPLINK:
        sends, receives = receives, sends
    elif role.kind == LinkKind.NODES:
        receives = (*of_node, role.receiver or 0)
    elif role.kind == LinkKind.MONOSTATIC:
        receives = (*of_walk, role.node + 1)
    return _built(config, link.tx_codebook, *sends), _built(config, link.rx_codebook, *receives)


def true_ends(config: SimulationConfig, scene: Scene, truth: Truth) -> tuple[Pose, Pose]:
    """The true poses of TX and RX of a link: that of its fixed node has the pointing offset."""
    node = true_tx_pose(config, scene.tx)
    return (node, truth.rx_pose) if truth.tx_pose is None else (truth.tx_pose, node)


def true_tx_pose(config: SimulationConfig, nominal: Pose) -> Pose:
    """The true TX pose: the nominal pose with the pointing offset, which the estimators do not know."""
    offset_deg = config.impairments.tx_pointing_offset_deg
    if not offset_deg:
        return nominal
    return Pose(nominal.position_m, float(nominal.heading_rad + np.deg2rad(offset_deg)))


def extra_clock_bias_s(config: SimulationConfig, n_stops: int) -> FloatArray:
    """Clock bias (stop,) in s, added to the random walk of the clock."""
    draws = stage_generator(config.seed, RandomStage.CLOCK_BIAS).standard_normal(n_stops)
    return np.asarray(config.impairments.clock_bias_std_ns * 1e-9 * draws)


def with_surveyed_pose(config: SimulationConfig, truth: Truth) -> Truth:
    """The truth with the surveyed pose of what walks, with the survey errors, for methods that know this pose."""
    hardware = config.impairments
    is_node = config.role.receiver is not None
    if is_node or not (hardware.rx_placement_std_m or hardware.rx_heading_std_deg):
        return truth
    rng = stage_generator(config.seed, RandomStage.SURVEY, truth.stop)
    heading_std_rad = np.deg2rad(hardware.rx_heading_std_deg)
    pose = surveyed_pose(truth.stop_pose, hardware.rx_placement_std_m, heading_std_rad, rng)
    return replace(truth, rx_pose=pose) if truth.tx_pose is None else replace(truth, tx_pose=pose)


def receive_samples(
    config: SimulationConfig,
    link: Link,
    stop: int,
    clean: ComplexArray,
    again: Callable[[int], ComplexArray] | None = None,
    noise_number: int = 0,
) -> ComplexArray:
    """Received samples of a stop from noiseless samples (tx_beam, rx_beam, subcarrier), which are overwritten.

    Oscillator, thermal noise and front end act on every repetition of a beam pair separately. The receiver
    replaces the pilots of each repetition by those of the first one and averages. If the slots of a beam differ
    between RX beams, the pilots of the first RX beam are used for all. `again` gives the noiseless samples of a
    later repetition, where they are not those of the first. `noise_number` is the TX whose noise it is: TX on the
    same resource elements share it.
    """
    from sim.signal.noise import add_noise  # noqa: PLC0415  (brings numba)

    occasions = sweep_occasions(config.waveform, *clean.shape[:2])
    phase_rad = oscillator_phase_rad(config, stop, occasions.time_s)
    noise_rng = stage_generator(config.seed, RandomStage.NOISE, stop, noise_number)
    symbol_rng = stage_generator(config.seed, RandomStage.SYMBOL_PHASE, stop)
    count = occasions.repetitions
    total = clean if count == 1 else np.zeros_like(clean)
    for number, (time_s, turn_rad, slot) in enumerate(
        zip(occasions.time_s, phase_rad, occasions.slot, strict=True)
    ):
        samples = clean if count == 1 else clean.copy() if again is None or not number else again(number)
        other_pilot = None
        if count > 1:
            other_pilot = (pilots(config.waveform, slot) * link.prs_symbol.conj()).astype(np.complex64)
            samples *= other_pilot[:, None]
        apply_oscillator(config, link, samples, time_s, turn_rad)
        add_noise(samples, link.noise_power_mw * count, noise_rng)
        apply_front_end(config, link, samples, symbol_rng)
        if other_pilot is not None:
            samples *= other_pilot.conj()[:, None] / np.float32(count)
            total += samples
    return total


def oscillator_phase_rad(config: SimulationConfig, stop: int, time_s: FloatArray) -> FloatArray:
    """Oscillator phase (repetition, tx_beam, rx_beam) of the receiver from CFO and phase noise between pairs."""
    hardware = config.impairments
    phase_rad = 2 * np.pi * hardware.cfo_hz * time_s
    if hardware.phase_noise_pair_deg:
        rng = stage_generator(config.seed, RandomStage.PAIR_PHASE, stop)
        phase_rad = phase_rad + random_walk_phase_rad(time_s, np.deg2rad(hardware.phase_noise_pair_deg), rng)
    return np.asarray(phase_rad)


def apply_oscillator(
    config: SimulationConfig, link: Link, samples: ComplexArray, time_s: FloatArray, phase_rad: FloatArray
) -> None:
    """Apply clock drift and the oscillator phase (tx_beam, rx_beam) to noiseless samples, in place."""
    drift_ppm = config.impairments.clock_drift_ppm
    if drift_ppm:
        apply_clock_drift(samples, time_s, drift_ppm, link.frequency_offset_hz)
    if phase_rad.any():
        samples *= np.exp(1j * phase_rad).astype(np.complex64)[..., None]


def apply_front_end(config: SimulationConfig, link: Link, samples: ComplexArray, rng: np.random.Generator) -> None:
    """Apply the impairments of oscillator, mixer and converters to the time samples, in place, per TX beam.

    CFO and phase noise within a symbol cause leakage between subcarriers, IQ imbalance adds mirrored subcarriers,
    and the converters act on the sum of all subcarriers. The strongest beam pair of the stop sets the converter
    gain.
    """
    hardware = config.impairments
    if not (
        hardware.cfo_hz or hardware.phase_noise_linewidth_hz or hardware.iq_gain_db or hardware.iq_phase_deg
        or hardware.adc_bits or hardware.adc_clip_db is not None
    ):  # fmt: skip
        return
    spacing_hz = config.waveform.prs.subcarrier_spacing_hz
    bins, n_fft = fft_bins(link.frequency_offset_hz, spacing_hz)
    strongest = max(float(np.linalg.norm(block, axis=1).max()) for block in samples) ** 2
    rms = np.sqrt(strongest / n_fft / 2)
    cfo_rad = 2 * np.pi * hardware.cfo_hz / (spacing_hz * n_fft) * np.arange(n_fft, dtype=float)
    for block in samples:
        signal = to_time_samples(block, bins, n_fft)
        phase_rad: FloatArray = cfo_rad
        if hardware.phase_noise_linewidth_hz:
            phase_rad = phase_rad + wiener_phase_rad(
                len(block), n_fft, hardware.phase_noise_linewidth_hz, spacing_hz * n_fft, rng
            )
        if hardware.cfo_hz or hardware.phase_noise_linewidth_hz:
            signal = signal * np.exp(1j * phase_rad).astype(np.complex64)
        if hardware.iq_gain_db or hardware.iq_phase_deg:
            signal = with_iq_imbalance(signal, hardware.iq_gain_db, np.deg2rad(hardware.iq_phase_deg))
        if hardware.adc_clip_db is not None:
            signal = clipped_iq(signal, rms * 10 ** (hardware.adc_clip_db / 20))
        if hardware.adc_bits:
            signal = quantised_iq(signal, hardware.adc_bits, rms * 10 ** (hardware.adc_full_scale_db / 20))
        block[:] = to_subcarriers(signal, bins)


def _built(
    config: SimulationConfig, codebook: Codebook, elements: RandomStage, beams: RandomStage, own: int
) -> Codebook:
    """The codebook of the device number `own` of its kind."""
    hardware = config.impairments
    if hardware.element_gain_std_db or hardware.element_phase_std_deg:
        codebook = with_element_errors(
            codebook,
            hardware.element_gain_std_db,
            np.deg2rad(hardware.element_phase_std_deg),
            stage_generator(config.seed, elements, tx_number=own),
        )
    if hardware.coupling_db is not None:
        codebook = with_mutual_coupling(codebook, hardware.coupling_db)
    if hardware.beam_phase_std_deg:
        codebook = with_beam_phases(
            codebook, np.deg2rad(hardware.beam_phase_std_deg), stage_generator(config.seed, beams, tx_number=own)
        )
    return codebook
