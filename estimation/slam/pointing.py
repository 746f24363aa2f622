"""Arrays that point a little wrong: an error that all paths of a campaign share, so a part of every pose."""

from collections.abc import Sequence

import numpy as np

from estimation.channel.record import ChannelEstimate
from estimation.slam.config import Consider


def with_array_pointing(consider: Consider, estimates: Sequence[ChannelEstimate]) -> Consider:
    """The errors of the set-up, with the pointing errors of both arrays that remain after calibration.

    That of the TX array turns the whole solution about the TX, that of the RX array turns the receiver.
    """
    parts = [one.pointing.covariance for one in estimates if one.pointing is not None and len(one)]
    if not parts:
        return consider
    tx, rx = (np.median(np.concatenate([part[:, end, end] for part in parts])) for end in (1, 2))
    return consider.model_copy(
        update={
            "pointing_std_deg": float(np.hypot(consider.pointing_std_deg, np.rad2deg(np.sqrt(tx)))),
            "heading_std_deg": float(np.hypot(consider.heading_std_deg, np.rad2deg(np.sqrt(rx)))),
        }
    )
