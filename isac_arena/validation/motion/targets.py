"""Targets of TR 38.901 clause 7.9: tables reached, statistics of their draws, and the rates of their paths."""

from dataclasses import replace
from typing import Any

import numpy as np
from tr3gpp import tr38901

from isac_arena.validation.measurement import Measurement, at_least, at_most
from isac_arena.validation.motion.rates import world_errors
from isac_arena.validation.motion.worlds import MadeWorld
from scenes.motion.motion import steady_motion
from scenes.pose import Pose
from scenes.random_arena import random_arena
from scenes.record import FloatArray
from scenes.targets.config import TargetConfig
from scenes.targets.standard import ScatteringPoints, TargetClass, TargetType, target_class
from sim.propagation.targets.rcs import PARTS, lobe_of, mean_rcs_dbsm, scattering

DRAWS = 100_000
SPREAD_BAR_DB = 0.05
RATE_BAR = 1e-6
CLASSES: dict[str, tuple[TargetType, int, ScatteringPoints]] = {
    "UAV with small size": ("uav_small", 1, "single"),
    "Human with RCS model 1": ("adult", 1, "single"),
    "UAV with large size": ("uav_large", 2, "single"),
    "Human with RCS model 2": ("child", 2, "single"),
    "Vehicle with single scattering point": ("vehicle", 2, "single"),
    "Vehicle with multiple scattering points": ("truck", 2, "multiple"),
    "AGV with single scattering point": ("agv_small", 2, "single"),
    "AGV with multiple scattering points": ("agv_large", 2, "multiple"),
}


def check_tables(seed: int, quick: bool) -> list[Measurement]:
    """Every entry of the tables on RCS, polarisation and sizes, reached through our classes."""
    del seed, quick
    data = tr38901.section("7.9")._data
    reached = [_model_1(row) for row in data.rcs_model_1] + [_model_2(row) for row in data.rcs_model_2]
    for row in data.xpr:
        known = [target_class(*key) for name, key in CLASSES.items() if name.startswith(row.target)]
        reached += [one.xpr_db == (float(row.mu_xpr_db), float(row.sigma_xpr_db)) for one in known]
    text = " ".join(
        (row.value or row.indoor_value).replace(" ", "")
        for row in data.sensing_scenarios
        if row.parameter.startswith("Physical")
    )
    for kind in ("adult", "child", "agv_small", "agv_large", "uav_small", "uav_large"):
        size = target_class(kind, 1 if kind == "uav_small" else 2, "single").size_m
        orders = (size, (size[1], size[0], size[2]))
        reached.append(any("mx".join(_short(value) for value in one) in _shortened(text) for one in orders))
    reason = f"{len(reached)} rows of tr3gpp: RCS, polarisation, sizes"
    return [at_least("motion.targets.tables", np.mean(reached), 1.0, reason, "share")]


def check_draws(seed: int, quick: bool) -> list[Measurement]:
    """Log-normal parts of the RCS and polarisation ratios over many draws, and the mean of the linear RCS."""
    del quick
    rng = np.random.default_rng(seed)
    worst = dict.fromkeys(("mean", "spread", "linear"), 0.0)
    for key in CLASSES.values():
        standard = target_class(*key)
        drawn = np.concatenate([rng.standard_normal((DRAWS, 2)), rng.random((DRAWS, PARTS - 2))], axis=1)
        factor, matrix = scattering(standard, drawn)
        factor_db, ratio_db = 10 * np.log10(factor), -20 * np.log10(np.abs(matrix[:, 0, 1]))
        expected = -np.log(10) / 20 * standard.spread_db**2
        mean, spread = standard.xpr_db
        worst["mean"] = max(worst["mean"], abs(factor_db.mean() - expected), abs(ratio_db.mean() - mean))
        worst["spread"] = max(
            worst["spread"], abs(factor_db.std() - standard.spread_db), abs(ratio_db.std() - spread)
        )
        worst["linear"] = max(worst["linear"], abs(10 * np.log10(factor.mean())))
    reason = f"largest deviation in {len(CLASSES)} classes, {DRAWS:,} draws each"
    return [at_most(f"motion.targets.{name}", value, SPREAD_BAR_DB, reason, "dB") for name, value in worst.items()]


