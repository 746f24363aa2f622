"""Bounds of a campaign's scene: the map over the plan and the table along the walk."""

import json
import re
import tomllib
from dataclasses import replace

import numpy as np
import pytest

import isac_arena as ia
from estimation.channel.model.crb import crb
from estimation.slam.bounds import StateBound, stop_bound
from isac_arena.insight.bounds import channel as channel_bound
from isac_arena.insight.bounds import position as bound_map
from isac_arena.insight.bounds import signal as signal_bound
from isac_arena.insight.bounds import tables
from isac_arena.report.figures.bound import BoundMap, bound_figure, channel_bound_figure
from isac_arena.report.style import png_bytes
from isac_arena.validation.scoring.campaigns import bound_difference
from scenes.config import LIBRARY
from scenes.pose import Pose
from tests.command_line import arena_here


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


def test_places_outside_the_walls_have_no_bound_where_no_path_comes():
    prepared = bound_map.bound_inputs("l_hall")
    grid = bound_map.plan_grid(prepared, 2.0)
    x, y = np.meshgrid(grid.x_m, grid.y_m)
    outside = (x > 6.5) & (y > 6.5)  # the legs are 6 m wide
    assert outside.any() and not grid.is_free[outside].any()
    assert grid.is_free[(x < 6) | (y < 6)].mean() > 0.9
    open_room = replace(prepared.scene, objects=tuple(o for o in prepared.scene.objects if "inner" not in o.name))
    assert bound_map.within_walls(open_room, np.stack([x, y, 0 * x], axis=-1))[outside].all()


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
    found = signal_bound.along_walk(signal_bound.SignalBounds(campaign))
    assert len(found.position_m) == 4 and 0 < max(found.position_m) < 0.01  # thermal noise alone


@pytest.mark.parametrize("size_m", [(12.0, 9.0), (8.0, 10.0), (40.0, 28.5), (30.0, 2.5), (5.0, 5.0), (90.0, 0.4)])
def test_a_plan_has_at_most_so_many_cells_by_default(size_m):
    prepared = bound_map.bound_inputs("box_room")
    scene = replace(prepared.scene, bounds_m=(0.0, 0.0, *size_m))
    assert bound_map.plan_grid(replace(prepared, scene=scene), n_links=3).is_free.size <= bound_map.MOST_CELLS / 3
    grid = bound_map.plan_grid(replace(prepared, scene=scene))
    assert 0.5 * bound_map.MOST_CELLS < grid.is_free.size <= bound_map.MOST_CELLS
    assert (
        len(grid.x_m) == max(1, round(size_m[0] / grid.step_m))
        and grid.x_m[-1] < size_m[0]
        and grid.y_m[-1] < size_m[1]
    )


def test_both_figures_have_the_same_edge_of_line_of_sight_also_below_the_beams():
    room = tomllib.loads((LIBRARY / "box_room.toml").read_text())
    high = {**room, "tx": {**room["tx"], "position_m": [1.5, 4.0, 2.8]}}
    campaign = ia.load_campaign("box_room", scene=high, waveform={"comb": 12}, propagation={"diffraction": False})
    prepared = bound_map.bound_inputs(campaign)
    model, grid = channel_bound.channel_model(prepared), bound_map.plan_grid(prepared, 2.0)
    position = signal_bound.over_plan(signal_bound.SignalBounds(campaign), [grid])
    channel, fixed = channel_bound.over_plan(model, grid), bound_map.over_plan(prepared, grid)
    tx_m = prepared.scene.tx.position_m
    seen = [
        grid.is_free[place] and not is_hidden(prepared.scene, grid, place, tx_m)
        for place in np.ndindex(grid.is_free.shape)
    ]
    for found in (position, channel, fixed):
        np.testing.assert_array_equal(found.has_los.ravel(), seen)
    assert np.array_equal(np.isnan(position.peb_m), ~grid.is_free)
    near = signal_bound.SignalBounds(campaign).links[0].at(Pose(grid.position_m[0], 0.0))
    assert not all(seen) and seen[0] and not near.truth.paths.is_los.any()  # seen, but far weaker than reflections


def is_hidden(scene, grid, place, tx_m):
    """Whether an object covers a point of the straight line from the TX to a place."""
    row, column = place
    end = np.array([grid.x_m[column], grid.y_m[row], scene.walk.height_m])
    return (scene.object_index_at(tx_m + np.linspace(0.0, 1.0, 2000)[:, None] * (end - tx_m)) >= 0).any()


def test_the_table_says_what_its_rms_counts_and_where_there_is_no_bound():
    stops = StateBound(np.array([0.3, np.inf, 0.4]), np.array([0.1, np.inf, 0.1]), np.array([3.0, np.inf, 3.0]))
    plan = BoundMap(
        np.arange(3.0),
        np.arange(2.0),
        np.array([[1.0, np.inf, np.nan], [1.0, 1.0, np.inf]]),
        np.ones((2, 3), bool),
    )
    table = tables.state_table(stops, plan)
    cells = [list(column.cells) for column in table.columns]
    assert cells[0][0] == "position error bound, stops" and cells[0][3] == "position error bound, plan"
    assert cells[1][:2] == ["0.354", "5.73"] and cells[1][3] == "1" and cells[4] == 4 * ["inf"]
    _, line = tables.about_unbounded([4, 6, 8], stops, plan)
    assert line.startswith("inf: no bound at stop 6 (1 of 3 stops) and 2 of 5 places of the plan (pink): too few")
    whole = replace(plan, peb_m=np.ones((2, 3)))
    assert len(list(tables.about_unbounded([4, 8], StateBound(*np.ones((3, 2))), whole))) == 1
    numbers = json.loads(json.dumps(tables.state_numbers([4, 6, 8], stops, plan), allow_nan=False))
    assert numbers["stops"]["position_m"] == [0.3, None, 0.4] and numbers["stops"]["heading_deg"][
        0
    ] == pytest.approx(5.73, abs=0.01)
    assert numbers["plan"]["position_m"] == [[1.0, None, None], [1.0, 1.0, None]]


@pytest.mark.whole
def test_the_command_says_the_time_to_expect_and_writes_its_numbers(tmp_path):
    result = arena_here(
        "bound", "box_room", "--step", 4, "--out", tmp_path / "b.png", "--json", tmp_path / "b.json"
    )
    assert result.returncode == 0, result.stderr
    assert re.search(r"^\d places over the plan, 4 m apart: about \d+ s \(--step", result.stdout, re.MULTILINE)
    assert "RMS and median: over the stops or places with a bound" in result.stdout
    found = json.loads((tmp_path / "b.json").read_text())
    assert found["campaign"] == "box_room" and len(found["stops"]["clock_ns"]) == 4
    assert (
        len(found["plan"]["position_m"]) == len(found["plan"]["y_m"]) == 2
        and (tmp_path / "b_channel.png").exists()
    )


def test_medians_are_over_the_stops_with_a_bound_as_in_the_scores():
    values = np.array([0.1, 0.3, np.inf, np.inf, np.inf])
    stops = StateBound(values, values, values)
    plan = BoundMap(np.arange(5.0), np.zeros(1), values[None], np.ones((1, 5), bool))
    assert set(tables.state_table(stops, plan).columns[2].cells) == {"0.2", "11.5", "0.667"}  # m, deg, ns
    assert next(tables.about_unbounded(range(5), stops, plan)).count("median") == 1
