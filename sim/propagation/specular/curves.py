"""Curved walls as a table of short smooth curves, evaluated together as arrays.

A curve c(t), t in [0, 1], is a conic o + u cos p + v sin p, p = start + sweep t, or a chain of cubic polynomials,
and is either convex or concave as seen from its lit side. Pieces are cut where the curvature changes its sign.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from scenes.contours.pieces import Piece
from scenes.record import BoolArray, FloatArray, IntArray, Record, array, concatenate
from sim.propagation.specular.plan_view import cross

N_NODES = 49  # points tabulated per curve
MAX_CONCAVE_TURN_RAD = np.pi / 4  # limit for concave curves: their nodes are then within 1 deg
MAX_CONVEX_TURN_RAD = 2 * np.pi
MAX_SEGMENTS = 12
NODE_T = np.linspace(0, 1, N_NODES)

_NODE_SHAPES = {
    "center_m": (2,),
    "reach_m": (),
    "node_m": (N_NODES, 2),
    "node_first": (N_NODES, 2),
    "node_second": (N_NODES, 2),
    "node_normal": (N_NODES, 2),
}

Maker = Callable[[int, float], list["Curves"]]


@dataclass(frozen=True)
class Curves(Record):
    """Curves with their nodes. The lit side is in the direction `side` times the normal to the right of c'(t)."""

    surface: IntArray = array("curve", dtype=int, doc="index of the object")
    side: FloatArray = array("curve", doc="+1 or -1")
    is_convex: BoolArray = array("curve", dtype=bool, doc="as seen from the lit side")
    is_conic: BoolArray = array("curve", dtype=bool, doc="whether coefficients are o, u, v, (start, sweep)")
    n_segments: IntArray = array("curve", dtype=int, doc="number of cubics in the curve, equal in t; 1 for conics")
    coefficient: FloatArray = array("curve", "segment", "row", "xy", doc="of the conic, or of t^3, t^2, t, 1")
    center_m: FloatArray = array("curve", "xy", unit="m", doc="centre of a disc that holds the curve")
    reach_m: FloatArray = array("curve", unit="m", doc="radius of that disc")
    node_m: FloatArray = array("curve", "node", "xy", unit="m", doc="c(t) at NODE_T")
    node_first: FloatArray = array("curve", "node", "xy", unit="m", doc="c'(t) there")
    node_second: FloatArray = array("curve", "node", "xy", unit="m", doc="c''(t) there")
    node_normal: FloatArray = array("curve", "node", "xy", doc="unit normal of the lit side there")

    def __len__(self) -> int:
        return self.size("curve")

    def at(self, curve: IntArray, t: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """c(t), c'(t), c''(t), each (..., xy) in m, of curves (...) at parameters (...)."""
        is_conic = self.is_conic[curve]
        if is_conic.all():
            return self._conic_at(curve, t)
        point, first, second = self._cubic_at(curve, t)
        if is_conic.any():
            there = self._conic_at(curve[is_conic], t[is_conic])
            point[is_conic], first[is_conic], second[is_conic] = there
        return point, first, second

    def _conic_at(self, curve: IntArray, t: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        w = self.coefficient[curve, 0]
        sweep = w[..., 3, 1, None]
        angle = w[..., 3, 0] + w[..., 3, 1] * t
        cosine, sine = np.cos(angle)[..., None], np.sin(angle)[..., None]
        bend = w[..., 1, :] * cosine + w[..., 2, :] * sine
        first = sweep * (w[..., 2, :] * cosine - w[..., 1, :] * sine)
        return w[..., 0, :] + bend, first, -(sweep**2) * bend

    def _cubic_at(self, curve: IntArray, t: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        n = self.n_segments[curve]
        segment = np.clip(np.floor(t * n).astype(int), 0, n - 1)
        w = self.coefficient[curve, segment]
        n, s = n[..., None], (t * n - segment)[..., None]
        point = ((w[..., 0, :] * s + w[..., 1, :]) * s + w[..., 2, :]) * s + w[..., 3, :]
        first = ((3 * w[..., 0, :] * s + 2 * w[..., 1, :]) * s + w[..., 2, :]) * n
        second = (6 * w[..., 0, :] * s + 2 * w[..., 1, :]) * n**2
        return point, first, second

    @property
    def is_cyclic(self) -> BoolArray:
        """Curves (curve,) that end where they start."""
        return np.asarray(self.is_conic & (np.abs(self.coefficient[:, 0, 3, 1]) > 2 * np.pi - 1e-9))

    def normal(self, curve: IntArray, first: FloatArray) -> FloatArray:
        """Unit normals (..., xy) of the lit side where the tangents are `first` (..., xy)."""
        scale = self.side[curve] / np.sqrt(first[..., 0] ** 2 + first[..., 1] ** 2)
        return np.stack([first[..., 1] * scale, -first[..., 0] * scale], axis=-1)

    def curvature(self, curve: IntArray, first: FloatArray, second: FloatArray) -> FloatArray:
        """Curvature (...) in 1/m, positive where the curve is convex from its lit side."""
        speed = np.sqrt(first[..., 0] ** 2 + first[..., 1] ** 2)
        return np.asarray(self.side[curve] * cross(first, second) / speed**3)


def joined_curves(parts: list[Curves]) -> Curves:
    """All curves in one table; the table may be empty."""
    if parts:
        return concatenate(parts, "curve")
    none = np.zeros(0)
    return Curves(
        surface=none.astype(int),
        side=none,
        is_convex=none.astype(bool),
        is_conic=none.astype(bool),
        n_segments=none.astype(int),
        coefficient=np.zeros((0, MAX_SEGMENTS, 4, 2)),
        **{name: np.zeros((0, *shape)) for name, shape in _NODE_SHAPES.items()},
    )


def conic_curves(
    center_m: FloatArray, u_m: FloatArray, v_m: FloatArray, start_rad: float, sweep_rad: float
) -> Maker:
    """Function that makes the curves o + u cos p + v sin p, p from `start_rad` to `start_rad + sweep_rad`."""

    def make(surface: int, side: float) -> list[Curves]:
        is_convex = bool(side * sweep_rad * cross(u_m, v_m) > 0)
        n = _n_cuts(abs(sweep_rad), is_convex)
        rows = [np.stack([center_m, u_m, v_m, [start_rad + sweep_rad * k / n, sweep_rad / n]]) for k in range(n)]
        return [_curve(row[None], surface, side, is_convex=is_convex, is_conic=True) for row in rows]

    return make


def cubic_curves(piece: Piece, knots: FloatArray, max_segments: int = MAX_SEGMENTS) -> Maker:
    """Function that makes curves of up to `max_segments` cubics through a piece and its slope at `knots`."""

    def make(surface: int, side: float) -> list[Curves]:
        """Fewest curves of one surface and side with one sign of curvature and a limited turn each."""
        parts = [part for low, high in pairwise(knots) for part in _parts(_hermite(piece, low, high), side)]
        groups: list[list[_CubicArc]] = []
        for part in parts:
            last = groups[-1] if groups else []
            turn = part.turn_rad + sum(one.turn_rad for one in last)
            joins = last and last[0].is_convex == part.is_convex and len(last) < max_segments
            if joins and turn <= _max_turn(part.is_convex):
                last.append(part)
            else:
                groups.append([part])
        return [
            _curve(np.stack([one.row for one in group]), surface, side, is_convex=group[0].is_convex)
            for group in groups
        ]

    return make


class _CubicArc(NamedTuple):
    """A cubic of one sign of curvature."""

    row: FloatArray
    is_convex: bool
    turn_rad: float


def _parts(whole: FloatArray, side: float) -> Iterator[_CubicArc]:
    """Parts of a cubic between its inflections, each with a limited turn."""
    for low, high in pairwise([0.0, *_inflections(whole), 1.0]):
        slope, bend = _slopes(whole, (low + high) / 2)
        is_convex = bool(side * cross(slope, bend) > 0)
        ends = [_slopes(whole, t)[0] for t in (low, high)]
        turn = float(abs(np.arctan2(cross(*ends), ends[0] @ ends[1])))
        n = _n_cuts(turn, is_convex)
        for a, b in pairwise(np.linspace(low, high, n + 1)):
            yield _CubicArc(_stretch(whole, a, b), is_convex, turn / n)


def _max_turn(is_convex: bool) -> float:
    return MAX_CONVEX_TURN_RAD if is_convex else MAX_CONCAVE_TURN_RAD


def _n_cuts(turn_rad: float, is_convex: bool) -> int:
    return max(1, int(np.ceil(turn_rad / _max_turn(is_convex) - 1e-9)))


def _hermite(piece: Piece, low: float, high: float) -> FloatArray:
    ends = np.array([low, high])
    (a, b), (da, db) = piece.point(ends), piece.derivative(ends) * (high - low)
    return np.stack([2 * a - 2 * b + da + db, -3 * a + 3 * b - 2 * da - db, da, a])


def _slopes(row: FloatArray, t: float) -> tuple[FloatArray, FloatArray]:
    return (3 * row[0] * t + 2 * row[1]) * t + row[2], 6 * row[0] * t + 2 * row[1]


def _inflections(row: FloatArray) -> list[float]:
    """Parameters in (0, 1) where c' x c'' of a cubic vanishes: a quadratic, the t^3 terms cancel."""
    quadratic = [-6 * cross(row[0], row[1]), -6 * cross(row[0], row[2]), -2 * cross(row[1], row[2])]
    roots = np.roots(np.trim_zeros(np.array(quadratic, float), "f"))
    real = np.sort(roots[np.abs(roots.imag) < 1e-12].real)
    return [float(t) for t in real if 1e-9 < t < 1 - 1e-9]


def _stretch(row: FloatArray, low: float, high: float) -> FloatArray:
    """The cubic on low..high, with its parameter from 0 to 1."""
    h = high - low
    slope, bend = _slopes(row, low)
    point = ((row[0] * low + row[1]) * low + row[2]) * low + row[3]
    return np.stack([row[0] * h**3, bend * h**2 / 2, slope * h, point])


def _curve(rows: FloatArray, surface: int, side: float, *, is_convex: bool, is_conic: bool = False) -> Curves:
    padded = np.zeros((1, MAX_SEGMENTS, 4, 2))
    padded[0, : len(rows)] = rows
    bare = replace(
        joined_curves([]),
        surface=np.array([surface]),
        side=np.array([side]),
        is_convex=np.array([is_convex]),
        is_conic=np.array([is_conic]),
        n_segments=np.array([len(rows)]),
        coefficient=padded,
        **{name: np.zeros((1, *shape)) for name, shape in _NODE_SHAPES.items()},
    )
    index = np.zeros((1, N_NODES), int)
    node, first, second = bare.at(index, NODE_T[None])
    center = (node.min(axis=1) + node.max(axis=1)) / 2
    sagitta = np.linalg.norm(second, axis=-1).max() / N_NODES**2
    return replace(
        bare,
        center_m=center,
        reach_m=np.linalg.norm(node - center, axis=-1).max(axis=1) + sagitta,
        node_m=node,
        node_first=first,
        node_second=second,
        node_normal=bare.normal(index, first),
    )
