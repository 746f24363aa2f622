"""The run that is attacked: a small campaign of three stops in a room, finished up to its report."""

from pathlib import Path

from scenes.config import LIBRARY

CAMPAIGN = """
name = "small"
scene = "room.toml"
seed = {seed}
[waveform]
n_rb = 24
comb = 12
[tx_array]
rows = 1
columns = 8
beams_per_panel = 8
[rx_array]
rows = 1
columns = 8
beams_per_panel = 8
[propagation]
max_bounces = 1
diffuse_samples = 0
diffraction = false
compare_planar = false
[channel]
method = "power"
"""
SWEEP = """
name = "powers"
base = "small.toml"
[[axes]]
field = "link.tx_power_dbm"
values = [0.0, 20.0]
"""
N_STOPS = 3


def write_campaign(folder: Path, seed: int = 1) -> Path:
    """The campaign with its scene and a sweep over it, in a folder."""
    text = (LIBRARY / "box_room.toml").read_text(encoding="utf-8")
    head, _, walk = text.partition("n_stops = ")
    (folder / "room.toml").write_text(f"{head}n_stops = {N_STOPS}\n{walk.partition(chr(10))[2]}", encoding="utf-8")
    (folder / "sweep.toml").write_text(SWEEP, encoding="utf-8")
    (folder / "small.toml").write_text(CAMPAIGN.format(seed=seed), encoding="utf-8")
    return folder / "small.toml"
