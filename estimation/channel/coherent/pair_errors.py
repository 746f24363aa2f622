"""Errors of beam pairs and arrays: noise in proportion to the signal, phases and elements known only so well.

A compressed sweep has no beam pairs any more, and its noise is taken as white. Phase noise and converters add
noise to the pairs of strong signals. A path is lit in a few pairs, so the noise of these pairs, weighted by what
each gives to the path, is the noise that it competes with. Unknown phases of pairs are further parameters with a
prior: they take information from the paths (a Schur complement).

Errors of the elements also spread every path over other directions of their end, at its own delay, and errors of
the phases over those of both ends. Weaker paths that do not exceed such a floor by more than chance may belong to
it.
"""

from dataclasses import dataclass

import numpy as np
from scipy.special import diric

from estimation.channel.model.compress import CompressedSweep
from estimation.channel.model.factors import pair_products
from estimation.channel.model.manifold import Manifold
from estimation.channel.model.path_model import PathParameters
from scenes.record import BoolArray, ComplexArray, FloatArray

CHANCE = 0.01  # that the power of a floor, which is exponential, exceeds the limit in a cell
SMALLEST = np.finfo(float).tiny  # of a norm that divides


@dataclass(frozen=True)
class PairErrors:
    """Errors (tx_beam, rx_beam) of beam pairs.

    Attributes
    ----------
    excess : noise power beyond that of the receiver, over the nominal one
    phase_variance : of the phases in rad^2, before the pair's own samples
    element_level : power of the error of an element of either end over its own
    """

    excess: FloatArray
    phase_variance: FloatArray
    element_level: float = 0.0


@dataclass(frozen=True)
class LitPairs:
    """Beam pairs with errors, as paths light them.

    Attributes
    ----------
    tx, rx : manifolds of all beams
    noise_mw : (rx_beam,) nominal noise
    """

    tx: Manifold
    rx: Manifold
    noise_mw: FloatArray
    errors: PairErrors

    def noise_factor(self, paths: PathParameters) -> FloatArray:
        """Noise power (path,) that paths compete with, over the nominal one."""
        tx, rx = (np.square(np.abs(part[:, 0])) for part in self._tangents(paths))
        energy = tx.sum(axis=1) * rx.sum(axis=1)
        beyond = np.einsum("pm,mn,pn->p", tx, self.errors.excess, rx, optimize=True)
        return np.asarray(1 + beyond / np.maximum(energy, SMALLEST))

    def may_be_floor(self, paths: PathParameters, n_bins: int) -> BoolArray:
        """Mask (path,) of paths that are not above a floor of stronger ones by more than chance."""
        power, *floors = self.power_and_floors(paths, n_bins)
        return np.asarray(power < -np.log(CHANCE) * np.maximum(*floors))

    def power_and_floors(self, paths: PathParameters, n_bins: int) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Power (path,) of paths in a matched filter, and its means there by errors of all stronger ones.

        First by the errors of the elements, then by those of the phases of pairs before the pairs' own samples.
        """
        tx, rx = (part[:, 0] for part in self._tangents(paths))
        norm_tx, norm_rx = (np.linalg.norm(one, axis=1, keepdims=True) for one in (tx, rx))
        along_tx, along_rx = tx / np.maximum(norm_tx, SMALLEST), rx / np.maximum(norm_rx, SMALLEST)
        tx_noise = self.tx.element_noise(along_tx, paths.aod_rad[:, : self.tx.n_angles])
        white_rx = along_rx / np.sqrt(self.noise_mw)
        rx_noise = self.rx.element_noise(white_rx, paths.aoa_rad[:, : self.rx.n_angles])
        same_tx, same_rx = np.square(np.abs(along_tx.conj() @ tx.T)), np.square(np.abs(along_rx.conj() @ rx.T))
        by_elements = self.errors.element_level * (tx_noise * same_rx + same_tx * rx_noise)
        of_tx, of_rx = np.square(np.abs(tx)), np.square(np.abs(rx))
        lit = zip(np.square(np.abs(along_tx)), np.square(np.abs(along_rx)), strict=True)
        changed = 2 * (1 - np.exp(-self.errors.phase_variance / 2))  # mean of |exp(j phase) - 1|^2
        turned = [((m * of_tx @ changed) * (n * of_rx)).sum(axis=1) for m, n in lit]
        gain = np.square(np.abs(paths.amplitude))
        power = gain * np.square(norm_tx * norm_rx)[:, 0]
        apart_rad = 2 * np.pi / n_bins * (paths.delay_bins[:, None] - paths.delay_bins)
        reach = (power > power[:, None]) * np.square(diric(apart_rad, n_bins)) * gain
        return power, (reach * by_elements).sum(axis=1), (reach * np.reshape(turned, reach.shape)).sum(axis=1)

    def lost_information(self, sweep: CompressedSweep, paths: PathParameters) -> FloatArray:
        """Half the Fisher information (path, column, path, column) that the unknown phases of pairs take.

        Columns are the real and imaginary part of the amplitude, delay, and angles of departure and arrival, as in
        `Solution.information`.
        """
        n = len(paths)
        tx, rx = self._tangents(paths)
        wave = sweep.delay_response(paths.delay_bins)
        gram = np.einsum("iab,jb->iaj", wave, wave[:, 0])
        response = pair_products(tx[:, 0], rx[:, 0])
        amplitude = paths.amplitude[:, None] * response
        against = np.einsum("iaj,jp->iap", gram, amplitude)  # of each wave and its slope with the signal of a pair
        energy = np.einsum("ip,ip->p", amplitude.conj(), against[:, 0]).real
        matched = response.conj() * against[:, 0]
        columns = [matched.imag, -matched.real, (amplitude.conj() * against[:, 1]).imag]
        for end, other, is_tx in ((tx, rx, True), (rx, tx, False)):
            for slope in range(1, end.shape[1]):
                ends = end[:, slope], other[:, 0]
                pair = pair_products(*(ends if is_tx else ends[::-1]))
                columns.append(((paths.amplitude[:, None] * pair).conj() * against[:, 0]).imag)
        variance = self.errors.phase_variance.ravel()
        share = 2 * variance / (2 * energy * variance + 1)
        rows = np.stack(columns, axis=1).reshape(n * len(columns), -1)
        return np.asarray((rows * share @ rows.T).reshape(n, len(columns), n, len(columns)))

    def _tangents(self, paths: PathParameters) -> tuple[ComplexArray, ComplexArray]:
        """Responses and slopes (path, 1 + angle, beam) of both ends, those of the RX over the noise amplitude."""
        rx = _tangents(self.rx, paths.aoa_rad) / np.sqrt(self.noise_mw)
        return _tangents(self.tx, paths.aod_rad), rx


def _tangents(manifold: Manifold, angles_rad: FloatArray) -> ComplexArray:
    """Tangents at directions (path, angle), which may have an elevation that the beams hide."""
    if angles_rad.shape[1] > manifold.n_angles:
        manifold = manifold.with_hidden_elevation()
    return manifold.tangents(angles_rad)
