"""Sweeps of a small link whose paths have Doppler shifts, equation (1) with the phase of every beam pair."""

from dataclasses import replace
from typing import Any

import numpy as np

from scenes.record import ComplexArray, FloatArray
from sim.config import WaveformConfig
from sim.observation import BeamClock, BeamSweep
from sim.signal.link import Link
from sim.signal.waveform.occasions import sweep_occasions
from tests.estimation.channel.plain_sweeps import PlainPaths, no_plain_paths, plain_sweep

PAIR_TIMES = 10.0  # a pair takes as many symbols: the sweep lasts 9 ms


def scan_clock(link: Link, order: Any) -> BeamClock:
    """Times of the beams of a link in one order of the scan."""
    time_s = sweep_occasions(
        WaveformConfig(scan_order=order), len(link.tx_codebook), len(link.rx_codebook)
    ).time_s[0]
    time_s = PAIR_TIMES * (time_s - time_s.mean())
    return BeamClock(time_s.mean(axis=1), time_s.mean(axis=0))


def moving_sweep(
    link: Link, paths: PlainPaths, doppler_hz: FloatArray, clock: BeamClock | None, rng: Any, dtype: Any = None
) -> Any:
    """The sweep of paths with these Doppler shifts; its samples alone where a `dtype` is given."""
    sweep: BeamSweep = plain_sweep(link, no_plain_paths(link), rng)
    samples: ComplexArray = sweep.samples.astype(complex)
    time_s = np.zeros(samples.shape[:2]) if clock is None else clock.tx_s[:, None] + clock.rx_s
    for path, shift_hz in enumerate(doppler_hz):
        one = [value[path : path + 1] for value in (paths.delay_s, paths.aod_rad, paths.aoa_rad, paths.amplitude)]
        turn = np.exp(2j * np.pi * shift_hz * time_s)
        samples += plain_sweep(link, PlainPaths(*one)).samples * turn[:, :, None]
    return samples.astype(dtype) if dtype else replace(sweep, samples=samples, clock=clock)
