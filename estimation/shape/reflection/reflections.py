"""Single-bounce paths of one object over a campaign: the data of the fits by the reflection law."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from estimation.laws.plane import ray_directions, start_point, state_columns
from estimation.shape.reflection.search import PathArrays
from scenes.record import FloatArray, IntArray, Record, array, concatenate, optional_array

_EXACT_STD = 1e-6  # of a state with zero covariance, in m and rad


@dataclass(frozen=True)
class Reflections(Record):
    """Delay and angles of the paths with the poses they were measured from.

    Raises `ValueError` for values that are not finite and covariances that are not symmetric and positive
    (measurement) or have a negative variance (pose).
    """

    measured: FloatArray = array("path", "quantity", doc="range in m, azimuth of departure, of arrival in rad")
    covariance: FloatArray = array("path", "quantity", "quantity2", doc="covariance in m, rad, rad")
    tx: FloatArray = array("path", "tx_pose", doc="x and y in m, heading in rad of the TX")
    rx_state: FloatArray = array("path", "state", doc="x and y in m, heading in rad, clock bias in m of the RX")
    rx_covariance: FloatArray = array("path", "state", "state2", doc="covariance of the RX state; 0: exact")
    session: IntArray = array("path", dtype=int, doc="session of the TX heading offset, from 0")
    stop: IntArray = array("path", dtype=int, doc="stop of the RX")
    clock: IntArray = optional_array("path", dtype=int, doc="index of the TX: of its clock bias at the stop")
    difference_m: FloatArray = optional_array(
        "path", unit="m", doc="height of the TX over the RX; NaN where it is unknown or the path has an elevation"
    )
    boresight_rad: FloatArray = optional_array(
        "path", "end", unit="rad", doc="azimuth of the panel at TX and RX in their frames; NaN for no cone angles"
    )
    specular_probability: FloatArray = optional_array(
        "path", doc="that the path is specular, not a sum of diffuse ones, if both are alike beforehand"
    )

    def __post_init__(self) -> None:
        n = len(self.stop)
        missing = {
            "clock": np.zeros(n, int),
            "difference_m": np.full(n, np.nan),
            "boresight_rad": np.full((n, 2), np.nan),
            "specular_probability": np.full(n, 0.5),
        }
        for name, value in missing.items():
            if getattr(self, name) is None:
                object.__setattr__(self, name, value)
        super().__post_init__()
        for name in ("measured", "covariance", "tx", "rx_state", "rx_covariance"):
            if not np.all(np.isfinite(getattr(self, name))):
                raise ValueError(f"Reflections.{name}: every value must be finite")
        if np.any(self.session < 0):
            raise ValueError(f"Reflections.session = {int(self.session.min())}: must be >= 0")
        asymmetry = np.abs(self.covariance - np.swapaxes(self.covariance, 1, 2)).max(initial=0.0)
        if asymmetry > 1e-9 or np.any(np.linalg.eigvalsh(self.covariance) <= 0):
            raise ValueError("Reflections.covariance: must be symmetric and positive definite")
        if np.any(np.diagonal(self.rx_covariance, axis1=1, axis2=2) < 0):
            raise ValueError("Reflections.rx_covariance: variances must be >= 0")

    def __len__(self) -> int:
        return len(self.stop)

    @property
    def log_specular(self) -> FloatArray:
        """Log of how much more likely (path,) than on average what is known of a path is if it is specular."""
        return np.asarray(np.log(2 * self.specular_probability))

    @property
    def log_diffuse(self) -> FloatArray:
        """The same if it is diffuse."""
        return np.asarray(np.log(2 * (1 - self.specular_probability)))

    def covariance_with_poses(self, by_state: FloatArray) -> FloatArray:
        """Covariances (path, 3, 3) with those of the poses, by the slopes (path, 3, 4) of what is measured."""
        return np.asarray(self.covariance + by_state @ self.rx_covariance @ np.swapaxes(by_state, 1, 2))

    @cached_property
    def arrays(self) -> PathArrays:
        """The same for compiled code: copies, because arrays of records are read-only, a type of its own."""
        names = ("measured", "covariance", "tx", "rx_state", "rx_covariance", "session", "clock", "log_specular")
        return PathArrays(*(np.array(getattr(self, name), order="C") for name in names))

    @cached_property
    def has_exact_poses(self) -> bool:
        """Whether the states have no covariance."""
        return not np.any(self.rx_covariance)

    @property
    def n_sessions(self) -> int:
        """Number of sessions, those without a path included."""
        return int(self.session.max(initial=-1)) + 1


def ray_points(data: Reflections) -> tuple[FloatArray, FloatArray]:
    """Point (path, xy) in m where the two rays of each path meet, and the azimuth (path,) of the normal there.

    The point is `estimation.laws.plane.start_point`. The normal bisects the rays back to TX and RX.
    """
    u, v = ray_directions(data.tx, data.rx_state[:, 2], data.measured)
    back = -(u + v)
    return start_point(data.tx, data.rx_state, data.measured), np.arctan2(back[:, 1], back[:, 0])


def at_solution(paths: Reflections, stop: IntArray, state: FloatArray, covariance: FloatArray) -> Reflections:
    """Paths with the solved states (stop, 3 + clock) and their covariances (stop, 3 + clock, 3 + clock)."""
    row, column = np.searchsorted(stop, paths.stop)[:, None], state_columns(paths.clock)
    own = covariance[row[:, :, None], column[:, :, None], column[:, None, :]]
    return replace(paths, rx_state=state[row, column], rx_covariance=own)


def prior_states(sets: Sequence[Reflections]) -> tuple[IntArray, FloatArray, FloatArray]:
    """Stops, their given states (stop, state), and the inverse (stop, state, state) of the covariances.

    The paths of several TX at a stop share its pose. Given the pose their clock biases are independent, so their
    informations add up, with that of the pose counted once.
    """
    every = concatenate(sets, "path")
    n_clocks = int(every.clock.max(initial=0)) + 1
    link, first = np.unique(every.stop * n_clocks + every.clock, return_index=True)
    stop, row = np.unique(link // n_clocks, return_inverse=True)
    state = np.zeros((len(stop), 3 + n_clocks))
    weight = np.zeros((len(stop), 3 + n_clocks, 3 + n_clocks))
    information = np.linalg.inv(every.rx_covariance[first] + _EXACT_STD**2 * np.eye(4))
    column = state_columns(every.clock[first])
    state[row[:, None], column] = every.rx_state[first]
    for k, own in enumerate(column):
        weight[row[k], own[:, None], own] += information[k]
    again = np.flatnonzero(np.diff(row, prepend=-1) == 0)  # the pose was counted before
    pose = np.linalg.inv(every.rx_covariance[first[again], :3, :3] + _EXACT_STD**2 * np.eye(3))
    np.subtract.at(weight[:, :3, :3], row[again], pose)
    unseen = np.ones((len(stop), n_clocks), bool)
    unseen[row, every.clock[first]] = False
    at, clock = np.nonzero(unseen)
    weight[at, 3 + clock, 3 + clock] = 1.0  # of no path: it stays where it is
    return stop, state, weight
