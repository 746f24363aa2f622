"""Scores of a map: errors of the incidence points, and the objects found."""

import numpy as np

from isac_arena.campaign.results import MapResult
from isac_arena.scoring.causes import GHOST_CAUSES, LEVEL, Cause, point_causes
from isac_arena.scoring.metrics.consistency import consistency_metrics
from isac_arena.scoring.metrics.metric import Metric
from isac_arena.scoring.metrics.statistics import mean, quantile, ratio, rms, rows_of_groups, squared_mahalanobis
from isac_arena.scoring.provenance import ClusterOrigin, ip_paths
from isac_arena.scoring.record import IpScores, OutlineScores, PathScores
from scenes.record import BoolArray, FloatArray, IntArray, TextArray
from scenes.scene import OBJECT_KINDS, Scene

FOUND_DISTANCE_M = 0.5  # a point supports its object from this distance: objects usually stand farther apart
SURFACE_STEP_M = 1e-4  # of the slopes of distances: well below all errors
FOUND_POINTS = 3  # an object is found when this many points support it: two can be close by chance


def surface_distance_m(scene: Scene, points_m: FloatArray) -> FloatArray:
    """Distance (point,) in m to the nearest boundary of any object or mesh in the plan; infinite without any."""
    nearest = np.full(len(points_m), np.inf)
    for item in scene.fixtures:
        nearest = np.minimum(nearest, np.abs(item.contour.signed_distance(points_m)))
    for mesh in scene.clutter:
        nearest = np.minimum(nearest, mesh.plan_distance_m(points_m))
    return nearest


def variance_across_m2(
    scene: Scene, points_m: FloatArray, distance_m: FloatArray, covariance_m2: FloatArray
) -> FloatArray:
    """Variance (point,) in m^2 of points across the boundary that is nearest in the plan; NaN without any.

    `distance_m` is `surface_distance_m` of the points.
    """
    here_m = np.where(np.isfinite(distance_m), distance_m, np.nan)
    ahead_m = [surface_distance_m(scene, points_m + step) for step in SURFACE_STEP_M * np.eye(2)]
    slope = np.stack(ahead_m, axis=1) - here_m[:, None]
    length = np.linalg.norm(slope, axis=1, keepdims=True)
    normal = np.divide(slope, length, out=np.full_like(slope, np.nan), where=length > 0)
    return np.asarray(np.einsum("na,nab,nb->n", normal, covariance_m2, normal))


def level_distance_m(scene: Scene, objects: TextArray, height_m: FloatArray) -> FloatArray:
    """Height difference (point,) in m to the floor or ceiling that a point stems from; NaN where unknown."""
    planes = dict(zip(LEVEL, (scene.floor, scene.ceiling), strict=True))
    z_m = {name: plane.z_m for name, plane in planes.items() if plane is not None}
    return np.asarray(np.abs(height_m - np.array([z_m.get(str(name), np.nan) for name in objects], float)))


def score_ips(scene: Scene, result: MapResult, paths: PathScores) -> IpScores:
    """Table of all incidence points of a map.

    Raises `ValueError` where the clusters do not have one label for every incidence point.
    """
    ips, label = result.ips, result.shapes.label
    if len(label) != len(ips):
        raise ValueError(f"Shapes.label: {len(label)} labels for {len(ips)} incidence points, one each is needed")
    row = ip_paths(ips, paths)
    error = ips.position_m - paths.vertex_m[row]
    height_error = ips.height_m - paths.vertex_height_m[row]
    source = paths.object[row]
    is_level = np.isin(source, LEVEL)
    height_variance_m2 = ips.height_covariance_m2[:, 2]
    in_plan_m = surface_distance_m(scene, ips.position_m)
    across_m = np.where(is_level, level_distance_m(scene, source, ips.height_m), in_plan_m)
    variance_m2 = variance_across_m2(scene, ips.position_m, in_plan_m, ips.covariance_m2)
    across_m2 = np.where(source == "", np.nan, np.where(is_level, height_variance_m2, variance_m2))
    return IpScores(
        stop=ips.stop,
        path=ips.path,
        is_inlier=ips.is_inlier,
        label=label,
        object=paths.plan_object[row],
        cause=point_causes(ips.is_inlier, paths.plan_object[row], paths.kind[row], paths.cause[row]),
        surface_distance_m=across_m,
        surface_nees=squared_mahalanobis(across_m[:, None], across_m2[:, None, None]),
        position_error_m=np.linalg.norm(error, axis=1),
        nees=squared_mahalanobis(error, ips.covariance_m2),
        height_error_m=height_error,
        height_nees=squared_mahalanobis(height_error[:, None], height_variance_m2[:, None, None]),
    )


