"""The path record: the result of propagation, used by the signal model and, as truth, by scoring."""

from collections import Counter
from dataclasses import dataclass, replace
from enum import IntEnum
from types import MappingProxyType
from typing import Any

import numpy as np

from scenes.pose import SPEED_OF_LIGHT_M_S, azimuth_elevation
from scenes.record import BoolArray, ComplexArray, FloatArray, IntArray, Record, TextArray, array


class BounceKind(IntEnum):
    """Kind of an interaction; NONE fills unused bounce slots."""

    NONE = 0
    SPECULAR = 1
    DIFFUSE = 2
    REFRACTION = 3
    DIFFRACTION = 4
    TARGET = 5


@dataclass(frozen=True)
class PathRates(Record):
    """How paths change at one instant, from the motion of TX, RX and everything that they meet."""

    doppler_hz: FloatArray = array(
        "path", unit="Hz", doc="shift of the carrier, positive where the path gets shorter"
    )
    length_rate_m_s: FloatArray = array(
        "path", unit="m/s", doc="rate of the length, -c / f_c of the Doppler shift"
    )
    length_acceleration_m_s2: FloatArray = array("path", unit="m/s^2", doc="second derivative of the length")
    aod_azimuth_rate_rad_s: FloatArray = array("path", unit="rad/s", doc="rate of the azimuth of departure")
    aod_elevation_rate_rad_s: FloatArray = array("path", unit="rad/s", doc="rate of the elevation of departure")
    aoa_azimuth_rate_rad_s: FloatArray = array("path", unit="rad/s", doc="rate of the azimuth of arrival")
    aoa_elevation_rate_rad_s: FloatArray = array("path", unit="rad/s", doc="rate of the elevation of arrival")

    def __len__(self) -> int:
        return self.size("path")


@dataclass(frozen=True)
class Paths(Record):
    """All propagation paths from the TX to one RX position; zero paths are valid.

    The gain applies between two isotropic, vertically polarised elements. It includes the carrier phase
    exp(-j 2 pi f_c tau) and every interaction; |gain|^2 is received over transmitted power. Directions are in
    the world frame: departure from the TX, arrival from the RX back towards the last interaction.
    Unused bounce slots hold kind NONE, object -1 and NaN vertices; they follow the used slots.
    """

    gain: ComplexArray = array("path", dtype=complex, doc="complex amplitude gain incl. carrier phase")
    delay_s: FloatArray = array("path", unit="s", doc="propagation delay, no clock bias")
    aod_azimuth_rad: FloatArray = array("path", unit="rad", doc="azimuth of departure, world frame")
    aod_elevation_rad: FloatArray = array("path", unit="rad", doc="elevation of departure")
    aoa_azimuth_rad: FloatArray = array("path", unit="rad", doc="azimuth of arrival, world frame")
    aoa_elevation_rad: FloatArray = array("path", unit="rad", doc="elevation of arrival")
    bounce_kind: IntArray = array("path", "bounce", dtype=int, doc="BounceKind of each interaction, TX to RX")
    bounce_object: IntArray = array("path", "bounce", dtype=int, doc="index into object_name, -1 for none")
    vertex_m: FloatArray = array("path", "bounce", "xyz", unit="m", doc="interaction points, TX to RX")
    object_name: TextArray = array("object", dtype=str, doc="names of the scene's objects")
    rates: PathRates | None = None  # absent where nothing moves

    derived = MappingProxyType({"is_los": array("path", dtype=bool, doc="no interaction: the line of sight")})

    def __len__(self) -> int:
        return self.size("path")

    @property
    def length_m(self) -> FloatArray:
        """Length (path,) in m."""
        return np.asarray(self.delay_s * SPEED_OF_LIGHT_M_S)

    @property
    def power(self) -> FloatArray:
        """|gain|^2 (path,): received over transmitted power between isotropic elements."""
        return np.abs(self.gain) ** 2

    @property
    def n_interactions(self) -> IntArray:
        """Number of interactions of any kind (path,): used bounce slots."""
        return np.asarray((self.bounce_kind != BounceKind.NONE).sum(axis=1), int)

    @property
    def n_bounces(self) -> IntArray:
        """Number of interactions that change the direction (path,): all except transmissions through walls."""
        turns = ~np.isin(self.bounce_kind, (BounceKind.NONE, BounceKind.REFRACTION))
        return np.asarray(turns.sum(axis=1), int)

    @property
    def is_los(self) -> BoolArray:
        """Paths without any interaction (path,). A straight path through a wall is not a line of sight."""
        return np.asarray(self.n_interactions == 0)

    @property
    def is_single_bounce(self) -> BoolArray:
        """Paths that change direction exactly once, by any kind of interaction (path,).

        Such a path has one incidence point. Transmissions through walls do not count, because they change neither
        directions nor delay.
        """
        return np.asarray(self.n_bounces == 1)

    @property
    def is_diffuse(self) -> BoolArray:
        """Paths with a diffuse interaction (path,)."""
        return np.asarray((self.bounce_kind == BounceKind.DIFFUSE).any(axis=1))


def canonical_order(paths: Paths) -> Paths:
    """Paths sorted by interactions, kinds, objects, delay and directions, independent of the input order."""
    quantised_delay = np.round(paths.delay_s * 1e15)
    keys = [
        paths.aoa_azimuth_rad, paths.aod_elevation_rad, paths.aod_azimuth_rad, quantised_delay,
        *paths.bounce_object.T[::-1], *paths.bounce_kind.T[::-1], paths.is_diffuse, paths.n_interactions,
    ]  # fmt: skip
    return paths.take("path", np.lexsort(keys))


