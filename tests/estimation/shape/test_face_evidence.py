"""What is evidence for the kind of a face: what it scatters, how far it reaches, which paths are specular."""

from dataclasses import replace

import numpy as np
import pytest

from estimation.shape.kinds.fit import OBJECT_KINDS
from estimation.shape.reflection.choice import choose_shape
from estimation.shape.reflection.faces.bends import fit_bend
from estimation.shape.reflection.faces.face import Face, face_choice
from estimation.shape.reflection.faces.points import FacePoints
from estimation.shape.reflection.faces.scattering import FaceLine, ScatteringPoints
from estimation.shape.reflection.normals import oriented_points
from estimation.shape.reflection.reflections import Reflections
from isac_arena.validation.scenarios.reflections import closed_paths
from scenes.contours.smooth import Circle
from tests.estimation.shape.made_paths import BEFORE_WALL, SURE, edge, seen, wall


def face_points(data: Reflections) -> FacePoints:
    return FacePoints(data, oriented_points(data), data.take("path", []), SURE)


def test_scattering_is_evidence_for_the_wall_that_scatters() -> None:
    choice, line = choose_shape(edge(BEFORE_WALL), SURE), FaceLine(np.zeros(2), np.eye(2), np.zeros(2))
    changed = face_choice(choice, Face(line, 0, (), np.zeros(0, int), 1e4), face_points(edge(BEFORE_WALL)))
    assert changed.best_class == "wall" and changed.best.kind == "wall"
    assert sum(changed.class_probability.values()) == pytest.approx(1.0)


def test_the_front_of_a_pillar_scatters_as_a_curved_wall_does() -> None:
    """Points on the pillar are evidence for both, points elsewhere for the wall alone, as with a radius of 3 m."""
    bend = fit_bend(np.arange(5.0), np.zeros(5), np.full(5, 0.01), 0.2)
    line = FaceLine(np.zeros(2), np.eye(2), np.zeros(2), bend=bend)
    for radius_m, on_it, is_pillar in ((0.4, True, True), (0.4, False, False), (3.0, True, False)):
        body = Circle(np.array([1.0, -2.6 - radius_m]), radius_m)
        data = seen(closed_paths(body, np.random.default_rng(6)), 7, 14)
        choice, rows = choose_shape(data, SURE), np.arange(14)
        points = face_points(data if on_it else edge([3.0, -2.0]))
        changed = face_choice(choice, Face(line, 0, (), rows[: len(points.data)], 1e4), points)
        assert (changed.class_probability["pillar"] > 0.5) == is_pillar
        assert changed.class_probability["edge"] == 0
        curved = choice.probability["arc"] + choice.class_probability["pillar"]
        if is_pillar:
            expected = choice.class_probability["pillar"] / curved
            assert changed.class_probability["pillar"] == pytest.approx(expected)


def test_a_wall_that_mirrors_goes_on_far_beyond_what_is_seen_of_it() -> None:
    line = FaceLine(np.zeros(2), np.eye(2), np.array([0.0, 4.0]))
    place = np.array([-1.0, 2.0, 5.0, 12.0])
    grid = np.arange(-2000.0, 2000.0, 0.01)
    for each in (line, line._replace(mirrors=True)):
        even = each.log_density(place, 1.0)
        assert even[0] == pytest.approx(even[2])
        assert np.exp(each.log_density(grid, 1.0)).sum() * 0.01 == pytest.approx(1.0, abs=1e-3)
    assert line._replace(mirrors=True).log_density(place, 1.0)[3] > line.log_density(place, 1.0)[3] + 20


def test_a_specular_path_is_rather_mirrored_and_a_diffuse_one_rather_scattered() -> None:
    """The evidence of a contour, and that of places about a point, change by what is known of every path."""
    data = wall()
    config, rows = SURE.model_copy(update={"ghost_share": 1e-12}), np.arange(len(data))
    known = [replace(data, specular_probability=np.full(len(data), each)) for each in (0.5, 0.8, 0.2)]
    mirrored = [OBJECT_KINDS["wall"].optimum(each, config).log_evidence for each in known]
    about = [ScatteringPoints.of(oriented_points(each), each).about_one(rows, config) for each in known]
    change = len(data) * np.log([1.0, 1.6, 0.4])
    np.testing.assert_allclose(np.diff(mirrored, prepend=mirrored[0]).cumsum(), change, atol=1e-6)
    np.testing.assert_allclose(np.diff(about, prepend=about[0]).cumsum(), change[[0, 2, 1]], atol=1e-6)
