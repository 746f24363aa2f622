"""Errors that differ from beam pair to beam pair: noise in proportion to the signal, phases known only so well.

A compressed sweep has no beam pairs any more, and its noise is taken as white. Phase noise and converters add
noise to the pairs of strong signals. A path is lit in a few pairs, so the noise of these pairs, weighted by what
each gives to the path, is the noise that it competes with. Unknown phases of pairs are further parameters with a
prior: they take information from the paths (a Schur complement).
"""

from dataclasses import dataclass

import numpy as np

from estimation.channel.model.compress import CompressedSweep
from estimation.channel.model.factors import pair_products
from estimation.channel.model.manifold import Manifold
from estimation.channel.model.path_model import PathParameters
from scenes.record import ComplexArray, FloatArray


@dataclass(frozen=True)
class PairErrors:
    """Errors (tx_beam, rx_beam) of beam pairs.

    Attributes
    ----------
    excess : noise power beyond that of the receiver, over the nominal one
    phase_variance : of the phases in rad^2, before the pair's own samples
    """

    excess: FloatArray
    phase_variance: FloatArray


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
        return np.asarray(1 + beyond / np.maximum(energy, np.finfo(float).tiny))

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
        share = 2 / (2 * energy + 1 / self.errors.phase_variance.ravel())
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
