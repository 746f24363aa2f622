"""Random arenas: valid for every seed, the same for the same one, fuller where they are difficult."""

from itertools import combinations

import numpy as np
import pytest
import shapely

from scenes.meshes.mesh import object_meshes
from scenes.random_arena import CLEARANCE_M, random_arena

DIFFICULTIES = (0.0, 0.3, 0.7, 1.0)


def arena(seed):
    return random_arena(np.random.default_rng(seed), DIFFICULTIES[seed % 4])


def check(seed):
    """Brute force over dense outlines: objects, stops and TX keep their distance."""
    scene = arena(seed)
    inside = scene.objects[4:]
    outlines = [shapely.MultiPoint(item.contour.sample(0.02)) for item in scene.objects]
    for first, second in combinations(outlines[4:], 2):
        assert first.distance(second) >= CLEARANCE_M - 0.002
    for item, outline in zip(inside, outlines[4:], strict=True):
        for wall in outlines[:4]:
            assert wall.distance(outline) >= CLEARANCE_M - 0.002, item.name
    devices = np.vstack([scene.tx.position_m, scene.walk.positions_m()])
    for item in scene.objects:
        assert item.contour.signed_distance(devices[:, :2]).min() >= CLEARANCE_M - 0.002, item.name
    x_min, y_min, x_max, y_max = scene.bounds_m
    assert ((devices[:, :2] > (x_min, y_min)) & (devices[:, :2] < (x_max, y_max))).all()
    assert len(scene.stops) == 10


@pytest.mark.parametrize("seed", range(24))
def test_arenas_are_valid(seed):
    check(seed)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(24, 200))
def test_more_arenas_are_valid(seed):
    check(seed)


def test_a_walk_that_ends_in_a_corner_starts_elsewhere():
    rng = np.random.default_rng([1, 1, 44])
    assert len(random_arena(rng, rng.uniform(0.0, 0.1), 100).stops) == 100


def test_same_seed_same_bits_and_others_differ():
    first, second, other = arena(3), arena(3), arena(7)
    assert first.tx.position_m.tobytes() == second.tx.position_m.tobytes() != other.tx.position_m.tobytes()
    assert first.walk.waypoints_m.tobytes() == second.walk.waypoints_m.tobytes()
    for a, b in zip(first.objects, second.objects, strict=True):
        assert a.name == b.name and a.contour.sample(0.1).tobytes() == b.contour.sample(0.1).tobytes()


def test_difficulty_adds_objects_of_all_shapes():
    n_objects, shapes = {}, set()
    for difficulty in (0.0, 0.4, 1.0):
        scenes = [random_arena(np.random.default_rng(seed), difficulty) for seed in range(5)]
        n_objects[difficulty] = np.mean([len(scene.objects) for scene in scenes])
        shapes |= {type(item.contour).__name__ for scene in scenes for item in scene.objects}
    assert n_objects[0.0] == 5 < n_objects[0.4] < n_objects[1.0]
    assert shapes == {"Circle", "Ellipse", "Polygon", "RoundedPolygon", "ClosedSpline", "Polyline"}


def test_an_arena_meshes_and_a_bad_difficulty_is_refused():
    scene = arena(2)
    assert {part.object_name for part in object_meshes(scene)} == {*scene.object_names, "floor", "ceiling"}
    with pytest.raises(ValueError, match=r"difficulty = 1\.5: must lie in \[0, 1\]"):
        random_arena(np.random.default_rng(0), 1.5)
