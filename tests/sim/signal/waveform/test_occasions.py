"""Repetition and muting in a campaign: slots, air time, noise and what the oscillator does to the combination."""

import numpy as np
import pytest

from isac_arena.validation.scenarios.paths import made_paths
from scenes.config import load_scene, scene_path
from scenes.pose import Pose
from sim.config import ArrayConfig, SimulationConfig, WaveformConfig
from sim.observation import BeamSweep
from sim.propagation.paths import Paths, empty_paths
from sim.signal.hardware.config import ImpairmentsConfig
from sim.signal.link import make_link, pilots
from sim.signal.waveform.config import ScheduleConfig
from sim.signal.waveform.occasions import resource_offsets, slot_of_beam, sweep_occasions
from sim.signal.waveform.schedule import is_sent
from sim.simulate import observe
from sim.truth import Truth

FEW = ArrayConfig(rows=1, columns=4, beams_per_panel=5)
FOUR = ScheduleConfig(repetitions=4, gap_slots=2)
MUTED = ScheduleConfig(repetitions=4, muting_2=[1, 0, 1, 1], muting_1=[0, 1])
LINE_OF_SIGHT = made_paths(1e-3, 20e-9, (0.1, 0.0), (0.1, 0.0))


def campaign(schedule: ScheduleConfig | None, **impairments: float) -> SimulationConfig:
    return SimulationConfig(
        scene="box_room",
        waveform=WaveformConfig(n_rb=24, comb=12, schedule=schedule),
        tx_array=FEW,
        rx_array=FEW,
        impairments=ImpairmentsConfig(**impairments),  # type: ignore[arg-type]
    )


def sweep(config: SimulationConfig, paths: Paths, stop: int = 0) -> BeamSweep:
    scene = load_scene(scene_path("box_room"), 60e9)
    pose = Pose(scene.tx.position_m, 0.0)
    return observe(config, make_link(config), scene, Truth(paths, pose, stop, 0.0))


def test_without_a_schedule_one_symbol_follows_the_other() -> None:
    occasions = sweep_occasions(WaveformConfig(), 3, 4)
    symbol_s = (1 + 144 / 2048) / 120e3
    assert occasions.repetitions == 1
    np.testing.assert_allclose(occasions.time_s.ravel(), symbol_s * np.arange(12))
    assert occasions.air_time_s == pytest.approx(12 * symbol_s)
    combined = sweep_occasions(WaveformConfig(comb=4, n_symbols=12, combine_symbols=True), 3, 4)
    np.testing.assert_allclose(combined.time_s, 12 * occasions.time_s)
    extended = sweep_occasions(WaveformConfig(numerology=2, cyclic_prefix="extended"), 3, 4)
    assert extended.air_time_s == pytest.approx(12 * 1.25 / 60e3)


