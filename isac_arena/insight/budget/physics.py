"""Physics switched off: a campaign without some paths, noise or impairments, on the same random numbers."""

from collections.abc import Sequence
from dataclasses import replace

from isac_arena.campaign.config import CampaignConfig
from isac_arena.insight.budget.stages import Part, Physics
from scenes.scene import Scene
from sim.observation import BeamSweep
from sim.signal.hardware.config import ImpairmentsConfig
from sim.signal.link import Link
from sim.simulate import observe
from sim.truth import Truth

QUIET = 1e-6  # noise switched off: 60 dB less, so that levels estimated from the data stay defined


def present_physics(config: CampaignConfig, truths: Sequence[Truth]) -> tuple[Part, ...]:
    """The physics of a campaign that can be switched off."""
    found = {
        Physics.DIFFUSE: any(truth.paths.is_diffuse.any() for truth in truths),
        Physics.MULTI_BOUNCE: any((truth.paths.n_bounces > 1).any() for truth in truths),
        Physics.NOISE: True,
        Physics.IMPAIRMENTS: bool(config.impairments.switched_on),
    }
    return tuple(part for part, is_there in found.items() if is_there)


def without_hardware(config: CampaignConfig, off: frozenset[Part]) -> CampaignConfig:
    """The settings without impairments where these are off."""
    if Physics.IMPAIRMENTS not in off:
        return config
    return config.model_copy(update={"impairments": ImpairmentsConfig()})


def without_paths(truth: Truth, off: frozenset[Part]) -> Truth:
    """The truth without diffuse paths or those that bounce more than once, where these are off."""
    paths = truth.paths
    if Physics.DIFFUSE in off:
        paths = paths.take("path", ~paths.is_diffuse)
    if Physics.MULTI_BOUNCE in off:
        paths = paths.take("path", paths.n_bounces <= 1)
    return replace(truth, paths=paths)


def observe_without(
    config: CampaignConfig, link: Link, scene: Scene, truth: Truth, off: frozenset[Part]
) -> BeamSweep:
    """The samples of a stop, without noise where it is off; the sweep states the nominal noise power anyway."""
    if Physics.NOISE not in off:
        return observe(config, link, scene, truth)
    quiet = replace(link, noise_power_mw=link.noise_power_mw * QUIET)
    return replace(observe(config, quiet, scene, truth), noise_power_mw=link.noise_power_mw)
