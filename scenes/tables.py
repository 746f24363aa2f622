"""A scene made in Python as the tables of a scene file, the inverse of `scenes.config`."""

from typing import Any

import numpy as np

from scenes.contours import Circle, ClosedSpline, Contour, Ellipse, OpenSpline, Polygon, Polyline, RoundedPolygon
from scenes.motion.motion import Motion
from scenes.objects.material import Material, itu_material, itu_names
from scenes.pose import Pose
from scenes.record import FloatArray
from scenes.scene import HorizontalPlane, Scene, SceneObject
from scenes.targets.target import Target
from scenes.walks.trajectory import AnyWalk, RecordedWalk


def scene_tables(scene: Scene, carrier_hz: float = 60e9) -> dict[str, Any]:
    """The tables of a scene file that gives this scene at the carrier of its materials.

    Raises `ValueError` for a scene with meshes, which are files, and for two materials of one name.
    """
    if scene.clutter:
        raise ValueError(f"mesh '{scene.clutter[0].name}': meshes are files; give the tables of a scene file")
    materials: dict[str, Material] = {}
    targets = {item.name for item in scene.objects if item.target is not None}
    for name, material in scene.materials.items():
        if name not in targets and materials.setdefault(material.name, material) != material:
            raise ValueError(f"material '{material.name}': two materials have this name; each needs its own")
    tables: dict[str, Any] = {
        "name": scene.name,
        "bounds_m": list(scene.bounds_m),
        "txs": [
            _tx(name, pose) | _motion(scene.tx_motions.get(name), pose.position_m)
            for name, pose in scene.txs.items()
        ],
        "walks": [_walk(name, walk) for name, walk in scene.walks.items()],
        "materials": {name: _material(material, carrier_hz) for name, material in materials.items()},
    }
    planes: dict[str, HorizontalPlane | None] = {"floor": scene.floor, "ceiling": scene.ceiling}
    for name, plane in planes.items():
        if plane is not None:
            tables[name] = {"z_m": plane.z_m, "material": plane.material.name}
    tables["objects"] = [
        {
            "name": item.name,
            "kind": item.kind,
            "material": item.material.name,
            "z_min_m": item.z_min_m,
            "z_max_m": item.z_max_m,
            **({"may_overlap": True} if item.may_overlap else {}),
            "contour": _contour(item.contour),
            **_motion(item.motion, item.pivot_m),
        }
        for item in scene.fixtures
    ]
    tables["targets"] = [_target(item, item.target) for item in scene.objects if item.target is not None]
    return tables


def _target(item: SceneObject, target: Target) -> dict[str, Any]:
    return {
        "name": item.name,
        "type": target.kind,
        "position_m": item.pivot_m[:2].tolist(),
        "z_m": item.z_min_m,
        "heading_deg": _deg(target.heading_rad),
        "rcs_model": target.rcs_model,
        "scattering_points": "multiple" if target.has_points else "single",
        **_motion(item.motion, item.pivot_m),
    }


def _motion(motion: Motion | None, middle_m: FloatArray) -> dict[str, Any]:
    """The table of a motion, of an object whose middle is at `middle_m`; none without motion."""
    if motion is None:
        return {}
    if motion.coefficient[:, :2].any():
        raise ValueError("motion: recorded motions are files; give the tables of a scene file")
    start, rate = motion.knot_s[0], motion.coefficient[0, 2]
    table: dict[str, Any] = {"start_s": float(start), "angular_rate_deg_s": _deg(rate[3])}
    if len(motion.coefficient) == 1 and not motion.loops:
        table |= {"type": "velocity", "speed_m_s": float(np.hypot(*rate[:2])), "climb_m_s": float(rate[2])}
        table["heading_deg"] = _deg(np.arctan2(rate[1], rate[0]))
        if np.isfinite(motion.knot_s[1]):
            table["duration_s"] = float(motion.knot_s[1] - start)
        return {"motion": table}
    step = motion.coefficient[:, 2] * np.diff(motion.knot_s)[:, None]
    places = middle_m[:2] + np.cumsum(step[:, :2], axis=0)
    table |= {"type": "waypoints", "speed_m_s": float(np.linalg.norm(rate[:3])), "loop": motion.loops}
    return {"motion": table | {"waypoints_m": places.tolist()}}


def _tx(name: str, pose: Pose) -> dict[str, Any]:
    return {"name": name, "position_m": pose.position_m.tolist(), "heading_deg": _deg(pose.heading_rad)}


def _walk(name: str, walk: AnyWalk) -> dict[str, Any]:
    timing = {field: getattr(walk, field) for field in ("speed_m_s", "stop_interval_s")}
    return _places(name, walk) | {field: value for field, value in timing.items() if value}


def _places(name: str, walk: AnyWalk) -> dict[str, Any]:
    if isinstance(walk, RecordedWalk):
        poses = np.column_stack([walk.position_m, np.rad2deg(walk.heading_rad)])
        return {"name": name, "type": "poses", "poses": poses.tolist()}
    table: dict[str, Any] = {
        "name": name,
        "type": "spline" if walk.is_smooth else "waypoints",
        "waypoints_m": walk.waypoints_m.tolist(),
        "height_m": walk.height_m,
    }
    if walk.n_stops is not None:
        table["n_stops"] = walk.n_stops
    if not np.isnan(walk.heading_rad):
        table["heading_deg"] = _deg(walk.heading_rad)
    return table


def _material(material: Material, carrier_hz: float) -> dict[str, Any]:
    """The ITU row that has the constants of a material at the carrier, otherwise the constants."""
    constants: dict[str, Any] = {
        "relative_permittivity": material.relative_permittivity,
        "conductivity_s_m": material.conductivity_s_m,
    }
    if material.is_itu:
        for name in itu_names(carrier_hz):
            row = itu_material(name, carrier_hz)
            if all(getattr(row, field) == value for field, value in constants.items()):
                constants = {"itu": name}
                break
    table = {
        **constants,
        "thickness_m": material.thickness_m,
        "scattering_coefficient": material.scattering_coefficient,
    }
    if material.scattering_directivity is not None:
        table["scattering_directivity"] = material.scattering_directivity
    return table


def _contour(contour: Contour) -> dict[str, Any]:
    match contour:
        case Circle():
            return {"type": "circle", "center_m": contour.center_m.tolist(), "radius_m": contour.radius_m}
        case Ellipse():
            place = {"center_m": contour.center_m.tolist(), "semi_axes_m": contour.semi_axes_m.tolist()}
            return {"type": "ellipse", **place, "rotation_deg": _deg(contour.rotation_rad)}
        case Polygon():
            return {"type": "polygon", "vertices_m": contour.vertices_m.tolist()}
        case RoundedPolygon():
            radii = contour.corner_radius_m.tolist()
            return {"type": "polygon", "vertices_m": contour.vertices_m.tolist(), "corner_radius_m": radii}
        case ClosedSpline() | OpenSpline() | Polyline():
            kinds = {ClosedSpline: "closed_spline", OpenSpline: "spline", Polyline: "polyline"}
            return {"type": kinds[type(contour)], "points_m": contour.points_m.tolist()}
    raise ValueError(f"contour = {type(contour).__name__}: a scene file has no such contour")


def _deg(angle_rad: float) -> float:
    return float(np.rad2deg(angle_rad))
