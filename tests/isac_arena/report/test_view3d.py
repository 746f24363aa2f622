"""The 3-D view: what stands in it is what the records say, and it comes up in a real browser in silence."""

from __future__ import annotations

import json
import re
import time
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from isac_arena.report.figures.bands import contour_curve
from isac_arena.report.figures.path_lines import COLORS, DASHES, path_lines
from isac_arena.report.view.page import estimated_ways, view_page
from isac_arena.report.view.traces import (
    WIDTHS,
    body_traces,
    contour_traces,
    coordinates,
    frame_axes,
    join_lines,
    ray_traces,
)
from scenes.config import load_scene


def points(trace: dict[str, Any]) -> np.ndarray:
    return np.array([trace[name] for name in "xyz"], float).T


@pytest.fixture(scope="module")
def page(campaign: Any) -> str:
    scene = campaign.scene
    lines = [path_lines(one.paths, scene.tx.position_m, one.rx_pose.position_m) for one in campaign.truths]
    return view_page("a <b>", scene, campaign.results, lines, 3, {"TX": scene.tx})


def test_bodies_are_closed_meshes_of_their_own_height():
    scene = load_scene("box_room")
    traces = {trace["name"]: trace for trace in body_traces(scene)}
    assert set(traces) == {"wall", "pillar", "box", "floor", "ceiling"}
    pillar, item = traces["pillar"], scene.object("pillar")
    corners = points(pillar)
    assert corners[:, 2].min() == item.z_min_m and corners[:, 2].max() == item.z_max_m
    faces = np.array([pillar[name] for name in "ijk"]).T
    assert faces.max() < len(corners) and set(pillar["text"]) == {"pillar"}
    edges = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    places = np.unique(corners, axis=0, return_inverse=True)[1].ravel()
    counts = np.unique(np.sort(places[edges], axis=1), axis=0, return_counts=True)[1]
    assert (counts == 2).all()  # every edge borders two faces
    assert traces["ceiling"]["visible"] == "legendonly"


def test_rays_keep_their_corners_and_part_at_gaps(campaign):
    truth, tx = campaign.truths[2], campaign.scene.tx.position_m
    lines = path_lines(truth.paths, tx, truth.rx_pose.position_m)
    traces = {trace["name"]: trace for trace in ray_traces(lines)}
    assert list(traces) == list(COLORS) == list(WIDTHS)
    single = points(traces["one reflection"])
    assert np.isnan(single).all(axis=1).sum() == 4 and len(single) == 4 * 4
    expected = {tuple(np.round(row, 3)) for row in truth.paths.vertex_m[1:5, 0]}
    assert {tuple(row) for row in single[1::4]} == expected
    np.testing.assert_allclose(points(traces["line of sight"])[:2], [tx, truth.rx_pose.position_m], atol=6e-4)


def test_kinds_of_paths_differ_in_more_than_colour():
    looks = [(COLORS[kind], DASHES[kind]) for kind in COLORS]
    assert len({color for color, _ in looks}) == len(COLORS)
    alike = [kind for kind in COLORS if not DASHES[kind]]
    assert alike == ["line of sight", "one reflection"]  # black and blue tell these apart in grey too
    assert len(set(WIDTHS.values())) == len(WIDTHS)


def test_rays_in_space_are_whole_lines():
    """A dashed line of two reflections reads as fragments that hang in the air."""
    assert not any("dash" in trace["line"] for trace in ray_traces([]))


def test_an_axis_points_along_the_heading():
    axes = frame_axes(np.pi / 2)
    np.testing.assert_allclose(axes, [[0, 1, 0], [-1, 0, 0], [0, 0, 1]], atol=1e-12)


def test_estimated_ways_meet_their_point_on_a_level_way(campaign):
    result, tx = campaign.results.mapping, np.array([2.0, 2.0, 1.0])
    rx = np.array([0.0, -1.5, 3.0])
    ways = estimated_ways(result, tx[None], rx, 5)
    assert len(ways) == 4
    for way, row in zip(ways, np.flatnonzero(result.ips.stop == 5), strict=True):
        np.testing.assert_array_equal(way[[0, 2]], [tx, rx])
        np.testing.assert_array_equal(way[1, :2], result.ips.position_m[row])
        lengths = np.linalg.norm(np.diff(way[:, :2], axis=0), axis=1)
        assert way[1, 2] == pytest.approx(1.0 + 2.0 * lengths[0] / lengths.sum())
    known = replace(result.ips, height_m=np.full(len(result.ips), 1.25))
    assert all(way[1, 2] == 1.25 for way in estimated_ways(replace(result, ips=known), tx[None], rx, 5))


def test_contours_stand_upright_with_their_bands(campaign):
    contours = campaign.results.mapping.contours
    sheet, band = contour_traces([contour_curve(contours, 0), contour_curve(contours, 2)], "ours", "#000", (0, 2))
    corners = points(sheet)
    assert set(corners[:, 2]) == {0.0, 2.0} and len(corners) == 2 * (181 + 180)
    assert len(sheet["i"]) == 2 * (180 + 179)
    assert np.nanmax(np.abs(points(band)[:, 2] - 2.0)) == 0


def test_nothing_to_draw_is_no_line():
    assert coordinates(join_lines([])) == {"x": [], "y": [], "z": []}


def test_the_page_stands_by_itself(page, campaign):
    assert "<title>a &lt;b&gt;: 3-D view</title>" in page
    assert "default-src 'none'" in page and not re.search(r'<(?:script|link|img)[^>]*(?:src|href)="http', page)
    assert len(page) < 15e6
    steps = json.loads(re.search(r'"sliders":(\[.*?\}\]\}\])', page)[1])[0]["steps"]
    assert [step["label"] for step in steps] == [str(stop) for stop in range(12)]
    with pytest.raises(ValueError, match="stop = 12: the campaign has stops 0 to 11"):
        view_page("x", campaign.scene, campaign.results, [], 12, {})


def test_a_measured_campaign_shows_estimated_ways_alone(campaign):
    page = view_page("x", campaign.scene, campaign.results, [[]] * 12, 0, {"TX": campaign.scene.tx})
    assert "estimated, mapping" in page


def test_it_comes_up_in_a_browser_and_the_slider_changes_the_stop(tab, page, folder):
    path = folder / "view.html"
    path.write_text(page, encoding="utf-8")
    tab.show(path)
    state = "(() => { const view = document.querySelector('#view'); return [view.layout.sliders[0].active,"
    state += " view.data.find(one => one.name === 'line of sight').x[1]]; })()"
    stop, rx_x = tab.evaluate(state)
    assert stop == 3 and rx_x == pytest.approx(-1.5 + 7.5 * 3 / 11, abs=1e-3)
    assert tab.count("#view canvas") >= 1
    rail = "(() => { const b = document.querySelector('.slider-rail-touch-rect').getBoundingClientRect();"
    x, y, width = tab.evaluate(rail + " return [b.x, b.y + b.height / 2, b.width]; })()")
    tab.press(x + 0.98 * width, y)
    until = time.monotonic() + 20
    while tab.evaluate(state)[0] == 3 and time.monotonic() < until:
        time.sleep(0.1)
    stop, rx_x = tab.evaluate(state)
    assert stop == 11 and rx_x == pytest.approx(6.0, abs=1e-3)
    assert tab.is_silent()
