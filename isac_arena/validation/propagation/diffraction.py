"""Diffraction against exact fields: edges of wedges and half planes, conducting cylinders near grazing."""

import numpy as np
from scipy.special import hankel2

from isac_arena.validation.measurement import Measurement, at_most
from isac_arena.validation.propagation import exact_fields
from scenes.contours import Circle, Polyline, rectangle
from scenes.objects.material import Material
from scenes.pose import SPEED_OF_LIGHT_M_S, Pose
from scenes.record import BoolArray, ComplexArray, FloatArray, concatenate
from scenes.scene import Scene, SceneObject
from scenes.walks.trajectory import Walk
from sim.propagation.diffraction.creeping import creeping_paths, creeping_rays
from sim.propagation.diffraction.edge_paths import diffracted_paths
from sim.propagation.diffraction.fock import Polarisation, creeping_gain, grazing_factor
from sim.propagation.diffraction.wedge import wedge_gain
from sim.propagation.paths import Paths

CARRIER_HZ = 60e9
K = 2 * np.pi * CARRIER_HZ / SPEED_OF_LIGHT_M_S
SIGN: dict[Polarisation, int] = {"soft": -1, "hard": 1}
# The field passes through nulls where rays cancel and vanishes on a soft face. An error in dB means nothing
# there, so the reference is at least this share of the free field over the edge or cylinder.
NULL_FLOOR = 1e-3
TRANSITION = 2 * np.pi  # k L a below this: within the transition about a shadow or reflection boundary


def check_wedge(seed: int, quick: bool) -> list[Measurement]:
    """Line source before conducting wedges, both polarisations: total field against the eigenfunction series."""
    del seed
    openings = (1.5, 2.0) if quick else (1.1, 1.25, 1.5, 1.75, 1.9, 2.0)
    outside, inside = [0.0], [0.0]
    for n in openings:
        for rho_in, rho_out in ((0.3, 1.5), (1.0, 0.4)):
            for phi_in in np.deg2rad([8.0, 30.0, 77.0]):
                for sign in SIGN.values():
                    phi = np.linspace(0.01, n * np.pi - 0.01, 181 if quick else 721)
                    exact = exact_fields.wedge_series(K, n, (rho_in, phi_in), rho_out, phi, sign)
                    reference = hankel2(0, K * (rho_in + rho_out))
                    diffracted = reference * wedge_gain(K, n, phi_in, phi, rho_in, rho_out, 1.0, sign, sign)
                    field = _optical_field(n, (rho_in, phi_in), rho_out, phi, sign) + diffracted
                    error = _error_db(field / reference, exact / reference)
                    near = _is_in_transition(n, phi_in, phi, rho_in * rho_out / (rho_in + rho_out))
                    outside.append(float(error[~near].max(initial=0)))
                    inside.append(float(error[near].max(initial=0)))
    return [
        at_most("wedge_outside_transition", max(outside), 0.5, "exact wedge solution", "dB"),
        at_most("wedge_in_transition", max(inside), 1.0, "exact wedge solution", "dB"),
    ]


def check_half_plane(seed: int, quick: bool) -> list[Measurement]:
    """Plane wave (Sommerfeld) and skew point source (Macdonald) on a half plane, both polarisations."""
    del seed
    phi = np.linspace(0.01, 2 * np.pi - 0.01, 361 if quick else 1441)
    plane, point = [0.0], [0.0]
    for phi_in in np.deg2rad([8.0, 30.0, 77.0, 140.0]):
        for sign in SIGN.values():
            rho_in, rho_out = 1e6, 0.7
            exact = exact_fields.half_plane_sommerfeld(K, phi_in, rho_out, phi, sign)
            optical = _optical_plane_wave(phi_in, rho_out, phi, sign)
            gain = wedge_gain(K, 2.0, phi_in, phi, rho_in, rho_out, 1.0, sign, sign)
            plane.append(float(_error_db(optical + gain * np.exp(-1j * K * rho_out), exact).max()))
            for rho_in, rho_out, rise in ((2.0, 3.0, 2.5), (0.5, 4.0, 1.0)):
                length = np.hypot(rho_in + rho_out, rise)
                sin_beta = (rho_in + rho_out) / length
                legs = rho_in / sin_beta, rho_out / sin_beta
                gain = wedge_gain(K, 2.0, phi_in, phi, *legs, sin_beta, sign, sign)
                reference = np.exp(-1j * K * length) / length
                exact = exact_fields.half_plane_point_source(K, (rho_in, phi_in), rho_out, phi, rise, sign)
                optical = _optical_field(2.0, (rho_in, phi_in), rho_out, phi, sign, rise)
                point.append(float(_error_db(optical / reference + gain, exact / reference).max()))
    return [
        at_most("half_plane_plane_wave", max(plane), 0.5, "Sommerfeld's solution", "dB"),
        at_most("half_plane_skew_point_source", max(point), 0.5, "Macdonald's solution", "dB"),
    ]


