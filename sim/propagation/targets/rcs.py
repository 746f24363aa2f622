"""Radar cross-section and polarisation of a scattering point, TR 38.901 clauses 7.9.2.1 and 7.9.2.2."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from scenes.record import ComplexArray, FloatArray, IntArray
from scenes.targets.standard import RcsLobe, TargetClass

LOSS_PER_WIDTH_DB = 12.0  # of a lobe at its 3-dB width
BISTATIC_DB = 3.0  # of model 1, at a bistatic angle of 180 deg
PARTS = 6  # numbers that are drawn for a pair of directions: RCS, polarisation ratio, four phases


def mean_rcs_dbsm(
    standard: TargetClass, heading_rad: float, incident: FloatArray, scattered: FloatArray, point: IntArray | None
) -> FloatArray:
    """10 lg(sigma_M sigma_D) (pair,) in dBsm, equations 7.9.2-2 and 7.9.2-3 without forward scattering.

    `incident` and `scattered` (pair, xyz) are unit vectors from the target towards where the wave comes from and
    goes to; `point` (pair,) is the number of the lobe where each is a point of its own.
    """
    cosine = np.clip((incident * scattered).sum(axis=1), -1.0, 1.0)
    bistatic = np.arccos(cosine)
    if not standard.lobes:
        return np.asarray(standard.mean_dbsm - BISTATIC_DB * np.sin(bistatic / 2))
    azimuth, zenith = _bisector_deg(incident, scattered, heading_rad)
    lobes = standard.lobes
    number = lobe_of(lobes, azimuth, zenith) if point is None else point
    most, depth = (np.array([getattr(lobe, name) for lobe in lobes])[number] for name in ("most_db", "depth_db"))
    off = np.zeros(len(azimuth))
    for index, lobe in enumerate(lobes):
        here = number == index
        off[here] = _off_lobe_db(lobe, azimuth[here], zenith[here])
    k1, k2 = standard.shape
    half = np.maximum(np.cos(bistatic / 2), np.finfo(float).tiny)
    pattern = most - np.minimum(off, depth) - k1 * np.sin(k2 * bistatic / 2) + 5 * np.log10(half)
    return np.asarray(np.maximum(pattern, most - depth))


def lobe_of(lobes: tuple[RcsLobe, ...], azimuth_deg: FloatArray, zenith_deg: FloatArray) -> IntArray:
    """The lobe (pair,) in whose ranges a direction lies; zenith 180 deg belongs to the last range."""
    found = np.full(len(azimuth_deg), -1)
    for index, lobe in enumerate(lobes):
        low, high = lobe.zenith_range_deg
        inside = (zenith_deg >= low) & ((zenith_deg < high) | (high == 180.0))
        first, last = lobe.azimuth_range_deg
        inside &= (azimuth_deg - first) % 360 < last - first
        found[inside & (found < 0)] = index
    return found


def scattering(standard: TargetClass, drawn: FloatArray) -> tuple[FloatArray, ComplexArray]:
    """Factor of the RCS (pair,) and polarisation matrix (pair, 2, 2), from draws (pair, `PARTS`).

    The first two draws are standard normal, the others uniform in [0, 1): sigma_S is log-normal of mean 1
    (equation 7.9.2-1), the ratio of polarisation log-normal, the four phases uniform (equation 7.9.2-5). Rows and
    columns are vertical and horizontal.
    """
    spread = standard.spread_db
    factor_db = spread * drawn[:, 0] - np.log(10) / 20 * spread**2
    ratio_db = standard.xpr_db[0] + standard.xpr_db[1] * drawn[:, 1]
    matrix = np.exp(2j * np.pi * drawn[:, 2:]).reshape(-1, 2, 2)
    matrix[:, [0, 1], [1, 0]] *= 10 ** (-ratio_db / 20)[:, None]
    return 10 ** (factor_db / 10), matrix


@dataclass(frozen=True)
class TargetDraws:
    """Random numbers (target, point, surface, surface, `PARTS`) of one stop.

    The surfaces are those off which the wave is reflected before and after; the last one stands for none.
    """

    value: FloatArray

    @classmethod
    def make(cls, rng: np.random.Generator, n_targets: int, n_points: int, n_surfaces: int) -> TargetDraws:
        """The draws of a stop."""
        shape = (n_targets, n_points, n_surfaces + 1, n_surfaces + 1)
        return cls(np.concatenate([rng.standard_normal((*shape, 2)), rng.random((*shape, PARTS - 2))], axis=-1))


def _off_lobe_db(lobe: RcsLobe, azimuth_deg: FloatArray, zenith_deg: FloatArray) -> FloatArray:
    """Loss (pair,) in dB off the middle of a lobe, each angle at most its depth."""
    loss = np.minimum(
        LOSS_PER_WIDTH_DB * ((zenith_deg - lobe.zenith_deg) / lobe.zenith_width_deg) ** 2, lobe.depth_db
    )
    if lobe.azimuth_deg is None:
        return np.asarray(loss)
    turn = (azimuth_deg - lobe.azimuth_deg + 180) % 360 - 180
    return np.asarray(loss + np.minimum(LOSS_PER_WIDTH_DB * (turn / lobe.azimuth_width_deg) ** 2, lobe.depth_db))


def _bisector_deg(
    incident: FloatArray, scattered: FloatArray, heading_rad: float
) -> tuple[FloatArray, FloatArray]:
    """Azimuth from the front and zenith (pair,) in degrees of the bisector of two directions.

    Opposite directions have none: their scattered one is taken.
    """
    middle = incident + scattered
    size = np.linalg.norm(middle, axis=1, keepdims=True)
    middle = np.where(size > 1e-9, middle / np.maximum(size, 1e-9), scattered)
    azimuth = np.rad2deg(np.arctan2(middle[:, 1], middle[:, 0]) - heading_rad) % 360
    return azimuth, np.rad2deg(np.arccos(np.clip(middle[:, 2], -1, 1)))
