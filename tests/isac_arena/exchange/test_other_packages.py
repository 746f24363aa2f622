"""Files that are exported, opened by the packages of their ecosystems.

sigmf, evo and webdataset have a Python of their own, named by PEERS_PYTHON:
`python3 -m venv .venv/peers && .venv/peers/bin/pip install sigmf evo webdataset`. `.ci/run` makes it. Likewise
`test_deepmimo_package.py` for deepmimo; scipy.io opens MATLAB files in `test_measured_campaign.py`.
"""

from __future__ import annotations

import json
import os
import subprocess
from pathlib import Path

import numpy as np
import pytest

import isac_arena as ia
from isac_arena.exchange.sigmf_recording import read_sigmf, write_sigmf
from scenes.walks.tum import tum_text

OWN = Path(__file__).resolve().parents[3] / ".venv/peers/bin/python"
PYTHON = Path(os.environ.get("PEERS_PYTHON", OWN))
needs_peers = pytest.mark.skipif(
    not PYTHON.exists(), reason="sigmf and evo have no Python of their own here, see the top of this file"
)
READ_SIGMF = """
import sys, json, numpy as np, sigmf
found = sigmf.fromfile(sys.argv[1])
found.validate()
np.save(sys.argv[2], found.read_samples())
about = found.get_annotations()
print(json.dumps([len(about), found.sample_rate, [one["core:label"] for one in about]]))
"""
WRITE_SIGMF = """
import sys, numpy as np, sigmf
np.load(sys.argv[2]).astype("<c8").tofile(sys.argv[1] + ".sigmf-data")
about = sigmf.SigMFFile(
    data_file=sys.argv[1] + ".sigmf-data", global_info={"core:datatype": "cf32_le", "core:sample_rate": 1e6}
)
about.add_capture(0, metadata={"core:frequency": 60e9})
about.tofile(sys.argv[1] + ".sigmf-meta")
"""
READ_TUM = """
import sys, numpy as np
from evo.tools import file_interface
found = file_interface.read_tum_trajectory_file(sys.argv[1])
np.savez(sys.argv[2], xyz=found.positions_xyz, wxyz=found.orientations_quat_wxyz, time=found.timestamps)
"""


def peers(code: str, *arguments: Path) -> str:
    done = subprocess.run([PYTHON, "-c", code, *arguments], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


@needs_peers
def test_sigmf_opens_our_recordings_and_we_open_theirs(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    bursts = [(rng.standard_normal(n) + 1j * rng.standard_normal(n)).astype(np.complex64) for n in (30, 50)]
    meta = write_sigmf(
        tmp_path / "ours", bursts, ["tx 0", "tx 1"], sample_rate_hz=1e6, carrier_hz=60e9, description="two bursts"
    )
    told = json.loads(peers(READ_SIGMF, meta, tmp_path / "read.npy").splitlines()[-1])
    assert told == [2, 1e6, ["tx 0", "tx 1"]]
    assert np.array_equal(np.load(tmp_path / "read.npy"), np.concatenate(bursts))
    peers(WRITE_SIGMF, tmp_path / "theirs", tmp_path / "read.npy")
    samples, about = read_sigmf(tmp_path / "theirs")
    assert np.array_equal(samples, np.concatenate(bursts)) and about["global"]["core:sample_rate"] == 1e6


@needs_peers
def test_evo_opens_our_trajectories(tmp_path: Path) -> None:
    poses = ia.load_campaign("box_room").stops
    place_m, heading_rad = (
        np.array([getattr(pose, name) for pose in poses]) for name in ("position_m", "heading_rad")
    )
    (tmp_path / "walk.tum").write_text(tum_text(np.arange(len(poses)), place_m, heading_rad))
    peers(READ_TUM, tmp_path / "walk.tum", tmp_path / "read.npz")
    with np.load(tmp_path / "read.npz") as found:
        assert found["xyz"] == pytest.approx(place_m, abs=1e-6)
        w, _, _, z = found["wxyz"].T
        assert np.abs(np.exp(1j * (2 * np.arctan2(z, w) - heading_rad)) - 1).max() < 1e-6
        assert np.array_equal(found["time"], np.arange(len(poses)))
