"""Scores of a twin: shares explained, residuals by parameter and object, power, line of sight."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from isac_arena.insight.twin.record import TwinPaths
from isac_arena.insight.twin.twin import Twin
from isac_arena.scoring.metrics.metric import Metric
from isac_arena.scoring.metrics.statistics import quantile, ratio, rms
from scenes.record import BoolArray, FloatArray


class ObjectResiduals(NamedTuple):
    """Residuals of the labelled single bounces that one object explains."""

    object: str
    n: int
    delay_median_s: float
    delay_rms_s: float
    aod_median_rad: float
    aod_rms_rad: float
    aoa_median_rad: float
    aoa_rms_rad: float
    power_median_db: float
    power_rms_db: float


def twin_metrics(twin: Twin, kinds: Mapping[str, str]) -> tuple[Metric, ...]:
    """All scores of a twin, with the same keys for the same models; `kinds` is the kind of every object."""
    metrics = [
        Metric("twin.los_agreement.stops", float(np.sum(twin.has_los == twin.simulated_los)), "1", "higher"),
        Metric("twin.stops", len(twin.has_los), "1", "info"),
    ]
    for name, model in twin.models.items():
        metrics += _model_metrics(f"twin.{name}", model.paths, kinds)
        metrics.append(Metric(f"twin.{name}.chance", model.chance, "1", "lower"))
        metrics += _model_metrics(f"twin.{name}.calibrated", model.calibrated, kinds)
    return tuple(metrics)


def object_residuals(paths: TwinPaths) -> list[ObjectResiduals]:
    """Residuals of explained labelled single bounces by the object of the simulated path, the most frequent first.

    Paths that are explained without a bounce or by several bounces are grouped by the number of bounces.
    """
    used = paths.is_explained & paths.is_single_bounce
    other = np.array(["straight" if n == 0 else f"{n} bounces" for n in paths.n_bounces], str)
    label = np.where(paths.object != "", paths.object, other)
    names, counts = np.unique(label[used], return_counts=True)
    rows = []
    for name, n in sorted(zip(names.tolist(), counts.tolist(), strict=True), key=lambda one: -one[1]):
        mine = used & (label == name)
        columns = (paths.delay_residual_s, paths.aod_residual_rad, paths.aoa_residual_rad)
        values = [
            statistic
            for column in (*columns, paths.power_residual_db)
            for statistic in (quantile(column[mine], 0.5), rms(column[mine]))
        ]
        rows.append(ObjectResiduals(name, n, *values))
    return rows


def is_pillar(paths: TwinPaths, kinds: Mapping[str, str]) -> BoolArray:
    """Paths (path,) that the twin explains by one bounce off a pillar."""
    pillars = [name for name, kind in kinds.items() if kind == "pillar"]
    return np.isin(paths.object, pillars)


def _model_metrics(key: str, paths: TwinPaths, kinds: Mapping[str, str]) -> list[Metric]:
    single, narrow = paths.is_single_bounce, paths.simulated_narrow >= 0
    used = single & paths.is_explained
    pillar = used & is_pillar(paths, kinds)
    bare = paths.power_dbm - paths.signal_dbm
    residual = paths.power_residual_db
    no_los = ~paths.is_los
    return [
        Metric(f"{key}.explained.wide", ratio(used.sum(), single.sum()), "1", "higher"),
        Metric(f"{key}.explained.narrow", ratio((single & narrow).sum(), single.sum()), "1", "higher"),
        Metric(f"{key}.explained_nlos.wide", _share(paths.is_explained, no_los), "1", "higher"),
        Metric(f"{key}.explained_nlos.narrow", _share(narrow, no_los), "1", "higher"),
        Metric(f"{key}.delay.rms_ns", 1e9 * rms(paths.delay_residual_s[used]), "ns", "lower"),
        Metric(f"{key}.aod.rms_deg", float(np.rad2deg(rms(paths.aod_residual_rad[used]))), "deg", "lower"),
        Metric(f"{key}.aoa.rms_deg", float(np.rad2deg(rms(paths.aoa_residual_rad[used]))), "deg", "lower"),
        Metric(f"{key}.power.pillar.median_db", _median(residual[pillar]), "dB", "info"),
        Metric(f"{key}.power.pillar.rms_db", rms(residual[pillar]), "dB", "lower"),
        Metric(f"{key}.power.single_bounce.median_db", _median(residual[used]), "dB", "info"),
        Metric(f"{key}.power.single_bounce.rms_db", rms(residual[used]), "dB", "lower"),
        Metric(f"{key}.power.without_floor.pillar.rms_db", rms(bare[pillar]), "dB", "lower"),
        Metric(f"{key}.power.without_floor.single_bounce.rms_db", rms(bare[used]), "dB", "lower"),
    ]


def _share(found: BoolArray, among: BoolArray) -> float:
    return ratio(int((found & among).sum()), int(among.sum()))


def _median(values: FloatArray) -> float:
    return quantile(values, 0.5)
