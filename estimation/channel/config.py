"""Settings of channel estimation: the method, and those of each method."""

from typing import Literal

from pydantic import Field, field_validator

from scenes.toml_config import ConfigModel, Pair

MOST_INCOHERENT_PATHS = 80  # the time grows with their square: every pair of beams has a phase of its own

MethodName = Literal["auto", "coherent", "incoherent", "power"]


class MaximumLikelihoodConfig(ConfigModel):
    """Detection and refinement of the coherent and incoherent maximum-likelihood methods."""

    false_alarm_probability: float = Field(
        3e-4, gt=0, lt=1, description="probability of any path at a stop that holds noise alone"
    )
    max_paths: int = Field(
        120, ge=1, le=400, description="most paths per stop, weak ones included; the incoherent fit stops at 80"
    )
    whiten_background: bool = Field(
        True, description="estimate the dense diffuse power over delay and whiten by it (coherent)"
    )
    oversampling: float = Field(2.0, ge=1, le=8, description="search grid points per resolution cell")
    expected_delay_ns: Pair = Field(
        (-200.0, 1000.0),
        description="delays (with clock bias) where the first path is expected; others need more power",
    )
    delay_before_ns: float = Field(
        100.0, gt=0, description="other paths are expected from this long before the strongest path"
    )
    delay_after_ns: float = Field(
        300.0, gt=0, description="to this long after it; a path at another delay needs more power"
    )

    max_length_rate_m_s: float = Field(
        6.0,
        gt=0,
        le=200,
        description="fastest change of a path's length that is searched, where sweeps have a clock (coherent)",
    )

    max_element_error: float = Field(
        0.3, gt=0, le=0.3, description="largest credible power of the error of an array element over its own"
    )

    @property
    def max_incoherent_paths(self) -> int:
        """Most paths of the incoherent fit."""
        return min(self.max_paths, MOST_INCOHERENT_PATHS)

    @field_validator("expected_delay_ns")
    @classmethod
    def _ascend(cls, value: tuple[float, float]) -> tuple[float, float]:
        if value[0] >= value[1]:
            raise ValueError("the first must be below the second")
        return value


class PowerMethodConfig(ConfigModel):
    """Settings of the power-only method."""

    false_alarm_probability: float = Field(1e-2, gt=0, lt=1, description="of a stop that holds noise alone")
    dynamic_range_db: float = Field(
        28.0, gt=0, description="level of the weakest reported path below the strongest"
    )
    side_lobe_margin_db: float = Field(4.0, ge=0, description="a peak must exceed side lobes by this")
    max_misfit: float = Field(0.05, gt=0, description="largest misfit of a path to the beam patterns")
    max_paths: int = Field(40, ge=1, description="most paths per stop")
    use_patterns: bool = Field(
        True, description="angles by the nominal beam patterns; false: by beam powers and pointings alone"
    )
    delay_std_floor_ns: float = Field(0.02, ge=0, description="added in quadrature to every delay's std")
    angle_std_floor_deg: float = Field(0.05, ge=0, description="added in quadrature to every angle's std")


class LosConfig(ConfigModel):
    """Prior of lines of sight, reflections and the clock."""

    power_at_1m_dbm: float = Field(-13.0, description="LOS power at 1 m between the peaks of two beams")
    tolerance_db: float = Field(3.0, gt=0, description="spread of a LOS's power about free space")
    reflection_loss_db: float = Field(12.0, ge=0, description="mean loss of a reflected path beyond free space")
    reflection_std_db: float = Field(7.0, gt=0, description="spread of that loss")
    least_loss_db: float = Field(6.0, ge=0, description="mean loss of a stop's least attenuated reflection")
    least_loss_std_db: float = Field(5.0, gt=0, description="spread of that loss")
    blocked_share: float = Field(0.3, gt=0, lt=1, description="prior share of stops without a LOS")
    ghost_share: float = Field(0.01, gt=0, lt=1, description="share of estimated paths that are ghosts")
    max_clock_bias_ns: float = Field(150.0, gt=0, description="largest credible clock bias")
    clock_std_ns: float | None = Field(
        None, gt=0, description="spread of the clock bias about zero if clocks are synchronised"
    )
    angle_std_deg: float = Field(2.0, gt=0, description="error of known directions: poses, pointing")


class SelfCalibrationConfig(ConfigModel):
    """Self-calibration of the arrays from the sweeps of a campaign."""

    use: Literal["auto", "always", "never"] = Field(
        "auto", description="auto: maximum-likelihood methods, where the first stops show errors of elements"
    )
    stops: int = Field(8, ge=2, description="number of stops used, spread over the campaign")
    max_paths: int = Field(30, ge=1, description="strongest paths of a stop that are used where phases hold")
    errors: Literal["elements", "beams", "both"] = Field("elements", description="what is estimated")
    prior_std: float = Field(0.3, gt=0, description="prior spread of relative errors")
    min_snr_db: float = Field(16.0, ge=10, description="least SNR of a used path in its best beam pair")
    min_purity: float = Field(0.97, gt=0, lt=1, description="share of the first singular value's power")
    turns: int = Field(30, ge=1, description="iterations over directions, elements and beams")


class HallConfig(ConfigModel):
    """What is made of floor and ceiling: they repeat the paths over upright surfaces, as heights tell."""

    use: bool = Field(
        True, description="tie such versions of a path to each other, with maximum-likelihood methods"
    )
    stops: int = Field(8, ge=1, description="stops at which the heights of floor and ceiling are read")


class ChannelConfig(ConfigModel):
    """Settings of channel estimation: the method, and the settings of each method."""

    method: MethodName = Field(
        "auto",
        description="maximum likelihood with or without phases between beam pairs, auto: as the signal allows; "
        "or beam powers alone",
    )
    maximum_likelihood: MaximumLikelihoodConfig = MaximumLikelihoodConfig()
    power: PowerMethodConfig = PowerMethodConfig()
    los: LosConfig = LosConfig()
    delay_std_floor_ns: float = Field(
        0.0,
        ge=0,
        description="added in quadrature to maximum-likelihood delays: errors of the model of separate paths",
    )
    angle_std_floor_deg: float = Field(0.0, ge=0, description="the same for their angles")
    interference: Literal["whiten", "ignore"] = Field(
        "whiten", description="another TX on the same resource elements: as noise of the RX beams, or not at all"
    )
    self_calibration: SelfCalibrationConfig = SelfCalibrationConfig()
    hall: HallConfig = HallConfig()
