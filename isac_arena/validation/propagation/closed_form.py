"""Checks of the exact specular solver against closed forms: two rays, a box, a mirror, a slab."""

from dataclasses import replace
from itertools import product
from typing import Any

import numpy as np

from isac_arena.validation.measurement import Measurement, at_least, at_most
from isac_arena.validation.scenarios.solids import CARRIER_HZ, STONE, box_walls, scene_of
from scenes.contours import Circle, OpenSpline, Polygon
from scenes.pose import SPEED_OF_LIGHT_M_S, azimuth_elevation, wrap_angle
from scenes.record import ComplexArray, FloatArray
from scenes.scene import HorizontalPlane
from sim.config import PropagationConfig
from sim.propagation.specular.fresnel import slab, slab_reflection
from sim.propagation.specular.solver import exact_paths

WAVELENGTH_M = SPEED_OF_LIGHT_M_S / CARRIER_HZ
BOX_M = (7.0, 5.0, 3.0)


def check_two_ray(seed: int, quick: bool) -> list[Measurement]:
    """Line of sight and floor bounce against the two-ray formula."""
    rng = np.random.default_rng(seed)
    errors = []
    for _ in range(10 if quick else 200):
        heights, distance = rng.uniform(0.5, 2.5, 2), rng.uniform(1, 30)
        tx, rx = np.array([0.0, 0.0, heights[0]]), np.array([distance, 0.0, heights[1]])
        scene = replace(scene_of(tx, []), floor=HorizontalPlane(0.0, STONE))
        [paths] = exact_paths(scene, rx, CARRIER_HZ, PropagationConfig(max_bounces=1))
        for index, rise in enumerate((heights[1] - heights[0], -heights[1] - heights[0])):
            length = np.hypot(distance, rise)
            gain = _free_space(length)
            if index:
                permittivity = STONE.complex_permittivity(CARRIER_HZ)
                _, r_p = slab_reflection(-rise / length, permittivity, STONE.thickness_m, CARRIER_HZ)
                gain = gain * r_p * np.sqrt(1 - STONE.scattering_coefficient**2)
            delay_s = abs(paths.delay_s[index] - length / SPEED_OF_LIGHT_M_S)
            angle = abs(paths.aod_elevation_rad[index] - np.arctan2(rise, distance))
            errors.append((delay_s, angle, _decibels(abs(paths.gain[index] / gain))))
    return _closed_form_rows("two_ray", np.array(errors))


def check_box_room(seed: int, quick: bool) -> list[Measurement]:
    """All paths of an empty box up to three bounces against its lattice of images."""
    rng = np.random.default_rng(seed)
    size = np.array(BOX_M)
    counts, errors = [], []
    for _ in range(2 if quick else 20):
        tx, rx = rng.uniform(0.3, size - 0.3, (2, 3))
        scene = scene_of(tx, box_walls(*BOX_M[:2]), (STONE,), height_m=BOX_M[2], floor=True)
        scene = replace(scene, bounds_m=(0.0, 0.0, *BOX_M[:2]))
        [paths] = exact_paths(scene, rx, CARRIER_HZ, PropagationConfig(max_bounces=3))
        images = [n for n in product(range(-3, 4), repeat=3) if sum(map(abs, n)) <= 3]
        expected = np.array([_lattice_image(np.array(n), tx, size) for n in images])
        length = np.linalg.norm(rx - expected, axis=1)
        order = np.argsort(length)
        ours = np.argsort(paths.delay_s)
        counts.append(len(paths) == len(images))
        if counts[-1]:
            delay = np.abs(paths.delay_s[ours] - length[order] / SPEED_OF_LIGHT_M_S).max()
            azimuth, elevation = azimuth_elevation(expected[order] - rx)
            angle = np.abs(wrap_angle(paths.aoa_azimuth_rad[ours] - azimuth)).max()
            angle = max(angle, np.abs(paths.aoa_elevation_rad[ours] - elevation).max())
            errors.append((delay, angle, 0.0))
    rows = _closed_form_rows("box_room", np.array(errors or [(np.inf,) * 3]))[:2]
    share = at_least("box_room_complete", np.mean(counts), 1.0, "63 images up to order 3", "share")
    return [share, *rows]


