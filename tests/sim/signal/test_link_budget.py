"""The link, its symbols per beam pair, and the budget by hand."""

from dataclasses import replace

import numpy as np
import pytest
from pydantic import ValidationError

from isac_arena.validation.scenarios.paths import free_space
from scenes.pose import SPEED_OF_LIGHT_M_S, Pose
from sim.config import ArrayConfig, LinkConfig, SimulationConfig, WaveformConfig
from sim.propagation.paths import BounceKind, Paths, empty_paths
from sim.signal.arrays.array import upa_positions_m
from sim.signal.arrays.codebook import steered_codebook
from sim.signal.link import Link, make_link
from sim.signal.link_budget import converter_noise_dbm, converter_share, link_budget, peak_gain_dbi, side_lobe_db
from sim.signal.waveform.config import ScheduleConfig
from sim.signal.waveform.occasions import measurements_per_sample
from sim.signal.waveform.prs import prs_comb_pass
from sim.truth import Truth

TX = Pose(np.array([0.0, 0.0, 1.5]), 0.0)
RX = Pose(np.array([5.0, 0.0, 1.5]), -np.pi)
BOTH = ArrayConfig(beams_per_panel=33)  # an odd number: one beam looks along the boresight


@pytest.fixture(scope="module")
def link() -> Link:
    return make_link(SimulationConfig(scene="none", tx_array=BOTH, rx_array=BOTH))


def bounced(paths: Paths) -> Paths:
    return replace(paths, gain=paths.gain / 10, bounce_kind=np.full((1, 1), BounceKind.SPECULAR))


def test_budget_of_a_line_of_sight_by_hand(link: Link) -> None:
    los = Truth(free_space(TX, RX), RX, 0, 0.0)
    budget = link_budget([los], link, TX, LinkConfig(), converter_share(WaveformConfig()))
    loss_db = 20 * np.log10(4 * np.pi * 5 * 60e9 / SPEED_OF_LIGHT_M_S)
    array_db = 10 * np.log10(64) + 8
    assert budget.eirp_dbm == pytest.approx(3 + array_db)
    assert budget.los_dbm[0] == pytest.approx(3 + 2 * array_db - loss_db)
    thermal_dbm = 10 * np.log10(1.380649e-23 * 290 * 1584 * 120e3 * 1e3) + 10
    assert budget.thermal_noise_dbm == pytest.approx(thermal_dbm)
    assert budget.processed_snr_db[0] == pytest.approx(budget.los_dbm[0] - thermal_dbm + 10 * np.log10(1584))
    assert budget.cross_db[0] == pytest.approx(-13.3, abs=0.5)
    assert budget.off_cross_db[0] == pytest.approx(2 * budget.cross_db[0])


def test_the_converter_floor_is_set_once_for_the_strongest_stop(link: Link) -> None:
    far = Pose(np.array([50.0, 0.0, 1.5]), -np.pi)
    settings, share = LinkConfig(adc_effective_bits=6, adc_back_off_db=12), converter_share(WaveformConfig())
    near_stop, far_stop = Truth(free_space(TX, RX), RX, 0, 0.0), Truth(free_space(TX, far), far, 1, 0.0)
    both = link_budget([far_stop, near_stop], link, TX, settings, share)
    expected = both.los_dbm[1] - (20 * np.log10(64) + 1.76 - 12) + 10 * np.log10(1584 / 4096)
    assert both.converter_noise_dbm == pytest.approx(expected)
    np.testing.assert_allclose(np.diff(both.dynamic_range_db), 20)
    one_bit = LinkConfig(adc_effective_bits=7)
    assert both.converter_noise_dbm - converter_noise_dbm(both.los_dbm[1], one_bit, share) == pytest.approx(
        20 * np.log10(2)
    )


