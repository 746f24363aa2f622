"""The tutorials in docs/tutorials do what they say: files are written, commands and code run, in order."""

import shutil
import subprocess
from pathlib import Path

import pytest
from markdown_it import MarkdownIt

from isac_arena.campaign.files import write_record
from isac_arena.campaign.results import StopEstimate
from isac_arena.validation.scenarios.perfect_campaign import make_campaign
from tests.command_line import ROOT, arena_here

pytestmark = pytest.mark.whole  # whole commands: `.ci/run` runs them after the quick tests

TUTORIALS = sorted((ROOT / "docs" / "tutorials").glob("*.md"))
OCTAVE = ROOT / "docs" / "octave" / "read_channel.m"


@pytest.mark.parametrize("tutorial", TUTORIALS, ids=lambda path: path.stem)
def test_tutorial(tutorial: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    blocks = [token for token in MarkdownIt().parse(tutorial.read_text()) if token.type == "fence"]
    assert blocks
    for block in blocks:
        language, _, about = block.info.partition(" ")
        if about.startswith("file="):
            Path(about.removeprefix("file=")).write_text(block.content)
        elif language == "sh":
            for line in block.content.splitlines():
                name, *arguments = line.split()
                assert name == "arena"
                done = arena_here(*arguments, cwd=tmp_path, columns=100)
                assert done.returncode == 0, f"{line}\n{done.stdout}\n{done.stderr}"
        elif language == "python":
            exec(compile(block.content, tutorial.name, "exec"), {})


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
