"""Choice of the LLVM library for the just-in-time compiler of the ray tracer, before Dr.Jit is imported.

Dr.Jit aborts the whole process, without an exception, when it compiles with LLVM 16 or older. So the library is
chosen by its version. `probe_llvm` tests a library in a separate process.
"""

import ctypes
import os
import re
import shutil
import subprocess
import sys
from dataclasses import dataclass
from functools import cache
from pathlib import Path

LLVM_VARIABLE = "DRJIT_LIBLLVM_PATH"
MIN_LLVM_VERSION = 17
CUDA_VARIANT = "cuda_ad_mono_polarized"
LLVM_VARIANT = "llvm_ad_mono_polarized"

SEARCH_PATTERNS = (
    "/usr/lib/*-linux-gnu/libLLVM*.so*",
    "/usr/lib/llvm-*/lib/libLLVM*.so*",
    "/usr/lib64/libLLVM*.so*",
    "/usr/lib64/llvm*/lib*/libLLVM*.so*",
    "/usr/lib/libLLVM*.so*",
    "/usr/local/lib/libLLVM*.so*",
    "/opt/homebrew/opt/llvm*/lib/libLLVM*.dylib",
    "/usr/local/opt/llvm*/lib/libLLVM*.dylib",
)

PROBE_CODE = """
import drjit as dr
from drjit.llvm import Float
x = dr.maximum(dr.arange(Float, 8), 1.5) + dr.minimum(dr.arange(Float, 8), 2.5)
assert abs(dr.sum(x)[0] - 45.5) < 1e-3, x
print(".".join(str(part) for part in dr.detail.llvm_version()))
"""


class LlvmError(RuntimeError):
    """No usable LLVM library; the message is one line and says how to install one."""


@dataclass(frozen=True)
class LlvmProbe:
    """Outcome of compiling and running a small kernel with one LLVM library."""

    ok: bool
    version: str
    error: str


def llvm_version(path: Path | str) -> int | None:
    """Major version from the file name of the library, its link target or its folder; None if unknown.

    Known forms are libLLVM.so.19.1, libLLVM-19.so.1, libLLVM.19.dylib and .../llvm-19/lib/libLLVM.so.
    """
    path = Path(path)
    for name in (path.name, path.resolve().name):
        found = re.match(r"libLLVM[-.]?(\d+)", name) or re.match(r"libLLVM\.so\.(\d+)", name)
        if found:
            return int(found[1])
    for folder in (*path.parts[::-1], *path.resolve().parts[::-1]):
        found = re.fullmatch(r"llvm[-@]?(\d+)", folder)
        if found:
            return int(found[1])
    return None


def find_llvm(patterns: tuple[str, ...] = SEARCH_PATTERNS) -> Path | None:
    """The library in `DRJIT_LIBLLVM_PATH`, else the newest one (version 17 or later) on the system."""
    chosen = os.environ.get(LLVM_VARIABLE)
    if chosen:
        return Path(chosen)
    found: dict[int, Path] = {}
    for pattern in patterns:
        for path in sorted(Path("/").glob(pattern.lstrip("/"))):
            version = llvm_version(path)
            if version is not None and version >= MIN_LLVM_VERSION and path.exists():
                found.setdefault(version, path)
    return found[max(found)] if found else None


def probe_llvm(path: Path | str, timeout_s: float = 60.0) -> LlvmProbe:
    """Compile and run a small kernel (with minimum and maximum) with this library, in a separate process."""
    try:
        done = subprocess.run(
            [sys.executable, "-c", PROBE_CODE],
            env={**os.environ, LLVM_VARIABLE: str(path)},
            capture_output=True, text=True, timeout=timeout_s, check=False,
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        return LlvmProbe(False, "", f"no answer within {timeout_s:g} s")
    if done.returncode == 0:
        return LlvmProbe(True, done.stdout.strip(), "")
    lines = [line.strip() for line in (done.stderr + done.stdout).splitlines() if line.strip()]
    reason = next((line for line in lines if re.search("error|cannot", line, re.IGNORECASE)), "no message")
    return LlvmProbe(False, "", f"exit status {done.returncode}: {reason}")


def llvm_install_command() -> str:
    """The shell line that installs a usable LLVM library on this system."""
    if shutil.which("apt-get"):
        sudo = "" if hasattr(os, "geteuid") and os.geteuid() == 0 else "sudo "
        return f"{sudo}apt-get update && {sudo}apt-get install -y libllvm19"
    if shutil.which("dnf"):
        return "sudo dnf install -y llvm-libs"
    if shutil.which("brew"):
        return "brew install llvm"
    return f"install LLVM {MIN_LLVM_VERSION} or later and set {LLVM_VARIABLE} to its libLLVM"


def require_llvm() -> Path:
    """Set `DRJIT_LIBLLVM_PATH` to a usable library, unless it is already set, and return the path.

    Call it before Dr.Jit is imported. It reads the version number only, so it is fast; `probe_llvm` runs a test.

    Raises `LlvmError` if there is no such library, or the one named in the variable is missing or too old. The
    message holds the install command.
    """
    path = find_llvm()
    if path is None:
        raise LlvmError(f"no libLLVM {MIN_LLVM_VERSION} or later found; install one: {llvm_install_command()}")
    if not path.exists():
        raise LlvmError(
            f"{LLVM_VARIABLE} = {path}: no such file; unset it or install one: {llvm_install_command()}"
        )
    version = llvm_version(path)
    if version is not None and version < MIN_LLVM_VERSION:
        raise LlvmError(
            f"{LLVM_VARIABLE} = {path}: LLVM {version} is too old, {MIN_LLVM_VERSION} or later is needed: "
            f"{llvm_install_command()}"
        )
    os.environ[LLVM_VARIABLE] = str(path)
    return path


@cache
def n_cuda_devices() -> int:
    """CUDA devices that the driver reports; 0 without a driver."""
    try:
        driver = ctypes.CDLL("libcuda.so.1")
    except OSError:
        return 0
    count = ctypes.c_int(0)
    if driver.cuInit(0) != 0 or driver.cuDeviceGetCount(ctypes.byref(count)) != 0:
        return 0
    return count.value


def mitsuba_variant() -> str:
    """Mitsuba variant of the tracer: CUDA if the driver reports a device, else LLVM on the CPU."""
    return CUDA_VARIANT if n_cuda_devices() else LLVM_VARIANT
