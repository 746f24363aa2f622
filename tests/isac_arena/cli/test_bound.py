"""Bounds of a campaign's scene: the map over the plan and the table along the walk."""

from dataclasses import replace

import numpy as np
import pytest

import isac_arena as ia
from estimation.channel.model.crb import crb
from estimation.slam.bounds import stop_bound
from isac_arena.insight.bounds import channel as channel_bound
from isac_arena.insight.bounds import position as bound_map
from isac_arena.insight.bounds import signal as signal_bound
from isac_arena.report.figures.bound import bound_figure, channel_bound_figure
from isac_arena.report.style import png_bytes
from isac_arena.validation.scoring.campaigns import bound_difference
from scenes.pose import Pose


def test_bounds_over_the_plan_are_those_of_the_paths_there():
    prepared = bound_map.bound_inputs("box_room")
    bound = bound_map.over_plan(prepared, bound_map.plan_grid(prepared, 0.7))
    assert bound.peb_m.shape == (len(bound.y_m), len(bound.x_m)) == bound.has_los.shape
    finite = np.argwhere(np.isfinite(bound.peb_m))
    row, column = finite[len(finite) // 2]
    place = np.array([bound.x_m[column], bound.y_m[row], prepared.scene.walk.height_m])
    paths = bound_map.stop_paths(prepared, prepared.solver.paths(place)[0])
    limits, _ = stop_bound(prepared.scene.tx, np.array([*place[:2], 0.0, 0.0]), paths)
    np.testing.assert_allclose(limits.position_m, bound.peb_m[row, column])
    assert np.all(bound.peb_m[np.isfinite(bound.peb_m)] > 0)
    assert png_bytes(bound_figure(prepared.scene, bound)).startswith(b"\x89PNG")


def test_the_table_along_the_walk_has_both_bounds():
    table = bound_map.along_walk(bound_map.bound_inputs("box_room"))
    assert table.row_count == 4 and len(table.columns) == 4


def test_faces_are_shared_by_the_stops_that_see_them_and_pillars_are_not():
    prepared = bound_map.bound_inputs("box_room")
    positions = prepared.scene.walk.positions_m()
    states = np.column_stack([positions[:, :2], np.zeros((len(positions), 2))])
    stops = [bound_map.stop_paths(prepared, paths) for paths in prepared.solver.paths(positions)]
    shared = bound_map.share_walls(prepared.scene.tx, states, stops)
    center = np.array([5.0, 5.5])
    for stop in shared:
        on_pillar = np.hypot(*(stop.point_m - center).T) < 0.35
        assert np.all(stop.wall[on_pillar] == -1)
    walls = np.concatenate([stop.wall for stop in shared])
    assert 1 <= len(np.unique(walls[walls >= 0])) <= 8


def test_channel_bounds_over_the_plan_are_those_of_the_strongest_path_there():
    prepared = bound_map.bound_inputs("box_room")
    model, grid = channel_bound.channel_model(prepared), bound_map.plan_grid(prepared, 1.1)
    bound = channel_bound.over_plan(model, grid)
    assert model.is_coherent and bound.delay_std_s.shape == bound.has_los.shape
    in_sight = np.flatnonzero(bound.has_los[grid.is_free])
    index = in_sight[len(in_sight) // 2]
    at = tuple(np.argwhere(grid.is_free)[index])
    pose = Pose(grid.position_m[index], float(prepared.scene.walk.headings_rad()[0]))
    paths, link = grid.paths[index], model.link
    los = int(np.argmax(paths.power))
    assert bound.has_los[at] and paths.is_los[los]
    alone = crb(
        link.tx_codebook,
        link.rx_codebook,
        link.frequency_offset_hz,
        link.noise_power_mw,
        delay_s=paths.delay_s[los],
        aod_rad=paths.aod_azimuth_rad[[los]] - prepared.scene.tx.heading_rad,
        aoa_rad=paths.aoa_azimuth_rad[[los]] - pose.heading_rad,
        amplitude=np.sqrt(link.tx_power_mw) * paths.gain[los],
    )
    together = np.array([bound.delay_std_s[at], bound.aod_std_rad[at], bound.aoa_std_rad[at]])
    assert np.all(together >= alone.std[0] * (1 - 1e-6)) and np.all(together < 10 * alone.std[0])
    assert png_bytes(channel_bound_figure(prepared.scene, bound)).startswith(b"\x89PNG")


def test_the_channel_table_has_both_kinds_of_paths_and_of_phases():
    table = channel_bound.along_walk(channel_bound.channel_model(bound_map.bound_inputs("box_room")), range(4))
    delay = [float(list(column.cells)[1]) for column in table.columns[1:5]]
    assert table.row_count == 5 and delay[0] < delay[2]
    assert delay[1] >= delay[0] and delay[3] >= delay[2]


def test_hardware_without_phase_is_bounded_as_such():
    prepared = bound_map.bound_inputs("campus_arena_hardware")
    assert not channel_bound.channel_model(prepared).is_coherent


def test_weak_paths_are_left_out():
    prepared = bound_map.bound_inputs("box_room")
    model, pose = channel_bound.channel_model(prepared), prepared.scene.walk.poses()[0]
    (paths,) = prepared.solver.paths(pose.position_m)
    kept, bounds = channel_bound.stop_bounds(model, paths, pose, coherent=True)
    assert 0 < len(kept) <= len(paths) and np.all(bounds.snr_db > channel_bound.LEAST_SNR_DB - 3)


def test_the_bound_of_a_walk_that_sends_is_that_of_the_scores():
    assert bound_difference(ia.load_campaign("box_room_uplink"), [0, 2]).max() <= 0.01


def test_an_uplink_has_the_channel_of_the_downlink_with_its_ends_swapped():
    loaded = ia.load_campaign("box_room_uplink")
    ((_, up),) = signal_bound.links_of_walk(loaded).items()
    prepared = bound_map.bound_inputs(replace(loaded, config=up.config, scene=up.scene))
    pose = prepared.scene.stops[0]
    (paths,) = prepared.solver.paths(pose.position_m)
    kept, bounds = channel_bound.stop_bounds(channel_bound.channel_model(prepared), paths, pose, coherent=True)
    los = int(np.flatnonzero(kept.is_los)[0])
    towards = prepared.scene.tx.position_m - pose.position_m
    assert kept.aod_azimuth_rad[los] == pytest.approx(np.arctan2(towards[1], towards[0]))
    assert np.isfinite(bounds.delay_std_s).all() and np.isfinite(bounds.aoa_std_rad[los]).all()


def test_fixed_nodes_alone_have_no_position_to_bound():
    with pytest.raises(ValueError, match="links: none has a walk"):
        signal_bound.SignalBounds(ia.load_campaign("monostatic"))


def test_the_bound_at_the_stops_is_that_of_the_scores():
    campaign = ia.load_campaign("box_room", waveform={"comb": 12}, propagation={"diffuse_samples": 0})
    assert bound_difference(campaign, [0, 3]).max() <= 0.01
    _, found = signal_bound.along_walk(signal_bound.SignalBounds(campaign))
    assert 0 < max(found) < 0.01  # thermal noise alone
