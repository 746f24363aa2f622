"""The ray tracer against an image method written out in double precision, and against closed forms."""

import itertools
import subprocess
import sys
from dataclasses import dataclass

import numpy as np
import pytest

from scenes.config import load_scene
from scenes.contours import Circle, Polyline
from scenes.objects.material import Material
from scenes.pose import SPEED_OF_LIGHT_M_S, Pose, direction
from scenes.scene import Scene, SceneObject
from scenes.walks.trajectory import Walk
from sim.config import PropagationConfig
from sim.propagation.llvm import find_llvm, n_cuda_devices
from sim.propagation.paths import BounceKind
from sim.propagation.propagator import Propagator, propagate
from sim.propagation.specular.fresnel import slab_reflection, vertical_polarisation
from sim.propagation.specular.solver import exact_paths
from sim.propagation.tracer import Tracer, trace

pytestmark = pytest.mark.skipif(
    find_llvm() is None and not n_cuda_devices(), reason="no LLVM 17 or later and no CUDA device"
)

CARRIER_HZ = 60e9
WAVELENGTH_M = SPEED_OF_LIGHT_M_S / CARRIER_HZ
RX = np.array([[6.3, 1.9, 1.1], [8.5, 6.9, 0.9], [2.6, 7.1, 2.2], [4.9, 6.7, 1.6]])


@dataclass(frozen=True)
class Rectangle:
    """A flat face: corner, two edge vectors, and what it belongs to."""

    name: str
    corner: np.ndarray
    edges: np.ndarray
    material: Material

    @property
    def normal(self):
        n = np.cross(*self.edges)
        return n / np.linalg.norm(n)

    def share(self, start, end):
        """How far along start -> end the plane is met, NaN where the rectangle itself is missed."""
        along = (end - start) @ self.normal
        if abs(along) < 1e-12:
            return np.nan
        u = (self.corner - start) @ self.normal / along
        inside = (start + u * (end - start) - self.corner) @ self.edges.T / (self.edges**2).sum(axis=1)
        return u if np.all((inside >= 0) & (inside <= 1)) else np.nan

    def image(self, point):
        return point - 2 * ((point - self.corner) @ self.normal) * self.normal


def rectangles(scene):
    """All flat faces of a scene of upright boxes."""
    x_min, y_min, x_max, y_max = scene.bounds_m
    for name in ("floor", "ceiling"):
        plane = getattr(scene, name)
        span = np.array([[x_max - x_min, 0, 0], [0, y_max - y_min, 0]], float)
        yield Rectangle(name, np.array([x_min, y_min, plane.z_m]), span, plane.material)
    for item in scene.objects:
        if isinstance(item.contour, Circle):
            continue
        corners = item.contour.vertices(1e-3)
        up = np.array([0, 0, item.z_max_m - item.z_min_m])
        for start, end in zip(corners, np.roll(corners, -1, axis=0), strict=True):
            yield Rectangle(
                item.name, np.array([*start, item.z_min_m]), np.array([[*(end - start), 0], up]), item.material
            )
        sides = np.column_stack([corners[[1, 3]] - corners[0], np.zeros(2)])
        yield Rectangle(item.name, np.array([*corners[0], item.z_max_m]), sides, item.material)


def meets_pillar(scene, start, end):
    for item in scene.objects:
        if isinstance(item.contour, Circle):
            leg = (end - start)[:2]
            u = np.clip((item.contour.center_m - start[:2]) @ leg / max(leg @ leg, 1e-30), 0, 1)
            if np.linalg.norm(start[:2] + u * leg - item.contour.center_m) < item.contour.radius_m:
                return True
    return False


def is_free(scene, faces, start, end):
    shares = np.array([face.share(start, end) for face in faces])
    return not (np.any((shares > 1e-9) & (shares < 1 - 1e-9)) or meets_pillar(scene, start, end))


