"""Floor plans: drawn or exported wall segments, merged into straight thin walls."""

from __future__ import annotations

import csv
from collections.abc import Iterator

import numpy as np
import shapely

from scenes.record import BoolArray, FloatArray

COLUMNS = ("x0_m", "y0_m", "x1_m", "y1_m")
JOIN_TOLERANCE_M = 5e-3  # segments this close to one line and to each other along it form one wall
MAX_ANGLE_RAD = 1e-2  # between segments of one wall


def parse_segments(text: str) -> FloatArray:
    """Segments (segment, end, xy) in m from CSV text with the columns x0_m, y0_m, x1_m, y1_m.

    Other columns and empty lines are ignored. Raises `ValueError` with the line and the column if a number is
    missing, invalid or not finite, or if a segment has no length.
    """
    rows = csv.DictReader(text.splitlines())
    missing = [name for name in COLUMNS if name not in (rows.fieldnames or [])]
    if missing:
        raise ValueError(f"column {missing[0]} is missing: the first line must name {', '.join(COLUMNS)}")
    segments = np.array(list(_numbers(rows)), float).reshape(-1, 2, 2)
    if not len(segments):
        raise ValueError("there is no segment: at least one is needed")
    return segments


def parse_geojson(text: str) -> FloatArray:
    """Segments (segment, end, xy) in m of the lines and polygons of a GeoJSON text (RFC 7946), in local metres.

    Points and heights are ignored. Raises `ValueError` if the text is not GeoJSON or has no segment.
    """
    try:
        shapes = shapely.get_parts(shapely.from_geojson(text))
    except shapely.errors.GEOSException as error:
        raise ValueError(f"no GeoJSON ({' '.join(str(error).split())})") from error
    while any(item.geom_type.startswith(("Multi", "GeometryCollection")) for item in shapes):
        shapes = shapely.get_parts(shapes)
    rings = [item for item in shapes if item.geom_type in ("LineString", "LinearRing")]
    for item in shapes:
        if item.geom_type == "Polygon":
            rings += [item.exterior, *item.interiors]
    lines = [shapely.get_coordinates(shapely.remove_repeated_points(ring)) for ring in rings]
    segments = [np.stack([line[:-1], line[1:]], axis=1) for line in lines]
    found = np.concatenate([np.zeros((0, 2, 2)), *segments])
    if not len(found):
        raise ValueError("there is no line and no polygon: at least one is needed")
    return found


def _numbers(rows: csv.DictReader[str]) -> Iterator[list[float]]:
    for row in rows:
        values = []
        for name in COLUMNS:
            try:
                values.append(float(row[name]))
            except (TypeError, ValueError):
                values.append(np.nan)
            if not np.isfinite(values[-1]):
                raise ValueError(f"line {rows.line_num}: {name} = {row[name]!r}: must be a finite number")
        if np.hypot(values[2] - values[0], values[3] - values[1]) < JOIN_TOLERANCE_M:
            raise ValueError(f"line {rows.line_num}: the segment is shorter than {JOIN_TOLERANCE_M} m")
        yield values


def merge_segments(segments_m: FloatArray, tolerance_m: float = JOIN_TOLERANCE_M) -> FloatArray:
    """Merge segments (segment, end, xy) into straight walls (wall, end, xy), in the order of their first segments.

    Segments become one wall if they lie on one line within the tolerance and overlap, repeat or touch each other.
    The wall spans all of them. Corners and crossings of different lines do not change.
    """
    from scipy.sparse.csgraph import connected_components  # noqa: PLC0415  (slow to import)

    segments = np.asarray(segments_m, float)
    n_walls, wall = connected_components(_are_one(segments, tolerance_m), directed=False)
    walls = [_spanned(segments[wall == index]) for index in range(n_walls)]
    return np.array(walls)


def _are_one(segments: FloatArray, tolerance_m: float) -> BoolArray:
    """Mask (segment, segment) of pairs that belong to one wall."""
    start, along = segments[:, 0], segments[:, 1] - segments[:, 0]
    length = np.linalg.norm(along, axis=1)
    unit = along / length[:, None]
    sine = unit[:, None, 0] * unit[None, :, 1] - unit[:, None, 1] * unit[None, :, 0]
    offset = segments[None] - start[:, None, None]
    aside = offset[..., 1] * unit[:, None, None, 0] - offset[..., 0] * unit[:, None, None, 1]
    place = (offset * unit[:, None, None]).sum(axis=-1)
    on_line = (np.abs(sine) < MAX_ANGLE_RAD) & (np.abs(aside).max(axis=-1) <= tolerance_m)
    meets = (place.max(axis=-1) >= -tolerance_m) & (place.min(axis=-1) <= length[:, None] + tolerance_m)
    return np.asarray(on_line & meets)


def _spanned(segments: FloatArray) -> FloatArray:
    """The wall (end, xy) along the longest segment that spans all segments."""
    along = segments[:, 1] - segments[:, 0]
    length = np.linalg.norm(along, axis=1)
    longest = int(length.argmax())
    unit = along[longest] / length[longest]
    place = (segments - segments[longest, 0]) @ unit
    return np.asarray(segments[longest, 0] + np.array([[place.min()], [place.max()]]) * unit)
