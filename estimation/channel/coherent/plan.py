"""Plan of a search: bases, grids and levels of a pair of codebooks, made once, and the delays to search."""

import hashlib
from dataclasses import dataclass, fields
from functools import lru_cache

import numpy as np

from estimation.channel.coherent.pair_errors import LitPairs
from estimation.channel.coherent.refine import Reference, refine_separately
from estimation.channel.coherent.search import DirectionGrid, SpectrumSearch, direction_grid, turn_rate
from estimation.channel.config import MaximumLikelihoodConfig
from estimation.channel.model.compress import BeamSpan, DelayCube, beam_span, every_beam
from estimation.channel.model.false_alarms import (
    delay_curvatures,
    detection_level,
    direction_curvatures,
    region_curvatures,
)
from estimation.channel.model.manifold import Manifold
from estimation.channel.model.path_model import PathParameters, no_paths
from estimation.channel.model.turns import SweepTurns
from scenes.record import BoolArray, FloatArray, IntArray
from sim.signal.arrays.codebook import Codebook

SCALLOPING = 0.6  # least share of a peak's power on the search grid, for 97 % of the peaks
MARGIN_BINS = 24  # kept outside the searched delays, for the side lobes of paths at their edges
TILE_BINS = 448  # delays searched at once in a search of the whole period
LATE_LEVEL = 12.5  # power of a compressed cell, over the noise, above which delays outside the window are searched
LATE_MARGIN_BINS = 12
NEAR_SHARE = 0.8  # of the allowed false alarms, for the delays where paths are expected


@dataclass(frozen=True, eq=False)
class SearchPlan:
    """Bases, search grids and curvatures of the directions of both ends."""

    tx: BeamSpan
    rx: BeamSpan
    grids: tuple[DirectionGrid, DirectionGrid]
    curvatures: FloatArray
    oversampling: int
    turns: SweepTurns | None = None

    @lru_cache(maxsize=64)  # noqa: B019  plans are few and live long
    def level(self, probability: float, n_bins: int, n_subcarriers: int) -> float:
        """Power over noise power that noise exceeds with this probability at any of `n_bins` delays."""
        return detection_level(
            probability, region_curvatures(delay_curvatures(n_bins, n_subcarriers), self.curvatures)
        )


@dataclass(frozen=True)
class DelayWindow:
    """Delay bins kept, and the power over noise power that a path needs there.

    Attributes
    ----------
    position : (bin,) ascending, around the strongest path, and separate intervals that may hold later paths
    first, last : bins around the strongest path, where `level` applies; elsewhere it is `late_level`
    pairs : beam pairs with errors, by whose noise levels increase; None if there are none
    """

    position: IntArray
    first: int
    last: int
    level: float
    late_level: float
    pairs: LitPairs | None = None

    def level_at(self, paths: PathParameters) -> FloatArray:
        """Level (path,) of paths."""
        return self.white_level_at(paths.delay_bins) * self.noise_at(paths)

    def white_level_at(self, delay_bins: FloatArray) -> FloatArray:
        """Level (path,) of paths at delays in bins in the noise of the receiver alone."""
        is_inside = (delay_bins >= self.first - 0.5) & (delay_bins <= self.last + 0.5)
        return np.where(is_inside, self.level, self.late_level)

    def noise_at(self, paths: PathParameters) -> FloatArray:
        """Noise power (path,) that paths compete with, over that of the receiver."""
        return np.ones(len(paths)) if self.pairs is None else self.pairs.noise_factor(paths)


class _ByContent:
    """A codebook as a cache key: equal if all its arrays are equal."""

    def __init__(self, codebook: Codebook) -> None:
        self.codebook = codebook
        digest = hashlib.blake2b(digest_size=16)
        for spec in fields(codebook):
            value = np.asarray(getattr(codebook, spec.name))
            digest.update(f"{spec.name}{value.shape}{value.dtype}".encode() + value.tobytes())
        self._digest = digest.digest()

    def __hash__(self) -> int:
        return hash(self._digest)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _ByContent) and self._digest == other._digest


def nominal_manifold(codebook: Codebook) -> Manifold:
    """The manifold of a codebook, cached for the next stop of the same device."""
    return _manifold(_ByContent(codebook))


@lru_cache(maxsize=8)
def _manifold(key: _ByContent) -> Manifold:
    return Manifold(key.codebook)


@lru_cache(maxsize=8)
def search_plan(
    tx: Manifold,
    rx: Manifold,
    noise_power_mw: tuple[float, ...],
    oversampling: float,
    turns: SweepTurns | None = None,
) -> SearchPlan:
    """The plan for the beams of two devices and the noise power of every RX beam, cached for the next stop.

    With the times of the beams in `turns`, Doppler shifts are searched as well.
    """
    span = beam_span if turns is None else every_beam
    spans = span(tx), span(rx, np.asarray(noise_power_mw))
    grids = direction_grid(spans[0].manifold, oversampling), direction_grid(spans[1].manifold, oversampling)
    regions = [direction_curvatures(each.manifold) for each in spans]
    if turns is not None:
        rate = turn_rate(turns, grids)
        regions.append(np.array([1.0, 2 * turns.most * rate]))
    return SearchPlan(
        *spans,
        grids=grids,
        curvatures=region_curvatures(*regions),
        oversampling=int(np.ceil(oversampling)),
        turns=turns,
    )


