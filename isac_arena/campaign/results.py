"""What the whole chain produced for one campaign, in memory."""

from dataclasses import dataclass
from typing import Literal

from estimation.channel.beam_power_map import BeamPowerMap
from estimation.channel.record import ChannelEstimate
from estimation.shape.record import Contours, Shapes
from estimation.slam.record import IncidencePoints, PoseEstimates
from scenes.record import Record

MapName = Literal["mapping", "slam"]


@dataclass(frozen=True)
class MapResult(Record):
    """A map of the scene, from mapping or from SLAM.

    Receiver poses, incidence points, the paper's shapes of clusters and our contours of objects.
    """

    poses: PoseEstimates
    ips: IncidencePoints
    shapes: Shapes
    contours: Contours


@dataclass(frozen=True)
class CampaignResults:
    """All estimates of a campaign. `channel` and `power_maps` have one entry per stop, in order.

    `power_maps` is for figures; it is empty where none are drawn.
    """

    channel: tuple[ChannelEstimate, ...]
    power_maps: tuple[BeamPowerMap, ...]
    mapping: MapResult
    slam: MapResult
