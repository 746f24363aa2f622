import json
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from isac_arena.scoring import headline as main_scores
from isac_arena.scoring.headline import ENOUGH, headline
from isac_arena.scoring.metrics.metric import Metric, from_json, to_json
from isac_arena.scoring.metrics.statistics import maximum, mean, quantile, ratio, rms, squared_mahalanobis
from isac_arena.scoring.stages.maps import FOUND_POINTS


def test_rows_survive_json_and_nan_becomes_null():
    metrics = (Metric("a.b_m", 1.5, "m", "lower"), Metric("c", math.nan, "1", "info"))
    rows = json.loads(json.dumps(to_json(metrics), allow_nan=False))
    assert rows[0] == {"key": "a.b_m", "value": 1.5, "unit": "m", "direction": "lower"}
    assert rows[1]["value"] is None
    back = from_json(rows)
    assert back[0] == metrics[0]
    assert math.isnan(back[1].value)


@pytest.mark.parametrize(("key", "direction"), [("", "lower"), ("a", "sideways")])
def test_bad_metric_is_refused(key, direction):
    with pytest.raises(ValueError, match="Metric"):
        Metric(key, 1.0, "m", direction)


def test_missing_field_is_named():
    with pytest.raises(ValueError, match=r"metrics\[0\]: 'unit' is missing"):
        from_json([{"key": "a", "value": 1, "direction": "info"}])


def test_statistics_leave_out_nan_and_survive_nothing():
    assert rms([3.0, np.nan, -4.0]) == pytest.approx(np.sqrt(12.5))
    assert mean([True, False, True, True]) == 0.75
    assert maximum([1.0, np.nan, 3.0]) == 3.0
    assert quantile([0.0, 1.0, 2.0], 0.5) == 1.0
    assert all(math.isnan(f([])) for f in (rms, mean, maximum))
    assert math.isnan(ratio(1, 0))


@given(st.integers(0, 2**32 - 1))
def test_mahalanobis_matches_the_plain_inverse(seed):
    rng = np.random.default_rng(seed)
    factor = rng.standard_normal((5, 3, 3)) + 2 * np.eye(3)
    covariance = factor @ factor.transpose(0, 2, 1) + 0.01 * np.eye(3)  # both inverses resolve it
    error = rng.standard_normal((5, 3))
    expected = [e @ np.linalg.solve(c, e) for e, c in zip(error, covariance, strict=True)]
    scale = np.array([1e-9, 1e-2, 1.0])
    got = squared_mahalanobis(error * scale, covariance * np.outer(scale, scale))
    np.testing.assert_allclose(got, expected, rtol=1e-6)


def test_mahalanobis_is_nan_without_variance_or_error():
    error = np.array([[1.0, 1.0], [np.nan, 1.0], [3.0, 4.0]])
    covariance = np.array([np.zeros((2, 2)), np.eye(2), np.eye(2)])
    np.testing.assert_allclose(squared_mahalanobis(error, covariance), [np.nan, np.nan, 25.0])


def test_rows_of_stages_that_did_not_run_are_left_out() -> None:
    metrics = [
        Metric("slam.position.rmse_m", 0.1, "m", "lower"),
        Metric("published.position.rmse_m", 0.2, "m", "lower"),
    ]
    assert [label for label, *_ in headline(metrics)] == ["Receiver position in plan by SLAM, RMSE"]
    assert not list(headline(metrics[1:]))


def test_means_over_contours_say_how_many_they_are_over() -> None:
    counts = {"contours.mapping.wall.count": 4, "shapes.mapping.wall.count": 5, "scene.visible.wall": 3}
    counts |= {"scene.single_bounces.wall.north": 2, "contours.mapping.north.hausdorff_m": 0.1}
    counts |= {"scene.single_bounces.wall.south": 2, "contours.mapping.south.hausdorff_m": np.nan}
    counts |= {"scene.single_bounces.wall.east": 9, "contours.mapping.east.hausdorff_m": 0.1}
    metrics = [Metric(key, value, "1", "info") for key, value in counts.items()]
    metrics.append(Metric("contours.mapping.wall.seen_rmse.mean_m", 0.01, "m", "lower"))
    counts = {
        "contours.mapping.pillar.count": 2,
        "contours.mapping.pillar.iou.count": 1,
        "scene.visible.pillar": 7,
    }
    metrics += [Metric(key, value, "1", "info") for key, value in counts.items()]
    metrics.append(Metric("contours.mapping.objects_found.pillar", 1, "1", "higher"))
    metrics.append(Metric("contours.mapping.pillar.iou.mean", 0.9, "1", "higher"))
    units = {label: unit for label, _, unit in headline(metrics)}
    few = "north of these: fewer than 3 single bounces meet it"
    wall = f"m, mean over 4 walls with a contour (published: 5); {few}"
    assert units["Walls, seen part, mapping, RMSE"] == wall
    assert units["Pillars, overlap (IoU), mapping"] == "mean over 1 pillar with a closed contour"
    assert units["Pillars found by mapping"] == "of 7 that 3 single bounces or more meet"
    assert ENOUGH.startswith(str(FOUND_POINTS)) and main_scores.FOUND_POINTS == FOUND_POINTS
    assert sum("mean over" in unit for unit in units.values()) == 2
