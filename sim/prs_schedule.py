"""In which slots a PRS resource is sent: period, repetition and muting, TS 38.211 clause 7.4.1.7.4."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from scenes.record import BoolArray, IntArray

PERIODS = (4, 5, 8, 10, 16, 20, 32, 40, 64, 80, 160, 320, 640, 1280, 2560, 5120, 10240)
REPETITIONS = (1, 2, 4, 6, 8, 16, 32)
GAPS = (1, 2, 4, 8, 16, 32)
MUTING_1_LENGTHS = (2, 4, 6, 8, 16, 32)
MUTING_BIT_REPETITIONS = (1, 2, 4, 8)


@dataclass(frozen=True)
class PrsSchedule:
    """Slots of one resource. All counts are in slots, except the repetitions; muting bits are 1 for sent.

    The resource is sent `repetitions` times, `gap` slots apart, in every `period` of its set. `muting_1` has a bit
    for `muting_bit_repetition` consecutive periods, `muting_2` one for each repetition within a period; where both
    are given, both bits have to be 1.

    Raises
    ------
    ValueError
        For values outside of TS 38.211 clause 7.4.1.7.4 and TS 38.214 clause 5.1.6.5.
    """

    numerology: int = 3
    period: int = 80
    offset: int = 0
    resource_offset: int = 0
    repetitions: int = 1
    gap: int = 1
    muting_1: tuple[int, ...] | None = None
    muting_bit_repetition: int = 1
    muting_2: tuple[int, ...] | None = None

    def __post_init__(self) -> None:
        periods = [2**self.numerology * base for base in PERIODS]
        checks = {
            "numerology": (0 <= self.numerology <= 3, "0 to 3"),
            "period": (self.period in periods, f"2^mu times one of {_listed(PERIODS)}"),
            "offset": (0 <= self.offset < self.period, "0 to period - 1"),
            "resource_offset": (0 <= self.resource_offset < min(self.period, 512), "0 to 511, within the period"),
            "repetitions": (self.repetitions in REPETITIONS, _listed(REPETITIONS)),
            "gap": (self.gap in GAPS, _listed(GAPS)),
            "muting_1": (_is_bitmap(self.muting_1, MUTING_1_LENGTHS), f"{_listed(MUTING_1_LENGTHS)} bits"),
            "muting_bit_repetition": (
                self.muting_bit_repetition in MUTING_BIT_REPETITIONS, _listed(MUTING_BIT_REPETITIONS),
            ),
            "muting_2": (_is_bitmap(self.muting_2, (self.repetitions,)), "one bit per repetition"),
        }  # fmt: skip
        for name, (valid, allowed) in checks.items():
            if not valid:
                raise ValueError(f"PrsSchedule.{name} = {getattr(self, name)}: allowed is {allowed}")
        span = (self.repetitions - 1) * self.gap + 1
        if span > self.period:
            raise ValueError(
                f"PrsSchedule.repetitions = {self.repetitions}: {span} slots at gap = {self.gap} do not fit into"
                f" the period of {self.period}"
            )


def is_sent(schedule: PrsSchedule, slot: IntArray) -> BoolArray:
    """Whether the resource is sent in slots (slot,), counted from the start of frame 0."""
    since = np.asarray(slot) - schedule.offset - schedule.resource_offset
    place = since % schedule.period
    repetition = place // schedule.gap
    sent = (place % schedule.gap == 0) & (repetition < schedule.repetitions)
    if schedule.muting_1 is not None:
        instance = since // (schedule.muting_bit_repetition * schedule.period)
        sent = sent & np.asarray(schedule.muting_1, bool)[instance % len(schedule.muting_1)]
    if schedule.muting_2 is not None:
        sent = sent & np.asarray(schedule.muting_2, bool)[repetition % len(schedule.muting_2)]
    return np.asarray(sent)


def _is_bitmap(bits: tuple[int, ...] | None, lengths: tuple[int, ...]) -> bool:
    return bits is None or (len(bits) in lengths and set(bits) <= {0, 1})


def _listed(values: tuple[int, ...]) -> str:
    return ", ".join(map(str, values))
