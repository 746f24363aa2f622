"""Measured paths explained by simulated ones, and the share that is explained by chance."""

from collections.abc import Sequence

import numpy as np

from isac_arena.campaign.measured import MeasuredCampaign
from isac_arena.insight.twin.offsets import without_offsets
from isac_arena.insight.twin.power import PowerModel, over_floor
from isac_arena.insight.twin.record import NARROW_GATE, WIDE_GATE, Offsets, TwinPaths
from isac_arena.scoring.association import assign_by_error, parameter_errors
from isac_arena.scoring.provenance import path_origin
from scenes.record import FloatArray, IntArray, concatenate
from sim.propagation.paths import Paths, path_labels

FAR_M = 2.0  # paths of stops this far apart agree only by chance: the wide gate is 0.45 m of delay


def explain_paths(
    campaign: MeasuredCampaign, simulated: Sequence[Paths], offsets: Offsets, power: PowerModel
) -> TwinPaths:
    """Every measured path with the simulated path that explains it.

    All paths of a stop compete for the simulated paths of that stop, with or without a label.
    """
    stops = [_explained_stop(campaign, stop, paths, offsets, power) for stop, paths in enumerate(simulated)]
    return concatenate(stops, "path")


def chance_share(campaign: MeasuredCampaign, simulated: Sequence[Paths], offsets: Offsets) -> float:
    """Share of labelled single bounces that simulated paths of stops at least `FAR_M` away explain."""
    position = np.array([truth.rx_pose.position_m for truth in campaign.truths])
    found, total = 0, 0
    for stop, truth in enumerate(campaign.truths):
        distance = np.linalg.norm(position - position[stop], axis=1)
        for other in np.flatnonzero(distance >= FAR_M).tolist():
            match = _matches(campaign, stop, simulated[other], offsets, WIDE_GATE)[0]
            found += int((match[truth.is_single_bounce] >= 0).sum())
            total += int(truth.is_single_bounce.sum())
    return found / total if total else float("nan")


def _explained_stop(
    campaign: MeasuredCampaign, stop: int, simulated: Paths, offsets: Offsets, power: PowerModel
) -> TwinPaths:
    truth, estimate = campaign.truths[stop], campaign.channel[stop]
    wide, difference = _matches(campaign, stop, simulated, offsets, WIDE_GATE)
    narrow, _ = _matches(campaign, stop, simulated, offsets, NARROW_GATE)
    known = wide >= 0
    origin = path_origin(simulated)
    residual = np.full((len(wide), 3), np.nan)
    residual[known] = difference[known, wide[known]]
    signal_dbm = np.full(len(wide), np.nan)
    signal_dbm[known] = power.reference_dbm[stop] + 10 * np.log10(simulated.power[wide[known]])
    return TwinPaths(
        stop=np.full(len(wide), stop),
        path=np.arange(len(wide)),
        is_los=truth.is_los,
        is_single_bounce=truth.is_single_bounce,
        landmark_m=truth.landmark_m,
        power_dbm=estimate.power_dbm,
        simulated=wide,
        simulated_narrow=narrow,
        chain=np.append(path_labels(simulated), "")[wide],
        object=np.append(origin.object, "")[wide],
        n_bounces=np.append(simulated.n_bounces, -1)[wide],
        delay_residual_s=residual[:, 0],
        aod_residual_rad=residual[:, 1],
        aoa_residual_rad=residual[:, 2],
        signal_dbm=signal_dbm,
        predicted_dbm=over_floor(signal_dbm, np.full(len(wide), power.floor_dbm[stop])),
    )


def _matches(
    campaign: MeasuredCampaign, stop: int, simulated: Paths, offsets: Offsets, gate: FloatArray
) -> tuple[IntArray, FloatArray]:
    """Simulated paths (path,) that explain those measured at a stop, and differences (path, candidate, 3)."""
    aod_rad = simulated.aod_azimuth_rad - campaign.tx.heading_rad
    aoa_rad = simulated.aoa_azimuth_rad - campaign.truths[stop].rx_pose.heading_rad
    candidates = np.column_stack([simulated.delay_s, aod_rad, aoa_rad])
    difference = parameter_errors(without_offsets(campaign, stop, offsets)[:, None], candidates[None])
    return explaining(difference, gate), difference


def explaining(difference: FloatArray, gate: FloatArray) -> IntArray:
    """Candidate (path,) that explains each path, -1 for none.

    A candidate explains at most one path, and only where all three differences (path, candidate, 3) lie within the
    gate (3,). As many paths as possible are explained, and with the least sum of differences in units of the
    gate.
    """
    none_costs = np.sqrt(3.0) * (len(difference) + 1)  # more than all pairs within the gate together
    return assign_by_error(difference, gate, none_costs)
