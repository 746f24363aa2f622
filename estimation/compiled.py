"""Compilation of hot loops: numba's `njit` with the types kept."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar, cast

import numba

F = TypeVar("F", bound=Callable[..., Any])


def compiled(function: F) -> F:
    """The function compiled at its first call (IEEE arithmetic, one thread), kept on disk for later runs."""
    return cast(F, numba.njit(cache=True, error_model="numpy")(function))
