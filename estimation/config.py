"""Settings of a whole campaign: the simulation and every estimation stage."""

from __future__ import annotations

from pydantic import Field

from estimation.channel.power import PowerMethodConfig
from estimation.shape.config import ShapeConfig
from estimation.slam.config import MappingConfig, SnapshotConfig
from sim.config import SimulationConfig


class CampaignConfig(SimulationConfig):
    """The campaign file: simulation settings at the top, one table per estimation stage."""

    name: str = Field(min_length=1, description="name of the campaign")
    channel: PowerMethodConfig = PowerMethodConfig()
    mapping: MappingConfig = MappingConfig()
    slam: SnapshotConfig = SnapshotConfig()
    shapes: ShapeConfig = ShapeConfig()
