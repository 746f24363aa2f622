"""Settings of the tracks of movers."""

from typing import Literal, Self

from pydantic import Field, model_validator

from scenes.toml_config import ConfigModel


class TrackConfig(ConfigModel):
    """Tracks of what moves, from stop to stop. Without paths that move there are none, and nothing is written."""

    method: Literal["bernoulli", "nearest", "none"] = Field(
        "bernoulli",
        description="multi-Bernoulli filter; Kalman filter with nearest neighbours (the baseline); no tracks",
    )
    speed_std_m_s: float = Field(1.0, gt=0, le=50, description="of a mover, per axis")
    steady_s: float = Field(1.5, gt=0, le=1e4, description="time over which a mover forgets its velocity")
    height_m: float = Field(0.8, ge=-100, le=1000, description="expected height of what echoes, over z = 0")
    height_std_m: float = Field(0.5, gt=0, le=100, description="its standard deviation")
    detection_probability: float = Field(0.6, gt=0, lt=1, description="of a mover's direct echo at a stop")
    birth_probability: float = Field(
        0.8, gt=0, lt=1, description="that an exact echo of one bounce, which no track explains, is a new mover"
    )
    most_chi_square: float = Field(
        12.0, gt=0, description="of an echo of one bounce: squared deviations, 2 degrees of freedom"
    )
    clutter: float = Field(
        0.02, gt=0, description="echoes of one bounce of no known mover, per m, rad^2 and m/s at a stop"
    )
    survival_per_s: float = Field(0.98, gt=0, le=1, description="chance of a mover to be there a second later")
    least_existence: float = Field(0.05, ge=0, lt=1, description="below it a track ends")
    shown_existence: float = Field(0.5, gt=0, lt=1, description="a track is reported once it exceeds this")
    body_m: float = Field(0.6, ge=0, description="further echoes that near to a mover are of its body")
    most_std_m: float = Field(0.5, gt=0, description="of a position: stops where it is less known are left out")
    floor_range_m: float = Field(0.005, ge=0, description="added in quadrature to the lengths of echoes")
    floor_angle_deg: float = Field(0.05, ge=0, description="added in quadrature to their angles")
    floor_rate_m_s: float = Field(0.005, ge=0, description="added in quadrature to their length rates")

    @model_validator(mode="after")
    def _check_order(self) -> Self:
        if self.least_existence >= self.shown_existence:
            raise ValueError(f"least_existence = {self.least_existence}: must be below shown_existence")
        return self
