"""The doctor's findings: each problem is seen, named and given a remedy."""

from __future__ import annotations

import json
import sys
from importlib import metadata
from pathlib import Path

import pytest
import typer
from typer.testing import CliRunner

from isac_arena import doctor as module
from isac_arena.cli.doctor import doctor
from isac_arena.doctor import Check

app = typer.Typer()
app.command()(doctor)


def test_the_interpreter_of_the_tests_is_good_and_an_old_one_is_not() -> None:
    assert module.check_python().status == "ok"
    old = module.check_python((3, 10))
    assert old.status == "fail"
    assert "3.10" in old.detail
    assert "3.11" in old.remedy


def test_packages_as_pinned_are_ok(tmp_path: Path) -> None:
    lock = tmp_path / "requirements.lock"
    lock.write_text(f"# a comment\nNumPy=={metadata.version('numpy')}\n", encoding="utf-8")
    assert module.check_packages(lock) == Check("packages", "ok", "1 packages as pinned in requirements.lock")


def test_another_version_and_a_missing_check_tool_only_warn(tmp_path: Path) -> None:
    lock = tmp_path / "requirements.lock"
    lock.write_text("numpy==0.0.1\nno-such-package==1.0\n", encoding="utf-8")
    check = module.check_packages(lock)
    assert check.status == "warn"
    assert f"numpy {metadata.version('numpy')} (pinned 0.0.1)" in check.detail
    assert "missing: no-such-package" in check.detail
    assert "requirements.lock" in check.remedy


def test_a_missing_package_that_the_project_runs_on_fails(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    lock = tmp_path / "requirements.lock"
    lock.write_text("no-such-package==1.0\n", encoding="utf-8")
    monkeypatch.setattr(metadata, "requires", lambda _: ["No_Such.Package>=1", "ruff; extra == 'dev'"])
    check = module.check_packages(lock)
    assert check.status == "fail"
    assert "no-such-package" in check.detail


def test_without_a_lock_file_the_needed_packages_are_looked_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(metadata, "requires", lambda _: ["numpy>=2"])
    found = module.check_packages(tmp_path / "requirements.lock")
    assert found.status == "ok" and "only a checkout pins" in found.detail
    monkeypatch.setattr(metadata, "requires", lambda _: ["numpy>=2", "No_Such.Package>=1"])
    missing = module.check_packages(tmp_path / "requirements.lock")
    assert (missing.status, missing.detail) == ("fail", "missing: no-such-package")


def test_a_library_that_is_no_llvm_fails_in_its_own_process(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    library = tmp_path / "libLLVM.so.19.1"
    library.write_text("not a library", encoding="utf-8")
    monkeypatch.setenv("DRJIT_LIBLLVM_PATH", str(library))
    monkeypatch.setattr(module, "n_cuda_devices", lambda: 0)
    check = module.check_llvm()
    assert check.status == "fail"
    assert str(library) in check.detail
    assert "unset DRJIT_LIBLLVM_PATH" in check.remedy
    assert module.check_sionna(check).status == "fail"


def test_a_missing_library_fails_and_matters_not_with_cuda(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "find_llvm", lambda: None)
    monkeypatch.setattr(module, "n_cuda_devices", lambda: 0)
    assert module.check_llvm().status == "fail"
    monkeypatch.setattr(module, "n_cuda_devices", lambda: 1)
    assert module.check_llvm().status == "ok"


def test_sionna_loads_here() -> None:
    llvm = module.check_llvm()
    assert llvm.status == "ok", llvm
    check = module.check_sionna(llvm)
    assert check.status == "ok", check
    assert metadata.version("sionna-rt") in check.detail


def test_a_variant_that_does_not_load_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "mitsuba_variant", lambda: "no_such_variant")
    check = module.check_sionna(Check("llvm", "ok", ""))
    assert check.status == "fail"
    assert "no_such_variant" in check.detail


@pytest.mark.parametrize(("available_gib", "status"), [(0.5, "warn"), (16.0, "ok")])
def test_little_memory_warns(available_gib: float, status: str) -> None:
    check = module.check_memory(available_gib)
    assert check.status == status
    assert bool(check.remedy) == (status != "ok")


def test_memory_and_disk_of_this_machine_are_read(tmp_path: Path) -> None:
    if sys.platform == "linux":
        assert (module.available_memory_gib() or 0.0) > 0.0
    assert str(tmp_path) in module.check_disk(tmp_path).detail


@pytest.mark.parametrize(("status", "exit_code"), [("ok", 0), ("warn", 0), ("fail", 1)])
def test_the_command_ends_with_one_only_where_something_fails(
    status: module.Status, exit_code: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    checks = [Check("python", "ok", "fine"), Check("llvm", status, "seen [as is]", "do this")]
    monkeypatch.setattr(module, "doctor_report", lambda: checks)
    as_json = CliRunner().invoke(app, ["--json"])
    assert as_json.exit_code == exit_code
    assert [row["status"] for row in json.loads(as_json.stdout)] == ["ok", status]
    table = CliRunner().invoke(app)
    assert table.exit_code == exit_code
    assert "seen [as is]" in table.stdout
    assert ("llvm: do this" in table.stdout) == (status != "ok")
