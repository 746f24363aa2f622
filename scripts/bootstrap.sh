#!/usr/bin/env bash
# Make .venv with the pinned dependencies and the project, and make sure that a usable libLLVM is there.
# A run that finds everything in place only compares a checksum. PYTHON names the interpreter to use.
set -euo pipefail

root="$(cd -- "$(dirname -- "${BASH_SOURCE[0]}")/.." && pwd -P)"
venv="$root/.venv"
unfinished="$venv/.unfinished"  # there while the environment is being made
installed="$venv/.installed"    # checkout, and checksum of what was installed
llvm="$venv/.llvm"              # the libLLVM that compiled a kernel, or "cuda"
kernels="$venv/.kernels"        # checksum of the sources whose kernels are compiled

say() { printf '%s\n' "$*" >&2; }
die() { say "error: $*"; exit 1; }

# Run a command; meanwhile tell its time: a live line in a terminal, elsewhere a line every 30 s.
timed() {
    local what="$1" ticker status=0
    shift
    tick "$what" 9>&- &
    ticker=$!
    "$@" || status=$?
    kill "$ticker" 2>/dev/null || true
    wait "$ticker" 2>/dev/null || true
    [[ ! -t 2 ]] || printf '\r\033[K' >&2
    return "$status"
}

tick() {
    local seconds=0
    while sleep 1; do
        seconds=$((seconds + 1))
        if [[ -t 2 ]]; then
            printf '\r\033[K%s: %d s' "$1" "$seconds" >&2
        elif ((seconds % 30 == 0)); then
            say "$1: $seconds s"
        fi
    done
}

is_root() { [[ "$(id -u)" == 0 ]]; }

can_apt() { is_root && command -v apt-get >/dev/null; }

apt_line() {
    local sudo="sudo "
    ! is_root || sudo=""
    printf '%sapt-get update && %sapt-get install -y %s' "$sudo" "$sudo" "$1"
}

apt_install() {
    say "Installing the package $1 ..."
    export DEBIAN_FRONTEND=noninteractive
    timed "package $1" apt_quietly "$1"
}

apt_quietly() {
    apt-get install -y -qq "$1" </dev/null >/dev/null 2>&1 && return
    apt-get update -qq </dev/null >/dev/null || true
    apt-get install -y -qq "$1" </dev/null >/dev/null || return 1
}

find_python() {
    local name
    for name in ${PYTHON:+"$PYTHON"} python3.11 python3.12 python3.13 python3; do
        if "$name" -c 'import sys; sys.exit(sys.version_info < (3, 11))' >/dev/null 2>&1; then
            command -v "$name"
            return
        fi
        [[ "$name" != "${PYTHON:-}" ]] || die "PYTHON = $PYTHON: not a Python 3.11 or later"
    done
    die "no Python 3.11 or later found; install one: $(apt_line python3)"
}

make_venv() {
    local python package
    python="$(find_python)"
    if ! "$python" -c 'import ensurepip, venv' >/dev/null 2>&1; then
        package="$("$python" -c 'import sys; print("python%d.%d-venv" % sys.version_info[:2])')"
        { can_apt && apt_install "$package"; } ||
            die "$python cannot make virtual environments; run: $(apt_line "$package")"
    fi
    say "Making the environment $venv ..."
    rm -rf -- "$venv"
    mkdir -- "$venv"
    touch -- "$unfinished"
    "$python" -m venv "$venv" || die "$python -m venv $venv failed"
}

wanted() {
    printf '%s\n' "$root"
    cat -- "$root/requirements.lock" "$root/pyproject.toml" | cksum
}

# True where the environment is whole and belongs to this checkout: one copied or moved with its folder does not.
venv_is_ours() {
    [[ -x "$venv/bin/python" && ! -e "$unfinished" ]] || return 1
    [[ ! -e "$installed" || "$(head -n 1 -- "$installed")" == "$root" ]]
}

