"""Places on the floor, at heights of rough walls and images in the ceiling are told from upright objects."""

import numpy as np
import pytest

from estimation.laws.plane import residual
from estimation.laws.raised import image_path, raised_path
from estimation.shape.config import ContourConfig, ReflectionConfig
from estimation.shape.reflection.levels import on_planes
from estimation.shape.reflection.objects import find_objects
from estimation.shape.reflection.raised import _is_determined, upright_paths
from estimation.shape.reflection.reflections import Reflections
from scenes.pose import wrap_angle

PANELS = np.deg2rad([-180.0, -90.0, 0.0, 90.0])
TX = np.array([0.0, 0.0, 0.2])
N_STOPS = 30
STD = np.array([0.02, np.deg2rad(0.1), np.deg2rad(0.1)])
WALK = np.column_stack([np.linspace(1, 9, N_STOPS), -4 + 0.5 * np.sin(np.arange(N_STOPS)), np.zeros((N_STOPS, 2))])
FLOOR_M = [(4.0, -10.5), (8.5, -10.0), (14.0, -9.0)]
CEILING_M2 = 60.0  # of the way up and down
CONFIG = ReflectionConfig(delay_offset_std_ns=0.01, aod_offset_std_deg=0.01, aoa_offset_std_deg=0.01)


def boresights(point: np.ndarray, state: np.ndarray) -> np.ndarray:
    ends = TX[:2], state[:2]
    turn = np.array([np.arctan2(*(point[:2] - end)[::-1]) for end in ends]) - np.array([TX[2], state[2]])
    return PANELS[np.abs(wrap_angle(turn[:, None] - PANELS)).argmin(axis=1)]


