"""Reflection off smooth contours against the conducting-cylinder series, brute force and wave integrals."""

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.special import hankel2, jv

from scenes.contours import Circle, OpenSpline, rectangle
from scenes.objects.material import Material
from scenes.pose import SPEED_OF_LIGHT_M_S, Pose, direction
from scenes.scene import Scene, SceneObject
from scenes.walks.trajectory import Walk
from sim.config import PropagationConfig
from sim.propagation.paths import BounceKind
from sim.propagation.specular.curved import curved_paths
from sim.propagation.specular.rays import CAUSTIC_LIMIT, spreading_factor
from sim.propagation.specular.solver import exact_paths
from sim.propagation.specular.surfaces import reflecting_surfaces

CARRIER_HZ = 60e9
WAVELENGTH_M = SPEED_OF_LIGHT_M_S / CARRIER_HZ
WAVENUMBER = 2 * np.pi / WAVELENGTH_M
METAL = Material("metal", 1.0, 1e7, 0.002)
RADIUS_M = 0.203


def scene_of(tx, *items):
    objects = tuple(
        SceneObject(f"object_{index}", "wall", contour, z_min, z_max, material)
        for index, (contour, z_min, z_max, material) in enumerate(items)
    )
    far = Walk(np.array([[90.0, 90.0]]), 1.0, 0.0)
    return Scene("test", objects, Pose(np.asarray(tx, float), 0.0), far, (-99, -99, 99, 99))


def curved_reflections(scene, rx, carrier_hz):
    solved = exact_paths(scene, rx, carrier_hz, PropagationConfig(max_bounces=1))
    flat = [index for index, item in enumerate(scene.objects) if not item.contour.pieces[0].is_curved]
    return [
        paths.take("path", paths.is_single_bounce & ~np.isin(paths.bounce_object[:, 0], flat)) for paths in solved
    ]


def one_bounce(curvature, s1, s2, cosine):
    return spreading_factor(
        np.atleast_1d(curvature)[:, None],
        np.tile([s1, s2], (np.size(curvature), 1)),
        np.full((np.size(curvature), 1), cosine),
    )


def pillar_scene(tx, material=METAL, radius=RADIUS_M, z=(0.0, 3.0)):
    return scene_of(tx, (Circle(np.zeros(2), radius), *z, material))


def ends_at_incidence(incidence_rad, s1, s2, *, z=(1.0, 1.0)):
    """TX and RX that a circle about the origin connects over its point at angle 0."""
    foot = np.array([RADIUS_M, 0.0])
    tx = foot + s1 * direction(incidence_rad)[:2]
    rx = foot + s2 * direction(-incidence_rad)[:2]
    return np.array([*tx, z[0]]), np.array([*rx, z[1]])


def cylinder_series(tx, rx):
    """Field scattered by a conducting cylinder of a line source, in units of H0(k r): exact, E along the axis."""
    order = np.arange(-400, 401)
    ratio = jv(order, WAVENUMBER * RADIUS_M) / hankel2(order, WAVENUMBER * RADIUS_M)
    rho = [np.hypot(*end[:2]) for end in (tx, rx)]
    turn = np.arctan2(tx[1], tx[0]) - np.arctan2(rx[1], rx[0])
    terms = ratio * hankel2(order, WAVENUMBER * rho[0]) * hankel2(order, WAVENUMBER * rho[1])
    return -(terms * np.exp(1j * order * turn)).sum()


