"""Gain, delay and directions of rays: the field vector after all reflections and transmissions."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from scenes.pose import SPEED_OF_LIGHT_M_S
from scenes.record import BoolArray, ComplexArray, FloatArray, IntArray, Record, array
from scenes.scene import Scene
from sim.propagation.occlusion import Crossings
from sim.propagation.paths import BounceKind, Paths, paths_from_field
from sim.propagation.specular.fresnel import normal_to_plane_of_incidence, slab, vertical_polarisation
from sim.propagation.specular.rays import Rays

Polarisation = Callable[[FloatArray], FloatArray]  # unit vectors of the field of waves in these directions

MIN_LEG_M = 1e-9  # shorter legs are rounding


@dataclass(frozen=True)
class Slabs(Record):
    """Electrical constants of all surfaces at the carrier, in the order of `surface_names`."""

    carrier_hz: float
    permittivity: ComplexArray = array("object", dtype=complex, doc="relative, negative imaginary part")
    thickness_m: FloatArray = array("object", unit="m", doc="of the slab behind every face")
    specular: FloatArray = array("object", doc="share of the reflected field that is not scattered")

    def opaque(self, max_loss_db: float) -> BoolArray:
        """Surfaces (object,) that lose more than `max_loss_db` in transmission under every angle."""
        cosine = np.linspace(0.02, 1, 99)[:, None] * np.ones(len(self.thickness_m))
        _, (t_s, t_p) = slab(cosine, self.permittivity, self.thickness_m, self.carrier_hz)
        strongest = np.maximum(np.abs(t_s), np.abs(t_p)).max(axis=0, initial=0)
        return np.asarray(strongest < 10 ** (-max_loss_db / 20))


def scene_slabs(scene: Scene, carrier_hz: float) -> Slabs:
    """The slab of every surface of a scene."""
    planes = [plane.material for plane in (scene.floor, scene.ceiling) if plane is not None]
    materials = [*(item.material for item in scene.objects), *planes, *(item.material for item in scene.clutter)]
    return Slabs(
        carrier_hz,
        np.array([material.complex_permittivity(carrier_hz) for material in materials], complex),
        np.array([material.thickness_m for material in materials]),
        np.sqrt(1 - np.array([material.scattering_coefficient for material in materials]) ** 2),
    )


@dataclass(frozen=True)
class Interactions(Record):
    """Interactions along every ray: reflections and transmissions in order; -1 if unused."""

    kind: IntArray = array("ray", "event", dtype=int, doc="BounceKind")
    surface: IntArray = array("ray", "event", dtype=int, doc="index of the object")
    vertex_m: FloatArray = array("ray", "event", "xyz", unit="m", doc="where; NaN where unused")
    normal: FloatArray = array("ray", "event", "xyz", doc="unit normal of the face")
    leg: IntArray = array("ray", "event", dtype=int, doc="leg before the event")


def ray_interactions(rays: Rays, points_m: FloatArray, met: Crossings, n_slots: int) -> Interactions:
    """Reflections and crossings of rays, sorted along each ray, with `n_slots` slots each."""
    n_rays, n_legs = len(points_m), points_m.shape[1] - 1
    ray, leg = met.leg // n_legs, met.leg % n_legs
    row = np.concatenate([np.repeat(np.arange(n_rays), n_legs - 1), ray])
    before = np.concatenate([np.tile(np.arange(n_legs - 1), n_rays), leg])
    place = np.concatenate([np.tile(np.arange(1.0, n_legs), n_rays), leg + met.share])
    start = points_m[ray, leg]
    crossed = start + met.share[:, None] * (points_m[ray, leg + 1] - start)
    kinds = np.repeat([int(BounceKind.SPECULAR), int(BounceKind.REFRACTION)], [n_rays * (n_legs - 1), len(ray)])
    order = np.lexsort([place, row])
    row = row[order]
    slot = np.arange(len(row)) - np.searchsorted(row, row)

    def table(values: FloatArray | IntArray, filler: float) -> FloatArray:
        filled = np.full((n_rays, n_slots, *values.shape[1:]), filler, values.dtype)
        filled[row, slot] = values[order]
        return filled

    return Interactions(
        kind=table(kinds, BounceKind.NONE).astype(int),
        surface=table(np.concatenate([rays.surface.ravel(), met.surface]), -1).astype(int),
        vertex_m=table(np.concatenate([rays.vertex_m.reshape(-1, 3), crossed]), np.nan),
        normal=table(np.concatenate([rays.normal.reshape(-1, 3), met.normal]), 0.0),
        leg=table(before, 0).astype(int),
    )


def paths_of_rays(
    rays: Rays,
    points_m: FloatArray,
    happening: Interactions,
    known: Slabs,
    names: list[str],
    max_loss_db: float,
    receives: Polarisation = vertical_polarisation,
) -> tuple[Paths, BoolArray]:
    """The rays as a path record, and a mask (ray,) of the valid ones; `receives` is the receiver's polarisation.

    Rays that lose more than `max_loss_db` in transmission are not valid, nor rays that bounce twice at one point,
    where two surfaces join.
    """
    travel = np.diff(points_m, axis=1)
    leg_m = np.sqrt((travel * travel).sum(axis=2))
    length = leg_m.sum(axis=1)
    direction = travel / np.maximum(leg_m, MIN_LEG_M)[..., None]
    received, transmitted = _received(direction, happening, known, receives)
    interactions = happening.kind, happening.surface, happening.vertex_m
    paths = paths_from_field(
        received * rays.spreading, length, direction[:, 0], direction[:, -1], interactions, names, known.carrier_hz
    )
    return paths, (transmitted >= 10 ** (-max_loss_db / 20)) & (leg_m > MIN_LEG_M).all(axis=1)


def _received(
    direction: FloatArray, happening: Interactions, known: Slabs, receives: Polarisation
) -> tuple[ComplexArray, FloatArray]:
    """Field between a vertical antenna and the receiver's (ray,), and the transmitted share of the amplitude."""
    ray = np.arange(len(direction))
    field = vertical_polarisation(direction[:, 0]).astype(complex)
    transmitted = np.ones(len(direction))
    for slot in range(happening.kind.shape[1]):
        kind, leg = happening.kind[:, slot], happening.leg[:, slot]
        used = np.flatnonzero(kind != BounceKind.NONE)
        if not len(used):
            break
        reflects = kind[used] == BounceKind.SPECULAR
        before = direction[used, leg[used]]
        after = np.where(reflects[:, None], direction[used, leg[used] + reflects], before)
        passed = _interact(
            field[used],
            before,
            after,
            happening.normal[used, slot],
            happening.surface[used, slot],
            reflects,
            known,
        )
        loss = _size(passed) / np.maximum(_size(field[used]), 1e-300)
        transmitted[used] *= np.where(reflects, 1.0, loss)
        field[used] = passed
    return (field * receives(direction[ray, -1])).sum(axis=1), transmitted


