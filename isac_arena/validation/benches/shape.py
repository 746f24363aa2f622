"""`arena bench shape`: the radial Gaussian process beside scikit-learn, and the fits by the reflection law.

All times are processor time of one thread.
"""

import warnings
from collections.abc import Callable, Sequence
from functools import partial

import numpy as np
from sklearn.exceptions import ConvergenceWarning
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import ConstantKernel, ExpSineSquared, WhiteKernel

from estimation.execution import one_blas_thread
from estimation.shape.config import ReflectionConfig
from estimation.shape.gp.radial import fit_radial_gp, fit_radial_gps
from estimation.shape.kinds.fit import fit_kind
from estimation.shape.reflection.bundle import fit_bundle
from estimation.shape.reflection.reflections import Reflections
from isac_arena.validation.benches.plain_reflections import (
    Evaluation,
    circle_terms,
    evaluated,
    los_terms,
    wall_terms,
)
from isac_arena.validation.benches.timing import on_each, paired_ratios, spread_of, times_in_turns
from isac_arena.validation.measurement import Measurement, at_least, at_most
from isac_arena.validation.scenarios.reflections import Errors
from isac_arena.validation.shape.gp_study import SHAPES, draw_points
from isac_arena.validation.shape.reflection import OFFSET_ERRORS, made_campaign, made_pillar, made_wall
from scenes.record import FloatArray

N_REPEATS = 7  # of the fits by the reflection law
N_EVALUATIONS = 100
Pair = tuple[Callable[[], object], Callable[[], object]]


def bench_radial_gp(seed: int, quick: bool) -> list[Measurement]:
    """Our fit with three starts over scikit-learn's with one start, on the same points; the slowest of the shapes.

    scikit-learn takes the cube of the number of points. So the fits of every number are held against one of its
    fits, of the star with 1,024 points (256 in the quick run).
    """
    rng = np.random.default_rng(seed)
    most, bar = (256, 1 / 5) if quick else (1024, 1 / 200)
    counts = (64, 256, 4096) if quick else (16, 64, 128, 256, 1024, 4096)
    drawn = {(n, shape): draw_points(shape, n, rng) for n in counts for shape in SHAPES}
    works = [_fit(*points) for points in drawn.values()]
    works.append(partial(_scikit_learn, *drawn[most, "star"]))
    with one_blas_thread():
        few = [
            paired_ratios(_fit(*drawn[64, shape]), partial(_scikit_learn, *drawn[64, shape]), 5 if quick else 25)
            for shape in SHAPES
        ]
        times_s = times_in_turns(works, 3 if quick else 7)
    all_ratios = times_s[:, :-1] / times_s[:, -1:]
    slowest = int(np.argmax(np.median(all_ratios, axis=0)))
    found = {  # each the ratios and the times of both
        ("points64.over_scikit_learn", 1 / 3): max(few, key=lambda pair: float(np.median(pair[0]))),
        (f"points{most}.over_scikit_learn", bar): _columns(times_s, list(drawn).index((most, "star"))),
        (f"any_points.over_scikit_learn_{most}", bar): _columns(times_s, slowest),
    }
    about = {"any_points": f"M = {counts}, slowest {list(drawn)[slowest]}; "}
    return [
        at_most(f"gp.{key}", np.median(pair[0]), bar, about.get(key.split(".")[0], "") + _told(*pair))
        for (key, bar), pair in found.items()
    ]


def bench_batched_gp(seed: int, quick: bool) -> list[Measurement]:
    """256 clusters of 16 points in one call, beside scikit-learn's fits of the same and ours one by one."""
    rng = np.random.default_rng(seed)
    n_clusters, rounds = (64, 3) if quick else (256, 7)
    shapes = list(SHAPES)
    clusters = [draw_points(shapes[k % len(shapes)], 16, rng) for k in range(n_clusters)]
    works = (
        lambda: fit_radial_gps(clusters),
        on_each(lambda cluster: fit_radial_gp(*cluster), clusters),
        on_each(lambda cluster: _scikit_learn(*cluster), clusters),
    )
    with one_blas_thread():
        times_s = times_in_turns(works, rounds) / n_clusters
    alone, theirs = times_s[:, 1] / times_s[:, 0], times_s[:, 0] / times_s[:, 2]
    about = f"M = 16, {n_clusters} clusters, three starts; "
    over_theirs = about + _told(theirs, times_s[:, [0, 2]])
    over_alone = about + _told(alone, times_s[:, 1::-1])
    return [
        at_most("gp.batched16.over_scikit_learn", np.median(theirs), 1 / 8, over_theirs),
        at_least("gp.batch_over_one_by_one", np.median(alone), 1.0, over_alone),
    ]


