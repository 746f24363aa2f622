"""Floor plans: drawn or exported wall segments, merged into straight thin walls."""

from __future__ import annotations

import csv
import json
from collections.abc import Iterator
from typing import Any

import numpy as np
import shapely

from scenes.pose import LARGEST_LENGTH_M
from scenes.record import BoolArray, FloatArray, IntArray

COLUMNS = ("x0_m", "y0_m", "x1_m", "y1_m")
JOIN_TOLERANCE_M = 5e-3  # segments this close to one line and to each other along it form one wall
BLOCK = 128  # segments whose neighbours are looked up at once
MAX_NEAR_PAIRS = 5_000_000  # 0.6 GB while they are compared
SHOWN = 40  # characters of a wrong cell in a message
SEPARATORS = {";": "semicolons", "\t": "tabulators", "|": "bars"}  # that other programs write
MAX_ANGLE_RAD = 1e-2  # between segments of one wall


def parse_segments(text: str) -> FloatArray:
    """Segments (segment, end, xy) in m from CSV text with the columns x0_m, y0_m, x1_m, y1_m.

    Other columns and empty lines are ignored. Raises `ValueError` with the line if it has too few or too many
    values or a segment has no length, and with the column too if a number is invalid or not finite.
    """
    rows = csv.DictReader(text.splitlines())
    try:
        missing = [name for name in COLUMNS if name not in (rows.fieldnames or [])]
        if missing:
            found = ",".join(rows.fieldnames or [])
            other = next((name for mark, name in SEPARATORS.items() if mark in found), "")
            hint = f"; commas must separate the values, not {other}, and a decimal point is a dot" if other else ""
            needed = f"the first line must name {', '.join(COLUMNS)}"
            raise ValueError(f"column {missing[0]} is missing: {needed}{hint}")
        segments = np.array(list(_numbers(rows)), float).reshape(-1, 2, 2)
    except csv.Error as error:
        raise ValueError(f"line {rows.line_num + 1}: no CSV ({error})") from error
    if not len(segments):
        raise ValueError("there is no segment: at least one is needed")
    return segments


def parse_geojson(text: str) -> FloatArray:
    """Segments (segment, end, xy) in m of the lines and polygons of a GeoJSON text (RFC 7946), in local metres.

    Points and heights are ignored. Raises `ValueError` if the text is not GeoJSON or has no segment.
    """
    try:
        segments = [_segments_of(line) for line in _lines(json.loads(text))]
    except RecursionError as error:
        raise ValueError("no GeoJSON (nested too deep)") from error
    except (ValueError, LookupError, TypeError, OverflowError) as error:
        raise ValueError(f"no GeoJSON ({' '.join(str(error).split())[:80]})") from error
    found = np.concatenate([np.zeros((0, 2, 2)), *segments])
    if not len(found):
        raise ValueError("there is no line and no polygon: at least one is needed")
    return found


def _lines(document: Any) -> list[Any]:
    """Coordinates of all lines of a GeoJSON document, then of the rings of all polygons."""
    lines: list[Any] = []
    rings: list[Any] = []
    waiting = [document]
    while waiting:
        item = waiting.pop()
        match item["type"]:
            case "FeatureCollection":
                waiting += reversed(item["features"])
            case "Feature":
                waiting += [] if item["geometry"] is None else [item["geometry"]]
            case "GeometryCollection":
                waiting += reversed(item["geometries"])
            case "LineString":
                lines.append(item["coordinates"])
            case "MultiLineString":
                lines += item["coordinates"]
            case "Polygon":
                rings += item["coordinates"]
            case "MultiPolygon":
                rings += [ring for polygon in item["coordinates"] for ring in polygon]
            case "Point" | "MultiPoint":
                continue
            case other:
                raise ValueError(f"type = {str(other)[:40]!r}")
    return lines + rings


def _segments_of(line: Any) -> FloatArray:
    """Segments (segment, end, xy) of a line through positions; repeated positions count once."""
    points = np.array([position[:2] for position in line], float).reshape(-1, 2)
    if len(points) < 2 or not (np.abs(points) <= LARGEST_LENGTH_M).all():
        raise ValueError(f"a line has two or more positions within +-{LARGEST_LENGTH_M:g} m")
    kept = np.append(True, (np.diff(points, axis=0) != 0).any(axis=1))
    points = points[kept]
    return np.stack([points[:-1], points[1:]], axis=1)


