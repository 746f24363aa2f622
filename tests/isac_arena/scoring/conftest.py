import pytest

from isac_arena.scoring.chain import score_campaign
from tests.isac_arena.scoring.test_score import LIMITS


@pytest.fixture
def tables(campaign, true_power):
    """The tables of the made-up campaign, whose estimates are exact."""
    found = score_campaign(
        campaign.scene, iter(campaign.truths), campaign.results, true_power_dbm=true_power, significance=LIMITS
    )
    return found.tables
