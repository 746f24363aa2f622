"""`arena validate twin`: what the simulated Campus Arena explains of the measured one, where that is at hand."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache
from typing import Literal

import numpy as np

from isac_arena.exchange.mat import read_measurement
from isac_arena.insight.twin.scores import twin_metrics
from isac_arena.insight.twin.simulate import MODELS, simulate_stops
from isac_arena.insight.twin.twin import make_twin
from isac_arena.scoring.metrics.metric import Metric
from isac_arena.validation.measurement import Measurement
from isac_arena.validation.slam.measured import FILE, data_folder
from scenes.config import load_scene

CARRIER_HZ = 60e9
SCENE = "campus_arena"
QUICK = ("one_bounce", "two_bounces")

Bar = tuple[str, str, Literal["lower", "higher"], float, str]  # key, unit, direction, bar, reason

SHARES = {"one_bounce": (0.62, 0.56), "two_bounces": (0.80, 0.70), "three_bounces": (0.80, 0.70)}
PILLAR_MEDIAN_DB, PILLAR_RMS_DB, ALL_RMS_DB = 1.0, 1.6, 3.5
PROTOTYPE = "a prototype with two TX offsets and one heading per stop"


def check_explained_paths(seed: int, quick: bool) -> list[Measurement]:
    """Share of the labelled single bounces with a simulated path within the gates, one to one, and by chance."""
    rows: list[Bar] = []
    for name in _models(quick):
        for gate, bar in zip(("wide", "narrow"), SHARES[name], strict=True):
            rows.append((f"twin.{name}.explained.{gate}", "1", "higher", bar, PROTOTYPE))
        rows.append((f"twin.{name}.chance", "1", "lower", 0.01, "paths of stops 2 m or more away"))
    rows.append(("twin.los_agreement.stops", "1", "higher", 29, "of 30; the heights are assumptions"))
    return list(_measured(rows, quick))


def check_power(seed: int, quick: bool) -> list[Measurement]:
    """Measured power of explained single bounces against the prediction, nothing fitted to reflections."""
    rows: list[Bar] = []
    for name in _models(quick):
        key = f"twin.{name}.power"
        rows += [
            (f"{key}.pillar.median_db", "dB", "lower", PILLAR_MEDIAN_DB, "magnitude; metal-clad cylinders"),
            (f"{key}.pillar.rms_db", "dB", "lower", PILLAR_RMS_DB, "metal-clad cylinders"),
            (f"{key}.single_bounce.rms_db", "dB", "lower", ALL_RMS_DB, "materials of the scene file"),
        ]
    return list(_measured(rows, quick))


def check_calibrated(seed: int, quick: bool) -> list[Measurement]:
    """The same with offsets and gains of objects calibrated on the half of the stops that is not judged."""
    rows: list[Bar] = []
    for name in _models(quick):
        key = f"twin.{name}.calibrated"
        for gate, bar in zip(("wide", "narrow"), SHARES[name], strict=True):
            rows.append((f"{key}.explained.{gate}", "1", "higher", bar, PROTOTYPE))
        rows.append((f"{key}.power.pillar.rms_db", "dB", "lower", PILLAR_RMS_DB, "other half of the stops"))
        rows.append(
            (f"{key}.power.single_bounce.rms_db", "dB", "lower", ALL_RMS_DB, "other half of the stops")
        )
    return list(_measured(rows, quick))


def _models(quick: bool) -> tuple[str, ...]:
    return QUICK if quick else tuple(MODELS)


def _measured(rows: list[Bar], quick: bool) -> Iterator[Measurement]:
    """The rows with their values; NaN, which meets no bar, where the measurement is not at hand."""
    if (data_folder() / FILE).is_file():
        value = {metric.key: metric.value for metric in _metrics(_models(quick))}
    else:
        missing = f"not measured: {FILE} is not in {data_folder()}"
        value, rows = {}, [(*row[:4], missing) for row in rows]
    for key, unit, direction, bar, reason in rows:
        one = value.get(key, np.nan)
        yield Measurement(key, abs(one) if key.endswith("median_db") else one, unit, direction, bar, reason)


@cache
def _metrics(models: tuple[str, ...]) -> tuple[Metric, ...]:
    scene = load_scene(SCENE, CARRIER_HZ)
    height_m = float(scene.tx.position_m[2])
    campaign = read_measurement(data_folder() / FILE, height_m=height_m)
    simulated = {name: list(simulate_stops(scene, campaign, MODELS[name], CARRIER_HZ)) for name in models}
    return twin_metrics(make_twin(campaign, scene, simulated), scene.kinds)
