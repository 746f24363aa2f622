"""The model of paths in a compressed sweep: tangents, and their inner products with samples and with each other.

A path adds c t(phi) r(theta) d(tau), a product over the three axes; with Doppler, t and r turn from beam to beam.
In each derivative one factor is replaced, so every inner product of two of them is a product of three short ones:
the Fisher information is a Hadamard product of small Gram matrices, and no array of the size paths x samples is
needed.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Self, TypeVar

import numpy as np

from estimation.channel.model.compress import CompressedSweep
from estimation.channel.model.kernels import hadamard_gram, normal_matrix, tangent_products
from estimation.channel.model.manifold import CELL
from estimation.channel.model.turns import is_moving
from scenes.pose import within_poles, wrap_angle
from scenes.record import BoolArray, ComplexArray, FloatArray, IntArray

A = TypeVar("A", FloatArray, ComplexArray)


@dataclass(frozen=True)
class PathParameters:
    """Parameters of paths: delays (path,) in bins, angles (path, angle) in rad, amplitudes (path,).

    `doppler_turns` (path, 0 or 1) are turns of phase during the sweep, exactly zero for a frozen path; a sweep
    without a clock has none.
    """

    delay_bins: FloatArray
    aod_rad: FloatArray
    aoa_rad: FloatArray
    amplitude: ComplexArray
    doppler_turns: FloatArray = field(default_factory=lambda: np.zeros((0, 0)))

    def __post_init__(self) -> None:
        if not self.doppler_turns.shape[1]:
            object.__setattr__(self, "doppler_turns", np.zeros((len(self.delay_bins), 0)))

    def __len__(self) -> int:
        return len(self.delay_bins)

    def take(self, index: IntArray | BoolArray | slice) -> Self:
        """Some of the paths."""
        return replace(
            self,
            delay_bins=self.delay_bins[index],
            aod_rad=self.aod_rad[index],
            aoa_rad=self.aoa_rad[index],
            amplitude=self.amplitude[index],
            doppler_turns=self.doppler_turns[index],
        )

    def joined(self, other: PathParameters) -> PathParameters:
        """These paths, then the others."""
        return PathParameters(
            np.concatenate([self.delay_bins, other.delay_bins]),
            np.concatenate([self.aod_rad, other.aod_rad]),
            np.concatenate([self.aoa_rad, other.aoa_rad]),
            np.concatenate([self.amplitude, other.amplitude]),
            np.concatenate([self.doppler_turns, other.doppler_turns]),
        )

    def replaced(self, where: BoolArray, other: PathParameters) -> PathParameters:
        """The paths, with those marked in `where` (path,) taken from `other`."""
        return PathParameters(
            np.where(where, other.delay_bins, self.delay_bins),
            np.where(where[:, None], other.aod_rad, self.aod_rad),
            np.where(where[:, None], other.aoa_rad, self.aoa_rad),
            np.where(where, other.amplitude, self.amplitude),
            np.where(where[:, None], other.doppler_turns, self.doppler_turns),
        )

    def with_paths(self, index: IntArray, paths: PathParameters) -> PathParameters:
        """The paths, with others in the places of these numbers."""
        place = np.arange(len(self))
        place[index] = len(self) + np.arange(len(paths))
        return self.joined(paths).take(place)

    def moved(self, step: FloatArray) -> PathParameters:
        """The paths after a step (path, parameter) of delays, angles and turns.

        Over a pole they come down behind it.
        """
        n_aod, n_angles = self.aod_rad.shape[1], self.aod_rad.shape[1] + self.aoa_rad.shape[1]
        return replace(
            self,
            delay_bins=self.delay_bins + step[:, 0],
            aod_rad=within_poles(self.aod_rad + step[:, 1 : 1 + n_aod]),
            aoa_rad=within_poles(self.aoa_rad + step[:, 1 + n_aod : 1 + n_angles]),
            doppler_turns=self.doppler_turns + step[:, 1 + n_angles :],
        )


def no_paths(sweep: CompressedSweep) -> PathParameters:
    """Zero paths with as many angles as the beams of a sweep observe."""
    return PathParameters(
        delay_bins=np.zeros(0),
        aod_rad=np.zeros((0, sweep.tx.n_angles)),
        aoa_rad=np.zeros((0, sweep.rx.n_angles)),
        amplitude=np.zeros(0, complex),
        doppler_turns=np.zeros((0, 0 if sweep.turns is None else 1)),
    )


@dataclass(frozen=True)
class PathTangents:
    """Factors of the responses of paths and of their derivatives along every axis, the value first.

    The order of the tangents is: value, derivatives over delay, angles of departure, angles of arrival, turns.

    Attributes
    ----------
    tx : (path, 1 + aod angle, tx_rank); rx : (path, 1 + aoa angle, rx_rank); delay : (path, 2, bin)
    is_tied : whether the last factors of both ends are slopes over turns: their sum is one derivative
    """

    tx: ComplexArray
    rx: ComplexArray
    delay: FloatArray
    is_tied: bool = False

    @property
    def values(self) -> PathTangents:
        """The responses alone."""
        return PathTangents(self.tx[:, :1], self.rx[:, :1], self.delay[:, :1])


def tangents(sweep: CompressedSweep, paths: PathParameters) -> PathTangents:
    """Responses of the paths and their derivatives over delay (per bin), angles (per rad) and turns."""
    tx, rx = sweep.tx.tangents(paths.aod_rad), sweep.rx.tangents(paths.aoa_rad)
    if sweep.turns is not None:
        tx = sweep.turns.with_slope(tx, paths.doppler_turns, is_tx=True)
        rx = sweep.turns.with_slope(rx, paths.doppler_turns, is_tx=False)
    return PathTangents(tx, rx, sweep.delay_response(paths.delay_bins), is_tied=sweep.turns is not None)


def responses(sweep: CompressedSweep, paths: PathParameters) -> PathTangents:
    """Responses of the paths alone, without derivatives."""
    tx, rx = sweep.tx.response(paths.aod_rad)[:, None], sweep.rx.response(paths.aoa_rad)[:, None]
    if sweep.turns is not None:
        tx = sweep.turns.turned(tx, paths.doppler_turns, is_tx=True)
        rx = sweep.turns.turned(rx, paths.doppler_turns, is_tx=False)
    return PathTangents(tx, rx, sweep.delay_response(paths.delay_bins)[:, :1])


def products_with(parts: FloatArray, at: PathTangents) -> ComplexArray:
    """Inner products (path, tangent) of the tangents with samples given as parts (part, tx_rank, rx_rank, bin)."""
    n_paths, n_factors, n_bins = at.delay.shape
    short = at.delay.reshape(n_paths * n_factors, n_bins).astype(np.float32)
    slices = short @ parts.reshape(-1, n_bins).T
    return _tied(tangent_products(slices.reshape(n_paths, n_factors, *parts.shape[:3]), at.tx, at.rx), at, 1)


def gram_matrix(at: PathTangents, other: PathTangents) -> ComplexArray:
    """Inner products (path, tangent, path, tangent) of two sets of tangents."""
    gram = hadamard_gram(
        _axis_gram(at.tx, other.tx), _axis_gram(at.rx, other.rx), _axis_gram(at.delay, other.delay)
    )
    return _tied(_tied(gram, at, 1), other, 3)


def normal_equations(
    at: PathTangents, rest: ComplexArray, amplitude: ComplexArray
) -> tuple[FloatArray, FloatArray]:
    """Normal matrix (path, column, path, column) and gradient (path, column) in real unknowns.

    `rest` (path, tangent) are the inner products of the tangents with the residual of all paths. The columns of a
    path are the derivatives over the real and the imaginary part of its amplitude, then over its parameters.
    """
    gram = _axis_gram(at.tx, at.tx), _axis_gram(at.rx, at.rx), _axis_gram(at.delay, at.delay)
    matrix = normal_matrix(*gram, amplitude)
    slope = np.concatenate([rest[:, :1].real, rest[:, :1].imag, (amplitude.conj()[:, None] * rest[:, 1:]).real], 1)
    return np.asarray(_tied(_tied(matrix, at, 1, before=1), at, 3, before=1)), slope


def own_gram_matrix(at: PathTangents, other: PathTangents) -> ComplexArray:
    """Inner products (path, tangent, tangent) of the tangents of each path and of its partner in `other`."""
    return group_gram_matrix(at, other, 1)[:, 0, :, 0]


def group_gram_matrix(
    at: PathTangents, other: PathTangents, size: int, other_size: int | None = None
) -> ComplexArray:
    """Inner products (group, path, tangent, path, tangent) of groups of `size` paths with their partners.

    The groups of partners have as many paths, or `other_size`.
    """
    sizes = size, size if other_size is None else other_size
    grouped = [
        [part.reshape(-1, n * part.shape[1], part.shape[2]) for part in (each.tx, each.rx, each.delay)]
        for each, n in zip((at, other), sizes, strict=True)
    ]
    tx, rx, delay = (one.conj() @ two.swapaxes(1, 2) for one, two in zip(*grouped, strict=True))
    (d, i, j), (e, k, h) = (_factors(each, n) for each, n in zip((at, other), sizes, strict=True))
    gram = tx[:, i[:, None], k] * rx[:, j[:, None], h] * delay[:, d[:, None], e]
    gram = gram.reshape(len(gram), sizes[0], len(d) // sizes[0], sizes[1], len(e) // sizes[1])
    return _tied(_tied(gram, at, 2), other, 4)


def _tied(products: A, at: PathTangents, axis: int, before: int = 0) -> A:
    """Products over all tangents along an axis, with both slopes over turns added to one, the last.

    There are so many more columns `before` the tangents.
    """
    if not at.is_tied:
        return products
    of_tx = before + at.delay.shape[1] + at.tx.shape[1] - 2
    both = np.take(products, of_tx, axis) + np.take(products, -1, axis)
    rest = np.delete(products, [of_tx, products.shape[axis] - 1], axis)
    return np.concatenate([rest, np.expand_dims(both, axis)], axis=axis)


def _factors(at: PathTangents, size: int) -> tuple[IntArray, IntArray, IntArray]:
    """Which factors of delay, TX and RX every tangent (path and tangent,) of a group is the product of."""
    n_delay, n_aod, n_aoa = at.delay.shape[1], at.tx.shape[1] - 1, at.rx.shape[1] - 1
    factors = np.zeros((3, n_delay + n_aod + n_aoa), int)
    factors[0, :n_delay] = np.arange(n_delay)
    factors[1, n_delay : n_delay + n_aod] = 1 + np.arange(n_aod)
    factors[2, n_delay + n_aod :] = 1 + np.arange(n_aoa)
    before = np.arange(size)[:, None] * np.array([n_delay, 1 + n_aod, 1 + n_aoa])
    d, i, j = (factors + before[..., None]).transpose(1, 0, 2).reshape(3, -1)
    return d, i, j


def response_energies(at: PathTangents) -> FloatArray:
    """Squared norm (path,) of the paths' responses at unit amplitude."""
    factors = (at.tx[:, 0], at.rx[:, 0], at.delay[:, 0])
    return np.asarray(np.prod([(np.abs(factor) ** 2).sum(axis=1) for factor in factors], axis=0))


