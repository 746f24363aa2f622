"""Stone Soup's models for movers: the tracker is imported late, since Stone Soup brings plotting libraries."""

from datetime import datetime, timedelta
from typing import Any

import numpy as np
from stonesoup.models.measurement.linear import LinearGaussian
from stonesoup.models.transition.linear import CombinedLinearGaussianTransitionModel, OrnsteinUhlenbeck, RandomWalk
from stonesoup.types.detection import Detection
from stonesoup.types.state import GaussianState

from estimation.tracks.config import TrackConfig
from estimation.tracks.echoes import OneBounce
from estimation.tracks.law import HEIGHT, N_STATE, POSITION, VELOCITY
from scenes.record import FloatArray

START = datetime(2000, 1, 1)  # of a campaign: only differences count
ANYWHERE_M = 100.0  # standard deviation of a position before its first echo
HEIGHT_WALK = 1e-6  # m^2 per s: heights stay


class EchoModel(LinearGaussian):  # type: ignore[misc]
    """An echo, linear in the state near the mover that it shows."""

    slope: FloatArray

    @classmethod
    def of(cls, slope: FloatArray, covariance: FloatArray) -> "EchoModel":
        """The model of a slope (component, state) and a covariance."""
        model = cls(ndim_state=N_STATE, mapping=tuple(range(len(slope))), noise_covar=covariance)
        model.slope = slope
        return model

    def matrix(self, **kwargs: Any) -> FloatArray:
        """The slope."""
        del kwargs
        return self.slope


def transition(config: TrackConfig) -> CombinedLinearGaussianTransitionModel:
    """Velocities that are forgotten over `steady_s` and keep their spread (Ornstein-Uhlenbeck); heights stay."""
    damping = 1 / config.steady_s
    axis = OrnsteinUhlenbeck(2 * damping * config.speed_std_m_s**2, damping)
    return CombinedLinearGaussianTransitionModel([axis, axis, RandomWalk(HEIGHT_WALK)])


def prior(config: TrackConfig, time_s: float) -> GaussianState:
    """A mover before its first echo."""
    mean, std = np.zeros(N_STATE), np.zeros(N_STATE)
    mean[HEIGHT] = config.height_m
    std[POSITION], std[VELOCITY], std[HEIGHT] = ANYWHERE_M, config.speed_std_m_s, config.height_std_m
    return GaussianState(mean[:, None], np.diag(std**2), timestamp=at(time_s))


def detection(bounce: OneBounce, time_s: float) -> Detection:
    """All that an echo measures."""
    model = EchoModel.of(bounce.slope, bounce.echo.covariance)
    return Detection(bounce.measured[:, None], timestamp=at(time_s), measurement_model=model)


def place(bounce: OneBounce, time_s: float) -> Detection:
    """The point in the plan that an echo of one bounce shows."""
    model = LinearGaussian(N_STATE, POSITION, bounce.spread[np.ix_(POSITION, POSITION)])
    return Detection(bounce.state[POSITION][:, None], timestamp=at(time_s), measurement_model=model)


def at(time_s: float) -> datetime:
    """A time of the campaign as Stone Soup counts it, to the microsecond."""
    return START + timedelta(seconds=float(time_s))
