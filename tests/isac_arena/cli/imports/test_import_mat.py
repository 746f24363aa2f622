"""A measured campaign runs through mapping, SLAM, shapes, scores and report like a simulated one."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.io import savemat

from estimation.laws.plane import predict_bounce, predict_los
from estimation.slam.config import TrajectoryConfig
from isac_arena.campaign import stages, stored
from isac_arena.campaign.chain.inputs import known_receiver
from isac_arena.exchange.measurement import import_campaign
from scenes.pose import Pose

TX = Pose(np.array([2.25, 2.5, 0.0]), -np.pi / 2)
POINTS = np.array(
    [[2.934, -4.203], [0.26, -4.1], [4.52, 1.0], [0.0, 0.5], [-0.2, -8.95], [-5.4, -6.7]]
)  # on two pillars, both corridor faces, the ring and a third pillar


def made_up_file(folder: Path) -> Path:
    """Twelve stops along the walk with a line of sight and six single bounces each, exact, no TX offset."""
    n = 12
    rx = np.column_stack([np.linspace(0.5, 4.0, n), np.full(n, -2.3), np.zeros(n)])
    cells = {name: np.empty((1, n), object) for name in ("y", "power", "inlier", "MU")}
    for stop in range(n):
        state = np.array([*rx[stop], 0.0])
        y = np.vstack([predict_los(TX, state), predict_bounce(TX, state, POINTS)])
        cells["y"][0, stop] = y.T
        cells["power"][0, stop] = (-13 - 17 * np.log10(y[:, 0]) - np.r_[0, np.full(6, 10)])[None]
        is_los = np.arange(7) == 0
        cells["inlier"][0, stop] = np.vstack([is_los, ~is_los]).astype(float)
        cells["MU"][0, stop] = np.column_stack([[np.nan, np.nan], POINTS.T])
    tx = np.tile([[2.25], [2.5], [-np.pi / 2]], n)
    path = folder / "walk.mat"
    savemat(path, {"sim": {"tx": tx, "rx": rx.T, **cells}})
    return path


@pytest.fixture(scope="module")
def directory(tmp_path_factory):
    folder = tmp_path_factory.mktemp("measured")
    out = folder / "campaign"
    file = made_up_file(folder)
    assert (
        import_campaign(file, out, tx_offset_deg=0.0, clock_seed=2, method="statistical", scene="campus_arena")
        == 12
    )
    store = stages.reopen(out)
    stages.sweep_and_estimate(store, keep_sweeps=False)
    stages.build_maps(store)
    stages.write_scores(store)
    stages.write_report(store)
    return out


def test_scores_of_an_exact_measurement(directory):
    scores = {row["key"]: row["value"] for row in json.loads((directory / "scores.json").read_text())}
    assert scores["slam.position.rmse_m"] < 0.02  # the prior of the walk, beside noise of 1 ns and 1 deg
    assert scores["slam.clock.rmse_ns"] < 0.1
    assert scores["slam.los.stops"] == 12
    assert scores["mapping.ip_position.rms_m"] < 1e-6
    assert scores["mapping.ip_to_surface.median_m"] < 0.05
    assert scores["mapping.objects_found.pillar"] >= 2
    assert scores["channel.estimated_per_stop"] == 7


def test_stops_alone_are_exact(directory):
    store = stages.reopen(directory)
    run = stages.campaign_run(store)
    config = run.config.model_copy(update={"trajectory": TrajectoryConfig(method="single")})
    channel = [estimate.channel for estimate in stored.channel_estimates(store, 12)]
    poses, _ = replace(run, config=config).locate(channel)
    truth = known_receiver(stored.measured_truths(store, 12))
    assert np.allclose(poses.position_m, truth.position_m, atol=1e-3)
    assert np.allclose(poses.clock_bias_s, truth.clock_bias_s, atol=1e-11)


def test_scores_that_need_true_paths_are_null(directory):
    scores = {row["key"]: row["value"] for row in json.loads((directory / "scores.json").read_text())}
    for key in ("detection_rate", "false_per_stop", "delay.rmse_ns", "los.decision_accuracy", "nees"):
        assert scores[f"channel.{key}"] is None


def test_the_report_says_what_was_measured(directory):
    page = (directory / "report.html").read_text()
    assert "walk.mat" in page and page.count("data:image/png;base64,") >= 4
    names = {file.stem for file in (directory / "figures").glob("*.png")}
    assert "map" in names and "power_map" not in names


def test_a_measured_campaign_takes_no_channel_estimator_and_no_other_file(directory, tmp_path):
    with (
        pytest.raises(ValueError, match="is measured and holds no samples"),
        stages.reopened(directory, {"channel": "my.module:function"}),
    ):
        pass
    file = made_up_file(tmp_path)
    with pytest.raises(ValueError, match="holds another campaign"):
        import_campaign(
            file, directory, tx_offset_deg=-1.6, clock_seed=2, method="statistical", scene="campus_arena"
        )
    with pytest.raises(ValueError, match="--method = 'best': must be one of reference, statistical"):
        import_campaign(
            file, tmp_path / "x", tx_offset_deg=0.0, clock_seed=None, method="best", scene="campus_arena"
        )
