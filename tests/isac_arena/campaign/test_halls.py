"""Halls of campaigns: when one is read, what is kept, and what later stages get."""

from dataclasses import replace

import numpy as np
import pytest

from estimation.channel.hall.record import HallClass
from isac_arena.campaign.campaign import load_campaign
from isac_arena.campaign.chain.halls import has_hall, in_halls, keeps_hall, make_halls
from isac_arena.campaign.driver import CampaignRun
from isac_arena.user_functions.config import with_functions
from sim.truth import Truth

STOPS = (0, 1)


@pytest.fixture(scope="module")
def run() -> CampaignRun:
    return load_campaign("box_room", channel={"maximum_likelihood": {"max_paths": 12}}).chain(STOPS)


@pytest.fixture(scope="module")
def truths(run: CampaignRun) -> list[Truth]:
    return list(run.truths())


def test_channel_estimates_come_with_what_the_hall_tells(run: CampaignRun, truths: list[Truth]) -> None:
    found = list(run.channel(truths))
    kept = run.results.hall()
    assert kept is not None and kept.model is not None
    for estimate, truth in zip(found, truths, strict=True):
        reported = run.results.estimate(truth.stop)
        assert reported is not None and reported.correlated is not None
        assert estimate.hall is not None and estimate.correlated is None
        assert len(estimate) == len(reported.reported)
        line_of_sight = estimate.hall.class_probability[:, list(HallClass).index(HallClass.LINE_OF_SIGHT)]
        assert line_of_sight[estimate.is_los].sum() > 0.5
    again = list(run.channel(truths))
    assert run.results.hall() is kept
    for one, two in zip(found, again, strict=True):
        np.testing.assert_array_equal(one.delay_s, two.delay_s)


def test_a_hall_of_other_stops_is_not_used(run: CampaignRun, truths: list[Truth]) -> None:
    list(run.channel(truths))
    reported = [run.results.estimate(truth.stop) for truth in truths[:1]]
    [one] = in_halls(run, [[each.reported for each in reported if each is not None]])
    assert one.stop == STOPS[0]
    hall = run.results.hall()
    assert hall is not None and hall.stops.tolist() == [STOPS[0]]


def test_halls_are_made_again_only_where_asked_for(run: CampaignRun, truths: list[Truth]) -> None:
    list(run.channel(truths))
    make_halls(run, again=False)
    before = run.results.hall()
    make_halls(run, again=True)
    after = run.results.hall()
    assert before is not None and after is not None and after is not before
    np.testing.assert_array_equal(before.paths.delay_s, after.paths.delay_s)


def test_without_a_hall_the_reported_paths_come_through(run: CampaignRun, truths: list[Truth]) -> None:
    channel = run.config.channel
    off = channel.model_copy(update={"hall": channel.hall.model_copy(update={"use": False})})
    other = replace(run, config=run.config.model_copy(update={"channel": off}))
    assert not keeps_hall(other.config)
    for estimate, truth in zip(other.channel(truths), truths, strict=True):
        kept = run.results.estimate(truth.stop)
        assert kept is not None and estimate.hall is None
        np.testing.assert_array_equal(estimate.delay_s, kept.reported.delay_s)


def test_the_power_method_and_own_estimators_have_no_hall(run: CampaignRun) -> None:
    assert has_hall(run)
    power = run.config.channel.model_copy(update={"method": "power"})
    assert not has_hall(replace(run, config=run.config.model_copy(update={"channel": power})))
    own = with_functions(run.config, {"channel": "module:function"})
    assert not has_hall(replace(run, config=own))
