"""The steps of long work, in words, to whoever listens."""

import logging
from collections.abc import Iterator, Sequence
from typing import TypeVar

STEPS = logging.getLogger("estimation.steps")
T = TypeVar("T")


def steps(items: Sequence[T], what: str) -> Iterator[T]:
    """The items, each told in words to whoever listens to the logger `STEPS`."""
    for number, item in enumerate(items, 1):
        STEPS.info("%s %d of %d", what, number, len(items))
        yield item
