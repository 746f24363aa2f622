"""Checks of this machine and environment: can they run the chain, and what to do about each problem."""

import math
import os
import platform
import re
import shutil
import subprocess
import sys
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from typing import Literal

from scenes.memory import free_bytes
from sim.propagation.llvm import (
    LLVM_VARIABLE,
    MIN_LLVM_VERSION,
    find_llvm,
    llvm_install_command,
    mitsuba_variant,
    n_cuda_devices,
    probe_llvm,
)

Status = Literal["ok", "warn", "fail"]

PROJECT = "isac-arena"
LOCK_FILE = Path(__file__).resolve().parents[1] / "requirements.lock"  # of a checkout
REINSTALL = "run scripts/test, or: python -m pip install --require-hashes -r requirements.lock"

MIN_PYTHON = (3, 11)
GIB = 2**30
LOW_MEMORY_GIB = 4.0
LOW_DISK_GIB = 2.0

SIONNA_CODE = """
import sys
import mitsuba
mitsuba.set_variant(sys.argv[1])
import sionna.rt
print(sionna.rt.__version__)
"""


@dataclass(frozen=True)
class Check:
    """One check: name, status, finding, and what to do where it is not ok."""

    name: str
    status: Status
    detail: str
    remedy: str = ""


def doctor_report() -> list[Check]:
    """All checks of this machine and environment, in the order in which to solve problems.

    Dr.Jit and Sionna are tried in subprocesses, because a wrong LLVM aborts the process that loads it.
    """
    llvm, disk = check_llvm(), check_disk(Path.cwd())
    return [check_python(), check_packages(), llvm, check_sionna(llvm), check_kernels(), check_memory(), disk]


def check_python(version: tuple[int, int] = sys.version_info[:2]) -> Check:
    """The interpreter is Python 3.11 or later."""
    detail = f"Python {platform.python_version()} ({sys.executable})"
    if version < MIN_PYTHON:
        found = ".".join(map(str, version))
        return Check("python", "fail", f"Python {found}", "install Python 3.11 or later")
    return Check("python", "ok", detail)


def check_packages(lock_file: Path = LOCK_FILE) -> Check:
    """The installed packages are the pinned ones; only missing runtime packages are a failure."""
    if not lock_file.is_file():
        return _check_unpinned_packages()
    pins = read_pins(lock_file)
    installed = {name: installed_version(name) for name in pins}
    missing = [name for name, version in installed.items() if version is None]
    other = [
        f"{name} {version} (pinned {pins[name]})"
        for name, version in installed.items()
        if version not in (None, pins[name])
    ]
    if needed := sorted(set(missing) & runtime_requirements()):
        return Check("packages", "fail", f"missing: {_listed(needed)}", REINSTALL)
    if missing or other:
        found = {"missing": missing, "other": other}
        texts = [f"{word}: {_listed(names)}" for word, names in found.items() if names]
        return Check("packages", "warn", "; ".join(texts), REINSTALL)
    return Check("packages", "ok", f"{len(pins)} packages as pinned in {lock_file.name}")


def _check_unpinned_packages() -> Check:
    """The packages that the project needs are there; outside a checkout no lock file pins their versions."""
    needed = runtime_requirements()
    missing = sorted(name for name in needed if installed_version(name) is None)
    if missing:
        return Check("packages", "fail", f"missing: {_listed(missing)}", f"python -m pip install {PROJECT}")
    detail = f"{len(needed)} packages are installed; only a checkout pins their versions"
    return Check("packages", "ok", detail)


def check_llvm() -> Check:
    """A libLLVM that compiles and runs a kernel; needed only where there is no CUDA device."""
    path = find_llvm()
    if path is None:
        problem = f"no libLLVM {MIN_LLVM_VERSION} or later found"
    elif not path.exists():
        problem = f"{path}: no such file"
    else:
        outcome = probe_llvm(path)
        if outcome.ok:
            return Check("llvm", "ok", f"LLVM {outcome.version} compiles ({path})")
        problem = f"{path}: {outcome.error}"
    if n_cuda_devices():
        return Check("llvm", "ok", f"{problem}; not needed, CUDA is used")
    chosen = f"unset {LLVM_VARIABLE}, or: " if LLVM_VARIABLE in os.environ else ""
    return Check("llvm", "fail", problem, f"{chosen}{llvm_install_command()}")


