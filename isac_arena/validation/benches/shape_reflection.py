"""`arena bench shape`: the fits by the reflection law, in processor time of one thread."""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial

import numpy as np

from estimation.shape.kinds.closed import fit_direct
from estimation.shape.kinds.mirror_wall import fit_mirror_wall
from estimation.shape.reflection.bundle import fit_bundle
from estimation.shape.reflection.reflections import ReflectionConfig
from isac_arena.validation.measurement import Measurement, at_most
from isac_arena.validation.scenarios.reflections import Errors
from isac_arena.validation.shape.reflection import OFFSET_ERRORS, made_campaign, made_pillar, made_wall

N_REPEATS = 7


def bench_reflection_fits(seed: int, quick: bool) -> list[Measurement]:
    """Median over random objects, offsets unknown, at 1 ns and 1 deg: circle, wall, and three pillars at once."""
    n, config = (5, ReflectionConfig()) if quick else (40, ReflectionConfig())
    pillars = [made_pillar(np.random.default_rng([seed, k]), OFFSET_ERRORS) for k in range(n)]
    walls = [made_wall(np.random.default_rng([seed, k]), Errors()) for k in range(n)]
    circle = [_least_time_ms(partial(fit_direct, data, "circle", config)) for data in pillars]
    wall = [_least_time_ms(partial(fit_mirror_wall, data, config)) for data in walls]
    campaigns = [made_campaign(np.random.default_rng([seed, k])) for k in range(2 if quick else 8)]
    bundle = [_least_time_ms(partial(fit_bundle, objects, los, config)) for objects, los in campaigns]
    return [
        at_most("reflection.circle.time_ms", np.median(circle), 4.0, "all starts", "ms"),
        at_most("reflection.wall.time_ms", np.median(wall), 1.0, "all starts", "ms"),
        at_most("reflection.bundle.time_ms", np.median(bundle), 60.0, "3 pillars, 45 stops", "ms"),
    ]


def _least_time_ms(action: Callable[[], object]) -> float:
    """Least processor time of a few runs, the first one left out: it may compile."""
    action()
    spent = []
    for _ in range(N_REPEATS):
        started = time.process_time()
        action()
        spent.append(time.process_time() - started)
    return 1e3 * min(spent)
