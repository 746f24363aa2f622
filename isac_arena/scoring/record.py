"""Tables behind the scores: every estimate with the truth that it is assigned to."""

from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from scenes.record import BoolArray, FloatArray, IntArray, Record, TextArray, array, optional_array

ON_SURFACE_M = 0.1  # nearer to a true surface than that what is found misleads no map: most right points lie so


class PathStatus(IntEnum):
    """Status of an estimated path."""

    FALSE = 0
    WEAK = 1  # unassigned, but explained by true paths that are not significant: weak or diffuse
    DETECTED = 2


class PathKind(IntEnum):
    """Number of reflections of a true path; transmission through a wall does not count."""

    NONE = -1
    LOS = 0
    SINGLE_BOUNCE = 1
    MULTI_BOUNCE = 2


@dataclass(frozen=True)
class PathScores(Record):
    """Every estimated path of a campaign, ordered by stop and path. Errors are estimate minus truth.

    Errors are NaN unless the path is detected; `object` is empty unless the true path bounces exactly once.
    """

    stop: IntArray = array("estimate", dtype=int, doc="index of the receiver stop")
    path: IntArray = array("estimate", dtype=int, doc="index in the channel estimate of the stop")
    status: IntArray = array("estimate", dtype=int, doc="PathStatus")
    cause: TextArray = array("estimate", dtype=str, doc="why it is weak or false, see docs/metrics.md")
    is_los: BoolArray = array("estimate", dtype=bool, doc="taken as line of sight by the estimator")
    true_path: IntArray = array("estimate", dtype=int, doc="index in the true paths of the stop, -1 for none")
    kind: IntArray = array("estimate", dtype=int, doc="PathKind of the true path")
    object: TextArray = array("estimate", dtype=str, doc="object the true path bounced off")
    vertex_m: FloatArray = array("estimate", "xy", unit="m", doc="true IP of a detected single bounce, or NaN")
    vertex_height_m: FloatArray = array("estimate", unit="m", doc="height of that IP, or NaN")
    delay_error_s: FloatArray = array("estimate", unit="s", doc="error of the delay")
    aod_error_rad: FloatArray = array("estimate", unit="rad", doc="error of the departure, cone or azimuth")
    aoa_error_rad: FloatArray = array("estimate", unit="rad", doc="error of the arrival, cone or azimuth")
    delay_std_s: FloatArray = array("estimate", unit="s", doc="reported standard deviation of the delay")
    aod_std_rad: FloatArray = array("estimate", unit="rad", doc="reported, of the azimuth of departure")
    aoa_std_rad: FloatArray = array("estimate", unit="rad", doc="reported, of the azimuth of arrival")
    aod_is_cone: BoolArray = array("estimate", dtype=bool, doc="the departure is a cone angle, not an azimuth")
    aoa_is_cone: BoolArray = array("estimate", dtype=bool, doc="the arrival is a cone angle, not an azimuth")
    power_error_db: FloatArray = array("estimate", unit="dB", doc="error of the power in the best beam pair")
    nees: FloatArray = array("estimate", doc="squared error over covariance, 3 degrees of freedom")
    tx: IntArray = optional_array("estimate", dtype=int, doc="index of the TX, among several of a campaign")
    hall_class: IntArray = optional_array("estimate", dtype=int, doc="most probable HallClass, -1 unknown")
    true_class: IntArray = optional_array("estimate", dtype=int, doc="true HallClass, -1 for a weak specular path")
    plan_object: TextArray = optional_array(
        "estimate", dtype=str, doc="the only upright object the true path bounced off, else as `object`"
    )

    def __post_init__(self) -> None:
        n = len(self.stop)
        unknown = {"hall_class": np.full(n, -1), "true_class": np.full(n, -1)}
        self._fill(tx=np.zeros(n, int), plan_object=self.object, **unknown)
        super().__post_init__()

    @property
    def angle_names(self) -> dict[str, str]:
        """What departures ("aod") and arrivals ("aoa") are: 'azimuth', 'cone angle' or, mixed, 'angle'."""
        names = {}
        for key, is_cone in (("aod", self.aod_is_cone), ("aoa", self.aoa_is_cone)):
            names[key] = "azimuth" if not is_cone.any() else "cone angle" if is_cone.all() else "angle"
        return names


