"""The tables of TR 38.901 clause 7.9 on targets, read from the package `tr3gpp`: sizes, RCS and polarisation."""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Literal, get_args

TargetType = Literal["adult", "child", "agv_small", "agv_large", "vehicle", "truck", "uav_small", "uav_large"]
TARGET_TYPES: tuple[str, ...] = get_args(TargetType)
ScatteringPoints = Literal["single", "multiple"]

# Names of the tables: family of scenarios, entry of its sizes, and names in the tables of RCS and polarisation.
_SIZES = {
    "adult": ("Human", "Adult Pedestrian:"),
    "child": ("Human", "Child:"),
    "agv_small": ("AGV", "Option 1:"),
    "agv_large": ("AGV", "Option 2:"),
    "uav_small": ("UAV", "Option 2:"),
    "uav_large": ("UAV", "Option 1:"),
}
_VEHICLE_SIZES_M = {
    "vehicle": (5.0, 2.0, 1.6),
    "truck": (13.0, 2.6, 3.0),
}  # TR 37.885 clause 6.1.2, types 1/2 and 3
_FAMILY = {"adult": "Human", "child": "Human", "truck": "Vehicle", "vehicle": "Vehicle"}
_MODEL_1 = {"Human": "Human with RCS model 1", "UAV": "UAV with small size"}
_MODEL_2 = {"Human": "Human with RCS model 2", "UAV": "UAV with large size"}
_SHAPE = {"Vehicle": "Vehicle with single/multiple SPSTs", "AGV": "AGV with single/multiple SPSTs"}


@dataclass(frozen=True)
class RcsLobe:
    """One row of Tables 7.9.2.1-2 to 7: a lobe of the RCS about a direction in the frame of the target.

    Angles are in degrees: azimuth from the front, zenith from the top. A lobe about the vertical has no azimuth.
    """

    side: str
    azimuth_deg: float | None
    azimuth_width_deg: float
    zenith_deg: float
    zenith_width_deg: float
    most_db: float  # G_max
    depth_db: float  # sigma_max
    zenith_range_deg: tuple[float, float]
    azimuth_range_deg: tuple[float, float]


@dataclass(frozen=True)
class TargetClass:
    """What the standard says of one type of target.

    Attributes
    ----------
    size_m : length, width and height; the front is one end of the length
    mean_dbsm : mean of the linear RCS; alone for model 1, whose `lobes` are empty
    spread_db : standard deviation of the log-normal part
    shape : k_1 and k_2 of equation 7.9.2-3
    xpr_db : mean and standard deviation of the cross-polarisation ratio
    """

    size_m: tuple[float, float, float]
    mean_dbsm: float
    spread_db: float
    lobes: tuple[RcsLobe, ...]
    shape: tuple[float, float]
    xpr_db: tuple[float, float]


@lru_cache(maxsize=64)
def target_class(kind: TargetType, model: int, points: ScatteringPoints) -> TargetClass:
    """The class of a type of target with RCS model 1 or 2, of one or of several scattering points.

    Raises `ValueError` where the standard has no such model or points.
    """
    family = _FAMILY.get(kind, kind.split("_")[0].upper())
    rcs = f"{family} of {points} points" if points == "multiple" else kind
    if (model == 1) != (family in _MODEL_1 and kind != "uav_large") and not (family == "Human" and model == 2):
        raise ValueError(f"rcs_model = {model}: the standard has none for '{kind}'")
    if points == "multiple" and family not in _SHAPE:
        raise ValueError(
            f"scattering_points = '{points}': the standard has them for AGVs and vehicles, not '{rcs}'"
        )
    table = _table()
    xpr = next(row for row in table.xpr if row.target == family)
    polarisation = float(xpr.mu_xpr_db), float(xpr.sigma_xpr_db)
    size_m = _VEHICLE_SIZES_M.get(kind) or _size_m(table, kind)
    if model == 1:
        one = next(row for row in table.rcs_model_1 if row.sensing_target == _MODEL_1[family])
        mean, spread = float(one.lg_sigma_m_dbsm), float(one.sigma_sigmaS_db)
        return TargetClass(size_m, mean, spread, (), (0.0, 0.0), polarisation)
    name = _MODEL_2.get(family, f"{family} with {points} scattering point{'s' * (points == 'multiple')}")
    rows = [row for row in table.rcs_model_2 if row.target == name]
    shape = next(row for row in table.rcs_model_2_k_parameters if row.target == _SHAPE.get(family, name))
    return TargetClass(
        size_m,
        float(rows[0].lg_sigma_m_dbsm),
        float(rows[0].sigma_sigmaS_db),
        tuple(_lobe(row) for row in rows),
        (float(shape.k1), float(shape.k2)),
        polarisation,
    )


@lru_cache(maxsize=1)
def _table() -> Any:
    """The data of clause 7.9."""
    from tr3gpp import tr38901  # noqa: PLC0415  (reads all tables)

    return tr38901.section("7.9")._data


def _size_m(table: Any, kind: str) -> tuple[float, float, float]:
    """Length, width and height of Tables 7.9.1-1 to 4; an AGV has its front at a short edge."""
    scenario, label = _SIZES[kind]
    row = next(
        row
        for row in table.sensing_scenarios
        if row.scenario_type == scenario and row.parameter.startswith("Physical characteristics")
    )
    text = row.value or row.indoor_value
    found = re.search(re.escape(label) + r"\s*([\d.]+)\s*m x ([\d.]+)\s*m x ([\d.]+)\s*m", text)
    if found is None:
        raise ValueError(f"tr3gpp: the size of '{kind}' is not where it was, '{text}'")
    first, second, height = (float(value) for value in found.groups())
    length, width = (max(first, second), min(first, second)) if scenario == "AGV" else (first, second)
    return length, width, height


def _lobe(row: Any) -> RcsLobe:
    level = row.phi_center_deg == "-"
    return RcsLobe(
        side=row.scattering_point.lower(),
        azimuth_deg=None if level else float(row.phi_center_deg),
        azimuth_width_deg=0.0 if level else float(row.phi_3db_deg),
        zenith_deg=float(row.theta_center_deg),
        zenith_width_deg=float(row.theta_3db_deg),
        most_db=float(row.g_max),
        depth_db=float(row.sigma_max),
        zenith_range_deg=_range(row.range_theta_deg),
        azimuth_range_deg=_range(row.range_phi_deg),
    )


def _range(text: str) -> tuple[float, float]:
    low, high = (float(part) for part in text.strip("[]() ").split(","))
    return low, high
