"""Settings of the maximum-likelihood channel estimators."""

from pydantic import Field, field_validator

from scenes.toml_config import ConfigModel, Pair

MOST_INCOHERENT_PATHS = 80  # the time grows with their square: every pair of beams has a phase of its own


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
