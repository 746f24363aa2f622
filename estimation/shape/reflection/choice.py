"""Choice by evidence of the kind of object: wall, edge point or pillar, and which closed contour."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any

import numpy as np
import shapely
from scipy.special import ndtr

from estimation.shape.config import ReflectionConfig
from estimation.shape.fit import ShapeFit
from estimation.shape.kinds.fit import fit_kind, refit_kind
from estimation.shape.reflection.reflections import Reflections
from scenes.record import FloatArray

_BAND_SHARE, _BAND_STDS = 0.95, 1.959964
_BISECTIONS = 40
# Prior share of each kind within its class: half of all pillars are round, a quarter of all walls are curved.
CLASSES: Mapping[str, Mapping[str, float]] = {
    "wall": {"wall": 0.75, "arc": 0.25},
    "edge": {"edge": 1.0},
    "pillar": {"circle": 0.5, "ellipse": 0.25, "rounded_square": 0.25},
}


@dataclass(frozen=True)
class Choice:
    """Fits of all kinds with their posterior probabilities; all classes have the same prior."""

    fits: Mapping[str, ShapeFit]
    probability: Mapping[str, float]  # of each kind
    class_probability: Mapping[str, float]
    log_evidence: float  # of all kinds together

    @property
    def best_class(self) -> str:
        """The most probable class."""
        return max(self.class_probability, key=lambda name: self.class_probability[name])

    @property
    def best(self) -> ShapeFit:
        """The fit to use, of the most probable class.

        For open contours it is the most probable kind. For closed contours it is the fit with the largest
        expected intersection over union with the others, weighted by their probabilities of being the truth.
        """
        kinds = [kind for kind in CLASSES[self.best_class] if self.fits[kind].is_usable]
        if not all(self.fits[kind].is_closed for kind in kinds):
            return self.fits[max(kinds, key=lambda kind: self.probability[kind])]
        areas = {kind: shapely.Polygon(self.fits[kind].contour_m).buffer(0.0) for kind in kinds}

        def expected(kind: str) -> float:
            return sum(self.probability[other] * _overlap(areas[kind], areas[other]) for other in kinds)

        return self.fits[max(kinds, key=expected)]


def averaged_band(shape: ShapeFit, choice: Choice) -> ShapeFit:
    """The closed contour of the chosen kind with a 95 % band over all kinds of its class, by their probabilities.

    Contours are sampled at the same normals: the support functions of two kinds differ across the contour.
    """
    kinds = [kind for kind in CLASSES["pillar"] if choice.probability[kind] > 0 and choice.fits[kind].is_usable]
    if not shape.is_closed or shape.kind not in kinds:
        return shape
    share = np.array([choice.probability[kind] for kind in kinds])
    psi = np.linspace(-np.pi, np.pi, len(shape.contour_m), endpoint=False)
    normal, own = np.column_stack([np.cos(psi), np.sin(psi)]), choice.fits[shape.kind]
    away_m = np.array([np.sum(normal * (choice.fits[kind].contour_m - own.contour_m), axis=1) for kind in kinds])
    std_m = np.array([(shape if kind == shape.kind else choice.fits[kind]).std_m for kind in kinds])
    return replace(shape, std_m=_mixed_std(share / share.sum(), away_m, std_m))


def _mixed_std(share: FloatArray, mean: FloatArray, std: FloatArray) -> FloatArray:
    """Deviation (sample,) of a normal law about 0 with the 95 % interval of a mixture (kind, sample)."""
    low, high = np.zeros(mean.shape[1]), (np.abs(mean) + _BAND_STDS * 2 * std).max(axis=0)
    for _ in range(_BISECTIONS):
        middle = (low + high) / 2
        inside = share @ (ndtr((middle - mean) / std) - ndtr((-middle - mean) / std))
        low, high = np.where(inside < _BAND_SHARE, middle, low), np.where(inside < _BAND_SHARE, high, middle)
    return np.asarray(high / _BAND_STDS)


def choose_shape(
    data: Reflections,
    config: ReflectionConfig,
    classes: Sequence[str] = tuple(CLASSES),
    shares: Mapping[str, float] = MappingProxyType({}),
    known: Mapping[str, ShapeFit] = MappingProxyType({}),
) -> Choice:
    """Fit every kind of object of the classes to the paths and weight the fits by their evidence.

    `shares` replaces the prior shares of kinds within their class. `known` are fits to the same paths under
    another prior of the radius of a pillar: only pillars are fitted again, each from its fit. No body holds a
    device. Raises `ValueError` where there is no path or every fit failed.
    """
    if len(data) == 0:
        raise ValueError("choose_shape: data holds 0 paths, at least one is needed")
    share = {kind: shares.get(kind, own) for name in classes for kind, own in CLASSES[name].items()}
    fits = {kind: _fit(data, kind, config, known.get(kind)) for kind in share}
    usable = {kind: fit.log_evidence + np.log(share[kind]) for kind, fit in fits.items() if fit.is_usable}
    free = {kind: value for kind, value in usable.items() if not _holds_device(fits[kind], data)}
    usable = free or usable
    if not usable:
        raise ValueError(f"choose_shape: no kind fits the {len(data)} paths; check the poses")
    total = np.logaddexp.reduce(list(usable.values()))
    probability = {kind: float(np.exp(usable.get(kind, -np.inf) - total)) for kind in share}
    by_class = {name: sum(probability[kind] for kind in CLASSES[name]) for name in classes}
    return Choice(fits, probability, by_class, float(total))


def _fit(data: Reflections, kind: str, config: ReflectionConfig, known: ShapeFit | None) -> ShapeFit:
    if known is None or not known.is_usable:
        return fit_kind(data, kind, config)
    return refit_kind(data, known, config) if kind in CLASSES["pillar"] else known


def _holds_device(fit: ShapeFit, data: Reflections) -> bool:
    """Whether a TX or a receiver of the paths is inside a closed contour: there is no such body."""
    if not fit.is_closed:
        return False
    devices = shapely.points(np.concatenate([data.tx[:, :2], data.rx_state[:, :2]]))
    return bool(shapely.contains(shapely.make_valid(shapely.Polygon(fit.contour_m)), devices).any())


def _overlap(one: Any, other: Any) -> float:
    """Intersection over union of two areas."""
    union = one.union(other).area
    return float(one.intersection(other).area / union) if union > 0 else 0.0
