"""Factors of both arrays from all strong paths of several stops, by damped Gauss-Newton steps.

Every stop brings the normal equations of its paths and of the factors (`normal.py`). The paths are eliminated stop
by stop, and the factors are solved for together (Levenberg-Marquardt).

A stop holds more than its strong paths. What they leave is no white noise but the sum of a few other paths, so
many samples err alike: the prior must count against as many errors as are independent (`independent_errors`). In
rooms these are a few hundred of a hundred thousand samples.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from estimation.channel.calibration.ends import End, coupling_levels, designed_factors
from estimation.channel.calibration.normal import NormalEquations, StopModel, StopSamples, normal_equations
from scenes.record import ComplexArray, FloatArray
from sim.signal.arrays.codebook import Codebook

FIRST_DAMPING, LARGEST_DAMPING = 1e-3, 1e6  # relative to the diagonal
HARDER, EASIER = 10.0, 0.1  # damping after a step that fails, and after one that holds
CONVERGED = 1e-3  # relative fall of the cost
COUPLING_STD = 0.1  # of the coupling of neighbours: -20 dB


@dataclass(frozen=True)
class JointFactors:
    """Factors (factor,) of both arrays, as `designed_factors` orders them.

    `gain` is by how much they lower the cost of the designed arrays, over its scale: without errors of elements it
    is half a chi-square with one degree of freedom per real parameter. `misfit` is the share of the energy of the
    samples that they leave beyond the noise.
    """

    tx: ComplexArray
    rx: ComplexArray
    gain: float
    misfit: float

    @property
    def n_parameters(self) -> int:
        """Number of real parameters."""
        return 2 * (len(self.tx) + len(self.rx))


def joint_factors(
    stops: Sequence[StopSamples],
    models: Sequence[StopModel],
    books: tuple[Codebook, Codebook],
    prior_std: float,
    turns: int,
) -> JointFactors:
    """The factors of both arrays (books of TX and RX) from stops with their paths.

    Elements are 1 to `prior_std`, and neighbours couple by no more than `COUPLING_STD`.
    """
    designed = [designed_factors(book) for book in books]
    spread = np.concatenate([_prior_spread(book, prior_std) for book in books])
    fit = _Fit(designed[0], designed[1], tuple(models), np.concatenate(designed), spread)
    costs = first = fit.costs(stops, books)
    damping = FIRST_DAMPING
    for _ in range(turns):
        scale = fit.scales(stops, books, costs)
        before = (costs / scale).sum() + fit.prior()
        equations = fit.equations(stops, books)
        found = None
        while found is None and damping <= LARGEST_DAMPING:
            tried = fit.stepped(equations, scale, damping)
            costs = tried.costs(stops, books)
            after = (costs / scale).sum() + tried.prior()
            found, damping = (tried, damping * EASIER) if after < before else (None, damping * HARDER)
        if found is None:
            costs = fit.costs(stops, books)
            break
        fit = found
        if before - after < CONVERGED * before:
            break
    gain = float(((first - costs) / fit.scales(stops, books, costs)).sum())
    energy = sum(float((stop.weight * np.square(np.abs(stop.sample)).sum(axis=2)).sum()) for stop in stops)
    beyond = float(costs.sum()) - sum(stop.sample.size for stop in stops)
    return JointFactors(fit.tx, fit.rx, gain, max(0.0, beyond / energy))


def independent_errors(left: ComplexArray) -> float:
    """Number of independent errors in what is left of samples (tx_beam, rx_beam, rank).

    For a covariance that is a product over the three axes it is the product of their participation ratios: the
    square of the trace of a covariance over the trace of its square (Satterthwaite, 1946). For white noise that is
    the number of samples.
    """
    if not left.any():
        return float(left.size)
    ratios = []
    for axis in range(3):
        rows = np.moveaxis(left, axis, 0).reshape(left.shape[axis], -1)
        covariance = rows @ rows.conj().T
        ratios.append(np.trace(covariance).real ** 2 / np.square(np.abs(covariance)).sum())
    return float(np.prod(ratios))


def _prior_spread(book: Codebook, prior_std: float) -> FloatArray:
    """Prior deviation (factor,) of the factors of a device from the designed ones."""
    return np.append(np.full(book.size("element"), prior_std), COUPLING_STD * coupling_levels(book))


@dataclass(frozen=True)
class _Fit:
    """Element factors of both ends, and a model of every stop."""

    tx: ComplexArray
    rx: ComplexArray
    models: tuple[StopModel, ...]
    designed: ComplexArray  # (factor,) of both ends
    spread: FloatArray  # (factor,) prior deviation of each from it

    def prior(self) -> float:
        """The cost of the factors."""
        return float(np.square(np.abs(np.concatenate([self.tx, self.rx]) - self.designed) / self.spread).sum())

    def ends(self, stop: int, books: tuple[Codebook, Codebook]) -> tuple[End, End]:
        """Both ends towards the paths of a stop."""
        model = self.models[stop]
        return End.towards(books[0], self.tx, model.aod_rad), End.towards(books[1], self.rx, model.aoa_rad)

    def costs(self, stops: Sequence[StopSamples], books: tuple[Codebook, Codebook]) -> FloatArray:
        """Cost (stop,) of every stop."""
        return np.array([self.models[k].cost(stop, *self.ends(k, books)) for k, stop in enumerate(stops)])

    def scales(
        self, stops: Sequence[StopSamples], books: tuple[Codebook, Codebook], costs: FloatArray
    ) -> FloatArray:
        """Noise power (stop,) per independent error of every stop of these `costs` (stop,), at least 1."""
        left = (self.models[k].residual(stop, *self.ends(k, books))[0] for k, stop in enumerate(stops))
        weighted = (rest * np.sqrt(stop.weight)[..., None] for rest, stop in zip(left, stops, strict=True))
        return np.maximum(1.0, costs / [independent_errors(rest) for rest in weighted])

    def equations(self, stops: Sequence[StopSamples], books: tuple[Codebook, Codebook]) -> list[NormalEquations]:
        """The normal equations of every stop."""
        return [normal_equations(stop, self.models[k], *self.ends(k, books)) for k, stop in enumerate(stops)]

    def stepped(self, equations: Sequence[NormalEquations], scale: FloatArray, damping: float) -> Self:
        """The fit after a damped step; `scale` (stop,) is of the noise."""
        factors = np.concatenate([self.tx, self.rx])
        away = np.concatenate([(factors - self.designed).real, factors.imag])
        information = np.tile(1 / self.spread**2, 2)
        matrix, gradient = np.diag(information), -information * away
        for one, factor in zip(equations, scale, strict=True):
            own, slope = one.of_elements(damping)
            matrix, gradient = matrix + own / factor, gradient + slope / factor
        step = np.asarray(np.linalg.solve(matrix + damping * np.diag(np.diag(matrix)), gradient), float)
        models = []
        for one, model in zip(equations, self.models, strict=True):
            paths, phases = one.following(damping, step)
            models.append(model.moved(paths.reshape(len(model.gain), -1), phases))
        moved = factors + step[: len(factors)] + 1j * step[len(factors) :]
        return replace(self, tx=moved[: len(self.tx)], rx=moved[len(self.tx) :], models=tuple(models))
