"""The echoes of a moving point in NIST's Q-D realization software, an independent model.

Its files are `nist_qd/PointTarget` in the folder of the measured data: TX, receiver, 256 places of a point in 2 s
and the path over each. The reference takes 3e8 m/s, so lengths are compared. Its phases
give Doppler shifts.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np

from isac_arena.exchange.nist_qd import SPEED_M_S, TARGET_FILES, NistTarget, read_nist_target
from isac_arena.validation.measured_data import data_folder
from isac_arena.validation.measurement import InfoTable, Measured, at_most
from isac_arena.validation.propagation.nist import path_places, place_differences
from scenes.motion.motion import steady_motion
from scenes.pose import SPEED_OF_LIGHT_M_S, Pose
from scenes.record import FloatArray
from scenes.scene import Scene
from scenes.targets.config import TargetConfig
from scenes.walks.trajectory import Walk
from sim.config import PropagationConfig
from sim.propagation.paths import BounceKind, Paths
from sim.propagation.propagator import Propagator

EXAMPLE = Path("nist_qd") / "PointTarget"
CARRIER_HZ, STEP_S = 60e9, 2.0 / 256
QUICK_STEP = 16  # of times


def check_nist_target(seed: int, quick: bool) -> Measured:
    """Length, angles and Doppler shift of the path over the point, against ours over a target of the standard."""
    del seed
    folder = data_folder() / EXAMPLE
    absent = [name for name in TARGET_FILES if not (folder / name).is_file()]
    if absent:
        reason = f"{absent[0]} is not in {folder}"
        return Measured([], (InfoTable("NIST point target", ("not measured",), ((reason,),)),))
    known = read_nist_target(folder)
    worst: FloatArray = np.zeros(3)
    chosen = range(0, len(known.phase_rad) - 1, QUICK_STEP if quick else 1)
    for time in chosen:
        here, after = known.target_m[time], known.target_m[time + 1]
        apart = np.abs(
            place_differences(path_places(_echo(known, here, np.zeros(3))), known.echo[time : time + 1])[0]
        )
        between = _echo(known, (here + after) / 2, (after - here) / STEP_S)
        assert between.rates is not None
        shift_hz = between.rates.doppler_hz[0] * SPEED_OF_LIGHT_M_S / SPEED_M_S
        turns = -(known.phase_rad[time + 1] - known.phase_rad[time]) / (2 * np.pi)
        off_hz = abs((turns - shift_hz * STEP_S + 0.5) % 1 - 0.5) / STEP_S
        worst = np.maximum(worst, [apart[0], apart[1:].max(), off_hz])
    reason = f"largest of {len(chosen)} times"
    return Measured(
        [
            at_most("motion.nist_target.delay", 1e12 * worst[0] / SPEED_OF_LIGHT_M_S, 1.0, reason, "ps"),
            at_most("motion.nist_target.angles", np.rad2deg(worst[1]), 1e-3, reason, "deg"),
            at_most("motion.nist_target.doppler", worst[2], 0.1, f"{reason}, from its phases", "Hz"),
        ]
    )


def _echo(known: NistTarget, point_m: FloatArray, velocity_m_s: FloatArray) -> Paths:
    """The path over a target whose scattering point is at a place and moves."""
    about = TargetConfig(name="point", type="adult", position_m=(0.0, 0.0))
    height = about.build().z_max_m
    placed = about.model_copy(update={"position_m": tuple(point_m[:2]), "z_m": float(point_m[2] - height / 2)})
    item = replace(placed.build(), motion=steady_motion(velocity_m_s, 0.0))
    walk = Walk(np.array([known.rx_m[:2], known.rx_m[:2] + 0.1]), float(known.rx_m[2]), 0.0, 2)
    scene = Scene("nist_target", (item,), Pose(known.tx_m, 0.0), walk, (-10.0, -10.0, 10.0, 10.0))
    solver = Propagator(scene.at(0.0), CARRIER_HZ, PropagationConfig(diffuse_samples=0))
    paths = solver.with_rates(solver.exact_paths(known.rx_m), scene.bodies_at(0.0, known.rx_m, np.zeros(3)))
    return paths.take("path", (paths.bounce_kind == BounceKind.TARGET).any(axis=1))
