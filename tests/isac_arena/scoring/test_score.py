import json
from dataclasses import replace

import numpy as np
import pytest

from estimation.shape.reflection.rows import no_contours
from estimation.slam.record import SolveStatus
from isac_arena.campaign.files import read_record, write_record
from isac_arena.campaign.results import MapResult
from isac_arena.scoring.chain import score_campaign, score_metrics
from isac_arena.scoring.config import Significance
from isac_arena.scoring.metrics.metric import is_share, to_json
from isac_arena.scoring.record import ScoreTables
from scenes.record import concatenate

LIMITS = Significance(dynamic_range_db=28.0, noise_threshold_dbm=-150.0)


@pytest.fixture
def score(campaign, true_power):
    def run(results=campaign.results, truths=campaign.truths):
        return score_campaign(
            campaign.scene, iter(truths), results, true_power_dbm=true_power, significance=LIMITS
        )

    return run


def emptied(result):
    shapes = result.shapes.take("ip", slice(0, 0)).take("cluster", slice(0, 0))
    poses = replace(result.poses, status=np.full(len(result.poses.stop), SolveStatus.FAILED))
    return MapResult(poses, result.ips.take("ip", slice(0, 0)), shapes, no_contours(0, len(poses.stop)))


def test_a_perfect_campaign_has_no_error(score):
    scores = score()
    for key in ("mapping.ip_to_surface.median_m", "slam.ip_to_surface.p90_m", "slam.position.rmse_m",
                "slam.clock.rmse_ns", "channel.false_per_stop", "mapping.ghost_clusters",
                "mapping.ip_position.rms_m"):  # fmt: skip
        assert scores.value(key) == pytest.approx(0, abs=1e-6), key
    for name in ("mapping", "slam"):
        assert scores.value(f"{name}.objects_found.pillar") == 2
        assert scores.value(f"{name}.objects_found.wall") == 2
        assert scores.value(f"{name}.objects_found.kiosk") == 0
        assert scores.value(f"shapes.{name}.pillar.iou.mean") == pytest.approx(1, abs=1e-3)
        assert scores.value(f"shapes.{name}.pillar_a.hausdorff_m") == pytest.approx(0, abs=1e-3)
        assert scores.value(f"shapes.{name}.pillar.coverage95.mean") == 1
    assert scores.tables.mapping.clusters.object.tolist() == ["pillar_a", "pillar_b", "wall_south", "wall_east"]
    assert np.all(scores.tables.mapping.clusters.purity == 1)


def test_shares_lie_between_zero_and_one(score):
    shares = {metric.key: metric.value for metric in score().metrics if is_share(metric.key)}
    assert all(np.isnan(value) or 0 <= value <= 1 for value in shares.values())
    assert {"channel.detection_rate", "slam.solved_share", "contours.slam.pillar.iou.mean"} <= set(shares)
    assert not is_share("channel.false_per_stop") and not is_share("contours.slam.pillar.iou.count")


def test_keys_stay_the_same_when_nothing_was_found(score, campaign):
    results = campaign.results
    silent = tuple(estimate.take("path", slice(0, 0)) for estimate in results.channel)
    empty = replace(results, channel=silent, mapping=emptied(results.mapping), slam=emptied(results.slam))
    full, none = score(), score(empty)
    assert [m.key for m in full.metrics] == [m.key for m in none.metrics]
    assert len({m.key for m in full.metrics}) == len(full.metrics)
    assert none.value("mapping.objects_found") == 0
    assert none.value("slam.solved_share") == 0
    assert np.isnan(none.value("slam.position.rmse_m"))
    json.dumps(to_json(none.metrics), allow_nan=False)


def test_heights_are_scored_where_they_were_estimated(score, campaign):
    flat = score()
    assert np.isnan([flat.value(f"mapping.ip_height.{key}") for key in ("rms_m", "nees", "coverage95")]).all()
    mapping = campaign.results.mapping
    height_m = np.full(len(mapping.ips), 1.8 + 0.3)  # of all true incidence points, and an error
    height_m[mapping.shapes.label == 1] = np.nan
    covariance = np.tile([0.0, 0.0, 0.15**2], (len(mapping.ips), 1))
    path = np.where(mapping.shapes.label == 0, 5, mapping.ips.path)  # the double bounce has no point of its own
    ips = replace(mapping.ips, height_m=height_m, height_covariance_m2=covariance, path=path)
    scores = score(replace(campaign.results, mapping=replace(mapping, ips=ips)))
    known = np.isfinite(scores.tables.mapping.ips.height_error_m)
    assert known.tolist() == (mapping.shapes.label >= 2).tolist()
    assert scores.value("mapping.ip_height.rms_m") == pytest.approx(0.3)
    assert scores.value("mapping.ip_height.median_m") == pytest.approx(0.3)
    assert scores.value("mapping.ip_height.nees") == pytest.approx(4)
    assert scores.value("mapping.ip_height.coverage95") == 0


