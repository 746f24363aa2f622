"""Offsets, power and gains of objects calibrated on one half of the stops for the other."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from isac_arena.campaign.measured import MeasuredCampaign
from isac_arena.insight.twin.explain import explained
from isac_arena.insight.twin.offsets import corrected_offsets, leave_one_out, other_half, sight_offsets
from isac_arena.insight.twin.power import (
    PowerModel,
    calibrated_signal_dbm,
    fit_power,
    object_gains,
    over_floor,
)
from isac_arena.insight.twin.record import Offsets, TwinPaths
from scenes.record import BoolArray
from scenes.scene import Scene
from sim.propagation.paths import Paths


@dataclass(frozen=True)
class Told:
    """What some stops tell about every stop."""

    offsets: Offsets
    power: PowerModel


@dataclass(frozen=True)
class TwinCalibration:
    """What the other stops of its own half tell about every stop (`within`), and the other half (`across`).

    `half` (stop, stop) says which stops are in the other half.
    """

    within: Told
    across: Told
    half: BoolArray


def calibrate(campaign: MeasuredCampaign, simulated: Sequence[Paths]) -> TwinCalibration:
    """Offsets and power of every stop from the half of the stops that it is not in.

    The offsets are those of the lines of sight, corrected by the single bounces that `simulated` explains. Within
    the half that tells, every stop is explained with what its other stops tell: the halves share nothing but where
    sessions begin.
    """
    n_stops = len(campaign.truths)
    half = other_half(n_stops)
    within = ~half & leave_one_out(n_stops)
    told = Told(sight_offsets(campaign, within), fit_power(campaign, simulated, within))
    teachers = explained(campaign, simulated, told.offsets, told.power)
    offsets = corrected_offsets(sight_offsets(campaign, half), teachers, teachers.is_single_bounce, half)
    return TwinCalibration(told, Told(offsets, fit_power(campaign, simulated, half)), half)


def explained_calibrated(
    campaign: MeasuredCampaign, scene: Scene, simulated: Sequence[Paths], calibration: TwinCalibration
) -> TwinPaths:
    """Every measured path with what explains it, by offsets, power and gains of objects from the other half."""
    materials = {name: material.name for name, material in scene.materials.items()}
    within, across = calibration.within, calibration.across
    teachers = explained(campaign, simulated, within.offsets, within.power)
    paths = explained(campaign, simulated, across.offsets, across.power)
    signal_dbm = paths.signal_dbm.copy()
    for stop in np.unique(paths.stop):
        used = calibration.half[stop][teachers.stop] & teachers.is_single_bounce
        gains = object_gains(teachers, within.power.floor_dbm[teachers.stop], used, materials)
        here = paths.stop == stop
        signal_dbm[here] = calibrated_signal_dbm(paths, gains, materials)[here]
    predicted_dbm = over_floor(signal_dbm, across.power.floor_dbm[paths.stop])
    return replace(paths, signal_dbm=signal_dbm, predicted_dbm=predicted_dbm)
