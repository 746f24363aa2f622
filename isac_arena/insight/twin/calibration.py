"""Offsets, power and gains of objects that are estimated from one half of the stops and applied to the other."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from isac_arena.campaign.measured import MeasuredCampaign
from isac_arena.insight.twin.explain import explain_paths
from isac_arena.insight.twin.offsets import corrected_offsets, leave_one_out, other_half, sight_offsets
from isac_arena.insight.twin.power import PowerModel, calibrated_signal_dbm, fit_power, object_gains, over_floor
from isac_arena.insight.twin.record import Offsets, TwinPaths
from scenes.record import BoolArray
from scenes.scene import Scene
from sim.propagation.paths import Paths


@dataclass(frozen=True)
class StopCalibration:
    """Offsets and power of every stop, estimated from other stops."""

    offsets: Offsets
    power: PowerModel


@dataclass(frozen=True)
class TwinCalibration:
    """Calibration of every stop from the other stops of its half (`within`) and from the other half (`across`).

    `half` (stop, stop) is true where the second stop is in the other half than the first.
    """

    within: StopCalibration
    across: StopCalibration
    half: BoolArray


def calibrate(campaign: MeasuredCampaign, simulated: Sequence[Paths]) -> TwinCalibration:
    """Offsets and power of every stop from the other half of the stops.

    The offsets are those of the lines of sight, corrected by the single bounces that `simulated` explains. These
    single bounces are explained with the calibration within their half. So the halves share nothing except the
    boundaries of the sessions.
    """
    n_stops = len(campaign.truths)
    half = other_half(n_stops)
    within = ~half & leave_one_out(n_stops)
    own = StopCalibration(sight_offsets(campaign, within), fit_power(campaign, simulated, within))
    paths = explain_paths(campaign, simulated, own.offsets, own.power)
    offsets = corrected_offsets(sight_offsets(campaign, half), paths, paths.is_single_bounce, half)
    return TwinCalibration(own, StopCalibration(offsets, fit_power(campaign, simulated, half)), half)


def explained_calibrated(
    campaign: MeasuredCampaign, scene: Scene, simulated: Sequence[Paths], calibration: TwinCalibration
) -> TwinPaths:
    """Every measured path with the simulated path that explains it, calibrated on the other half of the stops."""
    materials = {name: material.name for name, material in scene.materials.items()}
    within, across = calibration.within, calibration.across
    references = explain_paths(campaign, simulated, within.offsets, within.power)
    paths = explain_paths(campaign, simulated, across.offsets, across.power)
    signal_dbm = paths.signal_dbm.copy()
    for stop in np.unique(paths.stop):
        used = calibration.half[stop][references.stop] & references.is_single_bounce
        gains = object_gains(references, within.power.floor_dbm[references.stop], used, materials)
        here = paths.stop == stop
        signal_dbm[here] = calibrated_signal_dbm(paths, gains, materials)[here]
    predicted_dbm = over_floor(signal_dbm, across.power.floor_dbm[paths.stop])
    return replace(paths, signal_dbm=signal_dbm, predicted_dbm=predicted_dbm)