@pytest.mark.parametrize("gap_slots", [1, 2, 8, 32])
@pytest.mark.parametrize("repetitions", [1, 4, 6])
def test_every_occasion_has_a_slot_of_its_own_that_the_standard_sends(gap_slots: int, repetitions: int) -> None:
    schedule = ScheduleConfig(
        period_slots=256, offset_slots=7, repetitions=repetitions, gap_slots=gap_slots,
        muting_1=[1, 0, 0, 1], muting_bit_repetition=2,
    )  # fmt: skip
    waveform = WaveformConfig(schedule=schedule)
    occasions = sweep_occasions(waveform, 12, 6)
    slot = np.rint(occasions.time_s * 8e3).astype(int) + 7
    assert occasions.time_s.shape == (repetitions, 12, 6) and len(np.unique(slot)) == slot.size
    for beam, offset in enumerate(resource_offsets(schedule, 12)):
        assert is_sent(schedule.of_resource(3, int(offset)), slot[:, beam]).all()
        assert slot_of_beam(waveform, 12, beam) == slot[0, beam, 0] % 80 == occasions.slot[0, beam]
    # Six instances, of which two of every eight periods are followed by four that are muted
    assert occasions.air_time_s == pytest.approx((slot.max() - slot.min() + 1) / 8e3)
    assert (slot.max() // 256, slot.min() // 256) == (9, 0)


def test_repetitions_and_muting_cost_air_time() -> None:
    def air_time_s(schedule: ScheduleConfig) -> float:
        return sweep_occasions(WaveformConfig(schedule=schedule), 32, 10).air_time_s

    one = ScheduleConfig(period_slots=32)
    four = ScheduleConfig(period_slots=128, repetitions=4)
    assert air_time_s(one) == pytest.approx(10 * 32 / 8e3)
    assert air_time_s(four) == pytest.approx(4 * air_time_s(one))
    half = four.model_copy(update={"muting_1": [0, 1]})
    assert air_time_s(half) == pytest.approx(19 * 128 / 8e3)


@pytest.mark.parametrize(("schedule", "combined"), [(None, 1), (FOUR, 4), (MUTED, 3)])
def test_noise_falls_by_the_repetitions_that_are_sent(schedule: ScheduleConfig | None, combined: int) -> None:
    alone, config = campaign(None), campaign(schedule)
    expected_mw = make_link(alone).noise_power_mw / combined
    np.testing.assert_allclose(make_link(config).noise_power_mw, expected_mw)
    silent = [sweep(config, empty_paths(["wall"]), stop) for stop in range(40)]
    np.testing.assert_allclose(silent[0].noise_power_mw, expected_mw)
    measured_mw = np.mean([np.abs(one.samples) ** 2 for one in silent], axis=(0, 1, 3))
    np.testing.assert_allclose(measured_mw, expected_mw, rtol=5 / np.sqrt(40 * 5 * 24))


def test_the_signal_stays_as_it_is() -> None:
    config = campaign(FOUR)
    found, plain = sweep(config, LINE_OF_SIGHT), sweep(campaign(None), LINE_OF_SIGHT)
    channel = found.samples * found.prs_symbol.conj()[:, None]
    expected = plain.samples * plain.prs_symbol.conj()[:, None]
    noise = np.sqrt(found.noise_power_mw[0] + plain.noise_power_mw[0])
    assert np.abs(channel - expected).max() < 5 * noise < 0.05 * np.abs(expected).max()
    first = sweep_occasions(config.waveform, 5, 5).slot[0]
    np.testing.assert_array_equal(found.prs_symbol, pilots(config.waveform, first).astype(np.complex64))


def test_a_carrier_offset_turns_the_repetitions_against_each_other() -> None:
    """Four occasions two slots apart add up to the Dirichlet kernel of their phase step."""
    step_rad = 2 * np.pi * 900.0 * 2 * 125e-6
    found = sweep(campaign(FOUR, cfo_hz=900.0), LINE_OF_SIGHT).samples
    plain = sweep(campaign(FOUR), LINE_OF_SIGHT).samples
    best = np.unravel_index(np.argmax(np.linalg.norm(plain, axis=2)), (5, 5))
    loss = np.abs(np.vdot(plain[best], found[best])) / np.linalg.norm(plain[best]) ** 2
    expected = np.sin(2 * step_rad) / (4 * np.sin(step_rad / 2))
    assert loss == pytest.approx(abs(expected), rel=0.01)


def test_repetitions_of_impaired_hardware_repeat_bit_by_bit() -> None:
    config = campaign(MUTED, phase_noise_pair_deg=5.0, iq_gain_db=1.0, adc_bits=6, clock_drift_ppm=1.0)
    one, two = (sweep(config, LINE_OF_SIGHT).samples for _ in range(2))
    np.testing.assert_array_equal(one, two)


def test_an_image_averages_down_over_slots_with_other_pilots() -> None:
    """IQ imbalance mirrors subcarriers with their pilots, which differ from slot to slot."""
    many = ScheduleConfig(period_slots=256, repetitions=32)
    images = []
    for schedule in (None, many):
        paths = made_paths(10.0, 20e-9, (0.1, 0.0), (0.1, 0.0))
        clean, mixed = (sweep(campaign(schedule, **iq), paths).samples for iq in ({}, {"iq_gain_db": 2.0}))
        gain = np.vdot(clean, mixed) / np.vdot(clean, clean)
        images.append(np.linalg.norm(mixed - gain * clean) / np.linalg.norm(clean))
    assert images[0] > 0.1
    assert images[1] == pytest.approx(images[0] / np.sqrt(32), rel=0.3)


def test_beams_have_to_fit_into_the_period() -> None:
    short = WaveformConfig(schedule=ScheduleConfig(period_slots=32, repetitions=2))
    with pytest.raises(ValueError, match=r"period_slots = 32: 32 TX beams .* take 64 slots, allowed are 32"):
        make_link(SimulationConfig(scene="none", waveform=short))
    with pytest.raises(ValueError, match="offsets up to 511"):
        resource_offsets(ScheduleConfig(period_slots=1280, repetitions=16), 40)
    with pytest.raises(ValueError, match="tx_beam = 3: allowed is 0 to 2"):
        slot_of_beam(WaveformConfig(), 3, 3)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"period_slots": 6}, r"schedule.period_slots = 6: allowed is 2\^mu"),
        ({"repetitions": 3}, "schedule.repetitions = 3: allowed is 1, 2, 4"),
        ({"repetitions": 2, "muting_2": [1]}, r"schedule.muting_2 = \(1,\): allowed is one bit per repetition"),
        ({"muting_1": [0, 0]}, "leave nothing that is sent"),
    ],
)
def test_bad_schedules_name_field_and_rule(values: dict[str, object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        WaveformConfig(schedule=ScheduleConfig(**values))  # type: ignore[arg-type]
