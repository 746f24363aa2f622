"""A synthetic campaign whose truth is known in closed form: pillars, walls, a double bounce, diffuse paths."""

from dataclasses import dataclass, replace

import numpy as np

from estimation.channel.beam_power_map import BeamPowerMap
from estimation.channel.config import ChannelConfig
from estimation.channel.record import ChannelEstimate, PathMotion
from estimation.shape.fit import OK
from estimation.shape.record import CLASS_NAMES, Contours, Shapes
from estimation.shape.reflection.rows import no_contours
from estimation.slam.record import IncidencePoints, SolveStatus
from estimation.tracks.record import EchoSurvey, Tracks
from isac_arena.campaign.config import CampaignConfig
from isac_arena.campaign.results import CampaignResults, MapResult
from isac_arena.scoring.link_view import LinkView, link_view
from isac_arena.scoring.true_stop import device_parameters
from isac_arena.validation.scenarios.estimates import made_estimate, made_poses, true_states
from isac_arena.validation.scenarios.paths import over_points
from scenes.contours import Circle, Polyline
from scenes.motion.motion import steady_motion
from scenes.objects.material import Material
from scenes.pose import SPEED_OF_LIGHT_M_S, Pose
from scenes.record import FloatArray, IntArray
from scenes.scene import Scene, SceneObject
from scenes.walks.trajectory import Walk
from sim.config import ArrayConfig, WaveformConfig
from sim.propagation.paths import BounceKind, Paths
from sim.signal.link import make_link
from sim.truth import Truth

PILLARS = {"pillar_a": Circle(np.array([0.0, -4.0]), 0.3), "pillar_b": Circle(np.array([4.0, -4.0]), 0.4)}
WALLS = {
    "wall_south": Polyline(np.array([[-4.0, -7.0], [7.5, -7.0]])),
    "wall_east": Polyline(np.array([[8.0, -6.0], [8.0, 3.0]])),
}
LIT_WALLS_M = np.array([[2.5, 0.05], [0.8, 0.05]])  # half of their length, and of how thick they are drawn
NAMES = [*PILLARS, *WALLS]
SINGLES = len(NAMES)
DOUBLE, DIFFUSE = SINGLES + 1, SINGLES + 2  # rows of a stop's paths behind the LOS and the single bounces
HEADING_RAD = 0.3
STOP_INTERVAL_S, ECHO_HZ = 0.5, 120.0  # of a pillar that moves
SMALL_LINK = CampaignConfig(
    name="small",
    scene="made_up",
    channel=ChannelConfig(method="power"),
    waveform=WaveformConfig(comb=12),
    tx_array=ArrayConfig(rows=1, columns=8, beams_per_panel=12),
    rx_array=ArrayConfig(
        rows=1, columns=8, beams_per_panel=8, sector_deg=90.0, panel_azimuth_deg=[-180.0, -90.0, 0.0, 90.0]
    ),
)


@dataclass(frozen=True)
class MadeCampaign:
    """Scene, truths and estimates without any error."""

    scene: Scene
    truths: tuple[Truth, ...]
    results: CampaignResults


def make_scene() -> Scene:
    """Two pillars and two walls beside a straight walk."""
    metal = Material("metal", 1.0, 1e7)
    objects = (
        *(SceneObject(name, "pillar", contour, 0.0, 4.0, metal) for name, contour in PILLARS.items()),
        *(SceneObject(name, "wall", contour, 0.0, 4.0, metal) for name, contour in WALLS.items()),
    )
    walk = Walk(np.array([[-1.5, -1.5], [6.0, -1.5]]), 1.8, HEADING_RAD, 12)
    return Scene("made_up", objects, Pose(np.array([2.0, 2.0, 1.8]), -np.pi / 2), walk, (-6, -9, 10, 5))


def bounce_points(tx: FloatArray, rx: FloatArray) -> FloatArray:
    """A point (object, xy) on each object: near the specular point on the pillars, at it on the walls."""
    points = []
    for pillar in PILLARS.values():
        to_tx, to_rx = tx - pillar.center_m, rx - pillar.center_m
        normal = to_tx / np.linalg.norm(to_tx) + to_rx / np.linalg.norm(to_rx)
        points.append(pillar.center_m + pillar.radius_m * normal / np.linalg.norm(normal))
    for axis, level in ((1, -7.0), (0, 8.0)):
        share = (level - tx[axis]) / (2 * level - rx[axis] - tx[axis])
        mirrored = np.where(np.arange(2) == axis, 2 * level - rx, rx)
        points.append(tx + share * (mirrored - tx))
    return np.array(points)


