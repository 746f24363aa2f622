"""Samples of sweeps that move against tracing again at the symbols, and frozen worlds against the same code."""

import hashlib
import time
from dataclasses import replace
from functools import partial

import numpy as np

from isac_arena.validation.measurement import Measurement, at_least, at_most
from isac_arena.validation.motion.worlds import EXACT
from isac_arena.validation.scenarios.solids import CARRIER_HZ
from scenes.motion.motion import steady_motion
from scenes.random_arena import random_arena
from scenes.record import ComplexArray, FloatArray
from scenes.scene import Scene
from sim.clock import CampaignClock, campaign_clock
from sim.config import ArrayConfig, SimulationConfig, WaveformConfig
from sim.moving import MovingWorld
from sim.propagation.motion.tracks import SweepMotion
from sim.propagation.propagator import Propagator
from sim.signal.arrays.codebook import beam_response
from sim.signal.generation import beam_channel
from sim.signal.link import Link, make_link
from sim.signal.moving import moving_channel
from sim.simulate import clean_samples
from sim.truth import Truth

SPEEDS_M_S = (0.1, 1.0, 10.0)
BAR_DB = -60.0
BIAS_S = 1e-8
STRONG = 200  # symbols of the largest samples, from which half of those looked at are drawn
SLOWER_BAR = 1.05
CONFIG = SimulationConfig(
    scene="-",
    propagation=EXACT,
    waveform=WaveformConfig(n_rb=24),
    tx_array=ArrayConfig(),
    rx_array=ArrayConfig(panel_azimuth_deg=[-180.0, -90.0, 0.0, 90.0], beams_per_panel=24, sector_deg=90.0),
)


def check_samples(seed: int, quick: bool) -> list[Measurement]:
    """Whole sweeps of 3,072 beam pairs in random arenas with moving pillars and a walking receiver.

    In full every symbol is traced again in the first world of each speed, and some in the others.
    """
    link = make_link(CONFIG)
    rows, n_events = [], 0
    for speed in SPEEDS_M_S[1:] if quick else SPEEDS_M_S:
        errors = []
        for index in range(1 if quick else 10):
            world = walking_world(seed, index, speed)
            whole = not quick and not index
            error, events = _sweep_error(world, link, np.random.default_rng([seed, index]), 0 if whole else 24)
            errors.append(error)
            n_events += events
        reason = f"largest of {len(errors)} sweeps, over the largest sample of its sweep"
        rows.append(at_most(f"motion.samples.{speed:g}_m_s", max(errors), BAR_DB, reason, "dB"))
    reason = "stretches of one symbol, beside which a path appears or vanishes inside these sweeps"
    return [*rows, at_least("motion.samples.events", n_events, 1, reason, "stretches")]


def check_frozen_world(seed: int, quick: bool) -> list[Measurement]:
    """Samples of a world where nothing moves: bits and time of the generator itself."""
    scene = random_arena(np.random.default_rng(seed), 0.1, 2)
    link, stop = make_link(CONFIG), scene.stops[0]
    paths = Propagator(scene, CARRIER_HZ, EXACT, traces=False).exact_paths(stop.position_m)
    books = link.tx_codebook, link.rx_codebook
    plain = partial(
        beam_channel, paths, tx_codebook=books[0], rx_codebook=books[1], tx_pose=scene.tx, rx_pose=stop,
        frequency_offset_hz=link.frequency_offset_hz, clock_bias_s=BIAS_S,
    )  # fmt: skip
    through = partial(clean_samples, CONFIG, link, scene, Truth(paths, stop, 0, BIAS_S), books)
    same = _digest(plain()) == _digest(through(0))
    ratios = []
    for _ in range(5 if quick else 25):
        taken = []
        for make in (plain, partial(through, 0)):
            started = time.process_time()
            make()
            taken.append(time.process_time() - started)
        ratios.append(taken[1] / taken[0])
    return [
        at_least("motion.frozen.same_bits", same, 1, "samples of the path of moving worlds and of the generator"),
        at_most("motion.frozen.time", np.median(ratios), SLOWER_BAR, "median ratio of processor times"),
    ]


