"""Settings of the PRS slots of a campaign."""

from typing import Literal

from pydantic import Field

from scenes.toml_config import ConfigModel
from sim.signal.waveform.schedule import PrsSchedule

Bits = list[Literal[0, 1]]
ScanOrder = Literal["linear", "interleaved", "random"]


class ScheduleConfig(ConfigModel):
    """One PRS resource set with one resource per TX beam, TS 38.214 clause 5.1.6.5.

    Names and allowed values are those of `sim.signal.waveform.schedule.PrsSchedule`.
    """

    period_slots: int = Field(80, ge=4, description="slots from one instance of the set to the next")
    offset_slots: int = Field(0, ge=0, description="slot of the first instance")
    repetitions: int = Field(1, ge=1, le=32, description="slots in which a beam is sent per instance")
    gap_slots: int = Field(1, ge=1, le=32, description="slots from one repetition of a beam to the next")
    muting_1: Bits | None = Field(None, description="option 1: a bit for every instance, 0 for muted")
    muting_bit_repetition: int = Field(1, ge=1, le=8, description="consecutive instances of one bit of muting_1")
    muting_2: Bits | None = Field(None, description="option 2: a bit for every repetition, 0 for muted")

    def of_resource(self, numerology: int, resource_offset_slots: int = 0) -> PrsSchedule:
        """The schedule of one beam; `ValueError` if the standard does not allow it."""
        return PrsSchedule(
            numerology=numerology,
            period_slots=self.period_slots,
            offset_slots=self.offset_slots,
            resource_offset_slots=resource_offset_slots,
            repetitions=self.repetitions,
            gap_slots=self.gap_slots,
            muting_1=None if self.muting_1 is None else tuple(self.muting_1),
            muting_bit_repetition=self.muting_bit_repetition,
            muting_2=None if self.muting_2 is None else tuple(self.muting_2),
        )
