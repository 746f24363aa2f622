"""The measured Campus Arena stops that some checks compare with, where their file exists.

The data belong to their authors and are no part of this project. The variable ARENA_DATA names the folder that
holds them; by default it is shared/data beside the repository. Without it every row is NaN, which meets no bar.
"""

import os
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np

from isac_arena.campaign.measured import MeasuredCampaign
from isac_arena.exchange.mat import read_measurement
from isac_arena.validation.measurement import Measurement

N_STOPS = 30
FILE, PLAN = "campus_arena_30.mat", "campus_arena_floorplan.csv"
SESSION_STOP = 13  # the first stop after the TX was moved


def data_folder() -> Path:
    """Folder of the measured data: ARENA_DATA, or shared/data beside the repository."""
    beside = Path(__file__).resolve().parents[3] / "shared" / "data"
    return Path(os.environ.get("ARENA_DATA", beside))


@cache
def measured_campaign(clock_bias_m: float) -> MeasuredCampaign:
    """The measured stops, with one clock bias for all of them."""
    return read_measurement(data_folder() / FILE, clock_bias_m=np.full(N_STOPS, clock_bias_m))


def with_values(
    rows: Sequence[Measurement], values: Callable[[], Iterable[float]], *needed: str
) -> list[Measurement]:
    """The rows with their values in order; as they are, with the file that is missing as reason, without data."""
    for name in (FILE, *needed):
        if not (data_folder() / name).is_file():
            reason = f"not measured: {name} is not in {data_folder()}"
            return [replace(row, reason=reason) for row in rows]
    return [replace(row, value=float(value)) for row, value in zip(rows, values(), strict=True)]
