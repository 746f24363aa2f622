"""Conversion of the single-precision result of a ray tracer to a path record."""

import numpy as np

from scenes.pose import SPEED_OF_LIGHT_M_S, azimuth_elevation
from scenes.record import ComplexArray, FloatArray, IntArray
from sim.propagation.paths import BounceKind, Paths, with_bounce_slots


def traced_paths(
    *,
    amplitude: ComplexArray,
    kind: IntArray,
    surface: IntArray,
    vertex: FloatArray,
    ends: tuple[FloatArray, FloatArray],
    carrier_hz: float,
    names: list[str],
    n_slots: int,
) -> Paths:
    """Path record with delays, directions and the carrier phase in double precision from the vertices.

    `amplitude` (path,) does not include the phase of the path length: with a single-precision delay this phase
    would have an error of several milliradians at 60 GHz. `kind` and `surface` are
    (path, bounce), `vertex` is (path, bounce, xyz) in m, `ends` are TX and RX (xyz,) in m. The record has
    `n_slots` bounce slots.
    """
    tx, rx = ends
    used = (kind != BounceKind.NONE)[..., None]
    # An unused slot is placed at the receiver, so it adds no length. The arrival direction uses the last vertex.
    points = np.concatenate(
        [
            np.broadcast_to(tx, (len(kind), 1, 3)),
            np.where(used, vertex, rx),
            np.broadcast_to(rx, (len(kind), 1, 3)),
        ],
        axis=1,
    )
    last = points[np.arange(len(kind)), used.sum(axis=(1, 2))]
    delay_s = np.linalg.norm(np.diff(points, axis=1), axis=2).sum(axis=1) / SPEED_OF_LIGHT_M_S
    aod_azimuth, aod_elevation = azimuth_elevation(points[:, 1] - tx)
    aoa_azimuth, aoa_elevation = azimuth_elevation(last - rx)
    paths = Paths(
        gain=amplitude * np.exp(-2j * np.pi * carrier_hz * delay_s),
        delay_s=delay_s,
        aod_azimuth_rad=aod_azimuth,
        aod_elevation_rad=aod_elevation,
        aoa_azimuth_rad=aoa_azimuth,
        aoa_elevation_rad=aoa_elevation,
        bounce_kind=kind,
        bounce_object=surface,
        vertex_m=np.where(used, vertex, np.nan),
        object_name=np.asarray(names, str),
    )
    return with_bounce_slots(paths, n_slots)
