"""The chain in space: beams at several elevations, paths with elevations, states and points with heights."""

from pathlib import Path

import numpy as np
import pytest

from estimation.slam.record import SolveStatus
from estimation.slam.space.bounds import SpatialBound
from isac_arena.campaign.directory import open_campaign
from isac_arena.insight.bounds import position as bound_map
from tests.command_line import ROOT
from tests.command_line import arena_here as arena

RX_HEIGHT_M = 1.1


@pytest.mark.slow
def test_a_campaign_with_elevations_has_heights_from_sweep_to_map(tmp_path: Path) -> None:
    scene = (ROOT / "scenes/library/box_room_heights.toml").read_text()
    campaign = (ROOT / "isac_arena/campaign/library/box_room_heights.toml").read_text()
    assert "n_stops = 4" in scene
    (tmp_path / "room.toml").write_text(scene.replace("n_stops = 4", "n_stops = 2"))
    (tmp_path / "run.toml").write_text(campaign.replace('scene = "box_room_heights"', 'scene = "room.toml"'))
    result = arena("run", tmp_path / "run.toml", "--out", tmp_path / "out")
    assert result.returncode == 0, result.stderr
    store = open_campaign(tmp_path / "out")
    found = store.map_result("slam")
    assert found is not None
    assert found.poses.status.tolist() == [SolveStatus.LOS, SolveStatus.LOS]
    for row, stop in enumerate(found.poses.stop.tolist()):
        estimate, truth = store.channel(stop), store.truth(stop)
        assert estimate is not None and truth is not None
        assert np.isfinite(estimate.channel.aoa_elevation_rad).any()
        error = found.poses.position_m[row] - truth.rx_pose.position_m[:2]
        assert np.hypot(*error) < 0.1
    assert np.abs(found.poses.height_m - RX_HEIGHT_M).max() < 0.1
    assert np.all((found.poses.height_std_m > 0) & (found.poses.height_std_m < 0.5))
    inlier = found.ips.is_inlier
    assert np.isfinite(found.ips.height_m[inlier]).all()
    # Walls, floor and ceiling: everything that reflects lies inside the room.
    assert np.mean((found.ips.height_m[inlier] > -0.2) & (found.ips.height_m[inlier] < 3.2)) > 0.9


def test_bounds_of_a_campaign_with_elevations_are_those_in_space() -> None:
    prepared = bound_map.bound_inputs("box_room_heights")
    assert prepared.in_space and not bound_map.bound_inputs("box_room").in_space
    table = bound_map.along_walk(prepared)
    assert "height error bound" in list(table.columns[0].cells)
    place = np.array([4.0, 2.0, RX_HEIGHT_M])
    paths = prepared.solver.paths(place)[0]
    bound = bound_map.place_bound(prepared, place, paths)
    assert isinstance(bound, SpatialBound)
    assert paths.is_los.any() and 0 < bound.height_m < bound.position_m
    grid = bound_map.plan_grid(prepared, 1.7)
    peb = bound_map.over_plan(prepared, grid).peb_m
    assert np.isfinite(peb[grid.is_free]).any()
