"""Paths over user meshes: against the same box drawn as a prism, closed forms, and the rules of the record."""

from dataclasses import replace

import numpy as np
import pytest

from isac_arena.validation.propagation.mesh import BOX_FACES
from isac_arena.validation.scenarios.solids import METAL, scene_of
from scenes.contours import Circle
from scenes.objects.clutter import Clutter
from scenes.objects.material import Material
from scenes.pose import SPEED_OF_LIGHT_M_S
from sim.config import PropagationConfig
from sim.propagation.diffraction.mesh_edges import diffracted_by_meshes, mesh_edges
from sim.propagation.diffraction.wedge import wedge_gain
from sim.propagation.llvm import find_llvm, n_cuda_devices
from sim.propagation.occlusion import occluders
from sim.propagation.paths import BounceKind, path_labels
from sim.propagation.propagator import Propagator, propagate
from sim.propagation.specular.facets import TracedChains, mesh_rays
from sim.propagation.specular.fresnel import slab_reflection, slab_transmission
from sim.propagation.specular.solver import exact_paths

CARRIER_HZ = 60e9
WAVELENGTH_M = SPEED_OF_LIGHT_M_S / CARRIER_HZ
BOARD = Material("board", 5.0, 0.5, 0.01, 0.2)
PANE = np.array([(0, -2, 0), (0, 2, 0), (0, 2, 3), (0, -2, 3)], float)
S = BounceKind.SPECULAR
traces = pytest.mark.skipif(
    find_llvm() is None and not n_cuda_devices(), reason="no LLVM 17 or later and no CUDA device"
)


def pane(material=BOARD, tx=(-2.0, 0.5, 1.5)):
    """A scene of one upright mesh rectangle in the plane x = 0."""
    mesh = Clutter("pane", "clutter", material, PANE, np.array([(0, 1, 2), (0, 2, 3)]))
    return replace(scene_of(tx, []), clutter=(mesh,))


def free_space(length_m):
    return WAVELENGTH_M / (4 * np.pi * length_m) * np.exp(-2j * np.pi * length_m / WAVELENGTH_M)


def box(low, high, material=BOARD):
    corner = np.array([(x, y, z) for z in (0, 1) for x, y in ((0, 0), (1, 0), (1, 1), (0, 1))])
    return Clutter("box", "clutter", material, low + corner * np.subtract(high, low), np.array(BOX_FACES))


@traces
def test_reflection_off_a_pane_in_closed_form_and_its_record():
    scene = pane()
    rx = np.array([-1.0, -0.7, 1.2])
    config = PropagationConfig(max_bounces=1, diffuse_samples=0, diffraction=False)
    paths, compared = Propagator(scene, CARRIER_HZ, config).compared_paths(rx)
    assert path_labels(paths).tolist() == ["LOS", "S pane"]
    assert (compared.n_common, compared.n_repaired, compared.n_extra) == (1, 0, 0)
    image = scene.tx.position_m * (-1, 1, 1)
    length = np.linalg.norm(rx - image)
    assert paths.delay_s[1] == pytest.approx(length / SPEED_OF_LIGHT_M_S, abs=1e-15)
    cosine = (image[0] - rx[0]) / length
    permittivity = BOARD.complex_permittivity(CARRIER_HZ)
    r_s, _ = slab_reflection(cosine, permittivity, BOARD.thickness_m, CARRIER_HZ)
    near_level = r_s * np.sqrt(1 - BOARD.scattering_coefficient**2) * free_space(length)
    assert paths.gain[1] == pytest.approx(near_level, rel=0.05)  # the ray falls by 8 deg: not all of it is s


@traces
def test_same_bits_for_any_order_of_receivers_and_any_run():
    scene = replace(pane(), objects=scene_of((0, 5, 1), [Circle(np.array([-1.0, 2.5]), 0.3)]).objects)
    rx = np.array([(-1.0, -0.7, 1.2), (-3.0, 1.0, 1.4), (1.5, 0.4, 1.0)])
    config = PropagationConfig(diffuse_samples=100, transmission=True)
    first = propagate(scene, rx, carrier_hz=CARRIER_HZ, config=config)
    again = propagate(scene, rx[[2, 0, 1]], carrier_hz=CARRIER_HZ, config=config)
    for paths, other in zip(first, [again[1], again[2], again[0]], strict=True):
        for name in ("gain", "delay_s", "bounce_kind", "bounce_object", "vertex_m"):
            assert getattr(paths, name).tobytes() == getattr(other, name).tobytes(), name


def test_a_way_through_a_mesh_is_that_through_a_thin_wall():
    config = PropagationConfig(transmission=True, max_bounces=0)
    tx, rx = np.array([-2.0, 0.5, 1.5]), np.array([1.5, 0.5, 1.5])
    [paths] = exact_paths(pane(tx=tx), rx, CARRIER_HZ, config)
    assert path_labels(paths).tolist() == ["R pane"] and not paths.is_los.any()
    permittivity = BOARD.complex_permittivity(CARRIER_HZ)
    t_s, _ = slab_transmission(1.0, permittivity, BOARD.thickness_m, CARRIER_HZ)
    air = np.exp(2j * np.pi * BOARD.thickness_m / WAVELENGTH_M)
    assert paths.gain[0] == pytest.approx(t_s * air * free_space(3.5))
    assert len(exact_paths(pane(METAL, tx), rx, CARRIER_HZ, config)[0]) == 0
    assert len(exact_paths(pane(tx=tx), rx, CARRIER_HZ, PropagationConfig(max_bounces=0))[0]) == 0


