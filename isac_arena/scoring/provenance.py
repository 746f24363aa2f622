"""Origin of true paths, incidence points and clusters: the objects of the scene that they stem from."""

from dataclasses import dataclass

import numpy as np

from estimation.channel.hall.record import HallClass
from estimation.slam.record import IncidencePoints
from isac_arena.scoring.causes import LEVEL
from isac_arena.scoring.metrics.statistics import rows_of_groups
from isac_arena.scoring.record import PathKind, PathScores
from scenes.pose import SPEED_OF_LIGHT_M_S
from scenes.record import FloatArray, IntArray, TextArray
from sim.propagation.paths import BounceKind, Paths, with_bounce_slots

LEVEL_M = 1e-3  # between the rise of a path and that from the TX to the receiver


@dataclass(frozen=True)
class PathOrigin:
    """Kind of each true path, and the object of each single bounce, in space and seen from above."""

    kind: IntArray  # (path,) PathKind
    object: TextArray  # (path,) object of a single bounce, else empty
    plan_object: TextArray  # (path,) the same where a path also bounces off floor and ceiling
    vertex_m: FloatArray  # (path, xy) IP of a single bounce, else NaN
    height_m: FloatArray  # (path,) its height


def path_origin(paths: Paths) -> PathOrigin:
    """Kind, objects and incidence point of every true path; transmission through a wall is not a bounce.

    Seen from above a path that also bounces off floor and ceiling is the single bounce off its upright object.
    """
    paths = with_bounce_slots(paths, max(1, paths.size("bounce")))
    bounces = (paths.bounce_kind != BounceKind.NONE) & (paths.bounce_kind != BounceKind.REFRACTION)
    n_bounces = bounces.sum(axis=1)
    single = n_bounces == PathKind.SINGLE_BOUNCE
    path, slot = np.arange(len(paths)), bounces.argmax(axis=1)
    names = np.append(paths.object_name, "")
    upright = bounces & ~np.isin(names[paths.bounce_object], LEVEL)
    in_plan = np.where(upright.sum(axis=1) == 1, paths.bounce_object[path, upright.argmax(axis=1)], -1)
    index = np.where(single, paths.bounce_object[path, slot], -1)
    return PathOrigin(
        kind=np.minimum(n_bounces, PathKind.MULTI_BOUNCE),
        object=names[index],
        plan_object=names[np.where(single, index, in_plan)],
        vertex_m=np.where(single[:, None], paths.vertex_m[path, slot, :2], np.nan),
        height_m=np.where(single, paths.vertex_m[path, slot, 2], np.nan),
    )


def path_class(paths: Paths, tx_height_m: float, rx_height_m: float) -> IntArray:
    """Place (path,) in `HallClass` of true paths: diffuse ones are weak, others not level by floor or ceiling."""
    length_m = SPEED_OF_LIGHT_M_S * paths.delay_s
    rise_m = length_m * np.sin(paths.aod_elevation_rad), -length_m * np.sin(paths.aoa_elevation_rad)
    is_level = np.all([np.abs(rise - (rx_height_m - tx_height_m)) < LEVEL_M for rise in rise_m], axis=0)
    order = list(HallClass)
    specular = np.where(is_level, order.index(HallClass.LEVEL), order.index(HallClass.FLOOR_OR_CEILING))
    specular[path_origin(paths).kind == PathKind.LOS] = order.index(HallClass.LINE_OF_SIGHT)
    return np.where(paths.is_diffuse, order.index(HallClass.WEAK), specular)


def ip_paths(ips: IncidencePoints, paths: PathScores) -> IntArray:
    """Row (ip,) in `paths` of the path of each incidence point.

    Raises `ValueError` where an incidence point names a path that is in no channel estimate.
    """
    rows = {key: row for row, key in enumerate(zip(paths.stop.tolist(), paths.path.tolist(), strict=True))}
    keys = list(zip(ips.stop.tolist(), ips.path.tolist(), strict=True))
    unknown = [key for key in keys if key not in rows]
    if unknown:
        raise ValueError(
            f"IncidencePoints.path = {unknown[0][1]} at stop {unknown[0][0]}: "
            "must be a path of the channel estimate of that stop"
        )
    return np.array([rows[key] for key in keys], int)


FOUND_SHARE = 0.5  # a cluster shows an object when at least this share of its points stems from it


@dataclass(frozen=True)
class ClusterOrigin:
    """The object that each cluster shows."""

    object: TextArray  # (cluster,) empty where less than half of the IPs stem from one object
    purity: FloatArray  # (cluster,) share of the most frequent object


def cluster_origin(label: IntArray, ip_object: TextArray, n_clusters: int) -> ClusterOrigin:
    """Most frequent object among the IPs of each cluster, empty where its share is below `FOUND_SHARE`."""
    objects, purity = [], np.zeros(n_clusters)
    for cluster, rows in enumerate(rows_of_groups(label, n_clusters)):
        members = ip_object[rows]
        names, counts = np.unique(members[members != ""], return_counts=True)
        best = counts.argmax() if len(counts) else -1
        purity[cluster] = counts[best] / len(members) if len(counts) else 0.0
        objects.append(str(names[best]) if len(counts) and purity[cluster] >= FOUND_SHARE else "")
    return ClusterOrigin(np.asarray(objects, str), purity)
