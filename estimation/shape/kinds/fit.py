"""Every kind of object by name: its family of contours, its fit, its prior and its record."""

from collections.abc import Callable, Mapping
from functools import partial
from typing import NamedTuple

from estimation.laws.contour import EDGE, WALL
from estimation.laws.support import CIRCLE, CLOSED_FAMILY
from estimation.shape.config import ReflectionConfig
from estimation.shape.fit import ShapeFit, failed_fit
from estimation.shape.kinds.arc import arc_prior, arc_shape, fit_arc
from estimation.shape.kinds.closed import closed_prior, closed_shape, fit_closed, refit_closed
from estimation.shape.kinds.edge import edge_prior, edge_shape, fit_edge
from estimation.shape.kinds.mirror_wall import fit_wall, wall_prior, wall_shape
from estimation.shape.reflection.posterior import Optimum, Prior
from estimation.shape.reflection.reflections import Reflections
from scenes.record import FloatArray


class ObjectKind(NamedTuple):
    """How one kind of object is fitted to paths."""

    family: int  # of `estimation.laws.contour.predict`
    optimum: Callable[[Reflections, ReflectionConfig], Optimum | None]  # None: singular information
    prior: Callable[[FloatArray, ReflectionConfig], Prior]  # of the parameters, given the start
    shape: Callable[[Optimum, Reflections, ReflectionConfig], ShapeFit]  # the record


OBJECT_KINDS: Mapping[str, ObjectKind] = {
    **{
        kind: ObjectKind(
            family, partial(fit_closed, kind), partial(closed_prior, kind), partial(closed_shape, kind)
        )
        for kind, family in CLOSED_FAMILY.items()
    },
    "wall": ObjectKind(WALL, fit_wall, wall_prior, wall_shape),
    "arc": ObjectKind(CIRCLE, fit_arc, arc_prior, arc_shape),
    "edge": ObjectKind(EDGE, fit_edge, edge_prior, edge_shape),
}


def object_kind(kind: str) -> ObjectKind:
    """The entry of `OBJECT_KINDS`. Raises `ValueError` for an unknown kind."""
    if kind not in OBJECT_KINDS:
        raise ValueError(f"kind = '{kind}': must be one of {', '.join(OBJECT_KINDS)}")
    return OBJECT_KINDS[kind]


def fit_kind(data: Reflections, kind: str, config: ReflectionConfig) -> ShapeFit:
    """Fit one kind of object to its paths.

    The parameters are: closed contour [x, y, log R, shape ...]; wall [azimuth of the normal in rad, offset in m,
    first and last illuminated place along the wall in m]; arc [x, y, log R] of its circle; edge [x, y]; in m.
    The status is `failed` without a path or where the information is singular, `prior` where the paths do not
    reduce the uncertainty of the radius of a closed contour. Raises `ValueError` for an unknown kind.
    """
    methods = object_kind(kind)
    if len(data) == 0:
        return failed_fit(kind, "no paths")
    found = methods.optimum(data, config)
    return failed_fit(kind, "singular information") if found is None else methods.shape(found, data, config)


def refit_kind(data: Reflections, known: ShapeFit, config: ReflectionConfig) -> ShapeFit:
    """Fit a closed contour again, from a fit to the same paths under another prior of the radius."""
    found = refit_closed(known.kind, known.parameter, data, config)
    if found is None:
        return failed_fit(known.kind, "singular information")
    return closed_shape(known.kind, found, data, config)
