"""The data of tracks and movers for the report page, and the Doppler shifts of the paths of every stop."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from estimation.channel.record import ChannelEstimate
from estimation.channel.still import is_still
from estimation.tracks.record import Tracks
from isac_arena.report.page.payload.numbers import rounded
from scenes.record import FloatArray
from scenes.scene import Scene

N_FRAMES = 240


def track_payload(
    scene: Scene, channel: Sequence[ChannelEstimate], tracks: Tracks | None
) -> dict[str, Any] | None:
    """Tracks at the stops, true movers and receiver over time, and the shifts of all paths; None for none."""
    if tracks is None:
        return None
    time_s, stops = tracks.survey.time_s, tracks.survey.stop
    frame_s = np.linspace(time_s[0], max(time_s[-1], time_s[0] + 1e-3), N_FRAMES)
    rx_m = scene.walk.positions_m()[stops]
    at_frames = [np.interp(frame_s, time_s, rx_m[:, axis]) for axis in range(2)]
    row = {stop: place for place, stop in enumerate(stops.tolist())}
    return {
        "frame_s": rounded(frame_s, 3),
        "time_s": rounded(time_s, 3),
        "rx": rounded(np.stack(at_frames, axis=1), 3),
        "movers": [
            {"name": item.name, "xy": rounded(_places(item.pivot_m, item.motion.over(frame_s)[0]), 3)}
            for item in scene.objects
            if item.motion is not None
        ],
        "tracks": [
            {
                "row": [row[stop] for stop in one.stop.tolist()],
                "xy": rounded(one.position_m, 3),
                "velocity": rounded(one.velocity_m_s, 3),
                "std_m": rounded(np.sqrt(one.covariance[:, [0, 1], [0, 1]].sum(axis=1)), 3),
                "height_m": rounded(one.height_m, 2),
                "existence": rounded(one.existence, 3),
                "extent_m": rounded(one.extent_m[:1], 2)[0],
            }
            for one in (tracks.take("state", tracks.track == number) for number in range(tracks.n_tracks))
        ],
        "shifts": [_shifts(estimate, tracks) for estimate in channel],
    }


def _places(pivot_m: FloatArray, shift: FloatArray) -> FloatArray:
    return np.asarray(pivot_m[:2] + shift[:, :2])


def _shifts(estimate: ChannelEstimate, tracks: Tracks) -> dict[str, Any]:
    """Doppler shifts of the paths of a stop, which stand, and the tracks of those that do not."""
    here = tracks.echo_stop == estimate.stop
    track = np.full(len(estimate), -1)
    track[tracks.echo_path[here]] = tracks.echo_track[here]
    motion = estimate.motion
    doppler_hz = np.full(len(estimate), np.nan) if motion is None else motion.doppler_hz
    return {"doppler_hz": rounded(doppler_hz, 1), "still": is_still(estimate).tolist(), "track": track.tolist()}
