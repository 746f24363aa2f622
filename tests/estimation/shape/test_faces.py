"""Scattering places of a rough wall are parts of it, what it mirrors is no object, and others near it stand."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import quad_vec
from scipy.stats import multivariate_normal

from estimation.laws.plane import bounce, residual
from estimation.shape.kinds.fit import OBJECT_KINDS, fit_kind
from estimation.shape.kinds.mirror_wall import longer_wall, scattering_wall
from estimation.shape.reflection.choice import choose_shape
from estimation.shape.reflection.faces import scattering
from estimation.shape.reflection.faces.bends import fit_bend
from estimation.shape.reflection.faces.face import Face, part_walls
from estimation.shape.reflection.faces.find import FaceSearch
from estimation.shape.reflection.faces.parts import seen_parts
from estimation.shape.reflection.faces.scattering import FaceLine, ScatteringPoints, along_face, scattering_places
from estimation.shape.reflection.normals import oriented_points
from estimation.shape.reflection.objects import FoundObject
from estimation.shape.reflection.reflections import Reflections
from isac_arena.validation.scenarios.reflections import (
    Errors,
    closed_paths,
    edge_paths,
    observe_together,
    wall_paths,
)
from scenes.contours.smooth import Circle
from scenes.record import concatenate
from tests.estimation.shape.made_paths import BEFORE_WALL, IN_WALL, SURE, WALL_ENDS, edge, seen, wall


def scattered(places_m: np.ndarray, offset_m: float) -> Reflections:
    """One path by way of each place along the wall, that far in front of it, from places along the walk."""
    rng = np.random.default_rng(9)
    parts = [
        seen(edge_paths(np.array([x, -6.0 + offset_m]), rng), 20 + k, len(places_m))
        for k, x in enumerate(places_m)
    ]
    return concatenate([part.take("path", [min(k, len(part) - 1)]) for k, part in enumerate(parts)], "path")


def search(*parts: tuple[str, Reflections], free: Reflections | None = None) -> FaceSearch:
    """The search over objects of given kinds, and paths of no object."""
    objects, first = [], 0
    for kind, part in parts:
        optimum = OBJECT_KINDS[kind].optimum(part, SURE)
        assert optimum is not None
        objects.append(FoundObject(kind, optimum, np.arange(first, first + len(part))))
        first += len(part)
    data = concatenate([*(part for _, part in parts), *([] if free is None else [free])], "path")
    return FaceSearch(objects, data, data.take("path", []), SURE)


def test_point_on_the_line_of_a_wall_belongs_to_it_and_one_before_it_stands() -> None:
    found = search(("wall", wall()), ("edge", edge(IN_WALL)), ("edge", edge(BEFORE_WALL)))
    faces = found.run()
    assert [(face.mirror, face.objects) for face in faces] == [(0, (1,))]
    assert found.standing(faces) == [0, 2]
    assert faces[0].gain > 0


def test_places_along_a_wall_belong_to_it_and_the_same_before_it_do_not() -> None:
    places = np.linspace(3.0, 3.8, 9)
    for offset, expected in ((0.0, (1,)), (0.6, ())):
        (face,) = search(("wall", wall()), ("edge", scattered(places, offset))).run()[:1]
        assert face.objects == expected


def test_paths_of_no_object_near_the_seen_part_of_a_wall_belong_to_it() -> None:
    on = scattered(np.linspace(0.0, 4.0, 9), 0.0)
    (face,) = search(("wall", wall()), free=on).run()
    assert len(face.scattered) >= 7
    (face,) = search(("wall", wall()), free=scattered(np.linspace(0.0, 4.0, 9), 1.5)).run()
    assert len(face.scattered) == 0


def test_places_on_a_line_are_a_wall_that_mirrors_nothing() -> None:
    patches = [("edge", scattered(x + np.linspace(-0.3, 0.3, 8), 0.0)) for x in (0.0, 1.5, 3.0)]
    found = search(*patches)
    (face,) = found.run()
    assert face.mirror == -1 and face.objects == (0, 1, 2)
    assert found.standing([face]) == []
    ((shape, _),) = part_walls(face, face.scattered, found.points)
    assert shape.kind == "wall"
    np.testing.assert_allclose(shape.contour_m[:, 1], -6.0, atol=0.15)
    assert np.ptp(shape.contour_m[:, 0]) == pytest.approx(3.6, abs=0.4)
    assert face.class_probability[0] > 0.99


def test_a_wall_has_a_gap_where_another_is_seen_through_it() -> None:
    rng, door_ends = np.random.default_rng(2), np.array([[1.0, -6.11], [3.0, -6.11]])
    (whole, door), _ = observe_together(
        [wall_paths(ends, rng) for ends in (WALL_ENDS, door_ends)], Errors(0.05), rng
    )
    beside = whole.take("path", ~np.isin(whole.stop, door.stop))
    for of_wall, free, n in ((whole, door.take("path", []), 1), (beside, door, 2)):
        found = search(("wall", of_wall), free=free)
        (face,) = found.run()
        walls = part_walls(face, np.arange(len(of_wall)), found.points, fit_kind(of_wall, "wall", SURE))
        assert len(walls) == n
        assert sorted(np.concatenate([rows for _, rows in walls])) == list(range(len(of_wall)))
        is_before_door = [np.any(np.abs(each.contour_m[:, 0] - 2.0) < 0.5) for each, _ in walls]
        assert any(is_before_door) == (n == 1)


def test_what_is_seen_through_a_gap_is_not_hidden() -> None:
    behind = seen(closed_paths(Circle(np.array([1.0, -8.0]), 0.4), np.random.default_rng(4)), 5, 9)
    found = search(("wall", wall()), ("circle", behind))
    (face,) = found.run()
    assert found.standing([face]) == [0]
    _, met = found.points.crossings(face.line, found.objects[1].paths)
    open_face = replace(
        face, parts_m=np.array([[met.min() - 5, met.min() - 0.1], [met.max() + 0.1, met.max() + 5]])
    )
    assert found.standing([open_face]) == [0, 1]


def test_places_on_a_curve_are_one_curved_wall() -> None:
    around = Circle(np.array([1.0, -11.0]), 5.0)
    angles = np.deg2rad(np.linspace(55.0, 125.0, 8))
    rng, patches = np.random.default_rng(9), []
    for k, angle in enumerate(angles):
        spots = around.center_m + 5.0 * np.column_stack(
            [np.cos(angle + 0.01 * np.arange(8)), np.sin(angle + 0.01 * np.arange(8))]
        )
        parts = [seen(edge_paths(spot, rng), 20 + 8 * k + j, 8) for j, spot in enumerate(spots)]
        patches.append(
            (
                "edge",
                concatenate([part.take("path", [min(j, len(part) - 1)]) for j, part in enumerate(parts)], "path"),
            )
        )
    found = search(*patches)
    (face,) = found.run()
    ((shape, rows),) = part_walls(face, face.scattered, found.points)
    assert shape.kind == "depth_line" and len(rows) > 50
    away = np.hypot(*(shape.contour_m - around.center_m).T) - 5.0
    assert np.sqrt(np.mean(away**2)) < 0.05
    assert np.mean(np.abs(away) < 1.96 * shape.std_m) > 0.8
    assert shape.extent_m == pytest.approx(5.0 * np.ptp(angles), rel=0.1)


def test_one_place_shows_no_line() -> None:
    assert search(("edge", scattered(np.linspace(2.7, 3.3, 8), 0.0))).run() == []


def test_what_a_wall_mirrors_is_hidden_and_a_pillar_before_it_stands() -> None:
    behind = seen(closed_paths(Circle(np.array([1.0, -8.0]), 0.4), np.random.default_rng(4)), 5, 9)
    before = seen(closed_paths(Circle(np.array([1.0, -4.0]), 0.4), np.random.default_rng(4)), 5, 9)
    for pillar, expected in ((behind, [0]), (before, [0, 1])):
        found = search(("wall", wall()), ("circle", pillar))
        assert found.standing(found.run()) == expected


def pillar(y: float) -> Reflections:
    return seen(closed_paths(Circle(np.array([4.0, y]), 0.4), np.random.default_rng(6)), 7, 15)


def test_a_pillar_that_touches_a_wall_from_behind_is_a_patch_of_it() -> None:
    for y, expected in ((-6.4, (1,)), (-6.1, ()), (-5.4, ())):
        found = search(("wall", wall()), ("circle", pillar(y)))
        faces = found.run()
        assert faces[0].objects == expected
        assert found.standing(faces) == ([0] if expected else [0, 1])


def test_an_edge_on_a_pillar_is_part_of_it_and_one_beside_it_stands() -> None:
    for x, expected in ((4.4, [0]), (4.0, [0]), (5.2, [0, 1])):
        found = search(("circle", pillar(-3.0)), ("edge", edge([x, -3.0])))
        assert found.standing([]) == expected


def test_scattering_places_about_a_point_are_no_object() -> None:
    rng = np.random.default_rng(5)
    blob = [seen(edge_paths(np.array(BEFORE_WALL) + rng.normal(0, 0.5, 2), rng), 30 + k, 12) for k in range(12)]
    data = concatenate([part.take("path", [k]) for k, part in enumerate(blob)], "path")
    found = search(("edge", data), ("edge", edge(BEFORE_WALL)))
    assert found.standing([]) == [1]


def test_no_path_has_no_face() -> None:
    none = wall().take("path", [])
    found = FaceSearch([], none, none, SURE)
    assert found.run() == [] and found.standing([]) == []


def test_a_bend_is_evident_on_a_curve_only() -> None:
    rng, place = np.random.default_rng(3), np.linspace(0.0, 4.0, 40)
    noise = rng.normal(0, 0.04, 40)
    straight = fit_bend(place, 0.1 * place + noise, np.full(40, 0.04**2), 0.2)
    assert straight.gain < 0
    curve = 5.0 - np.sqrt(25.0 - (place - 2.0) ** 2)
    bend = fit_bend(place, curve + noise, np.full(40, 0.04**2), 0.2)
    assert bend.gain > 10
    np.testing.assert_allclose(np.interp(place, bend.place_m, bend.depth_m), curve, atol=0.04)
    beyond = np.interp([2.0, 5.5], bend.place_m, bend.variance_m2)
    assert beyond[1] > 10 * beyond[0]


NO_EVENT = np.zeros(0)


@pytest.mark.parametrize(
    ("places", "against_m", "expected"),
    [
        (np.linspace(0, 4, 30), NO_EVENT, [[0.0, 4.0]]),
        (np.append(np.linspace(0, 2, 15), np.linspace(6, 8, 15)), NO_EVENT, [[0.0, 2.0], [6.0, 8.0]]),
        (np.append(np.linspace(0, 2, 15), [6.0, 6.1]), NO_EVENT, [[0.0, 2.0]]),
        (np.append(np.linspace(0, 2, 15), np.linspace(2.6, 4, 15)), NO_EVENT, [[0.0, 4.0]]),
        (np.append(np.linspace(0, 2, 15), np.linspace(2.6, 4, 15)), np.full(5, 2.3), [[0.0, 2.0], [2.6, 4.0]]),
        (np.array([3.0]), NO_EVENT, [[3.0, 3.0]]),
    ],
    ids=["even", "long gap", "few beyond", "short gap", "seen through", "one"],
)
def test_parts_end_where_paths_are_missing_or_contradict(
    places: np.ndarray, against_m: np.ndarray, expected: list[list[float]]
) -> None:
    parts = seen_parts(places, np.full(len(places), 3.0), against_m, np.full(len(against_m), 2.9), 0.4)
    np.testing.assert_allclose(parts, expected)


def test_a_gap_costs_the_paths_within_it() -> None:
    places, against_m = np.linspace(0, 4, 81), np.linspace(1.8, 2.2, 6)
    for weight, n in ((1.0, 2), (20.0, 1)):
        assert len(seen_parts(places, np.full(81, weight), against_m, np.full(6, 2.9), 0.4)) == n


def test_walls_are_seen_as_far_as_they_mirror_and_scatter() -> None:
    shape = choose_shape(wall(), SURE).fits["wall"]
    first, last = shape.parameter[2:]
    longer = longer_wall(shape, np.array([first - 2.0, last - 0.1]), np.array([0.01, 0.02]))
    np.testing.assert_allclose(longer.parameter, [*shape.parameter[:2], first - 2.0, last])
    assert longer.extent_m == pytest.approx(shape.extent_m + 2.0)
    assert longer.parameter_covariance[2, 2] == pytest.approx(0.01)
    assert longer.parameter_covariance[3, 3] == shape.parameter_covariance[3, 3]
    own = scattering_wall(shape.parameter[:2], np.diag([1e-4, 1e-4]), np.array([1.0, 4.0, 2.0]), np.full(3, 0.01))
    assert own.extent_m == 3.0


def test_a_wall_ends_where_a_line_of_sight_passes_also_if_paths_are_mirrored_beyond() -> None:
    data = wall()
    found = search(("wall", data))
    (face,) = found.run()
    mirrored, rows = choose_shape(data, SURE).fits["wall"], np.arange(len(data))
    places = found.points.places_m(face.line, rows)
    middle = float(np.median(places))
    [(shape, own)] = part_walls(
        replace(face, line=face.line._replace(between_m=(-np.inf, middle))), rows, found.points, mirrored
    )
    assert mirrored.extent_m > 1.5 * shape.extent_m and 0 < len(own) < len(rows)
    assert places[own].max() < middle
    [(whole, own)] = part_walls(face, rows, found.points, mirrored)
    assert whole.extent_m >= mirrored.extent_m and len(own) == len(rows)


def test_evidence_along_a_face_is_the_integral_over_the_places(monkeypatch: pytest.MonkeyPatch) -> None:
    shape = choose_shape(wall(), SURE).fits["wall"]
    line = FaceLine(shape.parameter[:2], shape.parameter_covariance[:2, :2], shape.parameter[2:])
    data, spread = scattered(np.array([2.0, 2.3, 2.7]), 0.01), 0.2
    monkeypatch.setattr(scattering, "_SPREADS_M", (spread,))
    offset = line.parameter[1]

    def density(place_m: float, path: int) -> float:
        predicted = bounce(data.tx[path], data.rx_state[path], offset * line.normal + place_m * line.tangent)
        across = predicted.by_landmark @ line.normal
        covariance = data.covariance[path] + predicted.by_state @ data.rx_covariance[path] @ predicted.by_state.T
        covariance += line.variance_m2(np.array(place_m), SURE.wall_relief_m) * np.outer(across, across)
        error = residual(data.measured[path], predicted.value)
        return float(multivariate_normal(np.zeros(3), covariance).pdf(error))

    foot = (data.rx_state[:, :2].mean(axis=0)) @ line.tangent
    places = np.linspace(foot - 12, foot + 12, 24_001)
    likely = np.array([[density(place, path) for place in places[::4]] for path in range(3)])

    def integrand(middle: float) -> float:
        normal = np.exp(-0.5 * ((places[::4] - middle) / spread) ** 2) / np.sqrt(2 * np.pi) / spread
        of_paths = (likely * normal).sum(axis=1) * (places[4] - places[0])
        return float(np.exp(line.log_density(np.array(middle), scattering.OBJECT_REACH_M)) * of_paths.prod())

    best = float(places[::4][likely.sum(axis=0).argmax()])
    whole, _ = quad_vec(integrand, best - 3, best + 3, epsrel=1e-4)
    expected = np.log(whole) + 3 * SURE.log_path_share
    evidence, near = along_face(line, scattering_places(line, data, SURE), SURE)
    assert evidence == pytest.approx(expected, abs=0.1)
    assert near.all()


def test_evidence_about_a_point_is_the_integral_over_the_points(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of one path: the place is uniform over the area, whatever the spread."""
    data = edge(BEFORE_WALL).take("path", [0])
    points = ScatteringPoints.of(oriented_points(data), data)
    x, y = np.meshgrid(*(at + np.linspace(-1.5, 1.5, 601) for at in points.points.position_m[0]))
    place = np.column_stack([x.ravel(), y.ravel()])
    many = [np.repeat(part, len(place), axis=0) for part in (data.tx, data.rx_state)]
    predicted = bounce(*many, place)
    covariance = data.covariance[0] + predicted.by_state @ data.rx_covariance[0] @ np.swapaxes(
        predicted.by_state, 1, 2
    )
    error = residual(np.repeat(data.measured, len(place), axis=0), predicted.value)
    square = np.einsum("na,nab,nb->n", error, np.linalg.inv(covariance), error)
    density = np.exp(-0.5 * (square + np.linalg.slogdet(2 * np.pi * covariance)[1]))
    expected = np.log(density.sum() * 0.005**2 / SURE.area_m2) + SURE.log_path_share
    assert points.about_one(np.array([0]), SURE) == pytest.approx(expected, abs=0.05)


def test_a_bent_line_far_from_all_points_explains_nothing() -> None:
    found = search(("edge", edge(IN_WALL)), ("edge", edge(BEFORE_WALL)))
    rows, none = found.objects[0].paths, np.zeros(0, int)
    line = found.points.bent(found.points.most_crowded(rows, rows), rows, none)
    face = found._grown(line._replace(parameter=line.parameter + np.array([0.0, 40.0])))
    assert face.objects == () and not len(face.scattered)


def test_two_corners_without_a_scattered_path_show_no_line() -> None:
    found = search(("edge", edge(IN_WALL)), ("edge", edge(BEFORE_WALL)))
    rows = found.objects[0].paths
    corners = Face(found.points.most_crowded(rows, rows), -1, (0, 1), np.zeros(0, int), 9.0)
    assert found._curved(corners) is corners
