"""What the bundle needs of each kind of contour: its family, its fit alone, its prior and its record."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

from estimation.laws.contour import EDGE, WALL
from estimation.laws.support import CIRCLE, CLOSED_FAMILY
from estimation.shape.fit import ShapeFit
from estimation.shape.kinds.arc import arc_prior, arc_shape, fit_bent
from estimation.shape.kinds.closed import closed_prior, closed_shape, fit_closed
from estimation.shape.kinds.edge import edge_shape, fit_point, point_prior
from estimation.shape.kinds.mirror_wall import fit_wall, wall_prior, wall_shape
from estimation.shape.reflection.posterior import Optimum, Prior
from estimation.shape.reflection.reflections import ReflectionConfig, Reflections
from scenes.record import FloatArray


class _Open(NamedTuple):
    family: int
    fit: Callable[[Reflections, ReflectionConfig], Optimum | None]
    prior: Callable[[ReflectionConfig], Prior]


_OPEN = {
    "wall": _Open(WALL, fit_wall, wall_prior),
    "arc": _Open(CIRCLE, fit_bent, arc_prior),
    "edge": _Open(EDGE, fit_point, point_prior),
}


@dataclass(frozen=True)
class BundleObject:
    """The paths of one object and the kind of contour they are fitted with: closed, `wall`, `arc` or `edge`.

    `prior` replaces the settings of the bundle for this object's own parameters.
    """

    kind: str
    paths: Reflections
    prior: ReflectionConfig | None = None


def family_of_kind(kind: str) -> int:
    """Family of `estimation.laws.contour.predict`."""
    return _OPEN[kind].family if kind in _OPEN else CLOSED_FAMILY[kind]


def start_of(each: BundleObject, config: ReflectionConfig) -> Optimum | None:
    """The object's fit alone, None without one; `ValueError` for an unknown kind."""
    if each.kind not in (*CLOSED_FAMILY, *_OPEN):
        raise ValueError(f"kind = '{each.kind}': must be one of {', '.join((*CLOSED_FAMILY, *_OPEN))}")
    settings = _settings(each, config)
    if len(each.paths) == 0:
        return None
    if each.kind in _OPEN:
        return _OPEN[each.kind].fit(each.paths, settings)
    return fit_closed(each.paths, each.kind, settings)


def prior_of(each: BundleObject, start: FloatArray, config: ReflectionConfig) -> Prior:
    """Prior of the object's own parameters."""
    settings = _settings(each, config)
    return (
        _OPEN[each.kind].prior(settings) if each.kind in _OPEN else closed_prior(each.kind, start, settings)
    )


def shape_of(each: BundleObject, found: Optimum, solved: Reflections, config: ReflectionConfig) -> ShapeFit:
    """The record of an object; `solved` are its paths with the receivers where they were found to be."""
    if each.kind == "wall":
        return wall_shape(found, solved)
    if each.kind == "edge":
        return edge_shape(found)
    settings = _settings(each, config)
    return arc_shape(found, settings) if each.kind == "arc" else closed_shape(found, each.kind, settings)


def _settings(each: BundleObject, config: ReflectionConfig) -> ReflectionConfig:
    """The bundle's settings with the object's own priors."""
    if each.prior is None:
        return config
    own = {"radius_median_m": each.prior.radius_median_m, "radius_log_std": each.prior.radius_log_std}
    return config.model_copy(update=own)
