from dataclasses import replace

import numpy as np
import pytest

from estimation.channel.model.crb import crb
from estimation.slam.bounds import StopPaths, stop_bound
from isac_arena.campaign.config import CampaignConfig
from isac_arena.scoring.causes import Cause
from isac_arena.scoring.config import Significance
from isac_arena.scoring.link_view import Cells, link_view
from isac_arena.scoring.record import PathStatus
from isac_arena.scoring.stages.channel import score_stop
from isac_arena.scoring.stages.poses import pose_bounds
from isac_arena.scoring.true_stop import true_stop
from isac_arena.validation.scenarios.perfect_campaign import DIFFUSE
from scenes.pose import SPEED_OF_LIGHT_M_S
from sim.config import ArrayConfig, WaveformConfig
from sim.signal.generation import beam_channel
from sim.signal.hardware.config import ImpairmentsConfig
from sim.signal.link import best_beam_power_dbm, make_link

LIMITS = Significance(dynamic_range_db=60.0, noise_threshold_dbm=-300.0)
CONFIG = CampaignConfig(
    name="small",
    scene="made_up",
    waveform=WaveformConfig(comb=12),
    tx_array=ArrayConfig(rows=1, columns=8, beams_per_panel=12),
    rx_array=ArrayConfig(
        rows=1, columns=8, beams_per_panel=8, sector_deg=90.0, panel_azimuth_deg=[-180.0, -90.0, 0.0, 90.0]
    ),
)


@pytest.fixture(scope="module")
def view(campaign):
    return link_view(CONFIG, make_link(CONFIG), campaign.scene)


@pytest.fixture(scope="module")
def stop(campaign, view):
    truth = campaign.truths[4]
    power = best_beam_power_dbm(truth.paths, view.link, campaign.scene.tx, truth.rx_pose)
    return true_stop(truth, campaign.scene.tx, power, LIMITS, view)


def test_a_path_leaves_its_own_power_in_its_own_cell(stop, view):
    leaked = view.leaked_dbm(stop.truth, view.true_cells(stop.truth))
    np.testing.assert_allclose(np.diagonal(leaked), stop.power_dbm, atol=1e-9)


def test_leakage_is_what_a_matched_filter_sees_of_a_lone_path(stop, view):
    """Against samples of one path, windowed and summed over delay, beam pair by beam pair."""
    rng = np.random.default_rng(3)
    link, truth = view.link, stop.truth
    cells = Cells(
        rng.uniform(20e-9, 120e-9, 12), rng.integers(0, len(link.tx_codebook), 12),
        rng.integers(0, len(link.rx_codebook), 12),
    )  # fmt: skip
    leaked = view.leaked_dbm(truth, cells)
    for path in range(len(truth.paths)):
        samples = beam_channel(
            truth.paths.take("path", [path]),
            tx_codebook=link.tx_codebook,
            rx_codebook=link.rx_codebook,
            tx_pose=view.tx_pose,
            rx_pose=truth.rx_pose,
            frequency_offset_hz=link.frequency_offset_hz,
            clock_bias_s=truth.clock_bias_s,
        )
        wave = np.exp(2j * np.pi * cells.delay_s[:, None] * link.frequency_offset_hz) * view.window
        seen = (samples[cells.tx_beam, cells.rx_beam] * wave).sum(axis=1) / view.window.sum()
        level = np.abs(seen) ** 2 * link.tx_power_mw
        strongest = 10 ** (stop.power_dbm[path] / 10)
        np.testing.assert_allclose(10 ** (leaked[:, path] / 10), level, rtol=1e-3, atol=1e-9 * strongest)


def test_beams_have_no_loss_where_they_point_and_much_behind(campaign, view):
    truth = campaign.truths[4]
    book = view.link.tx_codebook
    best = int(np.abs(book.azimuth_rad).argmin())
    aimed = replace(
        truth.paths.take("path", [0, 0]),
        aod_azimuth_rad=view.tx_pose.heading_rad + book.azimuth_rad[best] + np.array([0, np.pi]),
        aoa_azimuth_rad=np.full(2, truth.rx_pose.heading_rad + view.link.rx_codebook.azimuth_rad[3]),
    )
    loss = view.beam_loss_db(replace(truth, paths=aimed))
    assert loss[0] < 1.5
    assert loss[1] > 10


def test_bounds_are_those_of_the_channel_estimator(stop, view, campaign):
    link, tables = view.link, score_stop(stop, campaign.results.channel[4])
    known = stop.parameters[stop.significant]
    direct = crb(
        link.tx_codebook, link.rx_codebook, link.frequency_offset_hz, link.noise_power_mw,
        delay_s=known[:, 0] - stop.truth.clock_bias_s, aod_rad=known[:, 1], aoa_rad=known[:, 2],
        amplitude=np.sqrt(link.tx_power_mw) * stop.truth.paths.gain[stop.significant],
    )  # fmt: skip
    np.testing.assert_allclose(tables[1].delay_bound_s, direct.delay_std_s, rtol=1e-6)
    np.testing.assert_allclose(tables[1].aod_bound_rad, direct.aod_std_rad[:, 0], rtol=1e-6)
    np.testing.assert_allclose(tables[1].aoa_bound_rad, direct.aoa_std_rad[:, 0], rtol=1e-6)


