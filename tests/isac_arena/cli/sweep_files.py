"""The smallest campaign and sweep that go through every stage, for the tests of sweeps."""

from pathlib import Path

N_CASES = 8  # of the undisturbed sweep

CAMPAIGN = """
name = "small"
scene = "box_room"
[waveform]
n_rb = 132
[tx_array]
rows = 1
columns = 8
beams_per_panel = 12
[rx_array]
rows = 1
columns = 8
beams_per_panel = 12
panel_azimuth_deg = [-180.0, -90.0, 0.0, 90.0]
sector_deg = 140.0
[propagation]
max_bounces = 1
diffuse_samples = 0
diffraction = false
compare_planar = false
[channel]
method = "power"
"""
SWEEP = """
name = "two powers"
base = "small.toml"
stop_every = 2
repeats = {repeats}
[[axes]]
field = "link.tx_power_dbm"
label = "power"
values = [0.0, 20.0]
"""


def write_sweep(folder: Path, repeats: int = 2, **changes: str) -> Path:
    """A campaign and a sweep file of 2 points; `changes` replace text in the sweep."""
    (folder / "small.toml").write_text(CAMPAIGN)
    text = SWEEP.format(repeats=repeats)
    for old, new in changes.items():
        text = text.replace(old, new)
    (folder / "sweep.toml").write_text(text)
    return folder / "sweep.toml"


def results(folder: Path) -> bytes:
    """The bytes of both tables of a sweep."""
    return (folder / "results.parquet").read_bytes() + (folder / "results.csv").read_bytes()
