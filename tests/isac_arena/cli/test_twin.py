"""`arena twin` on a made-up measurement file, and the real one where it is at hand."""

import csv
import json

import numpy as np
import pytest
from scipy.io import savemat
from typer.testing import CliRunner

from isac_arena.cli.main import app
from isac_arena.exchange.measurement import import_campaign
from isac_arena.validation import twin as validation
from isac_arena.validation.measured_data import FILE, data_folder
from tests.isac_arena.insight.twin.made_twin import make

runner = CliRunner()


@pytest.fixture(scope="module")
def measured(tmp_path_factory):
    """The made-up room as a measurement file, imported."""
    made = make(np.random.default_rng(1))
    n = len(made.campaign.truths)
    cells = {name: np.empty((1, n), object) for name in ("y", "power", "inlier", "MU")}
    for stop, (estimate, truth) in enumerate(zip(made.campaign.channel, made.campaign.truths, strict=True)):
        range_m = 299_792_458.0 * (estimate.delay_s - truth.clock_bias_s)
        y = np.vstack([range_m, estimate.aod_azimuth_rad, estimate.aoa_azimuth_rad])
        cells["y"][0, stop], cells["power"][0, stop] = y, estimate.power_dbm[None]
        cells["inlier"][0, stop] = np.vstack([truth.is_los, truth.is_single_bounce]).astype(float)
        cells["MU"][0, stop] = np.where(truth.is_single_bounce, 3.0, np.nan) * np.ones((2, 1))
    tx = np.tile([[1.5], [4.0], [0.0]], n)
    rx = np.array([[*truth.rx_pose.position_m[:2], np.pi] for truth in made.campaign.truths]).T
    folder = tmp_path_factory.mktemp("twin")
    savemat(folder / "room.mat", {"sim": {"tx": tx, "rx": rx, **cells}})
    import_campaign(
        folder / "room.mat", folder / "campaign", tx_offset_deg=0.0, clock_seed=3, method="statistical",
        scene="box_room",
    )  # fmt: skip
    return folder / "campaign"


def test_tables_and_figures_of_an_exact_measurement(measured, tmp_path):
    result = runner.invoke(app, ["twin", str(measured), "--out", str(tmp_path)])
    assert result.exit_code == 0, result.output
    content = json.loads((tmp_path / "twin.json").read_text(encoding="utf-8"))
    value = {row["key"]: row["value"] for row in content["metrics"]}
    for model in ("one_bounce", "two_bounces", "three_bounces"):
        assert value[f"twin.{model}.explained.narrow"] > 0.9  # floor and ceiling bounces are the same path
        assert value[f"twin.{model}.delay.rms_ns"] < 0.05
    assert value["twin.los_agreement.stops"] == 12
    assert len(content["offsets"]["delay_s"]) == 12
    assert content["objects"]["one_bounce"][0]["n"] >= 10
    with (tmp_path / "twin_paths.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert {row["model"] for row in rows} == {"one_bounce", "two_bounces", "three_bounces"}
    assert {"stop", "landmark_x_m", "chain", "delay_residual_s", "predicted_dbm"} <= set(rows[0])
    assert all((tmp_path / name).read_bytes()[1:4] == b"PNG" for name in ("twin_map.png", "twin_residuals.png"))


def test_a_simulated_campaign_is_refused(tmp_path):
    from isac_arena.campaign import stages  # noqa: PLC0415

    stages.prepare("box_room", tmp_path / "made", None)
    result = runner.invoke(app, ["twin", str(tmp_path / "made"), "--out", str(tmp_path / "out")])
    assert "holds a simulated campaign; a twin needs a measured one" in str(result.exception)
    assert not (tmp_path / "out").exists()


def test_without_the_measurement_every_row_says_so(monkeypatch, tmp_path):
    monkeypatch.setenv("ARENA_DATA", str(tmp_path))
    rows = [
        row
        for check in (validation.check_explained_paths, validation.check_power, validation.check_calibrated)
        for row in check(1, True)
    ]
    assert rows and all(np.isnan(row.value) and not row.met for row in rows)
    assert all(row.reason.startswith(f"not measured: {FILE} is not in") for row in rows)


@pytest.mark.skipif(not (data_folder() / FILE).is_file(), reason=f"{FILE} is not at hand, see ARENA_DATA")
def test_the_plain_twin_of_the_measured_hall_meets_its_bars(monkeypatch):
    monkeypatch.setattr(validation, "QUICK", ("one_bounce",))
    rows = {row.key: row for row in [*validation.check_explained_paths(1, True), *validation.check_power(1, True)]}
    assert len(rows) == 7
    missed = [f"{key}: {row.value:.3g}, bar {row.bar:g}" for key, row in rows.items() if not row.met]
    assert not missed
