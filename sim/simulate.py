"""Simulation of a campaign: from its settings to the `BeamSweep` and the `Truth` of each stop.

Every stop and stage has its own random generator, derived from the seed. So any subset of stops, in any order, on
any number of workers, gives the same bits.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from scenes.arguments import need
from scenes.pose import Pose
from scenes.record import ComplexArray, FloatArray, IntArray
from scenes.scene import Scene
from sim.clock import beam_clock, campaign_clock
from sim.config import LinkKind, SimulationConfig
from sim.observation import BeamSweep
from sim.propagation.deepmimo.folder import read_deepmimo
from sim.propagation.deepmimo.scenario import SAME_PLACE_M, PathScenario
from sim.signal.arrays.codebook import Codebook
from sim.signal.crosstalk import crosstalk, do_meet, share_all_elements
from sim.signal.demand import ask_sample_memory
from sim.signal.generation import beam_channel
from sim.signal.hardware.apply_impairments import (
    RandomStage,
    extra_clock_bias_s,
    impaired_codebooks,
    receive_samples,
    stage_generator,
    true_ends,
    true_tx_pose,
)
from sim.signal.leakage import with_leakage
from sim.signal.link import Link
from sim.signal.waveform.prs import SUBCARRIERS_PER_RB, prs_subcarriers
from sim.truth import Truth

if TYPE_CHECKING:
    from sim.propagation.propagator import PlanarComparison

__all__ = ["OtherTx", "RandomStage", "clock_biases_s", "observe", "simulate_truth", "stage_generator"]


def clock_biases_s(config: SimulationConfig, n_stops: int) -> FloatArray:
    """Clock bias (stop,) in s of a link, receiver minus TX, at every stop.

    That of a walk is a random walk from the initial value, plus the extra bias of every stop. That against a later
    node of several also has the offset between the two nodes.
    """
    steps = stage_generator(config.seed, RandomStage.CLOCK).standard_normal(n_stops)
    walk_s = (config.clock.initial_bias_ns + config.clock.walk_std_ns * np.cumsum(steps)) * 1e-9
    bias_s = np.asarray(walk_s + extra_clock_bias_s(config, n_stops))
    role, node_s = config.role, _node_clock_s(config, config.role.node, n_stops)
    if role.receiver is not None:  # zero where a node hears itself
        return np.asarray(_node_clock_s(config, role.receiver, n_stops) - node_s)
    bias_s = bias_s if not role.node else bias_s - node_s
    return -bias_s if role.kind == LinkKind.UPLINK else bias_s


def _node_clock_s(config: SimulationConfig, node: int, n_stops: int) -> FloatArray:
    """Clock (stop,) in s of a fixed node against the first one: a random walk from an offset."""
    if not node:
        return np.zeros(n_stops)
    clock = config.clock
    draws = stage_generator(config.seed, RandomStage.TX_CLOCK, 0, node).standard_normal(n_stops + 1)
    return np.asarray((clock.tx_offset_std_ns * draws[0] + clock.tx_walk_std_ns * np.cumsum(draws[1:])) * 1e-9)


def simulate_truth(config: SimulationConfig, scene: Scene, stops: Iterable[int]) -> Iterator[Truth]:
    """Compute the truth of the given stops of the walk of a scene, one at a time.

    If the settings name a DeepMIMO scenario, its paths replace the traced paths. If the scene needs the ray tracer
    and `propagation.compare_planar` is set, its planar paths are also compared with the exact ones.
    """
    need("config", config, SimulationConfig)
    need("scene", scene, Scene)
    for truth in _truths(config, scene, stops):
        if config.role.kind == LinkKind.MONOSTATIC:
            yield with_leakage(config, scene, truth)
        else:
            yield in_direction(config, scene, truth)


def in_direction(config: SimulationConfig, scene: Scene, truth: Truth) -> Truth:
    """A truth whose paths lead from the fixed node to the stop, as its link sends: in an uplink the other way."""
    return truth.sent_from_stop(scene.tx) if config.role.kind == LinkKind.UPLINK else truth


def _truths(config: SimulationConfig, scene: Scene, stops: Iterable[int]) -> Iterator[Truth]:
    """The truths with their paths from the fixed node to the stops."""
    poses = scene.stops
    biases_s = clock_biases_s(config, len(poses))
    carrier_hz = config.waveform.carrier_ghz * 1e9
    if scene.is_moving:
        from sim.moving import moving_paths  # noqa: PLC0415  (slow to import, kept truths need none)

        for stop, paths, motion, compared in moving_paths(config, scene, stops):
            yield Truth(paths, poses[stop], stop, biases_s[stop], *_counts(compared), motion)
        return
    if config.propagation.deepmimo is not None:
        scenario = _scenario(config.propagation.deepmimo, scene, carrier_hz)
        for stop in stops:
            yield Truth(scenario.paths_at(poses[stop].position_m), poses[stop], stop, biases_s[stop])
        return
    from sim.propagation.propagator import Propagator  # noqa: PLC0415

    propagator = Propagator(scene, carrier_hz, config.propagation)
    for stop in stops:
        rng = stage_generator(config.seed, RandomStage.TARGETS, stop)
        paths, compared = propagator.drawn(rng).compared_paths(poses[stop].position_m)
        yield Truth(paths, poses[stop], stop, biases_s[stop], *_counts(compared))


def _counts(compared: "PlanarComparison") -> tuple[int, int, int]:
    """Planar paths found, missed by the tracer, and found by the tracer alone."""
    return compared.n_common + compared.n_repaired + compared.n_extra, compared.n_repaired, compared.n_extra


def _scenario(folder: str, scene: Scene, carrier_hz: float) -> PathScenario:
    """The paths of a DeepMIMO scenario; `ValueError` if its carrier or TX position differs from the scene."""
    scenario = read_deepmimo(Path(folder))
    if abs(scenario.carrier_hz - carrier_hz) > 1:
        traced_ghz = scenario.carrier_hz / 1e9
        raise ValueError(f"waveform.carrier_ghz = {carrier_hz / 1e9:g}: {folder} was traced at {traced_ghz:g} GHz")
    if np.linalg.norm(scenario.tx_position_m - scene.tx.position_m) > SAME_PLACE_M:
        place = ", ".join(f"{value:g}" for value in scenario.tx_position_m)
        raise ValueError(
            f"propagation.deepmimo = {folder}: its TX stands at ({place}) m, that of the scene does not"
        )
    return scenario


@dataclass(frozen=True)
class OtherTx:
    """Another TX on the air, as its own link has it."""

    config: SimulationConfig
    link: Link
    scene: Scene
    truth: Truth


def observe(
    config: SimulationConfig, link: Link, scene: Scene, truth: Truth, others: Sequence[OtherTx] = ()
) -> BeamSweep:
    """The samples of one stop: equation (1) with noise, the unknown clock bias and the hardware impairments.

    Every call gives the same bits. The sweep holds only the nominal codebooks and the nominal TX pose. Another TX
    is heard where its resources meet those of the sweep.

    Raises `MemoryLimitError` where the samples do not fit into the memory.
    """
    need("config", config, SimulationConfig)
    need("link", link, Link)
    need("scene", scene, Scene)
    need("truth", truth, Truth)
    ask_sample_memory(config)
    tx_codebook, rx_codebook = impaired_codebooks(config, link)
    pilot = np.sqrt(link.tx_power_mw).astype(np.float32) * link.prs_symbol[:, None, :]
    heard = [
        (other, _heard_channel(other)) for other in others if is_heard(config, link, other.config, other.link)
    ]

    def sent(repetition: int) -> ComplexArray:
        samples = clean_samples(config, link, scene, truth, (tx_codebook, rx_codebook), repetition)
        samples *= pilot
        for other, channel in heard:
            samples += crosstalk(config, other.config, link.prs_symbol, channel, repetition)
        return samples

    is_alike = truth.motion is None and not heard
    samples = receive_samples(
        config, link, truth.stop, sent(0), None if is_alike else sent, _noise_number(config, link, others)
    )
    tx_pose = scene.tx if truth.motion is None else scene.tx_at(truth.motion.time_s)
    if truth.tx_pose is not None:
        tx_pose = Pose(np.full(3, np.nan), np.nan)
    return BeamSweep(
        tx_codebook=link.tx_codebook,
        rx_codebook=link.rx_codebook,
        tx_pose=tx_pose,
        stop=truth.stop,
        samples=samples,
        prs_symbol=link.prs_symbol,
        frequency_offset_hz=link.frequency_offset_hz,
        carrier_hz=link.carrier_hz,
        noise_power_mw=link.noise_power_mw,
        clock=None if truth.motion is None else beam_clock(config, campaign_clock(config, scene)),
    )


def is_heard(config: SimulationConfig, link: Link, other: SimulationConfig, other_link: Link) -> bool:
    """Whether another TX is heard in a sweep of these settings."""
    n_tx, n_other, n_rx = len(link.tx_codebook), len(other_link.tx_codebook), len(link.rx_codebook)
    return do_meet(config, other, n_tx, n_other, n_rx)


def _heard_channel(other: OtherTx) -> ComplexArray:
    """Channel (beam, rx_beam, subcarrier) of another TX, with its transmit power and its beams as built."""
    built = impaired_codebooks(other.config, other.link)
    samples = clean_samples(other.config, other.link, other.scene, other.truth, built, 0)
    return np.asarray(np.sqrt(other.link.tx_power_mw).astype(np.float32) * samples)


def _noise_number(config: SimulationConfig, link: Link, others: Sequence[OtherTx]) -> int:
    """The TX whose noise a sweep has: the first of those that are measured on the same resource elements."""
    n_tx, n_rx = len(link.tx_codebook), len(link.rx_codebook)
    same = [
        other.config.tx_number
        for other in others
        if len(other.link.tx_codebook) == n_tx and share_all_elements(config, other.config, n_tx, n_rx)
    ]
    return min([config.tx_number, *same])


def clean_samples(
    config: SimulationConfig,
    link: Link,
    scene: Scene,
    truth: Truth,
    codebooks: tuple[Codebook, Codebook],
    repetition: int,
) -> ComplexArray:
    """Channel (tx_beam, rx_beam, subcarrier) of one repetition of every beam pair of a stop, with these codebooks.

    In a frozen world all repetitions are the same.
    """
    if truth.motion is not None:
        return _moving_samples(config, link, scene, truth, codebooks, repetition)
    tx_pose, rx_pose = true_ends(config, scene, truth)
    return beam_channel(
        truth.paths,
        tx_codebook=codebooks[0],
        rx_codebook=codebooks[1],
        tx_pose=tx_pose,
        rx_pose=rx_pose,
        frequency_offset_hz=link.frequency_offset_hz,
        clock_bias_s=truth.clock_bias_s,
    )


def _moving_samples(
    config: SimulationConfig,
    link: Link,
    scene: Scene,
    truth: Truth,
    codebooks: tuple[Codebook, Codebook],
    repetition: int,
) -> ComplexArray:
    """Channel (tx_beam, rx_beam, subcarrier) of one repetition of every beam pair in a world that moves.

    Where a beam pair combines the symbols of a resource, each subcarrier is the mean of the symbols that sound it.
    """
    from sim.signal.moving import moving_channel  # noqa: PLC0415  (brings numba)

    assert truth.motion is not None
    motion, prs = truth.motion, config.waveform.prs
    time_s = campaign_clock(config, scene).symbol_s[repetition]

    def heading_rad(later_s: float) -> float:
        return true_tx_pose(config, scene.tx_at(motion.time_s + later_s)).heading_rad

    def channel(later_s: float, subcarrier: slice | IntArray) -> ComplexArray:
        """Channel (tx_beam, rx_beam, subcarrier) at some subcarriers, `later_s` s after the times of the pairs."""
        return moving_channel(
            motion,
            time_s,
            tx_codebook=codebooks[0],
            rx_codebook=codebooks[1],
            tx_heading_rad=heading_rad,
            rx_pose=truth.rx_pose,
            frequency_offset_hz=link.frequency_offset_hz[subcarrier],
            clock_bias_s=truth.clock_bias_s,
            later_s=later_s,
        )

    if not config.waveform.combine_symbols:
        return channel(0.0, slice(None))
    total = np.zeros((*time_s.shape, len(link.frequency_offset_hz)), np.complex64)
    for number, symbol in enumerate(prs.symbols):
        sounded = prs_subcarriers(prs, symbol) - prs.rb_offset * SUBCARRIERS_PER_RB
        total[..., sounded] += channel(number * prs.symbol_s, sounded)
    total *= np.float32(prs.comb / prs.length)
    return total