@dataclass(frozen=True)
class SignificantPaths(Record):
    """Every true path that a receiver can detect, in the frames of its devices."""

    stop: IntArray = array("true_path", dtype=int, doc="index of the receiver stop")
    path: IntArray = array("true_path", dtype=int, doc="index in the true paths of the stop")
    kind: IntArray = array("true_path", dtype=int, doc="PathKind")
    object: TextArray = array("true_path", dtype=str, doc="object of a single bounce, else empty")
    vertex_m: FloatArray = array("true_path", "xy", unit="m", doc="IP of a single bounce, or NaN")
    delay_s: FloatArray = array("true_path", unit="s", doc="delay with the clock bias")
    aod_azimuth_rad: FloatArray = array("true_path", unit="rad", doc="azimuth of departure, TX frame")
    aoa_azimuth_rad: FloatArray = array("true_path", unit="rad", doc="azimuth of arrival, RX frame")
    power_dbm: FloatArray = array("true_path", unit="dBm", doc="received power in the best beam pair")
    is_detected: BoolArray = array("true_path", dtype=bool, doc="an estimate is assigned to it")
    is_separable: BoolArray = array(
        "true_path", dtype=bool, doc="its joint bound allows to tell it from its neighbours and diffuse power"
    )
    share_of_cell: FloatArray = array(
        "true_path", doc="largest joint bound over a resolution cell, diffuse included"
    )
    cause: TextArray = array("true_path", dtype=str, doc="why it was missed, see docs/metrics.md")
    delay_bound_s: FloatArray = array("true_path", unit="s", doc="joint bound: all paths of the stop unknown")
    aod_bound_rad: FloatArray = array("true_path", unit="rad", doc="bound of the departure, cone or azimuth")
    aoa_bound_rad: FloatArray = array("true_path", unit="rad", doc="bound of the arrival, cone or azimuth")
    delay_lone_bound_s: FloatArray = array("true_path", unit="s", doc="bound of the delay without other paths")
    aod_lone_bound_rad: FloatArray = array("true_path", unit="rad", doc="bound of departure without other paths")
    aoa_lone_bound_rad: FloatArray = array("true_path", unit="rad", doc="bound of arrival without other paths")
    delay_scattered_bound_s: FloatArray = array("true_path", unit="s", doc="bound with diffuse power as noise")
    aod_scattered_bound_rad: FloatArray = array("true_path", unit="rad", doc="departure, diffuse power as noise")
    aoa_scattered_bound_rad: FloatArray = array("true_path", unit="rad", doc="arrival, diffuse power as noise")
    tx: IntArray = optional_array("true_path", dtype=int, doc="index of the TX, among several of a campaign")

    def __post_init__(self) -> None:
        self._fill(tx=np.zeros(len(self.stop), int))
        super().__post_init__()


@dataclass(frozen=True)
class StopScores(Record):
    """GOSPA between the estimated and the significant true paths of every stop; a row for each of several TX.

    Order 2, cutoff 1; the base distance is the root mean square of the errors in units of the gate. Weak
    estimates are not counted.
    """

    stop: IntArray = array("stop", dtype=int, doc="index of the receiver stop")
    gospa: FloatArray = array("stop", doc="GOSPA of the paths")
    localisation: FloatArray = array("stop", doc="part of GOSPA from errors of assigned paths")
    missed: FloatArray = array("stop", doc="part of GOSPA from missed paths")
    false: FloatArray = array("stop", doc="part of GOSPA from false paths")
    tx: IntArray = optional_array("stop", dtype=int, doc="index of the TX, among several of a campaign")
    rx_height_m: FloatArray = optional_array("stop", unit="m", doc="of the receiver as the hall was read, or NaN")
    ceiling_m: FloatArray = optional_array("stop", unit="m", doc="height of the ceiling as read, or NaN")

    def __post_init__(self) -> None:
        unknown = np.full(len(self.stop), np.nan)
        self._fill(tx=np.zeros(len(self.stop), int), rx_height_m=unknown, ceiling_m=unknown)
        super().__post_init__()


