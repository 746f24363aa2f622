"""Numerics of matched-filter spectra: products in single precision, powers, local maxima."""

import numpy as np

from estimation.execution import compiled
from scenes.record import BoolArray, ComplexArray, FloatArray, IntArray


def times(matched: ComplexArray | FloatArray, samples: ComplexArray) -> ComplexArray:
    """Product of a matrix, real or complex, with samples, in single precision."""
    if np.iscomplexobj(matched):
        return np.asarray(matched @ samples)
    return np.asarray((matched @ samples.view(np.float32)).view(np.complex64))


def cell_power(value: ComplexArray) -> FloatArray:
    """Power of complex samples."""
    power = np.square(value.real)
    power += np.square(value.imag)
    return np.asarray(power)


def with_neighbours(needed: BoolArray) -> BoolArray:
    """The delays needed and those next to them, which show whether they are local maxima."""
    wide = np.pad(needed, 1)
    return np.asarray(wide[:-2] | wide[1:-1] | wide[2:])


def local_maxima(
    power: FloatArray, first_neighbour: IntArray, second_neighbour: IntArray, level: np.float32
) -> IntArray:
    """Cells (peak, 3) of power (direction, direction, delay) over `level` that no neighbour exceeds.

    Of equal neighbours the first counts.
    """
    cells = np.flatnonzero(power.ravel() > level)
    kept = _is_maximum(power, first_neighbour, second_neighbour, cells)
    return np.stack(np.unravel_index(cells[kept], power.shape), axis=1)


@compiled
def _is_maximum(
    power: FloatArray, first_neighbour: IntArray, second_neighbour: IntArray, cells: IntArray
) -> BoolArray:
    """Whether no neighbour exceeds cells (cell,) of power (direction, direction, delay), numbered in its order."""
    _, n_second, n_delays = power.shape
    kept = np.zeros(len(cells), np.bool_)
    for k in range(len(cells)):
        row, d = divmod(cells[k], n_delays)
        i, j = divmod(row, n_second)
        value = power[i, j, d]
        if d > 0 and power[i, j, d - 1] >= value:
            continue
        if d + 1 < n_delays and power[i, j, d + 1] > value:
            continue
        kept[k] = _tops_directions(power, first_neighbour[i], second_neighbour[j], (i, j, d))
    return kept


@compiled
def _tops_directions(
    power: FloatArray, first_neighbour: IntArray, second_neighbour: IntArray, cell: tuple[int, int, int]
) -> bool:
    """Whether no neighbouring pair of directions exceeds a cell at its delay; of equal ones the first counts."""
    i, j, d = cell
    value = power[i, j, d]
    for a in first_neighbour:
        for b in second_neighbour:
            other = power[a, b, d]
            if other > value or (other == value and (a, b) < (i, j)):
                return False
    return True
