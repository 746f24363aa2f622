"""The start of a command: `arena estimate` on a finished campaign, until its first stop would begin."""

import io
import resource
import subprocess
import sys
import tempfile
from contextlib import redirect_stdout
from pathlib import Path

import numpy as np

from isac_arena.campaign import stages
from isac_arena.campaign.campaign import load_campaign
from isac_arena.kernels import TINY, child_environment
from isac_arena.validation.measurement import Measurement, at_most
from scenes.record import FloatArray

PAIRS, QUICK_PAIRS = 9, 2
BAR = 4.0
IMPORTS = "import numpy, scipy.linalg"
STARTED = 7  # exit status of a command that came to its first stop
COMMAND = f"""
import os, sys
import isac_arena.cli.main
from isac_arena.campaign import stages
stages.make_stops = lambda *arguments: os._exit({STARTED})
sys.argv[:] = ["arena", "estimate", sys.argv[1]]
isac_arena.cli.main.main()
"""


def bench_start(seed: int, quick: bool) -> list[Measurement]:
    """Processor times of processes in turns: the command until its first stop, and the imports of any such."""
    campaign = load_campaign("box_room", seed=seed, **TINY, **{"channel.method": "power"})
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder, "run")
        with redirect_stdout(io.StringIO()), stages.opened(campaign, out, None) as store:
            stages.sweep_and_estimate(store, keep_sweeps=False)
            stages.build_maps(store)
        times_s = np.array([_pair_s(out) for _ in range(1 + (QUICK_PAIRS if quick else PAIRS))])[1:]
    ratios = times_s[:, 0] / times_s[:, 1]
    command_ms, imports_ms = 1e3 * np.median(times_s, axis=0)
    about = (
        f"'arena estimate' {command_ms:.0f} ms over '{IMPORTS}' {imports_ms:.0f} ms, {len(ratios)} pairs; "
        f"from {ratios.min():.2f} to {ratios.max():.2f}"
    )
    return [at_most("campaign.start_over_imports", np.median(ratios), BAR, about, "imports")]


def _pair_s(out: Path) -> FloatArray:
    """Processor times in s of the command and of the imports, one after the other."""
    return np.array([_process_s(STARTED, COMMAND, str(out)), _process_s(0, IMPORTS)])


def _process_s(status: int, *code: str) -> float:
    """Processor time of a Python process in s; `RuntimeError` where it does not end with this status."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    command = [sys.executable, "-c", *code]
    done = subprocess.run(command, env=child_environment(), capture_output=True, text=True, check=False)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    if done.returncode != status:
        raise RuntimeError(f"the process of {code[-1]} ended with {done.returncode}: {done.stderr[-500:]}")
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
