"""Simulated paths of a twin: the scene traced at the surveyed stops, by models of increasing completeness."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace

from isac_arena.campaign.measured import MeasuredCampaign
from scenes.scene import Scene
from sim.config import PropagationConfig
from sim.propagation.paths import Paths
from sim.propagation.propagator import Propagator

_PLAIN = PropagationConfig(max_bounces=1, diffraction=False, diffuse_samples=0, compare_planar=False)
_FULL = {"diffraction": True, "transmission": True}

# The plainest first: it corrects the offsets, because a measured path has the fewest candidates there.
MODELS: Mapping[str, PropagationConfig] = {
    "one_bounce": _PLAIN,
    "two_bounces": _PLAIN.model_copy(update={**_FULL, "max_bounces": 2}),
    "three_bounces": _PLAIN.model_copy(update={**_FULL, "max_bounces": 3}),
}


def simulate_stops(
    scene: Scene, campaign: MeasuredCampaign, config: PropagationConfig, carrier_hz: float
) -> Iterator[Paths]:
    """Paths from the measured TX to the surveyed receiver of every stop, in order."""
    propagator = Propagator(replace(scene, tx=campaign.tx), carrier_hz, config)
    for truth in campaign.truths:
        yield propagator.paths(truth.rx_pose.position_m)
