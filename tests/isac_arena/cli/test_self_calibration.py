"""Self-calibration in a campaign: made once, stored, used by the estimator, and worth it."""

import json
from pathlib import Path

import numpy as np
import pytest

from estimation.channel.calibration.self_calibration import self_calibrate
from estimation.channel.config import ChannelConfig, SelfCalibrationConfig
from isac_arena.campaign.chain.inputs import channel_estimator
from isac_arena.campaign.config import CampaignConfig
from isac_arena.campaign.directory import CampaignStore
from isac_arena.validation.scenarios.link_bench import draw_paths, make_bench, observe_paths
from tests.command_line import arena_here as arena

CAMPAIGN = """
name = "{name}"
scene = "box_room"
seed = 1

[channel]
method = "auto"
{calibration}
[impairments]
element_gain_std_db = 1.0
element_phase_std_deg = 10.0

[shapes]
eps_m = 1.0
min_samples = 3
"""


def test_a_stored_calibration_is_the_one_that_the_estimator_uses(tmp_path: Path) -> None:
    bench = make_bench(3, element_gain_std_db=1.0, element_phase_std_deg=10.0)
    rng = np.random.default_rng(5)
    drawn = [draw_paths(rng, bench.cell, strongest_db=(35.0, 40.0)) for _ in range(5)]
    sweeps = [observe_paths(bench, paths, stop).sweep for stop, paths in enumerate(drawn)]
    settings = ChannelConfig(method="coherent", self_calibration=SelfCalibrationConfig(stops=5))
    config = CampaignConfig(name="calibrated", scene="box_room", channel=settings)
    store = CampaignStore(tmp_path / "out", config, "")
    store.open_for_writing()
    assert store.calibration() is None
    made = self_calibrate(sweeps, settings.self_calibration)
    store.write_calibration(made)
    stored = store.calibration()
    assert stored is not None
    np.testing.assert_array_equal(stored.tx_codebook.weights, made.tx_codebook.weights)
    np.testing.assert_array_equal(stored.rx_element, made.rx_element)
    nominal, calibrated = (channel_estimator(config, one)(sweeps[0]) for one in (None, stored))
    assert len(nominal) > len(drawn[0])  # ghosts
    assert len(calibrated) <= len(drawn[0])
    again = channel_estimator(config, made)(sweeps[0])
    np.testing.assert_array_equal(again.delay_s, calibrated.delay_s)


@pytest.mark.slow
def test_a_campaign_with_wrong_elements_gains_by_calibration(tmp_path: Path) -> None:
    scores = {}
    for name, calibration in (("plain", '\n[channel.self_calibration]\nuse = "never"\n'), ("calibrated", "")):
        file = tmp_path / f"{name}.toml"
        file.write_text(CAMPAIGN.format(name=name, calibration=calibration))
        result = arena("run", file, "--out", tmp_path / name)
        assert result.returncode == 0, result.stderr
        rows = json.loads((tmp_path / name / "scores.json").read_text())
        scores[name] = {row["key"]: row["value"] for row in rows}
    stored = tmp_path / "calibrated" / "channel" / "calibration.nc"
    assert stored.is_file() and not (tmp_path / "plain" / "channel" / "calibration.nc").exists()
    assert scores["calibrated"]["channel.delay.rmse_ns"] <= 0.5 * scores["plain"]["channel.delay.rmse_ns"]
    assert scores["calibrated"]["channel.weak_per_stop"] >= 1.5 * scores["plain"]["channel.weak_per_stop"]
    assert scores["calibrated"]["channel.coverage95"] >= scores["plain"]["channel.coverage95"]
    assert scores["calibrated"]["channel.false_per_stop"] <= 0.5
    assert scores["calibrated"]["channel.detection_rate"] == 1.0
    assert scores["calibrated"]["channel.los.decision_accuracy"] == 1.0
    assert scores["calibrated"]["slam.position.rmse_m"] < 0.1
    before = stored.read_bytes()
    assert arena("estimate", tmp_path / "calibrated").returncode == 0
    assert stored.read_bytes() == before