def bench_likelihood(seed: int, quick: bool) -> list[Measurement]:
    """That the timed fits end at the same optimum: with the same kernel ours is as likely as scikit-learn's.

    scikit-learn has no unknown mean: it is given the mean of the radii.
    """
    n = 256 if quick else 1024
    angle, radius = draw_points("star", n, np.random.default_rng(seed))
    gain = fit_radial_gp(angle, radius).log_likelihood - _scikit_learn(angle, radius)
    return [at_least("gp.likelihood_over_scikit_learn_nat", gain, -1e-3, f"M = {n}", "nat")]


def bench_reflection_fits(seed: int, quick: bool) -> list[Measurement]:
    """Fits with all starts over the residuals and Jacobians of their paths, evaluated 100 times in numpy.

    Random objects at 45 stops, offsets unknown, at 1 ns and 1 deg: a circle, a wall, and three pillars at once.
    """
    n = 5 if quick else 40
    pillars = [made_pillar(np.random.default_rng([seed, k]), OFFSET_ERRORS) for k in range(n)]
    walls = [made_wall(np.random.default_rng([seed, k]), Errors()) for k in range(n)]
    rows = [
        _over_evaluations("circle", _own_fits("circle", circle_terms, pillars), "all starts"),
        _over_evaluations("wall", _own_fits("wall", wall_terms, walls), "all starts"),
    ]
    return [*rows, _over_evaluations("bundle", _bundles(seed, 2 if quick else 8), "3 pillars with their own fits")]


def _own_fits(kind: str, terms: Evaluation, drawn: Sequence[Reflections]) -> list[Pair]:
    """Fits of one kind, each beside its evaluations at the solution."""
    pairs: list[Pair] = []
    for data in drawn:
        fit = partial(fit_kind, data, kind, ReflectionConfig())
        pairs.append((fit, partial(evaluated, [(terms, data, fit().parameter)], N_EVALUATIONS)))
    return pairs


def _bundles(seed: int, n: int) -> list[Pair]:
    """Bundles of three pillars, each beside its evaluations at the solution."""
    pairs: list[Pair] = []
    for k in range(n):
        objects, los = made_campaign(np.random.default_rng([seed, k]))
        fit = partial(fit_bundle, objects, los, ReflectionConfig())
        found = zip(objects, fit().shapes, strict=True)
        parts = [(circle_terms, each.paths, shape.parameter) for each, shape in found]
        pairs.append((fit, partial(evaluated, [*parts, (los_terms, los, np.empty(0))], N_EVALUATIONS)))
    return pairs


def _over_evaluations(name: str, pairs: Sequence[Pair], reason: str) -> Measurement:
    """The median ratio of fits to the evaluations beside them, each the median of its own pairs."""
    found = [paired_ratios(*pair, N_REPEATS) for pair in pairs]
    ratios = [float(np.median(ratio)) for ratio, _ in found]
    fit_ms, beside_ms = 1e3 * np.median([np.median(times, axis=0) for _, times in found], axis=0)
    low, high = np.quantile(ratios, (0.25, 0.75))
    about = f"{reason}; quartiles {low:.2f} and {high:.2f}; {fit_ms:.2f} ms over {beside_ms:.2f} ms"
    return at_most(f"reflection.{name}.over_100_evaluations", np.median(ratios), 1.0, about)


def _columns(times_s: FloatArray, column: int) -> tuple[FloatArray, FloatArray]:
    """Ratios and times of one work and of the last one."""
    both = times_s[:, [column, -1]]
    return both[:, 0] / both[:, 1], both


def _told(ratios: FloatArray, times_s: FloatArray) -> str:
    ours_ms, beside_ms = 1e3 * np.median(times_s, axis=0)
    return f"{ours_ms:.2f} ms over {beside_ms:.2f} ms; {spread_of(ratios)}"


def _fit(angle_rad: FloatArray, radius_m: FloatArray) -> Callable[[], object]:
    return lambda: fit_radial_gp(angle_rad, radius_m)


def _scikit_learn(angle_rad: FloatArray, radius_m: FloatArray) -> float:
    """Log marginal likelihood at scikit-learn's optimum, from where our first start begins."""
    spread = float(np.var(radius_m))
    kernel = ConstantKernel(spread, (1e-8, 1e3)) * ExpSineSquared(
        0.6, 2 * np.pi, length_scale_bounds=(0.05, 20.0), periodicity_bounds="fixed"
    ) + WhiteKernel(0.01, (1e-6, 1e2))
    with one_blas_thread(), warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)
        model = GaussianProcessRegressor(kernel).fit(angle_rad[:, None], radius_m - radius_m.mean())
    return float(model.log_marginal_likelihood_value_)
