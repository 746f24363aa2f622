"""The paths of a campaign in its hall: heights from some stops, then stop by stop versions tied and classes."""

from collections.abc import Sequence

import numpy as np

from estimation.channel.hall.model import GivenHeights, HallLink, read_hall
from estimation.channel.hall.record import HallEstimates, ReadPaths, no_hall
from estimation.channel.hall.stop import ClassifiedPaths, in_hall
from estimation.channel.record import ChannelEstimate
from estimation.execution import one_blas_thread
from estimation.steps import STEPS
from scenes.record import IntArray, concatenate

N_ALL = 5  # parameters of a path with elevations


def hall_estimates(
    estimates: Sequence[ChannelEstimate], link: HallLink, given: GivenHeights, rows: IntArray
) -> HallEstimates:
    """The hall of a campaign, read at the stops in these `rows`, and the paths of all stops that have any."""
    stops = np.array([estimate.stop for estimate in estimates], int)
    STEPS.info("versions of paths by floor and ceiling")
    with one_blas_thread():
        model = read_hall([estimates[row] for row in rows], link, given)
        if model is None:
            return no_hall(stops)
        parts = [_stop_paths(*in_hall(estimate, model, link)) for estimate in estimates if len(estimate)]
    return HallEstimates(concatenate(parts, "path"), stops, model)


def _stop_paths(estimate: ChannelEstimate, classes: ClassifiedPaths) -> ReadPaths:
    order = np.argsort(estimate.delay_s, kind="stable")
    n, size = len(estimate), estimate.size("parameter")
    covariance = np.full((n, N_ALL, N_ALL), np.nan)
    covariance[:, :size, :size] = estimate.covariance
    angles = (
        estimate.aod_azimuth_rad,
        estimate.aoa_azimuth_rad,
        estimate.aod_elevation_rad,
        estimate.aoa_elevation_rad,
    )
    paths = ReadPaths(
        stop=np.full(n, estimate.stop),
        row=np.arange(n),
        delay_s=estimate.delay_s,
        angle_rad=np.stack(angles, axis=1),
        covariance=covariance,
        class_probability=classes.class_probability,
        version_probability=classes.version_probability,
        tied_probability=classes.tied_probability,
    )
    return paths.take("path", order)
