"""Settings of a simulated campaign: waveform, arrays, link, clock and propagation."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from scenes.toml_config import ConfigModel

Comb = Literal[2, 4, 6, 12]
AngleDeg = Annotated[float, Field(ge=-360, le=360)]


class WaveformConfig(ConfigModel):
    """The PRS in the OFDM grid, TS 38.211 clause 7.4.1.7."""

    carrier_ghz: float = Field(60.0, gt=1, le=300, description="carrier frequency")
    numerology: Literal[2, 3] = Field(3, description="mu: subcarrier spacing 15 kHz x 2^mu")
    n_rb: int = Field(264, ge=24, le=275, description="resource blocks of 12 subcarriers")
    comb: Comb = Field(2, description="every comb-th subcarrier is occupied")


class ArrayConfig(ConfigModel):
    """A uniform planar array, its panels and its horizontal beams."""

    rows: int = Field(4, ge=1, le=256)
    columns: int = Field(16, ge=1, le=256)
    element_pattern: Literal["tr38901", "isotropic"] = "tr38901"
    panel_azimuth_deg: list[AngleDeg] = Field(
        [0.0], min_length=1, description="panel boresights, device frame"
    )
    beams_per_panel: int = Field(32, ge=1, le=1024, description="beams, uniform in the sine of azimuth")
    sector_deg: float = Field(140.0, gt=0, le=180, description="azimuth sector that each panel covers")


class LinkConfig(ConfigModel):
    """The link budget."""

    tx_power_dbm: float = Field(3.0, ge=-50, le=60, description="power into the TX array")
    noise_figure_db: float = Field(10.0, ge=0, le=40)


class ClockConfig(ConfigModel):
    """The receiver clock, unknown to the estimators: a start value and a random walk over the stops."""

    initial_bias_ns: float = Field(33.0, ge=-200, le=200)
    walk_std_ns: float = Field(3.3, ge=0, le=50, description="standard deviation of the step per stop")


class PropagationConfig(ConfigModel):
    """What is traced.

    Specular rays only look for chains of faces, each of which is then solved exactly: more of them find no other
    paths once every reflecting face is hit. Diffuse rays leave the TX on a fixed lattice, each standing for its
    share of the sphere: their number sets the grain, not the power.
    """

    max_bounces: int = Field(
        2, ge=0, le=3, description="specular bounces of a path, 0 for line of sight alone"
    )
    specular_samples: int = Field(200_000, ge=1, le=10_000_000, description="rays that look for faces")
    diffuse_samples: int = Field(2_000, ge=0, le=1_000_000, description="rays that scatter, 0 for none")


class SimulationConfig(ConfigModel):
    """One campaign: a scene, a seed and the settings of every simulated part."""

    scene: str = Field(min_length=1, description="library name or path of the scene file")
    seed: int = Field(1, ge=0, lt=2**63)
    waveform: WaveformConfig = WaveformConfig()
    tx_array: ArrayConfig = ArrayConfig()
    rx_array: ArrayConfig = ArrayConfig(
        panel_azimuth_deg=[-180.0, -90.0, 0.0, 90.0], beams_per_panel=24, sector_deg=90.0
    )
    link: LinkConfig = LinkConfig()
    clock: ClockConfig = ClockConfig()
    propagation: PropagationConfig = PropagationConfig()