def check_box_gain(seed: int, quick: bool) -> list[Measurement]:
    """Gain of level paths between four walls: free space times one s-polarised reflection coefficient a bounce."""
    rng = np.random.default_rng(seed + 1)
    errors = []
    permittivity = STONE.complex_permittivity(CARRIER_HZ)
    for _ in range(2 if quick else 20):
        tx, rx = rng.uniform(0.3, np.array(BOX_M[:2]) - 0.3, (2, 2))
        scene = scene_of([*tx, 1.5], box_walls(*BOX_M[:2]), (STONE,))
        [paths] = exact_paths(scene, np.array([*rx, 1.5]), CARRIER_HZ, PropagationConfig(max_bounces=3))
        for n in [n for n in product(range(-3, 4), repeat=2) if sum(map(abs, n)) <= 3]:
            offset = rx - _lattice_image(np.array(n), tx, np.array(BOX_M[:2]))
            length = float(np.hypot(*offset))
            gain = _free_space(length)
            for count, cosine in zip(np.abs(n), np.abs(offset) / length, strict=True):
                r_s, _ = slab_reflection(cosine, permittivity, STONE.thickness_m, CARRIER_HZ)
                gain = gain * (r_s * np.sqrt(1 - STONE.scattering_coefficient**2)) ** count
            nearest = np.abs(paths.delay_s * SPEED_OF_LIGHT_M_S - length).argmin()
            errors.append(_decibels(abs(paths.gain[nearest] / gain)))
    worst = float(np.max(errors))
    return [at_most("box_room_gain_error", worst, 0.05, "product of Fresnel coefficients", "dB")]


def check_concave_gain(seed: int, quick: bool) -> list[Measurement]:
    """Phase and size of a path past a caustic against the wave integral over a mirror; cap at the focus."""
    n = 100_001 if quick else 400_001
    arc = np.linspace(-0.6, 0.6, n)
    amplitude, phase = 0.0, 0.0
    for radius, s1, s2 in ((-1.2, 2.5, 2.0), (-6.0, 2.5, 2.0), (3.0, 2.5, 2.0)):
        ends = _mirror_ends(s1, s2)
        bent = radius * np.column_stack([np.sin(arc / radius), np.cos(arc / radius) - 1])
        fields = [_mirror_field(surface, arc, ends) for surface in (bent, np.column_stack([arc, 0 * arc]))]
        ours = _arc_gain(radius, ends) / _free_space(s1 + s2) / -1.0
        ratio = ours / (fields[0] / fields[1])
        amplitude, phase = max(amplitude, _decibels(abs(ratio))), max(phase, abs(float(np.angle(ratio))))
    focus = -2 * 2.5 * 2.0 / ((2.5 + 2.0) * np.cos(0.4))
    cap = _decibels(abs(_arc_gain(focus, _mirror_ends(2.5, 2.0)) / _free_space(4.5)))
    return [
        at_most("concave_gain_error", amplitude, 0.2, "wave integral over the mirror", "dB"),
        at_most("concave_phase_error", phase, 0.05, "+90 deg behind a caustic", "rad"),
        at_most("focus_gain", cap, 10.0, "capped where geometrical optics is infinite", "dB"),
    ]


def check_continuity(seed: int, quick: bool) -> list[Measurement]:
    """A round wall tends to a flat one as its radius grows."""
    tx, rx = np.array([-2.0, 3.0, 1.0]), np.array([3.0, 2.0, 1.4])
    wall = Polygon(np.array([(-9.0, -1), (9, -1), (9, 0), (-9, 0)]))
    [flat] = exact_paths(scene_of(tx, [wall]), rx, CARRIER_HZ)
    flat_gain = abs(flat.gain[flat.is_single_bounce][0])
    gaps = []
    for radius in (10.0, 100.0, 1e3, 1e4):
        scene = scene_of(tx, [Circle(np.array([0.0, -radius]), radius)])  # touches the plane y = 0
        [paths] = exact_paths(scene, rx, CARRIER_HZ, PropagationConfig(max_bounces=1))
        gaps.append(_decibels(abs(paths.gain[paths.is_single_bounce][0]) / flat_gain))
    rises = float(np.sum(np.diff(gaps) >= 0))
    return [
        at_most("continuity_at_1e4_m", gaps[-1], 0.1, "spreading factor 1 + 2ks1s2/..", "dB"),
        at_most("continuity_rises", rises, 0, "monotone in the radius", "count"),
    ]


