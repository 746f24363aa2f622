"""Measured power predicted from simulated paths, and gains of objects that improve the prediction."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from isac_arena.campaign.measured import MeasuredCampaign
from isac_arena.insight.twin.record import TwinPaths
from scenes.record import BoolArray, FloatArray
from sim.propagation.paths import Paths

CLEAR_OF_FLOOR_DB = 3.0  # the signal power of a path follows from its power when it is this far above the floor
MIN_GAIN_PATHS = 2  # fewer paths give no gain

Gains = Mapping[tuple[str, str], float]  # (interaction, object or material) -> gain in dB


@dataclass(frozen=True)
class PowerModel:
    """Model of the measured power: P = floor + reference x |gain|^2, all in mW.

    `reference_dbm` (stop,) is the transmit power with both beam gains and all losses. `floor_dbm` (stop,) is the
    power in a cell of delay and beams without the path: noise and side lobes. A path is reported when the sum of
    both is strong enough. So the weakest reported power is an upper bound of the floor, and is used as the floor.
    """

    reference_dbm: FloatArray
    floor_dbm: FloatArray


def fit_power(campaign: MeasuredCampaign, simulated: Sequence[Paths], others: BoolArray) -> PowerModel:
    """Power model of every stop from the stops that it is calibrated on, `others` (stop, stop).

    The reference is the median of measured over simulated power of the lines of sight; the floor is the weakest
    reported power.
    """
    level = np.full(len(simulated), np.nan)
    for stop, (estimate, truth, paths) in enumerate(
        zip(campaign.channel, campaign.truths, simulated, strict=True)
    ):
        if truth.is_los.any() and paths.is_los.any():
            level[stop] = estimate.power_dbm[truth.is_los][0] - _db(paths.power[paths.is_los][0])
    weakest = np.array([estimate.power_dbm.min(initial=np.inf) for estimate in campaign.channel])
    reference, floor = np.full((2, len(simulated)), np.nan)
    for stop, known in enumerate(others):
        seen = level[known & np.isfinite(level)]
        if len(seen):
            reference[stop] = np.median(seen)
        floor[stop] = weakest[known].min(initial=np.inf)
    return PowerModel(reference, floor)


def over_floor(signal_dbm: FloatArray, floor_dbm: FloatArray) -> FloatArray:
    """Sum in dBm of signal and floor."""
    return np.asarray(_db(10 ** (signal_dbm / 10) + 10 ** (floor_dbm / 10)))


def object_gains(paths: TwinPaths, floor_dbm: FloatArray, used: BoolArray, materials: Mapping[str, str]) -> Gains:
    """Gain in dB of every object and of every material: measured over simulated power of the paths from it.

    A gain is the median over those of the paths `used` (path,) that a simulated single bounce explains and that
    are clear of the floor (path,). Reflections and diffractions have gains of their own. `materials` is the
    material by object.
    """
    used = used & (paths.object != "") & (paths.power_dbm >= floor_dbm + CLEAR_OF_FLOOR_DB)
    found: dict[tuple[str, str], list[float]] = {}
    for row in np.flatnonzero(used):
        signal_dbm = _db(10 ** (paths.power_dbm[row] / 10) - 10 ** (floor_dbm[row] / 10))
        gain_db = float(signal_dbm - paths.signal_dbm[row])
        name = str(paths.object[row])
        for where in (name, f"material {materials[name]}"):
            found.setdefault((_event(str(paths.chain[row])), where), []).append(gain_db)
    return {key: float(np.median(gain)) for key, gain in found.items() if len(gain) >= MIN_GAIN_PATHS}


def calibrated_signal_dbm(paths: TwinPaths, gains: Gains, materials: Mapping[str, str]) -> FloatArray:
    """Signal power (path,) in dBm with the gain of the object, or else of its material, or else without gain."""
    signal_dbm = paths.signal_dbm.copy()
    for row in np.flatnonzero(paths.object != ""):
        name, event = str(paths.object[row]), _event(str(paths.chain[row]))
        signal_dbm[row] += gains.get((event, name), gains.get((event, f"material {materials[name]}"), 0.0))
    return signal_dbm


def _event(chain: str) -> str:
    """Letter of the interaction of a single bounce, as in the labels of `path_labels`."""
    return next(step[0] for step in chain.split(" > ") if not step.startswith("R "))


def _db(power: FloatArray | float) -> FloatArray:
    return np.asarray(10 * np.log10(power))
