import json
import re
from base64 import b64decode
from dataclasses import replace

import numpy as np
import pytest

from estimation.shape.reflection.rows import no_contours
from estimation.slam.record import SolveStatus
from isac_arena.campaign.results import MapResult
from isac_arena.report.figures.plan import plan_view
from isac_arena.report.page.figures import best_stop, make_figures
from isac_arena.report.page.html import render_report
from isac_arena.report.page.payload.campaign import report_payload
from isac_arena.report.page.tables import (
    ACCEPTED,
    CHANNEL_COUNTS,
    CHANNEL_ERRORS,
    CONTOURS,
    MAPS,
    POSES,
    SHAPES,
    scene_object_table,
    score_table,
)
from isac_arena.report.style import cluster_look
from isac_arena.scoring.chain import score_campaign
from isac_arena.scoring.config import Significance
from isac_arena.scoring.headline import HEADLINE
from isac_arena.scoring.metrics.metric import Metric
from isac_arena.scoring.record import TrackScores
from isac_arena.scoring.stages.tracks import track_metrics
from scenes.record import empty_record

LIMITS = Significance(dynamic_range_db=28.0, noise_threshold_dbm=-150.0)


def scored(campaign, results, true_power):
    return score_campaign(campaign.scene, campaign.truths, results, true_power_dbm=true_power, significance=LIMITS)


@pytest.fixture(scope="module")
def scores(campaign, true_power):
    return scored(campaign, campaign.results, true_power)


@pytest.fixture(scope="module")
def figures(campaign, scores):
    return make_figures(campaign.scene, campaign.results, scores)


@pytest.fixture(scope="module")
def page(campaign, scores, figures):
    payload = report_payload("a <b> & </script> c", campaign.scene, campaign.results, scores.tables)
    return render_report(payload, scores, figures, {"seed": "1", "<note>": "x & y"})


def test_every_cluster_and_stage_has_its_figure(figures):
    clusters = [f"{name}_cluster_{index:02d}" for name in ("mapping", "slam") for index in range(4)]
    stages = ["map", "power_map", "cdf_channel", "cdf_ip_to_surface", "cdf_pose"]
    assert list(figures) == stages + clusters


def test_the_map_shows_the_whole_scene_and_a_small_walk_again(campaign, scores, figures):
    whole = plan_view(campaign.scene, "all")
    axes = figures["map"].figure.axes
    assert len(axes) in (2, 4) and axes[0].get_xlim()[0] <= whole[0] and axes[0].get_ylim()[1] >= whole[3]
    wide = replace(campaign.scene, bounds_m=(-60.0, -60.0, 60.0, 60.0))
    top, _, near, _ = make_figures(wide, campaign.results, scores)["map"].figure.axes
    assert np.ptp(top.get_xlim()) > 120 and np.ptp(near.get_xlim()) < 40


def test_axes_are_labelled_with_units(figures):
    for name, figure in figures.items():
        labels = [label for ax in figure.figure.axes for label in (ax.get_xlabel(), ax.get_ylabel()) if label]
        assert labels, name
        assert all(re.search(r"\b(m|deg|ns|dBm)\b|share", label) for label in labels), labels


def test_curves_show_the_numbers_of_the_tables(figures, campaign):
    radial, plane, *_ = figures["mapping_cluster_01"].figure.axes
    drawn = {line.get_label(): line for line in radial.lines}
    np.testing.assert_allclose(drawn["GP prediction"].get_ydata(), 0.4)
    np.testing.assert_allclose(drawn["true outline"].get_ydata(), 0.4, atol=1e-9)
    members = campaign.results.mapping.shapes.label == 1
    assert len(drawn["incidence points"].get_xdata()) == members.sum()
    assert any(np.allclose(line.get_xydata(), [[4.0, -4.0]]) for line in plane.lines)


def test_the_same_figure_gives_the_same_bytes(campaign, scores, figures):
    again = make_figures(campaign.scene, campaign.results, scores)
    for name in ("map", "cdf_pose", "mapping_cluster_00"):
        assert again[name].png == figures[name].png
        assert figures[name].png.startswith(b"\x89PNG")