def image_path(scene, faces, chain, tx, rx):
    """Points TX, bounces, RX of the path over a chain of faces, None where there is none."""
    images = list(itertools.accumulate(chain, lambda point, face: face.image(point), initial=tx))
    points = [rx]
    for face, image in zip(chain[::-1], images[:0:-1], strict=True):
        u = face.share(points[0], image)
        if not 1e-9 < u < 1 - 1e-9:
            return None
        points.insert(0, points[0] + u * (image - points[0]))
    points.insert(0, tx)
    bends = zip(chain, points, points[1:], points[2:], strict=False)
    if any(((a - b) @ face.normal) * ((c - b) @ face.normal) <= 0 for face, a, b, c in bends):
        return None
    return points if all(is_free(scene, faces, *leg) for leg in itertools.pairwise(points)) else None


def image_gain(chain, points):
    """Free space times the reflected field vector followed through all bounces."""
    travel = np.diff(points, axis=0)
    length = np.linalg.norm(travel, axis=1).sum()
    k = travel / np.linalg.norm(travel, axis=1, keepdims=True)
    field = vertical_polarisation(k[0]).astype(complex)
    for face, before, after in zip(chain, k, k[1:], strict=False):
        s = np.cross(before, face.normal)
        s /= np.linalg.norm(s)
        permittivity = face.material.complex_permittivity(CARRIER_HZ)
        cosine = abs(before @ face.normal)
        r_s, r_p = slab_reflection(cosine, permittivity, face.material.thickness_m, CARRIER_HZ)
        field = r_s * (field @ s) * s + r_p * (field @ np.cross(s, before)) * np.cross(s, after)
        field *= np.sqrt(1 - face.material.scattering_coefficient**2)
    free_space = WAVELENGTH_M / (4 * np.pi * length) * np.exp(-2j * np.pi * length / WAVELENGTH_M)
    return free_space * (field @ vertical_polarisation(k[-1])), length / SPEED_OF_LIGHT_M_S


def image_paths(scene, rx, max_bounces):
    """(names of the faces, points, gain, delay) of every specular path over flat faces."""
    faces, tx = list(rectangles(scene)), scene.tx.position_m
    chains = itertools.chain(*(itertools.product(faces, repeat=n) for n in range(max_bounces + 1)))
    for chain in chains:
        points = image_path(scene, faces, chain, tx, rx)
        if points is not None:
            yield [face.name for face in chain], np.array(points), *image_gain(chain, points)


@pytest.fixture(scope="module")
def room():
    return load_scene("box_room", CARRIER_HZ)


@pytest.fixture(scope="module")
def propagator(room):
    return Propagator(room, CARRIER_HZ)


def specular(paths, *, flat_only=True):
    kept = ~(paths.is_diffuse | (paths.bounce_kind == BounceKind.DIFFRACTION).any(axis=1))
    if flat_only:
        kept &= ~np.isin(paths.bounce_object, np.flatnonzero(paths.object_name == "pillar")).any(axis=1)
    return paths.take("path", kept)


@pytest.mark.parametrize("rx", RX)
def test_every_flat_specular_path_up_to_two_bounces(room, propagator, rx):
    found = specular(propagator.paths(rx))
    expected = list(image_paths(room, rx, 2))
    assert len(found) == len(expected) > 10
    left = list(range(len(found)))
    for names, points, gain, delay in expected:
        used = found.vertex_m[left, : len(names)]
        match = found.n_bounces[left] == len(names)
        match &= np.linalg.norm(used - points[1:-1], axis=2).max(axis=1, initial=0) < 5e-4
        index = left.pop(np.flatnonzero(match).item())
        surfaces = found.bounce_object[index][: len(names)]
        assert found.object_name[surfaces].tolist() == names
        assert set(found.bounce_kind[index][: len(names)]) <= {BounceKind.SPECULAR}
        assert found.delay_s[index] == pytest.approx(delay, abs=1e-14)
        away, back = (points[1] - points[0], points[-2] - points[-1])
        for azimuth, elevation, vector in (
            (found.aod_azimuth_rad, found.aod_elevation_rad, away),
            (found.aoa_azimuth_rad, found.aoa_elevation_rad, back),
        ):
            np.testing.assert_allclose(
                direction(azimuth[index], elevation[index]), vector / np.linalg.norm(vector), atol=2e-4
            )
        error = found.gain[index] / gain
        assert abs(error) == pytest.approx(1, abs=2e-3)
        assert np.angle(error) == pytest.approx(0, abs=5e-3)


