"""Settings of a whole campaign: the simulation and every estimation stage."""

import json

from pydantic import Field

from estimation.channel.config import ChannelConfig
from estimation.shape.config import ContourConfig, ShapeConfig
from estimation.slam.config import HeightConfig, MappingConfig, SnapshotConfig, TrajectoryConfig
from estimation.tracks.config import TrackConfig
from isac_arena.user_functions.config import Stage, UserFunctions
from isac_arena.user_functions.names import OURS
from scenes.names import Name
from sim.config import SimulationConfig
from sim.signal.link import line_of_sight_at_1m_dbm


class CampaignConfig(SimulationConfig):
    """The campaign file: simulation settings at the top, one table per estimation stage."""

    name: Name = Field(description="name of the campaign")
    channel: ChannelConfig = ChannelConfig()
    heights: HeightConfig = HeightConfig()
    mapping: MappingConfig = MappingConfig()
    slam: SnapshotConfig = SnapshotConfig()
    trajectory: TrajectoryConfig = TrajectoryConfig()
    shapes: ShapeConfig = ShapeConfig()
    contours: ContourConfig = ContourConfig()
    tracks: TrackConfig = TrackConfig()
    functions: UserFunctions = UserFunctions()


def methods(config: CampaignConfig) -> dict[Stage, str]:
    """The method of every stage that a function can replace: that of the settings, or the function."""
    ours: dict[Stage, str] = {
        "channel": config.channel.method,
        "mapping": OURS,
        "slam": config.slam.method,
        "shapes": config.contours.method,
        "tracker": config.tracks.method,
    }
    for stage, function in config.functions.given.items():
        settings = ", ".join(f"{name} = {json.dumps(value)}" for name, value in function.settings.items())
        ours[stage] = f"{function.function} ({settings})" if settings else function.function
    return ours


def with_link_levels(config: CampaignConfig) -> CampaignConfig:
    """The settings with the nominal LOS power of the link, unless the campaign file gives it.

    A receiver knows its own array and the transmit power (signalled with the PRS). So the LOS decisions of the
    channel estimator and of snapshot SLAM compare powers with free space on this link.
    """
    level_dbm = line_of_sight_at_1m_dbm(config)
    los, path_loss = config.channel.los, config.slam.path_loss
    if "power_at_1m_dbm" not in los.model_fields_set:
        los = los.model_copy(update={"power_at_1m_dbm": level_dbm})
    if "intercept_dbm" not in path_loss.model_fields_set:
        path_loss = path_loss.model_copy(update={"intercept_dbm": level_dbm, "slope_db": -20.0})
    channel = config.channel.model_copy(update={"los": los})
    slam = config.slam.model_copy(update={"path_loss": path_loss})
    return config.model_copy(update={"channel": channel, "slam": slam})


def with_own_level(whole: CampaignConfig, own: CampaignConfig) -> CampaignConfig:
    """Settings of one TX with its nominal LOS power, from those of the campaign, which hold for its first TX."""
    if own is whole:
        return own
    more_db = line_of_sight_at_1m_dbm(own) - line_of_sight_at_1m_dbm(whole)
    level_dbm = own.channel.los.power_at_1m_dbm + more_db
    los = own.channel.los.model_copy(update={"power_at_1m_dbm": level_dbm})
    return own.model_copy(update={"channel": own.channel.model_copy(update={"los": los})})