def delay_window(cube: DelayCube, plan: SearchPlan, config: MaximumLikelihoodConfig) -> DelayWindow | None:
    """Delays to keep: those around the strongest path, and later ones near strong cells; None without a path.

    The strongest path must exceed the level of noise anywhere in the period, with four fifths of the allowed false
    alarms at the expected delays. With its delay known, the same share is used for the delays near it.
    """
    n = cube.n_bins
    cells = _strongest_cells(cube)
    levels = _first_levels(cube, plan, config)
    strongest = int(np.argmax(cells))
    anchor = strongest if cells[strongest] >= levels[strongest] else _strongest_path(cube, plan, levels)
    if anchor is None:
        return None
    anchor = _signed(anchor, n)
    before, after = _bins(cube, config.delay_before_ns), _bins(cube, config.delay_after_ns)
    n_near = before + after + 1
    if n_near + 2 * MARGIN_BINS >= n:
        position = np.arange(n) + anchor - min(before, n // 2)
        level = plan.level(config.false_alarm_probability, n, n)
        return DelayWindow(position, int(position[0]), int(position[-1]), level, level)
    position = np.arange(n) + anchor - before - MARGIN_BINS
    kept = position <= anchor + after + MARGIN_BINS
    kept |= _may_hold_paths(cells[position % n], position - anchor, ~kept)
    level, late_level = _levels(plan, config.false_alarm_probability, n_near, n)
    return DelayWindow(position[kept], anchor - before, anchor + after, level, late_level)


def _levels(plan: SearchPlan, probability: float, n_near: int, n: int) -> tuple[float, float]:
    """Levels at the `n_near` delay bins that are likely to hold a path, and at the other bins of the period."""
    return (
        plan.level(NEAR_SHARE * probability, n_near, n),
        plan.level((1 - NEAR_SHARE) * probability, n - n_near, n),
    )


def _first_levels(cube: DelayCube, plan: SearchPlan, config: MaximumLikelihoodConfig) -> FloatArray:
    """Level (bin,) that the strongest path needs at every delay bin of the period."""
    n = cube.n_bins
    early, late = (_bins(cube, ns) for ns in config.expected_delay_ns)
    if late - early + 1 >= n:
        return np.full(n, plan.level(config.false_alarm_probability, n, n))
    expected, other = _levels(plan, config.false_alarm_probability, late - early + 1, n)
    levels = np.full(n, other)
    levels[np.arange(early, late + 1) % n] = expected
    return levels


def _bins(cube: DelayCube, delay_ns: float) -> int:
    return int(np.ceil(1e-9 * delay_ns / cube.bin_s))


def _signed(delay_bin: int, n: int) -> int:
    """A bin of the period as a delay: the last eighth is negative, since a clock bias can make delays negative."""
    return delay_bin - n if delay_bin >= n - n // 8 else delay_bin


def _strongest_cells(cube: DelayCube) -> FloatArray:
    """Largest power (bin,) of the compressed cells of every delay bin, over the noise power."""
    power = cube.spectrum.real**2
    power += cube.spectrum.imag**2
    return np.asarray(power.max(axis=(0, 1)) / cube.noise_scale, float)


def _may_hold_paths(cells: FloatArray, distance: IntArray, outside: BoolArray) -> BoolArray:
    """Bins outside the window near cells that neither noise nor side lobes of the paths inside explain."""
    n = len(cells)
    strong = cells[~outside & (cells > LATE_LEVEL)]
    side_lobe = np.sqrt(strong).sum() / np.pi / np.maximum(1, np.minimum(distance % n, -distance % n))
    found = np.flatnonzero(outside & (np.sqrt(cells) > np.sqrt(LATE_LEVEL) + side_lobe))
    near = np.zeros(n + 2 * LATE_MARGIN_BINS, bool)
    for offset in range(2 * LATE_MARGIN_BINS + 1):
        near[found + offset] = True
    return near[LATE_MARGIN_BINS:-LATE_MARGIN_BINS] & outside


def _strongest_path(cube: DelayCube, plan: SearchPlan, levels: FloatArray) -> int | None:
    """Delay bin of the path of the whole period that exceeds its level (bin,) by most; None if there is none."""
    n, best, found = cube.n_bins, 0.0, None
    for start in range(0, n, TILE_BINS):
        end = min(n, start + TILE_BINS)
        margin = min(MARGIN_BINS, (n - (end - start)) // 2)
        tile = cube.window(np.arange(start - margin, end + margin))
        search = SpectrumSearch(tile, plan.grids, plan.oversampling)
        peaks = search.peaks(tile.parts, SCALLOPING * levels[start:end].min())
        inside = (peaks.delay_bins >= start - 0.5) & (peaks.delay_bins < end - 0.5)
        paths, power = refine_separately(Reference(tile, no_paths(tile)), search.paths(peaks.take(inside)))
        if not len(power):
            continue
        bins = np.round(paths.delay_bins).astype(int) % n
        excess = power - levels[bins]
        if excess.max() >= best:
            best, found = float(excess.max()), int(bins[np.argmax(excess)])
    return found
