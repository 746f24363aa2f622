"""What shape estimation hands on: clusters and their contours."""

from __future__ import annotations

from dataclasses import dataclass

from scenes.record import FloatArray, IntArray, Record, array


@dataclass(frozen=True)
class Shapes(Record):
    """One star-convex contour per cluster of incidence points, sampled on the full circle.

    The contour point at sample s is center + radius * (cos angle, sin angle).
    """

    label: IntArray = array("ip", dtype=int, doc="cluster of every incidence point given, -1 for none")
    center_m: FloatArray = array(
        "cluster", "xy", unit="m", doc="origin of the radial function, biases included"
    )
    angle_rad: FloatArray = array("sample", unit="rad", doc="polar angles of the sampled contour, [-pi, pi)")
    radius_m: FloatArray = array("cluster", "sample", unit="m", doc="predicted radius")
    radius_std_m: FloatArray = array("cluster", "sample", unit="m", doc="standard deviation of the radius")
    mean_m: FloatArray = array("cluster", unit="m", doc="learned mean radius mu")
    signal_std_m: FloatArray = array("cluster", unit="m", doc="learned sigma_f")
    length_scale: FloatArray = array("cluster", unit="1", doc="learned l of the periodic kernel")
    noise_std_m: FloatArray = array("cluster", unit="m", doc="learned sigma_n")
    log_likelihood: FloatArray = array("cluster", doc="log marginal likelihood at the optimum")
