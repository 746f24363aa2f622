from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import t as student

from isac_arena.report.style import new_figure
from isac_arena.report.sweep.captions import axis_caption, parallel_caption, pareto_caption
from isac_arena.report.sweep.figures import (
    axis_figure,
    coinciding,
    drawn_values,
    front_of,
    parallel_figure,
    pareto_figure,
)
from isac_arena.report.sweep.page import SweepFigure, axis_tables, render_sweep
from isac_arena.report.sweep.results import (
    SweepAxis,
    SweepMetric,
    SweepResults,
    groups,
    interval_ends,
    mean_interval,
    nondominated,
    varying,
)

KEY, OVER = "slam.position.rmse_m", "slam.position.over_bound"


def made(n_points: int = 6, repeats: int = 4) -> SweepResults:
    rng = np.random.default_rng(1)
    point = np.repeat(np.arange(n_points), repeats)
    power = tuple(float(value) for value in point)
    method = tuple("ab"[value % 2] for value in point)
    error = 1.0 / (1.0 + point) + 0.01 * rng.standard_normal(len(point))
    metrics = {
        KEY: SweepMetric(KEY, "m", "lower", error),
        OVER: SweepMetric(OVER, "1", "lower", np.full(len(point), 2.0)),
        "rate": SweepMetric("rate", "1", "higher", -error),
        "same": SweepMetric("same", "1", "info", np.ones(len(point))),
    }
    return SweepResults(point, (SweepAxis("power", power), SweepAxis("method", method)), metrics)


def test_the_interval_is_students() -> None:
    mean, half, n = mean_interval(np.array([1.0, np.nan, 2.0, 6.0]))
    assert (mean, n) == (3.0, 3)
    assert half == pytest.approx(student.ppf(0.975, 2) * np.std([1, 2, 6], ddof=1) / np.sqrt(3))
    assert mean_interval(np.array([5.0]))[1] == np.inf
    assert np.isnan(mean_interval(np.array([np.nan]))[0])


def test_the_interval_contains_the_mean_at_its_confidence_level() -> None:
    rng = np.random.default_rng(3)
    held = [abs(mean) <= half for mean, half, _ in (mean_interval(rng.standard_normal(5)) for _ in range(2000))]
    assert 0.935 <= np.mean(held) <= 0.965


def test_the_interval_of_a_share_ends_at_one() -> None:
    key = "channel.detection_rate"
    values = np.array([1.0, 1.0, 0.98, 1.0, 0.99])
    mean, half, _ = mean_interval(values)
    assert interval_ends(key, values) == (mean - half, 1.0)
    assert interval_ends("channel.aoa.bias_deg", values - 1) == (mean - 1 - half, mean - 1 + half)
    assert interval_ends(KEY, np.array([0.1, 0.0, 2.0, 0.1]))[0] == 0.0
    results = replace(made(1, 5), metrics={key: SweepMetric(key, "1", "higher", values)})
    assert "0.994 (0.983 to 1)" in axis_tables(results, [key])[0]
    band = axis_figure(results, key).axes[0].collections[0].get_paths()[0].vertices
    assert band[:, 1].max() == pytest.approx(1.0)
    few = replace(results, point=results.point[:2], metrics={key: SweepMetric(key, "1", "higher", values[1:3])})
    few = replace(few, axes=(SweepAxis("power", (0.0, 0.0)),))
    assert "0.99; 0.98 to 1" in axis_tables(few, [key])[0]


@given(st.lists(st.tuples(st.integers(0, 4), st.integers(0, 4)), min_size=1, max_size=12))
def test_the_front_has_the_points_that_no_other_one_beats(rows: list[tuple[int, int]]) -> None:
    costs = np.array(rows, float)
    brute = [not any((other <= row).all() and (other < row).any() for other in costs) for row in costs]
    np.testing.assert_array_equal(nondominated(costs), brute)
    assert not nondominated(np.array([[np.nan, 0.0]])).any()


@given(st.lists(st.floats(-1e3, 1e3), min_size=1, max_size=60))
def test_every_case_is_in_one_group(values: list[float]) -> None:
    parts = groups(SweepAxis("x", tuple(values)))
    np.testing.assert_array_equal(np.sum([part.members for part in parts], axis=0), 1)
    texts = groups(SweepAxis("x", ("b", "a", "b")))
    assert [(part.label, part.members.tolist()) for part in texts] == [
        ("b", [True, False, True]),
        ("a", [False, True, False]),
    ]


def test_bounds_stand_beside_what_they_bound() -> None:
    results = made()
    np.testing.assert_allclose(results.bound(KEY), results.metrics[KEY].value / 2)
    assert results.bound("rate") is None
    panel = axis_figure(results, KEY).axes[0]
    lines = {line.get_label(): line for line in panel.get_lines()}
    expected = [np.mean(results.metrics[KEY].value[results.point == at]) / 2 for at in (1, 3, 5)]  # of method b
    np.testing.assert_allclose(lines["bound, mean"].get_ydata(), expected)
    assert lines["bound, mean"].get_color() == lines["method: b"].get_color()
    assert sum(line.get_linestyle() == "--" for line in panel.get_lines()) == 2
    assert {"method: a", "method: b"} <= set(lines)
    assert varying(results, [KEY, "same", "nothing"]) == [KEY]


