"""Works that are timed in turns: their order, how often they are called, and the times per call."""

from numpy.testing import assert_array_equal

from isac_arena.validation.benches.timing import paired_ratios, times_in_turns


def made(costs_s):
    """Works that cost so many seconds of a clock of their own, the clock, and what was called."""
    now, called = [0.0], []

    def work(number):
        def run():
            called.append(number)
            now[0] += costs_s[number]

        return run

    return [work(number) for number in range(len(costs_s))], lambda: now[0], called


def test_works_take_turns_after_a_round_that_is_not_counted():
    works, clock, called = made([1.0, 4.0])
    times = times_in_turns(works, 2, (3, 1), clock=clock)
    assert_array_equal(times, [[1.0, 4.0], [1.0, 4.0]])
    assert called == 3 * [0, 0, 0, 1]


def test_compiled_works_need_no_first_round():
    works, clock, called = made([2.0, 1.0])
    times_in_turns(works, 2, is_warm=True, clock=clock)
    assert called == [0, 1, 0, 1]


def test_ratios_are_of_the_two_works_of_a_pair():
    works, _, called = made([0.0, 0.0])
    ratios, times_s = paired_ratios(*works, 3)
    assert called == 4 * [0, 1]
    assert_array_equal(ratios, times_s[:, 0] / times_s[:, 1])