def check_sionna(llvm: Check, timeout_s: float = 120.0) -> Check:
    """Sionna RT loads in the variant that the tracer would choose: CUDA where there is a device, else LLVM."""
    chosen = mitsuba_variant()
    if not n_cuda_devices() and llvm.status == "fail":
        return Check("sionna", "fail", f"{chosen} not tried, it needs LLVM", "solve the llvm problem first")
    environment = dict(os.environ)
    if (path := find_llvm()) is not None:
        environment[LLVM_VARIABLE] = str(path)
    try:
        done = subprocess.run(
            [sys.executable, "-c", SIONNA_CODE, chosen],
            env=environment, capture_output=True, text=True, timeout=timeout_s, check=False,
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        return Check("sionna", "fail", f"{chosen}: no answer within {timeout_s:g} s", REINSTALL)
    if done.returncode != 0:
        lines = done.stderr.strip().splitlines() or [f"exit status {done.returncode}"]
        return Check("sionna", "fail", f"{chosen}: {lines[-1]}", REINSTALL)
    return Check("sionna", "ok", f"Sionna RT {done.stdout.split()[-1]} in {chosen}")


def check_kernels() -> Check:
    """The loops that numba compiles are on disk; where they are not, the first run compiles them."""
    try:
        from isac_arena.kernels import kernels_compiled  # noqa: PLC0415  (brings numba)
    except (ImportError, RuntimeError) as error:
        return Check("kernels", "warn", f"numba cannot load them: {error}", "solve problems of packages first")
    if kernels_compiled():
        return Check("kernels", "ok", "compiled for these sources and this machine")
    todo = "nothing: the first run compiles them, once, in minutes; in a checkout scripts/bootstrap.sh does"
    return Check("kernels", "warn", "not compiled yet", todo)


def check_memory(available_gib: float | None = None) -> Check:
    """Memory that a run can take without swapping, within the limit of the container if there is one."""
    available = available_memory_gib() if available_gib is None else available_gib
    if available is None:
        return Check("memory", "warn", "this system does not say how much is available")
    detail = f"{available:.1f} GiB available, {os.cpu_count()} CPUs"
    if available < LOW_MEMORY_GIB:
        return Check("memory", "warn", detail, f"free some: a run wants about {LOW_MEMORY_GIB:g} GiB")
    return Check("memory", "ok", detail)


def check_disk(directory: Path) -> Check:
    """Free space in the folder a run would write to."""
    free_gib = shutil.disk_usage(directory).free / GIB
    detail = f"{free_gib:.1f} GiB free in {directory}"
    if free_gib < LOW_DISK_GIB:
        return Check("disk", "warn", detail, f"free some: a campaign wants up to {LOW_DISK_GIB:g} GiB")
    return Check("disk", "ok", detail)


def available_memory_gib() -> float | None:
    """Memory available to this process in GiB, None where the system does not report it."""
    free = free_bytes() / GIB
    return free if math.isfinite(free) else None


def read_pins(lock_file: Path) -> dict[str, str]:
    """Version of each package that a lock file pins, by normalised name; hashes are left out."""
    lines = (line.partition("#")[0].strip(" \\") for line in lock_file.read_text(encoding="utf-8").splitlines())
    pairs = (line.split("==", 1) for line in lines if line and not line.startswith("--hash="))
    return {normalised(name): version for name, version in pairs}


def runtime_requirements() -> set[str]:
    """Normalised names of the requirements of the installed project, without its extras."""
    try:
        requirements = metadata.requires(PROJECT) or []
    except metadata.PackageNotFoundError:
        return set()
    return {normalised(re.split(r"[^\w.-]", line)[0]) for line in requirements if "extra ==" not in line}


def installed_version(name: str) -> str | None:
    """Version of an installed package, None where it is missing."""
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return None


def normalised(name: str) -> str:
    """A package name as PEP 503 compares it."""
    return re.sub(r"[-_.]+", "-", name).lower()


def _listed(names: list[str], n_shown: int = 5) -> str:
    rest = len(names) - n_shown
    return ", ".join(names[:n_shown]) + (f" and {rest} more" if rest > 0 else "")
