"""From candidates to paths: joint fits, tests, and a search of the residual, until no path is added."""

from dataclasses import dataclass, field, replace

import numpy as np

from estimation.channel.config import MaximumLikelihoodConfig
from estimation.channel.incoherent.background import Background
from estimation.channel.incoherent.clock_drift import DRIFTING, ClockDrift, clock_drift, mean_pairs, without_drift
from estimation.channel.incoherent.likelihood import (
    MOST_STEPS,
    LinkBeams,
    LocalSamples,
    Score,
    correlated_paths,
    likelihood_without,
    local_samples,
    maximise_likelihood,
)
from estimation.channel.incoherent.proposal import starting_points
from estimation.channel.incoherent.response_errors import ResponseErrors, response_errors
from estimation.channel.incoherent.screen import Candidates, Screen
from estimation.channel.incoherent.second_path import second_path_start
from estimation.channel.incoherent.spectrum import DelaySpectrum, delay_spectrum, delay_waves, window_bins
from estimation.channel.incoherent.threshold import DetectionLevels
from estimation.channel.model.crb import path_covariance
from scenes.record import ComplexArray, FloatArray, IntArray
from sim.observation import BeamSweep

_LIT = 0.02  # least SNR of a beam pair that takes part in a fit
_ROUNDS = 30
_IN_VAIN = 2  # rounds without a better set of paths: the same places come and go
_ROUND_STEPS = 6  # of the fit of many paths: undetected paths would bias further steps
_PATH_STEPS = 400  # over the number of paths, if that is more
_REFIT_STEPS = 2  # of the next fit, without redundant paths
_COUPLED = 0.03  # least correlation with a path that can replace another one
_REBUILDS = 6  # of the compressed samples, if delays move out of reach
_VISIBLE = 0.9  # least level of a path at the threshold, over the root of its likelihood ratio
_PROMISING = 0.55  # of the threshold: least likelihood ratio on the grid of a candidate that is fitted
_SURE = 1.5  # of the threshold: above it a candidate enters the joint fit at once
_NEARLY = 0.7  # below, it enters if it reaches this share of the threshold when fitted alone
_ALONE_BINS = 12  # of delay to either side in that fit
_SAFE = 4.0  # of the threshold: Wald statistic above which no likelihood ratio is computed
_SAME_DRIFT = 0.1  # standard deviations by which a drift may differ from the one that is removed
_SAME_CELLS = 0.8  # a candidate this near to a failed one is not tried again


