"""Learned heights, classes and plan paths of synthetic halls: errors and covariances, and what is unknown."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from estimation.channel.hall.geometry import Heights
from estimation.channel.hall.model import GivenHeights, read_hall
from estimation.channel.hall.record import HallClass, HallModel
from estimation.channel.hall.stop import ClassifiedPaths, in_hall, located
from estimation.channel.record import EstimateStatus, empty_estimate
from scenes.pose import wrap_angle
from tests.estimation.channel.hall.hall_estimates import WEAK, TrueHall, hall_link, synthetic_hall

UNEQUAL = Heights(2.6, 1.4, 4.3)
EQUAL = Heights(1.5, 1.5, 4.0)
CLASSES = list(HallClass)


def read(
    heights: Heights, seed: int, *, sees_elevation: bool = False
) -> tuple[TrueHall, HallModel, list[ClassifiedPaths]]:
    return _read(heights, seed, sees_elevation)


@cache
def _read(heights: Heights, seed: int, sees_elevation: bool) -> tuple[TrueHall, HallModel, list[ClassifiedPaths]]:
    link = hall_link(sees_elevation=sees_elevation)
    truth = synthetic_hall(np.random.default_rng(seed), heights, link)
    hall = read_hall(truth.estimates, link, GivenHeights(tx_m=heights.tx_m))
    assert hall is not None
    return truth, hall, [in_hall(estimate, hall, link)[1] for estimate in truth.estimates]


@pytest.mark.parametrize("seed", [0, 1])
@pytest.mark.parametrize("heights", [UNEQUAL, EQUAL])
def test_horizontal_beams_learn_the_heights_within_their_covariance(heights: Heights, seed: int) -> None:
    _, hall, _ = read(heights, seed)
    error = (hall.heights.vector - heights.vector)[1:]
    assert np.abs(error).max() < 0.1
    assert error @ np.linalg.solve(hall.covariance_m2[1:3, 1:3], error) / 2 < 4.6  # chance of 1 %
    assert hall.height_std_m[0] == 0


def test_beams_at_three_elevations_learn_the_heights_within_two_centimetres() -> None:
    truth, hall, _ = read(UNEQUAL, 0, sees_elevation=True)
    error = (hall.heights.vector - UNEQUAL.vector)[1:]
    assert np.abs(error).max() < 0.02
    assert error @ np.linalg.solve(hall.covariance_m2[1:3, 1:3], error) / 2 < 4.6
    assert np.abs(hall.clock_m - truth.clock_m).max() < 5 * hall.clock_std_m.max()


@pytest.mark.parametrize(("heights", "sees_elevation"), [(UNEQUAL, False), (EQUAL, False), (UNEQUAL, True)])
def test_most_paths_have_their_class(heights: Heights, sees_elevation: bool) -> None:
    truth, _, found = read(heights, 0, sees_elevation=sees_elevation)
    version = np.concatenate(truth.version)
    plan = np.concatenate(truth.plan)
    shortest = np.concatenate([one[:, 0] == one[one[:, 0].argmin(), 0] for one in truth.plan])
    chosen = np.concatenate([paths.class_probability for paths in found]).argmax(axis=1)
    assert len(plan) == len(chosen)
    expected = np.where(version == WEAK, 3, np.where(version > 0, 2, np.where(shortest, 0, 1)))
    right = {name: np.mean(chosen[expected == index] == index) for index, name in enumerate(CLASSES)}
    assert right[HallClass.LINE_OF_SIGHT] == 1
    assert right[HallClass.LEVEL] > 0.9
    assert right[HallClass.FLOOR_OR_CEILING] > 0.85
    assert right[HallClass.WEAK] > 0.9


def test_plan_paths_have_the_errors_of_their_covariances() -> None:
    truth, _, found = read(UNEQUAL, 1)
    nees = []
    for paths, version, plan in zip(found, truth.version, truth.plan, strict=True):
        right = (paths.version_probability.argmax(axis=1) == version) & (paths.class_probability[:, 3] < 0.5)
        error = np.stack([paths.plan_length_m, paths.aod_azimuth_rad, paths.aoa_azimuth_rad], axis=1) - plan
        error[:, 1:] = wrap_angle(error[:, 1:])
        inverse = np.linalg.inv(paths.covariance[right])
        nees.append(np.einsum("pa,pab,pb->p", error[right], inverse, error[right]))
    assert np.median(np.concatenate(nees)) / 2.37 == pytest.approx(1, abs=0.5)


def test_probabilities_are_probabilities_with_at_most_one_line_of_sight() -> None:
    for heights in (UNEQUAL, EQUAL):
        for paths in read(heights, 0)[2]:
            np.testing.assert_allclose(paths.class_probability.sum(axis=1), 1)
            assert (paths.class_probability >= 0).all()
            assert paths.class_probability[:, 0].sum() <= 1 + 1e-9
            assert (np.linalg.eigvalsh(paths.covariance) > 0).all()


def test_a_common_delay_changes_the_clocks_alone() -> None:
    truth, hall, found = read(UNEQUAL, 1)
    late = [replace(estimate, delay_s=estimate.delay_s + 2e-8) for estimate in truth.estimates]
    again = read_hall(late, truth.link, GivenHeights(tx_m=UNEQUAL.tx_m))
    assert again is not None
    np.testing.assert_allclose(again.heights.vector, hall.heights.vector, atol=1e-4)
    np.testing.assert_allclose(again.clock_m - hall.clock_m, 2e-8 * 299_792_458.0, atol=1e-3)
    for one, estimate in zip(found, late, strict=True):
        two = in_hall(estimate, again, truth.link)[1]
        np.testing.assert_allclose(one.class_probability, two.class_probability, atol=1e-2)


def test_equal_heights_are_named_as_what_cannot_be_told() -> None:
    assert any("equal heights" in caveat for caveat in read(EQUAL, 0)[1].caveats)
    assert not any("equal heights" in caveat for caveat in read(UNEQUAL, 0)[1].caveats)


def test_nothing_is_read_from_estimates_without_paths() -> None:
    none = empty_estimate(0, "coherent", EstimateStatus.NO_PATHS, "")
    assert read_hall([none], hall_link(sees_elevation=False)) is None


def test_a_stop_without_paths_has_no_classes() -> None:
    truth, hall, _ = read(UNEQUAL, 0)
    none = empty_estimate(99, "coherent", EstimateStatus.NO_PATHS, "")
    assert len(in_hall(none, hall, truth.link)[1]) == 0


def test_a_stop_that_was_not_read_finds_its_clock() -> None:
    link = hall_link(sees_elevation=False)
    truth = synthetic_hall(np.random.default_rng(4), UNEQUAL, link, n_stops=5)
    hall = read_hall(truth.estimates[:4], link, GivenHeights(UNEQUAL.tx_m, UNEQUAL.rx_m, 0.01))
    assert hall is not None
    stop = located(truth.estimates[4], hall, link)
    assert abs(stop.clock_m - truth.clock_m[4]) < 4 * np.sqrt(stop.shared_m2[3, 3])
    assert stop.is_certain


def test_surveyed_heights_are_kept_within_their_errors() -> None:
    link = hall_link(sees_elevation=False)
    truth = synthetic_hall(np.random.default_rng(5), UNEQUAL, link)
    hall = read_hall(truth.estimates, link, GivenHeights(UNEQUAL.tx_m + 0.02, UNEQUAL.rx_m - 0.01, 0.02))
    assert hall is not None
    error = hall.heights_m - UNEQUAL.vector
    assert error @ np.linalg.solve(hall.covariance_m2, error) / 3 < 3.8  # chance of 1 %
    assert (hall.height_std_m[:2] <= 0.02).all()


def test_a_ceiling_without_paths_is_not_made_up() -> None:
    link = hall_link(sees_elevation=False)
    truth = synthetic_hall(np.random.default_rng(6), UNEQUAL, link)
    open_air = [
        estimate.take("path", (version == WEAK) | (version < 2))
        for estimate, version in zip(truth.estimates, truth.version, strict=True)
    ]
    hall = read_hall(open_air, link, GivenHeights(UNEQUAL.tx_m, UNEQUAL.rx_m, 0.02))
    assert hall is not None
    assert not hall.sees_ceiling
    assert "no ceiling shows" in hall.caveats
    tied, _ = in_hall(open_air[0], hall, link)
    np.testing.assert_array_equal(tied.delay_s, open_air[0].delay_s)
