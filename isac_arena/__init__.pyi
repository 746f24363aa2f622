# The public names for type checkers and editors; `__init__.py` imports each when it is first used.
from estimation.channel.estimate import estimate_channel as estimate_channel
from estimation.channel.record import ChannelEstimate as ChannelEstimate
from estimation.shape.record import Contours as Contours
from estimation.shape.record import Shapes as Shapes
from estimation.slam.record import IncidencePoints as IncidencePoints
from estimation.slam.record import PoseEstimates as PoseEstimates
from isac_arena.campaign.chain import known_receiver as known_receiver
from isac_arena.campaign.chain import make_map as make_map
from isac_arena.campaign.config import CampaignConfig as CampaignConfig
from isac_arena.campaign.directory import open_campaign as open_campaign
from isac_arena.campaign.driver import CampaignRun as CampaignRun
from isac_arena.campaign.files import read_record as read_record
from isac_arena.campaign.load import campaign_scene as campaign_scene
from isac_arena.campaign.load import load_campaign as load_campaign
from scenes.config import load_scene as load_scene
from scenes.pose import Pose as Pose
from scenes.scene import Scene as Scene
from sim.config import SimulationConfig as SimulationConfig
from sim.observation import BeamSweep as BeamSweep
from sim.propagation.paths import Paths as Paths
from sim.signal.link import make_link as make_link
from sim.simulate import observe as observe
from sim.simulate import simulate_truth as simulate_truth
from sim.truth import Truth as Truth

__version__: str
__all__: list[str]
HOMES: dict[str, tuple[str, ...]]