def check_power(seed: int, quick: bool) -> list[Measurement]:
    """|R|^2 + |T|^2 of a slab, the scattered share included in |R|^2: 1 without loss, never more."""
    rng = np.random.default_rng(seed)
    n = 1000 if quick else 100_000
    cosine, permittivity = rng.uniform(0.01, 1, n), rng.uniform(1, 15, n)
    thickness = rng.uniform(1e-4, 0.2, n)
    share = rng.uniform(0, 1, n) ** 2

    def power(eta: ComplexArray) -> FloatArray:
        both = zip(*slab(cosine, eta, thickness, CARRIER_HZ), strict=True)
        reflected = [((1 - share) * np.abs(r) ** 2 + share * np.abs(r) ** 2) + np.abs(t) ** 2 for r, t in both]
        return np.concatenate(reflected)

    lossless, lossy = power(permittivity + 0j), power(permittivity * (1 - 1j * rng.uniform(0, 2, n)))
    return [
        at_most("power_lossless", np.abs(lossless - 1).max(), 1e-6, "R + T + S = 1", ""),
        at_most("power_gained", (lossy - 1).max(), 1e-6, "passive", ""),
    ]


def _free_space(length_m: float | FloatArray) -> ComplexArray:
    return np.asarray(WAVELENGTH_M / (4 * np.pi * length_m) * np.exp(-2j * np.pi * length_m / WAVELENGTH_M))


def _decibels(ratio: Any) -> float:
    return float(abs(20 * np.log10(ratio)))


def _closed_form_rows(name: str, errors: FloatArray) -> list[Measurement]:
    delay, angle, gain = errors.max(axis=0)
    return [
        at_most(f"{name}_delay_error", delay * 1e12, 1.0, "closed form", "ps"),
        at_most(f"{name}_angle_error", angle, 1e-5, "closed form", "rad"),
        at_most(f"{name}_gain_error", gain, 0.05, "closed form", "dB"),
    ]


def _lattice_image(order: FloatArray, point_m: FloatArray, size_m: FloatArray) -> FloatArray:
    """Image of a point in a box 0..size after `order` bounces along each axis."""
    return np.where(order % 2 == 0, order * size_m + point_m, (order + 1) * size_m - point_m)


def _mirror_ends(s1_m: float, s2_m: float) -> FloatArray:
    """Ends (2, xy) of a path with legs of these lengths, 0.4 rad from the normal +y of a mirror at the origin."""
    return np.array([(-s1_m * np.sin(0.4), s1_m * np.cos(0.4)), (s2_m * np.sin(0.4), s2_m * np.cos(0.4))])


def _mirror_field(surface: FloatArray, arc: FloatArray, ends: FloatArray) -> complex:
    """Tapered integral of exp(-j k (r1 + r2)) / sqrt(r1 r2) over a mirror (point, xy)."""
    r1, r2 = (np.linalg.norm(end - surface, axis=1) for end in ends)
    taper = np.sin(np.linspace(0, np.pi, len(arc))) ** 2
    wave = taper / np.sqrt(r1 * r2) * np.exp(-2j * np.pi / WAVELENGTH_M * (r1 + r2))
    return complex(np.trapezoid(wave, arc))


def _arc_gain(radius_m: float, ends: FloatArray) -> complex:
    """Gain of the path over the top of a round wall that passes the origin, its normal +y, between points."""
    half = min(0.6 / abs(radius_m), 1.2)
    angle = np.linspace(-half, half, 41)
    points = radius_m * np.column_stack([np.sin(angle), np.cos(angle) - 1])
    scene = scene_of([*ends[0], 1.0], [OpenSpline(points)])
    [paths] = exact_paths(scene, np.array([*ends[1], 1.0]), CARRIER_HZ, PropagationConfig(max_bounces=1))
    offset = np.linalg.norm(paths.vertex_m[:, 0, :2], axis=1)
    return complex(paths.gain[int(np.nanargmin(offset))])
