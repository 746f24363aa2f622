"""Normal equations of the elements of both arrays from all strong paths of one stop.

A stop with the paths i, of gain g, responses t and r of both ends and delay wave w, shows in the beam pair (m, n)

    y[m, n] = exp(j phase[m, n]) sum_i g_i t_i[m] r_i[n] w_i + noise,   t_i[m] = sum_k T_i[m, k] e[k],

with the factors e of the elements of the TX (and alike of the RX), shared by all paths and stops; kinds of
coupling are further factors. The samples are kept in the space of the paths' waves and of their slopes over delay,
which holds all that they tell. A parameter of a path changes the model by a product of one factor per end and a
wave; a factor of an array changes its response to all paths. So the matrix of the normal equations is a sum of
small products per beam, and no Jacobian is formed.
"""

from dataclasses import dataclass
from typing import Self

import numpy as np

from estimation.channel.calibration.ends import End
from scenes.record import ComplexArray, FloatArray, IntArray

REGULAR = 1e-9  # relative, added to the diagonal of the parameters of a stop
N_SHARED = 2  # columns of a path that are not angles: its relative complex gain, and its delay


@dataclass(frozen=True)
class StopSamples:
    """Samples of one stop in the space of the waves of its paths.

    Attributes
    ----------
    sample : (tx_beam, rx_beam, rank)
    wave, slope : (path, rank) waves of the delays of the paths, and their slopes over delay
    weight : (tx_beam, rx_beam) inverse of the noise power
    phase_variance : (tx_beam, rx_beam) prior variance of the phases of pairs in rad^2, 0 for known phases
    """

    sample: ComplexArray
    wave: ComplexArray
    slope: ComplexArray
    weight: FloatArray
    phase_variance: FloatArray

    @property
    def phase_information(self) -> FloatArray:
        """Half the prior information (tx_beam, rx_beam) on the phases of pairs: infinite for known ones."""
        none = np.full(self.weight.shape, np.inf)
        return np.asarray(np.divide(0.5, self.phase_variance, out=none, where=self.phase_variance > 0))


@dataclass(frozen=True)
class StopModel:
    """Paths of a stop and phases of its beam pairs.

    Attributes
    ----------
    gain : (path,) complex
    delay_change : (path,) since the waves were made, in the unit of their slopes
    aod_rad, aoa_rad : (path, angle)
    phase_rad : (tx_beam, rx_beam)
    """

    gain: ComplexArray
    delay_change: FloatArray
    aod_rad: FloatArray
    aoa_rad: FloatArray
    phase_rad: FloatArray

    def moved(self, paths: FloatArray, phase_rad: FloatArray) -> Self:
        """The model after steps of the paths (path, parameter) and of the phases (tx_beam, rx_beam).

        Parameters are the relative gain, real and imaginary, delay, departure and arrival angles.
        """
        n = self.aod_rad.shape[1]
        return type(self)(
            gain=self.gain * (1 + paths[:, 0] + 1j * paths[:, 1]),
            delay_change=self.delay_change + paths[:, 2],
            aod_rad=self.aod_rad + paths[:, 3 : 3 + n],
            aoa_rad=self.aoa_rad + paths[:, 3 + n :],
            phase_rad=self.phase_rad + phase_rad,
        )

    @property
    def n_parameters(self) -> int:
        """Number of real parameters of the paths."""
        return len(self.gain) * (3 + int(self.aod_rad.shape[1]) + int(self.aoa_rad.shape[1]))

    def waves(self, stop: StopSamples) -> ComplexArray:
        """Waves (path, rank) of the paths."""
        return stop.wave + self.delay_change[:, None] * stop.slope

    def residual(self, stop: StopSamples, tx: End, rx: End) -> tuple[ComplexArray, ComplexArray]:
        """What the paths leave of the samples, their phases removed, and what they explain: both like `sample`."""
        lit = np.einsum("im,iq->miq", self.gain[:, None] * tx.response, self.waves(stop))
        model = np.einsum("in,miq->mnq", rx.response, lit, optimize=True)
        return stop.sample * np.exp(-1j * self.phase_rad)[..., None] - model, model

    def cost(self, stop: StopSamples, tx: End, rx: End) -> float:
        """Weighted energy that the paths leave, with the prior of the phases."""
        energy = np.square(np.abs(self.residual(stop, tx, rx)[0])).sum(axis=2)
        known = stop.phase_variance > 0
        prior = np.square(self.phase_rad[known]) @ stop.phase_information[known]
        return float((stop.weight * energy).sum() + prior)