@pytest.mark.parametrize(
    ("incidence_deg", "db", "rad"), [(10, 0.05, 0.02), (40, 0.05, 0.02), (63, 0.1, 0.05), (73, 0.3, 0.1)]
)
@pytest.mark.parametrize(("s1", "s2"), [(5.0, 3.0), (2.0, 8.0)])
def test_conducting_cylinder(incidence_deg, db, rad, s1, s2):
    tx, rx = ends_at_incidence(np.deg2rad(incidence_deg), s1, s2)
    [paths] = curved_reflections(pillar_scene(tx), rx[None], CARRIER_HZ)
    assert len(paths) == 1
    np.testing.assert_allclose(paths.vertex_m[0, 0], [RADIUS_M, 0, 1.0], atol=1e-9)
    length = paths.delay_s[0] * SPEED_OF_LIGHT_M_S
    assert length == pytest.approx(s1 + s2, abs=1e-9)
    over_plane = paths.gain[0] / (WAVELENGTH_M / (4 * np.pi * length) * np.exp(-1j * WAVENUMBER * length))
    exact = cylinder_series(tx, rx) / hankel2(0, WAVENUMBER * (s1 + s2))
    error = over_plane / exact
    assert abs(20 * np.log10(abs(error))) < db
    assert abs(np.angle(error)) < rad


def test_height_is_linear_in_the_unfolded_length_and_must_be_on_the_object():
    tx, rx = ends_at_incidence(0.5, 4.0, 2.0, z=(0.9, 2.4))
    [paths] = curved_reflections(pillar_scene(tx), rx[None], CARRIER_HZ)
    assert paths.vertex_m[0, 0, 2] == pytest.approx(1.9)
    assert paths.delay_s[0] * SPEED_OF_LIGHT_M_S == pytest.approx(np.hypot(6.0, 1.5))
    assert np.tan(paths.aod_elevation_rad[0]) == pytest.approx(1.5 / 6)
    assert np.tan(paths.aoa_elevation_rad[0]) == pytest.approx(-1.5 / 6)
    assert paths.bounce_kind.tolist() == [[BounceKind.SPECULAR]]
    for z in ((0.0, 1.85), (1.95, 3.0)):
        assert len(curved_reflections(pillar_scene(tx, z=z), rx[None], CARRIER_HZ)[0]) == 0


def test_directions_point_at_the_reflection_point():
    tx, rx = ends_at_incidence(0.7, 4.0, 2.0, z=(1.0, 2.0))
    [paths] = curved_reflections(pillar_scene(tx), rx[None], CARRIER_HZ)
    for end, azimuth, elevation in (
        (tx, paths.aod_azimuth_rad, paths.aod_elevation_rad),
        (rx, paths.aoa_azimuth_rad, paths.aoa_elevation_rad),
    ):
        towards = paths.vertex_m[0, 0] - end
        np.testing.assert_allclose(direction(azimuth, elevation)[0], towards / np.linalg.norm(towards), atol=1e-12)


def test_scattered_share_is_missing_in_the_reflection():
    tx, rx = ends_at_incidence(0.5, 4.0, 2.0)
    rough = Material("rough", 1.0, 1e7, 0.002, scattering_coefficient=0.6)
    [smooth], [reduced] = (curved_reflections(pillar_scene(tx, m), rx[None], CARRIER_HZ) for m in (METAL, rough))
    assert reduced.power[0] / smooth.power[0] == pytest.approx(1 - 0.36)


places = st.tuples(st.floats(0.5, 20), st.floats(-np.pi, np.pi))


@settings(max_examples=60, deadline=None)
@given(places, places)
def test_pillar_reflects_at_the_shortest_detour_where_it_does_not_block(tx, rx):
    tx, rx = (np.array([*(rho * direction(angle)[:2]), 1.0]) for rho, angle in (tx, rx))
    if np.allclose(tx, rx):
        return
    gap = shapely.distance(shapely.LineString([tx[:2], rx[:2]]), shapely.Point(0, 0)) - RADIUS_M
    if abs(gap) < 1e-3:
        return
    [paths] = curved_reflections(pillar_scene(tx), rx[None], CARRIER_HZ)
    assert len(paths) == (gap > 0)
    if len(paths):
        rim = RADIUS_M * direction(np.linspace(-np.pi, np.pi, 20_001))[:, :2]
        detour = np.linalg.norm(rim - tx[:2], axis=1) + np.linalg.norm(rim - rx[:2], axis=1)
        assert paths.delay_s[0] * SPEED_OF_LIGHT_M_S == pytest.approx(detour.min(), abs=1e-6)
        np.testing.assert_allclose(paths.vertex_m[0, 0, :2], rim[detour.argmin()], atol=1e-3)


