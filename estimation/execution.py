"""How numerical code runs: compiled loops, array calls over rows, one BLAS thread for small fits."""

from collections.abc import Callable
from contextlib import AbstractContextManager
from functools import lru_cache
from typing import Any, TypeVar, cast

import numba
import numpy as np
from threadpoolctl import ThreadpoolController

from estimation.kernel_cache import named_by_imports
from scenes.record import FloatArray

F = TypeVar("F", bound=Callable[..., Any])


def compiled(function: F) -> F:
    """Compile the function at its first call (IEEE arithmetic, one thread) and cache it on disk."""
    with named_by_imports():
        return cast(F, numba.njit(cache=True, error_model="numpy")(function))


def compiled_fast(function: F) -> F:
    """The same where sums may be taken in another order, and with no infinities or NaNs in them."""
    with named_by_imports():
        return cast(F, numba.njit(cache=True, error_model="numpy", fastmath=True)(function))


def over_rows(
    loop: Callable[..., tuple[FloatArray, ...]], *arguments: tuple[FloatArray, int]
) -> tuple[FloatArray, ...]:
    """Call a loop over rows with arrays that broadcast over leading axes.

    Parameters
    ----------
    loop
        Takes and returns arrays (row, ...).
    arguments
        Arrays (..., own axes), each with the number of its own axes.

    Returns
    -------
    The results of the loop, each (..., own axes).
    """
    leading = np.broadcast_shapes(*(array.shape[: array.ndim - n_own] for array, n_own in arguments))
    n_rows = int(np.prod(leading))
    rows = []
    for array, n_own in arguments:
        own = array.shape[array.ndim - n_own :]
        # A copy, also where nothing broadcasts: a view would be read-only, a type of its own to compile for.
        every = np.array(np.broadcast_to(array, (*leading, *own)), dtype=float, order="C")
        rows.append(every.reshape(n_rows, *own))
    return tuple(part.reshape(*leading, *part.shape[1:]) for part in loop(*rows))


@lru_cache(maxsize=1)
def _controller() -> ThreadpoolController:
    return ThreadpoolController()  # searches all loaded libraries: do it once


def one_blas_thread() -> AbstractContextManager[Any]:
    """Context in which BLAS uses one thread: for matrices of tens of rows more threads are slower."""
    context: AbstractContextManager[Any] = _controller().limit(limits=1, user_api="blas")
    return context