def test_the_axis_spans_what_is_drawn_and_no_single_outlier() -> None:
    results = made()
    value = results.metrics["rate"].value.copy()
    value[0] = 1e3
    wild = replace(results, axes=results.axes[:1], metrics={"rate": replace(results.metrics["rate"], value=value)})
    panel = axis_figure(wild, "rate").axes[0]
    means = [np.mean(value[results.point == at]) for at in range(6)]
    low, high = panel.get_ylim()
    assert low < min(means) and max(means) < high < 1e3
    assert len(drawn_values(results, KEY)) == (3 + 3) + 2 * 1 + 6 + 2  # two lines; both methods; their bounds


def test_captions_state_only_what_the_cases_support() -> None:
    single = made(repeats=1)
    assert axis_caption(single, "rate") == (
        "Dots: means of 1 to 3 cases each, which are the crosses: too few for an interval."
    )
    alone = replace(single, axes=single.axes[:1])
    assert axis_caption(alone, "rate") == "One case for each dot, so there are no intervals."
    assert "mean" not in pareto_caption(alone) and "mean" not in parallel_caption(alone, "rate")
    often = replace(made(), axes=made().axes[:1])
    assert axis_caption(often, "rate").startswith("Means of 4 cases each, with the 95 % interval")
    assert "figure" not in axis_caption(often, "rate") and "repeats" in pareto_caption(often)
    assert axis_caption(often, KEY).endswith("Dashed: the bound on the same stops.")
    value = often.metrics["rate"].value.copy()
    value[1:4] = np.nan
    holes = replace(often, metrics={"rate": replace(often.metrics["rate"], value=value)})
    assert "Means of 1 to 4 cases" in axis_caption(holes, "rate")
    assert axis_caption(holes, "rate").endswith("Crosses: cases of means of fewer than 4.")


def test_a_case_is_doubtful_by_all_of_its_scores_and_marked_by_its_poses() -> None:
    results = made(2, 1)
    half = "channel.aoa.over_bound.median"
    metrics = {**results.metrics, half: SweepMetric(half, "1", "lower", np.array([9.0, 1.0]))}
    results = replace(results, metrics=metrics)
    assert results.doubts[0].startswith("channel: errors of detected paths") and not results.doubts[1]
    assert not results.is_doubtful.any()
    far = replace(results, metrics={**metrics, OVER: SweepMetric(OVER, "1", "lower", np.array([2.0, 50.0]))})
    assert far.is_doubtful.tolist() == [False, True] and far.doubts[1].startswith("SLAM: position")


def test_errors_of_other_paths_at_other_points_have_a_note() -> None:
    results, key = made(), "channel.aoa.rmse_deg"
    value = SweepMetric(key, "deg", "lower", np.linspace(0.1, 0.2, 24))

    def caption(detected: list[float], of: str) -> str:
        found = SweepMetric("channel.detected_per_stop", "1", "higher", np.repeat(detected, 4))
        return axis_caption(replace(results, metrics={of: replace(value, key=of), found.key: found}), of)

    note = "errors of detected paths, 5 to 10 per stop"
    assert note in caption([5.0, 6.0, 7.0, 8.0, 9.0, 10.0], key)
    assert note not in caption([5.0, 6.0, 7.0, 8.0, 9.0, 10.0], "channel.false_per_stop")
    assert "errors of detected" not in caption([9.0, 9.1, 9.2, 9.3, 9.4, 9.5], key)


def test_trade_offs_use_the_directions_of_the_metrics() -> None:
    results = made()
    assert front_of(results, KEY, "rate").tolist() == [False] * 5 + [True]  # both are best at the last point
    figure = pareto_figure(results, KEY, "rate")
    assert " ".join(figure.axes[0].get_xlabel().split()) == "Receiver position in plan by SLAM, RMSE in m"
    parallel = parallel_figure(results, [KEY, "rate"])
    assert sum(len(line.get_xdata()) == 4 for line in parallel.axes[0].get_lines()) == 6  # a line per point


def test_points_of_a_front_that_coincide_are_labelled_together() -> None:
    results = made(3, 1)
    same = {
        KEY: SweepMetric(KEY, "m", "lower", np.array([0.1, 0.1, 0.2])),
        "rate": SweepMetric("rate", "1", "higher", np.array([0.9, 0.9, 0.95])),
    }
    texts = [text.get_text() for text in pareto_figure(replace(results, metrics=same), KEY, "rate").axes[0].texts]
    assert texts == ["0, a\n1, b", "2, a"]
    points = np.array([[0.0, 1.0], [5.0, 1.0], [0.0, 1.0], [5.0, 2.0]])
    assert [each.tolist() for each in coinciding(points, np.array([5.0, 1.0]))] == [[0, 2], [1], [3]]
    assert len(coinciding(np.zeros((6, 2)), np.zeros(2))) == 1


def test_the_page_is_whole_and_escapes_names() -> None:
    results = made()
    tables = axis_tables(results, [KEY])
    assert "power" in tables[0] and "±" in tables[0]
    assert "<td>4</td>" in tables[0] and "<td>12: 3 points x 4 seeds</td>" in tables[1]  # powers are pooled
    assert "not that over seeds alone" in "".join(tables)
    one_axis = axis_tables(replace(results, axes=results.axes[:1]), [KEY])
    assert "points" not in "".join(one_axis)
    picture = SweepFigure("a <b>", new_figure(4.0, 3.0), "caption & more")
    page = render_sweep("<sweep>", {"Cases": "1 < 2"}, [("Figures", [picture]), ("Tables", tables)])
    assert "<sweep>" not in page and "&lt;sweep&gt;" in page and "1 &lt; 2" in page
    assert "http" not in page.split("<body")[1] and page.count("data:image/png;base64,") == 1
