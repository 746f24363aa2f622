"""The exact solver as a whole: against shot rays, through walls, over lids, and in its symmetries."""

import numpy as np
import pytest

from isac_arena.validation.propagation import closed_form
from isac_arena.validation.propagation import specular as checks
from isac_arena.validation.scenarios.solids import GLASS, METAL, STONE, box_walls, scene_of
from scenes.contours import Circle, Polyline, rectangle
from scenes.pose import SPEED_OF_LIGHT_M_S
from sim.config import PropagationConfig
from sim.propagation.paths import BounceKind
from sim.propagation.specular.fresnel import slab_transmission
from sim.propagation.specular.solver import exact_paths

CARRIER_HZ = 60e9
WAVELENGTH_M = SPEED_OF_LIGHT_M_S / CARRIER_HZ
THROUGH = PropagationConfig(transmission=True, max_bounces=1)


@pytest.mark.parametrize(
    "check",
    [
        closed_form.check_two_ray,
        closed_form.check_box_room,
        checks.check_lit_pillar,
        checks.check_stationarity,
        closed_form.check_concave_gain,
        closed_form.check_continuity,
        closed_form.check_power,
        checks.check_symmetries,
        checks.check_same_bits,
    ],
)
def test_validation_meets_its_bars(check):
    for row in check(3, True):
        assert row.met, row


@pytest.mark.slow
def test_no_path_that_shot_rays_find_is_missed():
    for row in checks.check_against_shooting(3, True):
        assert row.met, row


def test_a_pane_transmits_and_is_recorded():
    scene = scene_of([-2.0, 0.0, 1.0], [Polyline(np.array([(0.0, -3.0), (0.0, 3.0)]))], (GLASS,))
    rx = np.array([2.0, 1.0, 1.5])
    [paths] = exact_paths(scene, rx, CARRIER_HZ, THROUGH)
    assert paths.bounce_kind[:, :2].tolist() == [[BounceKind.REFRACTION, BounceKind.NONE]]
    np.testing.assert_allclose(paths.vertex_m[0, 0], [0.0, 0.5, 1.25], atol=1e-12)
    distance = np.sqrt(16 + 1 + 0.25)
    t_s, t_p = slab_transmission(
        4 / distance, GLASS.complex_permittivity(CARRIER_HZ), GLASS.thickness_m, CARRIER_HZ
    )
    free = WAVELENGTH_M / (4 * np.pi * distance)
    low, high = sorted([abs(t_s), abs(t_p)])
    assert low * free <= abs(paths.gain[0]) <= high * free
    assert paths.delay_s[0] * SPEED_OF_LIGHT_M_S == pytest.approx(distance)
    assert len(exact_paths(scene, rx, CARRIER_HZ, PropagationConfig(max_bounces=1))[0]) == 0


def test_level_wave_through_a_hollow_wall_is_multiplied_twice():
    scene = scene_of([-2.0, 0.0, 1.0], [rectangle((0.0, 0.2), (-3.0, 3.0))], (GLASS,))
    [paths] = exact_paths(scene, np.array([2.0, 0.0, 1.0]), CARRIER_HZ, THROUGH)
    t_s, _ = slab_transmission(1.0, GLASS.complex_permittivity(CARRIER_HZ), GLASS.thickness_m, CARRIER_HZ)
    air = np.exp(2j * np.pi * GLASS.thickness_m / WAVELENGTH_M)
    free = WAVELENGTH_M / (16 * np.pi) * np.exp(-8j * np.pi / WAVELENGTH_M)
    assert paths.gain[0] == pytest.approx(free * (t_s * air) ** 2)
    assert paths.bounce_object[0, :3].tolist() == [0, 0, -1]
    thin = PropagationConfig(transmission=True, max_bounces=1, max_crossed_faces=1)
    assert len(exact_paths(scene, np.array([2.0, 0.0, 1.0]), CARRIER_HZ, thin)[0]) == 0


def test_metal_lets_nothing_through_and_the_loss_is_limited():
    wall = rectangle((0.0, 0.2), (-3.0, 3.0))
    rx = np.array([2.0, 0.0, 1.0])
    assert len(exact_paths(scene_of([-2.0, 0, 1], [wall], (METAL,)), rx, CARRIER_HZ, THROUGH)[0]) == 0
    strict = PropagationConfig(transmission=True, max_bounces=1, max_transmission_loss_db=1.0)
    scene = scene_of([-2.0, 0, 1], [wall], (STONE,))
    assert len(exact_paths(scene, rx, CARRIER_HZ, strict)[0]) == 0


def test_a_table_reflects_where_it_stands():
    scene = scene_of([-2.0, 0.0, 2.0], [rectangle((-0.5, 0.5), (-0.5, 0.5))], (METAL,), height_m=1.0)
    [over] = exact_paths(scene, np.array([2.0, 0.2, 2.0]), CARRIER_HZ, PropagationConfig(max_bounces=1))
    [beside] = exact_paths(scene, np.array([2.0, 1.2, 2.0]), CARRIER_HZ, PropagationConfig(max_bounces=1))
    assert over.n_bounces.tolist() == [0, 1]
    np.testing.assert_allclose(over.vertex_m[1, 0], [0.0, 0.1, 1.0], atol=1e-12)
    assert beside.n_bounces.tolist() == [0]


def test_receiver_straight_above_the_transmitter():
    scene = scene_of([2.0, 2.0, 1.0], box_walls(5.0, 4.0), floor=True)
    [paths] = exact_paths(scene, np.array([2.0, 2.0, 2.0]), CARRIER_HZ, PropagationConfig(max_bounces=1))
    assert len(paths) == 7
    assert np.all(np.isfinite(paths.gain))


def test_a_mirror_and_a_pillar_in_both_orders():
    scene = scene_of([0.0, 0.0, 1.0], [rectangle((-6, 6), (3.0, 3.2)), Circle(np.array([1.5, -1.0]), 0.3)])
    [paths] = exact_paths(scene, np.array([3.0, 0.5, 1.4]), CARRIER_HZ)
    chains = sorted(tuple(row[row >= 0].tolist()) for row in paths.bounce_object)
    assert chains == [(), (0,), (0, 1), (1,), (1, 0)]