@dataclass
class IncoherentSearch:
    """The search for the paths of one stop. Paths are (path, parameter) as in `likelihood.py`."""

    sweep: BeamSweep
    spectrum: DelaySpectrum  # of the sweep without the drift of the clock
    ends: LinkBeams
    screen: Screen
    levels: DetectionLevels
    config: MaximumLikelihoodConfig
    local: LocalSamples = field(init=False)
    bins: IntArray = field(init=False)  # of the window in which the current paths are fitted
    window: ComplexArray = field(init=False)
    pairs: IntArray = field(init=False)  # that the current paths illuminate
    background: Background | None = None  # in the residual of the last round
    errors: ResponseErrors = ResponseErrors()  # of the last round that showed them
    drift: ClockDrift = ClockDrift()
    drift_odds: float = DRIFTING  # before the samples
    failed: list[FloatArray] = field(default_factory=list)  # delays and angles

    @property
    def drift_s(self) -> float:
        """Growth of all delays from one beam pair to the next, which the spectrum is free of."""
        return self.drift.per_pair * self.spectrum.bin_s

    @property
    def _state(self) -> tuple[LocalSamples, IntArray, ComplexArray, IntArray]:
        """The samples on which the current paths are fitted."""
        return self.local, self.bins, self.window, self.pairs

    @_state.setter
    def _state(self, state: tuple[LocalSamples, IntArray, ComplexArray, IntArray]) -> None:
        self.local, self.bins, self.window, self.pairs = state

    def run(self) -> tuple[FloatArray, Score | None]:
        """Paths and the likelihood at its maximum; None if there are none."""
        paths, at = np.zeros((0, self.ends.n_parameters)), None
        new = self._first_starts()[: self.config.max_incoherent_paths]
        best, most, n_vain = paths, -np.inf, 0
        for n_rounds in range(_ROUNDS):
            if len(new):
                paths = np.concatenate([paths, new])
                paths, at = self._fitted(paths, self._round_steps(paths))
            if at is None:
                return paths, None
            if n_rounds == 0:
                paths, at = self._without_drift(paths, at)
            paths, at, residual = self._standing_out(paths, at)
            if at is None:
                return paths, None
            worth = at.value - self.levels.lowest * len(paths)
            n_vain = 0 if worth > most + self.levels.lowest else n_vain + 1
            best, most = (paths, worth) if n_vain == 0 else (best, most)
            room = self.config.max_incoherent_paths - len(paths) if n_vain < _IN_VAIN else 0
            new = self._further_starts(paths, at, residual)[:room] if room else paths[:0]
            if len(new):
                continue
            if n_vain >= _IN_VAIN:
                paths, at = self._fitted(best, self._round_steps(best))
            paths, at = self._converged(*self._without_drift(paths, at))
            n_paths = len(paths)
            if at is not None and room:
                paths, at = self._with_second_path(paths, at)
            if len(paths) == n_paths:
                return paths, at
        return self._converged(paths, at)

    def _round_steps(self, paths: FloatArray) -> int:
        return max(_ROUND_STEPS, min(MOST_STEPS, _PATH_STEPS // len(paths)))

    def _without_drift(self, paths: FloatArray, at: Score) -> tuple[FloatArray, Score]:
        """Paths fitted to the samples without the drift of the clock that the residual shows."""
        before, n_bins = self.drift, self.spectrum.n_bins
        residual = self._residual(paths, at)
        phasor = self._phasor(at)
        self.drift = clock_drift(self.ends, paths, phasor, residual, self.bins, n_bins, before, self.drift_odds)
        further = self.drift.per_pair - before.per_pair
        if abs(further) <= _SAME_DRIFT * np.sqrt(self.drift.variance):
            self.drift = replace(self.drift, per_pair=before.per_pair)
            return paths, at
        self.spectrum = delay_spectrum(without_drift(self.sweep, self.drift_s))
        paths = paths.copy()
        paths[:, 0] -= further * mean_pairs(self.ends, paths)
        return self._fitted(paths, self._round_steps(paths))

    def _first_starts(self) -> FloatArray:
        """Starting points of paths from the unchanged samples."""
        spectrum, n_bins = self.spectrum, self.spectrum.n_bins
        level, place = self.screen.all_levels(spectrum)
        first = -(n_bins // 8)  # a clock bias can make the first delay negative
        delay_bins = (np.arange(2 * n_bins) / 2 - first) % n_bins + first
        candidates = self._candidates(level, place, delay_bins)
        low = np.floor(candidates.delay_bins).astype(int)
        half = candidates.delay_bins > low
        matched = spectrum.window(low)
        matched[:, half] = (matched[:, half] + spectrum.window(low[half] + 1)) * np.float32(np.sqrt(0.5))
        starts, ratio = starting_points(
            self.screen, self.ends, candidates, matched, np.zeros(len(matched), complex), n_bins
        )
        if not len(starts):
            return starts
        limit = self.levels.first(starts[:, 0])
        strongest = int(np.argmax(ratio))
        if ratio[strongest] > limit[strongest]:
            limit = self._thresholds(starts, strongest)
        self.bins = window_bins(starts[ratio > _PROMISING * limit, 0], n_bins)
        return self._promising(candidates, starts, ratio, limit, spectrum.window(self.bins))

    def _further_starts(self, paths: FloatArray, at: Score, residual: ComplexArray) -> FloatArray:
        """Starting points of more paths from the residual (pair, bin) of the fitted ones."""
        n_bins = self.spectrum.n_bins
        phasor = self._phasor(at)
        candidates = self._candidates_within(residual)
        waves, _ = delay_waves(self.bins, candidates.delay_bins, n_bins)
        matched = residual @ (waves / np.sqrt(n_bins)).astype(np.complex64)
        starts, ratio = starting_points(self.screen, self.ends, candidates, matched, phasor, n_bins)
        limit = self._thresholds(np.concatenate([paths, starts]), self._strongest(paths))[len(paths) :]
        for failed in self.failed:
            ratio[self.ends.distance_cells(starts, failed) < _SAME_CELLS] = 0.0
        return self._promising(candidates, starts, ratio, limit, residual)

    def _standing_out(self, paths: FloatArray, at: Score) -> tuple[FloatArray, Score | None, ComplexArray]:
        """Paths that are significant above the background, and their residual (pair, bin)."""
        residual, n_paths = self._residual(paths, at), len(paths)
        n_bins = self.spectrum.n_bins
        shown = response_errors(self.ends, paths, self._phasor(at), residual, self.bins, n_bins, self.errors)
        self.errors = shown.at_most(self.config.max_element_error)
        self.background = Background.of(residual, self.bins, n_bins, self.errors)
        needed, then = self._needed(paths, at, _REFIT_STEPS)
        return (needed, then, residual if then is None or len(needed) == n_paths else self._residual(needed, then))

    def _residual(self, paths: FloatArray, at: Score) -> ComplexArray:
        """Residual (pair, bin) of the samples around the paths."""
        waves, _ = delay_waves(self.bins, paths[:, 0], self.spectrum.n_bins)
        signal = (self.ends.amplitudes(paths) * self._phasor(at)[:, None]).astype(np.complex64)
        return np.asarray(self.window - signal @ waves.T.astype(np.complex64))

    def _phasor(self, at: Score) -> ComplexArray:
        """Phase (pair,) of every pair as far as the fitted paths determine it, else 0."""
        phasor = np.zeros(len(self.window), complex)
        phasor[self.pairs] = at.pair_phasor
        return phasor

    def _with_second_path(self, paths: FloatArray, at: Score) -> tuple[FloatArray, Score]:
        """Paths with a hidden second path, if that increases the likelihood by the threshold."""
        start = second_path_start(self.local, self.ends, paths, at, _NEARLY * self.levels.lowest)
        if start is None:
            return paths, at
        fitted = self._state
        more, then = self._fitted(np.concatenate([paths, start]), MOST_STEPS)
        limit = self._thresholds(more, self._strongest(more))[-1]
        if then.value - at.value > limit and self.ends.in_sight(more).all():
            return more, then
        self._state = fitted
        return paths, at

    def _promising(
        self,
        candidates: Candidates,
        starts: FloatArray,
        ratio: FloatArray,
        limit: FloatArray,
        window: ComplexArray,
    ) -> FloatArray:
        """Starting points well above the threshold, or near it when fitted alone to the `window`.

        Where other directions have the same magnitudes, the one that explains most when fitted alone.
        """
        kept = ratio > _SURE * limit
        for i in np.flatnonzero(ratio > _PROMISING * limit):
            places = self.screen.twins(candidates.tx_direction[i], candidates.rx_direction[i])
            if kept[i] and len(places) == 1:
                continue
            near = np.abs(self.bins - starts[i, 0]) < _ALONE_BINS
            tried = np.repeat(starts[[i]], len(places), axis=0)
            tried[:, 1:-2] = places
            fits = [self._alone(one[None], window[:, near], self.bins[near]) for one in tried]
            seen = [value if self.ends.in_sight(path)[0] else -np.inf for path, value in fits]
            best = int(np.argmax(seen))
            starts[[i]], alone = fits[best]
            kept[i] |= alone > _NEARLY * limit[i]
        return starts[kept]

    def _alone(self, path: FloatArray, window: ComplexArray, bins: IntArray) -> tuple[FloatArray, float]:
        """One path at the maximum of its own likelihood, and the log-likelihood there."""
        local = local_samples(self.spectrum, window, bins, self._lit_pairs(path), path[:, 0])
        path, at, _ = maximise_likelihood(local, self.ends, path)
        return path, at.value

    def _lit_pairs(self, paths: FloatArray) -> IntArray:
        snr = (np.abs(self.ends.amplitudes(paths)) ** 2).sum(axis=1) * self.spectrum.n_bins
        return np.flatnonzero(snr > _LIT)

    def _candidates(self, level: FloatArray, place: IntArray, delay_bins: FloatArray) -> Candidates:
        lowest = _VISIBLE * np.sqrt(self.levels.lowest)
        return self.screen.candidates(level, place, delay_bins, float(lowest), self.config.max_incoherent_paths)

    def _candidates_within(self, residual: ComplexArray) -> Candidates:
        """Candidates in samples (pair, bin) of unit noise at the bins of the window, which may have gaps."""
        ends = self.ends
        cuts = np.flatnonzero(np.diff(self.bins) > 1) + 1
        parts = [
            (bins[0] + np.arange(2 * len(bins) - 2) / 2, *self.screen.levels(part, np.ones(ends.rx.n_beams), 1.0))
            for bins, part in zip(
                np.split(self.bins, cuts),
                np.split(residual.reshape(ends.tx.n_beams, ends.rx.n_beams, -1), cuts, axis=2),
                strict=True,
            )
        ]
        delay_bins, level, place = (np.concatenate(part) for part in zip(*parts, strict=True))
        return self._candidates(level, place, delay_bins)

    def _fitted(self, paths: FloatArray, most_steps: int) -> tuple[FloatArray, Score]:
        """Paths near the maximum of their joint likelihood, and the samples of that fit."""
        for _ in range(_REBUILDS):
            self.bins = window_bins(paths[:, 0], self.spectrum.n_bins)
            self.window = self.spectrum.window(self.bins)
            self.pairs = self._lit_pairs(paths)
            self.local = local_samples(self.spectrum, self.window, self.bins, self.pairs, paths[:, 0])
            paths, at, is_near = maximise_likelihood(self.local, self.ends, paths, most_steps)
            if is_near:
                break
        return paths, at

    def _converged(self, paths: FloatArray, at: Score | None) -> tuple[FloatArray, Score | None]:
        """The significant paths after convergence."""
        if at is None:
            return paths, at
        paths, at, is_near = maximise_likelihood(self.local, self.ends, paths)
        if not is_near:
            paths, at = self._fitted(paths, MOST_STEPS)
        return self._needed(paths, at, MOST_STEPS)

    def _needed(self, paths: FloatArray, at: Score, most_steps: int) -> tuple[FloatArray, Score | None]:
        """Significant paths, fitted again without the others.

        A path is removed at once if the likelihood without it, all others fixed, is too near. If others could
        replace it, according to Wald's test, those are fitted again without it, and that likelihood decides.
        """
        tested = np.zeros(len(paths), bool)
        while True:
            limit = self._thresholds(paths, self._strongest(paths))
            wald = self._wald(paths, at)
            failing = (self._ratios(paths, at, wald, limit) < limit) | ~self.ends.in_sight(paths)
            if failing.any():
                self.failed += list(paths[failing, :-2])
                paths, tested = paths[~failing], tested[~failing]
                if not len(paths):
                    return paths, None
                paths, at = self._fitted(paths, most_steps)
                continue
            doubtful = np.flatnonzero((wald < limit) & ~tested)
            if not len(doubtful) or len(paths) == 1:
                return paths, at
            worst = int(doubtful[np.argmin(wald[doubtful])])
            without, value = self._without(paths, at, worst)
            if at.value - value > limit[worst]:
                tested[worst] = True
            else:
                self.failed.append(paths[worst, :-2])
                tested = np.delete(tested, worst)
                paths, at = self._fitted(without, most_steps)

    def _without(self, paths: FloatArray, at: Score, path: int) -> tuple[FloatArray, float]:
        """Paths without one, those that can replace it fitted again, and the likelihood."""
        near = correlated_paths(at, len(paths), path, _COUPLED)
        rest = np.delete(paths, path, axis=0)
        if not near.any():
            return rest, float(likelihood_without(self.local, self.ends, paths, np.array([path]))[0])
        near = np.delete(near, path)
        rest[near], then, _ = maximise_likelihood(
            self.local.with_fixed(self.ends, rest[~near], rest[near, 0]), self.ends, rest[near]
        )
        return rest, then.value

    def _wald(self, paths: FloatArray, at: Score) -> FloatArray:
        """Wald's statistic (path,) of every path: half the inverse variance of its log amplitude."""
        n, size = paths.shape
        covariance = path_covariance(at.information.reshape(n, size, n, size))
        return np.asarray(0.5 / np.einsum("iaia->ia", covariance)[:, -2])

    def _ratios(self, paths: FloatArray, at: Score, wald: FloatArray, limit: FloatArray) -> FloatArray:
        """Log-likelihood ratio (path,) to the other paths fixed; Wald's statistic if that is safe."""
        ratio, doubtful = wald.copy(), np.flatnonzero(wald < _SAFE * limit)
        ratio[doubtful] = at.value - likelihood_without(self.local, self.ends, paths, doubtful)
        return ratio

    def _thresholds(self, paths: FloatArray, strongest: int) -> FloatArray:
        """Likelihood ratio (path,) that paths need: the strongest anywhere, the others with its delay known.

        It increases with the share of a path in beam pairs of known phase, and with the background.
        """
        known = self.ends.known_phase_shares(paths, self.spectrum.n_bins)
        limit = self.levels.further(paths[:, 0], float(paths[strongest, 0]), known)
        limit[strongest] = self.levels.first(paths[strongest, :1])[0]
        return limit if self.background is None else limit * self.background.noise_factor(self.ends, paths)

    def _strongest(self, paths: FloatArray) -> int:
        return int(np.argmax(self.ends.energies(paths)))
