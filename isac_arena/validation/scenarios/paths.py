"""Path records without a scene: random ones, and the line of sight through free space."""

from typing import Any

import numpy as np

from scenes.pose import SPEED_OF_LIGHT_M_S, Pose, azimuth_elevation
from scenes.record import FloatArray
from sim.propagation.paths import Paths


def made_paths(gain: Any, delay_s: Any, departure_rad: Any, arrival_rad: Any) -> Paths:
    """Paths without interactions, from gains (path,), delays (path,) and azimuths with elevations (2, path)."""
    columns: list[Any] = [np.atleast_1d(column) for column in (gain, delay_s, *departure_rad, *arrival_rad)]
    count = len(columns[0])
    columns += [np.zeros((count, 1), int), np.full((count, 1), -1), np.full((count, 1, 3), np.nan)]
    columns.append(np.array(["none"]))
    return Paths(*columns)


def random_paths(
    rng: np.random.Generator, count: int, azimuth_rad: float = 1.2, elevation_rad: float = 0.5
) -> Paths:
    """Paths of a hall: delays of 10 to 300 ns, thinning out exponentially, angles within these on either side."""
    phase = rng.uniform(0, 2 * np.pi, count)
    delay_s = 10e-9 + np.minimum(rng.exponential(40e-9, count), 290e-9)
    limits = np.array([[azimuth_rad], [elevation_rad]])
    return made_paths(
        np.exp(1j * phase - (delay_s - 10e-9) / 80e-9) / np.sqrt(max(count, 1)),
        delay_s,
        limits * rng.uniform(-1, 1, (2, count)),
        limits * rng.uniform(-1, 1, (2, count)),
    )


def free_space(tx: Pose, rx: Pose, carrier_hz: float = 60e9) -> Paths:
    """The unobstructed line of sight alone: lambda / (4 pi d), with the carrier's phase."""
    distance_m = float(np.linalg.norm(rx.position_m - tx.position_m))
    wavelength_m = SPEED_OF_LIGHT_M_S / carrier_hz
    return made_paths(
        wavelength_m / (4 * np.pi * distance_m) * np.exp(-2j * np.pi * distance_m / wavelength_m),
        distance_m / SPEED_OF_LIGHT_M_S,
        azimuth_elevation([rx.position_m - tx.position_m]),
        azimuth_elevation([tx.position_m - rx.position_m]),
    )


def over_points(points_m: FloatArray) -> tuple[float, float, float]:
    """Length in m, and world azimuths of departure and arrival in rad, of a path over points (point, xy)."""
    length = float(np.linalg.norm(np.diff(points_m, axis=0), axis=1).sum())
    first, last = points_m[1] - points_m[0], points_m[-2] - points_m[-1]
    return length, float(np.arctan2(first[1], first[0])), float(np.arctan2(last[1], last[0]))
