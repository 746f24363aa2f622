"""Floor plans: pieces of walls grow together, and mistakes name their line."""

import json
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from scenes.meshes.floorplan import merge_segments, parse_geojson, parse_segments

HEADER = "x0_m,y0_m,x1_m,y1_m\n"
ROOM = np.array(
    [[(0, 0), (6, 0)], [(6, 0), (6, 4)], [(6, 4), (0, 4)], [(0, 4), (0, 0)], [(2, 0), (3.5, 2.5)]], float
)


def as_set(walls):
    return {tuple(sorted(map(tuple, np.round(wall, 6)))) for wall in walls}


@given(seed=st.integers(0, 10_000))
@settings(max_examples=40, deadline=None)
def test_walls_cut_up_repeated_turned_and_shuffled_come_back(seed):
    rng = np.random.default_rng(seed)
    pieces = []
    for start, end in ROOM:
        cuts = np.concatenate([[0], np.sort(rng.uniform(0.1, 0.9, rng.integers(0, 4))), [1]])
        pieces += [(start + a * (end - start), start + b * (end - start)) for a, b in pairwise(cuts)]
    pieces += [pieces[index] for index in rng.integers(0, len(pieces), 4)]
    pieces = [piece[::-1] if rng.random() < 0.5 else piece for piece in pieces]
    shuffled = np.array([pieces[index] for index in rng.permutation(len(pieces))])
    assert as_set(merge_segments(shuffled)) == as_set(ROOM)


def test_gaps_parallels_and_crossings_stay():
    segments = np.array(
        [
            [(0, 0), (1, 0)], [(1.2, 0), (2, 0)], [(0, 0.05), (2, 0.05)], [(0.5, -1), (0.5, 1)],
            [(3, 0), (4, 0)], [(3.5, 0.002), (5, 0.002)],
        ]
    )  # fmt: skip
    walls = merge_segments(segments)
    assert len(walls) == 5
    np.testing.assert_allclose(walls[-1], [(3, 0.002), (5, 0.002)], atol=1e-12)
    np.testing.assert_allclose(walls[0], segments[0])


def test_parse():
    text = "\ufeffname,x0_m,y0_m,x1_m,y1_m\na,0,0,1,0\n\nb,1,0,1,2.5\n".lstrip("\ufeff")
    np.testing.assert_array_equal(parse_segments(text), [[(0, 0), (1, 0)], [(1, 0), (1, 2.5)]])
    np.testing.assert_array_equal(parse_segments(f"{HEADER}0,0,1,0,,\n"), [[(0, 0), (1, 0)]])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("x0_m,y0_m,x1_m\n0,0,1\n", "column y1_m is missing: the first line must name x0_m"),
        ("", "column x0_m is missing"),
        (HEADER, "there is no segment"),
        (HEADER + "0,0,1,0\n0,0,nan,0\n", r"line 3: x1_m = 'nan': must be a finite number"),
        (HEADER + "0,0,1\n", r"line 2 has 3 value\(s\): 4 are needed, .*: x0_m,y0_m,x1_m,y1_m$"),
        (HEADER + "0,0,1,0\n0,5,0,5,1,5,2,5\n", r"line 3 has 8 value\(s\): 4 are needed"),
        ("x0_m;y0_m;x1_m;y1_m\n0;0;1;0\n", r"column x0_m is missing: .*commas must separate .*, not semicolons"),
        (HEADER + "0,0,1,a\n", r"line 2: y1_m = 'a'"),
        (HEADER + "1,1,1,1\n", r"line 2: the segment is shorter than 0\.005 m"),
    ],
)
def test_mistakes(text, message):
    with pytest.raises(ValueError, match=message):
        parse_segments(text)


def geojson(*geometries):
    features = [{"type": "Feature", "properties": {}, "geometry": each} for each in geometries]
    return json.dumps({"type": "FeatureCollection", "features": features})


def test_geojson_lines_and_polygons_become_segments():
    line = {"type": "LineString", "coordinates": [[0, 0], [1, 0], [1, 0], [1, 2]]}
    room = [[0, 0], [4, 0], [4, 3], [0, 3], [0, 0]]
    hole = [[1, 1], [2, 1], [1, 2], [1, 1]]
    parts = {"type": "MultiPolygon", "coordinates": [[room, hole]]}
    point = {"type": "Point", "coordinates": [9, 9]}
    assert parse_geojson(geojson(line)).tolist() == [[[0, 0], [1, 0]], [[1, 0], [1, 2]]]
    assert len(parse_geojson(geojson(line, parts, point))) == 2 + 4 + 3
    assert parse_geojson(json.dumps(line)).shape == (2, 2, 2)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "no GeoJSON"),
        ("{", "no GeoJSON"),
        ('{"a": 1}', "no GeoJSON"),
        ('{"type": "LineString", "coordinates": [[0, 0]]}', "no GeoJSON"),
        ('{"type": "Point", "coordinates": [0, 0]}', "there is no line and no polygon"),
        ('{"type": "FeatureCollection", "features": []}', "there is no line and no polygon"),
    ],
)
def test_other_geojson_is_refused(text, message):
    with pytest.raises(ValueError, match=message):
        parse_geojson(text)
