"""Echoes to tracks by a multi-Bernoulli filter that keeps the best association, with Stone Soup.

Every track has a probability of existence. At a stop, the assignment of echoes to tracks with the highest
likelihood is taken (2D assignment); what no track explains begins a new one. This is the Poisson multi-Bernoulli
mixture with one global hypothesis (Garcia-Fernandez et al., "Poisson multi-Bernoulli mixture filter: direct
derivation and implementation", IEEE Trans. AES 54(4), 2018). At the end all tracks are smoothed backwards.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from stonesoup.dataassociator.neighbour import GNNWith2DAssignment
from stonesoup.hypothesiser.distance import DistanceHypothesiser
from stonesoup.initiator.simple import SinglePointInitiator
from stonesoup.measures import Measure, SquaredMahalanobis
from stonesoup.predictor.kalman import KalmanPredictor
from stonesoup.smoother.kalman import KalmanSmoother
from stonesoup.types.track import Track
from stonesoup.updater.kalman import KalmanUpdater

from estimation.tracks.config import TrackConfig
from estimation.tracks.echoes import OneBounce
from estimation.tracks.law import POSITION
from estimation.tracks.models import at, detection, prior, transition
from scenes.record import FloatArray


@dataclass
class Tracked:
    """A track while it grows: its states of Stone Soup, their stops, existence, and its echoes by stop."""

    track: Track
    rows: list[int]
    existence: list[float]
    echoes: dict[int, OneBounce]
    body: list[tuple[int, OneBounce]] = field(default_factory=list)  # further echoes, with the row of the stop

    @property
    def position_m(self) -> FloatArray:
        """Position (xy,) at the last stop."""
        return np.asarray(np.ravel(self.track[-1].state_vector)[POSITION], float)


class Surprise(Measure):  # type: ignore[misc]
    """Minus twice the log likelihood of a detection: sums of it compare assignments."""

    def __call__(self, state1: Any, state2: Any) -> float:
        """Of a measurement prediction and a detection."""
        spread = np.linalg.slogdet(2 * np.pi * np.asarray(state1.covar, float))[1]
        return float(SquaredMahalanobis(state_covar_inv_cache_size=None)(state1, state2) + spread)


def track_echoes(bounces: Sequence[Sequence[OneBounce]], time_s: FloatArray, config: TrackConfig) -> list[Tracked]:
    """The tracks that ever exceed `shown_existence`, smoothed, each from its first echo to its last."""
    updater = KalmanUpdater()
    unexplained = config.clutter / config.detection_probability
    missed = -2 * np.log((1 - config.detection_probability) * unexplained)
    hypothesiser = DistanceHypothesiser(KalmanPredictor(transition(config)), updater, Surprise(), missed)
    associator = GNNWith2DAssignment(hypothesiser)
    every: list[Tracked] = []
    for row, found in enumerate(bounces):
        seen = {detection(one, time_s[row]): one for one in found if one.chi_square <= config.most_chi_square}
        alive = [one for one in every if one.existence[-1] >= config.least_existence]
        chosen = associator.associate([one.track for one in alive], list(seen), at(time_s[row]))
        for one in alive:
            hypothesis = chosen[one.track]
            ratio = 1 - config.detection_probability
            if hypothesis:
                ratio = np.exp(-hypothesis.distance / 2) / unexplained
                one.echoes[row] = seen.pop(hypothesis.measurement)
            one.track.append(updater.update(hypothesis) if hypothesis else hypothesis.prediction)
            one.existence.append(_existence(one, ratio, time_s[row] - time_s[one.rows[-1]], config))
            one.rows.append(row)
        detected = [one for one in alive if row in one.echoes]
        for each, echo in sorted(seen.items(), key=lambda pair: pair[1].chi_square):
            near = [one for one in detected if np.hypot(*(one.position_m - echo.state[POSITION])) < config.body_m]
            if near:
                near[0].body.append((row, echo))
            else:
                detected.append(_new(each, echo, row, time_s, config))
                every.append(detected[-1])
    finished = [_finished(one, config) for one in every if max(one.existence) > config.shown_existence]
    return [one for one in finished if one.rows]  # some are nowhere known


def _existence(one: Tracked, ratio: float, step_s: float, config: TrackConfig) -> float:
    """The existence after a stop, from the likelihood ratio of what was seen with and without the mover."""
    held = one.existence[-1] * config.survival_per_s**step_s
    return float(ratio * held / (1 - held + ratio * held))


def _new(each: Any, one: OneBounce, row: int, time_s: FloatArray, config: TrackConfig) -> Tracked:
    """A track that begins with an echo: it exists the surer, the better the echo is one of one bounce."""
    initiator = SinglePointInitiator(prior(config, time_s[row]), updater=KalmanUpdater())
    (track,) = initiator.initiate({each}, at(time_s[row]))
    odds = config.birth_probability / (1 - config.birth_probability) * np.exp(-one.chi_square / 2)
    return Tracked(track, [row], [float(odds / (1 + odds))], {row: one})


def _finished(one: Tracked, config: TrackConfig) -> Tracked:
    """The track up to its last echo, smoothed; without the stops where it may be anywhere."""
    n = one.rows.index(max(one.echoes)) + 1
    one.track.states = one.track.states[:n]
    smooth = KalmanSmoother(transition(config)).smooth(one.track)
    spread_m2 = [np.trace(state.covar[np.ix_(POSITION, POSITION)]) for state in smooth]
    known = np.flatnonzero(np.array(spread_m2, float) < config.most_std_m**2).tolist()
    smooth.states = [smooth.states[k] for k in known]
    return replace(
        one, track=smooth, rows=[one.rows[k] for k in known], existence=[one.existence[k] for k in known]
    )
