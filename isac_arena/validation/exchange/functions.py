"""Bad functions of users for every stage: 36 ways to raise, hang, return nonsense or write into the input."""

from isac_arena.user_functions.config import Stage

HEAD = """
import ctypes, os, sys, time
from dataclasses import replace
import numpy as np
from estimation.channel.record import empty_estimate
from estimation.shape.outline import contours_of
from estimation.slam.record import IncidencePoints, PoseEstimates
from estimation.tracks.record import Tracks

def overwrite(value):
    address = value.__array_interface__["data"][0]
    (ctypes.c_ubyte * 8).from_address(address)[:] = b"\\x01" * 8

def points(channel):
    rows = [(e.stop, path) for e in channel for path in range(1, len(e))]
    n = len(rows)
    return IncidencePoints(
        stop=np.array([r[0] for r in rows], int), path=np.array([r[1] for r in rows], int),
        position_m=np.zeros((n, 2)), covariance_m2=np.tile(np.eye(2), (n, 1, 1)), cost=np.zeros(n),
        is_inlier=np.ones(n, bool),
    )

def poses(channel):
    n = len(channel)
    return PoseEstimates(
        stop=np.array([e.stop for e in channel], int), position_m=np.zeros((n, 2)), heading_rad=np.zeros(n),
        clock_bias_s=np.zeros(n), status=np.ones(n, int), n_inliers=np.zeros(n, int), cost=np.zeros(n),
        covariance=np.tile(np.diag([1.0, 1.0, 1.0, 1e-18]), (n, 1, 1)),
    )

def tracks(survey):
    n = len(survey.stop)
    return Tracks(survey, np.zeros(n, int), survey.stop, np.zeros((n, 2)), np.zeros((n, 2)))

def two_paths(sweep):
    found = empty_estimate(sweep.stop, "mine", "ok", "")
    two = {name: np.zeros(2) for name in ("aod_azimuth_rad", "aoa_azimuth_rad", "beam_loss_db", "snr_db")}
    cov = np.tile(np.diag([1e-18, 1e-4, 1e-4]), (2, 1, 1))
    return replace(
        found, **two, delay_s=np.array([1e-8, 2e-8]), power_dbm=np.array([-50.0, -60.0]), covariance=cov,
        is_los=np.zeros(2, bool), los_probability=np.zeros(2), gain_amplitude=np.full(2, np.nan),
        gain_phase_rad=np.full(2, np.nan), aod_elevation_rad=np.full(2, np.nan),
        aoa_elevation_rad=np.full(2, np.nan), unresolved_probability=np.full(2, np.nan), is_weak=np.zeros(2, bool),
        tx=np.zeros(2, int),
    )
"""
# Arguments of each stage, and bodies by name. A channel function fails at stop 2 only.
ARGUMENTS: dict[Stage, str] = {
    "channel": "sweep",
    "mapping": "channel, tx, receiver",
    "slam": "channel, tx, heights",
    "shapes": "channel, tx, poses_in, points_in",
    "tracker": "channel, poses_in, survey",
}
ENDS = {
    "raises": "raise RuntimeError('a\\nb')",
    "leaves": "sys.exit(0)",
    "dies": "os._exit(4)",
    "hangs": "time.sleep(600)",
    "nothing": "return None",
}
BODIES: dict[Stage, dict[str, str]] = {
    "channel": {
        **ENDS,
        "shape": "found = two_paths(sweep); return replace(found, delay_s=found.delay_s[:1])",
        "nan": "found = two_paths(sweep); return replace(found, delay_s=found.delay_s * np.nan)",
        "covariance": "found = two_paths(sweep); return replace(found, covariance=-found.covariance)",
        "writes": "overwrite(sweep.samples); return two_paths(sweep)",
    },
    "mapping": {
        **ENDS,
        "shape": "found = points(channel); return replace(found, path=found.path + 99)",
        "nan": "found = points(channel); return replace(found, position_m=found.position_m * np.nan)",
        "covariance": "found = points(channel); return replace(found, covariance_m2=-found.covariance_m2)",
    },
    "slam": {
        "crashes": "ctypes.string_at(0)",
        "spins": "\n    while True: pass",
        "shape": "return poses(channel[1:]), points(channel)",
        "nan": "return replace(poses(channel), heading_rad=np.full(len(channel), np.nan)), points(channel)",
        "covariance": "return replace(poses(channel), covariance=-poses(channel).covariance), points(channel)",
        "writes": "channel[1].power_dbm[:] = 0.0",
        "overwrites": "overwrite(channel[1].power_dbm); return poses(channel), points(channel)",
    },
    "shapes": {
        "raises": ENDS["raises"],
        "nothing": ENDS["nothing"],
        "memory": "np.ones(10**14)",
        "shape": "return contours_of([], poses_in, points_in.take('ip', slice(0, 1)))",
        "class": "return replace(contours_of([], poses_in, points_in), class_name=np.array(['tree'] * 3))",
        "overwrites": "overwrite(points_in.position_m); return contours_of([], poses_in, points_in)",
    },
    "tracker": {
        "raises": ENDS["raises"],
        "hangs": ENDS["hangs"],
        "shape": "return replace(tracks(survey), stop=survey.stop + 1)",
        "nan": "return replace(tracks(survey), velocity_m_s=np.full((len(survey.stop), 2), np.nan))",
        "covariance": "return replace(tracks(survey), covariance=np.tile(-np.eye(5), (len(survey.stop), 1, 1)))",
        "overwrites": "overwrite(survey.time_s); return tracks(survey)",
    },
}
COUNT = sum(len(bodies) for bodies in BODIES.values())


def source() -> str:
    """The module of all bad functions, `STAGE_NAME` each."""
    parts = [HEAD]
    for stage, bodies in BODIES.items():
        for name, body in bodies.items():
            guard = "    if sweep.stop != 2: return two_paths(sweep)\n" if stage == "channel" else ""
            parts.append(f"\ndef {stage}_{name}({ARGUMENTS[stage]}):\n{guard}    {body}\n")
    return "".join(parts)
