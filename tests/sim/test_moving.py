"""Sweeps of a world that moves: truth, files and samples against tracing again at every symbol."""

from dataclasses import replace

import numpy as np
import pytest

from scenes.config import load_scene
from scenes.contours import RoundedPolygon
from scenes.motion.motion import steady_motion
from sim.clock import campaign_clock
from sim.config import ArrayConfig, PropagationConfig, SimulationConfig, WaveformConfig
from sim.moving import MovingWorld
from sim.propagation.motion.tracks import lengths_at
from sim.propagation.paths import BounceKind, path_labels
from sim.propagation.propagator import Propagator
from sim.signal.arrays.codebook import beam_response
from sim.signal.link import make_link
from sim.signal.waveform.config import ScheduleConfig
from sim.signal.waveform.prs import SUBCARRIERS_PER_RB, prs_subcarriers
from sim.simulate import clean_samples, observe, simulate_truth

EXACT = PropagationConfig(diffuse_samples=0, max_bounces=1)
SMALL = ArrayConfig(rows=1, columns=4, beams_per_panel=3)
WIDE = ArrayConfig(rows=1, columns=2, beams_per_panel=2, panel_azimuth_deg=[0.0, 180.0])


def config_of(**waveform) -> SimulationConfig:
    schedule = ScheduleConfig(period_slots=80, repetitions=2)
    return SimulationConfig(
        scene="-", propagation=EXACT, tx_array=SMALL, rx_array=WIDE,
        waveform=WaveformConfig(n_rb=24, schedule=schedule, **waveform),
    )  # fmt: skip


def busy_room(speed_m_s: float = 3.0):
    """The box room with a receiver that walks, a pillar that crosses its line of sight, and a TX that turns."""
    scene = load_scene("box_room")
    pillar = replace(scene.object("pillar"), motion=steady_motion(np.array([0.0, -3.0, 0.0]), start_s=0.0))
    pillar = replace(pillar, contour=replace(pillar.contour, center_m=np.array([3.0, 3.53])))
    objects = [pillar if item.name == "pillar" else item for item in scene.objects]
    walk = replace(scene.walk, waypoints_m=np.array([(5.0, 2.0), (5.5, 2.0)]), n_stops=2, speed_m_s=speed_m_s)
    turning = {"tx": steady_motion(np.array([0.2, 0.1, 0.0]), turn_rate_rad_s=0.5)}
    return replace(scene, objects=tuple(objects), walk=walk, tx_motions=turning)


@pytest.mark.parametrize("combine", [False, True])
def test_samples_are_those_of_paths_traced_at_every_symbol(combine: bool):
    config, scene = config_of(combine_symbols=combine), busy_room()
    link, clock = make_link(config), campaign_clock(config, scene)
    [truth] = simulate_truth(config, scene, [0])
    prs = config.waveform.prs
    books = link.tx_codebook, link.rx_codebook
    seen = set()
    largest, worst = 0.0, 0.0
    for repetition in range(2):
        made = clean_samples(config, link, scene, truth, books, repetition)
        largest = max(largest, float(np.abs(made).max()))
        for tx_beam, rx_beam in np.ndindex(*made.shape[:2]):
            for number, symbol in enumerate(prs.symbols if combine else prs.symbols[:1]):
                later = clock.symbol_s[repetition, tx_beam, rx_beam] + number * prs.symbol_s
                now, velocity = truth.motion.time_s + later, truth.motion.rx_velocity_m_s
                tx, rx = scene.tx_at(now), truth.rx_pose
                solver = Propagator(scene.at(now), 60e9, EXACT, traces=False)
                paths = solver.exact_paths(rx.position_m + later * velocity)
                seen.add(bool(paths.is_los.any()))
                where = slice(None)
                if combine:
                    where = prs_subcarriers(prs, symbol) - prs.rb_offset * SUBCARRIERS_PER_RB
                sent = beam_response(books[0], paths.aod_azimuth_rad - tx.heading_rad, paths.aod_elevation_rad)
                got = beam_response(books[1], paths.aoa_azimuth_rad - rx.heading_rad, paths.aoa_elevation_rad)
                frequency = link.frequency_offset_hz[where]
                turn = np.exp(-2j * np.pi * np.outer(paths.delay_s + truth.clock_bias_s, frequency))
                exact = (paths.gain * sent[tx_beam] * got[rx_beam]) @ turn
                worst = max(worst, float(np.abs(exact - made[tx_beam, rx_beam, where]).max()))
    assert seen == {True, False}, "the line of sight vanishes or appears in this sweep"
    assert 20 * np.log10(worst / largest) < -60


