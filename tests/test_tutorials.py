"""The tutorials in docs/tutorials do what they say: files are written, commands and code run, in order."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from markdown_it import MarkdownIt

from isac_arena.campaign.directory import StopEstimate
from isac_arena.campaign.files import write_record
from isac_arena.validation.scenarios.perfect_campaign import make_campaign

ROOT = Path(__file__).resolve().parents[1]
TUTORIALS = sorted((ROOT / "docs" / "tutorials").glob("*.md"))
OCTAVE = ROOT / "docs" / "octave" / "read_channel.m"


def run(command: list[str], folder: Path) -> str:
    environment = {**os.environ, "PYTHONPATH": f"{ROOT}{os.pathsep}{folder}", "COLUMNS": "100"}
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, f"{command}\n{done.stdout}\n{done.stderr}"
    return done.stdout


@pytest.mark.parametrize("tutorial", TUTORIALS, ids=lambda path: path.stem)
def test_tutorial(tutorial: Path, tmp_path: Path) -> None:
    blocks = [token for token in MarkdownIt().parse(tutorial.read_text()) if token.type == "fence"]
    assert blocks
    for block in blocks:
        language, _, about = block.info.partition(" ")
        if about.startswith("file="):
            (tmp_path / about.removeprefix("file=")).write_text(block.content)
        elif language == "sh":
            for line in block.content.splitlines():
                name, *arguments = line.split()
                assert name == "arena"
                run([sys.executable, "-c", "from isac_arena.cli.main import main; main()", *arguments], tmp_path)
        elif language == "python":
            run([sys.executable, "-c", block.content], tmp_path)


@pytest.mark.skipif(shutil.which("octave-cli") is None, reason="Octave is not installed")
def test_octave_reads_a_channel_file(tmp_path: Path) -> None:
    campaign = make_campaign()
    estimate, power_map = campaign.results.channel[0], campaign.results.power_maps[0]
    write_record(tmp_path / "stop.nc", StopEstimate(estimate, power_map), {})
    command = ["octave-cli", "-q", str(OCTAVE), str(tmp_path / "stop.nc")]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if "package netcdf" in done.stderr:
        pytest.skip("Octave has no netcdf package")
    lines = done.stdout.splitlines()
    assert lines[0] == f"{len(estimate)} paths"
    assert float(lines[1].split()[0]) == pytest.approx(1e9 * estimate.delay_s[0], abs=1e-3)
