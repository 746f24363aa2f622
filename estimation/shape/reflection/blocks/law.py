"""The density of incidence points on the faces of a block that both TX and receiver see."""

from typing import NamedTuple

import numpy as np
from scipy.special import log_ndtr, ndtr

from scenes.record import FloatArray

_TINY = 1e-300


class SeenPoints(NamedTuple):
    """Incidence points with the ends of their paths."""

    position_m: FloatArray  # (point, xy)
    covariance_m2: FloatArray  # (point, xy, xy)
    tx_m: FloatArray  # (point, xy)
    rx_m: FloatArray  # (point, xy)


def log_block(block: FloatArray, points: SeenPoints, relief_m: float) -> FloatArray:
    """Log density (block, point) per m^2 of points on blocks [x, y, half width, half depth, turn] (block, 5).

    A point is anywhere on the faces that its TX and its receiver see, all places alike; -inf where they see none.
    Its error and the relief are normal: across the face it has a density, along it the place is integrated from
    one corner to the other.
    """
    center, half, turn = block[:, None, :2], block[:, 2:4], block[:, 4]
    away = points.position_m - center
    total, seen_m = np.zeros(away.shape[:2]), np.zeros(away.shape[:2])
    for side in range(4):
        azimuth = turn + side * np.pi / 2
        normal = np.stack([np.cos(azimuth), np.sin(azimuth)], axis=-1)
        tangent = np.stack([-normal[:, 1], normal[:, 0]], axis=-1)
        depth, reach = half[:, side % 2, None], half[:, 1 - side % 2, None]
        across = np.einsum("bna,ba->bn", away, normal) - depth
        along = np.einsum("bna,ba->bn", away, tangent)
        by_normal = np.einsum("nac,ba->bnc", points.covariance_m2, normal)
        variance = np.einsum("bnc,bc->bn", by_normal, normal) + relief_m**2
        shared = np.einsum("bnc,bc->bn", by_normal, tangent)
        rest = np.einsum("nac,ba,bc->bn", points.covariance_m2, tangent, tangent) - shared**2 / variance
        std, middle = np.sqrt(np.maximum(rest, 0.0) + relief_m**2), along - shared / variance * across
        on_face = _between((-reach - middle) / std, (reach - middle) / std)
        ends = (np.einsum("bna,ba->bn", end - center, normal) - depth for end in (points.tx_m, points.rx_m))
        is_seen = np.all([end > 0 for end in ends], axis=0)
        seen_m += np.where(is_seen, 2 * reach, 0.0)
        total += np.where(
            is_seen, np.exp(-0.5 * across**2 / variance) / np.sqrt(2 * np.pi * variance) * on_face, 0
        )
    with np.errstate(divide="ignore"):
        return np.log(total) - np.log(np.maximum(seen_m, _TINY))


def log_spot(spot: FloatArray, points: SeenPoints) -> FloatArray:
    """Log density (spot, point) per m^2 of points that are normal about spots [x, y, spread] (spot, 3)."""
    away = points.position_m - spot[:, None, :2]
    total = points.covariance_m2 + spot[:, 2, None, None, None] ** 2 * np.eye(2)
    square = np.einsum("bna,bnac,bnc->bn", away, np.linalg.inv(total), away)
    return np.asarray(-0.5 * square - 0.5 * np.linalg.slogdet(2 * np.pi * total)[1])


def _between(low: FloatArray, high: FloatArray) -> FloatArray:
    """Probability (...) of a standard normal value between two; exact in the tails too."""
    flip = low > 0
    low, high = np.where(flip, -high, low), np.where(flip, -low, high)
    inside = np.where(high < 0, np.exp(log_ndtr(high)) - np.exp(log_ndtr(low)), ndtr(high) - ndtr(low))
    return np.asarray(inside)