def _interact(
    field: ComplexArray,
    before: FloatArray,
    after: FloatArray,
    normal: FloatArray,
    surface: IntArray,
    reflects: BoolArray,
    known: Slabs,
) -> ComplexArray:
    """Field vectors (ray, xyz) after one reflection or transmission each.

    The slab replaces air, so a transmission has the phase of the slab minus the phase of its thickness in air.
    """
    cosine = np.abs((before * normal).sum(axis=1))
    thickness = known.thickness_m[surface]
    (r_s, r_p), (t_s, t_p) = slab(cosine, known.permittivity[surface], thickness, known.carrier_hz)
    air = np.exp(2j * np.pi * known.carrier_hz / SPEED_OF_LIGHT_M_S * thickness * cosine)
    on_s = np.where(reflects, r_s * known.specular[surface], t_s * air)
    on_p = np.where(reflects, r_p * known.specular[surface], t_p * air)
    s_vector = normal_to_plane_of_incidence(before, normal)
    p_before, p_after = np.cross(s_vector, before), np.cross(s_vector, after)
    along_s, along_p = (field * s_vector).sum(axis=1), (field * p_before).sum(axis=1)
    return np.asarray((on_s * along_s)[:, None] * s_vector + (on_p * along_p)[:, None] * p_after)


def _size(field: ComplexArray) -> FloatArray:
    return np.asarray(np.sqrt((field.real**2 + field.imag**2).sum(axis=1)))