def check_cylinder(seed: int, quick: bool) -> list[Measurement]:
    """Reflected field of conducting cylinders, both polarisations, against the series.

    The series also contains the wave that creeps round the back. It is not negligible where source, cylinder and
    receiver are almost in line, so it is subtracted.
    """
    del seed
    coarse, fine = [0.0, 30, 50, 60, 70, 75, 80, 83, 85], [*range(0, 70, 5), *range(70, 86)]
    incidence = np.deg2rad(coarse if quick else fine)
    radii = (0.2, 0.5) if quick else (0.2, 0.35, 0.5, 1.0, 2.0)
    error: dict[Polarisation, list[FloatArray]] = {"soft": [], "hard": []}
    for radius in radii:
        for s1, s2 in ((5.0, 3.0), (2.0, 8.0), (1.0, 1.0)):
            for polarisation, sign in SIGN.items():
                rows = []
                for angle in incidence:
                    tx, rx = _ends(radius, s1, s2, angle)
                    reflected = _reflected(radius, s1, s2, np.cos(angle), polarisation)
                    back = _round_the_back(radius, tx, rx, s1 + s2, polarisation)
                    exact = exact_fields.cylinder_series(K, radius, tx, rx[None], sign)[0]
                    exact = exact / hankel2(0, K * (s1 + s2)) - back
                    rows.append(20 * np.log10(np.abs(reflected / exact)))
                error[polarisation].append(np.abs(np.array(rows)))
    flat = np.rad2deg(incidence) <= 70.01
    rows_out = []
    for polarisation in SIGN:
        worst = np.max(error[polarisation], axis=0)
        rows_out += [
            at_most(f"cylinder_{polarisation}_to_70_deg", worst[flat].max(), 0.2, "exact series", "dB"),
            at_most(f"cylinder_{polarisation}_to_85_deg", worst.max(), 1.0, "exact series", "dB"),
        ]
    return rows_out


def check_cylinder_shadow(seed: int, quick: bool) -> list[Measurement]:
    """Total field of a conducting cylinder from light to shadow: continuity, and the creeping wave."""
    del seed
    worst, jump = [0.0], [0.0]
    for radius in (0.2,) if quick else (0.2, 0.5, 1.0):
        tx = np.array([-3.0, 0.0])
        for polarisation, sign in SIGN.items():
            rho = 2.0
            boundary = np.arccos(radius / 3.0) + np.arccos(radius / rho)
            turn = np.linspace(0.002, 0.25, 40)
            azimuth = np.pi - boundary - turn
            rx = rho * np.column_stack([np.cos(azimuth), np.sin(azimuth)])
            straight = np.hypot(*(rx - tx).T)
            exact = hankel2(0, K * straight) + exact_fields.cylinder_series(K, radius, tx, rx, sign)
            s1, s2 = np.sqrt(9.0 - radius**2), np.sqrt(rho**2 - radius**2)
            total = np.zeros(len(turn), complex)
            for angle in (turn, 2 * np.pi - 2 * boundary - turn):
                length = s1 + s2 + radius * angle
                total += creeping_gain(K, radius, s1, s2, angle, polarisation) * hankel2(0, K * length)
            reference = hankel2(0, K * (s1 + s2))
            worst.append(float(_error_db(total / reference, exact / reference).max()))
            lit = 1 + _reflected(radius, s1, s2, 1e-9, polarisation)
            dark = creeping_gain(K, radius, s1, s2, 1e-12, polarisation)
            jump.append(float(np.abs(20 * np.log10(np.abs(lit / dark)))))
    return [
        at_most("cylinder_shadow", max(worst), 1.0, "exact series, to 14 deg into the shadow", "dB"),
        at_most("cylinder_shadow_boundary_jump", max(jump), 0.01, "the field is continuous", "dB"),
    ]


def check_reciprocity(seed: int, quick: bool) -> list[Measurement]:
    """Diffracted paths of a scene of lossy objects with TX and RX swapped: same gains and delays."""
    rng = np.random.default_rng(seed)
    worst, n_paths = 0.0, 0
    for _ in range(5 if quick else 40):
        ends = rng.uniform([-6, -6, 0.5], [6, 6, 2.5], (2, 3))
        ends[:, 0] += [-9, 9]  # on either side of the objects
        there, back = (_all_diffracted(ends[order]) for order in ([0, 1], [1, 0]))
        n_paths += len(there)
        if len(there) != len(back):
            return [at_most("diffraction_reciprocity", np.inf, 1e-9, "a path is lost one way")]
        for values in ("delay_s", "gain"):
            a = getattr(there, values)[np.argsort(there.delay_s)]
            b = getattr(back, values)[np.argsort(back.delay_s)]
            worst = max(worst, float((np.abs(a - b) / np.abs(a)).max(initial=0)))
    reason = f"swapping TX and RX changes nothing over {n_paths} paths; phases of 1e4 rad round off 1e-12"
    return [at_most("diffraction_reciprocity", worst, 1e-9, reason)]


