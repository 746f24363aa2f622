import csv

import pytest
from typer.testing import CliRunner

from isac_arena.cli.main import app
from isac_arena.validation.shape import gp_study

runner = CliRunner()


@pytest.fixture
def few_points(monkeypatch):
    monkeypatch.setattr(gp_study, "N_POINTS", (4, 16))
    monkeypatch.setattr(gp_study.study, "__defaults__", ((4, 16), tuple(gp_study.MODES)))


def test_study_writes_figures_and_a_table(tmp_path, few_points):
    result = runner.invoke(app, ["study", "gp-synthetic", "--out", str(tmp_path), "--runs", "2", "--seed", "3"])
    assert result.exit_code == 0, result.output
    for name in ("radial_function.png", "contour.png", "rmse.png"):
        assert (tmp_path / name).read_bytes().startswith(b"\x89PNG")
    with (tmp_path / "rmse.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == len(gp_study.MODES) * len(gp_study.SHAPES) * 2
    assert all(0 <= float(row["rmse_m"]) < 1 for row in rows)


def test_same_seed_same_study():
    first, second = (gp_study.run_cell("paper", "star", 8, 3, 5) for _ in range(2))
    assert (first.rmse_m == second.rmse_m).all()


def test_example_is_a_contour_about_its_centre_and_is_found():
    shown = gp_study.example(2, "data-driven")
    assert shown.true_radius_m.min() >= gp_study.EXAMPLE_SMALLEST_RADIUS_M
    assert abs(shown.mean_m - shown.true_radius_m).mean() < 0.1
    assert len(shown.point_angle_rad) == gp_study.EXAMPLE_N_POINTS