def _numbers(rows: csv.DictReader[str]) -> Iterator[list[float]]:
    names = rows.fieldnames or []
    for row in rows:
        beyond = row.pop(None, [])  # empty values at the end do no harm
        if any(beyond) or None in map(row.get, COLUMNS):
            given = sum(value is not None for value in row.values()) + len(beyond)
            needed = f"{len(names)} are needed, those that the first line names: {','.join(names)}"
            raise ValueError(f"line {rows.line_num} has {given} value(s): {needed}")
        values = []
        for name in COLUMNS:
            try:
                values.append(float(row[name]))
            except ValueError:
                values.append(np.nan)
            if not abs(values[-1]) <= LARGEST_LENGTH_M:
                found = f"{name} = {_cut(row[name])!r}"
                raise ValueError(f"line {rows.line_num}: {found}: must be a finite number to {LARGEST_LENGTH_M:g}")
        if np.hypot(values[2] - values[0], values[3] - values[1]) < JOIN_TOLERANCE_M:
            raise ValueError(f"line {rows.line_num}: the segment is shorter than {JOIN_TOLERANCE_M} m")
        yield values


def merge_segments(segments_m: FloatArray, tolerance_m: float = JOIN_TOLERANCE_M) -> FloatArray:
    """Merge segments (segment, end, xy) into straight walls (wall, end, xy), in the order of their first segments.

    Segments become one wall if they lie on one line within the tolerance and overlap, repeat or touch each other.
    The wall spans all of them. Corners and crossings of different lines do not change.
    """
    from scipy.sparse import coo_array  # noqa: PLC0415  (slow to import)
    from scipy.sparse.csgraph import connected_components  # noqa: PLC0415  (slow to import)

    segments = np.asarray(segments_m, float)
    near = _near_pairs(segments, tolerance_m)
    one, other = near[:, _are_one(segments, near, tolerance_m)]
    pairs = coo_array((np.ones(len(one), bool), (one, other)), shape=(len(segments),) * 2)
    n_walls, wall = connected_components(pairs, directed=False)
    order = np.argsort(wall, kind="stable")
    ends = np.cumsum(np.bincount(wall, minlength=n_walls))
    return np.array([_spanned(group) for group in np.split(segments[order], ends[:-1])])


def _near_pairs(segments: FloatArray, tolerance_m: float) -> IntArray:
    """Indices (2, pair) of segments that are near enough to belong to one wall.

    Raises `ValueError` where so many lie on each other that the table of pairs would be too large.
    """
    lines = shapely.linestrings(segments)
    tree, found = shapely.STRtree(lines), []
    for first in range(0, len(lines), BLOCK):
        found.append(
            tree.query(lines[first : first + BLOCK], "dwithin", 2 * tolerance_m) + np.array([[first], [0]])
        )
        if sum(each.shape[1] for each in found) > MAX_NEAR_PAIRS:
            raise ValueError(f"{len(lines)} segments: too many lie on each other; merge those of a wall")
    return np.concatenate(found, axis=1)


def _are_one(segments: FloatArray, pairs: IntArray, tolerance_m: float) -> BoolArray:
    """Mask (pair,) of the pairs (2, pair) of segments that belong to one wall."""
    along = segments[:, 1] - segments[:, 0]
    length = np.linalg.norm(along, axis=1)
    unit = along / length[:, None]
    one, other = pairs
    sine = unit[one, 0] * unit[other, 1] - unit[one, 1] * unit[other, 0]
    offset = segments[other] - segments[one, :1]
    aside = offset[..., 1] * unit[one, None, 0] - offset[..., 0] * unit[one, None, 1]
    place = (offset * unit[one, None]).sum(axis=-1)
    on_line = (np.abs(sine) < MAX_ANGLE_RAD) & (np.abs(aside).max(axis=-1) <= tolerance_m)
    meets = (place.max(axis=-1) >= -tolerance_m) & (place.min(axis=-1) <= length[one] + tolerance_m)
    return np.asarray(on_line & meets)


def _cut(text: str) -> str:
    return text if len(text) <= SHOWN else f"{text[:SHOWN]}..."


def _spanned(segments: FloatArray) -> FloatArray:
    """The wall (end, xy) along the longest segment that spans all segments."""
    along = segments[:, 1] - segments[:, 0]
    length = np.linalg.norm(along, axis=1)
    longest = int(length.argmax())
    unit = along[longest] / length[longest]
    place = (segments - segments[longest, 0]) @ unit
    return np.asarray(segments[longest, 0] + np.array([[place.min()], [place.max()]]) * unit)
