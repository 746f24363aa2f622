"""Lines through the incidence points of a campaign: where they may go, and which points lie on them."""

from dataclasses import dataclass

import numpy as np
import shapely

from estimation.laws.contour import WALL, predict_reflection
from estimation.laws.wall import wall_places
from estimation.shape.config import ReflectionConfig
from estimation.shape.fit import ShapeFit
from estimation.shape.reflection.association import GATE, ONE_GATE
from estimation.shape.reflection.faces.bends import fit_bend
from estimation.shape.reflection.faces.scattering import OBJECT_REACH_M, FaceLine, Places, scattering_places
from estimation.shape.reflection.normals import OrientedPoints
from estimation.shape.reflection.reflections import Reflections
from scenes.record import BoolArray, FloatArray, IntArray

_TURNS = 60  # directions of the lines that are tried through an object
_FIRST_STD = (0.02, 0.03)  # of the azimuth in rad and of the offset in m of such a line
_FIT_STEPS = 5
_TINY = 1e-18
_CLEAR_M = 0.3  # of both ends of a line of sight from a line that it crosses


@dataclass(frozen=True)
class FacePoints:
    """The points of all paths, and the lines of sight."""

    data: Reflections
    points: OrientedPoints
    los: Reflections
    config: ReflectionConfig

    def places(self, line: FaceLine, rows: IntArray) -> Places:
        """Where paths (path,) met a face on the line, if they are scattered from it."""
        return scattering_places(line, self.data.take("path", rows), self.config)

    def across_m2(self, line: FaceLine, rows: IntArray) -> FloatArray:
        """Variances (path,) of points and of the line along its normal."""
        own = self._own_m2(line, rows)
        return np.asarray(own + line.variance_m2(self.places_m(line, rows), self.config.wall_relief_m))

    def _own_m2(self, line: FaceLine, rows: IntArray) -> FloatArray:
        """Variances (path,) of points along the normal of the line, those along a curved face included."""
        across = line.normal - line.slope(self.places_m(line, rows))[:, None] * line.tangent
        return np.asarray(np.einsum("na,nab,nb->n", across, self.points.covariance_m2[rows], across))

    def places_m(self, line: FaceLine, rows: IntArray) -> FloatArray:
        """Places (path,) of points along the line."""
        return np.asarray(self.points.position_m[rows] @ line.tangent)

    def squares(self, line: FaceLine, rows: IntArray) -> FloatArray:
        """Squared distances (path,) of points from the line over their variances."""
        return np.asarray(line.away_m(self.points.position_m[rows]) ** 2 / self.across_m2(line, rows))

    def on_body(self, fit: ShapeFit, rows: IntArray) -> bool:
        """Whether most points (path,) lie on a closed contour, within their errors and its own."""
        outline, point = shapely.LinearRing(fit.contour_m), shapely.points(self.points.position_m[rows])
        nearest = shapely.get_coordinates(
            shapely.line_interpolate_point(outline, shapely.line_locate_point(outline, point))
        )
        away = self.points.position_m[rows] - nearest
        distance2 = np.sum(away**2, axis=1)
        own = np.einsum("na,nab,nb->n", away, self.points.covariance_m2[rows], away) / np.maximum(distance2, _TINY)
        variance = own + np.median(fit.std_m) ** 2 + self.config.wall_relief_m**2
        return bool(np.mean(distance2 < ONE_GATE * variance) > 0.5) if len(rows) else True

    def crossings(self, line: FaceLine, rows: IntArray) -> tuple[BoolArray, FloatArray]:
        """Whether paths (path,) with points clear of the line cross it on both ways, and where (way, path)."""
        point = self.points.position_m[rows]
        beyond = line.away_m(point)
        crosses, places = beyond**2 > GATE * self.across_m2(line, rows), []
        for end in (self.data.tx[rows, :2], self.data.rx_state[rows, :2]):
            before = line.away_m(end)
            opposite = before * beyond < 0
            share = before / np.where(opposite, before - beyond, 1.0)
            places.append((end + share[:, None] * (point - end)) @ line.tangent)
            crosses &= opposite
        return np.asarray(crosses), np.array(places)

    def unmirrored(self, line: FaceLine, members: IntArray) -> tuple[FloatArray, FloatArray]:
        """Places (event,) where a flat face mirrored no path that it would have, and their evidence against it.

        It mirrors to a stop as often as to those between its first and last mirrored paths, `members`.
        """
        link = self.data.stop * (self.data.clock.max(initial=0) + 1) + self.data.clock
        _, first = np.unique(link, return_index=True)
        tx, state = self.data.tx[first], self.data.rx_state[first]
        place, _, _ = wall_places(line.parameter, tx, state[:, :2])
        lit = predict_reflection(WALL, line.parameter, tx, state).is_lit
        found = np.isin(link[first], link[members])
        if not found.any():
            return np.zeros(0), np.zeros(0)
        between = lit & (place >= place[found].min()) & (place <= place[found].max())
        n, missed = np.count_nonzero(between), lit & ~found
        silent = (n - np.count_nonzero(found & between) + 1) / (n + 2)
        return place[missed], np.full(np.count_nonzero(missed), -np.log(silent))

    def openings(self, line: FaceLine) -> tuple[float, float]:
        """The places nearest to the seen part, on either side, where a line of sight passes through the line."""
        tx, rx = self.los.tx[:, :2], self.los.rx_state[:, :2]
        before, beyond = line.away_m(tx), line.away_m(rx)
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

    def bent(self, line: FaceLine, rows: IntArray, mirrored: IntArray) -> FaceLine:
        """The curved face through points, as far as they reach, from one near it; `mirrored` have no relief."""
        base = self.fitted(line, rows)
        # The normals of the points are those of the face as it was.
        relief = np.where(np.isin(rows, mirrored), 0.0, self.config.wall_relief_m)
        away, variance = base.away_m(self.points.position_m[rows]), self._own_m2(line, rows) + relief**2
        return base._replace(
            bend=fit_bend(self.places_m(base, rows), away, variance, 1 / self.config.bend_radius_median_m)
        )

    def facing(self, rows: IntArray) -> FaceLine:
        """The line through the middle of points along their mean normal."""
        normal = self.points.normal_rad[rows]
        azimuth = np.arctan2(np.sin(normal).mean(), np.cos(normal).mean())
        middle = np.median(self.points.position_m[rows], axis=0)
        offset = float(middle @ [np.cos(azimuth), np.sin(azimuth)])
        return FaceLine(np.array([azimuth, offset]), np.diag(np.square(_FIRST_STD)), np.zeros(2))

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
