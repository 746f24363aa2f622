"""Numbers for the page: rounded flat lists with None for values that are not finite."""

import math
from base64 import b64encode
from typing import Any

import numpy as np

from scenes.record import FloatArray

POWER_STEP_DB = 0.25
SIGNIFICANT_DIGITS = 4
POWER_LEVELS = 255


def rounded(values: Any, decimals: int) -> list[float | None]:
    """All values of an array in order, None for those that are not finite."""
    flat = np.round(np.asarray(values, float).ravel(), decimals) + 0.0  # no negative zero
    return [_short(value) if math.isfinite(value) else None for value in flat.tolist()]


def significant(values: Any) -> list[float | None]:
    """All values of an array in order to `SIGNIFICANT_DIGITS`, None for those that are not finite."""
    flat = np.asarray(values, float).ravel().tolist()
    return [_short(float(f"{value:.{SIGNIFICANT_DIGITS}g}")) if math.isfinite(value) else None for value in flat]


def number(value: float, decimals: int) -> float | None:
    """One value as in `rounded`."""
    return rounded([value], decimals)[0]


def _short(value: float) -> float:
    return int(value) if value == int(value) else value


def quantised_power(power_dbm: FloatArray) -> tuple[float, str]:
    """Largest power in dBm, and the difference of each value (row, column) to it as one byte each, in base64.

    The step is `POWER_STEP_DB`; differences of `POWER_LEVELS` steps or more have the last level.
    """
    top = float(power_dbm.max())
    steps = np.clip(np.round((top - power_dbm) / POWER_STEP_DB), 0, POWER_LEVELS)
    return round(top, 2), b64encode(steps.astype(np.uint8).tobytes()).decode("ascii")
