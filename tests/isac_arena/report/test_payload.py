"""What the page is told is what the records say."""

import json
from base64 import b64decode
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from estimation.shape.record import normals
from isac_arena.report.figures.bands import contour_curve, shape_curve
from isac_arena.report.page.budget_file import BUDGET_FILE, read_budget
from isac_arena.report.page.payload import thinning
from isac_arena.report.page.payload.campaign import report_payload
from isac_arena.report.page.payload.numbers import POWER_LEVELS, POWER_STEP_DB, number, quantised_power, rounded
from isac_arena.report.page.payload.thinning import drawn_stops
from isac_arena.report.page.tables import channel_error_table
from isac_arena.scoring.chain import score_campaign, score_metrics
from isac_arena.scoring.config import Significance
from isac_arena.scoring.record import PathStatus
from isac_arena.scoring.score import Scores
from scenes.pose import wrap_angle
from scenes.record import concatenate

LIMITS = Significance(dynamic_range_db=28.0, noise_threshold_dbm=-150.0)


def scored(campaign, results, true_power):
    scores = score_campaign(
        campaign.scene, campaign.truths, results, true_power_dbm=true_power, significance=LIMITS
    )
    return scores.tables


@pytest.fixture(scope="module")
def tables(campaign, true_power):
    return scored(campaign, campaign.results, true_power)


@pytest.fixture(scope="module")
def payload(campaign, tables):
    return report_payload("made up", campaign.scene, campaign.results, tables, campaign.truths)


def test_numbers_are_rounded_and_what_is_not_known_is_none():
    assert rounded([[1.23456, np.nan], [-0.0001, np.inf]], 3) == [1.235, None, 0, None]
    assert json.dumps(rounded([2.0, -0.0], 3)) == "[2, 0]"
    assert number(float("nan"), 2) is None


@given(arrays(float, (3, 5), elements=st.floats(-140, -20)))
def test_power_is_kept_to_half_a_step(power_dbm):
    top, text = quantised_power(power_dbm)
    steps = np.frombuffer(b64decode(text), np.uint8).reshape(3, 5)
    reach = top - POWER_STEP_DB * POWER_LEVELS
    np.testing.assert_allclose(
        top - POWER_STEP_DB * steps, np.maximum(power_dbm, reach), atol=POWER_STEP_DB / 2 + 0.006
    )


def test_the_band_of_a_circle_is_a_ring_and_that_of_a_wall_a_strip(campaign):
    contours = campaign.results.mapping.contours
    pillar = contour_curve(contours, 0)
    center = np.array([0.0, -4.0])
    for ring, radius in ((pillar.outer_m, 0.3 + 0.0196), (pillar.inner_m, 0.3 - 0.0196)):
        np.testing.assert_allclose(np.linalg.norm(ring - center, axis=1), radius, atol=1e-9)
    wall = contour_curve(contours, 2)
    assert not wall.is_closed
    np.testing.assert_allclose(np.abs(wall.outer_m[:, 1] + 7.0), 0.0196, atol=1e-9)
    np.testing.assert_allclose(wall.outer_m + wall.inner_m, 2 * wall.points_m, atol=1e-12)


def test_bands_of_the_paper_lie_along_the_radius_and_end_at_the_centre(campaign):
    shapes = campaign.results.mapping.shapes
    wide = replace(shapes, radius_std_m=np.full_like(shapes.radius_m, 0.25))
    curve = shape_curve(wide, 0, step=3)
    radii = [
        np.linalg.norm(ring - wide.center_m[0], axis=1) for ring in (curve.points_m, curve.outer_m, curve.inner_m)
    ]
    assert len(radii[0]) == 120
    for found, expected in zip(radii, (0.3, 0.8, 0.0), strict=True):
        np.testing.assert_allclose(found, expected, atol=1e-12)


def test_normals_of_points_that_coincide_are_zero():
    points = np.array([[1.0, 2.0]] * 4)
    np.testing.assert_array_equal(normals(points, is_closed=True), np.zeros((4, 2)))


def test_paths_of_a_stop_are_those_of_the_records(campaign, tables, payload):
    estimate, paths = campaign.results.channel[4], payload["estimated"][4]
    np.testing.assert_allclose(paths["delay_ns"], 1e9 * estimate.delay_s, atol=6e-4)
    np.testing.assert_allclose(np.deg2rad(paths["aoa_deg"]), estimate.aoa_azimuth_rad, atol=1e-5)
    np.testing.assert_allclose(paths["aod_std_deg"], 0.5, atol=1e-4)
    assert paths["status"] == ["detected"] * len(estimate)
    assert paths["los"][0] and not any(paths["los"][1:])
    truth = payload["true"][4]
    assert truth["kind"][:2] == ["line of sight", "one reflection"]
    assert truth["label"][1] == "S pillar_a" and truth["object"][1] == "pillar_a"
    vertex = campaign.truths[4].paths.vertex_m[1, 0, :2]
    np.testing.assert_allclose(truth["corners"][1], vertex, atol=6e-4)
    assert [truth["path"].index(path) for path in paths["true_path"]] == list(range(len(truth["path"])))


