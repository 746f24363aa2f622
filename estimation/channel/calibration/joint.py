"""Factors of both arrays from all strong paths of several stops, by damped Gauss-Newton steps.

Every stop brings the normal equations of its paths and of the factors (`normal.py`). The paths are eliminated stop
by stop, and the factors are solved for together (Levenberg-Marquardt). A stop holds more than its strong paths:
its cost per degree of freedom is the scale of its noise.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from estimation.channel.calibration.ends import End, designed_factors
from estimation.channel.calibration.normal import NormalEquations, StopModel, StopSamples, normal_equations
from scenes.record import ComplexArray, FloatArray
from sim.signal.arrays.codebook import Codebook

FIRST_DAMPING, LARGEST_DAMPING = 1e-3, 1e6  # relative to the diagonal
HARDER, EASIER = 10.0, 0.1  # damping after a step that fails, and after one that holds
CONVERGED = 1e-3  # relative fall of the cost
COUPLING_STD = 0.1  # of the coupling of elements: -20 dB


@dataclass(frozen=True)
class JointFactors:
    """Factors (factor,) of both arrays, as `designed_factors` orders them.

    `gain` is by how much they and the paths lower the cost of the start, over its scale: without errors of
    elements it is half a chi-square with at most `n_parameters` degrees of freedom. `misfit` is the share of the
    energy of the samples that they leave beyond the noise.
    """

    tx: ComplexArray
    rx: ComplexArray
    gain: float
    misfit: float
    n_parameters: int


def joint_factors(
    stops: Sequence[StopSamples],
    models: Sequence[StopModel],
    books: tuple[Codebook, Codebook],
    prior_std: float,
    turns: int,
) -> JointFactors:
    """The factors of both arrays (books of TX and RX) from stops with their paths.

    Elements are 1 to `prior_std`, and couple by no more than `COUPLING_STD`.
    """
    designed = [designed_factors(book) for book in books]
    spread = np.where(np.concatenate(designed) == 1, prior_std, COUPLING_STD)
    fit = _Fit(designed[0], designed[1], tuple(models), np.concatenate(designed), spread)
    costs = first = fit.costs(stops, books)
    freedom = np.array(
        [stop.sample.size - model.n_parameters / 2 for stop, model in zip(stops, models, strict=True)]
    )
    damping = FIRST_DAMPING
    for _ in range(turns):
        scale = np.maximum(1.0, costs / freedom)
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
    energy = sum(float((stop.weight * np.square(np.abs(stop.sample)).sum(axis=2)).sum()) for stop in stops)
    scale = np.maximum(1.0, costs / freedom)
    return JointFactors(
        tx=fit.tx,
        rx=fit.rx,
        gain=float(((first - costs) / scale).sum()),
        misfit=max(0.0, float((costs - freedom).sum()) / energy),
        n_parameters=2 * len(fit.designed) + sum(model.n_parameters for model in models),
    )


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
