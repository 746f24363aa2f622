"""Merged clusters are split by the reflection law, ghosts are unassigned."""

import numpy as np

from estimation.shape.config import ReflectionConfig
from estimation.shape.reflection.association import GHOST, split_cluster
from estimation.shape.reflection.reflections import Reflections
from isac_arena.validation.scenarios.reflections import (
    Errors,
    TruePaths,
    closed_paths,
    edge_paths,
    observe,
    wall_paths,
)
from scenes.contours.smooth import Circle
from scenes.record import concatenate

SURE = ReflectionConfig(delay_offset_std_ns=0.0, aod_offset_std_deg=0.0, aoa_offset_std_deg=0.0)
RAIL = np.array([[-6.0, -5.6], [0.6, -5.4]])
PILLAR = Circle(np.array([1.0, -5.4]), 0.4)


def seen(true: TruePaths, seed: int, n: int) -> Reflections:
    data, _ = observe(true, Errors(0.5), np.random.default_rng(seed))
    return data.take("path", np.linspace(0, len(data) - 1, min(n, len(data))).astype(int))


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