def walking_world(seed: int, index: int, speed_m_s: float) -> Scene:
    """A random arena with a receiver that walks, and pillars and boxes that drive and turn at the same speed."""
    rng = np.random.default_rng([seed, 1000 + index])
    scene = random_arena(rng, float(rng.uniform(0.0, 0.1)), 2)
    objects = tuple(
        replace(
            item, motion=steady_motion(speed_m_s * _unit(rng), float(rng.uniform(-1, 1) * min(speed_m_s, 2.0)))
        )
        if item.kind in ("pillar", "box")
        else item
        for item in scene.objects
    )
    return replace(scene, objects=objects, walk=replace(scene.walk, speed_m_s=speed_m_s))


def _unit(rng: np.random.Generator) -> FloatArray:
    course = rng.uniform(-np.pi, np.pi)
    return np.array([np.cos(course), np.sin(course), 0.0])


def _sweep_error(scene: Scene, link: Link, rng: np.random.Generator, n_symbols: int) -> tuple[float, int]:
    """Largest error in dB over the largest sample, over `n_symbols` symbols or all (0); paths that come or go."""
    clock = campaign_clock(CONFIG, scene)
    _, motion, _ = MovingWorld(CONFIG, scene, clock).swept(0)
    pose = scene.stops[0]
    made = moving_channel(
        motion, clock.symbol_s[0], tx_codebook=link.tx_codebook, rx_codebook=link.rx_codebook,
        tx_heading_rad=lambda _: scene.tx.heading_rad, rx_pose=pose,
        frequency_offset_hz=link.frequency_offset_hz, clock_bias_s=BIAS_S,
    )  # fmt: skip
    size = np.abs(made).max(axis=2)
    chosen = np.arange(size.size)
    if n_symbols:
        strong = np.argsort(-size.ravel())[:STRONG]
        chosen = np.concatenate([rng.choice(strong, n_symbols // 2), rng.integers(0, size.size, n_symbols // 2)])
    worst = 0.0
    for tx_beam, rx_beam in zip(*np.unravel_index(np.unique(chosen), size.shape), strict=True):
        exact = _traced_sample(scene, link, clock, motion, int(tx_beam), int(rx_beam))
        worst = max(worst, float(np.abs(exact - made[tx_beam, rx_beam]).max()))
    events = int(((motion.first == motion.last) & np.isfinite(motion.to_s)).sum())
    return 20 * np.log10(max(worst, 1e-30) / size.max()), events


def _traced_sample(
    scene: Scene, link: Link, clock: CampaignClock, motion: SweepMotion, tx_beam: int, rx_beam: int
) -> ComplexArray:
    """Sample (subcarrier,) of one beam pair from paths traced at its own time."""
    later_s, pose = clock.symbol_s[0, tx_beam, rx_beam], scene.stops[0]
    solver = Propagator(scene.at(motion.time_s + later_s), CARRIER_HZ, EXACT, traces=False)
    paths = solver.exact_paths(pose.position_m + later_s * motion.rx_velocity_m_s)
    books = link.tx_codebook.take("beam", [tx_beam]), link.rx_codebook.take("beam", [rx_beam])
    sent = beam_response(books[0], paths.aod_azimuth_rad - scene.tx.heading_rad, paths.aod_elevation_rad)[0]
    received = beam_response(books[1], paths.aoa_azimuth_rad - pose.heading_rad, paths.aoa_elevation_rad)[0]
    turn = np.exp(-2j * np.pi * np.outer(paths.delay_s + BIAS_S, link.frequency_offset_hz))
    return np.asarray((paths.gain * sent * received) @ turn)


def _digest(samples: ComplexArray) -> str:
    return hashlib.sha256(samples.tobytes()).hexdigest()