def open_circle(radius=2.0, opening_rad=0.3, n=400):
    return OpenSpline(radius * direction(np.linspace(opening_rad, 2 * np.pi - opening_rad, n))[:, :2])


@pytest.mark.parametrize("rx", [(-0.5, 0.4), (1.2, -1.1), (0.1, 1.8), (-1.7, 0.2)])
def test_inside_of_a_ring_reflects_several_times(rx):
    tx = np.array([0.9, 0.7, 1.0])
    rx = np.array([*rx, 1.0])
    scene = scene_of(tx, (open_circle(), 0.0, 3.0, METAL))
    [paths] = curved_reflections(scene, rx[None], CARRIER_HZ)
    rim = 2.0 * direction(np.linspace(0.31, 2 * np.pi - 0.31, 400_001))[:, :2]
    detour = np.linalg.norm(rim - tx[:2], axis=1) + np.linalg.norm(rim - rx[:2], axis=1)
    turning = np.flatnonzero(np.diff(np.sign(np.diff(detour)))) + 1
    assert len(turning) >= 2
    np.testing.assert_allclose(np.sort(paths.delay_s) * SPEED_OF_LIGHT_M_S, np.sort(detour[turning]), atol=1e-6)
    assert len({tuple(np.round(point, 4)) for point in paths.vertex_m[:, 0]}) == len(paths)


def wave_integral(detour, density, arc):
    """Integral of density exp(-j k detour) over the arc length, tapered to nothing at both ends."""
    taper = np.sin(np.linspace(0, np.pi, len(arc))) ** 2
    return np.trapezoid(taper * density * np.exp(-1j * WAVENUMBER * detour), arc)


@pytest.mark.parametrize("radius", [3.0, -1.2, -6.0])
def test_spreading_is_the_stationary_phase_of_the_wave_integral(radius):
    """Convex, concave beyond the caustic (focus between), and concave before it, against the plane's integral."""
    s1, s2, incidence = 2.5, 2.0, 0.4
    tx, rx = s1 * direction(np.pi / 2 - incidence)[:2], s2 * direction(np.pi / 2 + incidence)[:2]
    arc = np.linspace(-0.6, 0.6, 200_001)
    angle = arc / radius
    bent = radius * np.column_stack([np.sin(angle), np.cos(angle) - 1])
    fields = []
    for surface in (bent, np.column_stack([arc, 0 * arc])):
        r1, r2 = (np.linalg.norm(end - surface, axis=1) for end in (tx, rx))
        fields.append(wave_integral(r1 + r2, 1 / np.sqrt(r1 * r2), arc))
    expected = fields[0] / fields[1]
    [ours] = one_bounce(1 / radius, s1, s2, np.cos(incidence))
    assert abs(ours / expected) == pytest.approx(1, abs=0.01)
    assert np.angle(ours / expected) == pytest.approx(0, abs=0.02)


def test_gain_is_capped_at_the_caustic():
    focused = -(2.0 + 3.0) / (2 * 2.0 * 3.0)
    gain = one_bounce([focused, focused * 1.001], 2.0, 3.0, 1.0)
    np.testing.assert_allclose(np.abs(gain), CAUSTIC_LIMIT**-0.5)


def test_both_sides_of_an_open_wall_reflect_but_not_from_one_to_the_other():
    scene = scene_of([0.5, 0.2, 1.0], (open_circle(opening_rad=1.5), 0.0, 3.0, METAL))
    inside, outside = np.array([[-0.5, -0.8, 1.0], [-5.0, 1.0, 1.0]])
    assert len(curved_reflections(scene, inside[None], CARRIER_HZ)[0]) > 0
    assert len(curved_reflections(scene, outside[None], CARRIER_HZ)[0]) == 0
    scene = scene_of([-6.0, -1.0, 1.0], (open_circle(opening_rad=1.5), 0.0, 3.0, METAL))
    [paths] = curved_reflections(scene, outside[None], CARRIER_HZ)
    assert len(paths) == 1
    assert np.linalg.norm(paths.vertex_m[0, 0, :2]) == pytest.approx(2.0, abs=1e-6)


