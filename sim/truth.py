"""The truth of one stop: for scoring only, never for an estimator."""

from dataclasses import dataclass

from scenes.pose import Pose
from scenes.record import Record, array
from sim.propagation.motion.tracks import SweepMotion
from sim.propagation.paths import Paths


@dataclass(frozen=True)
class Truth(Record):
    """True paths, RX pose and clock bias of one stop."""

    paths: Paths
    rx_pose: Pose
    stop: int = array(dtype=int, doc="index of the receiver stop")
    clock_bias_s: float = array(unit="s", doc="receiver clock minus transmitter clock")
    n_planar_compared: int = array(
        dtype=int, default=0, doc="planar specular paths found by the ray tracer or the exact solver"
    )
    n_planar_repaired: int = array(
        dtype=int, default=0, doc="of these, missed by the tracer: the exact ones are used"
    )
    n_planar_extra: int = array(dtype=int, default=0, doc="of these, found by the tracer only: discarded")
    motion: SweepMotion | None = None  # absent where nothing moves
    tx: int = array(dtype=int, default=0, doc="index of the TX, among several of a campaign")
