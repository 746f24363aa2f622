"""Merged clusters are split by the reflection law, ghosts are unassigned."""

from dataclasses import replace

import numpy as np

from estimation.shape.reflection.association import GHOST, GroupFits, split_cluster
from estimation.shape.reflection.objects import refit_objects
from isac_arena.validation.scenarios.reflections import Errors, closed_paths, edge_paths, observe, wall_paths
from scenes.contours.smooth import Circle
from scenes.record import concatenate
from tests.estimation.shape.made_paths import SURE, seen, wall

RAIL = np.array([[-6.0, -5.6], [0.6, -5.4]])
PILLAR = Circle(np.array([1.0, -5.4]), 0.4)


def test_pillar_that_touches_a_rail_is_split_off() -> None:
    rng = np.random.default_rng(2)
    parts = [
        seen(closed_paths(PILLAR, rng), 3, 25),
        seen(wall_paths(RAIL, rng), 4, 20),
        seen(edge_paths(np.array([3.0, -5.0]), rng), 5, 12),
    ]
    truth = np.repeat(np.arange(3), [len(part) for part in parts])
    found = split_cluster(concatenate(parts, "path"), SURE)
    assert sorted(found.kind) == ["circle", "edge", "wall"]
    for number, kind in enumerate(("circle", "wall", "edge")):
        agree = found.label[truth == number] == found.kind.index(kind)
        assert agree.mean() > 0.85


def test_ghosts_belong_to_no_object() -> None:
    rng = np.random.default_rng(6)
    data, is_ghost = observe(closed_paths(PILLAR, rng), Errors(0.3, ghost_share=0.3), rng)
    found = split_cluster(data, SURE)
    assert found.kind == ("circle",)
    assert np.mean((found.label == GHOST) == is_ghost) > 0.9


def test_nothing_but_ghosts_is_no_object() -> None:
    rng = np.random.default_rng(7)
    data, _ = observe(closed_paths(PILLAR, rng), Errors(0.1, ghost_share=1.0), rng)
    found = split_cluster(data.take("path", slice(0, 8)), SURE)
    assert found.kind == ()
    assert np.all(found.label == GHOST)
    assert split_cluster(data.take("path", []), SURE).kind == ()


def test_of_two_paths_of_a_stop_the_precise_one_is_that_of_an_object() -> None:
    """Vague paths agree as well with a wall, by way of the floor or diffuse: they are not taken for its own."""
    precise = wall()
    vague = replace(precise, covariance=400 * precise.covariance)
    data = concatenate([vague, precise], "path")
    own = np.arange(len(precise), 2 * len(precise))
    (found,) = refit_objects(GroupFits(data, SURE), [own], 4)
    assert found.kind == "wall"
    np.testing.assert_array_equal(found.paths, own)