def test_single_bounces_need_no_tracer_and_chains_that_miss_or_repeat_give_no_ray():
    mesh = box((0, 0, 0), (2, 2, 2))
    tx, rx = np.array([-1.0, 1.0, 1.0]), np.array([-1.0, 1.4, 1.0])
    near = np.array([[(0, 0, 0), (0, 2, 2), (0, 2, 0)], [(0, 0, 0), (0, 0, 2), (0, 2, 2)]], float)
    wall = np.array([[(-5, 9, -9), (-5, -9, -9), (-5, 0, 30)]] * 2, float)
    rows = [
        ([S, S], [7, 0], [near[0], wall[0]]),
        ([S, S], [7, 0], [near[0], wall[1]]),
        ([S, S], [7, 0], [near[1], wall[0]]),  # the other half of the square, which the point misses by far
        ([S, S], [0, 0], [wall[0], wall[1]]),  # meets no mesh
    ]
    kind, surface, corner = (np.array(column) for column in zip(*rows, strict=True))
    single, double = mesh_rays(TracedChains(kind, surface, corner), tx, rx, (mesh,), 7)
    np.testing.assert_allclose(single.vertex_m, [[(0.0, 1.2, 1.0)]], atol=1e-12)
    assert single.surface.tolist() == [[7]]
    assert double.surface.tolist() == [[7, 0]]
    np.testing.assert_allclose(double.vertex_m[0], [(0, 1.04, 1.0), (-5, 1.24, 1.0)], atol=1e-12)


def test_no_ray_reflects_within_a_solid():
    tx, rx = np.array([-1.0, 1.0, 1.0]), np.array([-1.0, 1.4, 1.0])
    closed, sheet = box((0, 0, 0), (2, 2, 2)), np.array([(2, 0, 0), (2, 2, 0), (2, 1, 3)], float)
    none = TracedChains(np.zeros((0, 1), int), np.zeros((0, 1), int), np.zeros((0, 1, 3, 3)))
    behind = Clutter("sheet", "clutter", BOARD, sheet, np.array([(0, 1, 2)]))
    [rays] = mesh_rays(none, tx, rx, (closed, behind), 0)
    assert sorted(rays.surface[:, 0].tolist()) == [0, 1]  # the back of the box is met from within, the sheet not


def test_edges_of_a_box_of_a_step_and_of_an_open_sheet():
    edges = mesh_edges([box((0, 0, 0), (2, 1, 1))])
    assert len(edges.length_m) == 12 and edges.length_m.sum() == pytest.approx(16)
    np.testing.assert_allclose(edges.opening_rad, 3 * np.pi / 2)
    middle = np.cos(0.75 * np.pi) * edges.face_0 + np.sin(0.75 * np.pi) * edges.normal_0
    outward = edges.start_m + edges.along * edges.length_m[:, None] / 2 - (1.0, 0.5, 0.5)
    assert np.all((middle * outward).sum(axis=1) > 0)
    rim = mesh_edges(pane().clutter)
    assert len(rim.length_m) == 4 and np.all(rim.opening_rad == 2 * np.pi)


@pytest.mark.parametrize("polarisation", ["soft", "hard"])
def test_edge_of_a_conducting_sheet_is_a_half_plane(polarisation):
    """Vertical polarisation lies along the upright rim, and across the level one."""
    scene = pane(METAL)
    rx = np.array([1.2, 3.4, 1.5]) if polarisation == "soft" else np.array([1.2, 0.5, 4.0])
    tx = scene.tx.position_m
    paths = diffracted_by_meshes(
        mesh_edges(scene.clutter), (tx, rx), [METAL], occluders(scene), CARRIER_HZ, ["pane"], 1
    )
    across = 1 if polarisation == "soft" else 2
    edge = 2.0 if polarisation == "soft" else 3.0
    legs = np.array([[tx[0], tx[across] - edge], [rx[0], rx[across] - edge]])
    phi = np.arctan2(legs[:, 0], -legs[:, 1]) % (2 * np.pi)  # from the sheet, over the side of the receiver
    size = np.linalg.norm(legs, axis=1)
    sign = -1.0 if polarisation == "soft" else 1.0
    expected = wedge_gain(2 * np.pi / WAVELENGTH_M, 2.0, phi[0], phi[1], *size, 1.0, sign, sign)
    nearest = np.abs(paths.delay_s * SPEED_OF_LIGHT_M_S - size.sum()).argmin()
    got = paths.gain[nearest] / free_space(size.sum())
    assert abs(got) == pytest.approx(abs(expected), rel=2e-3)
    assert paths.is_single_bounce.all() and set(paths.bounce_kind[:, 0]) == {BounceKind.DIFFRACTION}