def make_truth(scene: Scene, stop: int) -> Truth:
    """LOS, a single bounce per object, a double bounce and two diffuse paths off the first pillar."""
    tx, pose = scene.tx.position_m[:2], scene.stops[stop]
    rx = pose.position_m[:2]
    chains = [[], *([point] for point in bounce_points(tx, rx))]
    chains += [[chains[1][0], chains[3][0]], [chains[1][0] + [0.02, 0.0]], [np.array([-2.0, -7.0])]]
    objects = [[], [0], [1], [2], [3], [0, 2], [0], [2]]
    level_db = np.array([0.0, -14, -14, -8, -9, -10, -35, -40])
    rows = np.array([over_points(np.array([tx, *chain, rx])) for chain in chains])
    delay_s, aod, aoa = rows[:, 0] / SPEED_OF_LIGHT_M_S, rows[:, 1], rows[:, 2]
    vertex_m = np.full((len(rows), 2, 3), np.nan)
    bounce_object, kind = np.full((len(rows), 2), -1), np.zeros((len(rows), 2), int)
    for row, (chain, met) in enumerate(zip(chains, objects, strict=True)):
        for slot, point in enumerate(chain):
            vertex_m[row, slot] = [*point, 1.8]
            bounce_object[row, slot] = met[slot]
            kind[row, slot] = BounceKind.DIFFUSE if row >= DIFFUSE else BounceKind.SPECULAR
    level = np.zeros(len(rows))
    gain = 10 ** (level_db / 20) / (SPEED_OF_LIGHT_M_S * delay_s)
    paths = Paths(gain + 0j, delay_s, aod, level, aoa, level, kind, bounce_object, vertex_m, np.array(NAMES))
    return Truth(paths, pose, stop, (20.0 + stop) * 1e-9)


def power_dbm(truth: Truth) -> FloatArray:
    """Power of the true paths: that between two isotropic elements at 0 dBm."""
    return np.asarray(10 * np.log10(truth.paths.power))


def exact_estimate(scene: Scene, truth: Truth) -> ChannelEstimate:
    """LOS, single and double bounces without error."""
    parameters = device_parameters(truth, scene.tx)[: DOUBLE + 1]
    std = np.array([0.3e-9, np.deg2rad(0.5), np.deg2rad(0.5)])
    count = len(parameters)
    return made_estimate(truth.stop, parameters, power_dbm(truth)[:count], np.diag(std**2), np.arange(count) == 0)


def exact_shapes(scene: Scene, label: IntArray, n_samples: int = 360) -> Shapes:
    """The true circles of the pillars, and flat ellipses along the lit part of each wall."""
    angle = np.linspace(-np.pi, np.pi, n_samples, endpoint=False)
    center = np.array([*(pillar.center_m for pillar in PILLARS.values()), [2.2, -7.0], [8.0, 0.0]])
    radii = [pillar.radius_m for pillar in PILLARS.values()]
    along, across = (np.array([*radii, *ends]) for ends in LIT_WALLS_M.T)
    turned = angle - np.array([0.0, 0.0, 0.0, np.pi / 2])[:, None]
    radius = 1 / np.hypot(np.cos(turned) / along[:, None], np.sin(turned) / across[:, None])
    return Shapes(label, center, angle, radius, np.full_like(radius, 0.05), *5 * [np.ones(SINGLES)])


def exact_contours(scene: Scene, ips: IncidencePoints, label: IntArray, n_samples: int = 180) -> Contours:
    """The true circles of the pillars, and of each wall what lies between its outermost incidence points."""
    contours = []
    for number, item in enumerate(scene.objects):
        points = ips.position_m[label == number]
        if isinstance(item.contour, Circle):
            angle = np.linspace(-np.pi, np.pi, n_samples, endpoint=False)
            unit = np.stack([np.cos(angle), np.sin(angle)], axis=1)
            contours.append(item.contour.center_m + item.contour.radius_m * unit)
        else:
            contours.append(np.linspace(points.min(axis=0), points.max(axis=0), n_samples))
    contour = np.array(contours)
    is_pillar = np.array([item.kind == "pillar" for item in scene.objects])
    lit = np.linalg.norm(contour[:, -1] - contour[:, 0], axis=1)
    kind = np.where(is_pillar, "pillar", "wall")
    return replace(
        no_contours(len(ips), len(scene.stops), "exact"),
        kind=np.where(is_pillar, "circle", "wall"),
        status=np.full(SINGLES, OK),
        is_closed=is_pillar,
        center_m=contour.mean(axis=1),
        contour_m=contour,
        std_m=np.full(contour.shape[:2], 0.01),
        extent_m=np.where(is_pillar, np.ptp(contour[:, :, 0], axis=1) / 2, lit),
        extent_std_m=np.full(SINGLES, 0.01),
        class_probability=(kind[:, None] == np.array(CLASS_NAMES)).astype(float),
        cluster=np.arange(SINGLES),
        object=label,
    )


