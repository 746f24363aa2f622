from dataclasses import replace

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from estimation.channel.record import ChannelEstimate, PathMotion, empty_estimate
from estimation.channel.still import is_still, still_paths

LEAST_HZ = 8.0  # a shift of less has no evidence in these stops
STD_HZ = 2.0


def _estimate(seed: int, velocity_hz: np.ndarray, n_still: int, mover_hz: np.ndarray) -> ChannelEstimate:
    """Paths that stand, seen by a receiver of this velocity (in wavelengths), and movers with further shifts."""
    rng = np.random.default_rng(seed)
    n = n_still + len(mover_hz)
    aoa = rng.uniform(-np.pi, np.pi, n)
    exact = np.cos(aoa) * velocity_hz[0] + np.sin(aoa) * velocity_hz[1]
    exact[n_still:] += mover_hz
    shift = exact + STD_HZ * rng.standard_normal(n)
    moves = np.abs(shift) > LEAST_HZ
    motion = PathMotion(moves, np.where(moves, shift, 0.0), np.where(moves, STD_HZ, np.nan), np.zeros(n))
    none = empty_estimate(3, "given", "ok", "")
    columns = dict.fromkeys(("aod_azimuth_rad", "power_dbm", "beam_loss_db", "snr_db"), np.zeros(n))
    flags = {"is_los": np.zeros(n, bool), "covariance": np.zeros((n, 3, 3)), "motion": motion}
    return ChannelEstimate(**columns, **flags, stop=none.stop, delay_s=np.arange(n) * 1e-8, aoa_azimuth_rad=aoa)


def test_without_shifts_everything_stands() -> None:
    estimate = _estimate(1, np.zeros(2), 6, np.zeros(0))
    assert is_still(estimate).all() and is_still(replace(estimate, motion=None)).all()
    assert still_paths([estimate]).channel[0] is estimate


def test_movers_are_told_from_the_room_where_the_receiver_stands() -> None:
    assert is_still(_estimate(2, np.zeros(2), 8, np.array([120.0, -60.0, 300.0]))).tolist() == 8 * [True] + 3 * [
        False
    ]


@settings(max_examples=40, deadline=None, derandomize=True)
@given(seed=st.integers(0, 10_000), speed=st.floats(30.0, 400.0), course=st.floats(-3.1, 3.1))
def test_a_walking_receiver_sees_the_room_move_with_one_velocity(seed: int, speed: float, course: float) -> None:
    velocity = speed * np.array([np.cos(course), np.sin(course)])
    still = is_still(_estimate(seed, velocity, 12, np.array([150.0, -90.0])))
    assert still[:12].sum() >= 11 and not still[12:].any()


def test_numbers_of_paths_are_translated() -> None:
    still = still_paths([_estimate(2, np.zeros(2), 4, np.array([200.0])).take("path", [4, 0, 1, 2, 3])])
    stop = np.full(3, 3)
    every = still.of_all(stop, np.array([0, 1, 3]))
    assert every.tolist() == [1, 2, 4] and still.of_still(stop, every).tolist() == [0, 1, 3]
