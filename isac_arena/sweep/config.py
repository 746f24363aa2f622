"""Sweep files: a base campaign, and axes over any field of the campaign or of its scene."""

from typing import Annotated, Any, Literal, Self

from pydantic import Field, model_validator

from scenes.names import FileName, Name
from scenes.toml_config import ConfigModel


class AxisConfig(ConfigModel):
    """One axis: a field, with its values or with a range.

    The field is a dotted path into the campaign (`waveform.n_rb`); or, after `scene`, into its scene file, where
    tables in a list have names (`scene.objects.pillar_a.radius_m`). `functions.slam.function` varies the function
    of a user in place of SLAM, `ours` among them; `estimator` is short for `functions.channel.function`.
    """

    field: str = Field(min_length=1, description="dotted path of the field that varies")
    label: str | None = Field(None, description="what tables and figures call it; by default the field")
    values: Annotated[list[Any], Field(min_length=1)] | None = Field(None, description="the values it takes")
    low: float | None = Field(None, description="lower end of a range")
    high: float | None = Field(None, description="upper end of a range")
    count: int | None = Field(None, ge=2, le=10_000, description="values of a range on a grid or in a list")
    log: bool = Field(False, description="whether a range is uniform in the logarithm")
    integer: bool = Field(False, description="whether values of a range are rounded to whole numbers")

    @model_validator(mode="after")
    def _values_or_range(self) -> Self:
        has_range = self.low is not None or self.high is not None
        if (self.values is None) != has_range:
            raise ValueError(f"field = '{self.field}': give either values, or low and high")
        if self.low is None or self.high is None:
            if has_range:
                raise ValueError(f"field = '{self.field}': a range needs low and high")
            return self
        if not self.low < self.high or (self.log and self.low <= 0):
            raise ValueError(
                f"field = '{self.field}', low = {self.low:g}, high = {self.high:g}: low must be below "
                "high, and above 0 where log = true"
            )
        return self


class UntilConfig(ConfigModel):
    """Repeat seeds of every case until a metric is known well enough."""

    metric: str = Field(min_length=1, description="key of the metric, as in scores.json")
    half_width: float = Field(gt=0, description="wanted half width of the confidence interval of its mean")
    confidence: float = Field(0.95, gt=0.5, lt=1, description="level of the interval (Student's t)")
    max_repeats: int = Field(100, ge=2, le=100_000, description="repeats at the most")


class SweepConfig(ConfigModel):
    """A sweep: every case is the base campaign with some fields changed, repeated with other seeds."""

    name: Name = Field(description="name of the sweep")
    base: FileName = Field(description="campaign name of the library, or path of a campaign file")
    design: Literal["grid", "list", "random", "latin_hypercube"] = Field(
        "grid", description="all combinations; values side by side; or points drawn over the ranges"
    )
    n_points: int | None = Field(None, ge=1, le=1_000_000, description="random, latin_hypercube: points drawn")
    design_seed: int = Field(1, ge=0, lt=2**63, description="seed of the points drawn")
    repeats: int = Field(1, ge=1, le=100_000, description="seeds per point, from the campaign's own on")
    stop_every: int = Field(1, ge=1, description="take every n-th receiver stop of the walk")
    until: UntilConfig | None = Field(None, description="repeat until a metric is known; off by default")
    axes: list[AxisConfig] = Field([], description="what varies")

    @model_validator(mode="after")
    def _agree(self) -> Self:
        drawn = self.design in ("random", "latin_hypercube")
        if drawn != (self.n_points is not None):
            raise ValueError(
                f"n_points = {self.n_points}: must be given with design = 'random' or 'latin_hypercube', "
                "and only with them"
            )
        fields = [axis.field for axis in self.axes]
        twice = sorted({name for name in fields if fields.count(name) > 1})
        if twice:
            raise ValueError(f"axes: field '{twice[0]}' is given twice")
        for axis in self.axes:
            if not drawn and axis.values is None and axis.count is None:
                raise ValueError(f"axes.{axis.field}.count: a range needs it where design = '{self.design}'")
        if self.until is not None and self.repeats < 2:
            raise ValueError(f"repeats = {self.repeats}: must be at least 2 where `until` uses their spread")
        return self
