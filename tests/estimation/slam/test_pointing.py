"""Errors that all paths of a campaign share: arrays that point wrong, and stops that leap from their walk."""

from dataclasses import replace

import numpy as np
import pytest

from estimation.channel.correlation import PointingErrors
from estimation.slam.config import Consider
from estimation.slam.pointing import with_array_pointing
from estimation.slam.walk.motion import leaps
from isac_arena.validation.scenarios.halls import ScenarioConfig
from isac_arena.validation.scenarios.stops import draw_trajectory


def test_the_pointing_of_both_arrays_adds_to_that_of_the_set_up() -> None:
    estimate = draw_trajectory(np.random.default_rng(1), ScenarioConfig(n_paths=5), 1)[0].estimate
    pointing = np.zeros_like(estimate.covariance)
    pointing[:, 1, 1], pointing[:, 2, 2] = np.deg2rad(0.3) ** 2, np.deg2rad(0.4) ** 2
    pointed = replace(estimate, pointing=PointingErrors(pointing))
    found = with_array_pointing(Consider(pointing_std_deg=0.4, survey_std_m=0.1), [estimate, pointed])
    assert found.pointing_std_deg == pytest.approx(0.5)
    assert found.heading_std_deg == pytest.approx(0.4)
    assert found.survey_std_m == 0.1
    assert with_array_pointing(Consider(), [estimate]) == Consider()


def test_a_stop_far_from_its_walk_leaps() -> None:
    walk = np.cumsum(np.random.default_rng(2).uniform(0.5, 1.5, (12, 2)), axis=0)
    assert not leaps(walk).any()
    back = np.concatenate([walk, walk[-2::-1]])
    assert not leaps(back).any()  # it turns back
    for stop in (0, 5, 11):
        moved = walk.copy()
        moved[stop] += [9.0, -9.0]
        assert leaps(moved)[stop]
    assert not leaps(walk[:4] * [[1], [1], [1], [50]]).any()  # of a few stops no step is usual
