"""The truth of one stop: for scoring only, never for an estimator."""

from dataclasses import dataclass, replace
from typing import Self

from scenes.pose import Pose
from scenes.record import Record, array
from sim.propagation.motion.tracks import SweepMotion
from sim.propagation.paths import Paths, reversed_paths


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
    tx: int = array(dtype=int, default=0, doc="index of the TX or link, among several of a campaign")
    tx_pose: Pose | None = None  # of a TX that walks; absent where it stands in the scene

    @property
    def stop_pose(self) -> Pose:
        """The pose of what is at the stop, whether it sends or receives."""
        return self.rx_pose if self.tx_pose is None else self.tx_pose

    def sent_from_stop(self, node: Pose) -> Self:
        """The same paths the other way: from the stop to a fixed node."""
        return replace(self, paths=reversed_paths(self.paths), rx_pose=node, tx_pose=self.rx_pose)

    @property
    def from_node(self) -> Self:
        """The same paths from the fixed node to the stop, whichever of them sends."""
        if self.tx_pose is None:
            return self
        return replace(self, paths=reversed_paths(self.paths), rx_pose=self.tx_pose, tx_pose=None)