def manifold_rates(sweep: CompressedSweep, paths: PathParameters) -> FloatArray:
    """Length on the manifold (path, parameter) per delay bin, rad of every angle, and turn.

    A resolution cell is `CELL` long.
    """
    rates = [np.full((len(paths), 1), CELL)]
    for manifold, angles in ((sweep.tx, paths.aod_rad), (sweep.rx, paths.aoa_rad)):
        rates.append(manifold.rates(angles))
    if sweep.turns is not None:
        rate = sweep.turns.rates(sweep.tx.response(paths.aod_rad), sweep.rx.response(paths.aoa_rad))
        rates.append((rate * is_moving(paths.doppler_turns))[:, None])
    return np.concatenate(rates, axis=1)


def cells_apart(paths: PathParameters, others: PathParameters, rate: FloatArray) -> FloatArray:
    """Distance (path, other) in resolution cells of the others, along the axis where it is largest.

    `rate` (other, parameter) is the `manifold_rates` of the others.
    """
    apart = [paths.delay_bins[:, None, None] - others.delay_bins[:, None]]
    for angles, given in ((paths.aod_rad, others.aod_rad), (paths.aoa_rad, others.aoa_rad)):
        apart.append(wrap_angle(angles[:, None] - given))
    apart.append(paths.doppler_turns[:, None] - others.doppler_turns)
    return np.asarray((np.abs(np.concatenate(apart, axis=2)) * rate / CELL).max(axis=2))


def residual(sweep: CompressedSweep, paths: PathParameters) -> FloatArray:
    """Parts (part, tx_rank, rx_rank, bin) of the samples minus the signals of the paths."""
    if not len(paths):
        return sweep.parts
    at = responses(sweep, paths)
    beams = (paths.amplitude[:, None, None] * at.tx[:, 0, :, None] * at.rx[:, 0, None]).reshape(len(paths), -1)
    model = np.concatenate([beams.real, beams.imag], axis=1).astype(np.float32).T @ at.delay[:, 0].astype(
        np.float32
    )
    return sweep.parts - model.reshape(sweep.parts.shape)


def _axis_gram(one: ComplexArray | FloatArray, other: ComplexArray | FloatArray) -> ComplexArray:
    product = one.reshape(-1, one.shape[2]).conj() @ other.reshape(-1, other.shape[2]).T
    return np.asarray(product.reshape(*one.shape[:2], *other.shape[:2]))