def test_a_lost_phase_raises_the_bounds(campaign, view, stop):
    config = CONFIG.model_copy(update={"impairments": ImpairmentsConfig(cfo_hz=200.0)})
    lost = link_view(config, view.link, campaign.scene)
    other = true_stop(stop.truth, campaign.scene.tx, stop.power_dbm, LIMITS, lost)
    assert (
        np.diagonal(other.covariance, axis1=1, axis2=2) >= np.diagonal(stop.covariance, axis1=1, axis2=2)
    ).all()


def test_the_pose_bound_is_that_of_line_of_sight_and_single_bounces(stop, campaign):
    truth = stop.truth
    scale = np.array([SPEED_OF_LIGHT_M_S, 1, 1])
    covariance = stop.covariance * np.outer(scale, scale)
    bias_m = truth.clock_bias_s * SPEED_OF_LIGHT_M_S
    direct, _ = stop_bound(
        campaign.scene.tx,
        np.array([*truth.rx_pose.position_m[:2], truth.rx_pose.heading_rad, bias_m]),
        StopPaths(stop.origin.vertex_m[1:5], covariance[1:5], np.full(4, -1), covariance[0]),
    )
    found = pose_bounds(campaign.scene, [[stop]])
    assert found.position_m == pytest.approx([float(direct.position_m)])
    assert found.heading_rad == pytest.approx([float(direct.heading_rad)])
    fewer = replace(stop, significant=stop.significant[:2], covariance=stop.covariance[:2])
    assert pose_bounds(campaign.scene, [[fewer]]).position_m[0] > found.position_m[0]
    assert np.isnan(pose_bounds(campaign.scene, [[replace(stop, view=None)]]).position_m).all()


def test_an_estimate_in_a_side_lobe_is_named(stop, view, campaign):
    """A made estimate where the line of sight leaks most beyond its gate, as strong as the leak."""
    estimate = campaign.results.channel[4]
    aoa = np.deg2rad(np.arange(-180, 180, 1.0))
    probe = replace(
        estimate.take("path", np.zeros(len(aoa), int)), aoa_azimuth_rad=aoa, is_los=np.zeros(len(aoa), bool)
    )
    leaked = view.leaked_dbm(stop.truth, view.estimated_cells(probe))[:, 0]
    far = np.abs(np.angle(np.exp(1j * (aoa - estimate.aoa_azimuth_rad[0])))) > np.deg2rad(25)
    worst = int(np.where(far, leaked, -np.inf).argmax())
    made = replace(probe.take("path", [worst]), power_dbm=leaked[[worst]])
    paths, _, _ = score_stop(stop, made)
    assert paths.cause.tolist() == [Cause.SIDE_LOBE]
    loud = replace(made, power_dbm=leaked[[worst]] + 20)
    assert score_stop(stop, loud)[0].cause.tolist() == [Cause.UNKNOWN]


@pytest.mark.parametrize(("sign", "status"), [(1, PathStatus.WEAK), (-1, PathStatus.FALSE)])
def test_diffuse_paths_that_add_up_in_a_cell_explain_an_estimate(campaign, view, sign, status):
    """Nine equal ones in phase are 19 dB above one, in power 9.5 dB; of alternating signs they leave one."""
    truth = campaign.truths[4]
    rows = [0, *[DIFFUSE] * 9]
    rays = truth.paths.take("path", rows)
    rays = replace(rays, gain=rays.gain * np.array([1.0, *(float(sign) ** n for n in range(9))]))
    power = best_beam_power_dbm(rays, view.link, campaign.scene.tx, truth.rx_pose)
    stop = true_stop(replace(truth, paths=rays), campaign.scene.tx, power, LIMITS, view)
    assert stop.significant.tolist() == [0]
    estimate = replace(
        campaign.results.channel[4].take("path", [0, 1]),
        delay_s=stop.parameters[:2, 0],
        aod_azimuth_rad=stop.parameters[:2, 1],
        aoa_azimuth_rad=stop.parameters[:2, 2],
        power_dbm=power[:2] + np.array([0.0, 19.0]),
    )
    paths, _, _ = score_stop(stop, estimate)
    assert paths.status.tolist() == [PathStatus.DETECTED, status]
    assert (paths.true_path[1] >= 1) == (status == PathStatus.WEAK)


def test_a_flat_array_is_not_asked_for_front_or_back(campaign, view, stop):
    """An estimate is scored alike where the true departure or the estimated one is mirrored at the TX panel."""
    estimate = campaign.results.channel[4]
    tx_heading_rad = campaign.scene.tx.heading_rad
    paths = stop.truth.paths
    behind = replace(
        stop.truth, paths=replace(paths, aod_azimuth_rad=2 * tx_heading_rad + np.pi - paths.aod_azimuth_rad)
    )
    mirrored = true_stop(behind, campaign.scene.tx, stop.power_dbm, LIMITS, view)
    as_it_is, from_behind = score_stop(stop, estimate)[0], score_stop(mirrored, estimate)[0]
    assert (as_it_is.status == PathStatus.DETECTED).all()
    assert (from_behind.status == PathStatus.DETECTED).all()
    np.testing.assert_allclose(from_behind.aod_error_rad, as_it_is.aod_error_rad, atol=1e-9)
    guessed = replace(estimate, aod_azimuth_rad=np.pi - estimate.aod_azimuth_rad)
    np.testing.assert_allclose(score_stop(mirrored, guessed)[0].nees, as_it_is.nees, atol=1e-6)
