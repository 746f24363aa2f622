"""Incidence points of one object: the input of the methods for points."""

from dataclasses import dataclass

import numpy as np

from scenes.record import FloatArray, Record, array


@dataclass(frozen=True)
class PointCluster(Record):
    """Incidence points of one object with their covariances, and the place of the sensor.

    Raises `ValueError` without a point, for a value that is not finite and for a covariance that is not positive
    definite.
    """

    position_m: FloatArray = array("ip", "xy", unit="m", doc="incidence points")
    covariance_m2: FloatArray = array("ip", "xy", "xy2", unit="m^2", doc="their covariances")
    sensor_m: FloatArray = array("xy", unit="m", doc="place of the sensor; NaN if unknown")

    def __post_init__(self) -> None:
        super().__post_init__()
        if not len(self.position_m):
            raise ValueError("PointCluster.position_m: no point given, at least 1 is needed")
        for name in ("position_m", "covariance_m2"):
            if not np.isfinite(getattr(self, name)).all():
                raise ValueError(f"PointCluster.{name}: has a value that is not finite")
        skew = np.abs(self.covariance_m2 - np.swapaxes(self.covariance_m2, 1, 2)).max(axis=(1, 2))
        smallest = np.linalg.eigvalsh(self.covariance_m2)[:, 0]
        bad = np.flatnonzero((smallest <= 0) | (skew > 1e-6 * np.abs(self.covariance_m2).max(axis=(1, 2))))
        if len(bad):
            raise ValueError(
                f"PointCluster.covariance_m2[{bad[0]}] = {self.covariance_m2[bad[0]].tolist()}: must be symmetric "
                "and positive definite"
            )

    def __len__(self) -> int:
        return len(self.position_m)

    @property
    def middle_m(self) -> FloatArray:
        """Median position (xy,) in m, which is robust to outliers."""
        return np.asarray(np.median(self.position_m, axis=0))

    def area_m2(self, margin_m: float) -> float:
        """Area of the bounding box of the points with a margin on every side; outliers are uniform over it."""
        return float(np.prod(np.ptp(self.position_m, axis=0) + 2 * margin_m))

    @property
    def away(self) -> FloatArray:
        """Unit vector (xy,) from the sensor to the points; zero where the sensor is unknown."""
        direction = self.middle_m - self.sensor_m
        length = float(np.hypot(*direction))
        return np.asarray(direction / length) if length > 0 else np.zeros(2)


def ring_normals(contour_m: FloatArray) -> FloatArray:
    """Outward unit normals (sample, xy) of a closed contour sampled counter-clockwise."""
    along = np.roll(contour_m, -1, axis=0) - np.roll(contour_m, 1, axis=0)
    normal = np.stack([along[:, 1], -along[:, 0]], axis=1)
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    return np.asarray(np.divide(normal, length, out=np.zeros_like(normal), where=length > 0))
