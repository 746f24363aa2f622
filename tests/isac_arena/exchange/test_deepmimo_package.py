"""Channels that the `deepmimo` package generates from an exported scenario are those of our paths.

The package needs an older numpy than we do, so it has a Python of its own, named by DEEPMIMO_PYTHON:
`python3 -m venv .venv/deepmimo && .venv/deepmimo/bin/pip install deepmimo==4.0.5`. `.ci/run` makes it.
"""

import os
import subprocess
from pathlib import Path

import numpy as np
import pytest

import isac_arena as ia
from isac_arena.exchange.deepmimo import scene_facets, write_deepmimo
from scenes.pose import direction
from sim.propagation.deepmimo.scenario import PathScenario

OWN = Path(__file__).resolve().parents[3] / ".venv/deepmimo/bin/python"
PYTHON = Path(os.environ.get("DEEPMIMO_PYTHON", OWN))
CARRIER_HZ, BANDWIDTH_HZ, N_SUBCARRIERS = 60e9, 400e6, 128
BS, UE = 4, 2  # elements along y, half a wavelength apart
GENERATE = f"""
import sys, numpy as np, deepmimo as dm
dm.config.set("scenarios_folder", sys.argv[1])
dataset = dm.load(sys.argv[2])
antenna = lambda n: {{"shape": [n, 1], "spacing": 0.5, "rotation": [0, 0, 0]}}
all_of_them = np.arange({N_SUBCARRIERS})
ofdm = {{"subcarriers": {N_SUBCARRIERS}, "selected_subcarriers": all_of_them, "bandwidth": {BANDWIDTH_HZ}}}
arrays = {{"bs_antenna": antenna({BS}), "ue_antenna": antenna({UE})}}
both = dm.ChannelParameters(**arrays, freq_domain=1, num_paths=25, ofdm=ofdm)
np.save(sys.argv[3], dataset.compute_channels(both))
"""


@pytest.mark.skipif(not PYTHON.exists(), reason="deepmimo has no Python of its own here, see the top of this file")
def test_channels_are_those_of_our_paths(tmp_path: Path) -> None:
    campaign = ia.load_campaign("box_room", propagation={"diffuse_samples": 0})
    paths = [truth.paths for truth in campaign.trace([0, 3])]
    strongest = [one.take("path", np.argsort(-one.power, kind="stable")[:25]) for one in paths]
    position_m = np.array([campaign.stops[stop].position_m for stop in (0, 3)])
    scenario = PathScenario(campaign.scene.tx.position_m, position_m, CARRIER_HZ, tuple(strongest))
    write_deepmimo(tmp_path / "room", scenario, scene_facets(campaign.scene), 25)
    subprocess.run([PYTHON, "-c", GENERATE, tmp_path, "room", tmp_path / "made.npy"], check=True, cwd=tmp_path)
    theirs = np.load(tmp_path / "made.npy")  # (receiver, RX element, TX element, subcarrier)
    frequency_hz = np.arange(N_SUBCARRIERS) * BANDWIDTH_HZ / N_SUBCARRIERS
    assert theirs.shape == (2, UE, BS, N_SUBCARRIERS)
    for found, one in zip(theirs, strongest, strict=True):
        over_delay = one.gain[:, None] * np.exp(-2j * np.pi * one.delay_s[:, None] * frequency_hz)
        tx, rx = (
            np.exp(1j * np.pi * np.arange(n)[:, None] * direction(azimuth_rad, elevation_rad)[..., 1])
            for n, azimuth_rad, elevation_rad in (
                (BS, one.aod_azimuth_rad, one.aod_elevation_rad),
                (UE, one.aoa_azimuth_rad, one.aoa_elevation_rad),
            )
        )
        ours = np.einsum("rp,tp,pk->rtk", rx, tx, over_delay) / np.sqrt(N_SUBCARRIERS)
        assert np.abs(found - ours).max() / np.abs(ours).max() < 1e-4
