"""What a placement minimises: geometric means of the bounds of positions and outlines.

Geometric means, because one stop that hears nothing would fill a mean of squares. A stop that hears nothing is as
uncertain as the plan, an object that nothing lights as its prior.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from isac_arena.insight.bounds.several_tx import SeveralTx
from scenes.record import FloatArray

CriterionName = Literal["pose", "contours", "both"]
CRITERIA: tuple[CriterionName, ...] = get_args(CriterionName)


def criterion_name(text: str) -> CriterionName:
    """The criterion of that name; `ValueError` with all names where there is none."""
    for name in CRITERIA:
        if name == text:
            return name
    raise ValueError(f"--criterion = {text}: must be one of {', '.join(CRITERIA)}")


@dataclass(frozen=True)
class Criterion:
    """Logarithm of an error in m from any of the TX; `name` says of which one.

    `pose`: geometric mean over the stops of the position bound; `contours`: over the pillars of the RMS bound of
    the outline; `both`: the geometric mean of the two.
    """

    tx: SeveralTx
    name: CriterionName = "both"
    kept: tuple[int, ...] = ()  # rows of TX that stand already

    def __post_init__(self) -> None:
        if self.name != "pose" and not self.tx.objects:
            raise ValueError(
                f"criterion = '{self.name}': scene '{self.tx.scene.name}' has no pillar, only pose is allowed"
            )

    def __call__(self, chosen: Sequence[int]) -> float:
        """The logarithm with the chosen TX beside those that stand."""
        weight = np.zeros(len(self.tx.walks))
        weight[list(chosen)] = 1.0
        return self.relaxed(weight)[0]

    def relaxed(self, weight: FloatArray) -> tuple[float, FloatArray]:
        """The same with the information of every TX times its weight (tx,), and the gradient (tx,).

        It is convex in the weights, as `ContourInformation.log_error` shows.
        """
        weight = weight.copy()
        weight[list(self.kept)] = 1.0
        parts = []
        if self.name != "contours":
            parts.append(self._log_position(weight))
        if self.name != "pose":
            parts.append(self.tx.information.log_error(weight))
        value, slope = zip(*parts, strict=True)
        return float(np.mean(value)), np.asarray(np.mean(slope, axis=0))

    def _log_position(self, weight: FloatArray) -> tuple[float, FloatArray]:
        """Mean over the stops of the logarithm of the position bound, and its gradient."""
        informations = np.array([walk.pose for walk in self.tx.walks])  # (tx, stop, 3, 3)
        covariance = np.linalg.inv(self._anywhere + np.tensordot(weight, informations, 1))
        square = covariance[:, 0, 0] + covariance[:, 1, 1]
        half = covariance[:, :, :2]
        slope = np.einsum("sik,tsij,sjk->ts", half, informations, half) / (2 * square)
        return float(np.mean(0.5 * np.log(square))), -slope.mean(axis=1)

    @property
    def _anywhere(self) -> FloatArray:
        """Information (3, 3) on a pose that is uniform over the plan."""
        low_x, low_y, high_x, high_y = self.tx.scene.bounds_m
        return np.diag(12 / np.square([high_x - low_x, high_y - low_y, 2 * np.pi]))
