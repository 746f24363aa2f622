"""Choice of the LLVM library by name, by version and by trial."""

import os
import subprocess
import sys

import pytest

from sim.propagation.llvm import LLVM_VARIABLE, LlvmError, find_llvm, llvm_version, probe_llvm, require_llvm


@pytest.fixture
def unset(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(LLVM_VARIABLE, raising=False)


@pytest.mark.parametrize(
    ("path", "version"),
    [
        ("/usr/lib/x86_64-linux-gnu/libLLVM.so.19.1", 19),
        ("/usr/lib/x86_64-linux-gnu/libLLVM-19.so.1", 19),
        ("/usr/lib/x86_64-linux-gnu/libLLVM-14.0.6.so.1", 14),
        ("/usr/lib64/libLLVM.so.20.1-rc", 20),
        ("/usr/lib/llvm-18/lib/libLLVM.so", 18),
        ("/opt/homebrew/opt/llvm@21/lib/libLLVM.dylib", 21),
        ("/usr/local/lib/libLLVM.so", None),
    ],
)
def test_version_from_name(path, version):
    assert llvm_version(path) == version


def test_newest_usable_is_chosen(tmp_path, unset):
    for name in ("libLLVM-14.so.1", "libLLVM-17.so.1", "libLLVM.so.19.1", "libLLVM-9.so.1"):
        (tmp_path / name).touch()
    (tmp_path / "libLLVM-22.so").symlink_to(tmp_path / "gone")
    assert find_llvm((f"{tmp_path}/libLLVM*.so*",)) == tmp_path / "libLLVM.so.19.1"


def test_old_ones_are_not_chosen(tmp_path, unset):
    (tmp_path / "libLLVM-16.so.1").touch()
    assert find_llvm((f"{tmp_path}/libLLVM*.so*",)) is None


def test_link_without_number_is_read_through(tmp_path, unset):
    (tmp_path / "libLLVM.so.19.1").touch()
    (tmp_path / "libLLVM.so").symlink_to("libLLVM.so.19.1")
    assert llvm_version(tmp_path / "libLLVM.so") == 19


def test_variable_is_respected(tmp_path, monkeypatch):
    library = tmp_path / "libLLVM-21.so"
    library.touch()
    monkeypatch.setenv(LLVM_VARIABLE, str(library))
    assert find_llvm() == library == require_llvm()


@pytest.mark.parametrize(
    ("name", "made", "reason"), [("libLLVM-21.so", False, "no such"), ("libLLVM-15.so.1", True, "too old")]
)
def test_unusable_variable_is_one_clear_line(tmp_path, monkeypatch, name, made, reason):
    if made:
        (tmp_path / name).touch()
    monkeypatch.setenv(LLVM_VARIABLE, str(tmp_path / name))
    with pytest.raises(LlvmError, match=reason) as caught:
        require_llvm()
    assert "\n" not in str(caught.value)
    assert LLVM_VARIABLE in str(caught.value)


def test_nothing_found_names_the_install_command(monkeypatch):
    monkeypatch.setattr("sim.propagation.llvm.find_llvm", lambda: None)
    with pytest.raises(LlvmError, match="install"):
        require_llvm()


def test_probe_runs_a_kernel_with_the_chosen_library(unset):
    path = find_llvm()
    if path is None:
        pytest.skip("no LLVM 17 or later on this machine")
    result = probe_llvm(path)
    assert result.ok, result.error
    assert int(result.version.split(".")[0]) >= 17


def test_probe_survives_a_file_that_is_no_library(tmp_path):
    broken = tmp_path / "libLLVM-19.so"
    broken.write_text("no library")
    result = probe_llvm(broken)
    assert not result.ok
    assert result.error
    assert "\n" not in result.error


def test_nothing_heavy_is_imported():
    heavy = "{'drjit', 'mitsuba', 'sionna', 'trimesh'}"
    modules = "sim.propagation.llvm, sim.propagation.propagator"
    code = f"import {modules}, sys; sys.exit(bool({heavy} & set(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", code], env=os.environ, check=False)
    assert done.returncode == 0
