"""Synthetic stops whose paths have Doppler shifts, through the campaign's own simulator, with their bounds."""

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from estimation.channel.model.crb import joint_loss_db, path_covariance, path_information
from estimation.channel.model.factors import MovingPaths
from isac_arena.validation.scenarios.link_bench import (
    LONE_SCENE,
    LONE_STOP,
    DrawnPaths,
    LinkBench,
    amplitudes,
    bench_of,
    level_paths,
    nearest,
)
from scenes.pose import SPEED_OF_LIGHT_M_S
from scenes.record import ComplexArray, FloatArray, concatenate
from sim.clock import beam_clock, campaign_clock
from sim.config import ArrayConfig, SimulationConfig, WaveformConfig
from sim.observation import BeamClock, BeamSweep
from sim.propagation.motion.tracks import SweepMotion
from sim.propagation.paths import PathRates, Paths
from sim.signal.waveform.config import ScanOrder
from sim.simulate import observe
from sim.truth import Truth

N_BEAMS = 20
SYMBOLS: Literal[6] = 6  # of a beam pair: a sweep takes 21 ms, shifts of linear scans are ambiguous by 930 Hz


@dataclass(frozen=True)
class MovingStop:
    """One made stop: the sweep and what it was made of."""

    sweep: BeamSweep
    paths: DrawnPaths
    doppler_hz: FloatArray  # (path,) exactly zero for frozen paths
    amplitude: ComplexArray  # (path,) xi in sqrt(mW) in the middle of the sweep


def moving_bench(seed: int, order: ScanOrder, n_rb: int = 48) -> LinkBench:
    """A link of 20 x 20 beams in one order of its scan."""
    array = ArrayConfig(beams_per_panel=N_BEAMS, sector_deg=120.0)
    waveform = WaveformConfig(n_rb=n_rb, n_symbols=SYMBOLS, combine_symbols=True, scan_order=order)
    return bench_of(SimulationConfig(scene="lone", seed=seed, waveform=waveform, tx_array=array, rx_array=array))


def clock_of(bench: LinkBench) -> BeamClock:
    """The times of the beams of a link."""
    return beam_clock(bench.config, campaign_clock(bench.config, LONE_SCENE))


def moving_stop(bench: LinkBench, paths: DrawnPaths, doppler_hz: FloatArray, stop: int) -> MovingStop:
    """The sweep of drawn paths whose lengths change steadily, with noise and samples of the simulator."""
    xi = amplitudes(bench, paths)
    middle = level_paths(xi / np.sqrt(bench.link.tx_power_mw), paths.parameters)
    clock = campaign_clock(bench.config, LONE_SCENE)
    motion = steady_sweep(bench.link.carrier_hz, middle, doppler_hz, clock.order_s)
    truth = Truth(middle, LONE_STOP, stop, 0.0, motion=motion)
    return MovingStop(observe(bench.config, bench.link, LONE_SCENE, truth), paths, doppler_hz, xi)


def moving_bounds(
    bench: LinkBench, stop: MovingStop, clock: BeamClock
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Covariance (path, 4, 4) of delay, AoD, AoA and Doppler, SNR lost to others, distance in cells to the next.

    Frozen paths are known to be frozen.
    """
    link, parameters = bench.link, stop.paths.parameters
    moving = MovingPaths(clock, stop.doppler_hz, stop.doppler_hz == 0)
    information = path_information(
        bench.tx, bench.rx, link.frequency_offset_hz, link.noise_power_mw, parameters[:, 0], parameters[:, 1:2],
        parameters[:, 2:3], stop.amplitude, coherent=True, moving=moving,
    )  # fmt: skip
    joint = np.einsum("iaib->iab", path_covariance(information))[:, :4, :4]
    return joint, joint_loss_db(information), nearest(stop.paths.cells / bench.cell)


def steady_sweep(carrier_hz: float, middle: Paths, doppler_hz: FloatArray, order_s: FloatArray) -> SweepMotion:
    """Paths of constant length rates over a sweep; the phase of a gain is that of its length."""
    n = len(middle)
    ends_s = float(order_s[0]), 0.0, float(order_s[-1])
    none = np.zeros(n)
    rates = PathRates(doppler_hz, -SPEED_OF_LIGHT_M_S / carrier_hz * doppler_hz, *(none for _ in range(5)))
    states = [
        replace(
            middle,
            delay_s=middle.delay_s - doppler_hz * at_s / carrier_hz,
            gain=middle.gain * np.exp(2j * np.pi * doppler_hz * at_s),
            rates=rates,
        )
        for at_s in ends_s
    ]
    index = np.arange(3)[:, None] * n + np.arange(n)
    return SweepMotion(
        states=concatenate(states, "path"),
        state_s=np.repeat(ends_s, n),
        first=index[0],
        middle=index[1],
        last=index[2],
        from_s=np.full(n, ends_s[0]),
        to_s=np.full(n, np.inf),
        time_s=0.0,
        rx_velocity_m_s=np.zeros(3),
        n_traces=3,
        second_order_phase_rad=0.0,
    )
