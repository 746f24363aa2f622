"""Input that mapping and SLAM refuse: paths and poses that can only be mistakes."""

from collections.abc import Iterable

import numpy as np

from estimation.channel.record import ChannelEstimate
from estimation.slam.transmitters import AnyTx, transmitters_of

MAX_ANGLE_RAD = 2 * np.pi
_FIELDS = ("delay_s", "aod_azimuth_rad", "aoa_azimuth_rad", "power_dbm")


def check_estimates(estimates: Iterable[ChannelEstimate], tx_pose: AnyTx | None) -> None:
    """Refuse paths that no receiver can have estimated.

    Raises `ValueError` where there is no finite TX pose, a value of a path is not finite, an azimuth is beyond
    +-2 pi (degrees for radians), or two paths of a stop are equal. The message names stop, field and value.
    """
    if tx_pose is None:
        raise ValueError("tx_pose = None: mapping and SLAM need the position and the heading of the TX")
    for pose in transmitters_of(tx_pose).poses:
        if not np.isfinite([*pose.position_m, pose.heading_rad]).all():
            raise ValueError(f"tx_pose = {[*pose.position_m, pose.heading_rad]}: must be finite")
    for estimate in estimates:
        _check_values(estimate)
        _check_distinct(estimate)


def _check_values(estimate: ChannelEstimate) -> None:
    for name in _FIELDS:
        value = getattr(estimate, name)
        bad = np.flatnonzero(~np.isfinite(value))
        if len(bad):
            raise ValueError(f"stop {estimate.stop}: {name}[{bad[0]}] = {value[bad[0]]}: must be finite")
        if name.endswith("_rad") and np.any(np.abs(value) > MAX_ANGLE_RAD):
            worst = int(np.argmax(np.abs(value)))
            raise ValueError(
                f"stop {estimate.stop}: {name}[{worst}] = {value[worst]:g}: must be within +-2 pi rad;"
                " the angles look like degrees"
            )


def _check_distinct(estimate: ChannelEstimate) -> None:
    rows = np.column_stack([getattr(estimate, name) for name in _FIELDS[:3]] + [estimate.tx])
    _, first, count = np.unique(rows, axis=0, return_index=True, return_counts=True)
    if np.any(count > 1):
        index = int(first[np.argmax(count > 1)])
        raise ValueError(
            f"stop {estimate.stop}: path {index} is given {count.max()} times"
            f" (delay {1e9 * estimate.delay_s[index]:.3f} ns); every path must be given once"
        )
