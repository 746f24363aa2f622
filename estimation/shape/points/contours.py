"""Contours from incidence points only, cluster by cluster, by our methods or those of peers."""

import numpy as np

from estimation.execution import one_blas_thread
from estimation.shape.config import ContourConfig
from estimation.shape.fit import ShapeFit
from estimation.shape.gp.clustering import NOISE
from estimation.shape.points.cluster import PointCluster
from estimation.shape.points.methods import POINT_METHODS, choose_points
from estimation.shape.record import CLASS_NAMES, Contours
from estimation.shape.reflection.fit_all import CampaignFit
from estimation.shape.reflection.rows import contour_record
from estimation.shape.reflection.tx_sessions import one_session
from estimation.slam.record import IncidencePoints, PoseEstimates
from scenes.pose import Pose
from scenes.record import FloatArray, IntArray


def fit_point_contours(
    ips: IncidencePoints, label: IntArray, tx_pose: Pose, poses: PoseEstimates, config: ContourConfig
) -> Contours:
    """A contour per cluster `label` (ip,); a cluster whose fit fails has none.

    The sensor is taken halfway between the TX and the mean position of the receivers.
    """
    shapes: list[ShapeFit] = []
    probability: list[FloatArray] = []
    members: list[IntArray] = []
    position = dict(zip(poses.stop.tolist(), poses.position_m, strict=True))
    with one_blas_thread():
        for cluster in range(int(label.max(initial=NOISE)) + 1):
            rows = np.flatnonzero(label == cluster)
            receivers = np.array([position[stop] for stop in ips.stop[rows].tolist()])
            sensor = (tx_pose.position_m[:2] + receivers.mean(axis=0)) / 2
            points = PointCluster(ips.position_m[rows], ips.covariance_m2[rows], sensor)
            if config.method == "points":
                shape, chances = choose_points(points)
            else:
                shape, chances = POINT_METHODS[config.method](points), np.full(len(CLASS_NAMES), np.nan)
            if shape.is_usable:
                shapes.append(shape)
                probability.append(chances)
                members.append(rows)
    together = one_session(poses.stop)
    fit = CampaignFit(config.method, tuple(shapes), np.array(probability), tuple(members), None, together)
    return contour_record(fit, label, len(ips))
