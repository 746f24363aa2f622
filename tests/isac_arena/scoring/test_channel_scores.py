from dataclasses import replace

import numpy as np
import pytest

from isac_arena.scoring.config import Significance
from isac_arena.scoring.record import PathKind, PathStatus
from isac_arena.scoring.stages.channel import score_stop
from isac_arena.scoring.stages.channel_metrics import channel_metrics
from isac_arena.scoring.true_stop import significant_paths, true_stop
from scenes.record import concatenate

LIMITS = Significance(dynamic_range_db=28.0, noise_threshold_dbm=-150.0)


def metrics_of(scored):
    paths, significant, sets = scored
    return {m.key: m.value for m in channel_metrics(sets, paths, significant)}


@pytest.fixture
def stop(campaign, true_power):
    truth, estimate = campaign.truths[4], campaign.results.channel[4]

    def score(estimate=estimate, limits=LIMITS):
        stop = true_stop(truth, campaign.scene.tx, true_power(truth), limits, None)
        return score_stop(stop, estimate)

    return score


@pytest.fixture
def estimate(campaign):
    return campaign.results.channel[4]


def test_exact_estimates_score_perfectly(stop, estimate):
    paths, significant, sets = stop()
    values = metrics_of((paths, significant, sets))
    assert (paths.status == PathStatus.DETECTED).all()
    assert paths.object.tolist() == ["", "pillar_a", "pillar_b", "wall_south", "wall_east", ""]
    assert paths.kind.tolist() == [0, 1, 1, 1, 1, 2]
    assert significant.is_detected.all()
    assert values["channel.detected_per_stop"] == len(estimate)
    assert values["channel.false_per_stop"] == values["channel.missed_per_stop"] == 0
    assert values["channel.delay.rmse_ns"] == pytest.approx(0, abs=1e-6)
    assert values["channel.aoa.rmse_deg"] == pytest.approx(0, abs=1e-9)
    assert values["channel.power.rmse_db"] == pytest.approx(0, abs=1e-9)
    assert values["channel.nees"] == pytest.approx(0, abs=1e-12)
    assert values["channel.coverage95"] == 1
    assert values["channel.gospa.mean"] == pytest.approx(0, abs=1e-6)
    assert values["channel.los.decision_accuracy"] == 1


def test_errors_bias_and_nees_are_those_put_in(stop, estimate):
    shifted = replace(estimate, delay_s=estimate.delay_s + 0.3e-9, aod_azimuth_rad=estimate.aod_azimuth_rad - 0.01)
    values = metrics_of(stop(shifted))
    assert values["channel.delay.bias_ns"] == pytest.approx(0.3)
    assert values["channel.delay.rmse_ns"] == pytest.approx(0.3)
    assert values["channel.aod.bias_deg"] == pytest.approx(-np.rad2deg(0.01))
    assert values["channel.nees"] == pytest.approx((1 + (np.rad2deg(0.01) / 0.5) ** 2) / 3)


def test_missing_paths_are_counted_by_kind(stop, estimate):
    values = metrics_of(stop(estimate.take("path", np.array([0, 1, 2]))))
    assert values["channel.missed_per_stop"] == 3
    assert values["channel.detection_rate"] == pytest.approx(0.5)
    assert values["channel.los.detection_rate"] == 1
    assert values["channel.single_bounce.detection_rate"] == 0.5
    assert values["channel.multi_bounce.detection_rate"] == 0


