"""Least squares with an information matrix of one banded block of stops and a border of shared parameters.

[ B  E ]   B: a square block per stop, coupled to the next two stops (second differences of position);
[ E' C ]   E, C: shared parameters (session offsets, landmarks).

The solution and the marginal covariances take time linear in the number of stops.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.linalg import lapack

from scenes.record import FloatArray

_COUPLING = 2  # a stop is coupled to this many later stops
_ROUNDING = (0.0, 1e-15, 1e-14, 1e-13, 1e-12)  # relative growth of the diagonal, one after the other


class ArrowCovariance(NamedTuple):
    """Blocks of the inverse of an information matrix; those between stops are left out."""

    states: FloatArray  # (stop, state, state)
    shared: FloatArray  # (shared, shared)
    across: FloatArray  # (stop, state, shared)


@dataclass(frozen=True)
class ArrowSystem:
    """Information matrix and gradient; `damped` and `solve` do not change it."""

    diagonal: FloatArray  # (stop, state, state)
    next1: FloatArray  # (stop - 1, state, state), rows of stop k, columns of stop k + 1
    next2: FloatArray  # (stop - 2, state, state)
    border: FloatArray  # (stop, state, shared)
    corner: FloatArray  # (shared, shared)
    gradient: FloatArray  # (stop, state)
    shared_gradient: FloatArray  # (shared,)

    @property
    def _size(self) -> int:
        """Length of the state of a stop."""
        return int(self.diagonal.shape[-1])

    @property
    def _band(self) -> int:
        return self._size * (_COUPLING + 1) - 1

    def damped(self, damping: float) -> ArrowSystem:
        """The system with its diagonal multiplied by 1 + damping."""
        diagonal, corner = self.diagonal.copy(), self.corner.copy()
        index = np.arange(self._size)
        diagonal[:, index, index] *= 1 + damping
        np.fill_diagonal(corner, np.diag(corner) * (1 + damping))
        return replace(self, diagonal=diagonal, corner=corner)

    def solve(self) -> tuple[FloatArray, FloatArray]:
        """Steps of the states (stop, state) and of the shared parameters that zero the gradient."""
        states, shared = self.solve_for(self.gradient.reshape(-1, 1), self.shared_gradient.reshape(-1, 1))
        return -states.reshape(-1, self._size), -shared[:, 0]

    def solve_for(self, states: FloatArray, shared: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Inverse of the matrix times columns given as (state stop, column) and (shared, column)."""
        n_shared = len(self.corner)
        border = self.border.reshape(len(self.border) * self._size, n_shared)
        solved = self._solve_banded(np.hstack([states, border]))
        free, through = solved[:, : states.shape[1]], solved[:, states.shape[1] :]
        if not n_shared:
            return free, shared
        schur = self.corner - border.T @ through
        bordered = np.asarray(np.linalg.solve(schur, shared - border.T @ free), float)
        return free - through @ bordered, bordered

    def covariance(self) -> ArrowCovariance:
        """Covariances of the states, of the shared parameters, and of the states with the shared parameters."""
        blocks = self._inverse_blocks()
        n_shared = len(self.corner)
        if not n_shared:
            return ArrowCovariance(blocks, np.empty((0, 0)), np.empty((*blocks.shape[:2], 0)))
        border = self.border.reshape(len(self.border) * self._size, n_shared)
        through = self._solve_banded(border)
        shared: FloatArray = np.asarray(np.linalg.inv(self.corner - border.T @ through))
        through = through.reshape(-1, self._size, n_shared)
        across = -through @ shared
        return ArrowCovariance(blocks - across @ np.swapaxes(through, 1, 2), shared, across)

    def log_determinant(self) -> float:
        """Logarithm of the determinant of the matrix. `LinAlgError` as for a solution."""
        border = self.border.reshape(len(self.border) * self._size, len(self.corner))
        schur = self.corner - border.T @ self._solve_banded(border)
        return float(2 * np.log(self._factor()[self._band]).sum() + np.linalg.slogdet(schur)[1])

    def _solve_banded(self, right_side: FloatArray) -> FloatArray:
        """Inverse of B times columns (state stop, column). `LinAlgError` where B is not positive definite."""
        solved, _ = lapack.dpbtrs(self._factor(), right_side)
        return np.asarray(solved)

    def _factor(self) -> FloatArray:
        """Cholesky factor of B in banded form. `LinAlgError` where B is not positive definite.

        Where the information of one path about a stop is 1e16 times that of the rest, rounding alone can make B
        indefinite. Then its diagonal grows by as little as helps.
        """
        order = 0
        for growth in _ROUNDING:
            banded = self._banded()
            banded[-1] *= 1 + growth
            factor, order = lapack.dpbtrf(banded, overwrite_ab=1)
            if not order:
                return np.asarray(factor)
        raise np.linalg.LinAlgError(f"the block of stop {(order - 1) // self._size} is not positive definite")

    def _banded(self) -> FloatArray:
        """B in the upper banded form of scipy.linalg."""
        n = len(self.diagonal)
        banded = np.zeros((self._band + 1, n * self._size))
        rows, columns = np.indices((self._size, self._size))
        for ahead, block in enumerate((self.diagonal, self.next1, self.next2)):
            distance = ahead * self._size + columns - rows
            kept = distance >= 0
            k = np.arange(len(block))[:, None]
            banded[self._band - distance[kept], (k + ahead) * self._size + columns[kept]] = block[:, kept]
        return banded

    def _inverse_blocks(self) -> FloatArray:
        """Diagonal blocks of the inverse of B, by the backward recursion over pairs of stops."""
        n = len(self.diagonal)
        pairs = (n + 1) // 2
        main = np.zeros((pairs, 2 * self._size, 2 * self._size))
        upper = np.zeros((max(pairs - 1, 0), 2 * self._size, 2 * self._size))
        first, second = slice(0, self._size), slice(self._size, None)
        main[:, second, second] = np.eye(self._size)
        main[:, first, first] = self.diagonal[::2]
        main[: n // 2, second, second] = self.diagonal[1::2]
        inside = self.next1[::2]
        main[: len(inside), first, second] = inside
        main[: len(inside), second, first] = np.swapaxes(inside, 1, 2)
        upper[: len(self.next1[1::2]), second, first] = self.next1[1::2]
        upper[: len(self.next2[::2]), first, first] = self.next2[::2]
        upper[: len(self.next2[1::2]), second, second] = self.next2[1::2]
        pivots = [main[0]]
        for k in range(pairs - 1):
            pivots.append(main[k + 1] - upper[k].T @ np.linalg.solve(pivots[k], upper[k]))
        inverse = np.empty_like(main)
        inverse[-1] = np.linalg.inv(pivots[-1])
        for k in range(pairs - 2, -1, -1):
            own = np.linalg.inv(pivots[k])
            gain = own @ upper[k]
            inverse[k] = own + gain @ inverse[k + 1] @ gain.T
        blocks = np.empty((2 * pairs, self._size, self._size))
        blocks[::2], blocks[1::2] = inverse[:, first, first], inverse[:, second, second]
        return blocks[:n]
