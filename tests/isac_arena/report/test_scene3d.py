"""Pictures in space and path lines: what is drawn, and where it is cut off."""

import numpy as np
import pytest

from isac_arena.report.figures.path_lines import N_DRAWN, path_lines, path_summary, scatter_points
from isac_arena.report.figures.plan import plan_figure
from isac_arena.report.figures.scene3d import _clipped, scene_figure
from isac_arena.report.style import png_bytes
from scenes.config import library_scenes, load_scene
from scenes.objects.clutter import Clutter
from scenes.record import concatenate
from sim.config import PropagationConfig
from sim.propagation.paths import BounceKind
from sim.propagation.specular.solver import exact_paths


@pytest.fixture(scope="module")
def room():
    return load_scene("box_room")


@pytest.fixture(scope="module")
def paths(room):
    """Exact paths to stop 1, and one of them taken for a diffuse one too."""
    (exact,) = exact_paths(
        room, room.walk.positions_m()[1:2], 60e9, PropagationConfig(max_bounces=2, diffuse_samples=0)
    )
    single = exact.take("path", np.flatnonzero(exact.n_bounces == 1)[:1])
    kind = single.bounce_kind.copy()
    kind[:, 0] = BounceKind.DIFFUSE
    return concatenate([exact, type(single)(**{**vars(single), "bounce_kind": kind})], "path")


def test_path_lines_run_from_tx_to_rx_weakest_first(room, paths):
    rx = room.walk.positions_m()[1]
    lines = path_lines(paths, room.tx.position_m, rx)
    assert len(lines) == min(len(paths) - 1, N_DRAWN)
    for line in lines:
        np.testing.assert_array_equal(line.points_m[[0, -1]], [room.tx.position_m, rx])
        assert np.isfinite(line.points_m).all()
    opacity = [line.opacity for line in lines]
    assert opacity == sorted(opacity)
    assert lines[-1].kind == "line of sight" and len(lines[-1].points_m) == 2
    assert {len(line.points_m) for line in lines if line.kind == "two reflections"} == {4}
    assert len(scatter_points(paths)) == 1
    assert path_summary(paths) == f"{len(paths) - 1} paths, 1 diffuse"


def test_lines_are_cut_off_at_the_view():
    points = np.array([(-1, 0.5, 0), (2, 0.5, 3), (2, 3, 3), (0.5, 0.5, 0), (0.5, 0.5, 4)], float)
    legs = _clipped(points, (0.0, 0.0, 1.0, 1.0))
    expected = [
        [(0, 0.5, 1), (1, 0.5, 2)], [(0.8, 1, 0.6), (0.5, 0.5, 0)], [(0.5, 0.5, 0), (0.5, 0.5, 4)],
    ]  # fmt: skip
    np.testing.assert_allclose(legs, expected, atol=1e-12)


@pytest.mark.parametrize("name", library_scenes())
def test_every_library_scene_is_drawn_in_space(name):
    figure = scene_figure(load_scene(name))
    assert png_bytes(figure).startswith(b"\x89PNG")
    assert figure.get_suptitle() == name


def test_pictures_name_the_stop_and_the_kinds_of_paths(room, paths):
    mesh = Clutter(
        "crate", "clutter", room.object("box").material,
        [(2, 6, 0), (3, 6, 0), (3, 7, 0), (2, 7, 1)], [(0, 1, 2), (0, 2, 3)],
    )  # fmt: skip
    scene = type(room)(**{**vars(room), "clutter": (mesh,)})
    for draw in (scene_figure, plan_figure):
        figure = draw(scene, extent="all", paths=paths, stop=1)
        png_bytes(figure)
        legend = figure.legends or [figure.axes[0].get_legend()]
        texts = {text.get_text() for text in legend[0].get_texts()}
        assert {"mesh", "line of sight", "one reflection", "diffuse scattering", "RX stop"} <= texts
        title = figure.get_suptitle() or figure.axes[0].get_title()
        assert title == f"box_room, stop 1: {path_summary(paths)}"


def test_the_plan_shows_what_is_not_in_use():
    figure = plan_figure(load_scene("pillar_hall"))
    texts = {text.get_text() for text in figure.axes[0].texts}
    assert {"visitor", "north_east", "TX"} <= texts
