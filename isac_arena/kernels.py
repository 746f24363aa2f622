"""The compiled kernels: whether they are on disk, and tiny runs that compile what the library of campaigns needs.

Numba compiles a kernel for the types of its arguments, at its first call, and keeps it on disk. Types follow from
records, so a run of the real chain is the only list of them that does not go out of date. A marker beside the
kernels says that they were compiled, from which sources and for which machine: reading it takes milliseconds.
"""

import json
import os
import platform
import subprocess
import sys
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import llvmlite.binding  # type: ignore[import-untyped]
import numba
from numba.core.dispatcher import Dispatcher
from rich.console import Console

from estimation.channel.model.kernels import unit_vectors
from estimation.kernel_cache import OWN_PACKAGES, source_digest
from isac_arena.campaign.campaign import load_campaign
from isac_arena.campaign.driver import CampaignRun
from isac_arena.own_packages import ROOT
from isac_arena.progress import working
from isac_arena.workers.workers import n_cores

MARKER = "isac_arena_kernels.json"
TINY: dict[str, Any] = {
    "waveform.n_rb": 132, "propagation.diffuse_samples": 0, "propagation.diffraction": False,
    "propagation.compare_planar": False,
}  # fmt: skip
FEW = TINY | {"propagation.max_bounces": 1, "channel.maximum_likelihood.max_paths": 8}
POWER = FEW | {"channel.method": "power"}
WARM_UPS: tuple[tuple[str, dict[str, Any], int], ...] = (  # campaign, settings, and so many stops at most
    ("box_room", TINY, 4),  # all channel methods, mapping, SLAM, contours
    ("box_room_heights", FEW, 4),  # elevations: paths and states in space
    ("moving_target", FEW, 6),  # samples of a world that moves, tracks
    ("campus_arena_hardware", FEW, 2),  # phases that walk, considered errors
    ("campus_arena_three", POWER, 8),  # SLAM of several TX, long published contours
    ("warehouse", POWER, 6),  # contours of long walls
)


def kernels_compiled() -> bool:
    """Whether the kernels on disk are those of these sources and of this machine."""
    if numba.config.DISABLE_JIT:
        return True
    try:
        kept = json.loads(_marker().read_text(encoding="utf-8"))
        return (
            kept["machine"] == _machine()
            and all(source_digest(ROOT / name) == digest for name, digest in kept["sources"].items())
            and all(Path(name).is_file() for name in kept["files"])
        )
    except (OSError, ValueError, KeyError, TypeError):
        return False


def ensure_kernels(console: Console) -> None:
    """Compile the kernels where they are not, with a line of progress; they stay on disk.

    A failure is one line: the run itself compiles what it needs.
    """
    if kernels_compiled():
        return
    with working(console, "compiling kernels, once"):
        problem = compile_side_by_side()
    if problem:
        console.print(f"kernels: {problem}; they are compiled where they are first used", markup=False)


def compile_side_by_side() -> str:
    """Compile all kernels in processes of their own, on two cores where there are; what went wrong, or nothing."""
    with ExitStack() as stack:
        every = stack.enter_context(_started("compile_kernels"))
        if n_cores() > 1:
            second = stack.enter_context(_started("compile_late_ones"))
            stack.callback(second.kill)  # what it has not compiled by then, the first has
        stack.callback(every.kill)
        errors = every.communicate()[1].strip().splitlines()
    return "" if not every.returncode else (errors or [f"exit status {every.returncode}"])[-1]


def compile_kernels() -> None:
    """Compile all kernels in this process by tiny runs of the whole chain, and leave the marker."""
    for one in WARM_UPS:
        tiny_run(*one).scores()
    _write_marker()


def compile_late_ones() -> None:
    """Compile SLAM and what the last tiny runs need: in a second process, before the first one needs them."""
    run = tiny_run("box_room", POWER, 4)
    run.locate(list(run.channel(list(run.truths()))))
    for one in reversed(WARM_UPS[1:]):
        tiny_run(*one).scores()


def kernels() -> dict[Path, list[Dispatcher]]:
    """The kernels of the modules of ours that are loaded, by the file of the module."""
    found: dict[Path, list[Dispatcher]] = {}
    for name, module in sys.modules.items():
        own = [each for each in vars(module).values() if isinstance(each, Dispatcher)]
        if name.partition(".")[0] in OWN_PACKAGES and module.__file__:
            found[Path(module.__file__)] = [each for each in own if each.py_func.__module__ == name]
    return {path: each for path, each in found.items() if each}


def tiny_run(name: str, settings: dict[str, Any], most_stops: int) -> CampaignRun:
    """The chain over at most so many stops, spread over the walk."""
    campaign = load_campaign(name, **settings)
    n_stops = len(campaign.stops)
    return campaign.chain(range(0, n_stops, -(-n_stops // most_stops)))


def child_environment() -> dict[str, str]:
    """The environment of a Python process that finds this package, with one thread for each library."""
    paths = os.pathsep.join(filter(None, (str(ROOT), os.environ.get("PYTHONPATH"))))
    return os.environ | {"PYTHONPATH": paths, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}


def _started(function: str) -> subprocess.Popen[str]:
    """A process that calls a function of this module; it says nothing but errors."""
    code = f"from {__name__} import {function}; {function}()"
    return subprocess.Popen(
        [sys.executable, "-c", code],
        env=child_environment(), text=True, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE,
    )  # fmt: skip


def _marker() -> Path:
    """The marker, in the folder where numba keeps a kernel of ours."""
    kernel: Any = unit_vectors
    return Path(kernel.stats.cache_path) / MARKER


def _machine() -> list[str]:
    """What else kernels are compiled for."""
    return [numba.__version__, platform.python_version(), llvmlite.binding.get_host_cpu_name()]


def _write_marker() -> None:
    files: set[str] = set()
    found = kernels()
    for path, each in found.items():
        for folder in {str(kernel.stats.cache_path) for kernel in each}:
            files |= {str(file) for file in Path(folder).glob(f"{path.stem}.*.nbi")}
    sources = {path.relative_to(ROOT).as_posix(): source_digest(path) for path in found}
    content = {"machine": _machine(), "sources": sources, "files": sorted(files)}
    part = _marker().with_suffix(f".{os.getpid()}.part")
    part.write_text(json.dumps(content, indent=1), encoding="utf-8")
    part.replace(_marker())
