"""Maximum likelihood with known beam patterns when every beam pair has an unknown phase.

Real sweeps lose the phase between beam pairs to phase noise and frequency offsets. Within a pair it is coherent
over all subcarriers, so delays are as accurate as with phases; directions follow from the amplitudes over the
pairs, at almost no loss for an isolated path. Compare SAGE with a random phase per scan direction, arXiv
2212.11756; here the phases are marginalised, not estimated.
"""

from dataclasses import dataclass, fields, replace

import numpy as np

from estimation.channel.coherent.plan import nominal_manifold
from estimation.channel.companions import companions
from estimation.channel.config import MaximumLikelihoodConfig
from estimation.channel.fit import PathFit, empty_fit
from estimation.channel.incoherent.ambiguity import resolve_ambiguous_directions
from estimation.channel.incoherent.clock_drift import DRIFTING, mean_pairs
from estimation.channel.incoherent.likelihood import LinkBeams, Score
from estimation.channel.incoherent.screen import Screen
from estimation.channel.incoherent.search import IncoherentSearch
from estimation.channel.incoherent.spectrum import delay_spectrum
from estimation.channel.incoherent.threshold import DetectionLevels, null_tail
from estimation.channel.model.compress import check_sweep
from estimation.channel.model.crb import path_covariance
from estimation.channel.model.manifold import Manifold
from scenes.pose import wrap_angle
from scenes.record import BoolArray, FloatArray, IntArray, array
from sim.observation import BeamSweep

UNRESOLVED_VARIANCE = 1.0  # of a delay in bins, above which paths in one place share what is known of them


@dataclass(frozen=True)
class IncoherentFit(PathFit):
    """Paths, and the phases of the beam pairs.

    Phases between paths in different pairs are unobservable, hence NaN; a pair's is relative to its strongest
    path.
    """

    is_ambiguous: BoolArray = array(
        "path", dtype=bool, doc="magnitudes fit several directions; the covariance spans them"
    )
    pair_phase_rad: FloatArray = array("tx_beam", "rx_beam", unit="rad", doc="most likely phase of a pair")
    pair_snr: FloatArray = array(
        "tx_beam", "rx_beam", doc="energy of the paths in a pair over its noise, 0 without any path"
    )
    pair_residual: FloatArray = array(
        "tx_beam",
        "rx_beam",
        doc="residual energy at the paths' delays minus that of noise, over the noise, at least 0",
    )
    pair_path: IntArray = array("tx_beam", "rx_beam", dtype=int, doc="strongest path in a pair, -1 none")
    log_likelihood_ratio: float = array(doc="ratio of the paths to noise alone")
    drift_s: float = array(unit="s", doc="growth of all delays from one beam pair to the next, removed")
    element_error: float = array(doc="power of the error of an array element over its own, expected")
    element_floor: float = array(doc="the same, exceeded as often as not; 0 if noise may be all")

    @property
    def caveat(self) -> str:
        """What the covariances alone do not show; empty if there is nothing."""
        n, said = int(self.is_ambiguous.sum()), []
        if n:
            said.append(f"{n} of {len(self)} paths fit several directions equally by magnitudes alone")
        if self.drift_s:
            late_ns = 1e9 * self.drift_s * (self.pair_snr.size - 1)
            said.append(f"delays grow by {late_ns:.2g} ns over the sweep: the clock drifts, which is removed")
        return "; ".join(said)


def fit_incoherent(
    sweep: BeamSweep,
    config: MaximumLikelihoodConfig | None = None,
    tx_manifold: Manifold | None = None,
    rx_manifold: Manifold | None = None,
    drift_odds: float = DRIFTING,
) -> IncoherentFit:
    """Paths of one stop by maximum likelihood with one unknown phase per beam pair.

    Candidates are where amplitudes over many beam pairs rise together. They are fitted jointly with all other
    paths, and kept if the likelihood ratio exceeds what noise alone reaches with the configured probability; then
    the residual is searched.

    Parameters
    ----------
    sweep : the samples of one stop
    config : settings, the defaults if left out
    tx_manifold, rx_manifold : replace those of the nominal codebooks, such as by those of calibrated arrays
    drift_odds : of a clock that drifts, before the samples

    Raises `ValueError` For a sweep without beams, subcarriers or noise power, and for samples that are not
    finite; in one line.
    """
    config = config or MaximumLikelihoodConfig()
    check_sweep(sweep)
    tx = tx_manifold or nominal_manifold(sweep.tx_codebook)
    rx = rx_manifold or nominal_manifold(sweep.rx_codebook)
    spectrum = delay_spectrum(sweep)
    if not np.isfinite(spectrum.noise_mw).any():
        return _empty(sweep, empty_fit(tx.n_angles, rx.n_angles, "no_signal"))
    ends = LinkBeams(tx, rx, spectrum.noise_mw)
    screen = Screen.make(tx, rx, tx.grid(config.oversampling), rx.grid(config.oversampling), spectrum.noise_mw)
    levels = DetectionLevels(null_tail(tx, rx), config, spectrum.bin_s, spectrum.n_bins)
    search = IncoherentSearch(sweep, spectrum, ends, screen, levels, config, drift_odds=drift_odds)
    paths, at = search.run()
    if at is None:
        return _empty(sweep, empty_fit(tx.n_angles, rx.n_angles, "no_paths"))
    fit = _assemble(sweep, search, paths, at)
    is_lost = fit.covariance[:, 0, 0] > UNRESOLVED_VARIANCE * spectrum.bin_s**2
    return replace(fit, is_weak=companions(fit, tx, rx) | is_lost)


