"""Results of mapping and SLAM: incidence points and receiver poses."""

from dataclasses import dataclass, replace
from enum import IntEnum
from typing import Self

import numpy as np

from scenes.record import BoolArray, FloatArray, IntArray, Record, array, optional_array

N_STATE = 4  # x, y, heading, clock bias


class SolveStatus(IntEnum):
    """How a stop was solved. Non-convergence is a status, not an exception."""

    FAILED = 0
    LOS = 1
    NLOS = 2
    GIVEN = 3  # the pose was given, as in mapping


@dataclass(frozen=True)
class IncidencePoints(Record):
    """Incidence points (IPs) of non-LOS paths, over all stops, ordered by stop and path."""

    stop: IntArray = array("ip", dtype=int, doc="stop the path belongs to")
    path: IntArray = array("ip", dtype=int, doc="index of the path in the channel estimate of its stop")
    position_m: FloatArray = array("ip", "xy", unit="m", doc="estimated incidence point")
    covariance_m2: FloatArray = array("ip", "xy", "xy2", unit="m^2", doc="covariance of the position")
    cost: FloatArray = array(
        "ip", doc="J of equation (4) of the GP paper at the minimum: chi-square, 1 degree of freedom"
    )
    is_inlier: BoolArray = array("ip", dtype=bool, doc="taken as a single bounce; only these are clustered")
    height_m: FloatArray = optional_array("ip", unit="m", doc="estimated height; NaN in the plane")
    height_covariance_m2: FloatArray = optional_array(
        "ip", "xyz", unit="m^2", doc="covariance of the height with x, y and itself; NaN in the plane"
    )
    tx: IntArray = optional_array("ip", dtype=int, doc="index of the TX, among several of a campaign")
    influence_m: FloatArray = optional_array(
        "ip", unit="m", doc="by which the position of the stop moves without the path; NaN if not used"
    )

    def __post_init__(self) -> None:
        n = len(self.stop)
        unknown = np.full(n, np.nan), np.full((n, 3), np.nan)
        self._fill(
            height_m=unknown[0], height_covariance_m2=unknown[1], tx=np.zeros(n, int), influence_m=unknown[0]
        )
        super().__post_init__()

    def __len__(self) -> int:
        return self.size("ip")


@dataclass(frozen=True)
class PoseEstimates(Record):
    """Receiver state per stop. NaN where the status is FAILED.

    A state is [x, y, heading, clock bias] in (m, m, rad, s), with several TX one clock bias for each; `covariance`
    is that of the errors, estimate minus truth, with wrapped heading. It is that of the chosen mode;
    `position_std_m` includes all modes.
    """

    stop: IntArray = array("stop", dtype=int, doc="index of the receiver stop")
    position_m: FloatArray = array("stop", "xy", unit="m", doc="receiver position")
    heading_rad: FloatArray = array("stop", unit="rad", doc="receiver heading, world frame")
    clock_bias_s: FloatArray = array("stop", unit="s", doc="receiver clock bias, against the first TX of several")
    status: IntArray = array("stop", dtype=int, doc="SolveStatus")
    n_inliers: IntArray = array("stop", dtype=int, doc="paths that agree with the solution, LOS included")
    cost: FloatArray = array(
        "stop", doc="cost of the chosen solution, see docs/metrics.md: not comparable between stops"
    )
    height_m: FloatArray = optional_array("stop", unit="m", doc="receiver height; NaN in the plane")
    height_std_m: FloatArray = optional_array("stop", unit="m", doc="its standard deviation; NaN in the plane")
    covariance: FloatArray = optional_array(
        "stop", "state", "state2", doc="of the state, consider-parameters included; NaN where unknown"
    )
    height_covariance: FloatArray = optional_array(
        "stop", "state", doc="covariance of the height with the state (m^2, m^2, m rad, m s); NaN in the plane"
    )
    position_std_m: FloatArray = optional_array(
        "stop", unit="m", doc="standard deviation of the plan position over all modes; NaN where unknown"
    )
    is_ambiguous: BoolArray = optional_array(
        "stop", dtype=bool, doc="two modes are near-equal: the gap is below `ambiguous_gap` of the settings"
    )
    evidence_gap: FloatArray = optional_array(
        "stop", doc="log evidence of the mode chosen over the next distinct one; NaN where there is none"
    )
    alternative: FloatArray = optional_array(
        "stop", "state", doc="state of the next distinct mode; NaN where there is none"
    )
    los_probability: FloatArray = optional_array(
        "stop", doc="posterior probability that one of the paths is a line of sight; NaN where unknown"
    )
    is_of_walk: BoolArray = optional_array(
        "stop", dtype=bool, doc="solved together with other stops, jumps of the TX heading included"
    )
    tx_clock_bias_s: FloatArray = optional_array("stop", "tx", unit="s", doc="clock bias against every TX")
    most_influential_path: IntArray = optional_array(
        "stop", dtype=int, doc="index of the path without which the position moves most; -1 where unknown"
    )
    path_influence_m: FloatArray = optional_array(
        "stop", unit="m", doc="by which the position moves without that path; NaN where unknown"
    )

    def __post_init__(self) -> None:
        n = len(self.stop)
        unknown = np.full(n, np.nan)
        if self.tx_clock_bias_s is None or np.shape(self.tx_clock_bias_s)[1] == 1:
            object.__setattr__(self, "tx_clock_bias_s", np.asarray(self.clock_bias_s)[:, None])
        n_state = N_STATE - 1 + np.shape(self.tx_clock_bias_s)[1]
        self._fill(
            height_m=unknown,
            height_std_m=unknown,
            covariance=np.full((n, n_state, n_state), np.nan),
            height_covariance=np.full((n, n_state), np.nan),
            position_std_m=unknown,
            is_ambiguous=np.zeros(n, bool),
            evidence_gap=unknown,
            alternative=np.full((n, n_state), np.nan),
            los_probability=unknown,
            is_of_walk=np.zeros(n, bool),
            most_influential_path=np.full(n, -1),
            path_influence_m=unknown,
        )
        super().__post_init__()

    @property
    def n_tx(self) -> int:
        """Number of TX that have a clock bias."""
        return self.size("tx")

    @property
    def is_given(self) -> bool:
        """Whether all states that are known were given: none is of SLAM."""
        return bool(np.isin(self.status, (SolveStatus.GIVEN, SolveStatus.FAILED)).all())

    def of_tx(self, tx: int) -> Self:
        """The states with the clock bias against one TX, as of that TX alone."""
        if self.n_tx == 1:
            return self
        state = np.array([0, 1, 2, N_STATE - 1 + tx])
        return replace(
            self,
            clock_bias_s=self.tx_clock_bias_s[:, tx],
            tx_clock_bias_s=self.tx_clock_bias_s[:, tx : tx + 1],
            covariance=self.covariance[:, state[:, None], state],
            height_covariance=self.height_covariance[:, state],
            alternative=self.alternative[:, state],
        )
