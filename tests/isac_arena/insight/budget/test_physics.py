from dataclasses import replace

import numpy as np
import pytest

from isac_arena.campaign.config import CampaignConfig
from isac_arena.insight.budget.physics import observe_without, present_physics, without_hardware, without_paths
from isac_arena.insight.budget.stages import Physics
from sim.config import ArrayConfig, WaveformConfig
from sim.signal.hardware.config import ImpairmentsConfig
from sim.signal.link import make_link
from sim.simulate import observe

CONFIG = CampaignConfig(
    name="small",
    scene="made_up",
    waveform=WaveformConfig(comb=12),
    tx_array=ArrayConfig(rows=1, columns=4, beams_per_panel=4),
    rx_array=ArrayConfig(rows=1, columns=4, beams_per_panel=4),
)
ALL = frozenset(Physics)


@pytest.fixture(scope="module")
def link():
    return make_link(CONFIG)


def test_what_is_there_can_be_switched_off(campaign):
    assert present_physics(CONFIG, campaign.truths) == (Physics.DIFFUSE, Physics.MULTI_BOUNCE, Physics.NOISE)
    bare = [without_paths(truth, ALL) for truth in campaign.truths]
    rough = CONFIG.model_copy(update={"impairments": ImpairmentsConfig(cfo_hz=100.0)})
    assert present_physics(rough, bare) == (Physics.NOISE, Physics.IMPAIRMENTS)
    assert without_hardware(rough, ALL).impairments == ImpairmentsConfig()
    assert without_hardware(rough, frozenset()) is rough


def test_paths_are_switched_off_by_kind(campaign):
    truth = campaign.truths[0]
    assert not without_paths(truth, frozenset({Physics.DIFFUSE})).paths.is_diffuse.any()
    single = without_paths(truth, frozenset({Physics.MULTI_BOUNCE})).paths
    assert single.n_bounces.max() == 1 and single.is_diffuse.any()
    assert len(without_paths(truth, frozenset({Physics.NOISE})).paths) == len(truth.paths)


def test_without_noise_the_rest_of_the_samples_stays_the_same(campaign, link):
    truth, scene = campaign.truths[0], campaign.scene
    noisy = observe_without(CONFIG, link, scene, truth, frozenset())
    np.testing.assert_array_equal(noisy.samples, observe(CONFIG, link, scene, truth).samples)
    clean = observe_without(CONFIG, link, scene, truth, frozenset({Physics.NOISE}))
    np.testing.assert_array_equal(clean.noise_power_mw, noisy.noise_power_mw)
    silent = replace(truth, paths=truth.paths.take("path", slice(0, 0)))
    noise = observe_without(CONFIG, link, scene, silent, frozenset()).samples
    level = np.sqrt(link.noise_power_mw.max())
    np.testing.assert_allclose(clean.samples, noisy.samples - noise, atol=5e-3 * level)
    assert np.abs(noise).max() > level