@dataclass(frozen=True)
class PoseScores(Record):
    """Receiver state per stop: the truth and the errors of SLAM, NaN where SLAM found no solution."""

    stop: IntArray = array("stop", dtype=int, doc="index of the receiver stop")
    has_los: BoolArray = array("stop", dtype=bool, doc="the true line of sight is a significant path")
    status: IntArray = array("stop", dtype=int, doc="SolveStatus of SLAM")
    true_position_m: FloatArray = array("stop", "xy", unit="m", doc="true receiver position")
    true_heading_rad: FloatArray = array("stop", unit="rad", doc="true receiver heading")
    true_clock_bias_s: FloatArray = array("stop", unit="s", doc="true receiver clock bias")
    position_m: FloatArray = array("stop", "xy", unit="m", doc="estimated receiver position")
    position_error_m: FloatArray = array("stop", unit="m", doc="distance of the estimate to the truth")
    heading_error_rad: FloatArray = array("stop", unit="rad", doc="estimate minus truth, wrapped")
    clock_error_s: FloatArray = array("stop", unit="s", doc="estimate minus truth")
    nees: FloatArray = array("stop", doc="squared error over covariance, 4 degrees of freedom")
    position_nees: FloatArray = array("stop", doc="NEES of the position, 2 degrees of freedom")
    height_error_m: FloatArray = array("stop", unit="m", doc="estimate minus truth; NaN in the plane")
    height_nees: FloatArray = array("stop", doc="squared height error over variance; NaN in the plane")
    position_std_m: FloatArray = array("stop", unit="m", doc="stated deviation of the position, over all modes")
    is_ambiguous: BoolArray = array("stop", dtype=bool, doc="flagged by SLAM: two modes are near-equal")
    position_bound_m: FloatArray = array("stop", unit="m", doc="bound of the position from this stop alone")
    heading_bound_rad: FloatArray = array("stop", unit="rad", doc="bound of the heading from this stop alone")
    clock_bound_s: FloatArray = array("stop", unit="s", doc="bound of the clock bias from this stop alone")
    most_influential_path: IntArray = array(
        "stop", dtype=int, doc="index of the path without which the position moves most; -1 where unknown"
    )
    path_influence_m: FloatArray = array("stop", unit="m", doc="by which it moves without that path, or NaN")


@dataclass(frozen=True)
class IpScores(Record):
    """Every incidence point of one map, in the order of the map."""

    stop: IntArray = array("ip", dtype=int, doc="stop the path belongs to")
    path: IntArray = array("ip", dtype=int, doc="index in the channel estimate of the stop")
    is_inlier: BoolArray = array("ip", dtype=bool, doc="taken as a single bounce by the estimator")
    label: IntArray = array("ip", dtype=int, doc="cluster, -1 for none")
    object: TextArray = array(
        "ip", dtype=str, doc="object of the true bounce, the only one seen from above; else empty"
    )
    cause: TextArray = array("ip", dtype=str, doc="why an inlier has no object, or a single bounce is no inlier")
    surface_distance_m: FloatArray = array(
        "ip",
        unit="m",
        doc="distance to the nearest true surface: in plan to objects and meshes; in height to floor or ceiling "
        "of points that stem from it, NaN where their height is unknown",
    )
    surface_nees: FloatArray = array(
        "ip",
        doc="square of that distance over the stated variance across the surface; NaN for no true single bounce",
    )
    position_error_m: FloatArray = array(
        "ip", unit="m", doc="distance to the true IP, or NaN: a weak path is a sum of many, with no one true IP"
    )
    nees: FloatArray = array("ip", doc="squared position error over covariance, 2 degrees of freedom")
    height_error_m: FloatArray = array("ip", unit="m", doc="height minus the true IP's; NaN in the plane")
    height_nees: FloatArray = array("ip", doc="squared height error over variance; NaN in the plane")


@dataclass(frozen=True)
class OutlineScores(Record):
    """Every outline of one map with the object that it shows: the paper's outlines of clusters, or ours.

    Errors are NaN where there is no object. The paper's outlines are sampled over the polar angle; their bands and
    CRPS are those of the radius. Our outlines are sampled as points; their bands and CRPS are along the normal.
    """

    object: TextArray = array("outline", dtype=str, doc="object that at least half of its IPs stem from, or empty")
    purity: FloatArray = array("outline", doc="share of the most frequent object among the IPs")
    n_ips: IntArray = array("outline", dtype=int, doc="incidence points that it was fitted to")
    n_close: IntArray = array("outline", dtype=int, doc="IPs that stem from the object and lie close to it")
    is_found: BoolArray = array("outline", dtype=bool, doc="enough close IPs to call the object found")
    is_ghost: BoolArray = array("outline", dtype=bool, doc="more than half of the IPs stem from no object")
    cause: TextArray = array("outline", dtype=str, doc="most frequent cause of the IPs of a ghost")
    surface_m: FloatArray = array(
        "outline", unit="m", doc="median distance of the IPs to the nearest true surface"
    )
    iou: FloatArray = array("outline", doc="intersection over union of the areas, closed objects")
    hausdorff_m: FloatArray = array("outline", unit="m", doc="Hausdorff distance of the contours")
    modified_hausdorff_m: FloatArray = array("outline", unit="m", doc="larger mean distance of the contours")
    chamfer_m: FloatArray = array("outline", unit="m", doc="mean of the two mean distances of the contours")
    seen_rmse_m: FloatArray = array("outline", unit="m", doc="RMS distance of the seen contour to the object")
    full_rmse_m: FloatArray = array("outline", unit="m", doc="RMS distance of the full contour to the object")
    coverage95: FloatArray = array("outline", doc="share of samples whose 95 % band contains the true outline")
    seen_coverage95: FloatArray = array("outline", doc="coverage of the seen samples")
    crps_m: FloatArray = array("outline", unit="m", doc="mean CRPS of the predicted radius or distance")
    extent_iou: FloatArray = array("outline", doc="overlap of the seen contour with the lit extent, walls")

    @property
    def is_false(self) -> BoolArray:
        """Whether each outline shows no object of the scene."""
        return self.is_ghost

    @property
    def is_right_surface(self) -> BoolArray:
        """Whether each outline is a ghost whose points lie on a true surface: the right place by wrong paths."""
        return np.asarray(self.is_ghost & (self.surface_m <= ON_SURFACE_M))