def _error_db(field: ComplexArray, exact: ComplexArray) -> FloatArray:
    """|20 lg(1 + | |field| - |exact| | / max(|exact|, floor))|, both over the free field of the reference path."""
    level = np.maximum(np.abs(exact), NULL_FLOOR)
    return np.asarray(20 * np.log10(1 + np.abs(np.abs(field) - np.abs(exact)) / level))


def _is_in_transition(n: float, phi_in: float, phi: FloatArray, parameter_m: float) -> BoolArray:
    angles = np.stack([phi - phi_in, phi + phi_in, phi + phi_in - 2 * np.pi * n])
    return np.asarray((2 * K * parameter_m * np.cos(angles / 2) ** 2).min(axis=0) < TRANSITION)


def _optical_field(
    n: float, source: tuple[float, float], rho: float, phi: FloatArray, sign: int, rise: float | None = None
) -> ComplexArray:
    """Direct and reflected field of a line source, or of a point source where a rise is given."""

    def free(angle: FloatArray) -> ComplexArray:
        distance = np.sqrt(source[0] ** 2 + rho**2 - 2 * source[0] * rho * np.cos(angle) + (rise or 0.0) ** 2)
        wave = hankel2(0, K * distance) if rise is None else np.exp(-1j * K * distance) / distance
        return np.where(np.abs(angle) < np.pi, wave, 0)

    total = phi + source[1]
    return free(phi - source[1]) + sign * (free(total) + free(total - 2 * np.pi * n))


def _optical_plane_wave(phi_in: float, rho: float, phi: FloatArray, sign: int) -> ComplexArray:
    def free(angle: FloatArray) -> ComplexArray:
        return np.where(np.abs(angle) < np.pi, np.exp(1j * K * rho * np.cos(angle)), 0)

    return free(phi - phi_in) + sign * (free(phi + phi_in) + free(phi + phi_in - 4 * np.pi))


def _ends(radius: float, s1: float, s2: float, incidence_rad: float) -> tuple[FloatArray, FloatArray]:
    """Ends (xy,) that a circle about the origin connects over its point on the x axis."""
    cosine, sine = np.cos(incidence_rad), np.sin(incidence_rad)
    return np.array([radius + s1 * cosine, s1 * sine]), np.array([radius + s2 * cosine, -s2 * sine])


def _reflected(radius: float, s1: float, s2: float, cos_incidence: float, polarisation: Polarisation) -> complex:
    """Field reflected by a conducting cylinder over a free wave of that length."""
    divergence = 1 / np.sqrt(1 + 2 * s1 * s2 / ((s1 + s2) * radius * cos_incidence))
    factor = grazing_factor(K, radius, s1, s2, cos_incidence, polarisation)
    return complex(SIGN[polarisation] * divergence * factor)


def _round_the_back(
    radius: float, tx: FloatArray, rx: FloatArray, length_m: float, polarisation: Polarisation
) -> complex:
    """Creeping wave on the far side, over the free field of a path of that length."""
    circle = Circle(np.zeros(2), radius)
    rays = [creeping_rays(circle, np.append(tx, 0.0), np.append(rx, 0.0)[None], sense) for sense in (1, -1)]
    total = 0j
    for ray in rays:
        gain = creeping_gain(K, radius, ray.s1_m, ray.s2_m, ray.arc_m / radius, polarisation)
        level = ray.s1_m + ray.s2_m + ray.arc_m
        total += (gain * hankel2(0, K * level)).sum() / hankel2(0, K * length_m)
    return complex(total)


def _all_diffracted(ends_m: FloatArray) -> Paths:
    """Diffracted and creeping paths between the two ends (end, xyz) in a small scene of lossy objects."""
    stone, metal = Material("stone", 5.0, 0.5), Material("metal", 1.0, 1e7, 0.002)
    rail = Polyline(np.array([(-0.5, 1.0), (0.8, 1.7), (1.5, 1.2)]))
    objects = (
        SceneObject("object_0", "wall", rectangle((-1.0, 1.0), (-2.0, -1.0)), 0.0, 3.0, stone),
        SceneObject("object_1", "wall", rail, 0.0, 3.0, stone),
        SceneObject("object_2", "wall", Circle(np.array([0.3, 0.0]), 0.2), 0.0, 3.0, metal),
    )
    far = Walk(np.array([[90.0, 90.0]]), 1.0, 0.0)
    scene = Scene("diffraction", objects, Pose(ends_m[0], 0.0), far, (-99, -99, 99, 99))
    [edges] = diffracted_paths(scene, ends_m[1:], CARRIER_HZ)
    [creeping] = creeping_paths(scene, ends_m[1:], CARRIER_HZ)
    return concatenate([edges, creeping], "path")
