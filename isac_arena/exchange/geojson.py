"""A map as GeoJSON (RFC 7946): incidence points, both kinds of contours and the true outlines, in local metres."""

from collections.abc import Iterator
from typing import Any

import numpy as np

from isac_arena.campaign.results import MapResult
from isac_arena.scoring.stages.shapes import contour_points_m
from scenes.record import FloatArray
from scenes.scene import Scene

OUTLINE_SPACING_M = 0.02
DIGITS = 4  # tenths of a millimetre
# RFC 7946 knows degrees alone; with this older member GDAL and geopandas read metres of a local frame
LOCAL_CRS = (
    'ENGCRS["local frame of the scene",EDATUM["scene"],CS[Cartesian,2],AXIS["x",east],AXIS["y",north],'
    'LENGTHUNIT["metre",1]]'
)

Feature = dict[str, Any]


def map_geojson(scene: Scene, result: MapResult) -> dict[str, Any]:
    """A FeatureCollection; the property `layer` of a feature is truth, pose, ip, shape or contour.

    Coordinates are x and y of the world frame in m, not longitude and latitude.
    """
    layers = (_outlines(scene), _poses(result), _points(result), _shapes(result), _contours(result))
    return {
        "type": "FeatureCollection",
        "name": scene.name,
        "coordinates": "x and y of a local right-handed frame in m",
        "crs": {"type": "name", "properties": {"name": LOCAL_CRS}},
        "features": [feature for layer in layers for feature in layer],
    }


def _outlines(scene: Scene) -> Iterator[Feature]:
    for item in scene.objects:
        points = item.contour.sample(OUTLINE_SPACING_M)
        yield _line("truth", points, is_closed=item.contour.closed, object=item.name, kind=item.kind)


def _poses(result: MapResult) -> Iterator[Feature]:
    poses = result.poses
    for row in np.flatnonzero(np.isfinite(poses.position_m).all(axis=1)):
        yield _feature(
            "pose",
            {"type": "Point", "coordinates": _rounded(poses.position_m[row])},
            stop=int(poses.stop[row]),
            heading_deg=_number(np.rad2deg(poses.heading_rad[row])),
            clock_bias_ns=_number(1e9 * poses.clock_bias_s[row]),
        )


def _points(result: MapResult) -> Iterator[Feature]:
    ips = result.ips
    for row in np.flatnonzero(np.isfinite(ips.position_m).all(axis=1)):
        yield _feature(
            "ip",
            {"type": "Point", "coordinates": _rounded(ips.position_m[row])},
            stop=int(ips.stop[row]),
            path=int(ips.path[row]),
            tx=int(ips.tx[row]),
            is_inlier=bool(ips.is_inlier[row]),
            cluster=int(result.shapes.label[row]),
            contour=int(result.contours.object[row]),
            covariance_m2=[_number(value) for value in ips.covariance_m2[row].ravel()],
        )


def _shapes(result: MapResult) -> Iterator[Feature]:
    shapes = result.shapes
    for cluster in range(len(shapes.center_m)):
        std_m = [_number(value) for value in shapes.radius_std_m[cluster]]
        points_m = contour_points_m(shapes, cluster)
        yield _line("shape", points_m, is_closed=True, cluster=cluster, std_m=std_m)


def _contours(result: MapResult) -> Iterator[Feature]:
    contours = result.contours
    for row in range(len(contours)):
        names = contours.class_name.tolist()
        yield _line(
            "contour",
            contours.contour_m[row],
            is_closed=bool(contours.is_closed[row]),
            contour=row,
            kind=str(contours.kind[row]),
            status=str(contours.status[row]),
            extent_m=_number(contours.extent_m[row]),
            extent_std_m=_number(contours.extent_std_m[row]),
            class_probability=dict(zip(names, map(_number, contours.class_probability[row]), strict=True)),
            std_m=[_number(value) for value in contours.std_m[row]],
        )


def _line(layer: str, points_m: FloatArray, *, is_closed: bool, **properties: Any) -> Feature:
    """A polygon, its ring closed, or a line through points (sample, xy)."""
    places = [_rounded(point) for point in points_m]
    if not is_closed:
        return _feature(layer, {"type": "LineString", "coordinates": places}, **properties)
    return _feature(layer, {"type": "Polygon", "coordinates": [[*places, places[0]]]}, **properties)


def _feature(layer: str, geometry: dict[str, Any], **properties: Any) -> Feature:
    return {"type": "Feature", "geometry": geometry, "properties": {"layer": layer, **properties}}


def _rounded(point_m: FloatArray) -> list[float]:
    return [round(float(value), DIGITS) for value in point_m]


def _number(value: float) -> float | None:
    """A number that JSON can hold, six digits of it; None where it is not finite."""
    return float(f"{value:.6g}") if np.isfinite(value) else None
