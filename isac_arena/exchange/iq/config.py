"""What a recording states beside its samples: the table `[recording]` of a campaign file."""

from typing import Annotated

from pydantic import Field

from scenes.names import FileName
from scenes.toml_config import ConfigModel

Position = Annotated[tuple[float, float, float], Field(strict=False)]


class RecordedStop(ConfigModel):
    """The samples of one receiver stop, and its surveyed pose where it is known."""

    files: list[FileName] = Field(
        min_length=1, description="SigMF (.sigmf-meta), .npz or .h5; several are joined in this order"
    )
    position_m: Position | None = Field(None, description="surveyed x, y, z of the receiver")
    heading_deg: float | None = Field(None, ge=-360, le=360, description="its surveyed heading")


class RecordingConfig(ConfigModel):
    """How samples were recorded. Waveform, schedule, arrays and beams are those of the campaign file."""

    stops: list[RecordedStop] = Field(min_length=1, description="the receiver stops, in order")
    sample_rate_hz: float | None = Field(
        None, gt=0, description="nominal sampling rate; by default that of the SigMF metadata"
    )
    pairs: FileName | None = Field(
        None,
        description="table with columns tx_beam, rx_beam, start_s, slot: when the prefix of every pair starts;"
        " by default the schedule of the waveform, or one pair after the other",
    )
    sequence_ids: list[Annotated[int, Field(ge=0, le=4095)]] | None = Field(
        None, description="PRS sequence of every TX beam; by default 0, 1, 2, ..."
    )
    reference: FileName | None = Field(
        None,
        description=".npz with `grid` (tx_beam, subcarrier): pilots in place of the PRS, 0 where none is sent",
    )
    start_s: float = Field(
        0.0, ge=0, le=1e4, description="time in the recording at which the schedule starts, about"
    )
    search_us: float = Field(20.0, gt=0, le=1e4, description="largest error of that time")
    largest_cfo_hz: float = Field(600e3, ge=0, le=1e7, description="largest carrier frequency offset, 0: none")
    largest_drift_ppm: float = Field(25.0, ge=0, le=200, description="largest error of the sampling rate, 0: none")
    full_scale_dbm: float | None = Field(
        None, ge=-300, le=100,
        description="calibration: power at the array of a sample of magnitude 1; by default the level is unknown",
    )  # fmt: skip
    noise_power_dbm: float | None = Field(
        None, ge=-300, le=100, description="noise in the band of the pilots; by default from unused subcarriers"
    )
    refine: bool = Field(True, description="refine frequency and drift with fitted paths")


class RecordingFile(ConfigModel):
    """What a campaign file holds more for `arena import-iq`."""

    recording: RecordingConfig