def check_target_rates(seed: int, quick: bool) -> list[Measurement]:
    """Rates of paths over moving targets against tracing again: direct ones and those with a reflection."""
    errors: list[FloatArray] = []
    for index in range(2 if quick else 50):
        found = world_errors(target_world(seed, index))
        errors += [error for kind, error in found if kind == "target" and error is not None]
    every = np.array(errors)
    reason = f"{len(every)} paths of worlds with two targets, relative to the rate or its median"
    return [
        at_most("motion.targets.length_rate", every[:, 0].max(), RATE_BAR, reason),
        at_most("motion.targets.angle_rates", every[:, 2:].max(), RATE_BAR, reason),
    ]


def target_world(seed: int, index: int) -> MadeWorld:
    """A random arena where a person walks and an AGV drives and turns, and the receiver walks."""
    rng = np.random.default_rng([seed, 2000 + index])
    scene = random_arena(rng, 0.0, 2)
    rx = scene.stops[0].position_m
    targets = []
    both = {"type": "adult"}, {"type": "agv_small", "scattering_points": "multiple"}
    for about, share in zip(both, (0.35, 0.65), strict=True):
        place = scene.tx.position_m + share * (rx - scene.tx.position_m) + rng.uniform(-0.7, 0.7, 3)
        values = about | {"name": about["type"], "position_m": tuple(place[:2].tolist())}
        item = TargetConfig.model_validate(values).build()
        velocity = np.array([*rng.uniform(-1.5, 1.5, 2), 0.0])
        targets.append(replace(item, may_overlap=True, motion=steady_motion(velocity, float(rng.uniform(-1, 1)))))
    scene = replace(scene, objects=(*scene.objects, *targets), tx=Pose(scene.tx.position_m, scene.tx.heading_rad))
    return MadeWorld(scene, rx, np.array([*rng.uniform(-1, 1, 2), 0.0]))


def _model_1(row: Any) -> bool:
    standard = target_class(*CLASSES[row.sensing_target])
    level = mean_rcs_dbsm(standard, 0.3, np.eye(3)[:1], np.eye(3)[:1], None)[0]
    return bool(level == float(row.lg_sigma_m_dbsm) and standard.spread_db == float(row.sigma_sigmaS_db))


def _model_2(row: Any) -> bool:
    """Whether the RCS seen from the middle of a lobe is its largest, and off it falls to its least."""
    standard = target_class(*CLASSES[row.target])
    zenith = float(row.theta_center_deg)
    azimuth = 0.0 if row.phi_center_deg == "-" else float(row.phi_center_deg)
    lobe = next(one for one in standard.lobes if one.side == row.scattering_point.lower())
    number = None
    if row.range_phi_deg == "[0,360)" and "multiple" in row.target:
        number = np.array([standard.lobes.index(lobe)])
    top = _seen(standard, azimuth, zenith, number)
    side = _seen(standard, azimuth, zenith + (5.0 if zenith < 90 else -5.0), number)
    expected = float(row.g_max) - min(12 * (5 / float(row.theta_3db_deg)) ** 2, float(row.sigma_max))
    own = number is not None or lobe_of(standard.lobes, np.array([azimuth]), np.array([zenith]))[0] >= 0
    same = (float(row.lg_sigma_m_dbsm), float(row.sigma_sigmaS_db)) == (standard.mean_dbsm, standard.spread_db)
    return bool(own and same and np.isclose(top, float(row.g_max)) and np.isclose(side, expected))


def _seen(standard: TargetClass, azimuth_deg: float, zenith_deg: float, number: Any) -> float:
    """RCS in dBsm from one direction, monostatic."""
    azimuth, zenith = np.deg2rad([azimuth_deg, zenith_deg])
    ray = np.array([[np.sin(zenith) * np.cos(azimuth), np.sin(zenith) * np.sin(azimuth), np.cos(zenith)]])
    return float(mean_rcs_dbsm(standard, 0.0, ray, ray, number)[0])


def _short(value: float) -> str:
    return f"{value:g}"


def _shortened(text: str) -> str:
    return text.replace(".0m", "m").replace(".0x", "x")