def test_line_of_sight_is_free_space_with_the_carrier_phase(propagator, room):
    paths = propagator.paths(RX[0])
    [los] = np.flatnonzero(paths.is_los)
    distance = np.linalg.norm(RX[0] - room.tx.position_m)
    expected = WAVELENGTH_M / (4 * np.pi * distance) * np.exp(-2j * np.pi * distance / WAVELENGTH_M)
    assert paths.gain[los] == pytest.approx(expected, rel=1e-5)
    assert paths.bounce_kind[los].tolist() == [0, 0]
    assert paths.bounce_object[los].tolist() == [-1, -1]
    assert np.isnan(paths.vertex_m[los]).all()


def test_pillar_reflects_exactly_and_no_facet_does(room, propagator):
    pillar = room.object_names.index("pillar")
    for rx in RX:
        paths = specular(propagator.paths(rx), flat_only=False)
        paths = paths.take("path", (paths.bounce_object == pillar).any(axis=1))
        [exact] = exact_paths(room, rx[None], CARRIER_HZ)
        exact = exact.take("path", (exact.bounce_object == pillar).any(axis=1))
        assert exact.is_single_bounce.sum() <= 1
        np.testing.assert_array_equal(paths.gain, exact.gain)
    [traced] = trace(room, RX[:1], carrier_hz=CARRIER_HZ)
    assert pillar not in specular(traced, flat_only=False).bounce_object
    assert pillar in traced.bounce_object[traced.is_diffuse]


def test_pillar_blocks_the_line_of_sight(propagator):
    assert not propagator.paths(np.array([8.0, 6.9, 1.5])).is_los.any()


def test_record_is_well_formed_and_in_canonical_order(propagator, room):
    paths = propagator.paths(RX[1])
    assert paths.object_name.tolist() == [*room.object_names, "floor", "ceiling"]
    assert paths.bounce_kind.shape == (len(paths), 2)
    assert np.all(np.diff(paths.n_bounces[~paths.is_diffuse]) >= 0)
    unused = paths.bounce_kind == BounceKind.NONE
    np.testing.assert_array_equal(paths.bounce_object == -1, unused)
    np.testing.assert_array_equal(np.isnan(paths.vertex_m).any(axis=2), unused)
    assert np.all(paths.n_bounces[paths.is_diffuse] == 1)


def test_same_bits_whatever_was_traced_before(room, propagator):
    first = propagator.paths(RX[2])
    again = propagate(room, RX[[1, 2]], carrier_hz=CARRIER_HZ)[1]
    for name in ("gain", "delay_s", "aod_azimuth_rad", "aoa_elevation_rad", "bounce_object", "vertex_m"):
        assert getattr(first, name).tobytes() == getattr(again, name).tobytes(), name


@pytest.mark.slow
def test_same_bits_in_another_process(propagator):
    code = (
        "import sys, numpy; from scenes.config import load_scene\n"
        "from sim.propagation.propagator import Propagator\n"
        f"propagator = Propagator(load_scene('box_room', {CARRIER_HZ}), {CARRIER_HZ})\n"
        f"paths = propagator.paths(numpy.array({RX[3].tolist()}))\n"
        "sys.stdout.write(paths.gain.tobytes().hex() + paths.vertex_m.tobytes().hex())"
    )
    there = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    here = propagator.paths(RX[3])
    assert there == here.gain.tobytes().hex() + here.vertex_m.tobytes().hex()


def test_diffuse_power_does_not_depend_on_the_number_of_rays(room):
    total = []
    for n_samples in (2_000, 20_000):
        paths = Tracer(room, CARRIER_HZ, PropagationConfig(diffuse_samples=n_samples)).trace(RX[0])
        total.append(paths.power[paths.is_diffuse].sum())
        assert n_samples / 2 < paths.is_diffuse.sum() <= n_samples
    assert total[1] / total[0] == pytest.approx(1, abs=0.1)


