"""Attribution of an error to parts of a chain, with intervals.

The error is a mean square over units (stops, objects): squares of independent errors add, their roots do not. The
parts are replaced one after the other. The contribution of a part is the decrease of the mean square when it is
replaced, averaged over all orders that respect the causal order: the asymmetric Shapley value of Frye, Rowat and
Feige, "Asymmetric Shapley values: incorporating causal knowledge into model-agnostic explainability",
NeurIPS 2020; with one group of parts the Shapley value (1953). The contributions add up to the whole mean square
minus the mean square with all parts replaced.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from scipy.stats import bootstrap

from isac_arena.insight.budget.stages import Groups, Part, orders
from scenes.record import FloatArray, IntArray, TextArray

CONFIDENCE = 0.95
MIN_UNITS = 6  # stops or objects: the bootstrap interval of fewer is far too short
NOTHING = 1e-9  # of the whole: rounding errors are smaller
MOST_SHARE = 2.0  # a larger part is cancelled by parts of the other sign


@dataclass(frozen=True)
class Attribution:
    """Attribution of one mean square. Intervals cover the sampling of the units and the choice of the order.

    `low` and `high` span the bootstrap intervals of the share in all admissible orders, so that the share in any
    order is in its interval. Shares are NaN where there is no error.
    """

    part: tuple[Part, ...]
    contribution: FloatArray  # (part,) mean over orders
    low: FloatArray  # (part,) of the contribution over the total
    high: FloatArray  # (part,)
    alone: FloatArray  # (part,) decrease when this part alone is replaced
    first: FloatArray  # (part,) contribution in the orders where it comes earliest
    last: FloatArray  # (part,) and where it comes latest
    total: float  # with nothing replaced
    total_low: float
    total_high: float
    rest: float  # with all parts replaced
    rest_low: float  # of the rest over the total
    rest_high: float
    n_units: int

    @property
    def effect(self) -> TextArray:
        """Whether the error without each part (part,) 'falls', 'grows' or does not change ('none').

        'undecided' where the interval contains zero.
        """
        effect = np.full(len(self.part), "undecided")
        effect[self.low > NOTHING] = "falls"
        effect[self.high < -NOTHING] = "grows"
        effect[(np.abs(self.low) <= NOTHING) & (np.abs(self.high) <= NOTHING)] = "none"
        return effect

    @property
    def objection(self) -> str:
        """Why shares of the total would have no meaning; empty where they have one."""
        if self.total == 0:
            return "there is no error"
        if self.n_units < MIN_UNITS:
            return f"{self.n_units} stops or objects, an interval needs {MIN_UNITS}"
        if np.abs(self.contribution).max() > MOST_SHARE * self.total:
            return f"parts cancel: one is more than {MOST_SHARE:g} times the whole"
        if not np.isin(self.effect, ("falls", "grows")).any() and not self.rest_low > NOTHING:
            return "no interval excludes zero"
        return ""


def signed_root(mean_square: FloatArray | float) -> FloatArray:
    """Square root of a mean square or of a difference of two, with its sign."""
    return np.asarray(np.sign(mean_square) * np.sqrt(np.abs(mean_square)))


def attribute(
    squared_error: Mapping[frozenset[Part], FloatArray],
    groups: Groups,
    rng: np.random.Generator,
    n_resamples: int = 2000,
) -> Attribution:
    """Attribute an error to parts, from the squared errors (unit,) of every coalition of replaced parts.

    Intervals are percentile bootstrap intervals over the units (Efron and Tibshirani 1993, section 13.3), NaN
    with a single unit.

    Raises `ValueError` where there are no units, or coalitions differ in their number.
    """
    table = {parts: np.asarray(values, float) for parts, values in squared_error.items()}
    n_units = {len(values) for values in table.values()}
    if len(n_units) != 1 or n_units == {0}:
        what = f"{sorted(n_units)} units; every coalition needs the same, one or more"
        raise ValueError(f"squared_error: {what}")
    parts = tuple(part for group in groups for part in group)
    sequences = list(orders(groups))
    whole, everything = table[frozenset()], table[frozenset(parts)]

    def falls(index: IntArray) -> FloatArray:
        value = {key: values[index].mean(axis=-1) for key, values in table.items()}
        return np.stack([_falls(value, order, parts) for order in sequences])

    def shares(units: FloatArray, axis: int = -1) -> FloatArray:
        """Shares (order, part, ...), then the share of the rest and the total, as rows of one array."""
        del axis
        index = units.astype(int)
        by_part, total = falls(index), whole[index].mean(axis=-1)
        rows = np.concatenate([by_part.reshape(-1, *by_part.shape[2:]), [everything[index].mean(axis=-1)]])
        over = np.divide(rows, total, out=np.zeros_like(rows), where=total > 0)
        return np.concatenate([over, [total]])

    all_units = np.arange(n_units.pop())
    by_order, total = falls(all_units), float(whole.mean())
    low, high = _interval(all_units.astype(float), shares, by_order.size + 2, rng, n_resamples)
    of_order = by_order / total if total else np.full_like(by_order, np.nan)
    alone = [whole.mean() - table[frozenset({part})].mean() for part in parts]
    place = np.array([[order.index(part) for part in parts] for order in sequences])
    earliest, latest = place == place.min(axis=0), place == place.max(axis=0)
    return Attribution(
        part=parts,
        contribution=by_order.mean(axis=0),
        low=np.minimum(low[:-2].reshape(by_order.shape), of_order).min(axis=0),
        high=np.maximum(high[:-2].reshape(by_order.shape), of_order).max(axis=0),
        alone=np.array(alone),
        first=np.where(earliest, by_order, 0).sum(axis=0) / earliest.sum(axis=0),
        last=np.where(latest, by_order, 0).sum(axis=0) / latest.sum(axis=0),
        total=total,
        total_low=float(low[-1]),
        total_high=float(high[-1]),
        rest=float(everything.mean()),
        rest_low=float(low[-2]),
        rest_high=float(high[-2]),
        n_units=len(all_units),
    )


def _falls(
    value: Mapping[frozenset[Part], FloatArray], order: tuple[Part, ...], parts: tuple[Part, ...]
) -> FloatArray:
    """Decrease of the mean square at the turn of every part (part, ...) in one order."""
    met = [value[frozenset(order[:length])] for length in range(len(order) + 1)]
    fall = {part: before - after for part, before, after in zip(order, met, met[1:], strict=False)}
    return np.stack([fall[part] for part in parts])


def _interval(
    units: FloatArray, statistic: Callable[..., FloatArray], size: int, rng: np.random.Generator, n_resamples: int
) -> tuple[FloatArray, FloatArray]:
    """Percentile bootstrap interval of `size` statistics of the units, NaN where there is one unit alone."""
    if len(units) < 2:
        return np.full(size, np.nan), np.full(size, np.nan)
    found = bootstrap(
        (units,), statistic, n_resamples=n_resamples, vectorized=True, confidence_level=CONFIDENCE,
        method="percentile", rng=rng,
    ).confidence_interval  # fmt: skip
    return np.asarray(found.low), np.asarray(found.high)
