"""Responses of both arrays from single paths of unknown directions, where phases may be lost.

A single path in its delay cell gives a matrix over TX and RX beams of rank 1, for any arrays: its singular vectors
are the responses t(phi) and r(theta) of the two codebooks as built, up to a complex factor. With the designed
weights W, the panel geometry a(phi), unknown element responses e and unknown beam factors b,

    t(phi) ~ diag(b) W diag(a(phi)) e.

Over the dominant paths of some stops the directions, e and b are estimated in turn: directions by maximising the
match; e by least squares on the part of the model orthogonal to the measured vector (linear in e, free of the
unknown factor); b by least squares per beam. A weak prior about 1 determines what no path observes, such as the
share of each row in a column of elements if all beams are horizontal.

If phases are not coherent between beam pairs (tested on the data), the magnitudes of the matrix still have rank 1;
the phases of the vectors are then those of the model, updated in every iteration. Magnitudes do not distinguish
element factors from their conjugates in reverse order; either is valid if only magnitudes count.
"""

from dataclasses import dataclass

import numpy as np

from estimation.channel.calibration.dominant import DominantPaths
from estimation.channel.calibration.ends import azimuth_elevation, element_matrix, with_responses, without_gauge
from estimation.channel.calibration.record import Calibration
from estimation.channel.config import SelfCalibrationConfig
from estimation.channel.model.manifold import Manifold
from scenes.record import ComplexArray, FloatArray
from sim.signal.arrays.codebook import Codebook

INCOHERENT_GAIN = 4.0  # misfit of complex vectors over that of magnitudes: above it phases are incoherent
START_OVERSAMPLING = 4.0  # directions per Rayleigh cell at the start of the direction search
FIRST_STEP_RAD = np.deg2rad(0.5)  # of the direction search; halved in every iteration, down to
LAST_STEP_RAD = np.deg2rad(0.02)
LEAST_MISFIT = 1e-9


@dataclass(frozen=True)
class ArrayFactors:
    """Factors between one device as built and its design."""

    element: ComplexArray  # (element,)
    beam: ComplexArray  # (beam,)
    misfit: float  # mean share of the measured vectors' power that the model does not explain


def calibration_by_single_paths(
    paths: DominantPaths, books: tuple[Codebook, Codebook], config: SelfCalibrationConfig
) -> Calibration:
    """Factors by single paths; `ValueError` where there is none."""
    magnitudes = _calibrated(books, paths, config, is_coherent=False)
    if paths.phases_may_be_coherent() and len(paths.pure(True, config.min_purity)):
        coherent = _calibrated(books, paths, config, is_coherent=True)
        if coherent.misfit <= INCOHERENT_GAIN * magnitudes.misfit:
            return coherent
    return magnitudes


def _calibrated(
    books: tuple[Codebook, Codebook], paths: DominantPaths, config: SelfCalibrationConfig, *, is_coherent: bool
) -> Calibration:
    paths = paths.pure(is_coherent, config.min_purity)
    if not len(paths):
        raise ValueError("self_calibration: no path stands alone in its delay cell at any of the stops")
    vectors = paths.vectors(is_coherent)
    tx, rx = (
        calibrate_array(book, vector, paths.snr, config, is_coherent=is_coherent)
        for book, vector in zip(books, vectors, strict=True)
    )
    return Calibration(
        tx_codebook=with_responses(books[0], tx.element, tx.beam),
        rx_codebook=with_responses(books[1], rx.element, rx.beam),
        tx_element=tx.element,
        rx_element=rx.element,
        n_paths=len(paths),
        is_coherent=is_coherent,
        misfit=tx.misfit + rx.misfit,
    )


def calibrate_array(
    codebook: Codebook,
    vectors: ComplexArray,
    snr: FloatArray,
    config: SelfCalibrationConfig,
    *,
    is_coherent: bool = True,
) -> ArrayFactors:
    """Factors of the elements and of the beams of one device, 1 if as designed.

    Parameters
    ----------
    vectors
        (path, beam) of unit norm: the device's response to one path each, up to a complex factor.
    snr
        (path,) inverse of the noise power of an entry of `vectors`. Paths that fit worse than their noise explains
        (other paths in the same delay cell, side lobes) are weighted by their misfit instead.
    """
    element = np.ones(codebook.size("element"), complex)
    beam = np.ones(len(codebook), complex)
    manifold = Manifold(codebook)
    angles = _start(manifold, vectors if is_coherent else np.abs(vectors), is_coherent=is_coherent)
    step = FIRST_STEP_RAD
    for _ in range(config.turns):
        matrix = element_matrix(codebook, *azimuth_elevation(angles)) * beam[:, None]
        measured = vectors if is_coherent else _model_phases(vectors, matrix @ element)
        angles = _searched(codebook, element, beam, measured, angles, step)
        matrix = element_matrix(codebook, *azimuth_elevation(angles))
        misfit = 1 - _match(measured, (matrix @ element) * beam)
        weight = np.minimum(snr, (vectors.shape[1] - 1) / np.maximum(misfit, LEAST_MISFIT))
        if config.errors != "beams":
            element = _element_step(matrix * beam[:, None], measured, weight, element, config.prior_std)
            element = without_gauge(codebook, element)
        if config.errors != "elements":
            beam = _beam_step(matrix @ element, measured, weight, beam, config.prior_std)
        step = max(step / 2, LAST_STEP_RAD)
    return ArrayFactors(element, beam, float(np.average(misfit, weights=weight)))


