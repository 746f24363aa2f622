"""Self-calibration: the true responses of both arrays from paths of unknown directions.

Where phases hold from beam pair to beam pair, or can be tracked, all paths of some stops are fitted together with
the elements of both arrays and their coupling (`joint.py`): paths of many directions share the elements. Where
phases are lost, or where the factors of beams are wanted, paths that stand alone in their delay cell tell
(`rank_one.py`).

Gauge: a common complex factor belongs to the path gains, and a linear phase over the aperture rotates all
directions equally. Both are removed from the elements, so a constant pointing offset of a device remains
(`remaining.py`): only mapping and SLAM, which observe positions, can estimate it.
"""

from collections.abc import Iterable
from dataclasses import replace
from itertools import chain, islice

from scipy.stats import chi2

from estimation.channel.auto import few_paths
from estimation.channel.calibration.dominant import dominant_paths
from estimation.channel.calibration.ends import as_built, without_gauge
from estimation.channel.calibration.joint import joint_factors
from estimation.channel.calibration.normal import StopModel, StopSamples
from estimation.channel.calibration.rank_one import calibration_by_single_paths
from estimation.channel.calibration.record import Calibration, as_designed
from estimation.channel.calibration.remaining import error_power
from estimation.channel.calibration.strong import strong_paths
from estimation.channel.config import MaximumLikelihoodConfig, SelfCalibrationConfig
from estimation.channel.estimate import blind_ends, unusable
from estimation.channel.incoherent.paths import fit_incoherent
from estimation.execution import one_blas_thread
from scenes.record import concatenate
from sim.observation import BeamSweep
from sim.signal.arrays.codebook import Codebook

JUDGED_STOPS = 2  # that say whether arrays differ from their design
SHOWN_LEVEL = 3e-3  # power of the error of an element that calls for calibration: an error of 5 %
CHANCE = 1e-3  # that elements without errors would seem to have some


def self_calibrate(
    sweeps: Iterable[BeamSweep],
    config: SelfCalibrationConfig | None = None,
    likelihood: MaximumLikelihoodConfig | None = None,
) -> Calibration:
    """Calibrate both arrays of a link from the sweeps of several stops, which are read one at a time.

    With `use = "auto"` the arrays stay as designed where neither the magnitudes of the first stops show errors of
    elements, nor all paths of these stops together, nor those of all stops. `likelihood` has the settings of the
    fits.

    Raises `ValueError` if there are no sweeps, or if `use = "always"` and no path tells.
    """
    config = config or SelfCalibrationConfig(use="always")
    likelihood = likelihood or MaximumLikelihoodConfig()
    sweeps, is_sure = iter(sweeps), config.use == "always"
    first = list(islice(sweeps, JUDGED_STOPS))
    if not first:
        raise ValueError("self_calibration: no sweeps, at least 2 stops are needed")
    books = first[0].tx_codebook, first[0].rx_codebook
    with one_blas_thread():
        if not is_sure and not any(_magnitudes_show_errors(sweep, likelihood) for sweep in first):
            return as_designed(*books)
        strong, single = [], []
        for number, sweep in enumerate(chain(first, sweeps), 1):
            found = _strong_paths(sweep, likelihood, config)
            if found is None:
                single.append(dominant_paths(sweep, config.min_snr_db))
            else:
                strong.append(found)
            if number == len(first) and strong and not is_sure:
                some = _by_all_paths(strong, books, config, is_sure=False)
                if not some.n_paths:
                    return some
        if strong:
            return _by_all_paths(strong, books, config, is_sure=is_sure)
        try:
            return calibration_by_single_paths(concatenate(single, "path"), books, config)
        except ValueError:
            if is_sure:
                raise
            return as_designed(*books)


def _magnitudes_show_errors(sweep: BeamSweep, likelihood: MaximumLikelihoodConfig) -> bool:
    """Whether the magnitudes of a few paths are likely to have errors of elements, or of other paths near them."""
    if not _is_usable(sweep):
        return False
    return fit_incoherent(replace(sweep, clock=None), few_paths(likelihood)).element_error > SHOWN_LEVEL


def _is_usable(sweep: BeamSweep) -> bool:
    return not unusable(sweep) and not blind_ends(sweep)


def _strong_paths(
    sweep: BeamSweep, likelihood: MaximumLikelihoodConfig, config: SelfCalibrationConfig
) -> tuple[StopSamples, StopModel] | None:
    """The strong paths of a stop; None where phases are lost, or where beams are to be calibrated."""
    if config.errors != "elements" or not _is_usable(sweep):
        return None
    return strong_paths(sweep, likelihood.model_copy(update={"max_paths": config.max_paths}))


def _by_all_paths(
    stops: list[tuple[StopSamples, StopModel]],
    books: tuple[Codebook, Codebook],
    config: SelfCalibrationConfig,
    *,
    is_sure: bool,
) -> Calibration:
    """The elements and the coupling that explain all paths; as designed where they are small or by chance."""
    samples, models = zip(*stops, strict=True)
    found = joint_factors(samples, models, books, config.prior_std, config.turns)
    factors = [without_gauge(book, own) for book, own in zip(books, (found.tx, found.rx), strict=True)]
    elements = [own[: book.size("element")] for book, own in zip(books, factors, strict=True)]
    is_small = max(error_power(book, own) for book, own in zip(books, elements, strict=True)) < SHOWN_LEVEL
    if not is_sure and (is_small or found.gain < chi2.isf(CHANCE, found.n_parameters) / 2):
        return as_designed(*books)
    tx, rx = (as_built(book, own) for book, own in zip(books, factors, strict=True))
    return Calibration(
        tx_codebook=tx,
        rx_codebook=rx,
        tx_element=elements[0],
        rx_element=elements[1],
        n_paths=sum(len(model.gain) for model in models),
        is_coherent=True,
        misfit=found.misfit,
    )
