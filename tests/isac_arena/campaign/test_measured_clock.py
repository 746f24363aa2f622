"""The clock bias of a surveyed stop that nobody measured."""

from dataclasses import replace

import numpy as np
import pytest

from isac_arena.campaign.chain.inputs import known_receiver
from isac_arena.campaign.measured import MeasuredStop, measured_campaign, unlabelled_stop, with_clock
from scenes.pose import SPEED_OF_LIGHT_M_S, Pose

TX, RX = Pose(np.array([1.0, 2.0, 3.0]), 0.3), Pose(np.array([4.0, 6.0, 1.0]), -2.0)
BIAS_M = 25.0


def stop_with(*, has_los: bool) -> tuple:
    """A surveyed stop, and its line of sight between two other paths, or these alone."""
    azimuth = np.arctan2(4.0, 3.0)
    straight = [np.sqrt(29.0), azimuth - 0.3, azimuth - np.pi + 2.0 + 2 * np.pi]
    rows = np.array([[4.0, 1.0, 2.0], straight, [9.0, -1.0, 0.5]])[[0, 1, 2] if has_los else [0, 2]]
    none = np.zeros(len(rows), bool)
    rx = np.array([*RX.position_m[:2], RX.heading_rad])
    stop = MeasuredStop(rx, rows, np.full(len(rows), -60.0), none, none, np.full((len(rows), 2), np.nan))
    return unlabelled_stop(0, RX), measured_campaign(TX, [stop], np.array([BIAS_M])).channel[0]


def test_it_is_that_of_the_line_of_sight() -> None:
    truth, estimate = stop_with(has_los=True)
    assert known_receiver([truth]).status.tolist() == [0]
    found = with_clock(truth, estimate, TX)
    assert SPEED_OF_LIGHT_M_S * found.clock_bias_s == pytest.approx(BIAS_M, abs=1e-9)
    assert known_receiver([found]).status.tolist() == [3]


def test_it_stays_unknown_without_one_and_as_it_was_measured() -> None:
    truth, estimate = stop_with(has_los=False)
    assert np.isnan(with_clock(truth, estimate, TX).clock_bias_s)
    measured = replace(truth, clock_bias_s=1e-9)
    assert with_clock(measured, stop_with(has_los=True)[1], TX) is measured
    not_surveyed = unlabelled_stop(0, None)
    assert with_clock(not_surveyed, estimate, TX) is not_surveyed
