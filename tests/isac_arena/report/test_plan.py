"""The plan figure shows what it is asked for."""

import matplotlib
import numpy as np
import pytest

matplotlib.use("Agg")
import matplotlib.pyplot as plt

from isac_arena.report.figures.plan import draw_plan
from scenes.config import load_scene


@pytest.fixture
def ax():
    figure, axes = plt.subplots(layout="compressed")
    yield axes
    plt.close(figure)


def test_crop_shows_the_walk_and_all_shows_the_bounds(ax):
    scene = load_scene("campus_arena")
    draw_plan(ax, scene)
    (x_min, x_max), (y_min, y_max) = ax.get_xlim(), ax.get_ylim()
    devices = np.vstack([scene.walk.positions_m(), scene.tx.position_m])
    assert x_min < devices[:, 0].min() and devices[:, 0].max() < x_max
    assert y_min < devices[:, 1].min() and devices[:, 1].max() < y_max
    assert x_max - x_min < 25
    assert ax.get_xlabel() == "x in m"
    draw_plan(ax, scene, extent="all", labels=False)
    assert ax.get_xlim()[0] < scene.bounds_m[0] and ax.get_xlim()[1] > scene.bounds_m[2]


def test_chosen_stops_and_object_names(ax):
    scene = load_scene("box_room")
    draw_plan(ax, scene, stops=[0, 2], label_objects=["pillar"])
    marks = next(line for line in ax.lines if line.get_label() == "RX stop")
    np.testing.assert_allclose(marks.get_xydata(), scene.walk.positions_m()[[0, 2], :2])
    assert {"pillar", "TX", "0", "2"} <= {text.get_text() for text in ax.texts}
    legend = {text.get_text() for text in ax.get_legend().get_texts()}
    assert {"wall", "pillar", "box", "RX stop"} <= legend


def test_object_names_cover_neither_each_other_nor_a_stop(ax):
    scene = load_scene("campus_arena")
    ax.figure.set_size_inches(10, 7)
    names = ["pillar_a", "pillar_b", "kiosk", "rail_north", "rail_south", "rail_box", "ring_wall"]
    draw_plan(ax, scene, label_objects=names)
    ax.figure.canvas.draw()
    boxes = [text.get_window_extent() for text in ax.texts if text.get_text() in names]
    assert len(boxes) == len(names)
    stops = ax.transData.transform(scene.walk.positions_m()[:, :2])
    for index, box in enumerate(boxes):
        assert not any(box.overlaps(other) for other in boxes[:index])
        assert not any(box.contains(*stop) for stop in stops)


def test_a_second_record_in_the_same_axes_keeps_the_legend_of_the_first(campaign):
    result = campaign.results.mapping
    axes = result.ips.plot(campaign.scene)
    result.poses.plot(ax=axes)
    named = [text.get_text() for text in axes.get_legend().get_texts()]
    assert {"wall", "pillar", "RX stop", "incidence point", "receiver pose"} <= set(named)
    assert len(named) == len(set(named))
    plt.close("all")
