"""The truth behind one stop: for scoring only, never for an estimator."""

from __future__ import annotations

from dataclasses import dataclass

from scenes.pose import Pose
from scenes.record import Record, array
from sim.propagation.paths import Paths


@dataclass(frozen=True)
class Truth(Record):
    """What really was at one stop."""

    paths: Paths
    rx_pose: Pose
    stop: int = array(dtype=int, doc="index of the receiver stop")
    clock_bias_s: float = array(unit="s", doc="receiver clock minus transmitter clock")
    n_planar_compared: int = array(
        dtype=int,
        default=0,
        doc="planar specular paths that the ray tracer and the exact solver were asked for",
    )
    n_planar_repaired: int = array(
        dtype=int, default=0, doc="of these, lost by the tracer: the exact ones stand"
    )
    n_planar_extra: int = array(dtype=int, default=0, doc="of these, found by the tracer alone: left out")
