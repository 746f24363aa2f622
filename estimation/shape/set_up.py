"""Errors of the set-up that no path shows: those of the poses of SLAM are common to all, and so to all contours.

A pointing error of the TX turns poses and contours together about the TX, and an error of its place shifts them.
Contours are fitted without these errors, then their bands include them.
"""

from dataclasses import replace

import numpy as np

from estimation.shape.record import Contours, normals
from estimation.slam.config import Consider
from estimation.slam.record import PoseEstimates, SolveStatus
from estimation.slam.transmitters import AnyTx, transmitters_of


def common_errors(poses: PoseEstimates, consider: Consider | None) -> Consider:
    """The errors that all contours share; none at given poses, where the paths show them."""
    return Consider() if consider is None or poses.is_given else consider


def without_set_up(poses: PoseEstimates, tx: AnyTx, consider: Consider) -> PoseEstimates:
    """The poses with covariances of what their paths show.

    Those that are given, and those whose covariance does not include the errors, stay as they are.
    """
    common = consider.covariance(poses.position_m - transmitters_of(tx).rows[0, :2])
    covariance = poses.covariance.copy()
    rest = covariance[:, :4, :4] - common
    known = np.nan_to_num(rest[:, :3, :3])
    includes = (poses.status != SolveStatus.GIVEN) & (np.linalg.eigvalsh(known)[:, 0] >= 0)
    covariance[includes, :4, :4] = rest[includes]
    return replace(poses, covariance=covariance)


def with_set_up(contours: Contours, tx: AnyTx, consider: Consider) -> Contours:
    """The contours with bands that include the errors of the set-up, across the contour.

    A contour of one point has the mean over all directions.
    """
    contour = contours.contour_m
    common = consider.covariance(contour - transmitters_of(tx).rows[0, :2])[..., :2, :2]
    rows = zip(contour, contours.is_closed, strict=True)
    normal = np.reshape([normals(points, is_closed=bool(closed)) for points, closed in rows], contour.shape)
    across = np.einsum("csi,csij,csj->cs", normal, common, normal)
    is_point = ~normal.any(axis=2)
    across[is_point] = np.trace(common, axis1=2, axis2=3)[is_point] / 2
    return replace(contours, std_m=np.sqrt(contours.std_m**2 + across))
