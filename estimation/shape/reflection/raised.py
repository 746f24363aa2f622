"""Objects in the plane that are none: places at a height of their own, and images in floor and ceiling.

Where beams show no elevation, every path is taken as level. The paths by way of a place on the floor or high on a
rough wall are then too long, and so are those of an upright object by way of floor or ceiling: both look like an
edge or a thin pillar behind the true place. Over a walk their length and their cone angles change as no upright
object explains.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from estimation.distributions import normal_log_density
from estimation.execution import compiled
from estimation.laws.plane import bounce, residual, wrapped
from estimation.laws.raised import RAISED_STD_M, image_path, raised_path
from estimation.shape.config import ReflectionConfig
from estimation.shape.kinds.fit import OBJECT_KINDS
from estimation.shape.reflection.association import GATE, GHOST, MIN_GAIN_NAT
from estimation.shape.reflection.levels import on_planes
from estimation.shape.reflection.objects import FoundObject
from estimation.shape.reflection.reflections import Reflections, ray_points
from scenes.record import BoolArray, FloatArray, IntArray

_HEIGHTS_M = (0.7, -0.7, 2.0, -2.0, 4.0)  # over the middle of the devices that fits of places start from
_WAYS_M2 = (4.0, 16.0, 64.0)  # squares of ways up and down that fits of images start from
_CLEAR_M = 1.0  # of floor and ceiling from the devices
_REACH_M = 0.3  # standard deviation of the points of an object about their middle
_WIDER = (20.0, 4.0, 1.0)  # factors on the standard deviations, one search after another
_LEAST_EIGENVALUE = 1e-13  # of an information of unit diagonal; less is rounding
_STEPS = 30
_SETTLED = 1e-4  # of the log posterior
_FIRST_DAMPING, _MOST_DAMPING, _LESS, _MORE = 1e-3, 1e6, 0.3, 10.0
_SAME_M = 0.01  # devices with less between their heights have the same
_FIXED = 1e12  # precision of a third unknown that stays


class Spot(NamedTuple):
    """A point with a third unknown: its height over the RX in m, or of an image that of `image_path`."""

    value: FloatArray  # (3,)
    covariance: FloatArray  # (3, 3)
    log_evidence: float
    is_image: bool


class _Sights(NamedTuple):
    """Paths for compiled code, with what weighs them."""

    tx: FloatArray  # (path, 3)
    state: FloatArray  # (path, 4)
    difference_m: FloatArray  # (path,)
    boresight_rad: FloatArray  # (path, 2)
    measured: FloatArray  # (path, 3)
    inverse: FloatArray  # (path, 3, 3) of the covariances, with those of the poses
    log_norm: FloatArray  # (path,) log density at what is measured
    middle_m: FloatArray  # (xy,) of the points of the paths

    @classmethod
    def of(cls, paths: Reflections) -> "_Sights":
        """The paths of `Reflections`: copies, because arrays of records are read-only, a type of its own."""
        points = ray_points(paths)[0]
        covariance = paths.covariance_with_poses(bounce(paths.tx, paths.rx_state, points).by_state)
        return cls(
            np.array(paths.tx),
            np.array(paths.rx_state),
            np.array(paths.difference_m),
            np.array(paths.boresight_rad),
            np.array(paths.measured),
            np.asarray(np.linalg.inv(covariance)),
            np.asarray(-0.5 * np.linalg.slogdet(2 * np.pi * covariance)[1]),
            np.asarray(np.median(points, axis=0)),
        )


class _Law(NamedTuple):
    """Which spots paths come from: place or image, the normal prior of the third unknown, and the ghosts."""

    is_image: bool
    mean: float
    precision: float
    log_share: float
    log_ghost: float


class UprightPaths(NamedTuple):
    """What is left of paths (path,) without those by way of floor and ceiling, as they look from above."""

    kept: IntArray  # rows of the paths that stay
    shift: FloatArray  # (kept, 3) to take from what they measure: of places at a height
    covariance: FloatArray  # (kept, 3, 3) to add, of the uncertainty of that height

    def of(self, data: Reflections) -> Reflections:
        """These paths of some data."""
        left = data.take("path", self.kept)
        return replace(left, measured=left.measured - self.shift, covariance=left.covariance + self.covariance)

    def rows(self, before: IntArray) -> IntArray:
        """Rows of those that are kept of paths with the rows `before`."""
        return np.flatnonzero(np.isin(self.kept, before))


def upright_paths(
    objects: Sequence[FoundObject], data: Reflections, config: ReflectionConfig
) -> UprightPaths | None:
    """The paths without those of objects on floor or ceiling, and of images; None where nothing is raised.

    Floor and ceiling are heights that many places have. The other places are of rough walls: their paths are seen
    as those of an edge below or above.
    """
    if not np.isfinite(data.difference_m).any():
        return None
    points = np.array([np.median(ray_points(data.take("path", each.paths))[0], axis=0) for each in objects])
    spots = {}
    for k, each in enumerate(objects):
        if (spot := _spot(each, data, np.delete(points, k, axis=0), config)) is not None:
            spots[k] = spot
    if not spots:
        return None
    places = [k for k, spot in spots.items() if not spot.is_image]
    is_level = _on_floor_or_ceiling([spots[k] for k in places], data.difference_m)
    level = {k for k, is_on in zip(places, is_level, strict=True) if is_on}
    shift, covariance = np.zeros((len(data), 3)), np.zeros((len(data), 3, 3))
    kept, members = np.ones(len(data), bool), _members(spots, objects, data)
    for k, spot in spots.items():
        rows = np.flatnonzero(members == k)
        if spot.is_image or k in level:
            kept[rows] = False
        else:
            shift[rows], covariance[rows] = _seen_above(_Sights.of(data.take("path", rows)), spot)
    rows = np.flatnonzero(kept)
    return UprightPaths(rows, shift[rows], covariance[rows])


def _members(spots: Mapping[int, Spot], objects: Sequence[FoundObject], data: Reflections) -> IntArray:
    """The object (path,) of the spot that has each path: its own ones, and those of no object that it explains."""
    owner = np.full(len(data), GHOST)
    for k, each in enumerate(objects):
        owner[each.paths] = k
    free = np.flatnonzero((owner == GHOST) & np.isfinite(data.difference_m))
    if len(free):
        sights, names = _Sights.of(data.take("path", free)), np.array(list(spots))
        off = [residual(_predicted(sights, spot.value, spot.is_image), sights.measured) for spot in spots.values()]
        square = np.array([np.einsum("na,nab,nb->n", each, sights.inverse, each) for each in off])
        owner[free] = np.where(square.min(axis=0) <= GATE, names[square.argmin(axis=0)], GHOST)
    return owner


def _on_floor_or_ceiling(places: Sequence[Spot], difference_m: FloatArray) -> BoolArray:
    """Which places (place,) are on floor or ceiling, away from the devices of height differences (path,)."""
    height = np.array([place.value[2] for place in places]) - np.nanmedian(difference_m) / 2
    variance = np.array([place.covariance[2, 2] for place in places])
    elsewhere = np.exp(normal_log_density(height, 0.0, RAISED_STD_M))
    if np.nanmax(np.abs(difference_m)) < _SAME_M:  # below and above look the same
        height, elsewhere = np.abs(height), 2 * elsewhere
    found = np.abs(height) > _CLEAR_M
    found[found] = on_planes(height[found], variance[found], elsewhere[found])
    return found


def _spot(found: FoundObject, data: Reflections, others_m: FloatArray, config: ReflectionConfig) -> Spot | None:
    """The place or image that explains the paths of an object better than what is upright does; None for none.

    `others_m` (object, xy) are the middles of the points of other objects: images are likely there.
    """
    paths = data.take("path", found.paths)
    if found.kind == "wall" or not np.isfinite(paths.difference_m).all():
        return None
    sights = _Sights.of(paths)
    level = _fitted(sights, (0.0,), config, is_image=True, is_fixed=True)
    if level is None:
        return None
    least = level.log_evidence + MIN_GAIN_NAT
    if found.kind != "edge" and (edge := OBJECT_KINDS["edge"].optimum(paths, config)) is not None:
        least += max(found.optimum.log_evidence - edge.log_evidence, 0.0)
    heights = tuple(np.median(paths.difference_m) / 2 + np.array(_HEIGHTS_M))
    place, image = _fitted(sights, heights, config), _fitted(sights, _WAYS_M2, config, is_image=True)
    spots = [spot for spot in (place, image) if spot is not None and not _is_near(spot)]
    if not spots:
        return None
    best = max(spots, key=lambda spot: spot.log_evidence)
    evidence = best.log_evidence + (_at_others(best, others_m, config) if best.is_image else 0.0)
    return best if evidence > least else None


def _is_near(spot: Spot) -> bool:
    """Whether an image is of a floor or ceiling that is too near to the devices to be one."""
    return spot.is_image and spot.value[2] < (2 * _CLEAR_M) ** 2


def _at_others(image: Spot, others_m: FloatArray, config: ReflectionConfig) -> float:
    """Log odds, at least 0, that an image is of one of the objects at `others_m` (object, xy), not elsewhere."""
    if not len(others_m):
        return 0.0
    spread = image.covariance[:2, :2] + _REACH_M**2 * np.eye(2)
    off = others_m - image.value[:2]
    square = np.einsum("na,ab,nb->n", off, np.linalg.inv(spread), off)
    density = float(np.exp(-0.5 * square).sum() / np.sqrt(np.linalg.det(2 * np.pi * spread)) / len(others_m))
    return max(float(np.log(density * config.area_m2)), 0.0) if density > 0 else 0.0


def _fitted(
    sights: _Sights,
    starts: Sequence[float],
    config: ReflectionConfig,
    *,
    is_image: bool = False,
    is_fixed: bool = False,
) -> Spot | None:
    """The most likely spot of some paths; the third unknown stays at its start where it `is_fixed`."""
    precision = _FIXED if is_fixed else 0.0 if is_image else RAISED_STD_M**-2.0
    prior = 0.5 * np.log(precision / (2 * np.pi)) if precision else -2 * np.log(config.ghost_range_m)
    best: Spot | None = None
    for start in starts:
        law = _Law(
            is_image, start if is_fixed else 0.0, precision, config.log_path_share, config.log_ghost_density
        )
        value, cost, information = _search(sights, law, np.append(sights.middle_m, start), np.array(_WIDER))
        if not _is_determined(information):
            continue
        evidence = float(prior - cost - 0.5 * np.linalg.slogdet(information / (2 * np.pi))[1])
        if best is None or evidence > best.log_evidence:
            best = Spot(value, np.asarray(np.linalg.inv(information)), evidence, is_image)
    return best


def _is_determined(information: FloatArray) -> bool:
    """Whether paths with this information (unknown, unknown) determine all unknowns, up to rounding."""
    scale = np.sqrt(np.maximum(np.diagonal(information), 0.0))
    if not np.isfinite(information).all() or not scale.all():
        return False
    return bool(np.linalg.eigvalsh(information / np.outer(scale, scale))[0] > _LEAST_EIGENVALUE)


def _seen_above(sights: _Sights, spot: Spot) -> tuple[FloatArray, FloatArray]:
    """How much more (path, 3) the paths of a place measure than those of an edge there, and its covariance."""
    seen = _predicted(sights, spot.value, False)
    edge = _predicted(sights, np.array([*spot.value[:2], 0.0]), True)
    higher = _predicted(sights, spot.value + np.array([0.0, 0.0, _SAME_M]), False)
    by_height = residual(higher, seen) / _SAME_M
    return residual(seen, edge), spot.covariance[2, 2] * by_height[:, :, None] * by_height[:, None]


@compiled
def _predict(
    sights: _Sights, i: int, value: FloatArray, is_image: bool, seen: FloatArray, by_point: FloatArray
) -> None:
    """What path i by way of a spot measures (3,), with its derivative (3, 3), both written."""
    tx, state, boresight = sights.tx[i], sights.state[i], sights.boresight_rad[i]
    if is_image:
        image_path(tx, state, value, boresight, seen, by_point)
    else:
        raised_path(tx, state, value, sights.difference_m[i], boresight, seen, np.empty((3, 4)), by_point)


@compiled
def _predicted(sights: _Sights, value: FloatArray, is_image: bool) -> FloatArray:
    """What paths (path, 3) by way of a spot measure."""
    seen, by_point = np.empty((len(sights.tx), 3)), np.empty((3, 3))
    for i in range(len(seen)):
        _predict(sights, i, value, is_image, seen[i], by_point)
    return seen


@compiled
def _search(
    sights: _Sights, law: _Law, start: FloatArray, wider: FloatArray
) -> tuple[FloatArray, float, FloatArray]:
    """The spot (3,) of highest posterior density from a start, minus that in logarithm, and its information.

    Expectation maximisation by Levenberg-Marquardt: first with wide deviations, so that not all paths are ghosts.
    """
    value = start.copy()
    gradient, information = np.empty(3), np.empty((3, 3))
    to, slope = np.empty(3), np.empty((3, 3))
    cost = 0.0
    for factor in wider:
        damping = _FIRST_DAMPING
        cost = _weigh(sights, law, value, factor, gradient, information)
        for _ in range(_STEPS):
            damped = information.copy()
            for axis in range(3):
                damped[axis, axis] += damping * information[axis, axis] + 1e-9
            trial = value - np.linalg.solve(damped, gradient)
            less = _weigh(sights, law, trial, factor, to, slope)
            if less < cost:
                gain, cost = cost - less, less
                value, damping = trial, damping * _LESS
                gradient[:], information[:] = to, slope
                if gain < _SETTLED:
                    break
            else:
                damping *= _MORE
                if damping > _MOST_DAMPING:
                    break
    return value, cost, information


@compiled
def _weigh(
    sights: _Sights, law: _Law, value: FloatArray, factor: float, gradient: FloatArray, information: FloatArray
) -> float:
    """Minus the log posterior of a spot, its gradient (3,) and information (3, 3), both written."""
    off_mean = value[2] - law.mean
    gradient[:], information[:] = 0.0, 0.0
    gradient[2], information[2, 2] = law.precision * off_mean, law.precision
    cost = 0.5 * law.precision * off_mean**2
    seen, by_point, off = np.empty(3), np.empty((3, 3)), np.empty(3)
    for i in range(len(sights.tx)):
        _predict(sights, i, value, law.is_image, seen, by_point)
        off[0] = seen[0] - sights.measured[i, 0]
        off[1], off[2] = wrapped(seen[1] - sights.measured[i, 1]), wrapped(seen[2] - sights.measured[i, 2])
        weighted = sights.inverse[i] @ off / factor**2
        member = law.log_share + sights.log_norm[i] - 3 * np.log(factor) - 0.5 * off @ weighted
        total = np.logaddexp(member, law.log_ghost)
        weight = np.exp(member - total)
        cost -= total
        gradient += weight * (by_point.T @ weighted)
        information += weight / factor**2 * (by_point.T @ sights.inverse[i] @ by_point)
    return float(cost)