def test_averaging_lowers_both_noises_alike() -> None:
    plain = WaveformConfig(n_rb=24)
    four = WaveformConfig(
        n_rb=24, n_symbols=4, combine_symbols=True, schedule=ScheduleConfig(repetitions=2, muting_2=[1, 1])
    )
    noise_mw = [
        make_link(SimulationConfig(scene="none", waveform=wave)).noise_power_mw[0] for wave in (plain, four)
    ]
    assert measurements_per_sample(plain) == 1 and measurements_per_sample(four) == 4
    assert noise_mw[0] / noise_mw[1] == pytest.approx(4)
    assert converter_share(plain) / converter_share(four) == pytest.approx(4)


def test_thermal_noise_takes_over_with_ideal_converters(link: Link) -> None:
    truth = Truth(free_space(TX, RX), RX, 0, 0.0)
    budget = link_budget([truth], link, TX, LinkConfig(adc_effective_bits=24), 1.0)
    assert budget.weakest_dbm == pytest.approx(budget.thermal_noise_dbm + 3, abs=1e-3)


def test_blocked_and_silent_stops_are_valid(link: Link) -> None:
    blocked = Truth(bounced(free_space(TX, RX)), RX, 4, 0.0)
    silent = Truth(empty_paths(["wall"]), RX, 5, 0.0)
    budget = link_budget([blocked, silent], link, TX, LinkConfig(), 1.0)
    assert np.isnan(budget.los_dbm).all() and np.isnan(budget.dynamic_range_db).all()
    assert np.isfinite(budget.single_bounce_dbm[0]) and np.isnan(budget.single_bounce_dbm[1])
    assert budget.stop.tolist() == [4, 5]
    nothing = link_budget([silent], link, TX, LinkConfig(), 1.0)
    assert nothing.converter_noise_dbm == -np.inf
    assert nothing.weakest_dbm == pytest.approx(nothing.thermal_noise_dbm + 3)


def test_side_lobe_of_a_uniform_row() -> None:
    row = upa_positions_m(1, 16, 60e9)
    codebook = steered_codebook(row, 60e9, panel_azimuth_rad=[0.0], beams_per_panel=801, sector_rad=3.0)
    assert side_lobe_db(codebook, 0.0, 0.0) == pytest.approx(-13.15, abs=0.02)
    assert peak_gain_dbi(codebook) == pytest.approx(10 * np.log10(16) + 8)
    single = steered_codebook(row, 60e9, panel_azimuth_rad=[0.0], beams_per_panel=1, sector_rad=1.0)
    assert side_lobe_db(single, 0.0, 0.0) == -np.inf


@pytest.mark.parametrize(("comb", "length"), [(4, 4), (2, 12)])
def test_combined_symbols_fill_the_band_and_average_the_noise(comb: int, length: int) -> None:
    wave = WaveformConfig(n_rb=24, comb=comb, n_symbols=length, combine_symbols=True)  # type: ignore[arg-type]
    single = wave.model_copy(update={"combine_symbols": False})
    link, one = (make_link(SimulationConfig(scene="none", waveform=w)) for w in (wave, single))
    assert link.prs_symbol.shape == (32, 288) and one.prs_symbol.shape == (32, 288 // comb)
    np.testing.assert_allclose(np.diff(link.frequency_offset_hz), 120e3)
    np.testing.assert_allclose(link.noise_power_mw, one.noise_power_mw * comb / length)
    np.testing.assert_allclose(link.prs_symbol[5], prs_comb_pass(wave.prs, 5, 5), atol=1e-7)
    np.testing.assert_array_equal(link.prs_symbol[:, ::comb], one.prs_symbol)


def test_bad_settings_name_the_rule() -> None:
    with pytest.raises(ValidationError, match=r"n_symbols = 2: allowed is 4, 12 with comb 4"):
        WaveformConfig(comb=4, n_symbols=2)
    with pytest.raises(ValidationError, match=r"rb_offset \+ n_rb = 268: allowed is up to carrier_rb = 264"):
        WaveformConfig(rb_offset=4, carrier_rb=264)
    with pytest.raises(ValidationError, match=r"noise_figure_db\n.*greater than or equal to 0"):
        LinkConfig(noise_figure_db=-1.0)
