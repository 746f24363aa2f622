"""Paths over upright surfaces, seen from above: images of the TX in walls, and slopes against differences."""

import numpy as np
import pytest

from estimation.laws.level import nearest_boresight, plan_paths
from scenes.record import FloatArray

CONES = np.array([True, True])


def _seen(at: FloatArray) -> FloatArray:
    """Values (path, 3) from the columns length, both azimuths and height difference of (path, 4)."""
    none = np.zeros((len(at), 2))
    return plan_paths(at[:, 0], at[:, 1:3], none, CONES, none, at[:, 3]).value


def test_cones_and_lengths_of_true_paths_give_their_plans() -> None:
    rng = np.random.default_rng(1)
    plan_m, difference_m = rng.uniform(2, 30, 50), rng.uniform(-5, 5, 50)
    azimuth = rng.uniform(-1.2, 1.2, (50, 2))
    length_m = np.hypot(plan_m, difference_m)
    cone = np.arcsin(np.sin(azimuth) * (plan_m / length_m)[:, None])
    seen = _seen(np.column_stack([length_m, cone, difference_m]))
    np.testing.assert_allclose(seen, np.column_stack([plan_m, azimuth]), rtol=1e-12)


def test_slopes_are_limits_of_differences() -> None:
    rng = np.random.default_rng(2)
    at = np.column_stack([rng.uniform(8, 30, 20), rng.uniform(-1, 1, (20, 2)), rng.uniform(-4, 4, 20)])
    slope = plan_paths(at[:, 0], at[:, 1:3], np.zeros((20, 2)), CONES, np.zeros((20, 2)), at[:, 3]).slope
    for column in range(4):
        step = np.zeros(4)
        step[column] = 1e-6
        difference = (_seen(at + step) - _seen(at - step)) / 2e-6
        np.testing.assert_allclose(difference, slope[:, :, column], atol=1e-6)


def test_azimuths_stay_and_impossible_paths_are_named() -> None:
    azimuth = np.array([[0.3, 0.4], [0.3, 1.5], [0.3, 0.4]])
    boresight, slack = np.zeros((3, 2)), np.zeros((3, 2))
    seen = plan_paths(np.array([5.0, 3.0, 2.0]), azimuth, boresight, np.array([False, True]), slack, np.array(2.5))
    np.testing.assert_array_equal(seen.value[:, 1], 0.3)
    assert seen.is_possible.tolist() == [
        True,
        False,
        False,
    ]  # a cone too wide for its elevation; shorter than 2.5 m


@pytest.mark.parametrize(
    ("azimuth_deg", "panel_deg"), [(44.0, 0.0), (46.0, 90.0), (-170.0, 180.0), (-100.0, -90.0)]
)
def test_the_nearest_panel(azimuth_deg: float, panel_deg: float) -> None:
    panels = np.deg2rad([-90.0, 0.0, 90.0, 180.0, 180.0])
    assert np.rad2deg(nearest_boresight(np.deg2rad([azimuth_deg]), panels))[0] == pytest.approx(panel_deg)
