"""The results of shape estimation: the contours of clusters of the paper, and our contours of objects."""

from dataclasses import dataclass

import numpy as np

from scenes.record import BoolArray, FloatArray, IntArray, Record, TextArray, array

CLASS_NAMES = ("wall", "edge", "pillar")
N_CONTOUR_SAMPLES = 180


@dataclass(frozen=True)
class Shapes(Record):
    """One star-convex contour per cluster of incidence points, sampled on the full circle.

    The contour point at sample s is center + radius * (cos angle, sin angle).
    """

    label: IntArray = array("ip", dtype=int, doc="cluster of every incidence point given, -1 for none")
    center_m: FloatArray = array("cluster", "xy", unit="m", doc="origin of the radial function, biases included")
    angle_rad: FloatArray = array("sample", unit="rad", doc="polar angles of the sampled contour, [-pi, pi)")
    radius_m: FloatArray = array("cluster", "sample", unit="m", doc="predicted radius")
    radius_std_m: FloatArray = array("cluster", "sample", unit="m", doc="standard deviation of the radius")
    mean_m: FloatArray = array("cluster", unit="m", doc="learned mean radius mu")
    signal_std_m: FloatArray = array("cluster", unit="m", doc="learned sigma_f")
    length_scale: FloatArray = array("cluster", unit="1", doc="learned l of the periodic kernel")
    noise_std_m: FloatArray = array("cluster", unit="m", doc="learned sigma_n")
    log_likelihood: FloatArray = array("cluster", doc="log marginal likelihood at the optimum")


@dataclass(frozen=True)
class Contours(Record):
    """One contour per accepted object, by the method of the settings; a rejected ghost has no row.

    A closed contour is sampled counter-clockwise without a repeated end, an open one end to end. An object was
    fitted to the paths of the incidence points with its row in `object`. Offsets are added to the prediction of
    the geometry; they are NaN where none was fitted.
    """

    method: str = array(dtype=str, doc="method of the settings")
    kind: TextArray = array("contour", dtype=str, doc="kind of the contour: circle, ellipse, wall, edge, ...")
    status: TextArray = array("contour", dtype=str, doc="'ok', or 'prior' where the data are uninformative")
    is_closed: BoolArray = array("contour", dtype=bool, doc="closed contour of a pillar")
    center_m: FloatArray = array("contour", "xy", unit="m", doc="mean of the sampled contour")
    contour_m: FloatArray = array("contour", "sample", "xy", unit="m", doc="points of the contour")
    std_m: FloatArray = array(
        "contour", "sample", unit="m", doc="standard deviation along the normal: 95 % band is +-1.96 of it"
    )
    extent_m: FloatArray = array("contour", unit="m", doc="lit length if open, mean radius if closed")
    extent_std_m: FloatArray = array("contour", unit="m", doc="standard deviation of the extent")
    class_name: TextArray = array("class", dtype=str, doc="classes of objects")
    class_probability: FloatArray = array("contour", "class", doc="probability of each class; NaN unknown")
    cluster: IntArray = array("contour", dtype=int, doc="cluster of `shapes` with most of its IPs, -1 none")
    object: IntArray = array("ip", dtype=int, doc="contour that each incidence point supports, -1 for none")
    delay_offset_s: float = array(unit="s", doc="common error of all delays")
    delay_offset_std_s: float = array(unit="s", doc="its standard deviation")
    aoa_offset_rad: float = array(unit="rad", doc="common error of all azimuths of arrival")
    aoa_offset_std_rad: float = array(unit="rad", doc="its standard deviation")
    aod_offset_rad: FloatArray = array("session", unit="rad", doc="of a session's azimuths of departure")
    aod_offset_std_rad: FloatArray = array("session", unit="rad", doc="its standard deviation")
    session: IntArray = array("stop", dtype=int, doc="session of each stop, of all stops in order")

    def __len__(self) -> int:
        return len(self.kind)


def normals(points_m: FloatArray, *, is_closed: bool) -> FloatArray:
    """Unit normals (sample, xy) to the right of a curve: they point outward where it runs counter-clockwise.

    The tangents are central differences, and one-sided differences at the ends of an open curve. A normal is zero
    where points of the curve coincide.
    """
    if is_closed:
        along = np.roll(points_m, -1, axis=0) - np.roll(points_m, 1, axis=0)
    else:
        along = np.gradient(points_m, axis=0)
    length = np.linalg.norm(along, axis=1, keepdims=True)
    unit = np.divide(along, length, out=np.zeros_like(along), where=length > 0)
    return np.stack([unit[:, 1], -unit[:, 0]], axis=1)
