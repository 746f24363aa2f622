"""The tracks of a campaign, and what a tracker knows beside paths and poses."""

from dataclasses import dataclass

import numpy as np

from scenes.record import FloatArray, IntArray, Record, array, optional_array

N_COMPONENTS = 5  # of a state: x, y, both velocities, height


@dataclass(frozen=True)
class EchoSurvey(Record):
    """What is known of echoes beside paths and receiver states: times of the stops, TX, arrays and wavelength."""

    stop: IntArray = array("stop", dtype=int, doc="index of the receiver stop")
    time_s: FloatArray = array("stop", unit="s", doc="middle of the sweep of the stop")
    tx_m: FloatArray = array("tx", "xyz", unit="m", doc="position of every TX")
    tx_heading_rad: FloatArray = array("tx", unit="rad", doc="heading of every TX")
    wavelength_m: float = array(unit="m", doc="of the carrier")
    tx_panel_rad: FloatArray = array("tx_panel", unit="rad", doc="boresights of the TX panels, TX frame")
    rx_panel_rad: FloatArray = array("rx_panel", unit="rad", doc="boresights of the RX panels, RX frame")


@dataclass(frozen=True)
class Tracks(Record):
    """States of movers at the stops, ordered by track and stop, and the echoes that they are made of.

    States are smoothed: they use the echoes of all stops. A track has a state at every stop from its first echo to
    its last, except where its position is hardly known. `extent_m` is how far the echoes of a body scatter about
    their track beyond their own errors: 0 for a point.

    Fields after `velocity_m_s` are optional. If they are left out, heights and covariances are unknown (NaN),
    tracks exist for sure, bodies are points, and no echo is known.
    """

    survey: EchoSurvey
    track: IntArray = array("state", dtype=int, doc="number of the track")
    stop: IntArray = array("state", dtype=int, doc="index of the receiver stop")
    position_m: FloatArray = array("state", "xy", unit="m", doc="position in the plan")
    velocity_m_s: FloatArray = array("state", "xy", unit="m/s", doc="velocity in the plan")
    height_m: FloatArray = optional_array("state", unit="m", doc="height of what echoes; NaN unknown")
    covariance: FloatArray = optional_array(
        "state", "component", "component2",
        doc="of x, y in m, both velocities in m/s, and the height in m; NaN unknown",
    )  # fmt: skip
    existence: FloatArray = optional_array(
        "state", doc="probability that it exists, by the echoes until this stop"
    )
    extent_m: FloatArray = optional_array("state", unit="m", doc="scatter of its echoes, of the whole track")
    echo_stop: IntArray = optional_array("echo", dtype=int, doc="stop of every path that moves")
    echo_path: IntArray = optional_array("echo", dtype=int, doc="its number in the channel estimate of the stop")
    echo_track: IntArray = optional_array("echo", dtype=int, doc="track that it is a direct echo of, -1 for none")

    def __post_init__(self) -> None:
        n = len(self.track)
        no_echo = np.zeros(0, int)
        self._fill(
            height_m=np.full(n, np.nan),
            covariance=np.full((n, N_COMPONENTS, N_COMPONENTS), np.nan),
            existence=np.ones(n),
            extent_m=np.zeros(n),
            echo_stop=no_echo,
            echo_path=no_echo,
            echo_track=no_echo,
        )
        super().__post_init__()

    @property
    def n_tracks(self) -> int:
        """Number of tracks."""
        return int(self.track.max(initial=-1)) + 1
