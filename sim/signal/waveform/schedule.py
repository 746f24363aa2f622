"""Slots of a PRS resource: period, repetition and muting, TS 38.211 clause 7.4.1.7.4."""

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
    """Slots of one resource; a muting bit of 1 means sent.

    The resource is sent `repetitions` times, `gap_slots` apart, in every period of its set. `muting_1` has a bit
    for `muting_bit_repetition` consecutive periods, `muting_2` one for each repetition within a period. If both
    are given, both bits must be 1.

    Raises `ValueError` For values outside of TS 38.211 clause 7.4.1.7.4 and TS 38.214 clause 5.1.6.5.
    """

    numerology: int = 3
    period_slots: int = 80
    offset_slots: int = 0
    resource_offset_slots: int = 0
    repetitions: int = 1
    gap_slots: int = 1
    muting_1: tuple[int, ...] | None = None
    muting_bit_repetition: int = 1
    muting_2: tuple[int, ...] | None = None

    def __post_init__(self) -> None:
        periods = [2**self.numerology * base for base in PERIODS]
        checks = {
            "numerology": (0 <= self.numerology <= 3, "0 to 3"),
            "period_slots": (self.period_slots in periods, f"2^mu times one of {_listed(PERIODS)}"),
            "offset_slots": (0 <= self.offset_slots < self.period_slots, "0 to period_slots - 1"),
            "resource_offset_slots": (
                0 <= self.resource_offset_slots < min(self.period_slots, 512), "0 to 511, within the period",
            ),
            "repetitions": (self.repetitions in REPETITIONS, _listed(REPETITIONS)),
            "gap_slots": (self.gap_slots in GAPS, _listed(GAPS)),
            "muting_1": (_is_bitmap(self.muting_1, MUTING_1_LENGTHS), f"{_listed(MUTING_1_LENGTHS)} bits"),
            "muting_bit_repetition": (
                self.muting_bit_repetition in MUTING_BIT_REPETITIONS, _listed(MUTING_BIT_REPETITIONS),
            ),
            "muting_2": (_is_bitmap(self.muting_2, (self.repetitions,)), "one bit per repetition"),
        }  # fmt: skip
        for name, (valid, allowed) in checks.items():
            if not valid:
                raise ValueError(f"PrsSchedule.{name} = {getattr(self, name)}: allowed is {allowed}")
        span = (self.repetitions - 1) * self.gap_slots + 1
        if span > self.period_slots:
            raise ValueError(
                f"PrsSchedule.repetitions = {self.repetitions}: {span} slots at gap_slots = {self.gap_slots} do"
                f" not fit into the period of {self.period_slots}"
            )


def is_sent(schedule: PrsSchedule, slot: IntArray) -> BoolArray:
    """Whether the resource is sent in slots (slot,), counted from the start of frame 0."""
    since = np.asarray(slot) - schedule.offset_slots - schedule.resource_offset_slots
    place = since % schedule.period_slots
    repetition = place // schedule.gap_slots
    sent = (place % schedule.gap_slots == 0) & (repetition < schedule.repetitions)
    if schedule.muting_1 is not None:
        instance = since // (schedule.muting_bit_repetition * schedule.period_slots)
        sent = sent & np.asarray(schedule.muting_1, bool)[instance % len(schedule.muting_1)]
    if schedule.muting_2 is not None:
        sent = sent & np.asarray(schedule.muting_2, bool)[repetition % len(schedule.muting_2)]
    return np.asarray(sent)


def sent_slots(schedule: PrsSchedule, n_instances: int) -> IntArray:
    """Slots (instance, repetition) of the first instances that are sent, without the muted ones.

    An instance is the set of repetitions in one period. Raises `ValueError` if everything is muted.
    """
    n_bits = 1 if schedule.muting_1 is None else len(schedule.muting_1)
    n_periods = n_instances * n_bits * schedule.muting_bit_repetition
    first = schedule.offset_slots + schedule.resource_offset_slots
    instance = first + schedule.period_slots * np.arange(n_periods)
    slot = instance[:, None] + schedule.gap_slots * np.arange(schedule.repetitions)
    sent = is_sent(schedule, slot)
    if n_instances and not sent.any():
        raise ValueError(
            f"PrsSchedule: muting_1 = {schedule.muting_1} and muting_2 = {schedule.muting_2} leave nothing that is"
            " sent, at least 1 bit of each must be 1"
        )
    return np.asarray(slot[sent.any(axis=1)][:n_instances][:, sent.any(axis=0)])


def _is_bitmap(bits: tuple[int, ...] | None, lengths: tuple[int, ...]) -> bool:
    return bits is None or (len(bits) in lengths and set(bits) <= {0, 1})


def _listed(values: tuple[int, ...]) -> str:
    return ", ".join(map(str, values))
