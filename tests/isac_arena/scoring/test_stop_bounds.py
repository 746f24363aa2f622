"""Bounds in the angles that an estimate reports, diffuse power as noise, and paths that nobody can part."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from estimation.channel.record import AngleKind
from isac_arena.scoring.causes import Cause
from isac_arena.scoring.config import DEFAULT_SEPARABILITY, Significance
from isac_arena.scoring.link_view import link_view
from isac_arena.scoring.record import PathStatus
from isac_arena.scoring.stages.channel import score_stop
from isac_arena.scoring.stages.channel_metrics import channel_metrics
from isac_arena.scoring.stop_bounds import CONES, band_products, diffuse_scores, stop_information
from isac_arena.scoring.true_stop import seen_by, true_stop
from isac_arena.validation.scenarios.estimates import shift_estimate
from isac_arena.validation.scenarios.perfect_campaign import DIFFUSE, SMALL_LINK
from scenes.record import concatenate
from sim.signal.hardware.config import ImpairmentsConfig
from sim.signal.link import best_beam_power_dbm, make_link

LIMITS = Significance(dynamic_range_db=60.0, noise_threshold_dbm=-300.0)
AZIMUTHS = (AngleKind.AZIMUTH, AngleKind.AZIMUTH)
RAISED = {  # arrays with beams at two elevations
    f"{device}_array": getattr(SMALL_LINK, f"{device}_array").model_copy(
        update={"rows": 4, "beam_elevation_deg": [-12.0, 12.0]}
    )
    for device in ("tx", "rx")
}


@pytest.fixture(scope="module", params=["horizontal", "two elevations"])
def view(request, campaign):
    config = SMALL_LINK if request.param == "horizontal" else SMALL_LINK.model_copy(update=RAISED)
    return link_view(config, make_link(config), campaign.scene)


@pytest.fixture(scope="module")
def level_view(campaign):
    return link_view(SMALL_LINK, make_link(SMALL_LINK), campaign.scene)


def stop_of(truth, scene, view, paths=None):
    truth = truth if paths is None else replace(truth, paths=paths)
    power = best_beam_power_dbm(truth.paths, view.link, scene.tx, truth.rx_pose)
    return true_stop(truth, scene.tx, power, LIMITS, view)


def raised(paths, elevation_rad):
    """The paths with an elevation at both ends."""
    level = np.full(len(paths), elevation_rad)
    return replace(paths, aod_elevation_rad=level, aoa_elevation_rad=-level)


def with_energy(view, truth, energy):
    """The line of sight alone, with an energy over the noise, summed over all samples."""
    path = truth.paths.take("path", [0])
    information = stop_information(view, replace(truth, paths=path), np.array([0]))
    found = information.coherent[0, -1, 0, -1] / 2  # the information of arg xi is twice the energy
    return replace(path, gain=path.gain * np.sqrt(energy / found))


def as_cones(stop, estimate):
    """An estimate with the cone angles of the stop's significant paths, the bounds its covariances."""
    seen = seen_by(stop, replace(estimate, aod_angle_kind=AngleKind.CONE, aoa_angle_kind=AngleKind.CONE))
    places = seen.parameters[stop.significant]
    return replace(
        estimate,
        delay_s=places[:, 0],
        aod_azimuth_rad=places[:, 1],
        aoa_azimuth_rad=places[:, 2],
        covariance=seen.covariance,
        aod_angle_kind=AngleKind.CONE,
        aoa_angle_kind=AngleKind.CONE,
    )


def test_at_elevation_zero_a_cone_is_an_azimuth(campaign, view):
    stop = stop_of(campaign.truths[4], campaign.scene, view)
    np.testing.assert_allclose(stop.cone_rad, stop.parameters[:, 1:], atol=1e-9)
    joint = stop.bounds.joint
    np.testing.assert_allclose(stop.bounds.std(joint, CONES), stop.bounds.std(joint, AZIMUTHS), rtol=1e-6)


@given(azimuth=st.floats(-0.6, 0.6), elevation=st.floats(-0.7, 0.7))
def test_a_cone_and_its_slopes_are_those_of_the_definition(campaign, level_view, azimuth, elevation):
    """sin(cone) = sin(azimuth) cos(elevation) about the panel, which is the TX heading here."""
    truth = campaign.truths[4]

    def seen(azimuth, elevation):
        path = truth.paths.take("path", [0])
        turned = replace(
            path,
            aod_azimuth_rad=level_view.tx_pose.heading_rad + np.array([azimuth]),
            aod_elevation_rad=np.array([elevation]),
        )
        return level_view.cones(replace(truth, paths=turned))[0]

    found, step = seen(azimuth, elevation), 1e-6
    assert found.angle_rad[0] == pytest.approx(np.arcsin(np.sin(azimuth) * np.cos(elevation)), abs=1e-12)
    for column, shift in enumerate(((step, 0), (0, step))):
        ends = [seen(azimuth + s * shift[0], elevation + s * shift[1]).angle_rad[0] for s in (1, -1)]
        assert found.slope[0, column] == pytest.approx((ends[0] - ends[1]) / (2 * step), abs=1e-6)


