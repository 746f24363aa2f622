"""Power that a measurement should show of simulated paths, and gains of objects that bring it nearer."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from isac_arena.campaign.measured import MeasuredCampaign
from isac_arena.insight.twin.record import TwinPaths
from scenes.record import BoolArray, FloatArray
from sim.propagation.paths import Paths

CLEAR_OF_FLOOR_DB = 3.0  # a path this far over the floor tells the power of its signal
MIN_GAIN_PATHS = 2  # fewer paths do not tell a gain

Gains = Mapping[tuple[str, str], float]  # (what happens, where) -> gain in dB


@dataclass(frozen=True)
class PowerModel:
    """What turns a path gain into a measured power: P = floor + reference x |gain|^2, all in mW.

    `reference_dbm` (stop,) is transmit power with both beams and all losses; `floor_dbm` (stop,) is what stands in
    a cell of delay and beams besides the path: noise and side lobes. A path is reported when both together are
    strong enough, so the weakest reported power bounds the floor from above, and stands for it.
    """

    reference_dbm: FloatArray
    floor_dbm: FloatArray


def fit_power(campaign: MeasuredCampaign, simulated: Sequence[Paths], tells: BoolArray) -> PowerModel:
    """Power model of every stop from the stops that tell about it (stop, stop).

    The reference is the median over lines of sight, measured and simulated; the floor the weakest reported power.
    """
    level = np.full(len(simulated), np.nan)
    for stop, (estimate, truth, paths) in enumerate(
        zip(campaign.channel, campaign.truths, simulated, strict=True)
    ):
        if truth.is_los.any() and paths.is_los.any():
            level[stop] = estimate.power_dbm[truth.is_los][0] - _db(paths.power[paths.is_los][0])
    weakest = np.array([estimate.power_dbm.min(initial=np.inf) for estimate in campaign.channel])
    reference, floor = np.full((2, len(simulated)), np.nan)
    for stop, known in enumerate(tells):
        seen = level[known & np.isfinite(level)]
        if len(seen):
            reference[stop] = np.median(seen)
        floor[stop] = weakest[known].min(initial=np.inf)
    return PowerModel(reference, floor)


def over_floor(signal_dbm: FloatArray, floor_dbm: FloatArray) -> FloatArray:
    """Power in dBm of signals with the floor under them."""
    return np.asarray(_db(10 ** (signal_dbm / 10) + 10 ** (floor_dbm / 10)))


def object_gains(
    paths: TwinPaths, floor_dbm: FloatArray, used: BoolArray, materials: Mapping[str, str]
) -> Gains:
    """Gain in dB of every object, and of every material, by which the paths over it are stronger than simulated.

    Medians over those of the paths `used` (path,) that are explained by a single bounce and stand clear of the
    floor (path,); reflections and diffractions apart. `materials` is the material by object.
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
    """Signal power (path,) in dBm with the gain of the object, else that of its material, else none."""
    signal_dbm = paths.signal_dbm.copy()
    for row in np.flatnonzero(paths.object != ""):
        name, event = str(paths.object[row]), _event(str(paths.chain[row]))
        signal_dbm[row] += gains.get((event, name), gains.get((event, f"material {materials[name]}"), 0.0))
    return signal_dbm


def _event(chain: str) -> str:
    """Letter of the interaction that turns a single bounce, by the labels of `path_labels`."""
    return next(step[0] for step in chain.split(" > ") if not step.startswith("R "))


def _db(power: FloatArray | float) -> FloatArray:
    return np.asarray(10 * np.log10(power))