def test_points_know_what_they_support_and_where_they_come_from(campaign, payload):
    points = payload["maps"]["slam"]["ips"]
    result = campaign.results.slam
    assert points["ours"] == result.contours.object.tolist()
    assert points["paper"] == result.shapes.label.tolist()
    np.testing.assert_allclose(np.reshape(points["xy"], (-1, 2)), result.ips.position_m, atol=6e-4)
    np.testing.assert_allclose(points["std_m"], 0.1, atol=1e-4)
    contours = payload["maps"]["mapping"]["contours"]
    assert [one["object"] for one in contours] == ["pillar_a", "pillar_b", "wall_south", "wall_east"]
    assert contours[0]["probability"] == [0, 0, 1] and contours[0]["n_ips"] == 12
    assert contours[0]["scores"]["iou"] > 0.99


def test_ellipses_have_their_long_axis_first(campaign, true_power):
    result = campaign.results.mapping
    turned = np.array([[0.04, 0.0], [0.0, 0.01]])
    ips = replace(result.ips, covariance_m2=np.tile(turned, (len(result.ips), 1, 1)))
    results = replace(campaign.results, mapping=replace(result, ips=ips))
    payload = report_payload("x", campaign.scene, results, scored(campaign, results, true_power))
    points = payload["maps"]["mapping"]["ips"]
    assert points["std_m"][:2] == [0.2, 0.1]
    assert abs(np.sin(np.deg2rad(points["axis_deg"][0]))) < 1e-9


def test_power_maps_come_with_beams_in_order(campaign, payload):
    power = payload["power"]
    assert power["rx_deg"] == sorted(power["rx_deg"]) and len(power["colors"][0]) == 7
    truth = campaign.results.power_maps[2]
    steps = np.frombuffer(b64decode(power["below"][2]), np.uint8).reshape(truth.power_dbm.shape)
    strongest = np.unravel_index(truth.power_dbm.argmax(), truth.power_dbm.shape)
    assert steps[strongest] == 0


def test_of_beams_at_several_elevations_the_strongest_pair_is_shown(campaign, true_power):
    first = campaign.results.power_maps[0]
    weak_dbm = first.power_dbm - 30
    doubled = [
        replace(
            one,
            tx_azimuth_rad=np.tile(one.tx_azimuth_rad, 2),
            power_dbm=np.concatenate([weak_dbm, one.power_dbm] if row % 2 else [one.power_dbm, weak_dbm]),
        )
        for row, one in enumerate([replace(first, stop=one.stop) for one in campaign.results.power_maps])
    ]
    results = replace(campaign.results, power_maps=tuple(doubled))
    power = report_payload("x", campaign.scene, results, scored(campaign, results, true_power))["power"]
    assert len(power["tx_deg"]) == len(first.tx_azimuth_rad)
    assert power["n_pairs"] == 2 * first.power_dbm.size
    order = np.ix_(np.argsort(first.tx_azimuth_rad), np.argsort(first.rx_azimuth_rad))
    expected = quantised_power(first.power_dbm[order])
    for top, below in zip(power["top_dbm"], power["below"], strict=True):
        assert (top, below) == expected


def test_missed_and_false_paths_are_told_apart_with_their_cause(campaign, true_power):
    first = campaign.results.channel[0]
    extra = replace(first.take("path", slice(1, 2)), delay_s=first.delay_s[1:2] + 60e-9)
    changed = concatenate([first.take("path", np.array([0, 1, 3, 4, 5])), extra], "path")
    results = replace(campaign.results, channel=(changed, *campaign.results.channel[1:]))
    tables = scored(campaign, results, true_power)
    payload = report_payload("x", campaign.scene, results, tables, campaign.truths)
    assert payload["estimated"][0]["status"][-1] == "false"
    assert payload["estimated"][0]["delay_error_ns"][-1] is None
    truth = payload["true"][0]
    assert truth["detected"][2] is False and truth["cause"][2] and not truth["cause"][1]


def test_angles_are_those_of_one_turn(campaign, tables):
    first = campaign.results.channel[0]
    turned = replace(first, aoa_azimuth_rad=first.aoa_azimuth_rad - 2 * np.pi)
    results = replace(campaign.results, channel=(turned, *campaign.results.channel[1:]))
    payload = report_payload("x", campaign.scene, results, tables)
    np.testing.assert_allclose(np.deg2rad(payload["estimated"][0]["aoa_deg"]), first.aoa_azimuth_rad, atol=1e-5)


