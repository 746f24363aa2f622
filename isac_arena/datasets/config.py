"""Specifications of data sets."""

from typing import Annotated, Any, Literal, Self

from pydantic import Field, model_validator

from scenes.names import Name
from scenes.toml_config import ConfigModel, Pair

Kept = Literal["samples", "power_map", "cube", "paths", "poses", "contours", "occupancy"]
Split = Literal["train", "validation", "test"]
Share = Annotated[float, Field(ge=0, le=1)]
FORMAT = 1  # of the files; readers of another one are refused


class RandomScenesConfig(ConfigModel):
    """Scenes by rule: random arenas with their materials and walks, each from a seed of its own."""

    count: int = Field(ge=1, le=1_000_000, description="scenes")
    n_stops: int = Field(10, ge=1, le=10_000, description="receiver stops of each")
    difficulty: Pair = Field(
        (0.0, 0.5), description="range of the difficulty, 0 (one pillar) to 1 (cluttered hall)"
    )

    @model_validator(mode="after")
    def _ascend(self) -> Self:
        low, high = self.difficulty
        if not 0 <= low <= high <= 1:
            raise ValueError(f"difficulty = [{low:g}, {high:g}]: must ascend within 0 and 1")
        return self


class SplitsConfig(ConfigModel):
    """Shares of the scenes: all stops of a scene are in one split."""

    train: Share = Field(0.8, description="share of the scenes to learn from")
    validation: Share = Field(0.1, description="share of the scenes to choose by")
    test: Share = Field(0.1, description="share of the scenes to report on")

    @model_validator(mode="after")
    def _sum_to_one(self) -> Self:
        total = self.train + self.validation + self.test
        if abs(total - 1) > 1e-9:
            raise ValueError(f"train + validation + test = {total:g}: must be 1")
        return self


class DatasetConfig(ConfigModel):
    """A data set: scenes, a campaign over each, what is kept of every stop, and the splits."""

    name: Name = Field(description="name of the data set")
    seed: int = Field(1, ge=0, lt=2**63, description="seed of scenes, splits, noise and clocks")
    licence: str = Field("CC-BY-4.0", min_length=1, max_length=200, description="SPDX name of the licence")
    scenes: RandomScenesConfig
    splits: SplitsConfig = SplitsConfig()
    keep: list[Kept] = Field(["power_map", "paths", "poses"], min_length=1, description="what is kept")
    dtype: Literal["float32", "float16"] = Field("float32", description="numbers of power maps and cubes")
    cube_delays: int = Field(64, ge=2, le=4096, description="delay bins of a cube, from delay 0")
    grid_cells: int = Field(64, ge=4, le=2048, description="cells of an occupancy grid along x, and along y")
    cell_m: float = Field(0.5, gt=0, le=10, description="side of a cell")
    contour_points: int = Field(32, ge=4, le=4096, description="points of a contour")
    scenes_per_shard: int = Field(4, ge=1, le=10_000, description="scenes in a file")
    campaign: dict[str, Any] = Field({}, description="tables of a campaign file, without name, scene and seed")
