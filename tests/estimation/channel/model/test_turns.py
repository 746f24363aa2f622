from dataclasses import replace

import numpy as np
import pytest

from estimation.channel.coherent.plan import nominal_manifold, search_plan
from estimation.channel.model.compress import compress
from estimation.channel.model.crb import crb
from estimation.channel.model.path_model import (
    PathParameters,
    gram_matrix,
    normal_equations,
    products_with,
    tangents,
)
from estimation.channel.model.turns import sweep_turns
from sim.config import WaveformConfig
from sim.observation import BeamClock
from sim.signal.waveform.occasions import beam_turns, sweep_occasions
from tests.estimation.channel.coherent.moving_sweeps import moving_sweep, scan_clock
from tests.estimation.channel.plain_sweeps import plain_link, plain_paths

LINK = plain_link()
STEP = 1e-6


@pytest.mark.parametrize("order", ["linear", "interleaved", "random"])
def test_every_order_is_a_permutation_and_times_are_sums(order: str) -> None:
    waveform = WaveformConfig(scan_order=order)
    time_s = sweep_occasions(waveform, 12, 7).time_s[0]
    assert np.allclose(np.sort(time_s.ravel()), waveform.prs.symbol_s * np.arange(84))
    assert np.allclose(time_s[1:] - time_s[:1], (time_s[1:] - time_s[:1])[:, :1])
    assert sorted(beam_turns(order, 12)) == list(range(12))


def test_interleaved_beams_next_to_each_other_are_apart_in_time() -> None:
    assert np.abs(np.diff(beam_turns("interleaved", 64))).min() >= 7


def test_slots_of_a_schedule_follow_the_order() -> None:
    schedule = {"period_slots": 32, "repetitions": 2}
    linear, random = (
        sweep_occasions(WaveformConfig.model_validate({"scan_order": order, "schedule": schedule}), 12, 5)
        for order in ("linear", "random")
    )
    turns = np.ix_(range(2), beam_turns("random", 12), beam_turns("random", 5))
    assert np.array_equal(random.time_s, linear.time_s[turns])


def _tangents_at(turns: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Samples (tangent, tx, rx, bin) of one path's response and its slope, their Gram, products with noise."""
    paths = plain_paths(LINK, [40.0], [10.0], [-20.0], [25.0])
    sweep = moving_sweep(LINK, paths, np.array([100.0]), scan_clock(LINK, "linear"), np.random.default_rng(1))
    clock = sweep_turns(sweep, 6.0)
    plan = search_plan(
        nominal_manifold(LINK.tx_codebook), nominal_manifold(LINK.rx_codebook), (1.0,) * 10, 2.0, clock
    )
    window = compress(sweep, plan.tx, plan.rx, clock).window(np.arange(8))
    one = PathParameters(np.array([3.3]), paths.aod_rad, paths.aoa_rad, np.ones(1, complex), np.array([[turns]]))
    at = tangents(window, one)
    tx, rx, delay = at.tx[0], at.rx[0], at.delay[0]
    slope = np.einsum("m,n,k->mnk", tx[-1], rx[0], delay[0]) + np.einsum("m,n,k->mnk", tx[0], rx[-1], delay[0])
    value = np.einsum("m,n,k->mnk", tx[0], rx[0], delay[0])
    matrix, _ = normal_equations(at, np.zeros(gram_matrix(at, at).shape[:2], complex), one.amplitude)
    gram = gram_matrix(at, at)[0, :, 0]
    assert np.allclose(matrix[0, 2:, 0, 2:], gram[1:, 1:].real)  # of unit amplitude
    return np.stack([value, slope]), gram, products_with(window.parts, at)[0]


def test_the_slope_over_turns_is_that_of_the_response() -> None:
    (value, slope), gram, _ = _tangents_at(0.7)
    (later, _), *_ = _tangents_at(0.7 + STEP)
    assert np.allclose((later - value) / STEP, slope, atol=1e-4 * np.abs(slope).max())
    assert np.isclose(gram[-1, -1], np.vdot(slope, slope)) and np.isclose(gram[0, -1], np.vdot(value, slope))


def test_a_frozen_path_has_no_slope() -> None:
    _, gram, product = _tangents_at(0.0)
    assert not gram[-1].any() and product[-1] == 0


def _bounds(order: str, **known: object) -> np.ndarray:
    paths = plain_paths(LINK, [30.0, 34.0], [5.0, 9.0], [10.0, 14.0], [25.0, 25.0], phase=[0.0, 1.0])
    clock = scan_clock(LINK, order)
    return crb(
        LINK.tx_codebook, LINK.rx_codebook, LINK.frequency_offset_hz, 1.0, delay_s=paths.delay_s,
        aod_rad=paths.aod_rad, aoa_rad=paths.aoa_rad, amplitude=paths.amplitude, clock=clock,
        doppler_hz=[150.0, -80.0], **known,
    ).std  # fmt: skip


def test_the_bound_of_doppler_is_the_inverse_information_of_the_samples() -> None:
    paths = plain_paths(LINK, [30.0], [5.0], [10.0], [25.0])
    clock = scan_clock(LINK, "random")

    def mean(place: np.ndarray) -> np.ndarray:
        moved = plain_paths(LINK, [place[0]], [place[1]], [place[2]], [25.0])
        moved = type(moved)(
            moved.delay_s, moved.aod_rad, moved.aoa_rad, place[4] * np.exp(1j * place[5]) * np.ones(1)
        )
        return moving_sweep(LINK, moved, place[3:4], clock, None, np.complex128)

    xi = paths.amplitude[0]
    place = np.array([30.0, 5.0, 10.0, 150.0, abs(xi), np.angle(xi)])
    step = np.array([1e-3, 1e-3, 1e-3, 1e-2, 1e-6, 1e-4])
    slopes = [(mean(place + s) - mean(place - s)) / (2 * s.sum()) for s in np.diag(step)]
    information = 2 * np.array([[np.vdot(a, b).real for b in slopes] for a in slopes])
    bounds = crb(
        LINK.tx_codebook, LINK.rx_codebook, LINK.frequency_offset_hz, 1.0, delay_s=paths.delay_s,
        aod_rad=paths.aod_rad, aoa_rad=paths.aoa_rad, amplitude=paths.amplitude, clock=clock, doppler_hz=150.0,
    )  # fmt: skip
    expected = np.sqrt(np.diag(np.linalg.inv(information)))[:4] * [1e-9, np.pi / 180, np.pi / 180, 1.0]
    assert np.allclose(bounds.std[0], expected, rtol=1e-3)
    assert bounds.doppler_std_hz[0] == bounds.std[0, 3]


def test_a_path_known_to_be_frozen_is_known_better() -> None:
    free, frozen = _bounds("linear"), _bounds("linear", is_frozen=[True, False])
    assert frozen[0, 3] == 0 and (frozen <= free * (1 + 1e-9)).all()


def test_scattered_scans_know_doppler_better_than_linear_ones() -> None:
    assert (_bounds("random")[:, 3] < _bounds("linear")[:, 3]).all()


def test_a_sweep_without_duration_has_no_turns() -> None:
    sweep = moving_sweep(LINK, plain_paths(LINK, [30.0], [5.0], [10.0], [25.0]), np.zeros(1), None, None)
    assert sweep_turns(sweep, 6.0) is None
    still = BeamClock(np.zeros(10), np.zeros(10))
    assert sweep_turns(replace(sweep, clock=still), 6.0) is None
    assert sweep_turns(replace(sweep, clock=scan_clock(LINK, "linear")), 6.0) is not None