def test_the_bound_of_an_azimuth_is_that_of_its_cone_over_the_slope(campaign, level_view):
    truth = campaign.truths[4]
    stop = stop_of(truth, campaign.scene, level_view, raised(truth.paths, 0.5))
    cone, azimuth = (stop.bounds.std(stop.bounds.joint, kinds) for kinds in (CONES, AZIMUTHS))
    tx, rx = stop.bounds.cones
    np.testing.assert_allclose(azimuth[:, 1] * tx.slope[:, 0], cone[:, 1])
    np.testing.assert_allclose(np.abs(azimuth[:, 2] * rx.slope[:, 0]), cone[:, 2])
    np.testing.assert_array_equal(azimuth[:, 0], cone[:, 0])


def test_paths_from_above_score_by_their_cones(campaign, view):
    """Errors drawn from the bound of the cones: NEES over its dimension is 1; as azimuths they are far off."""
    truth, rng = campaign.truths[4], np.random.default_rng(5)
    stop = stop_of(truth, campaign.scene, view, raised(truth.paths, 0.25))
    exact = as_cones(stop, campaign.results.channel[4].take("path", np.arange(len(stop.significant))))
    nees = []
    for _ in range(60):
        errors = [rng.multivariate_normal(np.zeros(3), one) for one in exact.covariance]
        paths, significant, _ = score_stop(stop, shift_estimate(exact, errors))
        assert (paths.status == PathStatus.DETECTED).all() and significant.is_detected.all()
        nees.append(paths.nees / 3)
    n = 60 * len(exact)
    assert np.mean(nees) == pytest.approx(1, abs=4 * np.sqrt(2 / 3 / n))
    wrong = replace(exact, aod_angle_kind=AngleKind.AZIMUTH, aoa_angle_kind=AngleKind.AZIMUTH)
    assert np.nanmax(score_stop(stop, wrong)[0].nees) > 100


def test_a_pointing_offset_of_the_tx_is_no_error_of_the_channel(campaign):
    """The estimator reports departures in the frame of the TX as it stands; SLAM carries the offset."""
    config = SMALL_LINK.model_copy(update={"impairments": ImpairmentsConfig(tx_pointing_offset_deg=1.0)})
    turned = link_view(config, make_link(config), campaign.scene)
    stop = stop_of(campaign.truths[4], campaign.scene, turned)
    estimate = campaign.results.channel[4]
    offset = [[0.0, -np.deg2rad(1.0), 0.0]] * len(estimate)
    paths, _, _ = score_stop(stop, shift_estimate(estimate, offset))
    np.testing.assert_allclose(paths.aod_error_rad, 0, atol=1e-9)


def test_diffuse_scores_are_in_the_information_of_all_paths(campaign, view):
    """Beside its log-magnitude and phase, the information of a diffuse path holds 2 Re and -2 Im of J^H a."""
    truth = campaign.truths[4]
    truth = replace(truth, paths=raised(truth.paths, 0.1) if view.tx.n_angles == 2 else truth.paths)
    rows, n = np.flatnonzero(~truth.paths.is_diffuse), int((~truth.paths.is_diffuse).sum())
    every = view.information(truth, coherent=True)
    assert truth.paths.is_diffuse[n:].all()
    direct = (every[:n, :, n:, -2] - 1j * every[:n, :, n:, -1]).reshape(-1, len(truth.paths) - n) / 2
    found = diffuse_scores(view, truth, rows)
    np.testing.assert_allclose(found, direct, atol=1e-9 * np.abs(direct).max())


def test_diffuse_power_in_the_very_place_of_a_path_moves_its_gain_alone(campaign, level_view):
    truth = campaign.truths[4]
    line, paths = truth.paths.take("path", [0, 0]), truth.paths.take("path", [0, DIFFUSE])
    assert paths.is_diffuse.tolist() == [False, True]
    same = ("delay_s", "aod_azimuth_rad", "aod_elevation_rad", "aoa_azimuth_rad", "aoa_elevation_rad")
    paths = replace(paths, **{name: getattr(line, name) for name in same}, gain=line.gain * [1.0, 0.5])
    stop = stop_of(truth, campaign.scene, level_view, paths)
    bounds = stop.bounds
    np.testing.assert_allclose(bounds.scattered_std(CONES), bounds.std(bounds.joint, CONES), rtol=1e-3)
    aside = replace(paths, delay_s=paths.delay_s + np.array([0.0, 1e-9]))
    beside = stop_of(truth, campaign.scene, level_view, aside).bounds
    assert beside.scattered_std(CONES)[0, 0] > 10 * beside.std(beside.joint, CONES)[0, 0]


