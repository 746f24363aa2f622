"""`arena validate shape`: the radial Gaussian process on full contours against the published table and itself."""

from collections.abc import Callable, Mapping

import numpy as np

from estimation.shape.gp.exact import ExactPosterior, Likelihood, log_marginal_likelihood
from estimation.shape.gp.fourier import FourierPosterior, log_marginal_likelihood_fourier
from estimation.shape.gp.radial import RadialData
from isac_arena.validation.measurement import Measurement, at_least, at_most
from isac_arena.validation.monte_carlo import quick_bar
from isac_arena.validation.shape.gp_study import SHAPES, draw_points, run_cell
from scenes.record import FloatArray

TABLE_N_POINTS = (16, 32, 64, 128)
# RMSE in m at the training angles in paper mode, 1,000 runs of an independent prototype.
PAPER_RMSE_M: Mapping[str, tuple[float, ...]] = {
    "circle": (0.025, 0.017, 0.011, 0.008),
    "ellipse": (0.075, 0.055, 0.041, 0.030),
    "rectangle": (0.107, 0.074, 0.060, 0.049),
}
TOLERANCE = {"circle": 0.15, "ellipse": 0.10, "rectangle": 0.10}
FIXED_STAR_RMSE_M = 0.052


def check_paper_table(seed: int, quick: bool) -> list[Measurement]:
    """Paper mode against the table: largest relative deviation of the mean RMSE over M >= 16, and stuck stars."""
    n_runs = 30 if quick else 500
    n_points = TABLE_N_POINTS[:3] if quick else TABLE_N_POINTS
    rows = []
    for shape, expected in PAPER_RMSE_M.items():
        deviation, doubt = [], []
        for n, reference in zip(n_points, expected, strict=False):
            rmse = run_cell("paper", shape, n, n_runs, seed).rmse_m
            deviation.append(abs(rmse.mean() / reference - 1))
            doubt.append(rmse.std() / np.sqrt(n_runs) / reference)
        bar = quick_bar(TOLERANCE[shape], max(doubt), quick)
        reason = f"{n_runs} runs per M, table of 1,000 runs" + (", 3 standard errors added" if quick else "")
        rows.append(at_most(f"gp.paper.{shape}.rmse_deviation", max(deviation), round(bar, 3), reason))
    stuck = [run_cell("paper", "star", n, n_runs, seed).is_stuck.mean() for n in n_points]
    bar = round(quick_bar(0.7, -np.sqrt(0.8 * 0.2 / n_runs), quick), 3)
    reason = "least over M >= 16: from the printed start the fit takes the contour for noise"
    return [*rows, at_least("gp.paper.star.stuck_share", min(stuck), bar, reason)]


def check_corrected_gp(seed: int, quick: bool) -> list[Measurement]:
    """Data-driven starts and the uncertainty of the mean: star at M = 64, coverage of circles at M >= 16."""
    n_runs = 30 if quick else 500
    star = run_cell("data-driven", "star", 64, n_runs, seed).rmse_m
    error = abs(float(star.mean()) - FIXED_STAR_RMSE_M)
    n_points = TABLE_N_POINTS[:2] if quick else TABLE_N_POINTS
    runs = [run_cell("with noise floor", "circle", n, n_runs, seed).coverage for n in n_points]
    doubt = max(float(run.std()) for run in runs) / np.sqrt(n_runs)
    bar = round(quick_bar(0.92, -doubt, quick), 3)
    floor = "least over M >= 16, with the noise floor of the IP covariances"
    without_floor = run_cell("data-driven", "circle", 64, n_runs, seed).coverage.mean()
    key = "gp.fixed.circle"
    return [
        at_most("gp.fixed.star64.rmse_error_m", error, 0.005, f"from 0.052 m, {n_runs} runs", "m"),
        at_least(f"{key}.coverage", min(run.mean() for run in runs), bar, floor),
        at_least(f"{key}64.coverage_without_floor", without_floor, bar, "no floor: the noise is learned"),
    ]


def check_likelihood(seed: int, quick: bool) -> list[Measurement]:
    """Analytic gradients against differences, and the Fourier form against the full covariance matrix."""
    rng = np.random.default_rng(seed)
    counts = (16, 64) if quick else (16, 64, 256, 1024)
    gradient, difference, prediction = np.zeros(2), 0.0, 0.0
    for n in counts:
        for shape in SHAPES:
            data = RadialData(*draw_points(shape, n, rng))
            for beta in _betas(rng, 3):
                exact = log_marginal_likelihood(data.chords, data.radius_m, beta)
                fourier = log_marginal_likelihood_fourier(data.sums, beta)
                difference = max(difference, abs(exact.value - fourier.value))
                prediction = max(prediction, _prediction_difference(data, beta, exact.mu))
                if n <= 64:
                    gradient = np.maximum(gradient, _gradient_errors(data, beta))
    bar = "central differences over log beta, relative to the largest component"
    return [
        at_most("gp.gradient.exact", gradient[0], 1e-5, bar),
        at_most("gp.gradient.fourier", gradient[1], 1e-5, bar),
        at_most("gp.fourier.likelihood_nat", difference, 1e-6, f"M = {counts}", "nat"),
        at_most("gp.fourier.prediction_m", prediction, 1e-6, "mean and standard deviations", "m"),
    ]


def _betas(rng: np.random.Generator, count: int) -> FloatArray:
    """Draws (draw, 3) of beta: sigma_f 0.1-2 m, l 0.15-5, sigma_n 0.03-1 m."""
    return np.exp(rng.uniform(np.log([0.1, 0.15, 0.03]), np.log([2.0, 5.0, 1.0]), (count, 3))) ** 2


def _gradient_errors(data: RadialData, beta: FloatArray) -> list[float]:
    """Relative errors of the exact form and of the Fourier form."""
    step, errors = 1e-4, []
    forms: tuple[Callable[[FloatArray], Likelihood], ...] = (
        lambda at: log_marginal_likelihood(data.chords, data.radius_m, at),
        lambda at: log_marginal_likelihood_fourier(data.sums, at),
    )
    for form in forms:
        analytic, numerical = form(beta).gradient[1:] * beta, []
        for shift in step * np.eye(3):
            at = [form(beta * np.exp(s * shift)).value for s in (-2, -1, 1, 2)]
            numerical.append((at[0] - 8 * at[1] + 8 * at[2] - at[3]) / (12 * step))
        errors.append(float(np.max(np.abs(analytic - numerical)) / np.max(np.abs(analytic))))
    return errors


def _prediction_difference(data: RadialData, beta: FloatArray, mu: float) -> float:
    at = np.linspace(-np.pi, np.pi, 50)
    exact = ExactPosterior.of(data.angle_rad, data.radius_m, beta, mu).predict(at)
    fourier = FourierPosterior.of(data.sums, beta, mu).predict(at)
    std = [np.sqrt(result[1] + result[2]) for result in (exact, fourier)]
    return float(max(np.max(np.abs(exact[0] - fourier[0])), np.max(np.abs(std[0] - std[1]))))
