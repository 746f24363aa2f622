"""Tangents to convex contours and arc lengths along them, for waves that creep around a smooth solid."""

from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from scenes.contours.base import Contour
from scenes.contours.pieces import Piece
from scenes.record import BoolArray, FloatArray, IntArray
from sim.propagation.diffraction.edges import MIN_TURN_RAD

NODES_PER_INTERVAL = 16  # of a curved piece, between its breaks
N_GAUSS = 12
N_BISECTIONS = 60
N_NEWTON = 8
FLAT = 1e-9  # tolerance for rounding: curvature in 1/m and turn in rad
LEAST_CURVATURE = 1e-4  # 1/m; lower limit of the curvature where the contour is flatter


class TangentPoints(NamedTuple):
    """Points of tangency of rays from points (point,) to a contour; not valid at corners."""

    place_m: FloatArray
    point_m: FloatArray
    normal: FloatArray
    radius_m: FloatArray
    valid: BoolArray


@dataclass(frozen=True)
class ConvexContour:
    """A closed convex contour with a counter-clockwise table of nodes, including both ends of every piece.

    `place_m` is the arc length up to each node. `bend` is the integral of the curvature to the power 2/3 up to it,
    in m^(1/3); it sets the attenuation of a creeping wave. `corner_m` holds the arc lengths of the corners.
    """

    pieces: tuple[Piece, ...]
    piece: IntArray
    t: FloatArray
    point_m: FloatArray
    normal: FloatArray
    place_m: FloatArray
    bend: FloatArray
    corner_m: FloatArray

    @property
    def length_m(self) -> float:
        """Arc length of the whole contour."""
        return float(self.place_m[-1])

    def tangents(self, point_m: FloatArray, *, ends_light: bool) -> TangentPoints:
        """End (`ends_light`) or start of the part of the contour that is visible from points (point, xy) outside.

        End and start are in the counter-clockwise direction.
        """
        offset = point_m[None] - self.point_m[:, None]
        lit = (offset * self.normal[:, None]).sum(axis=2) > 0
        following = np.roll(lit, -1, axis=0)
        change = (lit & ~following) if ends_light else (~lit & following)
        node = change.argmax(axis=0)
        after = (node + 1) % len(self.piece)
        is_joint = self.piece[after] != self.piece[node]
        is_joint |= self.t[after] < self.t[node]
        t = np.where(is_joint, self.t[after], self._refined(point_m, node, after, lit, ~is_joint))
        piece = np.where(is_joint, self.piece[after], self.piece[node])
        point, normal, curvature = _at(self.pieces, piece, t)
        before = np.searchsorted(self.piece + self.t, piece + t, side="right") - 1
        arc, _ = _integrals(self.pieces, piece, self.t[before], t)
        return TangentPoints(
            self.place_m[before] + arc,
            point,
            normal,
            1 / np.maximum(curvature, LEAST_CURVATURE),
            change.any(axis=0) & ~(is_joint & self._is_corner(node)),
        )

    def bend_up_to(self, place_m: FloatArray) -> FloatArray:
        """The integral of the curvature to the power 2/3 from the first node to places (place,), in m^(1/3)."""
        node, t = self._parameter(place_m)
        rest = _integrals(self.pieces, self.piece[node], self.t[node], t)[1]
        return np.asarray(self.bend[node] + rest)

    def at(self, place_m: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Points and unit normals (place, xy) at places (place,) in m."""
        node, t = self._parameter(place_m)
        point, normal, _ = _at(self.pieces, self.piece[node], t)
        return point, normal

    def has_corner(self, start_m: FloatArray, arc_m: FloatArray) -> BoolArray:
        """Whether a corner lies on the arcs of length `arc_m`, counter-clockwise from `start_m` (arc,)."""
        ahead = (self.corner_m[None] - start_m[:, None]) % self.length_m
        return np.asarray((ahead < arc_m[:, None]).any(axis=1))

    def _is_corner(self, node: IntArray) -> BoolArray:
        after = (node + 1) % len(self.piece)
        turn = (self.normal[node] * self.normal[after]).sum(axis=1)
        return np.asarray(turn < np.cos(MIN_TURN_RAD))

    def _refined(
        self, point_m: FloatArray, node: IntArray, after: IntArray, lit: BoolArray, inside: BoolArray
    ) -> FloatArray:
        """The parameter (point,), between two nodes, of the end or start of the visible part of the contour."""
        low, high = self.t[node], np.where(inside, self.t[after], self.t[node])
        at_low = lit[node, np.arange(len(node))]
        for _ in range(N_BISECTIONS):
            middle = (low + high) / 2
            point, normal, _ = _at(self.pieces, self.piece[node], middle)
            same = (((point_m - point) * normal).sum(axis=1) > 0) == at_low
            low, high = np.where(same, middle, low), np.where(same, high, middle)
        return np.asarray((low + high) / 2)

    def _parameter(self, place_m: FloatArray) -> tuple[IntArray, FloatArray]:
        """Node before and parameter of places (place,) in m, by Newton's method on the arc length."""
        place = place_m % self.length_m
        node = np.minimum(np.searchsorted(self.place_m, place, side="right") - 1, len(self.t) - 2)
        piece, t = self.piece[node], self.t[node]
        for _ in range(N_NEWTON):
            gone = self.place_m[node] + _integrals(self.pieces, piece, self.t[node], t)[0]
            t = t + (place - gone) / _speed(self.pieces, piece, t)
        return node, np.clip(t, 0.0, 1.0)


def convex_contour(contour: Contour) -> ConvexContour | None:
    """The table of a contour; None if it is open, has no curved piece, or is not convex."""
    pieces = contour.pieces
    if not contour.closed or not any(piece.is_curved for piece in pieces):
        return None
    columns: list[tuple[IntArray, FloatArray]] = []
    for index, piece in enumerate(pieces):
        n = NODES_PER_INTERVAL if piece.is_curved else 1
        t = np.unique(np.concatenate([np.linspace(a, b, n + 1) for a, b in pairwise(piece.breaks)]))
        columns.append((np.full(len(t), index), t))
    piece_of, t = (np.concatenate(column) for column in zip(*columns, strict=True))
    point, normal, curvature = _at(pieces, piece_of, t)
    turn = _turn(normal, np.roll(normal, -1, axis=0))
    if curvature.min() < -FLAT or turn.min() < -FLAT:
        return None
    is_joint = np.append(np.diff(piece_of) != 0, True)
    steps = _integrals(pieces, piece_of[:-1], t[:-1], np.where(is_joint[:-1], t[:-1], t[1:]))
    place, bend = (np.concatenate([[0.0], np.cumsum(step)]) for step in steps)
    return ConvexContour(pieces, piece_of, t, point, normal, place, bend, place[is_joint & (turn > MIN_TURN_RAD)])


def _at(pieces: tuple[Piece, ...], piece: IntArray, t: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Points and unit normals (n, xy) and curvatures (n,) of pieces (n,) at parameters (n,)."""
    point, normal, curvature = np.zeros((len(t), 2)), np.zeros((len(t), 2)), np.zeros(len(t))
    for index in np.unique(piece):
        here, one = piece == index, pieces[index]
        point[here], normal[here] = one.point(t[here]), one.outward_normal(t[here])
        curvature[here] = one.curvature(t[here])
    return point, normal, curvature


def _speed(pieces: tuple[Piece, ...], piece: IntArray, t: FloatArray) -> FloatArray:
    """|c'(t)| (n,) of pieces (n,) at parameters (n,)."""
    speed = np.zeros(len(t))
    for index in np.unique(piece):
        here = piece == index
        speed[here] = np.linalg.norm(pieces[index].derivative(t[here]), axis=-1)
    return speed


def _integrals(
    pieces: tuple[Piece, ...], piece: IntArray, start: FloatArray, end: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Arc length and bend (n,) from parameters (n,) to others of the same pieces (n,), by Gauss and Legendre."""
    gauss, weight = np.polynomial.legendre.leggauss(N_GAUSS)
    arc, bend = np.zeros(len(start)), np.zeros(len(start))
    for index in np.unique(piece):
        here = piece == index
        half = (end - start)[here, None] / 2
        inside = start[here, None] + half * (1 + gauss)
        step = np.linalg.norm(pieces[index].derivative(inside), axis=-1) * weight * half
        arc[here] = step.sum(axis=1)
        bend[here] = (np.maximum(pieces[index].curvature(inside), 0.0) ** (2 / 3) * step).sum(axis=1)
    return arc, bend


def _turn(before: FloatArray, after: FloatArray) -> FloatArray:
    """Angle (...) from one direction (..., xy) to the next."""
    cross = before[..., 0] * after[..., 1] - before[..., 1] * after[..., 0]
    return np.asarray(np.arctan2(cross, (before * after).sum(axis=-1)))