@dataclass(frozen=True)
class NormalEquations:
    """Half the second and minus half the first derivatives of the cost of one stop, phases of pairs eliminated.

    Rows are the elements of TX and RX, real parts of all before imaginary ones, then the parameters of every path
    in the order of `StopModel.moved`.

    Attributes
    ----------
    matrix, gradient : (row, row) and (row,)
    n_elements : of both ends
    phase_gradient, phase_curvature : (tx_beam, rx_beam) of the phases
    phase_cross : (row, tx_beam, rx_beam) between the rows and the phases
    """

    matrix: FloatArray
    gradient: FloatArray
    n_elements: int
    phase_gradient: FloatArray
    phase_curvature: FloatArray
    phase_cross: FloatArray

    def of_elements(self, damping: float) -> tuple[FloatArray, FloatArray]:
        """Matrix and gradient of the elements alone; the paths follow them."""
        n = 2 * self.n_elements
        follow = self._solved(damping, np.column_stack([self.matrix[n:, :n], self.gradient[n:]]))
        across = self.matrix[:n, n:] @ follow
        return self.matrix[:n, :n] - across[:, :-1], self.gradient[:n] - across[:, -1]

    def following(self, damping: float, elements: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Steps of all parameters of the paths, and (tx_beam, rx_beam) of phases, for a step of the factors."""
        n = 2 * self.n_elements
        paths = self._solved(damping, (self.gradient[n:] - self.matrix[n:, :n] @ elements)[:, None])[:, 0]
        moved = np.tensordot(np.append(elements, paths), self.phase_cross, axes=1)
        return paths, np.asarray((self.phase_gradient - moved) / self.phase_curvature)

    def _solved(self, damping: float, right: FloatArray) -> FloatArray:
        """The parameters of the paths for right sides (row, side), their equations damped."""
        own = self.matrix[2 * self.n_elements :, 2 * self.n_elements :]
        size = np.sqrt(np.maximum(np.diag(own), np.finfo(float).tiny))[:, None]
        return np.asarray(
            np.linalg.solve(own / size / size.T + (damping + REGULAR) * np.eye(len(own)), right / size) / size
        )


@dataclass(frozen=True)
class _Columns:
    """How the parameters of all paths change the model: one factor per end and a wave, (column, ...) each.

    The columns of a path are its gain, its delay, and its angles; those of the gains are at `base` (path,).
    """

    tx: ComplexArray  # (column, tx_beam), with the gains
    rx: ComplexArray  # (column, rx_beam)
    wave: ComplexArray  # (column, rank)
    base: IntArray

    @classmethod
    def of(cls, stop: StopSamples, model: StopModel, tx: End, rx: End) -> Self:
        """The columns of a model of a stop, for the ends towards its paths; angles are per rad."""
        n, n_aod, n_aoa = len(model.gain), len(tx.slopes), len(rx.slopes)
        size = N_SHARED + n_aod + n_aoa
        near, far = (np.repeat(end.response[:, None], size, axis=1) for end in (tx, rx))
        near[:, N_SHARED : N_SHARED + n_aod] = tx.slopes.swapaxes(0, 1)
        far[:, N_SHARED + n_aod :] = rx.slopes.swapaxes(0, 1)
        near = near * model.gain[:, None, None]
        wave = np.repeat(model.waves(stop)[:, None], size, axis=1)
        wave[:, 1] = stop.slope
        near, far, wave = (array.reshape(n * size, -1) for array in (near, far, wave))
        return cls(near, far, wave, np.arange(n) * size)


def normal_equations(stop: StopSamples, model: StopModel, tx: End, rx: End) -> NormalEquations:
    """The normal equations of one stop at a model of it, for the ends towards its paths."""
    left, explained = model.residual(stop, tx, rx)
    columns = _Columns.of(stop, model, tx, rx)
    lit = tx.matrix * model.gain[:, None, None]  # (path, tx_beam, element)
    n_elements = lit.shape[2] + rx.matrix.shape[2]
    rows = _real_rows(n_elements, len(columns.base), len(columns.wave))
    matrix = _complex_matrix(stop, columns, lit, rx)
    matrix = np.block([[matrix.real, -matrix.imag], [matrix.imag, matrix.real]])[np.ix_(rows, rows)]
    gradient = _parts(_products(stop, columns, lit, rx, left).sum(axis=(1, 2)))[rows]
    phase_cross = _parts(_products(stop, columns, lit, rx, 1j * explained))[rows]
    prior = stop.phase_information
    curvature = stop.weight * np.square(np.abs(explained)).sum(axis=2) + prior
    phase_gradient = stop.weight * (left * (1j * explained).conj()).real.sum(axis=2)
    known = np.isfinite(prior)
    phase_gradient[known] -= prior[known] * model.phase_rad[known]
    cross = phase_cross.reshape(len(rows), -1)
    return NormalEquations(
        matrix=matrix - (cross / curvature.ravel()) @ cross.T,
        gradient=gradient - cross @ (phase_gradient / curvature).ravel(),
        n_elements=n_elements,
        phase_gradient=phase_gradient,
        phase_curvature=curvature,
        phase_cross=phase_cross,
    )


def _real_rows(n_elements: int, n_paths: int, n_columns: int) -> IntArray:
    """Places of the real parameters in the real parts of all complex columns, followed by the imaginary parts.

    Elements and gains are complex, all else is real.
    """
    elements, total = np.arange(n_elements), n_elements + n_columns
    own = n_elements + np.arange(n_columns).reshape(n_paths, -1)
    paths = np.concatenate([own[:, :1], total + own[:, :1], own[:, 1:]], axis=1)
    return np.concatenate([elements, total + elements, paths.ravel()])


def _parts(values: ComplexArray) -> FloatArray:
    return np.concatenate([values.real, values.imag])


def _complex_matrix(stop: StopSamples, columns: _Columns, lit: ComplexArray, rx: End) -> ComplexArray:
    """Products of all complex columns, weighted: elements of TX, of RX, then the columns of the paths."""
    n_tx, n_rx = lit.shape[2], rx.matrix.shape[2]
    of_tx, of_rx, of_paths = slice(0, n_tx), slice(n_tx, n_tx + n_rx), slice(n_tx + n_rx, None)
    matrix = np.zeros((n_tx + n_rx + len(columns.wave),) * 2, complex)
    inner = columns.wave.conj() @ columns.wave.T
    at_gains = np.ix_(columns.base, columns.base)
    sides = (
        (of_tx, lit, columns.tx, columns.rx, stop.weight),
        (of_rx, rx.matrix, columns.rx, columns.tx, stop.weight.T),
    )
    for of_end, elements, near, far, weight in sides:
        for beam in range(len(weight)):
            product = ((far.conj() * weight[beam]) @ far.T) * inner
            element = elements[:, beam].conj().T  # (element, path)
            matrix[of_end, of_paths] += element @ (product[columns.base] * near[:, beam])
            matrix[of_end, of_end] += element @ product[at_gains] @ element.conj().T
            if of_end is of_tx:
                matrix[of_paths, of_paths] += near[:, beam].conj()[:, None] * product * near[:, beam]
    for beam in range(stop.weight.shape[1]):
        weighted = lit.conj() * stop.weight[:, beam, None]
        each = np.einsum("imk,jm->kij", weighted, columns.tx[columns.base], optimize=True)
        turned = each * (rx.response[:, beam].conj()[:, None] * inner[at_gains])
        matrix[of_tx, of_rx] += turned.sum(axis=1) @ rx.matrix[:, beam]
    matrix[of_rx, of_tx] = matrix[of_tx, of_rx].conj().T
    matrix[of_paths, : n_tx + n_rx] = matrix[: n_tx + n_rx, of_paths].conj().T
    return matrix


def _products(
    stop: StopSamples, columns: _Columns, lit: ComplexArray, rx: End, values: ComplexArray
) -> ComplexArray:
    """Weighted products (column, tx_beam, rx_beam) of all complex columns with `values` like the samples."""
    along = np.einsum("cq,mnq->cmn", columns.wave.conj(), values, optimize=True) * stop.weight
    own = columns.tx.conj()[:, :, None] * columns.rx.conj()[:, None] * along
    at_gains = along[columns.base]
    of_tx = np.einsum("imk,imn->kmn", lit.conj(), rx.response.conj()[:, None] * at_gains, optimize=True)
    of_rx = np.einsum(
        "ink,imn->kmn", rx.matrix.conj(), columns.tx[columns.base].conj()[:, :, None] * at_gains, optimize=True
    )
    return np.concatenate([of_tx, of_rx, own])
