"""Paths off a wall, an edge or a pillar, observed with errors: the data of the tests of faces."""

import numpy as np

from estimation.shape.config import ReflectionConfig
from estimation.shape.reflection.reflections import Reflections
from isac_arena.validation.scenarios.reflections import Errors, TruePaths, edge_paths, observe, wall_paths

SURE = ReflectionConfig(delay_offset_std_ns=0.0, aod_offset_std_deg=0.0, aoa_offset_std_deg=0.0)
WALL_ENDS = np.array([[-8.0, -6.0], [9.0, -6.0]])
IN_WALL, BEFORE_WALL = [6.0, -6.02], [2.0, -5.0]


def seen(true: TruePaths, seed: int, n: int) -> Reflections:
    data, _ = observe(true, Errors(0.5), np.random.default_rng(seed))
    return data.take("path", np.linspace(0, len(data) - 1, min(n, len(data))).astype(int))


def wall() -> Reflections:
    return seen(wall_paths(WALL_ENDS, np.random.default_rng(2)), 3, 20)


def edge(at: list[float]) -> Reflections:
    return seen(edge_paths(np.array(at), np.random.default_rng(4)), 5, 12)