def panel_scene(scattering_coefficient, directivity=None):
    material = Material("board", 5.0, 0.5, 0.05, scattering_coefficient, scattering_directivity=directivity)
    panel = SceneObject("panel", "wall", Polyline(np.array([(2.0, -3.0), (2.0, 3.0)])), 0.0, 3.0, material)
    walk = Walk(np.array([[-1.0, 2.0]]), 1.2, 0.0)
    return Scene("panel", (panel,), Pose(np.array([0.0, -0.5, 1.5]), 0.0), walk, (-5, -5, 5, 5))


def test_diffuse_power_is_the_lambertian_integral():
    """S^2 of the reflected flux leaves every spot over cos t / pi and meets the area lambda^2 / 4 pi."""
    scene, rx = panel_scene(0.5), np.array([-1.0, 2.0, 1.2])
    paths = Tracer(scene, CARRIER_HZ, PropagationConfig(diffuse_samples=100_000)).trace(rx)
    traced = paths.power[paths.is_diffuse].sum()
    y, z = np.meshgrid(np.arange(-3, 3, 0.01) + 0.005, np.arange(0, 3, 0.01) + 0.005)
    spots = np.column_stack([np.full(y.size, 2.0), y.ravel(), z.ravel()])
    to_spot, to_rx = spots - scene.tx.position_m, rx - spots
    r1, r2 = (np.linalg.norm(leg, axis=1) for leg in (to_spot, to_rx))
    k_in, normal = to_spot / r1[:, None], np.array([-1.0, 0, 0])
    cos_in, cos_out = -k_in @ normal, to_rx @ normal / r2
    material = scene.objects[0].material
    r_s, r_p = slab_reflection(cos_in, material.complex_permittivity(CARRIER_HZ), material.thickness_m, CARRIER_HZ)
    s = np.cross(k_in, normal)
    share_s = ((vertical_polarisation(k_in) * s).sum(axis=1) / np.linalg.norm(s, axis=1)) ** 2
    reflected = share_s * abs(r_s) ** 2 + (1 - share_s) * abs(r_p) ** 2
    incident = cos_in / (4 * np.pi * r1**2) * 1e-4
    radiated = 0.25 * reflected * incident * cos_out / np.pi / r2**2
    assert traced == pytest.approx((radiated * WAVELENGTH_M**2 / (4 * np.pi)).sum(), rel=0.01)


def test_a_directive_surface_scatters_about_the_specular_direction():
    rx = np.array([-1.0, 2.0, 1.2])
    spread = []
    for directivity in (None, 4, 30):
        paths = Tracer(panel_scene(0.5, directivity), CARRIER_HZ, PropagationConfig(diffuse_samples=50_000)).trace(
            rx
        )
        diffuse = paths.take("path", paths.is_diffuse)
        [mirrored] = paths.vertex_m[paths.is_single_bounce & ~paths.is_diffuse][:, 0]
        distance = np.linalg.norm(diffuse.vertex_m[:, 0] - mirrored, axis=1)
        spread.append(np.average(distance, weights=diffuse.power))
    assert spread[0] > 1.2 * spread[1] > 1.2**2 * spread[2]


def test_no_scattering_coefficient_gives_no_diffuse_paths():
    paths = Tracer(panel_scene(0.0), CARRIER_HZ).trace(np.array([-1.0, 2.0, 1.2]))
    assert not paths.is_diffuse.any()
    assert paths.n_bounces.tolist() == [0, 1]


def test_zero_bounces_leave_the_line_of_sight_and_a_blocked_one_nothing(room):
    config = PropagationConfig(max_bounces=0)
    clear, blocked = propagate(room, np.array([RX[0], [8.0, 6.9, 1.5]]), carrier_hz=CARRIER_HZ, config=config)
    assert clear.n_bounces.tolist() == [0]
    assert len(blocked) == 0
    assert blocked.bounce_kind.shape == (0, 1)


@pytest.mark.parametrize("field", ["max_bounces", "specular_samples", "diffuse_samples"])
def test_bad_numbers_are_refused(field):
    with pytest.raises(ValueError, match=field):
        PropagationConfig(**{field: -1})
