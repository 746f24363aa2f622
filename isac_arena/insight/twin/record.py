"""Tables of a twin: the offsets of the measured paths, and the simulated path that explains each of them."""

from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from scenes.record import BoolArray, FloatArray, IntArray, Record, TextArray, array

# Largest differences of delay, departure and arrival, in s, rad, rad, of a path and the one that explains it.
WIDE_GATE = np.array([1.5e-9, np.deg2rad(3.0), np.deg2rad(3.0)])
NARROW_GATE = np.array([1.0e-9, np.deg2rad(2.0), np.deg2rad(2.0)])


class HeadingSource(IntEnum):
    """Where the RX heading of a stop is taken from."""

    LINE_OF_SIGHT = 0  # the labelled line of sight of the stop
    STRAIGHT = 1  # a path that is not labelled so, but has the delay and departure of the straight line
    OTHER_STOPS = 2


@dataclass(frozen=True)
class Offsets(Record):
    """Common offset of the measured delays and angles of every stop from the surveyed geometry.

    The offset of the arrival is minus the error of the surveyed RX heading, and the offset of the departure is
    minus the error of the TX heading. The path that gives the heading of its stop is itself compared with
    `other_aoa_rad`, because its own residual would be zero.
    """

    delay_s: FloatArray = array("stop", unit="s", doc="of the delays, without the known clock bias")
    aod_rad: FloatArray = array("stop", unit="rad", doc="of the departures, TX frame")
    aoa_rad: FloatArray = array("stop", unit="rad", doc="of the arrivals, RX frame")
    heading_source: IntArray = array("stop", dtype=int, doc="HeadingSource")
    heading_path: IntArray = array("stop", dtype=int, doc="path that gave the heading, -1 for none")
    other_aoa_rad: FloatArray = array("stop", unit="rad", doc="offset of the arrivals from other stops")
    session: IntArray = array("stop", dtype=int, doc="session: stops in a row with one TX heading offset")


@dataclass(frozen=True)
class TwinPaths(Record):
    """Every measured path of a campaign with the simulated path that explains it, ordered by stop and delay.

    Residuals are measured minus simulated, after subtraction of the offsets. Columns of a path that nothing
    explains are NaN, -1 or empty.
    """

    stop: IntArray = array("path", dtype=int, doc="index of the receiver stop")
    path: IntArray = array("path", dtype=int, doc="index in the channel estimate of the stop")
    is_los: BoolArray = array("path", dtype=bool, doc="labelled as line of sight")
    is_single_bounce: BoolArray = array("path", dtype=bool, doc="labelled as single bounce")
    landmark_m: FloatArray = array("path", "xy", unit="m", doc="labelled IP; NaN unless a single bounce")
    power_dbm: FloatArray = array("path", unit="dBm", doc="measured power")
    simulated: IntArray = array("path", dtype=int, doc="simulated path within the wide gate")
    simulated_narrow: IntArray = array("path", dtype=int, doc="simulated path within the narrow gate")
    chain: TextArray = array("path", dtype=str, doc="interactions of the simulated path")
    object: TextArray = array("path", dtype=str, doc="object of a simulated single bounce")
    n_bounces: IntArray = array("path", dtype=int, doc="bounces of the simulated path")
    delay_residual_s: FloatArray = array("path", unit="s", doc="residual of the delay")
    aod_residual_rad: FloatArray = array("path", unit="rad", doc="residual of the departure")
    aoa_residual_rad: FloatArray = array("path", unit="rad", doc="residual of the arrival")
    signal_dbm: FloatArray = array("path", unit="dBm", doc="simulated power of the path alone")
    predicted_dbm: FloatArray = array("path", unit="dBm", doc="simulated power plus the floor")

    @property
    def is_explained(self) -> BoolArray:
        """Paths (path,) with a simulated path within the wide gate."""
        return self.simulated >= 0

    @property
    def power_residual_db(self) -> FloatArray:
        """Measured over predicted power (path,) in dB."""
        return self.power_dbm - self.predicted_dbm
