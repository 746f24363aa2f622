"""Association of paths to shared landmarks: lines that many bounces share are walls, compact
clusters of incidence points are objects.
"""

from dataclasses import replace

import numpy as np

from estimation.distributions import chi_square_quantile
from estimation.laws import plane as plane_law
from estimation.slam.config import TrajectoryConfig
from estimation.slam.mapping.point_fit import point_covariance
from estimation.slam.walk.assignment import assign_to_landmarks
from estimation.slam.walk.flats import off_flats
from estimation.slam.walk.mirrors import find_walls
from estimation.slam.walk.raised import with_raised
from estimation.slam.walk.residuals import (
    Association,
    Observations,
    PathClass,
    TrajectoryState,
    own_bounces,
    without_heading_offsets,
)
from scenes.record import BoolArray, FloatArray, IntArray

# Landmarks are found from incidence points more certain than this.
_MAX_POINT_STD_M = 0.6
_LEAST_OF_WALL = 3  # points: one more than two that any line joins
_MAX_OBJECT_SCATTER_M = 0.4
# Standard deviation of the position of a landmark that is not yet estimated.
_START_STD_M = 0.05
# The normals of a flat face agree: this share of them is within this many standard deviations.
_FLAT_QUANTILE, _FLAT_STDS = 0.8, 3.0


def single_bounces(
    seen: Observations, now: TrajectoryState, is_los: BoolArray, config: TrajectoryConfig
) -> BoolArray:
    """Paths (path,) that are feasible single bounces at the present trajectory."""
    terms = own_bounces(seen, now, np.arange(len(is_los)))
    gate = chi_square_quantile(config.gate_probability, 1)
    return np.asarray(~is_los & terms.is_feasible & (terms.value_m**2 <= gate * terms.variance_m2))


def classify_paths(
    seen: Observations,
    now: TrajectoryState,
    is_los: BoolArray,
    config: TrajectoryConfig,
    noise: tuple[Observations, TrajectoryConfig],
) -> tuple[Association, TrajectoryState, FloatArray]:
    """Classify every path at the present trajectory, and find landmarks.

    Single bounces are mapped and clustered; long clusters become walls, compact ones circles. A path is assigned
    to the landmark that predicts it best within the gate, which is widened for landmarks not yet estimated.
    Other single bounces keep their own IP; other paths may be double bounces off two walls. Also returns the
    spans (wall, 2) of the walls. A compact cluster is a point at a height where that explains it better than a
    circle, with the paths and settings of `noise`.
    """
    bounce = single_bounces(seen, now, is_los, config)
    link = _without_landmarks(is_los, bounce & ~off_flats(seen, now, is_los, now.flats))
    now = replace(now, walls=np.empty((0, 2)), objects=np.empty((0, 3)), raised=np.empty((0, 3)))
    if not config.use_landmarks or not bounce.any():
        return link, now, np.empty((0, 2))
    path = np.flatnonzero(bounce)
    state, measured = seen.states(now.state)[path], without_heading_offsets(seen, now, path)
    tx = seen.tx_rows[path]
    point = plane_law.start_point(tx, state, measured)
    covariance, _ = point_covariance(plane_law, tx, state, point, seen.covariance[path])
    sharp = np.linalg.eigvalsh(covariance)[:, -1] < _MAX_POINT_STD_M**2
    azimuth, _ = plane_law.lit_normals(point[sharp], tx[sharp], state[sharp, :2])
    normal = np.column_stack([np.cos(azimuth), np.sin(azimuth)])
    variance = seen.covariance[path[sharp]]
    angle_std_rad = np.sqrt(variance[:, 1, 1] + variance[:, 2, 2] + 2 * variance[:, 1, 2]) / 2
    walls, objects, spans, member = find_landmarks(point[sharp], normal, angle_std_rad, config)
    now = replace(now, walls=walls, objects=objects)
    if seen.heights is not None and len(objects):
        now = with_raised(noise[0], now, path[sharp], member, noise[1])
    rough = np.hypot([config.wall_roughness_m, config.object_roughness_m], _START_STD_M)
    loose = config.model_copy(update={"wall_roughness_m": rough[0], "object_roughness_m": rough[1]})
    return assign_to_landmarks(seen, now, link, spans, loose), now, spans


