"""The bootstrap of a bare machine: shell syntax, the lock file, and a clear line where something is missing."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import tomllib
from pathlib import Path

import pytest

from isac_arena.doctor import normalised, read_pins

ROOT = Path(__file__).resolve().parents[2]
LOCK = ROOT / "requirements.lock"
SCRIPTS = ["scripts/bootstrap.sh", "scripts/demo", "scripts/docs", "scripts/test", "scripts/wheel", ".ci/run"]


def name_of(requirement: str) -> str:
    return normalised(re.split(r"[^\w.-]", requirement)[0])


@pytest.fixture
def checkout(tmp_path: Path) -> Path:
    """A checkout with a blank in its path and nothing but what the bootstrap reads."""
    root = tmp_path / "a check out"
    (root / "scripts").mkdir(parents=True)
    for name in ("scripts/bootstrap.sh", "scripts/demo", "scripts/test", "requirements.lock", "pyproject.toml"):
        shutil.copy(ROOT / name, root / name)
    return root


def executable(path: Path, text: str) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(f"#!/bin/bash\n{text}\n", encoding="utf-8")
    path.chmod(0o755)
    return path


def run(script: Path, *arguments: str, **environment: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        ["bash", str(script), *arguments],
        cwd="/",
        env={**os.environ, **environment},
        capture_output=True,
        text=True,
        check=False,
    )


def mark_installed(root: Path) -> None:
    """Leave what a finished bootstrap leaves, around an interpreter that fails when it is used."""
    executable(root / ".venv/bin/python", "exit 9")
    summed = subprocess.run(
        f"cat '{root}/requirements.lock' '{root}/pyproject.toml' | cksum",
        shell=True, capture_output=True, text=True, check=True,
    )  # fmt: skip
    (root / ".venv/.installed").write_text(f"{root}\n{summed.stdout}", encoding="utf-8")
    library = root / "libLLVM.so"
    library.touch()
    (root / ".venv/.llvm").write_text(str(library), encoding="utf-8")
    (root / ".venv/.kernels").write_text("4294967295 0\n", encoding="utf-8")  # the checksum of no sources


@pytest.mark.parametrize("script", SCRIPTS)
def test_scripts_are_executable_bash_that_stops_on_errors(script: str) -> None:
    path = ROOT / script
    text = path.read_text(encoding="utf-8")
    assert os.access(path, os.X_OK)
    assert text.startswith("#!/usr/bin/env bash\n")
    assert re.search(r"^set -e?uo pipefail$", text, re.MULTILINE)
    subprocess.run(["bash", "-n", str(path)], check=True)


@pytest.mark.parametrize("lock", [LOCK, ROOT / "docs" / "requirements.lock"], ids=["project", "docs"])
def test_lock_file_pins_exact_versions_and_hashes_and_holds_no_address(lock: Path) -> None:
    text = lock.read_text(encoding="utf-8")
    assert "://" not in text
    entries = re.sub(r"#.*\n", "", text).replace("\\\n", " ").splitlines()
    for entry in entries:
        assert re.fullmatch(r"[A-Za-z0-9._-]+==[0-9][\w.+!]*( +--hash=sha256:[0-9a-f]{64})+ *", entry), entry
    assert len(entries) == len(read_pins(lock))


def test_packages_are_installed_with_their_hashes_alone() -> None:
    for script in ("scripts/bootstrap.sh", "scripts/docs"):
        text = (ROOT / script).read_text(encoding="utf-8").replace("\\\n", " ")
        installs = [line for line in text.splitlines() if re.search(r"-r +\S*requirements.lock", line)]
        assert installs and all("--require-hashes" in line for line in installs)


def test_lock_file_pins_every_dependency_and_the_build() -> None:
    with (ROOT / "pyproject.toml").open("rb") as file:
        content = tomllib.load(file)
    project = content["project"]
    wanted = [
        *project["dependencies"],
        *project["optional-dependencies"]["dev"],
        *content["build-system"]["requires"],
    ]
    assert {name_of(line) for line in wanted} | {"editables"} <= set(read_pins(LOCK))


def test_a_finished_environment_is_left_alone(checkout: Path) -> None:
    mark_installed(checkout)
    result = run(checkout / "scripts/bootstrap.sh", DRJIT_LIBLLVM_PATH="")
    assert (result.returncode, result.stderr) == (0, "")


def test_kernels_are_compiled_once_and_their_failure_ends_nothing(checkout: Path) -> None:
    mark_installed(checkout)
    calls = checkout / "calls"

    def bootstrap(status: int) -> str:
        executable(checkout / ".venv/bin/python", f'echo "$2" >>"{calls}"; exit {status}')
        result = run(checkout / "scripts/bootstrap.sh", DRJIT_LIBLLVM_PATH="")
        assert result.returncode == 0
        return result.stderr

    (checkout / "sim").mkdir()
    (checkout / "sim/noise.py").write_text("a = 1\n")
    assert bootstrap(1) == "The kernels could not be compiled now; the first run does.\n"
    assert bootstrap(0) == "" and calls.read_text().count("compile_side_by_side()") == 2
    (checkout / "sim/noise.py").touch()
    assert bootstrap(1) == ""  # as long as the sources stay
    (checkout / "sim/noise.py").write_text("a = 2\n")
    assert bootstrap(0) == "" and calls.read_text().count("compile_side_by_side()") == 3


@pytest.mark.parametrize("trace", [".unfinished", "moved", "changed"])
def test_an_environment_that_is_not_whole_is_made_again(checkout: Path, trace: str, tmp_path: Path) -> None:
    mark_installed(checkout)
    if trace == ".unfinished":
        (checkout / ".venv/.unfinished").touch()
    elif trace == "moved":
        checkout = checkout.rename(tmp_path / "elsewhere")
    else:
        (checkout / "requirements.lock").write_text("numpy==1.0\n", encoding="utf-8")
    python = executable(tmp_path / "python", '[[ "$1" == -c ]] || exit 7')
    result = run(checkout / "scripts/bootstrap.sh", PYTHON=str(python))
    assert result.returncode == 1
    first, *_, last = result.stderr.strip().splitlines()
    assert first.startswith("Installing" if trace == "changed" else f"Making the environment {checkout}/.venv")
    assert last.startswith("error: ")
    assert not (checkout / ".venv/.installed").exists()
    assert (checkout / ".venv/.unfinished").exists()


def test_an_interpreter_that_is_too_old_is_named(checkout: Path, tmp_path: Path) -> None:
    old = executable(tmp_path / "python3.10", "exit 1")
    result = run(checkout / "scripts/demo", PYTHON=str(old))
    assert result.returncode == 1
    assert result.stderr == f"error: PYTHON = {old}: not a Python 3.11 or later\n"
    assert not (checkout / ".venv").exists()


def test_without_venv_the_line_to_run_is_printed(checkout: Path, tmp_path: Path) -> None:
    python = executable(
        tmp_path / "python", 'case "$2" in *ensurepip*) exit 1 ;; *print*) echo python3.11-venv ;; esac'
    )
    executable(tmp_path / "bin/id", "echo 1000")
    result = run(checkout / "scripts/test", PYTHON=str(python), PATH=f"{tmp_path}/bin:{os.environ['PATH']}")
    assert result.returncode == 1
    assert result.stderr == (
        f"error: {python} cannot make virtual environments; "
        "run: sudo apt-get update && sudo apt-get install -y python3.11-venv\n"
    )


def test_an_unusable_chosen_llvm_stops_with_one_line(checkout: Path) -> None:
    mark_installed(checkout)
    result = run(checkout / "scripts/bootstrap.sh", DRJIT_LIBLLVM_PATH="/nowhere/libLLVM")
    assert result.returncode == 1
    assert result.stderr == (
        "error: DRJIT_LIBLLVM_PATH = /nowhere/libLLVM: not a usable LLVM 17 or later; unset it or name another\n"
    )


@pytest.mark.parametrize("given", [None, "--out=", "--out"])
def test_demo_passes_arguments_on_and_says_where_the_report_is(
    checkout: Path, tmp_path: Path, given: str | None
) -> None:
    mark_installed(checkout)
    out = checkout / "out/campus_arena" if given is None else tmp_path / "my out"
    out.mkdir(parents=True)
    (out / "report.html").touch()
    arguments = {None: [], "--out=": [f"--out={out}"], "--out": ["--out", str(out)]}[given]
    executable(checkout / ".venv/bin/arena", 'printf "<%s>" "$@"; echo')
    result = run(checkout / "scripts/demo", *arguments, DRJIT_LIBLLVM_PATH="")
    passed = "".join(f"<{word}>" for word in ["run", "campus_arena", "--out", str(out), *arguments])
    assert result.stdout == f"{passed}\nReport: {out}/report.html\n"


def test_demo_ends_as_the_run_ends(checkout: Path) -> None:
    mark_installed(checkout)
    executable(checkout / ".venv/bin/arena", "exit 3")
    result = run(checkout / "scripts/demo", DRJIT_LIBLLVM_PATH="")
    assert (result.returncode, result.stdout) == (3, "")


def test_test_runs_slow_tests_and_other_numbers_of_processes_on_demand_only(checkout: Path) -> None:
    mark_installed(checkout)
    executable(checkout / ".venv/bin/python", 'printf "<%s>" "$@"')

    def passed(*arguments: str) -> str:
        return run(checkout / "scripts/test", *arguments, DRJIT_LIBLLVM_PATH="").stdout

    quick, two = "<-m><pytest><-m><not slow and not whole>", "<-n><2><--dist><worksteal>"
    assert passed("tests/a file.py") == f"{quick}{two}<tests/a file.py>"
    assert passed("--whole") == f"<-m><pytest><-m><whole and not slow>{two}"
    assert passed("--all") == "<-m><pytest><-n><2><--dist><worksteal>"
    assert passed("--all", "-n", "0") == "<-m><pytest><-n><0>"
    assert passed("-n4") == f"{quick}<-n4>"
    assert passed("--pdb") == f"{quick}<--pdb>"
