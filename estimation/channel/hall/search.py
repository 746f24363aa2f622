"""Coarse search for the heights: pairs of paths vote for differences of dz^2, for every clock bias of their stop.

Two versions of one plan path have lengths with l_2^2 - l_1^2 = dz_2^2 - dz_1^2, whatever the plan length is, and
the same l sin(cone) (or azimuth). A pair of a stop therefore votes, at each clock bias, for one gap
r = sqrt(l_2^2 - l_1^2), with the logarithm of the odds against angles and gap that agree by chance. The heights
are searched whose gaps collect most votes; the clock bias of every stop is marginalised, with the powers of its
paths as prior.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter1d

from estimation.channel.hall.geometry import HEIGHT_SLOPES
from estimation.channel.hall.paths import RangedPaths
from scenes.pose import wrap_angle
from scenes.record import BoolArray, FloatArray, IntArray

FIRST_LENGTH_M, N_CLOCKS = (0.5, 60.0), 100
GAP_STEP_M = 0.04
LARGEST_GAP_M = 24.0
SMALLEST_GAP_M = 0.8
WIDEST_SINE = 0.3  # between the sines (or azimuths) of two versions of a plan path
WINDOW_SINE = 0.06  # where pairs that agree by chance are counted
WINDOW_GAP_M = 1.0
SPREAD = 1.5  # standard deviations are taken this much wider than reported
SHARE = 0.5  # prior share of pairs that are versions among those with angles that agree
LARGEST_DISTANCE = 16.0  # squared, of the angles of pairs that are considered
LEAST_ODDS = 0.1
HEIGHT_STEP_M, COARSE_STEP_M = 0.1, 0.2  # of the grid if the height of the TX is given, and if not
RX_HEIGHTS_M, TX_HEIGHTS_M, CEILINGS_M = (0.2, 4.0), (0.5, 8.0), (2.0, 14.0)
CEILING_STEP_M = 0.02  # of the ceilings where clocks are known
LEAST_MARGIN_M = 0.05  # of the devices below the ceiling
RX_MEDIAN_M, RX_LOG_STD = 1.3, 0.3
APART_M = 0.3  # between starts
N_STARTS = 10

ClockPrior = Callable[[float], Sequence[FloatArray]]  # log prior (clock,) of every stop, by h_t - h_r in m


@dataclass(frozen=True)
class Votes:
    """What the pairs of one stop tell of gaps, at clock biases (clock,) in m.

    `odds` has, for every clock bias, (gap, pair): how much more likely a pair is as versions with this gap than by
    chance.
    """

    clock_m: FloatArray
    odds: Sequence[FloatArray]


def gap_grid() -> FloatArray:
    """Gaps (gap,) in m of the axis of votes."""
    return np.arange(0.0, LARGEST_GAP_M, GAP_STEP_M)


def clock_grid(paths: RangedPaths) -> FloatArray:
    """Clock biases (clock,) in m that give the first path a length of `FIRST_LENGTH_M`."""
    return np.asarray(paths.range_m.min() - np.geomspace(*FIRST_LENGTH_M, N_CLOCKS))


def stop_votes(paths: RangedPaths, clock_m: FloatArray) -> Votes:
    """The votes of a stop at clock biases (clock,) in m."""
    grid = gap_grid()
    one, two = _candidates(paths)
    odds = []
    variance = SPREAD**2 * paths.variance
    turn = wrap_angle(paths.azimuth_rad - paths.boresight_rad)
    angle_variance = np.where(paths.is_cone, np.cos(turn) ** 2, 1.0) * variance[:, 1:3]
    range_variance = variance[one, 0] + variance[two, 0]
    for bias in clock_m:
        length = paths.range_m - bias
        apart = _apart(paths, length, one, two)
        gap = np.sqrt(np.maximum(length[two] ** 2 - length[one] ** 2, 0.0))
        near = (np.abs(apart) < WINDOW_SINE).all(axis=1) & (gap > SMALLEST_GAP_M) & (gap < LARGEST_GAP_M)
        near &= length[one] > 0
        spread = angle_variance[one] + angle_variance[two]
        distance = (apart**2 / spread).sum(axis=1)
        chosen = near & (distance < LARGEST_DISTANCE)
        gap_std = (length[two] / np.maximum(gap, 0.1))[chosen] * np.sqrt(range_variance[chosen])
        gap_std = np.maximum(gap_std, GAP_STEP_M)
        agree = np.exp(-0.5 * distance[chosen]) / (2 * np.pi * np.sqrt(spread[chosen].prod(axis=1)))
        offset = (grid[:, None] - gap[chosen]) / gap_std
        density = agree * np.exp(-0.5 * offset**2) / (np.sqrt(2 * np.pi) * gap_std)
        ratio = density / _chance_density(gap[near], grid)[:, None]
        odds.append(ratio[:, ratio.max(axis=0) > LEAST_ODDS].astype(np.float32))
    return Votes(clock_m, odds)


def _apart(paths: RangedPaths, length_m: FloatArray, one: IntArray, two: IntArray) -> FloatArray:
    """Differences (pair, end) of what versions have in common, in sines of the later path or in rad."""
    sine = np.sin(paths.azimuth_rad - paths.boresight_rad)
    ratio = (length_m[one] / np.maximum(length_m[two], 1e-3))[:, None]
    turn = wrap_angle(paths.azimuth_rad[one] - paths.azimuth_rad[two])
    return np.where(paths.is_cone, sine[one] * ratio - sine[two], turn)


def _chance_density(gap_m: FloatArray, grid: FloatArray) -> FloatArray:
    """Density (gap,) of pairs that agree by chance, per m of gap and per unit of both angles."""
    count = np.bincount(np.rint(gap_m / GAP_STEP_M).astype(int), minlength=len(grid) + 1)[: len(grid)]
    smooth = gaussian_filter1d(count.astype(float), WINDOW_GAP_M / GAP_STEP_M, mode="nearest") / GAP_STEP_M
    floor = max(len(gap_m), 1) / LARGEST_GAP_M / 10
    return np.asarray(np.maximum(smooth, floor) / (2 * WINDOW_SINE) ** 2)


def _candidates(paths: RangedPaths) -> tuple[IntArray, IntArray]:
    """Pairs that may be versions of one plan path: the earlier ones, and the later ones."""
    order = np.argsort(paths.range_m, kind="stable")
    first, second = np.triu_indices(len(paths), 1)
    one, two = order[first], order[second]
    apart = _apart(paths, np.ones(len(paths)), one, two)
    same = ~paths.is_cone | (np.abs(wrap_angle(paths.boresight_rad[one] - paths.boresight_rad[two])) < 1e-6)
    near = ((np.abs(apart) < WIDEST_SINE) & same).all(axis=1)
    return one[near], two[near]


def height_grid(tx_height_m: float | None, rx_height_m: float | None = None) -> FloatArray:
    """Candidates (candidate, 3) of the heights of TX, receiver and ceiling; those of the devices may be given."""
    step = HEIGHT_STEP_M if tx_height_m is not None else COARSE_STEP_M
    rx = np.arange(*RX_HEIGHTS_M, step) if rx_height_m is None else np.array([rx_height_m])
    tx = np.arange(*TX_HEIGHTS_M, step) if tx_height_m is None else np.array([tx_height_m])
    ceiling = np.arange(*CEILINGS_M, step)
    grid = np.stack(np.meshgrid(tx, rx, ceiling, indexing="ij"), axis=-1).reshape(-1, 3)
    return np.asarray(grid[grid[:, :2].max(axis=1) < grid[:, 2] - LEAST_MARGIN_M])


def height_log_prior(heights_m: FloatArray) -> FloatArray:
    """Log prior (candidate,), not normalised, of heights (candidate, 3): receivers are carried by people or carts.

    The height of the receiver is log-normal. Without it floor and ceiling could change places.
    """
    return np.asarray(-0.5 * (np.log(heights_m[:, 1] / RX_MEDIAN_M) / RX_LOG_STD) ** 2)


def starting_heights(votes: Sequence[Votes], clocks: ClockPrior, grid: FloatArray) -> FloatArray:
    """The best local maxima (start, 3) of the coarse search, best first."""
    score = height_log_prior(grid)
    for difference in np.unique(np.round(grid[:, 0] - grid[:, 1], 6)):
        rows = np.flatnonzero(np.abs(grid[:, 0] - grid[:, 1] - difference) < 1e-5)
        score[rows] += _score(votes, clocks(difference), _gaps(grid[rows]))
    starts: list[int] = []
    for index in np.argsort(-score, kind="stable"):
        if all(np.abs(grid[index] - grid[other]).max() > APART_M for other in starts):
            starts.append(int(index))
        if len(starts) == N_STARTS:
            break
    return np.asarray(grid[starts])


def likely_ceilings(votes: Sequence[Votes], heights_m: FloatArray, n_ceilings: int) -> FloatArray:
    """Ceilings (ceiling,) with most votes, where clocks and the heights of the devices, of (3,), are known."""
    ceiling = np.arange(heights_m[:2].max() + LEAST_MARGIN_M, CEILINGS_M[1], CEILING_STEP_M)
    grid = np.stack(np.broadcast_arrays(*heights_m[:2], ceiling), axis=1)
    score = _score(votes, len(votes) * [np.zeros(1)], _gaps(grid))
    return np.asarray(ceiling[peaks_of(score)[:n_ceilings]])


def peaks_of(score: FloatArray) -> IntArray:
    """Indices (peak,) of the local maxima of a score along a grid, the highest first."""
    around = np.pad(score, 1, constant_values=-np.inf)
    peaks = np.flatnonzero((score >= around[:-2]) & (score >= around[2:]))
    return peaks[np.argsort(-score[peaks], kind="stable")]


def _gaps(heights: FloatArray) -> FloatArray:
    """Gaps (candidate, 5) in m between the versions of candidates (candidate, 3)."""
    level, floor, ceiling, one, two = np.square(heights @ HEIGHT_SLOPES.T).T
    pairs = [floor - level, ceiling - level, ceiling - floor, one - level, two - level]
    return np.asarray(np.sqrt(np.abs(np.stack(pairs, axis=1))))


def _score(votes: Sequence[Votes], log_prior: Sequence[FloatArray], gaps: FloatArray) -> FloatArray:
    """Log score (candidate,) of gaps (candidate, kind), clocks marginalised."""
    scores = [_by_clock(stop, gaps) + prior[:, None] for stop, prior in zip(votes, log_prior, strict=True)]
    return np.asarray(np.sum([np.logaddexp.reduce(score, axis=0) for score in scores], axis=0))


def _by_clock(stop: Votes, gaps: FloatArray) -> FloatArray:
    """Log score (clock, candidate) of one stop: a pair is of one of the kinds of gaps, or agrees by chance."""
    cell, usable = _cells(gaps)
    scores = []
    for odds in stop.odds:
        total = np.zeros((len(gaps), odds.shape[1]), np.float32)
        for index in range(cell.shape[1]):
            total += odds[cell[:, index]] * usable[:, index, None]
        scores.append(np.log1p(SHARE / cell.shape[1] * total).sum(axis=1))
    return np.asarray(scores, float)


def _cells(gaps: FloatArray) -> tuple[IntArray, BoolArray]:
    """Cells (candidate, kind) of gaps, and which of them are inside the grid."""
    cell = np.rint(gaps / GAP_STEP_M).astype(int)
    usable = (gaps > SMALLEST_GAP_M) & (cell < len(gap_grid()))
    return np.where(usable, cell, 0), usable


def log_votes(votes: Sequence[Votes], clocks: ClockPrior, heights_m: FloatArray) -> float:
    """Log score of heights (3,), clocks marginalised."""
    return float(_score(votes, clocks(float(heights_m[0] - heights_m[1])), _gaps(heights_m[None]))[0])


def starting_clocks(
    votes: Sequence[Votes], clocks: ClockPrior, heights_m: FloatArray, n_clocks: int
) -> list[FloatArray]:
    """The clock biases (start,) in m of largest posterior of every stop at given heights (3,): local maxima."""
    gaps, priors = _gaps(heights_m[None]), clocks(float(heights_m[0] - heights_m[1]))
    best = []
    for stop, prior in zip(votes, priors, strict=True):
        best.append(stop.clock_m[peaks_of(_by_clock(stop, gaps)[:, 0] + prior)[:n_clocks]])
    return best