def reclassify_paths(
    seen: Observations, now: TrajectoryState, is_los: BoolArray, spans: FloatArray, config: TrajectoryConfig
) -> Association:
    """Classify every path at the present trajectory and landmarks, with walls of these `spans` (wall, 2)."""
    bounce = single_bounces(seen, now, is_los, config) & ~off_flats(seen, now, is_los, now.flats)
    link = _without_landmarks(is_los, bounce)
    return assign_to_landmarks(seen, now, link, spans, config) if config.use_landmarks else link


def drop_unused_landmarks(now: TrajectoryState, link: Association) -> tuple[TrajectoryState, Association]:
    """State and association without the landmarks that no path is assigned to."""
    landmark = link.landmark.copy()
    kept = []
    families = (
        ((PathClass.WALL, PathClass.DOUBLE), len(now.walls)),
        ((PathClass.OBJECT,), len(now.objects)),
        ((PathClass.RAISED,), len(now.raised)),
    )
    for kinds, n in families:
        mine = np.isin(link.kind, kinds)
        used = np.isin(np.arange(n), landmark[mine])
        number = np.where(used, np.cumsum(used) - 1, -1)
        landmark[mine] = np.where(landmark[mine] >= 0, number[landmark[mine]], -1) if n else landmark[mine]
        kept.append(used)
    now = replace(now, walls=now.walls[kept[0]], objects=now.objects[kept[1]], raised=now.raised[kept[2]])
    return now, replace(link, landmark=landmark)


def _without_landmarks(is_los: BoolArray, bounce: BoolArray) -> Association:
    kind = np.where(is_los, PathClass.LOS, np.where(bounce, PathClass.BOUNCE, PathClass.UNUSED))
    return Association(kind, np.full((len(kind), 2), -1))


def find_landmarks(
    point_m: FloatArray, normal: FloatArray, normal_std_rad: FloatArray, config: TrajectoryConfig
) -> tuple[FloatArray, FloatArray, FloatArray, IntArray]:
    """Walls (wall, 2), circles (object, 3), the spans (wall, 2) of the walls, and the circle (ip,) of every IP.

    From IPs (ip, 2) and the outward normals (ip, 2) of their surfaces, with standard deviations `normal_std_rad`
    (ip,). Walls first; the compact clusters of the other IPs are objects, unless their normals are equal. The
    centre of an object's circle is behind each IP by the radius; IPs on no circle have -1.
    """
    walls, spans, is_free = find_walls(point_m, normal, normal_std_rad, _LEAST_OF_WALL)
    objects: list[FloatArray] = []
    member = np.full(len(point_m), -1)
    if is_free.any():
        from sklearn.cluster import DBSCAN  # noqa: PLC0415  (it takes a second, and pandas comes with it)

        rest, outward, std = point_m[is_free], normal[is_free], normal_std_rad[is_free]
        label = DBSCAN(eps=config.cluster_eps_m, min_samples=config.cluster_min_samples).fit_predict(rest)
        for cluster in range(label.max() + 1):
            mine = label == cluster
            is_compact = _scatter(rest[mine]) <= _MAX_OBJECT_SCATTER_M
            is_compact = is_compact and _extent(rest[mine]) <= config.max_object_extent_m
            if is_compact and not _is_flat(outward[mine], std[mine]):
                member[np.flatnonzero(is_free)[mine]] = len(objects)
                centre = np.median(rest[mine] - config.object_radius_m * outward[mine], axis=0)
                objects.append(np.array([*centre, config.object_radius_m]))
    return walls, np.reshape(objects, (-1, 3)), spans, member


def _is_flat(normal: FloatArray, std_rad: FloatArray) -> bool:
    """Whether normals (ip, 2) with standard deviations (ip,) are equal."""
    mean = np.median(normal, axis=0)
    off = np.abs(np.arctan2(normal[:, 1] * mean[0] - normal[:, 0] * mean[1], normal @ mean))
    return bool(np.quantile(off / std_rad, _FLAT_QUANTILE) < _FLAT_STDS)


def _extent(point_m: FloatArray) -> float:
    """Length in m of the middle nine tenths of a cluster along its main axis."""
    along = np.sort(point_m @ np.linalg.eigh(np.cov(point_m.T))[1][:, -1])
    low, high = np.interp([0.05, 0.95], np.linspace(0, 1, len(along)), along)
    return float(high - low)


def _scatter(point_m: FloatArray) -> float:
    """Standard deviation in m along the main axis."""
    return float(np.sqrt(np.linalg.eigvalsh(np.cov(point_m.T))[-1]))