def exact_map(scene: Scene, truths: tuple[Truth, ...], status: SolveStatus) -> MapResult:
    """True poses, the true incidence point of every single bounce, and one cluster per object."""
    n = len(truths)
    poses = made_poses(true_states(truths), status, n_inliers=5)
    label = np.tile(np.arange(SINGLES), n)
    ips = IncidencePoints(
        stop=np.repeat(poses.stop, SINGLES),
        path=np.tile(np.arange(1, SINGLES + 1), n),
        position_m=np.concatenate([truth.paths.vertex_m[1 : SINGLES + 1, 0, :2] for truth in truths]),
        covariance_m2=np.tile(0.01 * np.eye(2), (n * SINGLES, 1, 1)),
        cost=np.zeros(n * SINGLES),
        is_inlier=np.ones(n * SINGLES, bool),
    )
    return MapResult(poses, ips, exact_shapes(scene, label), exact_contours(scene, ips, label))


def make_power_map(truth: Truth, scene: Scene) -> BeamPowerMap:
    """Gaussian beams on every true path, over noise."""
    tx, rx = np.deg2rad(np.linspace(-70, 70, 32)), np.deg2rad(np.arange(-180, 180, 3.75))
    parameters, power = device_parameters(truth, scene.tx), 10 ** (power_dbm(truth) / 10)
    beam = np.deg2rad(4.0)
    tx_gain = np.exp(-(((tx[:, None] - parameters[:, 1]) / beam) ** 2))
    rx_gain = np.exp(-((np.angle(np.exp(1j * (rx[:, None] - parameters[:, 2]))) / beam) ** 2))
    return BeamPowerMap(truth.stop, tx, rx, 10 * np.log10(tx_gain * power @ rx_gain.T + 1e-6))


def make_campaign() -> MadeCampaign:
    """Scene, truths and the results of a perfect estimator at twelve stops."""
    scene = make_scene()
    truths = tuple(make_truth(scene, stop) for stop in range(len(scene.stops)))
    results = CampaignResults(
        channel=tuple(exact_estimate(scene, truth) for truth in truths),
        power_maps=tuple(make_power_map(truth, scene) for truth in truths),
        mapping=exact_map(scene, truths, SolveStatus.GIVEN),
        slam=exact_map(scene, truths, SolveStatus.LOS),
    )
    return MadeCampaign(scene, truths, results)


def make_moving_campaign(velocity_m_s: FloatArray) -> MadeCampaign:
    """The same as if its first pillar moved: the second path of every stop is its echo, and SLAM has its track."""
    made = make_campaign()
    pillar, *others = made.scene.objects
    walk = replace(made.scene.walk, stop_interval_s=STOP_INTERVAL_S)
    scene = replace(made.scene, objects=(replace(pillar, motion=steady_motion(velocity_m_s)), *others), walk=walk)
    channel = []
    for one in made.results.channel:
        moves, shift_hz = np.arange(len(one)) == 1, np.where(np.arange(len(one)) == 1, ECHO_HZ, 0.0)
        motion = PathMotion(moves, shift_hz, np.where(moves, 1.0, np.nan), np.zeros(len(one)))
        channel.append(replace(one, motion=motion))
    stop = np.array([one.stop for one in channel])
    n, time_s = len(stop), STOP_INTERVAL_S * np.arange(float(len(stop)))
    survey = EchoSurvey(stop, time_s, np.zeros((1, 3)), np.zeros(1), 0.005, np.zeros(1), np.zeros(1))
    place_m, speed_m_s = pillar.pivot_m[:2] + time_s[:, None] * velocity_m_s[:2], np.tile(velocity_m_s[:2], (n, 1))
    tracks = Tracks(
        survey, np.zeros(n, int), stop, place_m, speed_m_s, height_m=np.ones(n), existence=np.full(n, 0.9),
        covariance=np.tile(np.eye(5) * 0.01, (n, 1, 1)), echo_stop=stop, echo_path=np.ones(n, int),
        echo_track=np.zeros(n, int),
    )  # fmt: skip
    slam = replace(made.results.slam, tracks=tracks)
    return MadeCampaign(scene, made.truths, replace(made.results, channel=tuple(channel), slam=slam))


def made_view() -> LinkView:
    """The view of a small link in the made scene."""
    return link_view(SMALL_LINK, make_link(SMALL_LINK), make_scene())