def _assemble(sweep: BeamSweep, search: IncoherentSearch, paths: FloatArray, at: Score) -> IncoherentFit:
    ends, spectrum = search.ends, search.spectrum
    paths, at, spread = resolve_ambiguous_directions(search.local, ends, paths, at)
    n, size = paths.shape
    # A clock bias can make the first delay negative: the last eighth of the period counts as negative.
    delay_bins = (paths[:, 0] + spectrum.n_bins / 8) % spectrum.n_bins - spectrum.n_bins / 8
    order = np.argsort(delay_bins, kind="stable")
    information = at.information.reshape(n, size, n, size)[order][:, :, order]
    paths, delay_bins, spread = paths[order], delay_bins[order], spread[order]
    block = _observable(np.einsum("iaib->iab", path_covariance(information))[:, :-2, :-2], spectrum.n_bins)
    if search.background is not None:
        block = block * search.background.covariance_factor(ends, paths)[:, None, None]
        block[:, 1:, 1:] += search.background.errors.angle_covariance(ends, paths)
    block = block + spread
    block[:, 0, 0] += search.drift.variance * np.square(mean_pairs(ends, paths))
    scale = np.concatenate([[spectrum.bin_s], np.ones(size - 3)])
    power = np.abs(ends.amplitudes(paths)) ** 2 * spectrum.n_bins
    shape = sweep.samples.shape[:2]
    pairs = search.local.pair
    phase, snr, residual = np.zeros((3, shape[0] * shape[1]))
    phase[pairs], snr[pairs] = np.angle(at.pair_phasor), at.pair_snr
    signal = search.local.signal(ends, paths) * at.pair_phasor
    residual[pairs] = np.square(np.abs(search.local.samples - signal)).sum(axis=0) - len(signal)
    n_tx = ends.tx.n_angles
    is_ambiguous = np.einsum("iaa->i", spread) > 0
    return IncoherentFit(
        delay_s=delay_bins * spectrum.bin_s,
        aod_rad=wrap_angle(paths[:, 1 : 1 + n_tx]),
        aoa_rad=wrap_angle(paths[:, 1 + n_tx : -2]),
        amplitude=np.exp(paths[:, -2]),
        phase_rad=np.full(n, np.nan),
        snr_db=10 * np.log10(power.max(axis=0)),
        covariance=block * scale[:, None] * scale,
        unresolved_probability=np.where(is_ambiguous, 1.0, 0.0),
        is_weak=np.zeros(n, bool),
        doppler_hz=np.zeros((n, 0)),
        seen_s=np.zeros(n),
        status="ok",
        is_ambiguous=is_ambiguous,
        pair_phase_rad=phase.reshape(shape),
        pair_snr=snr.reshape(shape),
        pair_residual=np.maximum(residual, 0.0).reshape(shape),
        pair_path=np.where(snr > 0, power.argmax(axis=1), -1).reshape(shape),
        log_likelihood_ratio=at.value,
        drift_s=search.drift_s,
        element_error=0.0 if search.background is None else search.background.errors.mean,
        element_floor=0.0 if search.background is None else search.background.errors.level,
    )


def _observable(covariance: FloatArray, n_bins: int) -> FloatArray:
    """Covariances (path, parameter, parameter) with unobservable parameters as uniform over period or circle."""
    uniform = np.full(covariance.shape[1], (2 * np.pi) ** 2 / 12)
    uniform[0] = n_bins**2 / 12
    lost = ~np.isfinite(np.einsum("iaa->ia", covariance))
    kept = np.where(lost[:, :, None] | lost[:, None], 0.0, covariance)
    return np.asarray(kept + np.where(lost, uniform, 0.0)[:, :, None] * np.eye(len(uniform)))


def _empty(sweep: BeamSweep, fit: PathFit) -> IncoherentFit:
    shape = sweep.samples.shape[:2]
    return IncoherentFit(
        **{field.name: getattr(fit, field.name) for field in fields(fit)},
        is_ambiguous=np.zeros(0, bool),
        pair_phase_rad=np.zeros(shape),
        pair_snr=np.zeros(shape),
        pair_residual=np.zeros(shape),
        pair_path=np.full(shape, -1),
        log_likelihood_ratio=0.0,
        drift_s=0.0,
        element_error=0.0,
        element_floor=0.0,
    )
