"""Paths that a move of the search has tried in vain: they are not tried again until they move."""

import numpy as np

from estimation.channel.model.path_model import PathParameters, cells_apart
from scenes.record import BoolArray, FloatArray

SAME_CELLS = 0.02  # resolution cells within which a path is one that was tried


class TriedPaths:
    """Paths of one stop that were tried in vain."""

    def __init__(self) -> None:
        self._paths: PathParameters | None = None

    def add(self, paths: PathParameters) -> None:
        """Remember paths."""
        self._paths = paths if self._paths is None else self._paths.joined(paths)

    def among(self, paths: PathParameters, rate: FloatArray) -> BoolArray:
        """Mask (tried, path) of the places of tried paths; `rate` is the `manifold_rates` of the paths."""
        if self._paths is None:
            return np.zeros((0, len(paths)), bool)
        return cells_apart(self._paths, paths, rate) <= SAME_CELLS
