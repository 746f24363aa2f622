"""Channel estimates of traced stops made from the truth: exact, or with errors drawn from their joint bound."""

from dataclasses import replace

import numpy as np

from estimation.channel.record import ChannelEstimate, EstimateStatus, empty_estimate
from isac_arena.scoring.config import DEFAULT_SEPARABILITY
from isac_arena.scoring.record import PathKind
from isac_arena.scoring.stop_bounds import observed_kinds
from isac_arena.scoring.true_stop import TrueStop, seen_by
from isac_arena.validation.scenarios.estimates import PARAMETERS
from scenes.record import BoolArray, FloatArray, IntArray


def drawn_estimate(
    stop: TrueStop,
    rng: np.random.Generator | None = None,
    chosen: BoolArray | None = None,
    stated_factor: float = 1.0,
) -> ChannelEstimate:
    """Significant paths of a stop in the angles that its beams observe, elevations with them.

    Errors are drawn from the joint bound of each path; without a generator there are none. The stated covariance
    is the bound times `stated_factor`. `chosen` (significant,) are the paths, by default those that are separable.
    A path that stands for a group has the bound that it has without the others.

    Raises `ValueError` for a stop without a view of the link.
    """
    if stop.bounds is None or stop.view is None:
        raise ValueError("stop: has no view of the link, which bounds need")
    rows = np.flatnonzero(stop.is_separable if chosen is None else chosen)
    own = (stop.share_of_cell <= DEFAULT_SEPARABILITY.share_of_cell)[:, None, None]
    covariance = np.where(own, _bound(stop, stop.bounds.joint), _bound(stop, stop.bounds.alone))[rows]
    place = _parameters(stop, stop.significant[rows])
    if rng is not None:
        none = np.zeros(place.shape[1])
        place = place + np.reshape([rng.multivariate_normal(none, one) for one in covariance], place.shape)
    order = np.argsort(place[:, 0], kind="stable")
    path = stop.significant[rows][order]
    departures, arrivals = observed_kinds(stop.view)
    return ChannelEstimate(
        stop=stop.truth.stop,
        power_dbm=stop.power_dbm[path],
        beam_loss_db=stop.view.beam_losses_db(stop.truth).sum(axis=0)[path],
        snr_db=np.full(len(path), np.nan),
        covariance=stated_factor * covariance[order],
        is_los=np.asarray(stop.origin.kind[path] == PathKind.LOS),
        aod_angle_kind=departures,
        aoa_angle_kind=arrivals,
        **dict(zip(PARAMETERS, place[order].T, strict=False)),
    )


def _in_space(stop: TrueStop) -> bool:
    """Whether the beams of both devices observe elevations."""
    return stop.bounds is not None and stop.bounds.n_angles == (2, 2)


def _bound(stop: TrueStop, covariance: FloatArray) -> FloatArray:
    """A bound (path, parameter, parameter) in the order of `ChannelEstimate`: delay, azimuths, elevations."""
    if _in_space(stop):
        order = np.array([0, 1, 3, 2, 4])
        return covariance[:, order[:, None], order]
    assert stop.bounds is not None and stop.view is not None
    return stop.bounds.in_kinds(covariance, observed_kinds(stop.view))


def _parameters(stop: TrueStop, path: IntArray) -> FloatArray:
    """True parameters (path, 3 or 5) as an estimate would report them."""
    assert stop.view is not None
    departures, arrivals = observed_kinds(stop.view)
    empty = empty_estimate(stop.truth.stop, "drawn", EstimateStatus.OK, "")
    plane = seen_by(stop, replace(empty, aod_angle_kind=departures, aoa_angle_kind=arrivals)).parameters[path]
    if not _in_space(stop):
        return plane
    traced = stop.truth.paths
    return np.column_stack([plane, traced.aod_elevation_rad[path], traced.aoa_elevation_rad[path]])
