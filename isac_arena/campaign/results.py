"""What the chain produced for a campaign, and where a run keeps it."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Literal, Protocol

from estimation.channel.beam_power_map import BeamPowerMap
from estimation.channel.calibration.record import Calibration
from estimation.channel.hall.record import HallEstimates
from estimation.channel.record import ChannelEstimate, EstimateStatus
from estimation.shape.record import Contours, Shapes
from estimation.slam.record import IncidencePoints, PoseEstimates
from estimation.tracks.record import Tracks
from scenes.record import IntArray, Record, array
from sim.observation import BeamSweep
from sim.truth import Truth

# The steps of both maps, and the usual share of each in their time, in %.
MAP_STEPS = {"mapping": 1, "contours of mapping": 11, "SLAM": 78, "contours of SLAM": 7, "published SLAM": 3}
MapName = Literal["mapping", "slam"]


@dataclass(frozen=True)
class StopEstimate(Record):
    """One channel file: the paths of a stop and its beam power map."""

    channel: ChannelEstimate
    power_map: BeamPowerMap


@dataclass(frozen=True)
class MapResult(Record):
    """A map of the scene, from mapping or from SLAM.

    Receiver poses, incidence points, the paper's shapes of clusters and our contours of objects, or those of the
    user's functions in their place.
    """

    poses: PoseEstimates
    ips: IncidencePoints
    shapes: Shapes
    contours: Contours
    problem: str = array(dtype=str, default="", doc="how a user's function failed; empty where none did")
    published: PoseEstimates | None = None  # SLAM: by the published algorithm, to compare with
    tracks: Tracks | None = None  # SLAM: what moves; absent where nothing does


@dataclass(frozen=True)
class CampaignResults:
    """All estimates of a campaign. `channel` and `power_maps` have one entry per stop, in order.

    With several TX an estimate has the paths of all, and the power maps are those of the first. `power_maps` is
    for figures; it is empty where none are drawn.
    """

    channel: tuple[ChannelEstimate, ...]
    power_maps: tuple[BeamPowerMap, ...]
    mapping: MapResult
    slam: MapResult

    @property
    def failures(self) -> list[str]:
        """How functions of a user failed, one by one."""
        at_stops = [one.reason for one in self.channel if one.status == EstimateStatus.FAILED]
        return [*at_stops, *filter(None, (self.mapping.problem, self.slam.problem))]


@dataclass(frozen=True)
class Oracle:
    """Truth in place of the records behind the channel estimates; what is None is estimated.

    `has_all_points` states that each path of `channel` is a line of sight or a single bounce: then each incidence
    point is an inlier. `clusters` gives the cluster (ip,) of each incidence point, -1 for none.
    """

    channel: Sequence[ChannelEstimate] | None = None
    receiver: PoseEstimates | None = None
    has_all_points: bool = False
    clusters: Callable[[IncidencePoints], IntArray] | None = None


class ResultStore(Protocol):
    """Where a run keeps its results. Reading returns None for a result that has to be made."""

    def of_tx(self, name: str) -> "ResultStore":
        """Where the truths, samples and channel estimates of one TX of several are kept."""

    def truth(self, stop: int) -> Truth | None:
        """The paths of a stop; the run sets the clock."""

    def write_truth(self, truth: Truth) -> None:
        """Keep the truth of a stop."""

    def sweep(self, stop: int) -> BeamSweep | None:
        """The samples of a stop."""

    def calibration(self) -> Calibration | None:
        """The self-calibration of both arrays."""

    def write_calibration(self, calibration: Calibration) -> None:
        """Keep the self-calibration."""

    def estimate(self, stop: int) -> ChannelEstimate | None:
        """The channel estimate of a stop."""

    def write_estimate(self, estimate: ChannelEstimate, sweep: BeamSweep) -> None:
        """Keep the channel estimate of a stop, and what is drawn of its sweep."""

    def hall(self) -> HallEstimates | None:
        """The hall of a link and its paths."""

    def write_hall(self, hall: HallEstimates) -> None:
        """Keep the hall."""

    def map_result(self, name: MapName) -> MapResult | None:
        """The map of mapping or SLAM."""

    def write_map(self, name: MapName, result: MapResult) -> None:
        """Keep the map of mapping or SLAM."""


@dataclass
class MemoryResults:
    """Results in memory, except the samples: they are large and made again where needed."""

    truths: dict[int, Truth] = field(default_factory=dict)
    estimates: dict[int, ChannelEstimate] = field(default_factory=dict)
    maps: dict[MapName, MapResult] = field(default_factory=dict)
    calibrated: Calibration | None = None
    found_hall: HallEstimates | None = None
    links: dict[str, "MemoryResults"] = field(default_factory=dict)

    def of_tx(self, name: str) -> "MemoryResults":
        """As `ResultStore`."""
        return self.links.setdefault(name, MemoryResults())

    def truth(self, stop: int) -> Truth | None:
        """As `ResultStore`."""
        return self.truths.get(stop)

    def write_truth(self, truth: Truth) -> None:
        """As `ResultStore`."""
        self.truths[truth.stop] = truth

    def sweep(self, stop: int) -> BeamSweep | None:
        """None: samples are not kept."""
        del stop
        return None

    def calibration(self) -> Calibration | None:
        """As `ResultStore`."""
        return self.calibrated

    def write_calibration(self, calibration: Calibration) -> None:
        """As `ResultStore`."""
        self.calibrated = calibration

    def estimate(self, stop: int) -> ChannelEstimate | None:
        """As `ResultStore`."""
        return self.estimates.get(stop)

    def write_estimate(self, estimate: ChannelEstimate, sweep: BeamSweep) -> None:
        """As `ResultStore`."""
        del sweep
        self.estimates[estimate.stop] = estimate

    def hall(self) -> HallEstimates | None:
        """As `ResultStore`."""
        return self.found_hall

    def write_hall(self, hall: HallEstimates) -> None:
        """As `ResultStore`."""
        self.found_hall = hall

    def map_result(self, name: MapName) -> MapResult | None:
        """As `ResultStore`."""
        return self.maps.get(name)

    def write_map(self, name: MapName, result: MapResult) -> None:
        """As `ResultStore`."""
        self.maps[name] = result