@dataclass(frozen=True)
class ContourScores(OutlineScores):
    """Every contour of ours in one map, and whether its class is correct."""

    class_right: FloatArray = array("outline", doc="1 where the most probable class is the object's, else 0")
    is_phantom: BoolArray = array("outline", dtype=bool, doc="closed, and no object covers half of its area")

    @property
    def is_false(self) -> BoolArray:
        """Whether each contour shows no object of the scene: a ghost or a phantom."""
        return self.is_ghost | self.is_phantom

    @property
    def is_right_surface(self) -> BoolArray:
        """As that of `OutlineScores`; a phantom shows nothing."""
        return super().is_right_surface & ~self.is_phantom

    @property
    def is_mixed(self) -> BoolArray:
        """Whether the points of each contour are of several objects, none of which has half of them."""
        return np.asarray((self.object == "") & ~self.is_false)


@dataclass(frozen=True)
class SceneScores(Record):
    """GOSPA between all closed outlines of one map and all lit closed objects.

    Order 2, cutoff 1; the base distance is 1 - IoU.
    """

    method: TextArray = array("method", dtype=str, doc="shapes: the paper's; contours: ours")
    gospa: FloatArray = array("method", doc="GOSPA of the outlines")
    localisation: FloatArray = array("method", doc="part of GOSPA from errors of assigned outlines")
    missed: FloatArray = array("method", doc="part of GOSPA from missed objects")
    false: FloatArray = array("method", doc="part of GOSPA from false outlines")


@dataclass(frozen=True)
class MapScores(Record):
    """Tables of one map."""

    ips: IpScores
    clusters: OutlineScores
    contours: ContourScores
    scene: SceneScores


@dataclass(frozen=True)
class TrackScores(Record):
    """Every mover at every stop, by mover and stop, and the tracks of every stop as a set."""

    mover: TextArray = array("mover_state", dtype=str, doc="name of the mover")
    mover_stop: IntArray = array("mover_state", dtype=int, doc="index of the receiver stop")
    true_position_m: FloatArray = array("mover_state", "xy", unit="m", doc="true position of its middle")
    true_velocity_m_s: FloatArray = array("mover_state", "xy", unit="m/s", doc="true velocity of its middle")
    is_in_view: BoolArray = array("mover_state", dtype=bool, doc="a path of one bounce meets it, above the noise")
    track: IntArray = array("mover_state", dtype=int, doc="track that follows it, -1 for none")
    position_error_m: FloatArray = array("mover_state", unit="m", doc="distance of the track, or NaN")
    velocity_error_m_s: FloatArray = array("mover_state", unit="m/s", doc="error of its velocity, or NaN")
    velocity_bound_m_s: FloatArray = array("mover_state", unit="m/s", doc="bound of that error, or NaN")
    stop: IntArray = array("stop", dtype=int, doc="index of the receiver stop")
    gospa_m: FloatArray = array("stop", unit="m", doc="GOSPA of the tracks and the movers in view, cutoff 1 m")
    gospa_all_m: FloatArray = array("stop", unit="m", doc="the same with all movers")
    n_false: IntArray = array("stop", dtype=int, doc="tracks that follow no mover")


@dataclass(frozen=True)
class ScoreTables(Record):
    """All tables of a campaign."""

    paths: PathScores
    significant: SignificantPaths
    stops: StopScores
    poses: PoseScores
    published: PoseScores
    mapping: MapScores
    slam: MapScores
    tracks: TrackScores | None = None  # absent where nothing moves