def seen(point: np.ndarray, *, is_image: bool, difference_m: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Exact measurements (stop, 3) of one point along the walk, and the boresights (stop, 2)."""
    value, found, panels = np.empty(3), [], []
    for state in WALK:
        boresight = boresights(point, state)
        if is_image:
            image_path(TX, state, point, boresight, value, np.empty((3, 3)))
        else:
            raised_path(TX, state, point, difference_m, boresight, value, np.empty((3, 4)), np.empty((3, 3)))
        found.append(value.copy())
        panels.append(boresight)
    return np.array(found), np.array(panels)


def campaign(cases: list[tuple[np.ndarray, bool]], difference_m: float = 0.0, seed: int = 0) -> Reflections:
    """The paths of points (3,), each of them an image or not, with noise."""
    rng = np.random.default_rng(seed)
    parts = [seen(point, is_image=is_image, difference_m=difference_m) for point, is_image in cases]
    measured = np.concatenate([part[0] for part in parts])
    n = len(measured)
    return Reflections(
        measured=measured + STD * rng.standard_normal((n, 3)),
        covariance=np.tile(np.diag(STD**2), (n, 1, 1)),
        tx=np.tile(TX, (n, 1)),
        rx_state=np.tile(WALK, (len(cases), 1)),
        rx_covariance=np.zeros((n, 4, 4)),
        session=np.zeros(n, int),
        stop=np.tile(np.arange(N_STOPS), len(cases)),
        difference_m=np.full(n, difference_m),
        boresight_rad=np.concatenate([part[1] for part in parts]),
    )


def upright(data: Reflections) -> tuple[np.ndarray, np.ndarray]:
    """Which paths of `campaign` stay, by case and stop, and what they measure then."""
    config = ContourConfig()
    objects = find_objects(data, config.eps_m, config.min_samples, CONFIG)
    found = upright_paths(objects, data, CONFIG)
    stays, measured = np.ones(len(data), bool), data.measured.copy()
    if found is not None:
        stays[:] = False
        stays[found.kept] = True
        measured[found.kept] = found.of(data).measured
    return stays.reshape(-1, N_STOPS), measured.reshape(-1, N_STOPS, 3)


def test_an_image_is_the_upright_edge_a_way_up_and_down_longer() -> None:
    rng, step = np.random.default_rng(1), 1e-6
    for _ in range(50):
        state, point = rng.normal(size=4) * 4, np.array([*rng.normal(size=2) * 6, rng.uniform(0, 50)])
        boresight = np.where(rng.random(2) < 0.3, np.nan, boresights(point, state))
        value, slope, ahead, behind = np.empty(3), np.empty((3, 3)), np.empty(3), np.empty(3)
        image_path(TX, state, point, boresight, value, slope)
        plan = np.linalg.norm(point[:2] - TX[:2]) + np.linalg.norm(point[:2] - state[:2])
        assert value[0] == pytest.approx(np.sqrt(plan**2 + point[2]) + state[3])
        for axis in range(3):
            move = step * np.eye(3)[axis]
            image_path(TX, state, point + move, boresight, ahead, np.empty((3, 3)))
            image_path(TX, state, point - move, boresight, behind, np.empty((3, 3)))
            np.testing.assert_allclose(slope[:, axis], residual(ahead, behind) / (2 * step), rtol=1e-4, atol=1e-6)


def test_a_level_image_and_a_place_between_devices_at_one_height_are_the_same() -> None:
    point = np.array([5.0, -8.0, 0.0])
    np.testing.assert_allclose(seen(point, is_image=True)[0], seen(point, is_image=False)[0], atol=1e-12)


@pytest.mark.parametrize("difference_m", [0.0, 1.2])
def test_places_of_the_floor_are_taken_out_and_edges_stay(difference_m: float) -> None:
    floor = [(np.array([*place, -1.5]), False) for place in FLOOR_M]
    edges = [(np.array([6.0, -9.0, 0.0]), True), (np.array([0.5, -8.0, 0.0]), True)]
    stays, measured = upright(campaign([*floor, *edges], difference_m))
    assert stays[: len(floor)].mean() < 0.1 and stays[len(floor) :].all()
    exact = np.array([seen(point, is_image=True)[0] for point, _ in edges])
    assert np.abs(residual(measured[len(floor) :], exact)[..., 0]).max() < 5 * STD[0]


def test_an_image_of_an_object_in_the_ceiling_is_taken_out() -> None:
    pillar = np.array([5.0, -14.0, 0.0])
    stays, _ = upright(campaign([(pillar, True), (np.array([*pillar[:2], CEILING_M2]), True)]))
    assert stays[0].all() and not stays[1].any()


def test_a_place_of_a_rough_wall_is_seen_as_the_edge_below_it() -> None:
    wall = np.array([6.0, -8.0, 0.9])
    stays, measured = upright(campaign([(wall, False)]))
    assert stays.all()
    exact, _ = seen(np.array([6.0, -8.0, 0.0]), is_image=True)
    before, _ = seen(wall, is_image=False)
    off, off_before = (np.sqrt(np.mean(residual(each, exact)[..., 0] ** 2)) for each in (measured, before))
    assert off < 0.03 and off_before > 0.05


def test_without_heights_nothing_is_told() -> None:
    data = campaign([(np.array([*place, -1.5]), False) for place in FLOOR_M])
    unknown = Reflections(**{**vars(data), "difference_m": None, "boresight_rad": None})
    assert upright(unknown)[0].all()


def test_heights_that_agree_are_a_plane_and_few_are_none() -> None:
    rng = np.random.default_rng(3)
    height = np.concatenate([1.5 + 0.05 * rng.standard_normal(8), rng.uniform(0.2, 6.0, 8)])
    found = on_planes(height, np.full(16, 0.05**2), np.full(16, 0.2))
    assert found[:8].all() and found[8:].mean() < 0.3
    assert not on_planes(np.array([1.5]), np.array([0.05**2]), np.array([0.2])).any()


def test_spots_that_rounding_alone_determines_are_none() -> None:
    slope = np.array([1e4, -3.0, 2e-3])
    along_one = np.outer(slope, slope)
    assert not _is_determined(along_one)
    assert not _is_determined(np.diag([1.0, 1.0, 0.0]))
    assert not _is_determined(np.full((3, 3), np.nan))
    assert _is_determined(np.diag([1e-6, 1.0, 1e12]))
    assert _is_determined(along_one + np.diag(np.square(slope)) * 1e-6)