def test_weak_energy_explains_and_thin_air_does_not(stop, estimate, campaign, true_power):
    truth = campaign.truths[4]
    diffuse = replace(
        estimate.take("path", np.array([0, 0])),
        delay_s=truth.paths.delay_s[7] + truth.clock_bias_s + np.array([0, 50e-9]),
        aod_azimuth_rad=np.full(2, truth.paths.aod_azimuth_rad[7] - campaign.scene.tx.heading_rad),
        aoa_azimuth_rad=np.full(2, truth.paths.aoa_azimuth_rad[7] - truth.rx_pose.heading_rad),
        power_dbm=np.full(2, true_power(truth)[7] + 5.9),
        is_los=np.zeros(2, bool),
    )
    both = concatenate([estimate, diffuse], "path")
    paths, _, _ = stop(both)
    assert paths.status[-2:].tolist() == [PathStatus.WEAK, PathStatus.FALSE]
    assert paths.object[-2:].tolist() == ["wall_south", ""]
    assert paths.true_path[-2:].tolist() == [7, -1]
    assert np.isnan(paths.delay_error_s[-2:]).all()
    louder = replace(both, power_dbm=both.power_dbm + np.array([0] * len(estimate) + [0.2, 0]))
    assert stop(louder)[0].status[-2] == PathStatus.FALSE


def test_an_estimate_of_a_weaker_path_does_not_detect_a_significant_one(campaign, estimate, true_power):
    """A weaker path of its power explains it better, 2 ns later; with too little power it cannot."""
    truth = campaign.truths[4]
    later = truth.paths.take("path", np.array([1]))
    later = replace(later, delay_s=later.delay_s + 2e-9)
    more = replace(truth, paths=concatenate([truth.paths, later], "path"))
    shown = estimate.take("path", np.array([1]))
    shown = replace(shown, delay_s=shown.delay_s + 2e-9, power_dbm=shown.power_dbm - 5.0)
    power = true_power(truth)
    limits = Significance(dynamic_range_db=100.0, noise_threshold_dbm=float(power[1]) - 4.0)
    for below_db, status in ((5.0, PathStatus.WEAK), (30.0, PathStatus.DETECTED)):
        stop = true_stop(more, campaign.scene.tx, np.append(power, power[1] - below_db), limits, None)
        paths, significant, _ = score_stop(stop, shown)
        assert paths.status.tolist() == [status]
        assert significant.is_detected[significant.path == 1].tolist() == [status == PathStatus.DETECTED]


def test_a_duplicate_of_a_detected_path_is_false(stop, estimate):
    twice = concatenate([estimate, estimate.take("path", np.array([4]))], "path")
    paths, _, _ = stop(twice)
    assert (paths.status == PathStatus.DETECTED).sum() == len(estimate)
    assert (paths.status == PathStatus.FALSE).sum() == 1


def test_significance_follows_range_noise_and_kind(campaign, true_power):
    truth = campaign.truths[0]
    power = true_power(truth)
    assert significant_paths(truth.paths, power, LIMITS).tolist() == [True] * 6 + [False] * 2
    narrow = Significance(dynamic_range_db=0.1, noise_threshold_dbm=-300)
    assert significant_paths(truth.paths, power, narrow).sum() == 1
    deaf = Significance(dynamic_range_db=300.0, noise_threshold_dbm=100)
    assert not significant_paths(truth.paths, power, deaf).any()


def test_los_decision(stop, estimate):
    none_named = replace(estimate, is_los=np.zeros(len(estimate), bool))
    wrong_named = replace(estimate, is_los=np.arange(len(estimate)) == 2)
    assert metrics_of(stop(none_named))["channel.los.decision_accuracy"] == 0
    assert metrics_of(stop(wrong_named))["channel.los.decision_accuracy"] == 0
    assert (
        metrics_of(stop(none_named, Significance(dynamic_range_db=1, noise_threshold_dbm=100)))[
            "channel.los.decision_accuracy"
        ]
        == 1
    )


def test_nothing_estimated_is_valid(stop, estimate):
    paths, significant, sets = stop(estimate.take("path", np.zeros(0, int)))
    values = metrics_of((paths, significant, sets))
    assert values["channel.missed_per_stop"] == 6
    assert np.isnan(values["channel.delay.rmse_ns"])
    assert (significant.kind == [PathKind.LOS] + [PathKind.SINGLE_BOUNCE] * 4 + [PathKind.MULTI_BOUNCE]).all()


