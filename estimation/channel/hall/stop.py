"""One stop in a hall that was read at others: its clock bias, and what each of its paths is."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from estimation.channel.hall.classes import StopStates, class_probabilities, version_probabilities
from estimation.channel.hall.clocks import LOOSE_STD_M, N_CLOCKS, clocks_by_elevation, own_clock
from estimation.channel.hall.geometry import HEIGHT_SLOPES
from estimation.channel.hall.groups import N_SHARED, Groups
from estimation.channel.hall.model import AMBIGUOUS, GivenHeights, HallLink, prepared_stops
from estimation.channel.hall.paths import RangedPaths
from estimation.channel.hall.power import SightPower
from estimation.channel.hall.record import HallModel
from estimation.channel.hall.refine import stop_equations
from estimation.channel.hall.search import clock_grid, starting_clocks, stop_votes
from estimation.channel.hall.tied import TiedPaths, tied_paths
from estimation.channel.record import MIN_PARAMETERS, ChannelEstimate
from scenes.pose import SPEED_OF_LIGHT_M_S, wrap_angle
from scenes.record import FloatArray, Record, array, empty_record

CLOCK_STEPS = 12  # most steps of each clock bias that is tried
SAME_STDS, SAME_M = 3.0, 0.05  # within which two clock biases are one


@dataclass(frozen=True)
class ClassifiedPaths(Record):
    """The paths of one stop, in the order of its channel estimate, as a hall explains them.

    Plan length and azimuths are those of the most probable version; they are meant where `class_probability` says
    that the path is not weak.
    """

    stop: int = array(dtype=int, doc="index of the receiver stop")
    class_probability: FloatArray = array("path", "class", doc="of the classes in the order of HallClass")
    version_probability: FloatArray = array("path", "version", doc="of the versions, if the path is not weak")
    tied_probability: FloatArray = array("path", doc="that other versions of its plan path are among the paths")
    plan_length_m: FloatArray = array("path", unit="m", doc="length of the path in plan view")
    aod_azimuth_rad: FloatArray = array("path", unit="rad", doc="true azimuth of departure in the TX frame")
    aoa_azimuth_rad: FloatArray = array("path", unit="rad", doc="true azimuth of arrival in the RX frame")
    covariance: FloatArray = array(
        "path", "parameter", "parameter2", unit="(m, rad, rad)^2", doc="of plan length and both azimuths"
    )

    def __len__(self) -> int:
        return self.size("path")


@dataclass(frozen=True)
class HallStop:
    """One stop in a hall.

    Attributes
    ----------
    states : of the paths, at the clock bias
    shared_m2 : covariance (4, 4) of the heights and the clock bias
    is_certain : whether no other clock bias explains the paths nearly as well
    """

    paths: RangedPaths
    states: StopStates
    clock_m: float
    shared_m2: FloatArray
    is_certain: bool


def in_hall(estimate: ChannelEstimate, hall: HallModel, link: HallLink) -> tuple[ChannelEstimate, ClassifiedPaths]:
    """The estimate with the versions of its plan paths tied, and what each path is, both in its order.

    Delays, angles and covariances change; powers and marks stay. Paths that are hardly apart may come out in
    another order than that of their delays. Versions stay as they were found where no ceiling shows, where the
    clock bias is ambiguous, where the method does not tell what errors versions share, and where elements of the
    arrays err: what they leave is in no covariance.
    """
    if not len(estimate):
        return estimate, empty_classes(estimate.stop)
    stop = located(estimate, hall, link)
    is_told = estimate.correlated is not None and estimate.pointing is None
    if not (is_told and hall.sees_ceiling and stop.is_certain):
        return replace(estimate, correlated=None), _classified(estimate.stop, stop, np.zeros(len(estimate)))
    tied = tied_paths(Groups(stop.paths, stop.states, hall.priors, stop.shared_m2, hall.heights.differences_m))
    return _moved(estimate, tied), _classified(estimate.stop, stop, tied.probability)


def empty_classes(stop: int) -> ClassifiedPaths:
    """The classes of no paths."""
    return replace(empty_record(ClassifiedPaths), stop=stop)


def located(estimate: ChannelEstimate, hall: HallModel, link: HallLink) -> HallStop:
    """The stop of an estimate at the clock bias that explains its paths best; with a path at least."""
    stops = prepared_stops([estimate], link, GivenHeights())
    (paths,), (powers,), heights_m = stops.paths, stops.powers, hall.heights_m
    clocks = clock_grid(paths)
    votes = [stop_votes(paths, clocks)]
    sight = SightPower([estimate], [powers], [clocks], link.los)
    differences_m = hall.heights.differences_m
    [tried] = starting_clocks(votes, sight.log_prior, heights_m, N_CLOCKS)
    use = hall.by_elevation
    tried = np.append(tried, clocks_by_elevation(paths, powers, differences_m, hall.priors))
    reached = [
        own_clock(paths, powers, float(one), differences_m, hall.priors, CLOCK_STEPS, by_elevation=use)
        for one in tried
    ]
    clock_m, states = max(reached, key=lambda one: one[1].evidence)
    at = stop_equations(paths, powers, states, clock_m, differences_m, by_elevation=use)
    own = at.information[3, 3] + 1 / LOOSE_STD_M**2
    by_heights = -at.information[3, :3] / own
    turn = np.vstack([np.eye(N_SHARED - 1), by_heights])
    shared_m2 = turn @ hall.covariance_m2 @ turn.T
    shared_m2[3, 3] += 1 / own
    apart_m = SAME_STDS * np.sqrt(shared_m2[3, 3]) + SAME_M
    rivals = [one.evidence for other_m, one in reached if abs(other_m - clock_m) > apart_m]
    is_certain = states.evidence - max(rivals, default=-np.inf) > AMBIGUOUS
    return HallStop(paths, states, clock_m, shared_m2, bool(is_certain))


def _moved(estimate: ChannelEstimate, tied: TiedPaths) -> ChannelEstimate:
    unit = np.array([SPEED_OF_LIGHT_M_S, 1.0, 1.0, 1.0, 1.0])
    size = estimate.size("parameter")
    shift, covariance = tied.shift / unit, (tied.covariance / unit[:, None] / unit)[:, :size, :size]
    changed = tied.probability > 0
    known = np.where(np.isnan(estimate.covariance), np.nan, covariance)
    return replace(
        estimate,
        delay_s=estimate.delay_s + shift[:, 0],
        aod_azimuth_rad=wrap_angle(estimate.aod_azimuth_rad + shift[:, 1]),
        aoa_azimuth_rad=wrap_angle(estimate.aoa_azimuth_rad + shift[:, 2]),
        aod_elevation_rad=estimate.aod_elevation_rad + shift[:, MIN_PARAMETERS],
        aoa_elevation_rad=estimate.aoa_elevation_rad + shift[:, MIN_PARAMETERS + 1],
        covariance=np.where(changed[:, None, None], known, estimate.covariance),
        correlated=None,
    )


def _classified(number: int, stop: HallStop, tied_probability: FloatArray) -> ClassifiedPaths:
    version = version_probabilities(stop.states.probability)
    version /= np.maximum(version.sum(axis=1, keepdims=True), np.finfo(float).tiny)
    best = version.argmax(axis=1)
    every = np.arange(len(stop.paths))
    value, own = stop.states.points.value[every, best], stop.states.points.covariance[every, best]
    slope = stop.states.points.slope[every, best]
    common = np.concatenate([slope[:, :, 3, None] * HEIGHT_SLOPES[best][:, None], -slope[:, :, :1]], axis=2)
    return ClassifiedPaths(
        stop=number,
        class_probability=class_probabilities(stop.states),
        version_probability=version,
        tied_probability=tied_probability,
        plan_length_m=value[:, 0],
        aod_azimuth_rad=value[:, 1],
        aoa_azimuth_rad=value[:, 2],
        covariance=own + np.einsum("pai,ij,pbj->pab", common, stop.shared_m2, common),
    )
