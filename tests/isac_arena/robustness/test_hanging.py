"""A worker that hangs is ended, also where it never gives the interpreter back; one that is in time goes on."""

import multiprocessing
import re
import time
from typing import Any

import pytest

from isac_arena.workers.tasks import run_within


def hold(batch: Any) -> None:
    """Match a pattern whose time is exponential: it holds the GIL all the while."""
    del batch
    re.match(r"(a+)+b", "a" * 60)


def rest(batch: Any) -> list[None]:
    time.sleep(0.2)
    return [None for _ in batch]


@pytest.mark.parametrize(("work", "code"), [(hold, 1), (rest, 0)])
def test_a_hanging_worker_is_ended(work: Any, code: int) -> None:
    limit_s = 0.5 if code else 60.0
    process = multiprocessing.get_context("fork").Process(target=run_within, args=(limit_s, work, []))
    process.start()
    process.join(60)
    assert process.exitcode == code
