"""What is known of a hall: its heights, what its paths are like, and its paths."""

from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np

from estimation.channel.hall.geometry import NO_CEILING_M, Heights
from estimation.channel.record import ChannelEstimate, PathsInHall
from scenes.record import FloatArray, IntArray, Record, TextArray, array, empty_record


class HallClass(StrEnum):
    """Class of a path; the axis `class` of arrays has this order."""

    LINE_OF_SIGHT = "line of sight"
    LEVEL = "level"
    FLOOR_OR_CEILING = "floor or ceiling"
    WEAK = "weak or diffuse"


@dataclass(frozen=True)
class ClassPriors(Record):
    """What paths of each state are like."""

    share: FloatArray = array("state", doc="of the paths that are not the line of sight")
    mean: FloatArray = array("state", "feature", doc="loss beyond free space in dB, then features of `StopPowers`")
    covariance: FloatArray = array("state", "feature", "feature2", doc="of these")
    has_versions: FloatArray = array("state", doc="probability of versions among the other paths")


@dataclass(frozen=True)
class HallModel(Record):
    """A hall as channel estimates of some stops show it. Heights are those of TX, receiver and ceiling."""

    priors: ClassPriors  # what paths of each class are like
    heights_m: FloatArray = array("height", unit="m", doc="above the floor")
    covariance_m2: FloatArray = array("height", "height2", unit="m^2", doc="0 for a height given without error")
    stop: IntArray = array("read_stop", dtype=int, doc="index of every stop that was read")
    clock_m: FloatArray = array("read_stop", unit="m", doc="its clock bias times the speed of light")
    clock_std_m: FloatArray = array("read_stop", unit="m", doc="standard deviation of that")
    merit: float = array(doc="log evidence of the solution, by the classes of paths and by the votes of pairs")
    other_heights_m: FloatArray = array(
        "other", "height", unit="m", doc="other solutions that explain the estimates nearly as well"
    )
    other_merit: FloatArray = array("other", doc="their merits")
    caveats: TextArray = array("caveat", dtype=str, doc="what the estimates cannot tell")
    by_elevation: bool = array(
        dtype=bool, doc="whether elevations count for heights: not where those of both devices were surveyed"
    )

    @property
    def heights(self) -> Heights:
        """The heights above the floor."""
        return Heights(*map(float, self.heights_m))

    @property
    def sees_ceiling(self) -> bool:
        """Whether paths by way of a ceiling show; if not, its height is out of reach."""
        return bool(self.heights_m[2] < NO_CEILING_M / 2)

    @property
    def shown_m(self) -> FloatArray:
        """Heights (3,) of TX, receiver and ceiling; NaN for a ceiling that does not show."""
        return np.where([True, True, self.sees_ceiling], self.heights_m, np.nan)

    @property
    def height_std_m(self) -> FloatArray:
        """Standard deviations (3,) of the heights of TX, receiver and ceiling."""
        return np.asarray(np.sqrt(np.diagonal(self.covariance_m2)), float)


@dataclass(frozen=True)
class ReadPaths(Record):
    """The paths of a campaign in its hall, one stop after the other, sorted by delay at each."""

    stop: IntArray = array("path", dtype=int, doc="index of the receiver stop")
    row: IntArray = array("path", dtype=int, doc="row of the path among those that its stop reported before")
    delay_s: FloatArray = array("path", unit="s", doc="time of arrival, clock bias included")
    angle_rad: FloatArray = array("path", "angle", unit="rad", doc="both azimuths, then both elevations")
    covariance: FloatArray = array(
        "path", "parameter", "parameter2", unit="(s, rad, ...)^2", doc="of delay and these; NaN unknown"
    )
    class_probability: FloatArray = array("path", "class", doc="of the classes in the order of HallClass")
    version_probability: FloatArray = array("path", "version", doc="of the versions, if the path is not weak")
    tied_probability: FloatArray = array("path", doc="that other versions of its plan path are among the paths")


@dataclass(frozen=True)
class HallEstimates(Record):
    """The hall of a campaign and its paths. Without a `model` nothing is known of a hall, and no path is there."""

    paths: ReadPaths
    stops: IntArray = array("stop", dtype=int, doc="indices of the stops, in order")
    model: HallModel | None = None

    def applied(self, estimate: ChannelEstimate) -> ChannelEstimate:
        """The reported paths of a stop with versions tied."""
        if self.model is None or not len(estimate):
            return replace(estimate, correlated=None)
        own = self.paths.take("path", self.paths.stop == estimate.stop)
        taken, size = estimate.take("path", own.row), estimate.size("parameter")
        return replace(
            taken,
            delay_s=own.delay_s,
            aod_azimuth_rad=own.angle_rad[:, 0],
            aoa_azimuth_rad=own.angle_rad[:, 1],
            aod_elevation_rad=own.angle_rad[:, 2],
            aoa_elevation_rad=own.angle_rad[:, 3],
            covariance=own.covariance[:, :size, :size],
            correlated=None,
            hall=PathsInHall(
                own.class_probability, own.version_probability, own.tied_probability, self.model.shown_m
            ),
        )


def no_hall(stops: IntArray) -> HallEstimates:
    """Of a campaign without a hall, or none that is read."""
    return HallEstimates(empty_record(ReadPaths), stops)