@pytest.mark.parametrize(("cells", "n_separable"), [(0.003, 1), (2.0, 2)])
def test_two_paths_in_one_cell_count_as_one(campaign, level_view, cells, n_separable):
    """Beside a path of 40 dB, missing the weaker one is no miss where nobody could tell the two apart."""
    truth = campaign.truths[4]
    paths = with_energy(level_view, truth, 1e4).take("path", [0, 0])
    apart_s = cells * level_view.resolution_cell[0]
    paths = replace(paths, delay_s=paths.delay_s + np.array([0.0, apart_s]), gain=paths.gain * [1.0, 0.7j])
    stop = stop_of(truth, campaign.scene, level_view, paths)
    assert stop.is_separable.tolist() == [True, n_separable == 2]
    only = campaign.results.channel[4].take("path", [0])
    scored = score_stop(stop, only)
    values = {metric.key: metric.value for metric in channel_metrics(scored[2], scored[0], scored[1])}
    assert values["channel.inseparable_per_stop"] == 2 - n_separable
    assert values["channel.missed_per_stop"] == n_separable - 1
    assert values["channel.inseparable_undetected_per_stop"] == 2 - n_separable
    assert values["channel.detected_per_stop"] == 1  # the three are the two significant ones
    assert values["channel.detection_rate"] == 1 / n_separable
    assert (scored[1].cause[1] == Cause.INSEPARABLE) == (n_separable == 1)
    assert values["channel.gospa.missed_mean"] == pytest.approx(0 if n_separable == 1 else np.sqrt(0.5), abs=1e-9)


def test_a_lone_path_is_separable_above_the_snr_of_detection(campaign, level_view):
    """Its share of a delay cell is sqrt(3) / (pi sqrt(2 SNR)) with the SNR over all samples."""
    truth = campaign.truths[4]
    limit = 3 / (2 * np.pi**2 * DEFAULT_SEPARABILITY.share_of_cell**2)
    assert limit == pytest.approx(34, rel=0.01)
    stop = stop_of(truth, campaign.scene, level_view, with_energy(level_view, truth, limit))
    found = stop.bounds.std(stop.bounds.joint, CONES)[0, 0] / level_view.resolution_cell[0]
    assert found == pytest.approx(DEFAULT_SEPARABILITY.share_of_cell, rel=0.02)
    for energy, expected in ((limit / 4, False), (limit * 10, True)):  # angles: the beams are no uniform aperture
        quiet = with_energy(level_view, truth, energy)
        assert stop_of(truth, campaign.scene, level_view, quiet).is_separable.tolist() == [expected]


def test_the_joint_bound_grows_beside_a_neighbour_and_the_lone_one_does_not(campaign, level_view):
    truth = campaign.truths[4]
    paths = truth.paths.take("path", [0])
    lone = stop_of(truth, campaign.scene, level_view, paths)
    other = replace(paths, delay_s=paths.delay_s + 0.4 * level_view.resolution_cell[0], gain=1j * paths.gain)
    pair = stop_of(truth, campaign.scene, level_view, concatenate([paths, other], "path"))
    np.testing.assert_allclose(
        np.diagonal(pair.bounds.alone[0]), np.diagonal(lone.bounds.joint[0]), rtol=1e-9, atol=0
    )
    assert pair.bounds.joint[0, 0, 0] > 2 * lone.bounds.joint[0, 0, 0]


@pytest.mark.parametrize("n_subcarriers", [1, 2, 792])
def test_sums_over_the_band_and_their_slopes(n_subcarriers):
    frequency_hz = -1.9e8 + 480e3 * np.arange(n_subcarriers)
    apart_s = np.array([[0.0, 1e-13, -2e-12], [3e-9, -4e-8, 1e-6]])
    turn = np.exp(2j * np.pi * apart_s[..., None] * frequency_hz)
    level, slope = band_products(apart_s, frequency_hz)
    np.testing.assert_allclose(level, turn.sum(axis=-1), atol=1e-9 * n_subcarriers)
    expected = (2j * np.pi * frequency_hz * turn).sum(axis=-1)
    np.testing.assert_allclose(slope, expected, atol=1e-6 * 2 * np.pi * 2e8 * n_subcarriers)
