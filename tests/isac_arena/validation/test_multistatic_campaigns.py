"""The rows of the campaign with three TX: which pillars count, and what a failed run is."""

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from isac_arena.validation.chain.campaigns import ChainGroup
from isac_arena.validation.chain.run import ChainFailure
from isac_arena.validation.multistatic import campaigns


def test_a_pillar_counts_where_two_tx_light_it_from_enough_stops() -> None:
    """Pillar a: two TX, 5 stops each. b: two TX, one of them 4 times. c: one TX. The wall is no pillar."""
    paths = [("a", 0, 5), ("a", 2, 5), ("b", 0, 9), ("b", 1, 4), ("c", 1, 9), ("wall", 0, 9), ("wall", 1, 9)]
    significant = SimpleNamespace(
        object=np.concatenate([[name] * n for name, _, n in paths]),
        tx=np.concatenate([[tx] * n for _, tx, n in paths]),
        stop=np.concatenate([np.arange(n) for *_, n in paths]),
    )
    scene = SimpleNamespace(objects=[SimpleNamespace(name=name) for name in ("wall", "c", "b", "a")])
    result = cast(Any, SimpleNamespace(scene=scene, tables=SimpleNamespace(significant=significant)))
    assert campaigns._lit_by_several(result).tolist() == [True, False, False, True]
    kind = np.array(["wall", "pillar", "pillar", "pillar"])
    objects = cast(Any, SimpleNamespace(kind=kind, iou=np.array([0, 0.1, 0.2, 0.9]), coverage=np.ones(4)))
    iou, coverage = campaigns._seen_from_several([result, result], [objects, objects])
    assert iou.tolist() == [0.9, 0.9] and coverage.tolist() == [1.0, 1.0]


def test_a_campaign_that_failed_misses_its_row(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[Any] = []

    def failed(_console: object, chosen: list[Any], *_: object) -> tuple[list[Any], list[ChainFailure]]:
        asked.extend(chosen)
        return [], [ChainFailure(one.name, ChainGroup.LIBRARY, "out of memory") for one in chosen]

    monkeypatch.setattr(campaigns, "run_chain", failed)
    (row,) = campaigns.check_campaigns(7, False, trials=2)
    assert not row.met and row.value == 2 and "out of memory" in row.reason
    assert [(one.case.config.seed, one.case.stop_every) for one in asked] == [(7, 3), (8, 3)]
    assert asked[0].case.config.channel.maximum_likelihood.max_paths == 80
    assert campaigns.check_campaigns(7, True) == []
