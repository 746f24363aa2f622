"""Rates of paths against closed forms and central differences of paths traced again."""

from dataclasses import replace

import numpy as np
import pytest

from scenes.contours import Circle, ClosedSpline, RoundedPolygon, rectangle
from scenes.motion.motion import Motion, steady_motion
from scenes.objects.clutter import Clutter
from scenes.objects.material import itu_material
from scenes.objects.scene_object import SceneObject
from scenes.pose import SPEED_OF_LIGHT_M_S, Pose, wrap_angle
from scenes.scene import HorizontalPlane, Scene
from scenes.walks.trajectory import RecordedWalk
from sim.config import PropagationConfig
from sim.propagation.motion.bounces import _curvature_at
from sim.propagation.motion.tracks import ANGLES
from sim.propagation.paths import BounceKind, path_labels
from sim.propagation.propagator import Propagator
from sim.propagation.specular.facets import TracedChains

METAL = itu_material("metal", 60e9, name="metal", thickness_m=0.01)
TX, RX = np.array([0.0, 0.0, 1.5]), np.array([6.0, 0.5, 1.2])
NO_CHAINS = TracedChains(np.zeros((0, 1), int), np.zeros((0, 1), int), np.zeros((0, 1, 3, 3)))
CONFIG = PropagationConfig(diffuse_samples=0)


def bent(*, shift, turn=0.0) -> Motion:
    """A motion with velocity, acceleration and turn, at rest in its place at time zero."""
    coefficient = np.zeros((1, 4, 4))
    coefficient[0, 2] = [*shift, turn]
    coefficient[0, 1] = 0.5 * coefficient[0, 2][[1, 0, 2, 3]]
    return Motion(np.array([-1.0, 9.0]), np.array([shifted(coefficient[0])]))


def shifted(coefficient):
    """The same polynomial counted from -1 s."""
    a, b, c, d = coefficient
    return np.array([a, b - 3 * a, c - 2 * b + 3 * a, d - c + b - a])


def scene_of(objects, tx_motion=None, clutter=()) -> Scene:
    walk = RecordedWalk(RX[None], np.zeros(1))
    return Scene(
        "made", tuple(objects), Pose(TX, 0.0), walk, (-9.0, -9.0, 15.0, 9.0), HorizontalPlane(0.0, METAL),
        clutter=clutter, tx_motions={} if tx_motion is None else {"tx": tx_motion},
    )  # fmt: skip


def paths_at(scene: Scene, time: float, velocity):
    here = RX + time * np.asarray(velocity)
    solver = Propagator(scene.at(time), 60e9, CONFIG, traces=False)
    return solver.with_rates(
        solver.exact_paths(here, NO_CHAINS), scene.bodies_at(time, here, np.asarray(velocity))
    )


def test_line_of_sight_and_a_mirror_that_comes_nearer_have_the_doppler_of_the_books():
    mirror = SceneObject("mirror", "wall", rectangle((-5.0, 12.0), (4.0, 4.2)), 0.0, 3.0, METAL)
    scene = replace(scene_of([replace(mirror, motion=steady_motion(np.array([0.0, -2.0, 0.0])))]), floor=None)
    paths = paths_at(scene, 0.0, (3.0, 0.0, 0.0))
    rates = paths.rates
    away = (RX - TX) / np.linalg.norm(RX - TX)
    [los], [echo] = np.flatnonzero(paths.is_los), np.flatnonzero(path_labels(paths) == "S mirror")
    assert np.isclose(rates.doppler_hz[los], -60e9 / SPEED_OF_LIGHT_M_S * 3.0 * away[0])
    image = np.array([0.0, 8.0, 1.5])
    toward = (RX - image) / np.linalg.norm(RX - image)
    assert np.isclose(rates.length_rate_m_s[echo], toward @ [3.0, 4.0, 0.0])
    assert np.isclose(
        rates.length_acceleration_m_s2[echo], (25 - (toward @ [3.0, 4.0, 0.0]) ** 2) / np.linalg.norm(RX - image)
    )


ROUND = RoundedPolygon(np.array([(2.0, 2.0), (4.0, 2.2), (3.0, 3.4)]), np.array([0.3, 0.3, 0.3]))
LOBED = ClosedSpline(np.array([(3.2, -3.0), (4.0, -2.6), (3.6, -2.0), (2.6, -2.1)]))
CORNERS = np.array([(1, 1, 1), (1, -1, -1), (-1, 1, -1), (-1, -1, 1)]) * 0.4
TETRAHEDRON = np.array([(0, 1, 2), (0, 3, 1), (0, 2, 3), (1, 3, 2)])