def close_counts(scene: Scene, result: MapResult, ips: IpScores, origin: ClusterOrigin) -> IntArray:
    """Numbers (cluster,) of IPs that stem from the object or mesh and lie within `FOUND_DISTANCE_M` of it."""
    counts = np.zeros(len(origin.object), int)
    distance_of = {item.name: item.contour.signed_distance for item in scene.fixtures}
    distance_of |= {mesh.name: mesh.plan_distance_m for mesh in scene.clutter}
    for cluster, members in enumerate(rows_of_groups(ips.label, len(counts))):
        name = str(origin.object[cluster])
        if name not in distance_of:
            continue
        own = members[ips.object[members] == name]
        distance = np.abs(distance_of[name](result.ips.position_m[own]))
        counts[cluster] = (distance <= FOUND_DISTANCE_M).sum()
    return counts


def is_ghost(ips: IpScores, n_clusters: int) -> BoolArray:
    """Whether more than half of the IPs of each cluster have no object: multiple bounces and false paths."""
    nameless = [mean(ips.object[members] == "") for members in rows_of_groups(ips.label, n_clusters)]
    return np.array(nameless, float) > 0.5


def map_metrics(prefix: str, scene: Scene, ips: IpScores, clusters: OutlineScores) -> list[Metric]:
    """Scores of one map; `prefix` is 'mapping' or 'slam'. Distances are those of the estimator's inliers."""
    inliers = ips.take("ip", ips.is_inlier)
    clustered = inliers.label >= 0
    return [
        Metric(f"{prefix}.ips", len(inliers.stop), "1", "info"),
        Metric(f"{prefix}.ips_clustered_share", mean(clustered), "1", "info"),
        Metric(f"{prefix}.ips_of_floor_or_ceiling", np.isin(inliers.object, LEVEL).sum(), "1", "info"),
        Metric(f"{prefix}.ips_from_single_bounce_share", mean(inliers.object != ""), "1", "higher"),
        *_cause_metrics(prefix, ips),
        *_distance_metrics(f"{prefix}.ip_to_surface", inliers.surface_distance_m),
        *_distance_metrics(f"{prefix}.ip_to_surface.clustered", inliers.surface_distance_m[clustered]),
        *consistency_metrics(f"{prefix}.ip_to_surface", inliers.surface_nees, 1),
        *_distance_metrics(f"{prefix}.ip_position", inliers.position_error_m),
        *consistency_metrics(f"{prefix}.ip_position", inliers.nees, 2),
        *_distance_metrics(f"{prefix}.ip_height", np.abs(inliers.height_error_m)),
        *consistency_metrics(f"{prefix}.ip_height", inliers.height_nees, 1),
        *_object_metrics(prefix, scene, clusters),
    ]


def found_objects(clusters: OutlineScores) -> list[str]:
    """Sorted names of the objects and meshes found."""
    return sorted({str(name) for name in clusters.object[clusters.is_found]})


def found_kinds(scene: Scene, clusters: OutlineScores) -> list[str]:
    """Kinds of the objects found; meshes, which have no true outline, are in no score of objects."""
    known = scene.object_names
    return [scene.object(name).kind for name in found_objects(clusters) if name in known]


def _cause_metrics(prefix: str, ips: IpScores) -> list[Metric]:
    """Numbers of inliers without object by cause, and of true single bounces that are not inliers."""
    return [
        *(
            Metric(f"{prefix}.ghost_ips.{cause}", (ips.cause[ips.is_inlier] == cause).sum(), "1", "info")
            for cause in GHOST_CAUSES
        ),
        Metric(f"{prefix}.rejected_ips", (ips.cause == Cause.REJECTED).sum(), "1", "info"),
    ]


def _distance_metrics(prefix: str, distance_m: FloatArray) -> list[Metric]:
    return [
        Metric(f"{prefix}.median_m", quantile(distance_m, 0.5), "m", "lower"),
        Metric(f"{prefix}.rms_m", rms(distance_m), "m", "lower"),
        Metric(f"{prefix}.p90_m", quantile(distance_m, 0.9), "m", "lower"),
    ]


def _object_metrics(prefix: str, scene: Scene, clusters: OutlineScores) -> list[Metric]:
    found = found_kinds(scene, clusters)
    n_clusters = len(clusters.object)
    return [
        Metric(f"{prefix}.clusters", n_clusters, "1", "info"),
        Metric(f"{prefix}.ghost_clusters", clusters.is_ghost.sum(), "1", "lower"),
        Metric(f"{prefix}.cluster_purity", mean(clusters.purity), "1", "higher"),
        Metric(f"{prefix}.objects_found", len(found), "1", "higher"),
        Metric(f"{prefix}.objects_found_share", ratio(len(found), len(scene.fixtures)), "1", "higher"),
        *(Metric(f"{prefix}.objects_found.{kind}", found.count(kind), "1", "higher") for kind in OBJECT_KINDS),
    ]