def test_the_truth_holds_rates_and_counts_what_was_traced():
    config, scene = config_of(), busy_room()
    [truth] = simulate_truth(config, scene, [0])
    motion, paths = truth.motion, truth.paths
    clock = campaign_clock(config, scene)
    assert np.isclose(motion.time_s, clock.middle_s[0]) and motion.n_traces > 3
    south = np.flatnonzero(path_labels(paths) == "S wall_south")
    for name in ("length_rate_m_s", "aod_azimuth_rate_rad_s", "aoa_azimuth_rate_rad_s"):
        assert getattr(paths.rates, name)[south].all()
    assert np.allclose(paths.rates.doppler_hz, -60e9 / 299_792_458 * paths.rates.length_rate_m_s)
    sweep = observe(config, make_link(config), scene, truth)
    assert np.allclose(sweep.tx_pose.position_m, scene.at(motion.time_s).tx.position_m)
    [again] = simulate_truth(config, scene, [0])
    assert again.motion.states.gain.tobytes() == motion.states.gain.tobytes()


def test_slow_worlds_are_traced_at_the_ends_and_the_middle_alone():
    scene = load_scene("box_room")
    scene = replace(scene, walk=replace(scene.walk, speed_m_s=0.01))
    [truth] = simulate_truth(config_of(), scene, [1])
    assert truth.motion.n_traces == 3 and truth.motion.second_order_phase_rad < 1e-6


def test_a_flash_off_a_face_of_one_millimetre_is_seen():
    """The bounce goes from arc to arc over a face that no symbol of the first traces falls on."""
    scene = load_scene("box_room")
    walk = replace(scene.walk, waypoints_m=np.array([(4.0, 2.0), (5.0, 2.0)]), n_stops=2, speed_m_s=1.0)
    scene = replace(scene, walk=walk)
    config = SimulationConfig(scene="-", propagation=EXACT, waveform=WaveformConfig(n_rb=24))
    clock = campaign_clock(config, scene)
    flash_s = 0.3 * float(clock.order_s[0])
    rx = np.array([4.0 + flash_s, 2.0])
    face, half_m = np.array([5.0, 5.2]), 0.1505
    legs = [end - face for end in (scene.tx.position_m[:2], rx)]
    normal = sum(leg / np.linalg.norm(leg) for leg in legs)
    normal = normal / np.linalg.norm(normal)
    along = np.array([-normal[1], normal[0]])
    corners = [face + half_m * (normal * (a - 1) + along * b) for a, b in ((1, -1), (1, 1), (-1, 1), (-1, -1))]
    pillar = replace(scene.object("pillar"), contour=RoundedPolygon(np.array(corners), np.full(4, half_m - 5e-4)))
    objects = tuple(pillar if item.name == "pillar" else item for item in scene.objects)
    scene = replace(scene, objects=objects)
    world = MovingWorld(config, scene, clock)
    _, motion, _ = world.swept(0)
    solver = Propagator(scene, 60e9, EXACT, traces=False)
    gains = []
    for later_s in (flash_s, flash_s + 0.005):
        traced = solver.exact_paths(scene.stops[0].position_m + later_s * motion.rx_velocity_m_s)
        [row] = np.flatnonzero(path_labels(traced) == "S pillar")
        here = motion.stretches(np.flatnonzero((motion.from_s <= later_s) & (later_s < motion.to_s)))
        length_m, gain = (each[0] for each in lengths_at(here, np.array([later_s]), 60e9))
        mine = np.abs(length_m - traced.length_m[row]).argmin()
        gains.append(abs(traced.gain[row]))
        assert np.isclose(abs(gain[mine]), gains[-1], rtol=1e-6)
    assert gains[0] > 2 * gains[1], "the face flashes"


def test_frozen_worlds_have_no_motion():
    [truth] = simulate_truth(config_of(), load_scene("box_room"), [0])
    assert truth.motion is None and truth.paths.rates is None


def test_diffuse_points_stay_on_their_bodies():
    scene = load_scene("box_room")
    box = replace(scene.object("box"), motion=steady_motion(np.array([0.0, -3.0, 0.0]), end_s=0.5))
    objects = tuple(box if item.name == "box" else item for item in scene.objects)
    scene = replace(scene, objects=objects, walk=replace(scene.walk, speed_m_s=2.0))
    config = config_of().model_copy(update={"propagation": PropagationConfig(diffuse_samples=2000, max_bounces=1)})
    [truth] = simulate_truth(config, scene, [0])
    motion, states = truth.motion, truth.motion.states
    box_index = states.object_name.tolist().index("box")
    diffuse = np.flatnonzero(states.is_diffuse[motion.middle] & np.isinf(motion.to_s))
    mine = diffuse[states.bounce_object[motion.middle[diffuse], 0] == box_index]
    assert len(mine)
    span = motion.state_s[motion.last[mine]] - motion.state_s[motion.first[mine]]
    moved = states.vertex_m[motion.last[mine], 0] - states.vertex_m[motion.first[mine], 0]
    assert np.allclose(moved, span[:, None] * np.array([0.0, -3.0, 0.0]))
    gone = motion.state_s[motion.last[mine]] - motion.state_s[motion.middle[mine]]
    predicted = states.length_m[motion.middle[mine]] + gone * (
        states.rates.length_rate_m_s[motion.middle[mine]]
        + gone * states.rates.length_acceleration_m_s2[motion.middle[mine]] / 2
    )
    assert np.allclose(states.length_m[motion.last[mine]], predicted, atol=2e-5)
    assert (states.bounce_kind[motion.middle[mine], 0] == BounceKind.DIFFUSE).all()