def test_legs_hit_by_the_contour_itself_or_by_others_are_dropped():
    s_bend = OpenSpline(np.array([(-3, 0), (-2, 1.5), (-1, 0), (0, -1.5), (1, 0), (2, 1.5), (3, 0)], float))
    tx = np.array([-1.0, 4.0, 1.0])
    rx = np.column_stack([np.linspace(-4, 4, 33), np.full(33, 2.0), np.full(33, 1.2)])
    scene = scene_of(tx, (s_bend, 0.0, 3.0, METAL))
    candidates = curved_paths(reflecting_surfaces(scene).curves, tx[:2], rx[:, :2])
    outline = shapely.LineString(s_bend.vertices(1e-7))
    expected = []
    for receiver, point, normal in zip(
        candidates.receiver, candidates.point_m[:, 0], candidates.normal[:, 0], strict=True
    ):
        near = point[:2] + 1e-5 * normal[:2]
        legs = shapely.LineString([tx[:2], near, rx[receiver, :2]])
        expected.append(not legs.intersects(outline))
    found = curved_reflections(scene, rx, CARRIER_HZ)
    counts = np.bincount(candidates.receiver[np.array(expected)], minlength=len(rx))
    assert [len(paths) for paths in found] == counts.tolist()
    assert 0 < sum(expected) < len(expected)
    screened = scene_of(tx, (s_bend, 0.0, 3.0, METAL), (rectangle((-5, 5), (3.0, 3.1)), 0.0, 3.0, METAL))
    assert sum(map(len, curved_reflections(screened, rx, CARRIER_HZ))) == 0


def test_reflection_at_the_joint_of_a_circle_is_found_once():
    for tx_angle in (0.3, -0.3, 0.0):
        tx, rx = ends_at_incidence(tx_angle, 4.0, 4.0)
        [paths] = curved_reflections(pillar_scene(tx), rx[None] * [1, 1, 1.1], CARRIER_HZ)
        assert len(paths) == 1


def test_two_bounces_spread_like_the_lens_chain():
    """Two equal thin lenses of power K against the matrix product [[1, s], [0, 1]] [[1, 0], [K, 1]] ..."""
    k, legs, cosine = 0.8, np.array([2.0, 1.5, 3.0]), 0.7
    lens = np.array([[1, 0], [2 * k / cosine, 1]])
    free = [np.array([[1, leg], [0, 1]]) for leg in legs]
    tube = (free[2] @ lens @ free[1] @ lens @ free[0])[0, 1]
    [gain] = spreading_factor(np.full((1, 2), k), legs[None], np.full((1, 2), cosine))
    assert gain == pytest.approx(np.sqrt(legs.sum() / tube))
    [focusing] = spreading_factor(np.full((1, 2), -3.0), legs[None], np.full((1, 2), cosine))
    assert focusing.real < 0  # two caustics turn the phase by 180 deg
    assert abs(focusing.imag) < 1e-12


def test_no_curved_object_gives_empty_records():
    scene = scene_of([3.0, 3.0, 1.0], (rectangle((0, 1), (0, 1)), 0.0, 3.0, METAL))
    [first, second] = curved_reflections(scene, np.array([[2.0, 3, 1], [3.0, 2, 1]]), CARRIER_HZ)
    assert len(first) == len(second) == 0
    assert first.object_name.tolist() == ["object_0"]


def test_receivers_together_and_alone_give_the_same_bits():
    scene = scene_of([0.9, 0.7, 1.0], (open_circle(), 0.0, 3.0, METAL))
    rx = np.random.default_rng(2).uniform([-1, -1, 0.5], [1, 1, 2.5], (6, 3))
    for position, together in zip(rx, curved_reflections(scene, rx, CARRIER_HZ), strict=True):
        [alone] = curved_reflections(scene, position[None], CARRIER_HZ)
        assert alone.gain.tobytes() == together.gain.tobytes()
        assert alone.vertex_m.tobytes() == together.vertex_m.tobytes()
