"""Contours of objects from paths and poses, by the method of the settings."""

from collections.abc import Sequence

from estimation.channel.record import ChannelEstimate
from estimation.laws.raised import PathHeights
from estimation.shape.config import ContourConfig
from estimation.shape.record import Contours
from estimation.shape.reflection.fit_all import fit_campaign
from estimation.shape.reflection.paths import campaign_paths
from estimation.shape.reflection.rows import contour_record, no_contours
from estimation.shape.set_up import common_errors, with_set_up, without_set_up
from estimation.slam.config import Consider, PathNoise
from estimation.slam.record import IncidencePoints, PoseEstimates
from estimation.slam.transmitters import AnyTx, Transmitters
from scenes.record import IntArray


def estimate_contours(
    channel: Sequence[ChannelEstimate],
    tx_pose: AnyTx,
    poses: PoseEstimates,
    ips: IncidencePoints,
    label: IntArray,
    noise: PathNoise,
    config: ContourConfig,
    heights: Sequence[PathHeights] = (),
    consider: Consider | None = None,
) -> Contours:
    """One contour per object, by the method of the settings.

    `label` (ip,) are the clusters of the shapes of the paper. They are the objects of the methods for points;
    the record names the cluster of each object. `heights` of all paths, where they are known and elevations are
    not, tell places on floor and ceiling from objects. `consider` are errors of the set-up that the covariances of
    poses of SLAM include.
    """
    if config.method == "none":
        return no_contours(len(ips), len(poses.stop))
    if config.method != "reflection":
        if isinstance(tx_pose, Transmitters):
            allowed = "several need 'reflection' or 'none'"
            raise ValueError(f"contours.method = '{config.method}': is of one TX; {allowed}")
        from estimation.shape.points.contours import fit_point_contours  # noqa: PLC0415  (slow to import)

        return fit_point_contours(ips, label, tx_pose, poses, config)
    common = common_errors(poses, consider)
    shown = without_set_up(poses, tx_pose, common)
    fit = fit_campaign(campaign_paths(channel, tx_pose, shown, ips, noise, config, heights), config)
    return with_set_up(contour_record(fit, label, len(ips)), tx_pose, common)