def with_bounce_slots(paths: Paths, n_slots: int) -> Paths:
    """The same paths with `n_slots` bounce slots each; `ValueError` if a path needs more."""
    if len(paths) and paths.n_interactions.max() > n_slots:
        raise ValueError(
            f"Paths.bounce: {paths.n_interactions.max()} interactions do not fit into {n_slots} slots"
        )
    changes: dict[str, Any] = {}
    for name, filler in (("bounce_kind", BounceKind.NONE), ("bounce_object", -1), ("vertex_m", np.nan)):
        old = getattr(paths, name)[:, :n_slots]
        new = np.full((old.shape[0], n_slots, *old.shape[2:]), filler, old.dtype)
        new[:, : old.shape[1]] = old
        changes[name] = new
    return replace(paths, **changes)


def reversed_paths(paths: Paths) -> Paths:
    """The paths (without rates) from the other end: the gain between equal elements is the same both ways."""
    slot = np.arange(paths.size("bounce"))
    used = paths.n_interactions[:, None]
    order = np.where(slot < used, used - 1 - slot, slot)
    return replace(
        paths,
        aod_azimuth_rad=paths.aoa_azimuth_rad,
        aod_elevation_rad=paths.aoa_elevation_rad,
        aoa_azimuth_rad=paths.aod_azimuth_rad,
        aoa_elevation_rad=paths.aod_elevation_rad,
        bounce_kind=np.take_along_axis(paths.bounce_kind, order, axis=1),
        bounce_object=np.take_along_axis(paths.bounce_object, order, axis=1),
        vertex_m=np.take_along_axis(paths.vertex_m, order[:, :, None], axis=1),
        rates=None,
    )


def empty_paths(object_name: TextArray | list[str], n_slots: int = 1) -> Paths:
    """A record of zero paths in a scene with these objects."""
    none = np.zeros(0)
    unused = np.zeros((0, n_slots), int)
    return Paths(
        gain=none.astype(complex),
        delay_s=none,
        aod_azimuth_rad=none,
        aod_elevation_rad=none,
        aoa_azimuth_rad=none,
        aoa_elevation_rad=none,
        bounce_kind=unused,
        bounce_object=unused,
        vertex_m=np.zeros((0, n_slots, 3)),
        object_name=np.asarray(object_name, str),
    )


def paths_from_field(
    field: ComplexArray,
    length_m: FloatArray,
    departure: FloatArray,
    arrival: FloatArray,
    interactions: tuple[IntArray, IntArray, FloatArray],
    object_name: TextArray | list[str],
    carrier_hz: float,
) -> Paths:
    """Paths whose field is `field` (path,) times that of a free-space wave over the path lengths (path,) in m.

    `departure` and `arrival` (path, xyz) are the directions of travel at the TX and at the receiver;
    `interactions` are kinds (path, bounce), objects (path, bounce) and vertices (path, bounce, xyz).
    """
    wavelength = SPEED_OF_LIGHT_M_S / carrier_hz
    aod_azimuth, aod_elevation = azimuth_elevation(departure)
    aoa_azimuth, aoa_elevation = azimuth_elevation(-arrival)
    kind, item, vertex_m = interactions
    return Paths(
        gain=field * (wavelength / (4 * np.pi * length_m)) * np.exp(-2j * np.pi * length_m / wavelength),
        delay_s=length_m / SPEED_OF_LIGHT_M_S,
        aod_azimuth_rad=aod_azimuth,
        aod_elevation_rad=aod_elevation,
        aoa_azimuth_rad=aoa_azimuth,
        aoa_elevation_rad=aoa_elevation,
        bounce_kind=kind,
        bounce_object=item,
        vertex_m=vertex_m,
        object_name=np.asarray(object_name, str),
    )


def single_interaction(
    kind: BounceKind, item: IntArray | int, vertex_m: FloatArray
) -> tuple[IntArray, IntArray, FloatArray]:
    """Kinds, objects and vertices of paths with one interaction each, at `vertex_m` (path, xyz)."""
    shape = (len(vertex_m), 1)
    return np.full(shape, kind), np.broadcast_to(np.reshape(item, (-1, 1)), shape), vertex_m[:, None]


def path_labels(paths: Paths) -> TextArray:
    """A readable label (path,) that is the same in every run: the interactions and, for equal ones, a number.

    Kinds are S specular, D diffuse, R refraction (through a wall), X diffraction, T target: 'LOS', 'S wall_east',
    'R door > S wall_east #1'; 'R door' is the straight path through the door. Paths with the same interactions
    are numbered by delay, from #1 for the second.
    """
    names = [*paths.object_name.tolist(), "?"]  # the last name is for unknown objects: index -1
    letters = {
        BounceKind.SPECULAR: "S",
        BounceKind.DIFFUSE: "D",
        BounceKind.REFRACTION: "R",
        BounceKind.DIFFRACTION: "X",
        BounceKind.TARGET: "T",
    }
    chains = [
        " > ".join(
            f"{letters[BounceKind(kind)]} {names[item]}"
            for kind, item in zip(kinds, objects, strict=True)
            if kind != BounceKind.NONE
        )
        or "LOS"
        for kinds, objects in zip(paths.bounce_kind, paths.bounce_object, strict=True)
    ]
    labels = np.array(chains, dtype=object)
    seen: Counter[str] = Counter()
    for index in np.lexsort([paths.aoa_azimuth_rad, paths.delay_s]):
        chain = chains[index]
        labels[index] = f"{chain} #{seen[chain]}" if seen[chain] else chain
        seen[chain] += 1
    return labels.astype(str)
