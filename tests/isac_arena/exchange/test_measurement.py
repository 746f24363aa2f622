"""Campaigns in the layout of the public measurement file: what is written is read again."""

import numpy as np
import pytest

from isac_arena.exchange.mat import measurement_bytes, read_measurement
from isac_arena.exchange.measurement import labelled_stops
from isac_arena.scoring.chain import score_campaign
from isac_arena.scoring.config import Significance
from isac_arena.validation.scenarios.perfect_campaign import make_campaign, power_dbm
from scenes.pose import SPEED_OF_LIGHT_M_S


@pytest.fixture(scope="module")
def campaign():
    return make_campaign()


@pytest.fixture(scope="module")
def stops(campaign):
    scores = score_campaign(
        campaign.scene, campaign.truths, campaign.results, true_power_dbm=power_dbm,
        significance=Significance(dynamic_range_db=28.0, noise_threshold_dbm=-150.0),
    )  # fmt: skip
    return labelled_stops(campaign.results.channel, campaign.truths, scores.tables.paths)


def test_ranges_hold_no_clock_and_labels_are_true(stops, campaign):
    scene = campaign.scene
    for stop, truth in zip(stops, campaign.truths, strict=True):
        assert stop.is_los.sum() == 1 and stop.is_single_bounce.sum() == len(scene.objects)
        straight = np.linalg.norm(truth.rx_pose.position_m - scene.tx.position_m)
        assert stop.measured[stop.is_los, 0] == pytest.approx(straight, abs=1e-6)
        for landmark in stop.landmark_m[stop.is_single_bounce]:
            assert min(abs(float(item.contour.signed_distance(landmark))) for item in scene.objects) < 1e-6
        assert np.isnan(stop.landmark_m[~stop.is_single_bounce]).all()


def test_the_file_is_read_again(stops, campaign, tmp_path):
    file = tmp_path / "made_up.mat"
    file.write_bytes(measurement_bytes(campaign.scene.tx, stops))
    back = read_measurement(file, tx_offset_deg=0.0)
    assert back.tx.heading_rad == pytest.approx(campaign.scene.tx.heading_rad)
    for given, estimate, truth in zip(stops, back.channel, back.truths, strict=True):
        order = np.argsort(given.measured[:, 0], kind="stable")
        np.testing.assert_allclose(SPEED_OF_LIGHT_M_S * estimate.delay_s, given.measured[order, 0])
        np.testing.assert_array_equal(estimate.aod_azimuth_rad, given.measured[order, 1])
        np.testing.assert_array_equal(estimate.power_dbm, given.power_dbm[order])
        np.testing.assert_array_equal(truth.is_single_bounce, given.is_single_bounce[order])
        np.testing.assert_array_equal(truth.landmark_m, given.landmark_m[order])
