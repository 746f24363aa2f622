"""The twin: measured paths explained by the simulated paths of every model, with and without calibration."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from isac_arena.campaign.measured import MeasuredCampaign
from isac_arena.insight.twin.calibration import calibrate, explained_calibrated
from isac_arena.insight.twin.explain import chance_share, explain_paths
from isac_arena.insight.twin.offsets import leave_one_out, sight_offsets
from isac_arena.insight.twin.power import fit_power
from isac_arena.insight.twin.record import Offsets, TwinPaths
from scenes.record import BoolArray
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


@dataclass(frozen=True)
class ModelTwin:
    """A measured campaign explained by one model of propagation.

    `calibrated` has offsets, floor, reference and gains of objects from the other half of the stops. `chance` is
    the share of labelled single bounces that simulated paths of distant stops explain.
    """

    paths: TwinPaths
    calibrated: TwinPaths
    chance: float


@dataclass(frozen=True)
class Twin:
    """All models, by name, the offsets they share, and which stops have a line of sight (stop,)."""

    models: Mapping[str, ModelTwin]
    offsets: Offsets
    has_los: BoolArray
    simulated_los: BoolArray


def make_twin(campaign: MeasuredCampaign, scene: Scene, simulated: Mapping[str, Sequence[Paths]]) -> Twin:
    """Explain the measured paths of a campaign by the paths that each model simulates at its stops.

    `simulated` has for each model the paths of every stop, traced in `scene` from the measured TX to the surveyed
    receivers. Offsets come from lines of sight and straight paths. The offsets of clock and TX heading, the
    reference power and the floor of a stop come from the other stops only (leave one out).

    Raises `ValueError` where there are too few lines of sight, or a model has another number of stops than the
    campaign.
    """
    n_stops = len(campaign.truths)
    for name, paths in simulated.items():
        if len(paths) != n_stops:
            raise ValueError(f"simulated['{name}']: {len(paths)} stops, the campaign has {n_stops}")
    plainest = next(iter(simulated))
    others = leave_one_out(n_stops)
    offsets = sight_offsets(campaign, others)
    power = fit_power(campaign, simulated[plainest], others)
    calibration = calibrate(campaign, simulated[plainest])
    models = {}
    for name, paths in simulated.items():
        models[name] = ModelTwin(
            paths=explain_paths(campaign, paths, offsets, power),
            calibrated=explained_calibrated(campaign, scene, paths, calibration),
            chance=chance_share(campaign, paths, offsets),
        )
    return Twin(
        models=models,
        offsets=offsets,
        has_los=np.array([truth.is_los.any() for truth in campaign.truths]),
        simulated_los=np.array([paths.is_los.any() for paths in simulated[plainest]]),
    )


def simulate_stops(
    scene: Scene, campaign: MeasuredCampaign, config: PropagationConfig, carrier_hz: float
) -> Iterator[Paths]:
    """Paths from the measured TX to the surveyed receiver of every stop, in order."""
    propagator = Propagator(replace(scene, tx=campaign.tx), carrier_hz, config)
    for truth in campaign.truths:
        yield propagator.paths(truth.rx_pose.position_m)
