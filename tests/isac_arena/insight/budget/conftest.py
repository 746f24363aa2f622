"""A made campaign with known faults: noisy, missed, false, double and diffuse paths."""

from dataclasses import replace

import numpy as np
import pytest

from estimation.shape.config import ContourConfig, ShapeConfig
from estimation.slam.config import TrajectoryConfig
from isac_arena.campaign.config import CampaignConfig
from isac_arena.campaign.driver import CampaignRun
from isac_arena.insight.budget.chain import Chain, make_chain
from isac_arena.insight.budget.outcome import lit_objects
from isac_arena.scoring.config import Significance
from isac_arena.scoring.true_stop import true_stop
from scenes.record import concatenate

LIMITS = Significance(dynamic_range_db=28.0, noise_threshold_dbm=-150.0)
CONFIG = CampaignConfig(
    name="made",
    scene="made_up",
    trajectory=TrajectoryConfig(method="single"),
    shapes=ShapeConfig(eps_m=1.5, min_samples=3),
    contours=ContourConfig(method="none"),
)


def faulty(estimate, rng):
    """Delays and angles off by their standard deviation, one path missed, one made up; sorted by delay."""
    n = len(estimate)
    noisy = replace(
        estimate,
        delay_s=estimate.delay_s + rng.normal(0, 0.3e-9, n),
        aod_azimuth_rad=estimate.aod_azimuth_rad + rng.normal(0, np.deg2rad(0.5), n),
        aoa_azimuth_rad=estimate.aoa_azimuth_rad + rng.normal(0, np.deg2rad(0.5), n),
    )
    false = replace(
        noisy.take("path", [2]),
        delay_s=noisy.delay_s[[2]] + 7e-9,
        aoa_azimuth_rad=noisy.aoa_azimuth_rad[[2]] + 0.3,
    )
    both = concatenate([noisy.take("path", np.arange(n) != 3), false], "path")
    return both.take("path", np.argsort(both.delay_s))


@pytest.fixture(scope="session")
def stops(campaign, true_power):
    return [true_stop(truth, campaign.scene.tx, true_power(truth), LIMITS, None) for truth in campaign.truths]


@pytest.fixture(scope="session")
def chain(campaign, stops) -> Chain:
    rng = np.random.default_rng(11)
    channel = [faulty(estimate, rng) for estimate in campaign.results.channel]
    return make_chain(CampaignRun(CONFIG, campaign.scene), stops, channel, lit_objects(campaign.scene, stops, 3))
