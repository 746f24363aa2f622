"""How much of the floors of `PathNoise` the paths of a campaign need, learned from their single bounces.

A single bounce at a known state has one measurement more than its incidence point has unknowns, two more in space.
So the paths themselves show how precise they are: under the right noise single bounces agree to their stated
precision, and all others stand out. The floors are for errors that covariances leave out; where these are right,
less noise explains the paths better.

One measurement too many does not show every error. So the floors stay where covariances follow from no likelihood,
and at states of SLAM, whose common errors move all points alike.
"""

from collections.abc import Sequence

import numpy as np

from estimation.channel.record import ChannelEstimate
from estimation.slam.config import MappingConfig
from estimation.slam.mapping.incidence_points import concatenate_stops, map_stops
from estimation.slam.record import IncidencePoints, PoseEstimates, SolveStatus
from estimation.slam.space.mapping import map_stops_spatial
from estimation.slam.space.problem import spatial_problem
from estimation.slam.transmitters import AnyTx, Transmitters, of_tx
from scenes.record import FloatArray

LIKELIHOOD = ("auto", "coherent", "incoherent")  # methods whose covariances follow from a likelihood
SHARES = (0.3, 0.1, 0.03)  # of the floors
LEAST_GAIN = 10.0  # in log evidence, that less noise needs
LARGEST_RANGE_M = 30.0  # of paths that are no single bounce: any range up to it, any angles
SHARE_STEPS = 50  # of the share of single bounces


def with_learned_noise(
    estimates: Sequence[ChannelEstimate],
    poses: PoseEstimates,
    tx_pose: AnyTx,
    config: MappingConfig,
    *,
    spatial: bool,
) -> MappingConfig:
    """The settings of mapping with the share of the floors that has most evidence at the given states.

    A path is a single bounce off any place, or anything; the share of single bounces is learned with the noise.
    The floors stay for states that were estimated, and for estimates of other methods than maximum likelihood.
    """
    is_given = (poses.status == SolveStatus.GIVEN).all()
    by_likelihood = all(estimate.method in LIKELIHOOD for estimate in estimates)
    if not (config.noise.floor.any() and is_given and by_likelihood):
        return config
    candidates = [config]
    for share in SHARES:
        candidates.append(config.model_copy(update={"noise": config.noise.with_floors(share)}))
    densities = [_log_densities(estimates, poses, tx_pose, each, spatial=spatial) for each in candidates]
    is_certain = np.isfinite(densities[0])
    evidence = np.array([_log_evidence(density[is_certain]) for density in densities])
    evidence[1:] -= LEAST_GAIN
    return candidates[int(np.argmax(evidence))]


def _log_densities(
    estimates: Sequence[ChannelEstimate],
    poses: PoseEstimates,
    tx_pose: AnyTx,
    config: MappingConfig,
    *,
    spatial: bool,
) -> FloatArray:
    """Log density (ip,) of the paths as single bounces off any place, over that of anything; -inf if uncertain.

    The place is integrated out in Gaussian approximation.
    """
    if isinstance(tx_pose, Transmitters):
        parts = [
            _log_densities(of_tx(estimates, index), poses.of_tx(index), pose, config, spatial=spatial)
            for index, pose in enumerate(tx_pose.poses)
        ]
        return np.concatenate(parts)
    if spatial:
        points = map_stops_spatial(estimates, poses, tx_pose, config)
        covariances = [spatial_problem(estimate, tx_pose, config.noise).covariance for estimate in estimates]
    else:
        points = map_stops(estimates, poses, tx_pose, config)
        covariances = [config.noise.covariance(estimate) for estimate in estimates]
    first = np.concatenate([[0], np.cumsum([len(each) for each in estimates])]).astype(int)
    row = np.searchsorted(poses.stop, points.stop)
    size = 5 if spatial else 3
    measured = concatenate_stops(covariances, float, (size, size))[first[row] + points.path]
    own = _point_covariances(points, spatial=spatial)
    freedom = size - own.shape[-1]
    log_density = (np.linalg.slogdet(own)[1] - np.linalg.slogdet(measured)[1] - points.cost) / 2
    log_density += freedom * np.log(LARGEST_RANGE_M / np.sqrt(2 * np.pi))
    is_certain = np.linalg.eigvalsh(points.covariance_m2)[:, -1] <= config.max_position_std_m**2
    return np.where(is_certain, log_density, -np.inf)


def _point_covariances(points: IncidencePoints, *, spatial: bool) -> FloatArray:
    """Covariances (ip, axis, axis) of incidence points in the plane or in space."""
    if not spatial:
        return points.covariance_m2
    covariance = np.empty((len(points.path), 3, 3))
    covariance[:, :2, :2] = points.covariance_m2
    covariance[:, 2] = covariance[:, :, 2] = points.height_covariance_m2
    return covariance


def _log_evidence(log_density: FloatArray) -> float:
    """Log likelihood of paths of which a share are single bounces, at the share that explains them best."""
    share = 0.5
    for _ in range(SHARE_STEPS):
        single = share * np.exp(np.minimum(log_density, 600.0))
        share = float(np.clip((single / (single + 1 - share)).mean(), 0.01, 0.99)) if len(single) else 0.5
    return float(np.logaddexp(np.log(share) + log_density, np.log(1 - share)).sum())