def test_a_campaign_without_truth_or_samples_says_so(campaign, tables):
    results = replace(campaign.results, power_maps=())
    payload = report_payload("measured", campaign.scene, results, tables)
    assert payload["has_truth"] is False and payload["power"] is None
    assert payload["true"] == [None] * len(campaign.truths)
    json.dumps(payload, allow_nan=False)


def test_a_budget_is_read_and_a_wrong_one_named_and_refused(tmp_path):
    assert read_budget(tmp_path, "hall") is None
    path = tmp_path / BUDGET_FILE
    path.parent.mkdir()
    row = {
        "outcome": "pose", "budget": "stages", "part": "slam", "share": 0.4, "share_low": None,
        "share_high": None, "rms_m": 0.1, "alone_rms_m": 0.2, "mean_square_m2": 0.01, "objection": "",
        "effect": "falls",
    }  # fmt: skip
    text = json.dumps({"campaign": "hall", "rows": [row]})
    path.write_text(text)
    (found,) = read_budget(tmp_path, "hall")
    assert found["part"] == "slam" and "alone_rms_m" not in found
    with pytest.raises(ValueError, match=r"budget\.json: is the budget of 'hall', not of 'other'"):
        read_budget(tmp_path, "other")
    for wrong in (text[:-20], '{"rows": 3}', ""):
        path.write_text(wrong)
        with pytest.raises(ValueError, match=r"budget\.json: no error budget"):
            read_budget(tmp_path, "hall")


def test_true_paths_stand_at_the_angles_that_their_estimates_report(campaign, true_power):
    tables = scored(campaign, campaign.results, true_power)
    cone = replace(tables.paths, aod_error_rad=np.full_like(tables.paths.aod_error_rad, 0.1))
    payload = report_payload("x", campaign.scene, campaign.results, replace(tables, paths=cone), campaign.truths)
    estimate, truth, found = campaign.results.channel[4], payload["true"][4], payload["estimated"][4]
    rows = [truth["path"].index(path) for path in found["true_path"]]
    reported_rad = np.deg2rad(np.array(truth["aod_deg"])[rows])
    np.testing.assert_allclose(np.sin(reported_rad - estimate.aod_azimuth_rad), np.sin(-0.1), atol=1e-5)
    missed = replace(cone, status=np.full_like(cone.status, PathStatus.FALSE))
    payload = report_payload("x", campaign.scene, campaign.results, replace(tables, paths=missed), campaign.truths)
    significant = tables.significant.take("true_path", tables.significant.stop == 4)
    np.testing.assert_allclose(
        np.deg2rad(payload["true"][4]["aod_deg"]), wrap_angle(significant.aod_azimuth_rad), atol=1e-5
    )


def test_a_long_campaign_draws_evenly_spaced_stops_and_all_contours(campaign, true_power, monkeypatch):
    tables = scored(campaign, campaign.results, true_power)
    whole = report_payload("x", campaign.scene, campaign.results, tables, campaign.truths)
    assert drawn_stops(campaign.results) == [estimate.stop for estimate in campaign.results.channel]
    monkeypatch.setattr(thinning, "MOST_BYTES", 0.0)
    drawn = drawn_stops(campaign.results)
    assert drawn == [campaign.results.channel[0].stop, campaign.results.channel[-1].stop]
    thin = report_payload("x", campaign.scene, campaign.results, tables, campaign.truths)
    rows = [whole["stops"]["stop"].index(stop) for stop in drawn]
    assert thin["n_stops"] == whole["n_stops"] == len(whole["stops"]["stop"]) and thin["stops"]["stop"] == drawn
    for name in ("estimated", "true"):
        assert thin[name] == [whole[name][row] for row in rows]
    for name, part in thin["maps"].items():
        all_ips, ips = whole["maps"][name]["ips"], part["ips"]
        kept = [index for index, stop in enumerate(all_ips["stop"]) if stop in drawn]
        assert 0 < len(kept) < len(all_ips["stop"])
        assert ips["path"] == [all_ips["path"][index] for index in kept]
        assert ips["xy"] == [all_ips["xy"][2 * index + axis] for index in kept for axis in range(2)]
        assert len(ips["ours"]) == len(ips["nees"]) == len(kept)
        assert part["contours"] == whole["maps"][name]["contours"]


def test_angles_are_called_what_they_are(campaign, tables):
    """Cone angles of horizontal beams are no azimuths, in the tables of stops and in that of errors."""
    is_cone = np.ones(len(tables.paths.stop), bool)
    cones = replace(tables, paths=replace(tables.paths, aod_is_cone=is_cone))
    told = report_payload("made up", campaign.scene, campaign.results, cones, campaign.truths)
    assert told["angles"] == {"aod": "cone angle", "aoa": "azimuth"}
    shown = channel_error_table(Scores(score_metrics(campaign.scene, cones), cones))
    assert "Cone angle</abbr> of departure, RMSE" in shown and "Azimuth of arrival, RMSE" in shown
