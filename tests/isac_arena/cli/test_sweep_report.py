import json
import shutil
from pathlib import Path

from typer.testing import CliRunner, Result

from isac_arena.cli.main import app
from isac_arena.sweep.store import is_done, read_plan


def report(folder: Path, *options: str) -> Result:
    return CliRunner().invoke(app, ["sweep-report", str(folder), *options])


def test_a_finished_sweep_has_figures_and_tables(undisturbed: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    shutil.copytree(undisturbed / "out", out)
    result = report(out)
    assert result.exit_code == 0, result.output
    page = (out / "sweep_report.html").read_text()
    assert page.count("data:image/png;base64,") >= 5 and "http" not in page.split("<body")[1]
    assert "8 of 8 done, 0 failed" in page and "Parallel coordinates" in page
    options = ("--metric", "channel.delay.rmse_ns", "--pareto", "channel.delay.rmse_ns,channel.aoa.rmse_deg")
    assert report(out, *options).exit_code == 0
    page = (out / "sweep_report.html").read_text()
    assert "Paths: delay, RMSE against Paths: angle of arrival, RMSE" in page and "Receiver position" not in page
    assert "Score: channel.delay.rmse_ns." in page


def test_an_unfinished_sweep_tells_its_pace_and_its_failures(undisturbed: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    shutil.copytree(undisturbed / "out", out)
    cases = read_plan(out)
    for case in cases[:4]:
        shutil.rmtree(out / "cases" / case.key)
    assert sum(is_done(out, case.key) for case in cases) == 4
    (out / "failures").mkdir(exist_ok=True)
    (out / "failures" / f"{cases[0].key}.json").write_text(json.dumps({"error": "ValueError: a <bad> case"}))
    assert report(out).exit_code == 0
    page = (out / "sweep_report.html").read_text()
    assert "4 of 8 done, 1 failed" in page and "3 remain, about" in page
    assert "a &lt;bad&gt; case" in page and "power = 0.0, seed 1" in page


def test_a_damaged_case_is_named_and_left_out(undisturbed: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    shutil.copytree(undisturbed / "out", out)
    first, second, third, fourth = (out / "cases" / case.key for case in read_plan(out)[:4])
    (first / "provenance.nc").unlink()
    (second / "manifest.json").unlink()
    (third / "campaign.json").write_bytes((third / "campaign.json").read_bytes()[:-2])
    (fourth / "scores.json").write_text("[]")
    result = report(out)
    assert result.exit_code == 1 and "4 damaged cases; 'arena sweep'" in result.output
    told = "".join(result.output.split())
    assert f"{first.name}/provenance.nc:missing" in told and f"{third.name}/campaign.json:damaged" in told
    page = (out / "sweep_report.html").read_text()
    assert "4 of 8 done, 0 failed, 4 damaged" in page and "4 damaged cases" in page
    (out / "manifest.json").unlink()
    assert "manifest.json: missing; a finished run writes it" in str(report(out).exception)


def test_what_cannot_be_shown_is_one_line(undisturbed: Path, tmp_path: Path) -> None:
    assert "holds no sweep" in str(report(tmp_path).exception)
    assert "--metric = 'nothing'" in str(report(undisturbed / "out", "--metric", "nothing").exception)
    assert "--pareto = 'one'" in str(report(undisturbed / "out", "--pareto", "one").exception)
