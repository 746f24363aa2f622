"""Tracing of a sweep: at its ends and its middle, and inside only where the second order of a path is not enough.

Every path is followed by prediction: at two traced symbols it is the same path if it met the same objects and its
length and directions are where the rates say. It has one stretch from one to the other if the second order also
predicts it between them, and if it keeps to the same smooth pieces of contours: where an arc meets a face the gain
jumps, also where the face is a millimetre wide and no traced symbol falls on it. Else the time between is halved.
When a path appears or vanishes is thus found to the symbol. Between its ends only the objects that such paths meet
are looked at again.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from scenes.pose import SPEED_OF_LIGHT_M_S, wrap_angle
from scenes.record import ComplexArray, FloatArray, IntArray
from sim.propagation.motion.tracks import ANGLES
from sim.propagation.paths import Paths

TRACES_OF_A_SWEEP = 3  # at its ends and its middle, where the second order is enough
GATE_M, GATE_RAD = 0.02, 0.05  # farther from its prediction, it is another path
UNSEEN_M = 0.05  # nothing moves farther between two full traces: a shorter flash of a path is missed
FAINT = 1e-4  # of the strongest path: when a weaker one appears or vanishes is not looked for
APERTURE = 30.0  # phase over the half of an array per radian of direction
SMOOTH = 1e-2  # of the allowed phase: error of the gain

Trace = Callable[[float, IntArray | None], tuple[Paths, IntArray]]


@dataclass
class SweepTrace:
    """The traced symbols of a sweep, and the stretches found so far.

    `trace` gives paths with rates at a time, and the pieces (path, bounce) of contours that they meet.
    With objects `trace` finds only paths that meet no others.
    """

    trace: Trace
    time_s: FloatArray
    carrier_hz: float
    phase_rad: float
    top_speed_m_s: float
    states: list[Paths] = field(default_factory=list)
    state_s: list[FloatArray] = field(default_factory=list)
    stretch: list[tuple[int, int, int, float, float]] = field(default_factory=list)
    n_traces: int = 0
    n_states: int = 0
    second_order_phase_rad: float = 0.0
    _strongest: float = 1.0

    def run(self) -> Paths:
        """Trace the sweep; returns the paths of its middle symbol, which are the first states."""
        last = len(self.time_s) - 1
        middle = self._node(len(self.time_s) // 2, None)
        self._strongest = float(np.abs(middle.paths.gain).max(initial=0.0)) or 1.0
        if not last:
            self._at_once(middle, np.arange(len(middle.paths)), np.inf)
            return middle.paths
        start, end = self._node(0, None), self._node(last, None)
        every = [np.arange(len(node.paths)) for node in (start, end)]
        self._refine(start, end, every[0], every[1], [], middle)
        self._at_once(end, every[1], np.inf)
        return middle.paths

    def _node(self, symbol: int, objects: IntArray | None) -> _Node:
        paths, pieces = self.trace(float(self.time_s[symbol]), objects)
        self.n_traces += 1
        self.states.append(paths)
        self.state_s.append(np.full(len(paths), self.time_s[symbol]))
        self.n_states += len(paths)
        return _Node(symbol, float(self.time_s[symbol]), paths, pieces, self.n_states - len(paths))

    def _refine(
        self, a: _Node, b: _Node, rows_a: IntArray, rows_b: IntArray, done: list[_Done], m: _Node | None = None
    ) -> None:
        """Find the stretches of paths (rows of `a` and of `b`) between two symbols; `done` are those found."""
        if b.symbol - a.symbol == 1:
            self._at_once(a, rows_a, b.time_s)
            return
        if m is None and self._is_faint(a, rows_a) and self._is_faint(b, rows_b):
            middle_s = float(self.time_s[(a.symbol + b.symbol) // 2])
            self._at_once(a, rows_a, middle_s)
            self._at_once(b, rows_b, b.time_s, middle_s)
            return
        wide = self.top_speed_m_s * (b.time_s - a.time_s) > UNSEEN_M
        if m is None:
            objects = np.unique(np.concatenate([a.objects(rows_a), b.objects(rows_b)]))
            m = self._node((a.symbol + b.symbol) // 2, None if wide else objects)
        rows_m = m.without(done)
        found = self._smooth(a, m, b, rows_a, rows_m, rows_b)
        if wide:
            found = found[:0]
        for i, j, k in found:
            self.stretch.append((a.start + i, m.start + j, b.start + k, a.time_s, b.time_s))
        done = [*done, *(_Done(node, found[:, place]) for place, node in enumerate((a, m, b)))]
        rows_a, rows_m, rows_b = (
            np.setdiff1d(rows, found[:, place]) for place, rows in enumerate((rows_a, rows_m, rows_b))
        )
        self._refine(a, m, rows_a, rows_m, done)
        self._refine(m, b, rows_m, rows_b, done)

    def _smooth(
        self, a: _Node, m: _Node, b: _Node, rows_a: IntArray, rows_m: IntArray, rows_b: IntArray
    ) -> IntArray:
        """Rows (path, 3) at three symbols of smooth paths: predicted from both ends, on the same pieces."""
        to_m, to_b = _same(a, m, rows_a, rows_m), _same(b, m, rows_b, rows_m)
        both = np.intersect1d(to_m[:, 1], to_b[:, 1])
        rows = np.column_stack([_partner(to_m, both), both, _partner(to_b, both)])
        weight = np.abs(m.paths.gain[both]) / self._strongest
        wavenumber = 2 * np.pi * self.carrier_hz / SPEED_OF_LIGHT_M_S
        phase, turn = np.zeros(len(rows)), np.zeros(len(rows))
        for node, place in ((a, 0), (b, 2)):
            length, angles = node.predicted(rows[:, place], m.time_s)
            phase = np.maximum(phase, wavenumber * np.abs(length - m.paths.length_m[both]))
            turn = np.maximum(turn, _apart(angles, m.paths, both))
        share = (m.time_s - a.time_s) / (b.time_s - a.time_s)
        spread = [node.spread(rows[:, place], self.carrier_hz) for place, node in enumerate((a, m, b))]
        line = spread[0] + share * (spread[2] - spread[0])
        bent = np.abs(line - spread[1]) / np.maximum(np.abs(spread[1]), 1e-300)
        cubic = (8 * bent) ** 1.5 / 125  # error of a parabola where a line has the error `bent`
        self.second_order_phase_rad = max(self.second_order_phase_rad, float((phase * weight).max(initial=0.0)))
        smooth = (phase * weight <= self.phase_rad) & (cubic * weight <= SMOOTH * self.phase_rad)
        smooth &= turn**2 * APERTURE * weight <= self.phase_rad
        pieces = [node.pieces[rows[:, place]] for place, node in enumerate((a, m, b))]
        smooth &= ((pieces[0] == pieces[1]) & (pieces[1] == pieces[2])).all(axis=1)
        return rows[smooth]

    def _is_faint(self, node: _Node, rows: IntArray) -> bool:
        """Whether all these paths are so weak that it does not matter when they appear or vanish."""
        return bool((np.abs(node.paths.gain[rows]) < FAINT * self._strongest).all())

    def _at_once(self, node: _Node, rows: IntArray, to_s: float, from_s: float | None = None) -> None:
        """Stretches from a single state, by default from its symbol on."""
        for row in (rows + node.start).tolist():
            self.stretch.append((row, row, row, node.time_s if from_s is None else from_s, to_s))


@dataclass(frozen=True)
class _Node:
    """Paths at a symbol, and where they start among all states."""

    symbol: int
    time_s: float
    paths: Paths
    pieces: IntArray
    start: int

    def predicted(self, rows: IntArray, time_s: float) -> tuple[FloatArray, FloatArray]:
        """Lengths (path,) and angles (path, 4) at another time, to second and first order."""
        gone, rates = time_s - self.time_s, self.paths.rates
        assert rates is not None
        length = self.paths.length_m[rows] + gone * (
            rates.length_rate_m_s[rows] + gone * rates.length_acceleration_m_s2[rows] / 2
        )
        angles = [
            getattr(self.paths, f"{name}_rad")[rows] + gone * getattr(rates, f"{name}_rate_rad_s")[rows]
            for name in ANGLES
        ]
        return length, np.stack(angles, axis=1)

    def spread(self, rows: IntArray, carrier_hz: float) -> ComplexArray:
        """Gain over that of free space of the same length, without its phase."""
        paths = self.paths
        turn = np.exp(2j * np.pi * carrier_hz * paths.delay_s[rows])
        return np.asarray(paths.gain[rows] * paths.length_m[rows] * turn)

    def objects(self, rows: IntArray) -> IntArray:
        """All objects that paths meet."""
        return np.unique(self.paths.bounce_object[rows])

    def without(self, done: list[_Done]) -> IntArray:
        """Rows of the paths that are none of those found already."""
        rows = np.arange(len(self.paths))
        for one in done:
            rows = np.setdiff1d(rows, _same(one.node, self, one.rows, rows)[:, 1])
        return rows


@dataclass(frozen=True)
class _Done:
    """Rows of a node whose paths have their stretches."""

    node: _Node
    rows: IntArray


def _same(a: _Node, b: _Node, rows_a: IntArray, rows_b: IntArray) -> IntArray:
    """Rows (pair, 2) of the same paths at two symbols: each the nearest to the prediction of the other."""
    one, other = a.paths, b.paths
    same = (one.bounce_object[rows_a, None] == other.bounce_object[None, rows_b]).all(axis=2)
    same &= (one.bounce_kind[rows_a, None] == other.bounce_kind[None, rows_b]).all(axis=2)
    length, angles = a.predicted(rows_a, b.time_s)
    apart = np.abs(length[:, None] - other.length_m[None, rows_b])
    turned = np.zeros(apart.shape)
    for place, name in enumerate(ANGLES):
        offset = wrap_angle(angles[:, None, place] - getattr(other, f"{name}_rad")[None, rows_b])
        turned = np.maximum(turned, np.abs(offset))
    same &= (apart < GATE_M) & (turned < GATE_RAD)
    cost = np.where(same, apart / GATE_M + turned / GATE_RAD, np.inf)
    if not cost.size:
        return np.zeros((0, 2), int)
    best_b, best_a = cost.argmin(axis=1), cost.argmin(axis=0)
    mutual = (best_a[best_b] == np.arange(len(rows_a))) & np.isfinite(cost.min(axis=1))
    return np.column_stack([rows_a[mutual], rows_b[best_b[mutual]]])


def _partner(pairs: IntArray, seconds: IntArray) -> IntArray:
    """First entries of pairs, in the order of their second ones."""
    order = np.argsort(pairs[:, 1])
    return np.asarray(pairs[order[np.searchsorted(pairs[order, 1], seconds)], 0])


def _apart(angles: FloatArray, paths: Paths, rows: IntArray) -> FloatArray:
    """Largest difference (path,) in rad of angles (path, 4) from those of paths."""
    true = np.stack([getattr(paths, f"{name}_rad")[rows] for name in ANGLES], axis=1)
    return np.asarray(np.abs(wrap_angle(angles - true)).max(axis=1, initial=0.0))
