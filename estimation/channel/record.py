"""The channel estimate: the paths of one stop as the receiver knows them, the same record for all methods."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Any, Self

import numpy as np

from estimation.channel.correlation import CorrelatedPaths, PointingErrors
from scenes.record import BoolArray, FloatArray, IntArray, Record, array, optional_array
from sim.observation import BeamSweep

UNKNOWN_ANGLE_VARIANCE = np.pi**2 / 3  # of a uniform angle on the circle, as with a single beam
MIN_PARAMETERS = 3  # delay, departure azimuth, arrival azimuth; then departure and arrival elevation


class EstimateStatus(StrEnum):
    """Outcome of the estimation of a stop."""

    OK = "ok"
    NO_PATHS = "no paths"  # the sweep is valid, nothing exceeds the noise
    LIMITED = "limited"  # more paths than the limit, or than the data can determine
    REFUSED = "refused"  # the samples are uninformative: empty, all zero, not finite
    FAILED = "failed"  # a user's function gave no estimate: it raised, hung, ended its process, or was not valid


class AngleKind(StrEnum):
    """What the azimuths of one device are.

    AZIMUTH
        The horizontal direction: elevation was estimated, or the path is known to be horizontal.
    CONE
        The azimuth that the beams would show at elevation 0: horizontal beams of a panel observe only
        sin(azimuth) cos(elevation) about its boresight, so a path from above or below appears nearer to it.
    """

    AZIMUTH = "azimuth"
    CONE = "cone"


@dataclass(frozen=True)
class PathMotion(Record):
    """What a sweep with a clock shows of the motion of its paths, from the Doppler shift of each.

    A path moves if its shift explains the samples better than a frozen path does, by evidence. Delays are those
    in the middle of the sweep, angles those of `seen_s`.
    """

    is_moving: BoolArray = array("path", dtype=bool, doc="whether the path has a Doppler shift, by evidence")
    doppler_hz: FloatArray = array("path", unit="Hz", doc="Doppler shift: positive where a path gets shorter")
    doppler_std_hz: FloatArray = array("path", unit="Hz", doc="its standard deviation; NaN for frozen paths")
    seen_s: FloatArray = array(
        "path", unit="s", doc="when the energy of the path arrives, since the middle of the sweep"
    )


@dataclass(frozen=True)
class PathsInHall(Record):
    """Classes of the paths of a stop, and the heights of its hall: see `estimation.channel.hall`."""

    class_probability: FloatArray = array("path", "class", doc="of the classes in the order of HallClass")
    version_probability: FloatArray = array("path", "version", doc="of the versions, if the path is not weak")
    tied_probability: FloatArray = array("path", doc="that other versions of its plan path are among the paths")
    heights_m: FloatArray = array(
        "height", unit="m", doc="of TX, receiver and ceiling above the floor; NaN: not shown"
    )

    @property
    def specular_probability(self) -> FloatArray:
        """Probability (path,) of each path to be neither weak nor diffuse: the last class."""
        return np.asarray(1 - self.class_probability[:, -1])


@dataclass(frozen=True)
class ChannelEstimate(Record):
    """Estimated paths of one stop, sorted by delay; zero paths are valid.

    Angles are in the devices' own frames: departure relative to the TX heading, arrival relative to the RX heading
    (the estimator does not know the RX heading). Delays contain the unknown clock bias.

    Fields after `is_los` are optional. If they are left out their values are unknown (NaN), the probability of the
    line of sight is 1 or 0, and azimuths are taken as horizontal.
    """

    stop: int = array(dtype=int, doc="index of the receiver stop")
    delay_s: FloatArray = array("path", unit="s", doc="time of arrival, clock bias included")
    aod_azimuth_rad: FloatArray = array("path", unit="rad", doc="azimuth of departure in the TX frame")
    aoa_azimuth_rad: FloatArray = array("path", unit="rad", doc="azimuth of arrival in the RX frame")
    power_dbm: FloatArray = array("path", unit="dBm", doc="received power in the best beam pair")
    beam_loss_db: FloatArray = array(
        "path", unit="dB", doc="nominal gain of the best beam pair below the peak of its panels; 0 where unknown"
    )
    snr_db: FloatArray = array("path", unit="dB", doc="SNR in the best beam pair after summing the subcarriers")
    covariance: FloatArray = array(
        "path",
        "parameter",
        "parameter2",
        unit="(s, rad, ...)^2",
        doc="of delay, both azimuths (departure, arrival) and, where estimated, both elevations; NaN unknown",
    )
    is_los: BoolArray = array("path", dtype=bool, doc="the path taken as line of sight: at most one")
    los_probability: FloatArray = optional_array("path", doc="probability that the path is the line of sight")
    gain_amplitude: FloatArray = optional_array(
        "path", unit="sqrt(mW)", doc="magnitude of the path gain with the transmit power, without beams"
    )
    gain_phase_rad: FloatArray = optional_array(
        "path", unit="rad", doc="phase of the path gain at the carrier; NaN if phases are not coherent"
    )
    aod_elevation_rad: FloatArray = optional_array("path", unit="rad", doc="elevation of departure; NaN unknown")
    aoa_elevation_rad: FloatArray = optional_array("path", unit="rad", doc="elevation of arrival; NaN unknown")
    unresolved_probability: FloatArray = optional_array(
        "path", doc="probability that the path stands for several closer than a resolution cell; NaN unknown"
    )
    is_weak: BoolArray = optional_array(
        "path",
        dtype=bool,
        doc="the estimator's mark: a sum of weak fields, or not resolved; mapping, SLAM and scores leave it out",
    )
    aod_angle_kind: str = optional_array(dtype=str, doc="departure azimuths are: 'azimuth' or 'cone' angles")
    aoa_angle_kind: str = optional_array(dtype=str, doc="arrival azimuths are: 'azimuth' or 'cone' angles")
    tx: IntArray = optional_array("path", dtype=int, doc="index of the TX, among several of a campaign")
    method: str = optional_array(dtype=str, doc="method that found the paths")
    status: str = optional_array(dtype=str, doc="'ok', 'no paths', 'limited', 'refused' or 'failed'")
    reason: str = optional_array(dtype=str, doc="what the method chose and why, or what is wrong")
    motion: PathMotion | None = None  # absent where the sweep has no clock, or phases are not coherent
    correlated: CorrelatedPaths | None = None  # absent where the method does not tell
    pointing: PointingErrors | None = None  # absent where both arrays point as designed
    hall: PathsInHall | None = None  # absent where no hall was read

    def __post_init__(self) -> None:
        n = len(self.delay_s)
        unknown = np.full(n, np.nan)
        self._fill(
            los_probability=np.asarray(self.is_los, float),
            gain_amplitude=unknown,
            gain_phase_rad=unknown,
            aod_elevation_rad=unknown,
            aoa_elevation_rad=unknown,
            unresolved_probability=unknown,
            is_weak=np.zeros(n, bool),
            tx=np.zeros(n, int),
            aod_angle_kind=AngleKind.AZIMUTH,
            aoa_angle_kind=AngleKind.AZIMUTH,
            method="given",
            status=EstimateStatus.OK if n else EstimateStatus.NO_PATHS,
            reason="",
        )
        super().__post_init__()

    def __len__(self) -> int:
        return self.size("path")

    def take(self, axis: str, index: Any) -> Self:
        """As `Record.take`."""
        taken = super().take(axis, index)
        if axis != "path" or self.correlated is None:
            return taken
        return replace(taken, correlated=self.correlated.of_paths(len(self), index))

    @property
    def reported(self) -> Self:
        """The estimate without its weak paths: what mapping, SLAM and scores use."""
        return self.take("path", ~self.is_weak)

    @property
    def plane_parameters(self) -> FloatArray:
        """Delay in s, azimuths of departure and of arrival in rad (path, 3)."""
        return np.stack([self.delay_s, self.aod_azimuth_rad, self.aoa_azimuth_rad], axis=-1)

    @property
    def plane_covariance(self) -> FloatArray:
        """Covariance (path, 3, 3) of delay and both azimuths, in (s, rad, rad)^2."""
        return self.covariance[:, :MIN_PARAMETERS, :MIN_PARAMETERS]


ChannelEstimator = Callable[[BeamSweep], ChannelEstimate]


def empty_estimate(stop: int, method: str, status: EstimateStatus, reason: str) -> ChannelEstimate:
    """The estimate of a stop without paths, with its status and reason."""
    none = np.zeros(0)
    return ChannelEstimate(
        stop=stop,
        delay_s=none,
        aod_azimuth_rad=none,
        aoa_azimuth_rad=none,
        power_dbm=none,
        beam_loss_db=none,
        snr_db=none,
        covariance=np.zeros((0, MIN_PARAMETERS, MIN_PARAMETERS)),
        is_los=np.zeros(0, bool),
        method=method,
        status=status,
        reason=reason,
    )


def check_estimate(estimate: ChannelEstimate, period_s: float) -> None:
    """Check an estimate against the contract of the record.

    `period_s` is the delay after which a comb of subcarriers repeats; larger delays are ambiguous.

    Raises `ValueError` if a value is not finite, a delay is beyond +-`period_s` (ns for s), paths are not sorted
    by delay, a covariance is not symmetric and positive definite, several paths are line of sight or one
    contradicts its probability, or a word is not an allowed one; the message names stop, field and value.
    """
    where = f"stop {estimate.stop}: "
    for name in ("delay_s", "aod_azimuth_rad", "aoa_azimuth_rad", "power_dbm"):
        value = getattr(estimate, name)
        if not np.isfinite(value).all():
            raise ValueError(f"{where}{name} = {value[~np.isfinite(value)][0]}: must be finite")
    late = np.abs(estimate.delay_s) > period_s
    if late.any():
        raise ValueError(f"{where}delay_s = {estimate.delay_s[late][0]:g}: must be within +-{period_s:.3g} s")
    if (np.diff(estimate.delay_s) < 0).any():
        raise ValueError(f"{where}delay_s is not sorted: paths must come in order of delay")
    _check_covariance(estimate, where)
    _check_los(estimate, where)
    for name, allowed in (
        ("aod_angle_kind", AngleKind),
        ("aoa_angle_kind", AngleKind),
        ("status", EstimateStatus),
    ):
        if getattr(estimate, name) not in list(allowed):
            raise ValueError(f"{where}{name} = '{getattr(estimate, name)}': must be one of {', '.join(allowed)}")


def _check_covariance(estimate: ChannelEstimate, where: str) -> None:
    n_parameters = estimate.size("parameter")
    if n_parameters not in (MIN_PARAMETERS, MIN_PARAMETERS + 2) or n_parameters != estimate.size("parameter2"):
        shape = estimate.covariance.shape
        raise ValueError(f"{where}covariance has shape {shape}: every matrix must be 3 x 3 or 5 x 5")
    if not len(estimate):
        return
    known = np.ones((len(estimate), n_parameters), bool)
    elevations = np.stack([estimate.aod_elevation_rad, estimate.aoa_elevation_rad], axis=1)
    known[:, MIN_PARAMETERS:] = np.isfinite(elevations[:, : n_parameters - MIN_PARAMETERS])
    both = known[:, :, None] & known[:, None, :]
    bad = both & ~np.isfinite(estimate.covariance)
    if bad.any():
        raise ValueError(f"{where}covariance = {estimate.covariance[bad][0]}: must be finite")
    # Delays in ns and angles in rad have similar magnitudes, so one limit fits all eigenvalues.
    scale = np.array([1e9, 1.0, 1.0, 1.0, 1.0])[:n_parameters]
    scaled = np.where(both, estimate.covariance * scale[:, None] * scale, np.eye(n_parameters))
    if not np.allclose(scaled, np.swapaxes(scaled, 1, 2)) or (np.linalg.eigvalsh(scaled) <= 0).any():
        raise ValueError(f"{where}covariance: every matrix must be symmetric and positive definite")


def _check_los(estimate: ChannelEstimate, where: str) -> None:
    if estimate.is_los.sum() > 1:
        raise ValueError(f"{where}is_los = {int(estimate.is_los.sum())} paths: at most one can be line of sight")
    probability = estimate.los_probability
    outside = ~((probability >= 0) & (probability <= 1))
    if outside.any():
        raise ValueError(f"{where}los_probability = {probability[outside][0]:g}: must be within 0 to 1")
    if (estimate.is_los != (probability > 0.5)).any():
        raise ValueError(f"{where}is_los: must be set where los_probability is above 0.5, and nowhere else")