@pytest.mark.parametrize("what", ["round", "lobed", "box", "pillar_in_the_way", "mesh"])
def test_rates_are_those_of_paths_traced_again(what):
    spin = bent(shift=(0.7, -0.4, 0.05), turn=0.8)
    contours = {"round": ROUND, "lobed": LOBED, "box": rectangle((2.5, 3.5), (1.0, 1.6)),
                "pillar_in_the_way": Circle(np.array([3.0, 0.05]), 0.25)}  # fmt: skip
    wall = SceneObject(
        "wall", "wall", rectangle((-5.0, 12.0), (4.5, 4.7)), 0.0, 3.0, METAL, motion=bent(shift=(0.1, 0.3, 0))
    )
    objects, clutter = [wall], ()
    if what == "mesh":
        clutter = (Clutter("crate", "clutter", METAL, CORNERS + np.array([3.0, 1.2, 1.6]), TETRAHEDRON, spin),)
    else:
        objects.append(SceneObject("thing", "pillar", contours[what], 0.0, 2.8, METAL, motion=spin))
    scene, velocity = scene_of(objects, bent(shift=(-0.3, 0.5, 0.02)), clutter), (0.4, 1.1, -0.05)
    step = 1e-3
    traced = [paths_at(scene, k * step, velocity) for k in (-2, -1, 0, 1, 2)]
    middle = traced[2]
    n_judged, kinds = 0, set()
    for path, label in enumerate(path_labels(middle)):
        rows = [near(paths, middle, path, (k - 2) * step) for k, paths in enumerate(traced)]
        if None in rows:
            continue
        length = np.array([paths.length_m[row] for paths, row in zip(traced, rows, strict=True)])
        first = np.array([1, -8, 0, 8, -1]) / (12 * step)
        assert np.isclose(first @ length, middle.rates.length_rate_m_s[path], atol=1e-7), label
        second = np.array([-1, 16, -30, 16, -1]) / (12 * step**2) @ length
        assert np.isclose(second, middle.rates.length_acceleration_m_s2[path], rtol=1e-4, atol=1e-4), label
        for name in ANGLES:
            angle = np.unwrap(
                [getattr(paths, f"{name}_rad")[row] for paths, row in zip(traced, rows, strict=True)]
            )
            rate = getattr(middle.rates, f"{name}_rate_rad_s")[path]
            assert np.isclose(first @ angle, rate, rtol=1e-5, atol=1e-6), (label, name)
        n_judged += 1
        kinds |= set(middle.bounce_kind[path].tolist())
    assert n_judged > len(middle) / 2 and BounceKind.SPECULAR in kinds
    if what in ("box", "pillar_in_the_way", "mesh"):
        assert BounceKind.DIFFRACTION in kinds


@pytest.mark.parametrize("contour", [LOBED, ROUND, Circle(np.array([1.0, 2.0]), 0.4)])
def test_curvature_and_normal_at_a_point_of_a_contour_also_beside_its_joints(contour):
    for piece in contour.pieces:
        t = np.array([1e-4, 0.003, 0.3, 0.77, 0.99, 0.9999])
        curvature, normal = _curvature_at(contour.pieces, piece.point(t))
        expected = piece.curvature(t) if piece.is_curved else np.zeros(len(t))
        assert np.allclose(curvature, expected, atol=1e-6) and np.allclose(normal, piece.outward_normal(t))


def near(paths, middle, path, time):
    """The row of a path at another time; None where it is not there."""
    length = middle.length_m[path] + time * middle.rates.length_rate_m_s[path]
    same = (paths.bounce_object == middle.bounce_object[path]).all(axis=1)
    same &= (paths.bounce_kind == middle.bounce_kind[path]).all(axis=1)
    for name in ANGLES:
        turned = getattr(paths, f"{name}_rad") - getattr(middle, f"{name}_rad")[path]
        same &= np.abs(wrap_angle(turned)) < 0.02
    rows = np.flatnonzero(same & (np.abs(paths.length_m - length) < 1e-4))
    return rows[0] if len(rows) else None