install_packages() {
    local pip=("$venv/bin/python" -m pip install --no-input --disable-pip-version-check -qq)
    [[ -e "$installed" && "$(<"$installed")" == "$(wanted)" ]] && venv_is_ours && return
    venv_is_ours || make_venv
    touch -- "$unfinished"
    rm -f -- "$installed" "$llvm" "$kernels"
    say "Installing the pinned packages into $venv (once, about a minute) ..."
    timed "packages" "${pip[@]}" --require-hashes -r "$root/requirements.lock" || die "the pinned packages could not be installed, see above"
    timed "the project" "${pip[@]}" --no-deps --no-build-isolation -e "$root" || die "the project could not be installed, see above"
    # Numba's caches name the classes of the code that they were compiled from: after an update that renames a class,
    # loading an old cache raises AttributeError.
    find "$root" -path "$venv" -prune -o -name '*.nb[ic]' -exec rm -f -- {} +
    wanted >"$installed.part"
    mv -- "$installed.part" "$installed"
    rm -- "$unfinished"
    is_new=yes
}

# Write to .venv/.llvm what the ray tracer can compile with; fail where there is nothing.
probe_llvm() {
    "$venv/bin/python" - "$llvm" <<'PY'
import sys
from pathlib import Path

from sim.propagation.llvm import find_llvm, n_cuda_devices, probe_llvm

library = find_llvm()
if n_cuda_devices():
    Path(sys.argv[1]).write_text("cuda")
elif library is not None and probe_llvm(library).ok:
    Path(sys.argv[1]).write_text(str(library))
else:
    sys.exit(1)
PY
}

ensure_llvm() {
    local chosen="${DRJIT_LIBLLVM_PATH:-}" found=""
    [[ ! -e "$llvm" ]] || found="$(<"$llvm")"
    [[ "$found" == cuda ]] && return
    [[ -n "$found" && -e "$found" && "$found" == "${chosen:-$found}" ]] && return
    rm -f -- "$llvm"
    [[ -z "$is_new" ]] || say "Trying the ray tracer (once, some seconds) ..."
    timed "ray tracer, a first kernel" probe_llvm && return
    [[ -z "$chosen" ]] || die "DRJIT_LIBLLVM_PATH = $chosen: not a usable LLVM 17 or later; unset it or name another"
    can_apt && apt_install libllvm19 && probe_llvm && return
    die "no usable libLLVM (17 or later) found; install one: $(
        "$venv/bin/python" -c 'from sim.propagation.llvm import llvm_install_command; print(llvm_install_command())'
    )"
}

# Compile the loops of numba once, not in the first run; where sources changed, those that come from them. Without
# them all works: a run compiles what is missing.
ensure_kernels() {
    local sources
    sources="$(cd -- "$root" && find scenes sim estimation -name '*.py' -exec cksum {} + 2>/dev/null | sort | cksum)" || true
    [[ -e "$kernels" && "$(<"$kernels")" == "$sources" ]] && return
    [[ -z "$is_new" ]] || say "Compiling kernels (once, two to five minutes) ..."
    if timed "kernels" compile_kernels; then
        printf '%s\n' "$sources" >"$kernels"
    else
        say "The kernels could not be compiled now; the first run does."
    fi
}

compile_kernels() {
    "$venv/bin/python" -c '
import sys
from isac_arena.kernels import compile_side_by_side, kernels_compiled
sys.exit(not kernels_compiled() and compile_side_by_side() or 0)'
}

# One bootstrap at a time in this checkout, where flock is there.
if command -v flock >/dev/null; then
    exec 9<"$root"
    flock -n 9 || { say "Waiting for another bootstrap of this checkout ..."; flock 9; }
fi
is_new=""
install_packages
ensure_llvm
ensure_kernels
[[ -z "$is_new" ]] || say "Installed. For this terminal: source .venv/bin/activate; then arena --help"
