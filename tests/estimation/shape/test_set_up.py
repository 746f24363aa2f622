"""Errors of the set-up in contours: a TX that points wrong turns all of them alike."""

from dataclasses import replace

import numpy as np
import pytest

from estimation.shape.fit import OK, ShapeFit
from estimation.shape.record import Contours
from estimation.shape.reflection.choice import Choice, averaged_band
from estimation.shape.reflection.fit_all import CampaignFit
from estimation.shape.reflection.rows import contour_record
from estimation.shape.reflection.tx_sessions import one_session
from estimation.shape.set_up import common_errors, with_set_up, without_set_up
from estimation.slam.config import Consider
from estimation.slam.record import SolveStatus
from isac_arena.validation.scenarios.estimates import made_poses
from scenes.pose import Pose

TX = Pose(np.array([1.0, 2.0, 1.5]), 0.3)
TURNED = Consider(pointing_std_deg=1.0, survey_std_m=0.02)


def shape(contour_m: np.ndarray, std_m: float, *, is_closed: bool, kind: str = "wall") -> ShapeFit:
    none = np.zeros(0)
    return ShapeFit(
        kind, OK, is_closed, contour_m, np.full(len(contour_m), std_m), 0.0, none, np.zeros((0, 0)),
        none.astype(str), 1.0, 0.1,
    )  # fmt: skip


def record(*shapes: ShapeFit) -> Contours:
    rows = tuple(np.zeros(0, int) for _ in shapes)
    fit = CampaignFit("reflection", shapes, np.ones((len(shapes), 3)) / 3, rows, None, one_session(np.arange(2)))
    return contour_record(fit, np.zeros(0, int), 0)


def circle(radius_m: float) -> np.ndarray:
    psi = np.linspace(-np.pi, np.pi, 180, endpoint=False)
    return np.array([6.0, 3.0]) + radius_m * np.column_stack([np.cos(psi), np.sin(psi)])


def test_bands_hold_contours_that_turn_with_the_tx() -> None:
    """The spread across the contour of many turned and shifted copies; a wall does not move ahead of the TX."""
    wall, body = np.linspace([4.0, -3.0], [4.0, 6.0], 180), circle(0.4)
    both = record(shape(wall, 0.01, is_closed=False), shape(body, 0.02, is_closed=True))
    found = with_set_up(both, TX, TURNED)
    rng, tx = np.random.default_rng(0), TX.position_m[:2]
    turn, shift = np.deg2rad(1.0) * rng.standard_normal(4000), 0.02 * rng.standard_normal((4000, 2))
    psi = np.linspace(-np.pi, np.pi, 180, endpoint=False)
    normals = np.tile([1.0, 0.0], (180, 1)), np.column_stack([np.cos(psi), np.sin(psi)])
    for k, (points, normal, own) in enumerate(zip((wall, body), normals, (0.01, 0.02), strict=True)):
        away = points - tx
        lever = np.column_stack([-away[:, 1], away[:, 0]])
        across = turn[:, None] * np.sum(normal * lever, axis=1) + shift @ normal.T
        np.testing.assert_allclose(found.std_m[k], np.sqrt(own**2 + across.var(axis=0)), rtol=0.08)
    assert found.std_m[0].min() == pytest.approx(np.hypot(0.01, 0.02), rel=1e-3)  # where the TX is ahead


def test_a_point_moves_as_much_as_on_average_over_all_directions() -> None:
    found = with_set_up(record(shape(np.array([[5.0, 5.0]]), 0.01, is_closed=False, kind="edge")), TX, TURNED)
    turned2 = (np.deg2rad(1.0) * 5.0) ** 2 / 2
    np.testing.assert_allclose(found.std_m, np.sqrt(0.01**2 + 0.02**2 + turned2))


def test_poses_lose_what_they_share_and_given_ones_keep_all() -> None:
    state = np.array([[5.0, 5.0, 0.2, 0.0], [8.0, 1.0, 0.4, 0.0]])
    own = np.diag([1e-6, 1e-6, 1e-6, 1e-20])
    for status in (SolveStatus.NLOS, SolveStatus.GIVEN):
        poses = made_poses(state, status)
        wide = own + TURNED.covariance(poses.position_m - TX.position_m[:2])
        poses = replace(poses, covariance=wide)
        left = without_set_up(poses, TX, TURNED).covariance
        np.testing.assert_allclose(
            left, wide if status == SolveStatus.GIVEN else np.tile(own, (2, 1, 1)), atol=1e-18
        )
        assert common_errors(poses, TURNED) == (Consider() if status == SolveStatus.GIVEN else TURNED)
        assert common_errors(poses, None) == Consider()


def test_poses_of_another_origin_keep_their_covariances() -> None:
    poses = replace(
        made_poses(np.ones((1, 4)) * 5, SolveStatus.LOS), covariance=np.diag([1e-6] * 3 + [1e-20])[None]
    )
    np.testing.assert_array_equal(without_set_up(poses, TX, TURNED).covariance, poses.covariance)


def test_bands_are_averaged_over_the_kinds_of_a_class() -> None:
    """A circle that may be a larger ellipse: of draws from both, 95 of 100 are in the band."""
    small, large = (shape(circle(radius), 0.01, is_closed=True, kind=kind)
                    for radius, kind in ((0.4, "circle"), (0.5, "ellipse")))  # fmt: skip
    fits, rng = {"circle": small, "ellipse": large, "rounded_square": small}, np.random.default_rng(1)
    for p_large in (0.02, 0.25):
        probability = {"wall": 0.2, "circle": 0.8 * (1 - p_large), "ellipse": 0.8 * p_large, "rounded_square": 0.0}
        choice = Choice(fits, probability, {"wall": 0.2, "edge": 0.0, "pillar": 0.8}, 0.0)
        std = averaged_band(small, choice).std_m
        np.testing.assert_allclose(std, std[0], rtol=1e-6)
        draws = 0.1 * (rng.random(40000) < p_large) + 0.01 * rng.standard_normal(40000)
        assert np.mean(np.abs(draws) <= 1.96 * std[0]) == pytest.approx(0.95, abs=0.004)
        assert (std[0] < 0.02) == (
            p_large < 0.05
        )  # what is less likely than the rest of the band does not widen it
    wall = shape(circle(0.4), 0.01, is_closed=False)
    assert averaged_band(wall, choice) is wall
