"""Classes, plan lengths and true azimuths of the paths of a campaign, in a hall that was read."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from estimation.channel.hall.classes import class_probabilities, stop_states, version_probabilities
from estimation.channel.hall.geometry import HEIGHT_SLOPES
from estimation.channel.hall.model import HallLink, HallModel, prepared_stops
from estimation.channel.record import ChannelEstimate
from scenes.record import FloatArray, Record, array


@dataclass(frozen=True)
class ClassifiedPaths(Record):
    """The paths of one stop, in the order of its channel estimate, as a hall explains them.

    Plan length and azimuths are those of the most probable version; they are meant where `class_probability` says
    that the path is not weak.
    """

    stop: int = array(dtype=int, doc="index of the receiver stop")
    class_probability: FloatArray = array("path", "class", doc="of the classes in the order of HallClass")
    version_probability: FloatArray = array("path", "version", doc="of the versions, if the path is not weak")
    plan_length_m: FloatArray = array("path", unit="m", doc="length of the path in plan view")
    aod_azimuth_rad: FloatArray = array("path", unit="rad", doc="true azimuth of departure in the TX frame")
    aoa_azimuth_rad: FloatArray = array("path", unit="rad", doc="true azimuth of arrival in the RX frame")
    covariance: FloatArray = array(
        "path", "parameter", "parameter2", unit="(m, rad, rad)^2", doc="of plan length and both azimuths"
    )
    own_covariance: FloatArray = array(
        "path", "parameter", "parameter2", unit="(m, rad, rad)^2", doc="without errors of clock and heights"
    )

    def __len__(self) -> int:
        return self.size("path")


def classify(estimates: Sequence[ChannelEstimate], hall: HallModel, link: HallLink) -> list[ClassifiedPaths]:
    """The paths of every estimate that `hall` was read from, in that order.

    Raises `ValueError` for an estimate of another stop: its clock bias is unknown.
    """
    row = {int(stop): index for index, stop in enumerate(hall.stop)}
    unknown = [estimate.stop for estimate in estimates if len(estimate) and estimate.stop not in row]
    if unknown:
        raise ValueError(f"stop {unknown[0]}: is not among the stops that the hall was read from")
    stops = prepared_stops(estimates, link, tx_is_known=True)
    results = []
    for estimate, paths, powers in zip(estimates, stops.paths, stops.powers, strict=True):
        index = row.get(estimate.stop, 0)
        states = stop_states(paths, powers, float(hall.clock_m[index]), hall.heights.differences_m, hall.priors)
        version = version_probabilities(states.probability)
        version /= np.maximum(version.sum(axis=1, keepdims=True), np.finfo(float).tiny)
        best = version.argmax(axis=1)
        every = np.arange(len(paths))
        value, own = states.points.value[every, best], states.points.covariance[every, best]
        common = _common_slopes(states.points.slope[every, best], best)
        places = np.array([0, 1, 2, 3 + index])
        shared = hall.covariance_m2[np.ix_(places, places)]
        results.append(
            ClassifiedPaths(
                stop=estimate.stop,
                class_probability=class_probabilities(states),
                version_probability=version,
                plan_length_m=value[:, 0],
                aod_azimuth_rad=value[:, 1],
                aoa_azimuth_rad=value[:, 2],
                covariance=own + np.einsum("pai,ij,pbj->pab", common, shared, common),
                own_covariance=own,
            )
        )
    return results


def _common_slopes(slope: FloatArray, version: FloatArray) -> FloatArray:
    """Slopes (path, 3, 4) of plan paths over the heights and the clock bias, from those of `PlanPoints`."""
    by_heights = slope[:, :, 3, None] * HEIGHT_SLOPES[version][:, None]
    return np.concatenate([by_heights, -slope[:, :, :1]], axis=2)
