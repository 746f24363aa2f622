"""The estimated shape of one object: one record for all methods."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from scenes.record import FloatArray, IntArray, Record, TextArray, array

KINDS = (
    "circle",
    "ellipse",
    "rounded_square",
    "square",
    "star_convex",
    "support_gp",
    "wall",
    "arc",
    "depth_line",
    "edge",
    "none",
)
OK, PRIOR, FAILED = "ok", "prior", "failed"


@dataclass(frozen=True)
class ShapeFit(Record):
    """Contour of one object with its uncertainty.

    `status` is `ok`, `prior` where the data are uninformative and the result is as wide as the prior, or
    `failed: why`. A closed contour is sampled counter-clockwise without a repeated end, an open one end to end.
    Raises `ValueError` for another kind or status.
    """

    kind: str
    status: str
    is_closed: bool
    contour_m: FloatArray = array("sample", "xy", unit="m", doc="points of the contour")
    std_m: FloatArray = array(
        "sample", unit="m", doc="standard deviation along the contour's normal: the 95 % band is +-1.96 of it"
    )
    log_evidence: float = array(
        unit="nat", doc="log marginal likelihood, comparable among models of the same data; NaN without one"
    )
    parameter: FloatArray = array("parameter", doc="parameters of the model; empty where it has none")
    parameter_covariance: FloatArray = array("parameter", "parameter2", doc="their covariance")
    parameter_name: TextArray = array("parameter", dtype=np.str_, doc="their names, units included")
    extent_m: float = array(unit="m", doc="lit length of an open contour, mean radius of a closed one")
    extent_std_m: float = array(unit="m", doc="standard deviation of the extent")

    def __post_init__(self) -> None:
        if self.kind not in KINDS:
            raise ValueError(f"ShapeFit.kind = '{self.kind}': must be one of {', '.join(KINDS)}")
        if self.status not in (OK, PRIOR) and not self.status.startswith(FAILED):
            raise ValueError(f"ShapeFit.status = '{self.status}': must be ok, prior or 'failed: why'")
        super().__post_init__()

    @property
    def is_usable(self) -> bool:
        """Whether there is a contour: the status is no failure."""
        return not self.status.startswith(FAILED)


class FoundContour(NamedTuple):
    """A contour with the incidence points that it was fitted to and the probabilities of its classes."""

    shape: ShapeFit
    rows: IntArray  # (path,) of the data
    class_probability: Sequence[float]  # in the order of the classes of contours


def failed_fit(kind: str, why: str) -> ShapeFit:
    """The result of a method that found no shape: an empty contour, and the reason as status."""
    return ShapeFit(
        kind=kind,
        status=f"{FAILED}: {why}",
        is_closed=False,
        contour_m=np.zeros((0, 2)),
        std_m=np.zeros(0),
        log_evidence=np.nan,
        parameter=np.zeros(0),
        parameter_covariance=np.zeros((0, 0)),
        parameter_name=np.zeros(0, dtype=np.str_),
        extent_m=np.nan,
        extent_std_m=np.nan,
    )
