"""Versions of a plan path against image sources in space, and plan paths against finite differences."""

from dataclasses import replace

import numpy as np
import pytest

from estimation.channel.hall.geometry import ELEVATION_SIGNS, HEIGHT_SLOPES, Heights, Version, heights_from_gaps
from estimation.channel.hall.paths import RangedPaths, plan_points
from scenes.pose import azimuth_elevation

HEIGHTS = Heights(2.6, 1.4, 4.1)


def mirrored(point: np.ndarray, plane_m: float) -> np.ndarray:
    """The point mirrored at the horizontal plane of this height."""
    return point * [1, 1, -1] + [0, 0, 2 * plane_m]


def image(source: np.ndarray, planes_m: list[float]) -> np.ndarray:
    """Image of a source that is reflected at these planes in order."""
    for plane_m in planes_m:
        source = mirrored(source, plane_m)
    return source


BOUNCES = {
    Version.LEVEL: [],
    Version.FLOOR: [0.0],
    Version.CEILING: [HEIGHTS.ceiling_m],
    Version.FLOOR_CEILING: [0.0, HEIGHTS.ceiling_m],
    Version.CEILING_FLOOR: [HEIGHTS.ceiling_m, 0.0],
}


@pytest.mark.parametrize("version", list(Version))
def test_lengths_and_elevations_are_those_of_image_sources(version: Version) -> None:
    plan_m = 7.3
    tx, rx = np.array([0.0, 0.0, HEIGHTS.tx_m]), np.array([plan_m, 0.0, HEIGHTS.rx_m])
    arrival = image(tx, BOUNCES[version]) - rx
    departure = image(rx, BOUNCES[version][::-1]) - tx
    difference = HEIGHTS.differences_m[version]
    assert np.hypot(plan_m, difference) == pytest.approx(np.linalg.norm(arrival))
    for end, toward in enumerate((departure, arrival)):
        elevation = np.arctan2(ELEVATION_SIGNS[version, end] * difference, plan_m)
        assert elevation == pytest.approx(azimuth_elevation(toward)[1])


def test_heights_follow_from_the_gaps_of_floor_and_ceiling_and_the_difference() -> None:
    square = np.square(HEIGHTS.differences_m)
    gaps = square[[Version.FLOOR, Version.CEILING]] - square[Version.LEVEL]
    found = heights_from_gaps(gaps[0], gaps[1], np.asarray(HEIGHTS.tx_m - HEIGHTS.rx_m))
    np.testing.assert_allclose(found, HEIGHTS.vector)
    assert gaps[0] == pytest.approx(4 * HEIGHTS.tx_m * HEIGHTS.rx_m)


def cone_paths(seed: int = 0, n: int = 6) -> RangedPaths:
    rng = np.random.default_rng(seed)
    boresight = np.stack([np.zeros(n), rng.choice([-np.pi / 2, 0.0, np.pi / 2], n)], axis=1)
    return RangedPaths(
        range_m=rng.uniform(12, 25, n),
        azimuth_rad=boresight + rng.uniform(-0.6, 0.6, (n, 2)),
        elevation_rad=np.zeros((n, 2)),
        boresight_rad=boresight,
        is_cone=np.array([True, True]),
        covariance=np.einsum("p,ab->pab", rng.uniform(1, 2, n), np.diag([1e-4, 1e-5, 1e-5, 100.0, 100.0])),
        cross=np.zeros((n, n, 5, 5)),
    )


def test_a_plan_path_gives_back_the_cone_angles_and_the_range() -> None:
    paths, clock_m, differences = cone_paths(), 0.7, HEIGHTS.differences_m
    points = plan_points(paths, clock_m, differences)
    assert points.is_possible.all()
    length = np.hypot(points.value[..., 0], differences)
    np.testing.assert_allclose(length, np.broadcast_to((paths.range_m - clock_m)[:, None], length.shape))
    for end in range(2):
        turn = points.value[..., 1 + end] - paths.boresight_rad[:, None, end]
        sine = np.sin(turn) * points.value[..., 0] / length
        np.testing.assert_allclose(sine, np.sin(paths.azimuth_rad - paths.boresight_rad)[:, end, None] + 0 * sine)


def test_slopes_of_plan_paths_agree_with_finite_differences() -> None:
    paths, differences, step = cone_paths(3), HEIGHTS.differences_m, 1e-6
    slope = plan_points(paths, 0.4, differences).slope
    by_clock = (
        plan_points(paths, 0.4 + step, differences).value - plan_points(paths, 0.4 - step, differences).value
    )
    np.testing.assert_allclose(-slope[..., 0], by_clock / (2 * step), atol=1e-6)
    by_height = (
        plan_points(paths, 0.4, differences + step).value - plan_points(paths, 0.4, differences - step).value
    )
    np.testing.assert_allclose(slope[..., 3], by_height / (2 * step), atol=1e-6)
    for axis in range(2):
        offset = step * (np.arange(2) == axis)
        ends = [
            plan_points(replace(paths, azimuth_rad=paths.azimuth_rad + sign * offset), 0.4, differences).value
            for sign in (1, -1)
        ]
        np.testing.assert_allclose(slope[..., 1 + axis], (ends[0] - ends[1]) / (2 * step), atol=1e-6)


def test_a_path_shorter_than_the_height_difference_has_no_plan_path() -> None:
    paths = cone_paths()
    possible = plan_points(paths, float(paths.range_m[0] - 3.0), HEIGHTS.differences_m).is_possible
    np.testing.assert_array_equal(possible[0], HEIGHTS.differences_m < 3.0)


def test_height_differences_are_linear_in_the_heights() -> None:
    np.testing.assert_allclose(HEIGHT_SLOPES @ HEIGHTS.vector, HEIGHTS.differences_m)
