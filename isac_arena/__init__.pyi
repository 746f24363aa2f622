# The public names for type checkers and editors; `__init__.py` imports each when it is first used.
from estimation.channel.estimate import estimate_channel as estimate_channel
from estimation.channel.record import ChannelEstimate as ChannelEstimate
from estimation.channel.still import is_still as is_still
from estimation.shape.outline import ObjectOutline as ObjectOutline
from estimation.shape.outline import contours_of as contours_of
from estimation.shape.record import Contours as Contours
from estimation.shape.record import Shapes as Shapes
from estimation.slam.record import IncidencePoints as IncidencePoints
from estimation.slam.record import PoseEstimates as PoseEstimates
from estimation.tracks.record import EchoSurvey as EchoSurvey
from estimation.tracks.record import Tracks as Tracks
from isac_arena import datasets as datasets
from isac_arena.api import FinishedRun as FinishedRun
from isac_arena.api import fit_contours as fit_contours
from isac_arena.api import map_points as map_points
from isac_arena.api import open as open
from isac_arena.api import run as run
from isac_arena.api import score as score
from isac_arena.api import slam as slam
from isac_arena.api import track as track
from isac_arena.campaign.campaign import Campaign as Campaign
from isac_arena.campaign.campaign import load_campaign as load_campaign
from isac_arena.campaign.chain.inputs import known_receiver as known_receiver
from isac_arena.campaign.chain.maps import make_map as make_map
from isac_arena.campaign.chain.memory import MemoryRun as MemoryRun
from isac_arena.campaign.config import CampaignConfig as CampaignConfig
from isac_arena.campaign.directory import open_campaign as open_campaign
from isac_arena.campaign.driver import CampaignRun as CampaignRun
from isac_arena.campaign.files import read_record as read_record
from isac_arena.campaign.load import campaign_scene as campaign_scene
from isac_arena.campaign.load import library_campaigns as library_campaigns
from isac_arena.campaign.results import MapResult as MapResult
from isac_arena.scoring.score import Scores as Scores
from scenes.config import library_scenes as library_scenes
from scenes.config import load_scene as load_scene
from scenes.contours.polygons import Polygon as Polygon
from scenes.contours.polygons import Polyline as Polyline
from scenes.contours.polygons import RoundedPolygon as RoundedPolygon
from scenes.contours.polygons import rectangle as rectangle
from scenes.contours.smooth import Circle as Circle
from scenes.contours.smooth import ClosedSpline as ClosedSpline
from scenes.contours.smooth import Ellipse as Ellipse
from scenes.contours.smooth import OpenSpline as OpenSpline
from scenes.objects.material import Material as Material
from scenes.objects.material import itu_material as itu_material
from scenes.pose import Pose as Pose
from scenes.random_arena import random_arena as random_arena
from scenes.scene import HorizontalPlane as HorizontalPlane
from scenes.scene import Scene as Scene
from scenes.scene import SceneObject as SceneObject
from scenes.walks.trajectory import RecordedWalk as RecordedWalk
from scenes.walks.trajectory import Walk as Walk
from sim.config import SimulationConfig as SimulationConfig
from sim.observation import BeamSweep as BeamSweep
from sim.propagation.paths import Paths as Paths
from sim.signal.arrays.codebook import Codebook as Codebook
from sim.signal.link import make_link as make_link
from sim.simulate import observe as observe
from sim.simulate import simulate_truth as simulate_truth
from sim.truth import Truth as Truth

__version__: str
__all__: list[str]
MODULES: tuple[str, ...]
HOMES: dict[str, tuple[str, ...]]
