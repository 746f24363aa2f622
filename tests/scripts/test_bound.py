"""Bounds of a campaign's scene: the map over the plan and the table along the walk."""

import numpy as np

from estimation.report.bound_figure import bound_figure
from estimation.report.style import png_bytes
from estimation.slam.bounds import stop_bound
from scripts import bound_map


def test_bounds_over_the_plan_are_those_of_the_paths_there():
    prepared = bound_map.prepare("box_room")
    bound = bound_map.over_plan(prepared, 0.7)
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
    table = bound_map.along_walk(bound_map.prepare("box_room"))
    assert table.row_count == 4 and len(table.columns) == 4


def test_faces_are_shared_by_the_stops_that_see_them_and_pillars_are_not():
    prepared = bound_map.prepare("box_room")
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
