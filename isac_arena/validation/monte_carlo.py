"""What Monte Carlo checks share: generators, bars of quick runs, and rows of consistency and efficiency."""

from collections.abc import Iterable, Iterator

import numpy as np
from scipy.stats import binom, norm, poisson

from isac_arena.scoring.metrics.consistency import consistency_metrics
from isac_arena.validation.measurement import Measurement, at_least, at_most
from scenes.record import FloatArray

STANDARD_ERRORS = 3.0  # that the value of a quick run, with few trials, may be off by chance
BY_CHANCE = float(norm.cdf(-STANDARD_ERRORS))


def generators(seed: int, count: int, *path: int) -> Iterator[np.random.Generator]:
    """A generator of its own for every trial, so that a trial does not depend on how many run before it."""
    return (np.random.default_rng([seed, trial, *path]) for trial in range(count))


def quick_bar(bar: float, standard_error: float, quick: bool) -> float:
    """The bar; in a quick run, with few trials, moved by three (signed) standard errors of the value."""
    return float(bar + STANDARD_ERRORS * standard_error) if quick else bar


def standard_error(values: FloatArray) -> float:
    """Standard error of the mean of values; NaN values do not count to the spread."""
    return float(np.nanstd(values)) / float(np.sqrt(len(values)))


def most_by_chance(expected: float) -> float:
    """Count that rare events, `expected` on average, exceed with the probability of three standard errors."""
    return float(poisson.ppf(1 - BY_CHANCE, expected))


def fewest_by_chance(count: int, share: float) -> float:
    """Hits of `count` trials, each a hit with the probability `share`, that chance alone may fall to."""
    return float(binom.ppf(BY_CHANCE, count, share))


def consistency(nees: FloatArray, freedom: int) -> tuple[float, float]:
    """Mean NEES (trial,) over its degrees of freedom, and the share of trials inside the 95 % region.

    A trial without a solution has no NEES (NaN) and counts as outside of the region. NaN for no trial.
    """
    if not len(nees):
        return np.nan, np.nan
    mean, cover, _ = (metric.value for metric in consistency_metrics("", nees, freedom))
    return mean, cover * float(np.isfinite(nees).mean())


def band_rows(
    key: str, value: float, bars: tuple[float, float], error: float, quick: bool, reason: str
) -> list[Measurement]:
    """Two rows that hold a value between two bars; a quick run moves both by its standard `error`."""
    low, high = quick_bar(bars[0], -error, quick), quick_bar(bars[1], error, quick)
    return [at_least(f"{key}.least", value, low, reason), at_most(f"{key}.most", value, high, reason)]


def nees_row(key: str, nees: FloatArray, freedom: int, bar: float, of: str = "") -> Measurement:
    """Distance of the mean NEES over its degrees of freedom from 1, its value for a consistent estimator."""
    mean, _ = consistency(nees, freedom)
    return at_most(key, abs(mean - 1), bar, f"NEES over its {freedom} degrees of freedom is {mean:.3f}{of}")


def coverage_row(key: str, nees: FloatArray, freedom: int, bar: float, of: str = "") -> Measurement:
    """Distance of the share of errors inside their 95 % region from 0.95."""
    _, cover = consistency(nees, freedom)
    return at_most(key, abs(cover - 0.95), bar, f"{cover:.4f} of the errors lie in their 95 % region{of}")


def rms_ratio(squared_error: Iterable[float], bound: Iterable[float]) -> float:
    """RMS error over the RMS bound: 1 for an efficient estimator."""
    return float(np.sqrt(np.mean(list(squared_error)) / np.mean(np.square(list(bound)))))