def test_all_objects_and_meshes_have_a_row_also_unseen_ones(campaign, scores):
    objects = [{"name": item.name, "kind": item.kind} for item in campaign.scene.objects]
    scene = {"objects": [*objects, {"name": "far_wall", "kind": "wall"}], "clutter": [{"name": "cart"}]}
    rows = re.findall(r"<tr>(.*?)</tr>", scene_object_table(scene, scores.tables).replace("\n", ""))[1:]
    cells = {row[0]: row[1:] for row in (re.findall(r"<td>(.*?)</td>", each) for each in rows)}
    assert cells["far_wall"] == ["wall", "0", "0", "no point", "no point"]
    assert cells["cart"] == ["mesh", "0", "0", "no point", "no point"]
    met = scores.tables.significant.object == "pillar_a"
    assert cells["pillar_a"] == ["pillar", str(met.sum()), str(met.sum()), "found", "found"]


def test_an_object_without_a_contour_says_how_many_points_it_has(campaign, scores):
    scene = {"objects": [{"name": "pillar_a", "kind": "pillar"}], "clutter": []}
    contours = scores.tables.mapping.contours
    nameless = replace(contours, object=np.full(len(contours.object), "", contours.object.dtype))
    tables = replace(scores.tables, mapping=replace(scores.tables.mapping, contours=nameless))
    ips = tables.mapping.ips
    n_points = (ips.is_inlier & (ips.object == "pillar_a")).sum()
    assert n_points and f"<td>no contour of its {n_points} points</td>" in scene_object_table(scene, tables)


def test_page_is_self_contained_and_escaped(page, figures):
    assert not re.search(r'(?:src|href)="(?!data:image/png;base64,|#)', page)
    assert "http" not in re.sub(r"base64,[^\"]*", "", page).replace("http-equiv", "")
    assert "default-src 'none'" in page
    assert page.count("<script") == page.count("</script>") == 2
    assert "a &lt;b&gt; &amp; &lt;/script&gt; c" in page
    assert "x &amp; y" in page
    images = [b64decode(text) for text in re.findall(r"image/png;base64,([^\"]+)\"", page)]
    assert sorted(images) == sorted(figure.png for figure in figures.values())
    (data,) = re.findall(r'<script type="application/json" id="campaign">(.*?)</script>', page)
    assert json.loads(data)["name"] == "a <b> & </script> c"


def test_every_shown_score_exists(scores):
    of_movers = track_metrics(empty_record(TrackScores))  # a world that stands has none
    keys = {metric.key for metric in (*scores.metrics, *of_movers)}
    shown = {key for row in HEADLINE for key in (row.key, row.paper, row.bound) if key}
    for table in (CHANNEL_COUNTS, CHANNEL_ERRORS, POSES, MAPS, SHAPES, CONTOURS, ACCEPTED):
        shown |= {prefix + suffix for _, prefix in table.columns for _, suffix in table.rows}
    assert shown <= keys


@pytest.mark.parametrize(
    ("value", "text"), [(0.0202, "0.0202"), (12.0, "12"), (123.4, "123"), (1.5, "1.50"), (0.00002, "2.0e-05")]
)
def test_values_have_three_digits(value, text):
    table = score_table(POSES, [Metric("slam.position.rmse_m", value, "m", "lower")])
    assert f"<td>{text}</td><td>–</td><td>–</td><td>m</td>" in table


def test_a_campaign_without_any_result_still_has_a_report(campaign, true_power):
    def emptied(result):
        shapes = result.shapes.take("ip", slice(0, 0)).take("cluster", slice(0, 0))
        n = len(result.poses.stop)
        poses = replace(result.poses, status=np.full(n, SolveStatus.FAILED), position_m=np.full((n, 2), np.nan))
        return MapResult(poses, result.ips.take("ip", slice(0, 0)), shapes, no_contours(0, len(poses.stop)))

    results = campaign.results
    silent = tuple(estimate.take("path", slice(0, 0)) for estimate in results.channel)
    empty = replace(results, channel=silent, mapping=emptied(results.mapping), slam=emptied(results.slam))
    scores = scored(campaign, empty, true_power)
    figures = make_figures(campaign.scene, empty, scores)
    assert len(figures) == 5
    payload = report_payload("empty", campaign.scene, empty, scores.tables, campaign.truths)
    assert "–" in render_report(payload, scores, figures, {})


def test_power_map_stop_is_chosen_and_checked(campaign, scores):
    assert best_stop(scores.tables) == 0
    figures = make_figures(campaign.scene, campaign.results, scores, power_map_stop=3)
    assert figures["power_map"].title == "Power map of stop 3"
    with pytest.raises(ValueError, match="power_map_stop = 77: must be one of the 12 stops"):
        make_figures(campaign.scene, campaign.results, scores, power_map_stop=77)


def test_clusters_look_different():
    looks = [tuple(cluster_look(cluster).values()) for cluster in range(36)]
    assert len(set(looks)) == 36
