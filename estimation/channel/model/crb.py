"""Cramer-Rao bounds of path parameters from beam sweeps, with coherent or with unknown phases of beam pairs.

Model, equation (1): y[m, n, k] = sum_i xi_i T_m(phi_i) R_n(theta_i) exp(-j 2 pi f_k tau_i) x[m, k] + w with |x| =
1 and white w of power sigma_n^2. Parameters of a path are, in this order,

    delay in s, AoD angles in rad, AoA angles in rad, (Doppler shift in Hz,) log |xi|, arg xi.

With the times t of the beam pairs, a path of Doppler shift nu is multiplied by exp(j 2 pi nu t[m, n]). These times
are sums of one per TX beam and one per RX beam, so the slope over nu is a sum of two products of factors: both are
carried as parameters of their own, and tied at the end.

Every derivative of the mean is a product of one factor over TX beams, one over RX beams and one over subcarriers,
so the coherent Fisher information is the Hadamard product of three small Grams: J_ab = 2 Re(c_a^* c_b G_T G_R G_W)
(Kay 1993, equation 15.52, for a circular Gaussian with a known covariance).

Incoherent means one unknown, uniform phase per beam pair: the information is the exact one of the likelihood
marginalised over these phases; see `estimation.channel.model.phase_information`. It needs gains as log-magnitude
and phase: with real and imaginary part a path near an axis gets a bound that is too small.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from estimation.channel.model.factors import MovingPaths, TangentFactors
from estimation.channel.model.manifold import Manifold
from scenes.record import ComplexArray, FloatArray, Record, array
from sim.observation import BeamClock
from sim.signal.arrays.codebook import Codebook

_NO_INFORMATION = 1e-13  # eigenvalue of an equilibrated information that is a rounding error
_TOUCHED = 1e-6  # component of a parameter in a direction without information


@dataclass(frozen=True)
class PathBounds(Record):
    """Bounds of every path if all paths of the stop are estimated together.

    Infinite if the sweep does not determine a parameter: an angle observed by one beam, two paths in one place.
    Phases are NaN in incoherent mode: no common phase exists there.
    """

    covariance: FloatArray = array(
        "path",
        "parameter",
        "parameter2",
        unit="(s, rad, Hz)^2",
        doc="of delay, AoD angles, AoA angles (, Doppler)",
    )
    gain_std_db: FloatArray = array("path", unit="dB", doc="of the path's gain magnitude")
    phase_std_rad: FloatArray = array("path", unit="rad", doc="of the path's gain phase")
    snr_db: FloatArray = array("path", unit="dB", doc="of the best beam pair after summing the subcarriers")
    n_aod_angles: int = array(dtype=int, doc="1: azimuth, 2: azimuth and elevation; then come AoA angles")
    has_doppler: bool = array(dtype=bool, default=False, doc="whether the last parameter is the Doppler shift")

    @property
    def std(self) -> FloatArray:
        """Bounds (path, parameter) on standard deviations, in s and rad."""
        return np.sqrt(np.diagonal(self.covariance, axis1=1, axis2=2))

    @property
    def delay_std_s(self) -> FloatArray:
        """Delay (path,)."""
        return self.std[:, 0]

    @property
    def aod_std_rad(self) -> FloatArray:
        """Angles of departure (path, angle)."""
        return self.std[:, 1 : 1 + self.n_aod_angles]

    @property
    def aoa_std_rad(self) -> FloatArray:
        """Angles of arrival (path, angle)."""
        return self.std[:, 1 + self.n_aod_angles : self.std.shape[1] - self.has_doppler]

    @property
    def doppler_std_hz(self) -> FloatArray:
        """Doppler shift (path,): zero for a path known to be frozen, NaN without times of the beam pairs."""
        return self.std[:, -1] if self.has_doppler else np.full(len(self.covariance), np.nan)


def crb(
    tx_codebook: Codebook,
    rx_codebook: Codebook,
    frequency_offset_hz: FloatArray,
    noise_power_mw: Any,
    *,
    delay_s: Any,
    aod_rad: Any,
    aoa_rad: Any,
    amplitude: Any,
    coherent: bool = True,
    clock: BeamClock | None = None,
    doppler_hz: Any = 0.0,
    is_frozen: Any = False,
) -> PathBounds:
    """Cramer-Rao bounds of the paths of one stop, for design studies: any codebooks, subcarriers and paths.

    Two paths 2 ns apart, observed by the beams of a link:

    >>> bounds = crb(
    ...     link.tx_codebook, link.rx_codebook, link.frequency_offset_hz, link.noise_power_mw,
    ...     delay_s=[20e-9, 22e-9], aod_rad=[0.1, 0.2], aoa_rad=[-0.3, 0.1], amplitude=[1e-4, 5e-5j],
    ... )  # doctest: +SKIP
    >>> bounds.delay_std_s  # doctest: +SKIP

    Parameters
    ----------
    tx_codebook, rx_codebook : beams of both ends, of any kind and number of panels
    frequency_offset_hz : (subcarrier,) sounded subcarriers relative to the phase reference of the gains
    noise_power_mw : scalar or (rx_beam,), per sample
    delay_s : (path,)
    aod_rad, aoa_rad : (path,) or (path, angle) in the device frames: azimuth, and elevation if the beams resolve
        it (`Manifold.n_angles`)
    amplitude : (path,) complex xi in sqrt(mW), the transmit power included
    coherent : whether phases are coherent from beam pair to beam pair
    clock : times of the beams; with it every path has an unknown Doppler shift, and the bound holds what the order
        of the scan costs. Without it the world is known to be frozen.
    doppler_hz : scalar or (path,)
    is_frozen : scalar or (path,), paths that are known to have no shift

    Raises `ValueError` For arrays of other shapes, values that are not finite, and noise powers that are not
    positive.
    """
    tx, rx = Manifold(tx_codebook), Manifold(rx_codebook)
    amplitude = np.atleast_1d(np.asarray(amplitude, complex))
    n = len(amplitude)
    delay = _checked("delay_s", delay_s, (n,))
    aod = _checked("aod_rad", aod_rad, (n, tx.n_angles))
    aoa = _checked("aoa_rad", aoa_rad, (n, rx.n_angles))
    noise = _checked("noise_power_mw", np.broadcast_to(noise_power_mw, rx.n_beams), (rx.n_beams,))
    if not np.isfinite(amplitude).all() or amplitude.ndim != 1:
        raise ValueError("amplitude: must be finite, one number per path")
    if (noise <= 0).any():
        raise ValueError(f"noise_power_mw = {noise.min():g}: must be positive")
    frequency_hz = np.asarray(frequency_offset_hz, float)
    moving = None
    if clock is not None:
        shift = np.broadcast_to(np.asarray(doppler_hz, float), n)
        moving = MovingPaths(clock, shift, np.broadcast_to(np.asarray(is_frozen, bool), n))
    return path_bounds(tx, rx, frequency_hz, noise, delay, aod, aoa, amplitude, coherent=coherent, moving=moving)


def path_bounds(
    tx: Manifold,
    rx: Manifold,
    frequency_offset_hz: FloatArray,
    noise_power_mw: FloatArray,
    delay_s: FloatArray,
    aod_rad: FloatArray,
    aoa_rad: FloatArray,
    amplitude: ComplexArray,
    *,
    coherent: bool,
    moving: MovingPaths | None = None,
) -> PathBounds:
    """Bounds as in `crb`, for given manifolds: arguments as in `path_information`."""
    paths = delay_s, aod_rad, aoa_rad, amplitude
    information = path_information(
        tx, rx, frequency_offset_hz, noise_power_mw, *paths, coherent=coherent, moving=moving
    )
    covariance = path_covariance(information)
    block = np.einsum("iaib->iab", covariance)
    phase_std = np.sqrt(block[:, -1, -1])
    return PathBounds(
        covariance=block[:, :-2, :-2],
        gain_std_db=20 / np.log(10) * np.sqrt(block[:, -2, -2]),
        phase_std_rad=phase_std if coherent else np.full(len(delay_s), np.nan),
        snr_db=path_snr_db(tx, rx, len(frequency_offset_hz), noise_power_mw, aod_rad, aoa_rad, amplitude),
        n_aod_angles=tx.n_angles,
        has_doppler=moving is not None,
    )


def path_information(
    tx: Manifold,
    rx: Manifold,
    frequency_offset_hz: FloatArray,
    noise_power_mw: FloatArray,
    delay_s: FloatArray,
    aod_rad: FloatArray,
    aoa_rad: FloatArray,
    amplitude: ComplexArray,
    *,
    coherent: bool,
    moving: MovingPaths | None = None,
) -> FloatArray:
    """Fisher information (path, parameter, path, parameter) of all parameters of all paths.

    `noise_power_mw` is (rx_beam,), angles (path, angle) as in the manifolds, `amplitude` (path,) xi in sqrt(mW).
    Frozen paths of `moving` know their shift: it has no slope and infinite information.
    """
    factors = TangentFactors.make(
        tx, rx, frequency_offset_hz, noise_power_mw, delay_s, aod_rad, aoa_rad, amplitude, moving
    )
    flat = factors.coherent() if coherent else factors.incoherent()
    n = len(delay_s)
    size = 3 + tx.n_angles + rx.n_angles
    if moving is None:
        return flat.reshape(n, size, n, size)
    tie = np.insert(np.eye(size + 1), 1 + tx.n_angles, 0.0, axis=0)  # (factor, parameter)
    tie[1 + tx.n_angles, size - 2] = 1.0
    tied = np.einsum("ap,iajb,bq->ipjq", tie, flat.reshape(n, size + 2, n, size + 2), tie)
    known = np.flatnonzero(moving.is_frozen)
    tied[known, size - 2, known, size - 2] = np.inf
    return np.asarray(tied)


def path_covariance(information: FloatArray) -> FloatArray:
    """Inverse (path, parameter, path, parameter) of a path information.

    Parameters with a component in a direction without information, such as all phases in incoherent mode, get
    infinite variances; those of infinite information are known. Parameters are first scaled to a unit diagonal:
    seconds and radians differ by 1e20.
    """
    n, size = information.shape[:2]
    if not n:
        return np.zeros_like(information)
    flat = information.reshape(n * size, n * size)
    known = np.isinf(np.diagonal(flat))
    if known.any():
        covariance = np.zeros_like(flat)
        unknown = np.ix_(~known, ~known)
        covariance[unknown] = _inverse(flat[unknown])
        return covariance.reshape(information.shape)
    return _inverse(flat).reshape(information.shape)


def _inverse(flat: FloatArray) -> FloatArray:
    """The covariance (parameter, parameter) of an information, infinite where there is none."""
    diagonal = np.diagonal(flat)
    scale = np.sqrt(np.where(diagonal > 0, diagonal, 1.0))
    value, vector = np.linalg.eigh(flat / np.outer(scale, scale))
    free = value <= _NO_INFORMATION * len(flat)
    kept = vector[:, ~free]
    covariance = (kept / value[~free]) @ kept.T / np.outer(scale, scale)
    touched = np.any(np.abs(vector[:, free]) > _TOUCHED, axis=1)
    covariance[touched, touched] = np.inf
    return np.asarray(covariance)


def joint_loss_db(information: FloatArray) -> FloatArray:
    """SNR (path,) in dB that a path loses to all others: a lone path of `snr - loss` has the same bound.

    It is the largest increase of its variances (delay, angles, gain magnitude); infinite if one is unobservable.
    """
    n = len(information)
    if not n:
        return np.zeros(0)
    joint = np.einsum("iaia->ia", path_covariance(information))
    alone = [path_covariance(information[i : i + 1, :, i : i + 1])[0, :, 0] for i in range(n)]
    own = np.array([np.diagonal(covariance) for covariance in alone])
    ratio = np.full((n, joint.shape[1] - 1), np.inf)
    known = own[:, :-1] == 0  # as the shift of a frozen path
    ratio[known] = 1.0
    np.divide(joint[:, :-1], own[:, :-1], out=ratio, where=np.isfinite(joint[:, :-1]) & ~known)
    return np.asarray(10 * np.log10(ratio.max(axis=1)))


def path_snr_db(
    tx: Manifold,
    rx: Manifold,
    n_subcarriers: int,
    noise_power_mw: FloatArray,
    aod_rad: FloatArray,
    aoa_rad: FloatArray,
    amplitude: ComplexArray,
) -> FloatArray:
    """SNR (path,) in dB of the best beam pair, subcarriers summed: |xi|^2 max|T|^2 max|R|^2 K / sigma^2."""
    tx_gain = np.square(np.abs(tx.response(aod_rad))).max(axis=1, initial=0.0)
    rx_gain = (np.square(np.abs(rx.response(aoa_rad))) / noise_power_mw).max(axis=1, initial=0.0)
    snr = np.square(np.abs(amplitude)) * tx_gain * rx_gain * n_subcarriers
    return np.asarray(10 * np.log10(np.maximum(snr, np.finfo(float).tiny)))


def _checked(name: str, value: Any, shape: tuple[int, ...]) -> FloatArray:
    result = np.atleast_1d(np.asarray(value, float))
    if len(shape) == 2 and shape[1] == 1 and result.ndim == 1:
        result = result[:, None]
    if result.shape != shape:
        raise ValueError(f"{name}: shape {result.shape}, {shape} is needed")
    if not np.isfinite(result).all():
        raise ValueError(f"{name}: must be finite")
    return result
