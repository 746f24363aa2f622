"""Slots of a PRS resource: period, repetition and muting."""

import numpy as np
import pytest

from sim.signal.waveform.schedule import PrsSchedule, is_sent, sent_slots


def sent(schedule: PrsSchedule, n_slots: int) -> list[int]:
    return np.flatnonzero(is_sent(schedule, np.arange(n_slots))).tolist()


def test_repetitions_in_every_period() -> None:
    schedule = PrsSchedule(
        numerology=2, period_slots=16, offset_slots=3, resource_offset_slots=2, repetitions=4, gap_slots=2
    )
    assert sent(schedule, 32) == [5, 7, 9, 11, 21, 23, 25, 27]


def test_muting_of_whole_periods() -> None:
    schedule = PrsSchedule(numerology=2, period_slots=16, muting_1=(1, 0), muting_bit_repetition=2)
    assert sent(schedule, 128) == [0, 16, 64, 80]


def test_muting_of_repetitions() -> None:
    schedule = PrsSchedule(numerology=2, period_slots=16, repetitions=4, muting_2=(0, 1, 1, 0))
    assert sent(schedule, 32) == [1, 2, 17, 18]


def test_both_muting_patterns_have_to_agree() -> None:
    both = PrsSchedule(numerology=2, period_slots=16, repetitions=2, muting_1=(0, 1), muting_2=(0, 1))
    assert sent(both, 64) == [17, 49]


def test_sent_slots_pass_over_what_is_muted() -> None:
    schedule = PrsSchedule(
        numerology=2, period_slots=16, offset_slots=3, repetitions=4, gap_slots=2, muting_1=(0, 1, 1, 0),
        muting_bit_repetition=2, muting_2=(1, 0, 0, 1),
    )  # fmt: skip
    slots = sent_slots(schedule, 5)
    assert slots.tolist() == [[start, start + 6] for start in (35, 51, 67, 83, 163)]
    np.testing.assert_array_equal(slots.ravel(), sent(schedule, 175))
    assert sent_slots(PrsSchedule(repetitions=2), 0).shape == (0, 0)


def test_a_schedule_has_to_send_something() -> None:
    for muting in ({"muting_1": (0, 0)}, {"muting_2": (0,)}):
        with pytest.raises(ValueError, match="leave nothing that is sent"):
            sent_slots(PrsSchedule(**muting), 1)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("period_slots", 6), ("offset_slots", 80), ("repetitions", 3), ("gap_slots", 3), ("muting_1", (1, 0, 1)),
        ("muting_1", (2, 1)), ("muting_2", (1, 0)), ("muting_bit_repetition", 3), ("resource_offset_slots", -1),
    ],
)  # fmt: skip
def test_bad_schedules_name_field_and_value(field: str, value: object) -> None:
    with pytest.raises(ValueError, match=rf"PrsSchedule.{field} = .*: allowed"):
        PrsSchedule(**{field: value})  # type: ignore[arg-type]


def test_repetitions_fit_into_the_period() -> None:
    with pytest.raises(ValueError, match=r"repetitions = 8: 57 slots at gap_slots = 8 do not fit"):
        PrsSchedule(numerology=2, period_slots=16, repetitions=8, gap_slots=8)