def in_space(estimate, elevation_deg, std_deg=1.0):
    """The estimate with these elevations (path, 2) of departure and arrival and their stated deviation."""
    variance = np.broadcast_to(np.square(np.deg2rad(std_deg)), (len(estimate), 2))
    covariance = np.zeros((len(estimate), 5, 5))
    covariance[:, :3, :3] = estimate.covariance
    covariance[:, [3, 4], [3, 4]] = variance
    aod_rad, aoa_rad = np.deg2rad(elevation_deg).T
    return replace(estimate, covariance=covariance, aod_elevation_rad=aod_rad, aoa_elevation_rad=aoa_rad)


@pytest.fixture
def above_and_below(campaign, true_power):
    """Scores of one estimate against two true paths alike in delay, azimuths and power, 30 deg up and down."""
    truth = campaign.truths[4]

    def score(elevation_deg, std_deg=1.0, limits=LIMITS):
        rays = truth.paths.take("path", [1, 1])
        sign_rad = np.deg2rad(30.0) * np.array([1.0, -1.0])
        rays = replace(rays, aod_elevation_rad=sign_rad, aoa_elevation_rad=sign_rad)
        power = np.repeat(true_power(truth)[1], 2)
        stop = true_stop(replace(truth, paths=rays), campaign.scene.tx, power, limits, None)
        one = replace(
            campaign.results.channel[4].take("path", [1]),
            delay_s=stop.parameters[:1, 0],
            aod_azimuth_rad=stop.parameters[:1, 1],
            aoa_azimuth_rad=stop.parameters[:1, 2],
            power_dbm=power[:1],
        )
        return score_stop(stop, in_space(one, [[elevation_deg, elevation_deg]], std_deg))

    return score


@pytest.mark.parametrize(("elevation_deg", "path"), [(29.0, 0), (-29.0, 1)])
def test_elevations_tell_a_path_from_above_from_one_from_below(above_and_below, elevation_deg, path):
    paths, significant, _ = above_and_below(elevation_deg)
    assert paths.status.tolist() == [PathStatus.DETECTED]
    assert paths.true_path.tolist() == [path]
    assert significant.is_detected.tolist() == [path == 0, path == 1]


@pytest.mark.parametrize(("elevation_deg", "path"), [(29.0, 0), (-29.0, 1)])
def test_elevations_tell_what_weak_energy_a_path_stems_from(above_and_below, elevation_deg, path):
    """Neither is significant, so each explains the estimate by its power alone."""
    deaf = Significance(dynamic_range_db=28.0, noise_threshold_dbm=100.0)
    paths, _, _ = above_and_below(elevation_deg, limits=deaf)
    assert paths.status.tolist() == [PathStatus.WEAK]
    assert paths.true_path.tolist() == [path]


def test_an_elevation_between_two_paths_is_neither_unless_it_says_so(above_and_below):
    sure, unsure = above_and_below(15.0), above_and_below(15.0, std_deg=6.0)
    assert sure[0].status.tolist() == [PathStatus.FALSE]
    assert sure[2].false > 0
    assert unsure[0].true_path.tolist() == [0]  # 2.5 of its deviations off; the other is 7.5 off


def test_an_elevation_without_deviation_counts_as_not_estimated(campaign, stop, estimate):
    wrong = np.full((len(estimate), 2), 60.0)
    for std_deg in (np.nan, np.inf):
        for found, plain in zip(stop(in_space(estimate, wrong, std_deg)), stop(), strict=True):
            np.testing.assert_equal(vars(found), vars(plain))


def test_an_elevation_at_one_device_counts_there_alone(stop, estimate):
    half = in_space(estimate, np.zeros((len(estimate), 2)), np.array([1.0, np.nan]))
    assert (stop(half)[0].status == PathStatus.DETECTED).all()
    off = in_space(estimate, np.tile([40.0, np.nan], (len(estimate), 1)), np.array([1.0, np.nan]))
    assert not stop(off)[1].is_detected.any()
