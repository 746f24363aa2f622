"""The result of self-calibration, and which stops it takes: apart from the search, which is slow to import."""

from dataclasses import dataclass, replace

import numpy as np

from scenes.record import ComplexArray, IntArray, Record, array
from sim.observation import BeamSweep
from sim.signal.arrays.codebook import Codebook


@dataclass(frozen=True)
class Calibration(Record):
    """Result of self-calibration: both codebooks with the responses as built in their weights."""

    tx_codebook: Codebook
    rx_codebook: Codebook
    tx_element: ComplexArray = array("tx_element", dtype=complex, doc="response over the designed one")
    rx_element: ComplexArray = array("rx_element", dtype=complex, doc="response over the designed one")
    n_paths: int = array(dtype=int, doc="number of paths used; 0 if the arrays are as designed")
    is_coherent: bool = array(dtype=bool, doc="whether phases between beam pairs were used")
    misfit: float = array(doc="mean share of a path's power that the calibrated arrays do not explain")

    def applied(self, sweep: BeamSweep) -> BeamSweep:
        """The sweep with the calibrated codebooks in place of the designed ones."""
        return replace(sweep, tx_codebook=self.tx_codebook, rx_codebook=self.rx_codebook)


def as_designed(tx_codebook: Codebook, rx_codebook: Codebook) -> Calibration:
    """The calibration of arrays that show no errors: from no path."""
    tx, rx = (np.ones(book.size("element"), complex) for book in (tx_codebook, rx_codebook))
    return Calibration(tx_codebook, rx_codebook, tx, rx, n_paths=0, is_coherent=False, misfit=0.0)


def spread_rows(n_stops: int, n_chosen: int) -> IntArray:
    """Rows of some stops, spread evenly over `n_stops`: sorted, each once."""
    return np.unique(np.linspace(0, n_stops - 1, n_chosen).round().astype(int))