def test_an_object_named_like_a_kind_keeps_its_own_keys(score, campaign):
    scene = campaign.scene
    more = (*scene.objects, replace(scene.objects[0], name="pillar", may_overlap=True))
    keys = [m.key for m in score_metrics(replace(scene, objects=more), score().tables)]
    assert len(set(keys)) == len(keys)


def test_tables_survive_a_file(score, campaign, tmp_path):
    scores = score()
    write_record(tmp_path / "provenance.nc", scores.tables)
    tables = read_record(tmp_path / "provenance.nc", ScoreTables)
    assert to_json(score_metrics(campaign.scene, tables)) == to_json(scores.metrics)


def test_causes_add_up_to_what_is_missed_false_and_ghostly(score, campaign):
    """Two paths missed everywhere, every fourth stop with a copy of a path, and the double bounces as points."""
    channel = []
    for index, estimate in enumerate(campaign.results.channel):
        kept = estimate.take("path", [0, 1, 4, 5])
        channel.append(concatenate([kept, kept.take("path", [1])], "path") if index % 4 == 0 else kept)
    mapping = campaign.results.mapping
    path = np.minimum(mapping.ips.path, 2)
    path[mapping.shapes.label == 1] = 3  # the double bounce
    results = replace(
        campaign.results,
        channel=tuple(channel),
        mapping=replace(mapping, ips=replace(mapping.ips, path=path)),
        slam=replace(campaign.results.slam, ips=replace(mapping.ips, path=path)),
    )
    scores = score(results)
    tables, n_stops = scores.tables, len(campaign.truths)
    counts = {m.key.split(".", 1)[1]: m.value for m in scores.metrics}
    missed = {key: value for key, value in counts.items() if key.startswith("missed.")}
    assert sum(missed.values()) == (~tables.significant.is_detected).sum() == 2 * n_stops
    assert (tables.significant.cause != "").tolist() == (~tables.significant.is_detected).tolist()
    false = {key: value for key, value in counts.items() if key.startswith("false.")}
    assert sum(false.values()) == false["false.duplicate"] == 3
    assert scores.value("mapping.ghost_ips.double_bounce") == n_stops
    ghosts = tables.mapping.ips.is_inlier & (tables.mapping.ips.object == "")
    assert (tables.mapping.ips.cause != "").tolist() == ghosts.tolist()
    assert tables.mapping.clusters.cause.tolist() == ["", "double_bounce", "", ""]


def test_ghost_clusters_are_told_from_objects(score, campaign):
    mapping = campaign.results.mapping
    path = mapping.ips.path.copy()
    path[mapping.shapes.label == 1] = 5  # made from the double bounce
    results = replace(campaign.results, mapping=replace(mapping, ips=replace(mapping.ips, path=path)))
    scores = score(results)
    clusters = scores.tables.mapping.clusters
    assert clusters.is_ghost.tolist() == [False, True, False, False]
    assert clusters.object[1] == ""
    assert scores.value("mapping.objects_found.pillar") == 1
    assert scores.value("mapping.ips_from_single_bounce_share") == 0.75
    assert np.isnan(scores.value("shapes.mapping.pillar_b.iou"))


def test_far_points_do_not_find_an_object(score, campaign):
    mapping = campaign.results.mapping
    position = mapping.ips.position_m + np.where(mapping.shapes.label == 0, 0.51, 0.0)[:, None]
    moved = replace(mapping, ips=replace(mapping.ips, position_m=position))
    assert score(replace(campaign.results, mapping=moved)).value("mapping.objects_found.pillar") == 1


def test_stops_must_agree(score, campaign):
    with pytest.raises(ValueError, match="no truth for stop 11"):
        score(truths=campaign.truths[:-1])
    short = replace(campaign.results, channel=campaign.results.channel[1:])
    with pytest.raises(ValueError, match="stop 0 has a truth but no channel estimate"):
        score(results=short)


def test_labels_and_paths_must_fit(score, campaign):
    mapping = campaign.results.mapping
    few = replace(mapping, shapes=mapping.shapes.take("ip", slice(0, 3)))
    with pytest.raises(ValueError, match=r"Shapes\.label: 3 labels"):
        score(replace(campaign.results, mapping=few))
    lost = replace(mapping, ips=replace(mapping.ips, path=mapping.ips.path + 90))
    with pytest.raises(ValueError, match=r"IncidencePoints\.path = 91 at stop 0"):
        score(replace(campaign.results, mapping=lost))