def _element_step(
    matrix: ComplexArray, measured: ComplexArray, snr: FloatArray, element: ComplexArray, prior_std: float
) -> ComplexArray:
    """Least squares for e on the part of the model (path, beam, element) orthogonal to the measured vectors.

    The noise of a unit vector is 1 / SNR per entry, that of the orthogonal part |A e|^2 / SNR.
    """
    scale = np.sqrt(snr / np.square(np.abs(matrix @ element)).sum(axis=1))
    across = matrix - measured[:, :, None] * (measured[:, None].conj() @ matrix)
    rows = (across * scale[:, None, None]).reshape(-1, matrix.shape[2])
    normal = rows.conj().T @ rows + np.eye(matrix.shape[2]) / prior_std**2
    # The prior pulls e to 1; the gauge removes its pull along the scale.
    return np.asarray(np.linalg.solve(normal, np.full(matrix.shape[2], 1 / prior_std**2, complex)))


def _beam_step(
    model: ComplexArray, measured: ComplexArray, snr: FloatArray, beam: ComplexArray, prior_std: float
) -> ComplexArray:
    """Least squares for the factor of every beam, given the responses (path, beam) without it."""
    current = model * beam
    factor = (current.conj() * measured).sum(axis=1) / np.square(np.abs(current)).sum(axis=1)
    expected = model * factor[:, None]
    weight = np.square(np.abs(expected)) * snr[:, None]
    matched = expected.conj() * measured * snr[:, None]
    updated = (matched.sum(axis=0) + 1 / prior_std**2) / (weight.sum(axis=0) + 1 / prior_std**2)
    scale = np.sqrt(np.mean(np.square(np.abs(updated))))
    return np.asarray(updated / (scale * np.exp(1j * np.angle(updated.sum()))))


def _start(manifold: Manifold, measured: ComplexArray, *, is_coherent: bool) -> FloatArray:
    """Directions (path, angle) of the grid whose designed responses are nearest to the measured vectors."""
    grid = manifold.grid(START_OVERSAMPLING)
    response = manifold.response(grid)
    if not is_coherent:
        response = np.abs(response).astype(complex)
    response = response / np.linalg.norm(response, axis=1, keepdims=True)
    return np.asarray(grid[np.abs(measured.conj() @ response.T).argmax(axis=1)])


def _searched(
    codebook: Codebook,
    element: ComplexArray,
    beam: ComplexArray,
    measured: ComplexArray,
    angles: FloatArray,
    step_rad: float,
) -> FloatArray:
    """Directions moved to the vertex of a parabola through the match at three points along every angle."""
    angles = angles.copy()
    for axis in range(angles.shape[1]):
        match = []
        for move in (-step_rad, 0.0, step_rad):
            tried = angles.copy()
            tried[:, axis] += move
            response = (element_matrix(codebook, *azimuth_elevation(tried)) @ element) * beam
            match.append(np.log(_match(measured, response)))
        left, centre, right = match
        curvature = left - 2 * centre + right
        with np.errstate(divide="ignore", invalid="ignore"):
            vertex = np.where(
                curvature < 0, np.clip(0.5 * (left - right) / curvature, -1, 1), np.sign(right - left)
            )
        angles[:, axis] += step_rad * vertex
    return angles


def _match(measured: ComplexArray, model: ComplexArray) -> FloatArray:
    """Share (path,) of the power of the unit vectors `measured` (path, beam) along the model."""
    along = np.square(np.abs((measured.conj() * model).sum(axis=1)))
    return np.asarray(along / np.square(np.abs(model)).sum(axis=1))


def _model_phases(vectors: ComplexArray, model: ComplexArray) -> ComplexArray:
    """The magnitudes of the vectors (path, beam) with the phases of the model."""
    return np.asarray(np.abs(vectors) * np.exp(1j * np.angle(model)))
