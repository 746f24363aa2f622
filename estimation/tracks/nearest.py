"""The baseline: a Kalman filter of positions with nearest neighbours, with Stone Soup.

It takes every echo as one of one bounce and uses the point that it shows: no Doppler shift, no test of the
bounces. A track is confirmed by its second echo, and ends after two stops without one.
"""

from collections.abc import Sequence

from stonesoup.dataassociator.neighbour import NearestNeighbour
from stonesoup.deleter.time import UpdateTimeStepsDeleter
from stonesoup.hypothesiser.distance import DistanceHypothesiser
from stonesoup.initiator.simple import MultiMeasurementInitiator, SinglePointInitiator
from stonesoup.measures import Mahalanobis
from stonesoup.predictor.kalman import KalmanPredictor
from stonesoup.tracker.simple import MultiTargetTracker
from stonesoup.types.update import Update
from stonesoup.updater.kalman import KalmanUpdater

from estimation.tracks.config import TrackConfig
from estimation.tracks.echoes import OneBounce
from estimation.tracks.models import at, place, prior, transition
from estimation.tracks.tracker import Tracked
from scenes.record import FloatArray

GATE_DEVIATIONS = 3.7  # of two coordinates: a share of 0.1 % is outside
MISSED_STOPS = 2


def track_nearest(
    bounces: Sequence[Sequence[OneBounce]], time_s: FloatArray, config: TrackConfig
) -> list[Tracked]:
    """The confirmed tracks, each from its confirmation to its end."""
    updater = KalmanUpdater()
    near = DistanceHypothesiser(KalmanPredictor(transition(config)), updater, Mahalanobis(), GATE_DEVIATIONS)
    associator, deleter = NearestNeighbour(near), UpdateTimeStepsDeleter(MISSED_STOPS)
    start = prior(config, time_s[0])
    initiator = MultiMeasurementInitiator(
        start, deleter, associator, updater, initiator=SinglePointInitiator(start, updater=updater)
    )
    seen = [{place(one, time): one for one in found} for found, time in zip(bounces, time_s, strict=True)]
    stream = [(at(time), set(found)) for time, found in zip(time_s, seen, strict=True)]
    tracked: dict[str, Tracked] = {}
    tracker = MultiTargetTracker(initiator, deleter, stream, associator, updater)
    for row, (_, tracks) in enumerate(tracker):
        for track in tracks:
            one = tracked.setdefault(track.id, Tracked([], [], [], {}))
            one.track.append(track.state)
            one.rows.append(row)
            one.existence.append(1.0)
            if isinstance(track.state, Update):
                one.echoes[row] = seen[row][track.state.hypothesis.measurement]
    return sorted(tracked.values(), key=lambda one: (one.rows[0], tuple(one.track[0].state_vector.ravel())))
