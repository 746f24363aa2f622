"""Lines through the incidence points of a campaign: where they may go, and which points lie on them."""

from dataclasses import dataclass

import numpy as np

from estimation.shape.reflection.association import GATE
from estimation.shape.reflection.faces.scattering import OBJECT_REACH_M, FaceLine
from estimation.shape.reflection.normals import OrientedPoints
from estimation.shape.reflection.reflections import ReflectionConfig, Reflections
from scenes.record import BoolArray, FloatArray, IntArray

_TURNS = 60  # directions of the lines that are tried through an object
_FIRST_STD = (0.02, 0.03)  # of the azimuth in rad and of the offset in m of such a line
_FIT_STEPS = 5
_CLEAR_M = 0.3  # of both ends of a line of sight from a line that it crosses


@dataclass(frozen=True)
class FacePoints:
    """The points of all paths, and the lines of sight."""

    data: Reflections
    points: OrientedPoints
    los: Reflections
    config: ReflectionConfig

    def across_m2(self, line: FaceLine, rows: IntArray) -> FloatArray:
        """Variances (path,) of points and of the line along its normal."""
        covariance, place = self.points.covariance_m2[rows], self.places_m(line, rows)
        own = np.einsum("a,nab,b->n", line.normal, covariance, line.normal)
        return np.asarray(own + line.variance_m2(place, self.config.wall_relief_m))

    def places_m(self, line: FaceLine, rows: IntArray) -> FloatArray:
        """Places (path,) of points along the line."""
        return np.asarray(self.points.position_m[rows] @ line.tangent)

    def squares(self, line: FaceLine, rows: IntArray) -> FloatArray:
        """Squared distances (path,) of points from the line over their variances."""
        away = self.points.position_m[rows] @ line.normal - line.parameter[1]
        return np.asarray(away**2 / self.across_m2(line, rows))

    def behind(self, line: FaceLine, rows: IntArray) -> BoolArray:
        """Whether paths (path,) with points clear of the line would cross its seen part on both ways."""
        point = self.points.position_m[rows]
        beyond = point @ line.normal - line.parameter[1]
        crosses = beyond**2 > GATE * self.across_m2(line, rows)
        for end in (self.data.tx[rows, :2], self.data.rx_state[rows, :2]):
            before = end @ line.normal - line.parameter[1]
            opposite = before * beyond < 0
            share = before / np.where(opposite, before - beyond, 1.0)
            met = (end + share[:, None] * (point - end)) @ line.tangent
            crosses &= opposite & (met >= line.seen_m[0]) & (met <= line.seen_m[1])
        return np.asarray(crosses)

    def openings(self, line: FaceLine) -> tuple[float, float]:
        """The places nearest to the seen part, on either side, where a line of sight passes through the line."""
        tx, rx = self.los.tx[:, :2], self.los.rx_state[:, :2]
        before, beyond = (end @ line.normal - line.parameter[1] for end in (tx, rx))
        crosses = (before * beyond < 0) & (np.minimum(np.abs(before), np.abs(beyond)) > _CLEAR_M)
        share = (before / np.where(crosses, before - beyond, 1.0))[crosses]
        place = (tx[crosses] + share[:, None] * (rx - tx)[crosses]) @ line.tangent
        middle = line.seen_m.mean()
        return float(place[place < middle].max(initial=-np.inf)), float(place[place > middle].min(initial=np.inf))

    def fitted(self, line: FaceLine, rows: IntArray) -> FaceLine:
        """The line of least squares through points, seen as far as they reach, from a line near it."""
        point, covariance = self.points.position_m[rows], self.points.covariance_m2[rows]
        parameter = line.parameter.copy()
        for _ in range(_FIT_STEPS):
            normal = np.array([np.cos(parameter[0]), np.sin(parameter[0])])
            variance = np.einsum("a,nab,b->n", normal, covariance, normal) + self.config.wall_relief_m**2
            slope = np.column_stack([point @ [-normal[1], normal[0]], -np.ones(len(point))])
            weighted = (slope / variance[:, None]).T
            information = weighted @ slope + 1e-9 * np.eye(2)
            parameter -= np.linalg.solve(information, weighted @ (point @ normal - parameter[1]))
        found = FaceLine(parameter, np.linalg.inv(information), line.seen_m)
        place = point @ found.tangent
        return found._replace(seen_m=np.array([place.min(), place.max()]))

    def most_crowded(self, own: IntArray, others: IntArray) -> FaceLine:
        """The line through the middle of some points, `own`, near which most of the `others` are."""
        azimuth = np.arange(_TURNS) * np.pi / _TURNS
        normal = np.column_stack([np.cos(azimuth), np.sin(azimuth)])
        tangent = np.column_stack([-normal[:, 1], normal[:, 0]])
        middle = np.median(self.points.position_m[own], axis=0)
        variance = np.einsum("ka,nab,kb->kn", normal, self.points.covariance_m2[others], normal)
        variance += self.config.wall_relief_m**2
        away = normal @ (self.points.position_m[others] - middle).T
        along = tangent @ (self.points.position_m[others] - middle).T
        density = np.exp(-0.5 * away**2 / variance) / np.sqrt(2 * np.pi * variance)
        # As much as anywhere in the area, and less with the distance.
        ratio = density * np.sqrt(self.config.area_m2) / (1 + (along / (2 * OBJECT_REACH_M)) ** 2)
        best = int(np.argmax(np.log1p(ratio).sum(axis=1)))
        place = self.points.position_m[own] @ tangent[best]
        parameter = np.array([azimuth[best], float(middle @ normal[best])])
        return FaceLine(parameter, np.diag(np.square(_FIRST_STD)), np.array([place.min(), place.max()]))
