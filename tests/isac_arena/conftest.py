from collections.abc import Callable, Iterator

import pytest

from isac_arena.validation.scenarios.perfect_campaign import MadeCampaign, make_campaign, power_dbm
from scenes.record import FloatArray
from sim.truth import Truth


@pytest.fixture(scope="session")
def campaign() -> MadeCampaign:
    return make_campaign()


@pytest.fixture(scope="session")
def true_power() -> Callable[[Truth], FloatArray]:
    return power_dbm


@pytest.fixture
def truths(campaign: MadeCampaign) -> Iterator[Truth]:
    return iter(campaign.truths)
