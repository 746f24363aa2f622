"""Scores of clusters: the rows of all groups at once, and a cost in proportion to the points."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from isac_arena.scoring.causes import cluster_causes
from isac_arena.scoring.metrics.statistics import rows_of_groups
from isac_arena.scoring.provenance import cluster_origin


class Counted(np.ndarray):
    """An array that counts the elements that are compared."""

    elements = 0

    def __array_ufunc__(self, ufunc: Any, method: str, *inputs: Any, **options: Any) -> Any:
        plain = [np.asarray(each) for each in inputs]
        if ufunc in (np.equal, np.not_equal):
            Counted.elements += max(each.size for each in plain)
        return getattr(ufunc, method)(*plain, **options)


def test_rows_of_groups_are_those_of_masks() -> None:
    label = np.random.default_rng(1).integers(-1, 7, 60)
    for group, rows in enumerate(rows_of_groups(label, 9)):
        np.testing.assert_array_equal(rows, np.flatnonzero(label == group))
    assert [len(rows) for rows in rows_of_groups(np.zeros(0, int), 2)] == [0, 0]


def origins(n: int) -> None:
    label, objects = np.arange(n).view(Counted), np.full(n, "wall").view(Counted)
    cluster_origin(label, objects, n)


def causes(n: int) -> None:
    label, objects = np.arange(n).view(Counted), np.full(n, "").view(Counted)
    cluster_causes(label, objects, np.full(n, "noise"), np.ones(n, bool))


@pytest.mark.parametrize("score", [origins, causes])
def test_twice_the_clusters_cost_twice(score: Callable[[int], None]) -> None:
    counts = []
    for n in (200, 400):
        Counted.elements = 0
        score(n)
        counts.append(Counted.elements)
    assert 0 < counts[1] <= 2.2 * counts[0]
