"""`arena validate twin`: what the simulated Campus Arena explains of the measured one, where its file exists."""

from collections.abc import Iterator
from functools import cache

import numpy as np

from isac_arena.exchange.mat import read_measurement
from isac_arena.insight.twin.scores import twin_metrics
from isac_arena.insight.twin.twin import MODELS, make_twin, simulate_stops
from isac_arena.scoring.metrics.metric import Metric
from isac_arena.validation.measured_data import FILE, data_folder, with_values
from isac_arena.validation.measurement import Measurement, at_least, at_most
from scenes.config import load_scene

CARRIER_HZ = 60e9
SCENE = "campus_arena"
QUICK = ("one_bounce", "two_bounces")

SHARES = {"one_bounce": (0.62, 0.56), "two_bounces": (0.80, 0.70), "three_bounces": (0.80, 0.70)}
PILLAR_MEDIAN_DB, PILLAR_RMS_DB, ALL_RMS_DB = 1.0, 1.6, 3.5
PROTOTYPE = "share of a prototype with two TX offsets and one heading per stop"
CYLINDERS = "metal-clad cylinders, whose reflection is known"


def check_explained_paths(seed: int, quick: bool) -> list[Measurement]:
    """Share of the labelled single bounces with a simulated path within the gates, one to one, and by chance."""
    rows = []
    for name in _models(quick):
        rows += _explained(f"twin.{name}", name)
        rows.append(at_most(f"twin.{name}.chance", np.nan, 0.01, "paths of stops 2 m or more away"))
    los = at_least("twin.los_agreement.stops", np.nan, 29, "of 30; the heights are assumptions")
    return _measured([*rows, los], quick)


def check_power(seed: int, quick: bool) -> list[Measurement]:
    """Measured power of explained single bounces against the prediction, nothing fitted to reflections."""
    rows = []
    for name in _models(quick):
        key, materials = f"twin.{name}.power", "materials of the scene file"
        rows += [
            at_most(f"{key}.pillar.median_db", np.nan, PILLAR_MEDIAN_DB, f"magnitude; {CYLINDERS}", "dB"),
            at_most(f"{key}.pillar.rms_db", np.nan, PILLAR_RMS_DB, CYLINDERS, "dB"),
            at_most(f"{key}.single_bounce.rms_db", np.nan, ALL_RMS_DB, materials, "dB"),
        ]
    return _measured(rows, quick)


def check_calibrated(seed: int, quick: bool) -> list[Measurement]:
    """The same with offsets and gains of objects calibrated on the half of the stops that is not judged."""
    rows, reason = [], "calibrated on the other half of the stops"
    for name in _models(quick):
        key = f"twin.{name}.calibrated"
        rows += [
            *_explained(key, name),
            at_most(f"{key}.power.pillar.rms_db", np.nan, PILLAR_RMS_DB, reason, "dB"),
            at_most(f"{key}.power.single_bounce.rms_db", np.nan, ALL_RMS_DB, reason, "dB"),
        ]
    return _measured(rows, quick)


def _explained(key: str, model: str) -> list[Measurement]:
    return [
        at_least(f"{key}.explained.{gate}", np.nan, bar, PROTOTYPE)
        for gate, bar in zip(("wide", "narrow"), SHARES[model], strict=True)
    ]


def _models(quick: bool) -> tuple[str, ...]:
    return QUICK if quick else tuple(MODELS)


def _measured(rows: list[Measurement], quick: bool) -> list[Measurement]:
    """The rows with the scores of the same keys; a median counts by its magnitude."""

    def values() -> Iterator[float]:
        value = {metric.key: metric.value for metric in _metrics(_models(quick))}
        for row in rows:
            one = value.get(row.key, np.nan)
            yield abs(one) if row.key.endswith("median_db") else one

    return with_values(rows, values)


@cache
def _metrics(models: tuple[str, ...]) -> tuple[Metric, ...]:
    scene = load_scene(SCENE, CARRIER_HZ)
    height_m = float(scene.tx.position_m[2])
    campaign = read_measurement(data_folder() / FILE, height_m=height_m)
    simulated = {name: list(simulate_stops(scene, campaign, MODELS[name], CARRIER_HZ)) for name in models}
    return twin_metrics(make_twin(campaign, scene, simulated), scene.kinds)
