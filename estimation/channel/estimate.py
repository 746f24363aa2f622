"""Channel estimation of one stop: one function for all methods, one record as the result of each."""

from dataclasses import replace
from typing import get_args

import numpy as np

from estimation.channel.assemble import assemble_estimate
from estimation.channel.auto import fit_auto
from estimation.channel.beam_power_map import summed_power
from estimation.channel.coherent.diffuse import fit_over_background
from estimation.channel.coherent.plan import nominal_manifold
from estimation.channel.config import ChannelConfig, MethodName
from estimation.channel.fit import PathFit
from estimation.channel.incoherent.paths import IncoherentFit, fit_incoherent
from estimation.channel.power.paths import estimate_power
from estimation.channel.record import (
    ChannelEstimate,
    ChannelEstimator,
    EstimateStatus,
    check_estimate,
    empty_estimate,
)
from estimation.execution import one_blas_thread
from scenes.arguments import need
from sim.observation import BeamSweep
from sim.signal.arrays.codebook import Codebook

RANK_TOLERANCE = 1e-6  # singular values of beam weights below this share of the largest are rounding errors
NUMBERS_PER_PATH = 5  # real numbers: delay, two angles, complex gain


def estimate_channel(
    sweep: BeamSweep, method: str | ChannelEstimator | None = None, config: ChannelConfig | None = None
) -> ChannelEstimate:
    """The paths of one stop.

    Parameters
    ----------
    sweep
        What the receiver has of the stop.
    method
        `coherent`: joint maximum likelihood, phases known over the sweep; `incoherent`: the same with an unknown
        phase per beam pair; `auto`: a test on the data chooses; `power`: beam powers over delay alone; or a
        function of the sweep. Default: the method in `config`.
    config
        By default all defaults: a sweep knows no campaign. `Campaign.estimate` takes those of its campaign.

    Returns
    -------
    ChannelEstimate
        `status` is 'ok', 'no paths', 'limited' if there were more paths than may be reported, or 'refused' if
        the sweep is empty, all zero or not finite; `reason` says what was chosen and why, or what is wrong.

    Raises `ValueError` For an unknown method, and if a given function does not return a channel estimate of this
    stop.
    """
    need("sweep", sweep, BeamSweep)
    need("config", config, ChannelConfig, type(None))
    config = config or ChannelConfig()
    method = config.method if method is None else method
    if callable(method):
        return checked_estimate(method(sweep), sweep, getattr(method, "__name__", "estimator"))
    if method not in get_args(MethodName):
        raise ValueError(f"method = '{method}': must be auto, coherent, incoherent, power or a function")
    wrong = unusable(sweep)
    if wrong:
        return empty_estimate(sweep.stop, method, EstimateStatus.REFUSED, wrong)
    blind = blind_ends(sweep)
    with one_blas_thread():
        if method != "power" and not blind:
            return _maximum_likelihood(sweep, method, config)
        estimate = estimate_power(sweep, config.power, config.los)
    reason = f"{blind}; beam powers hold all observable information" if blind else ""
    return replace(_limited(estimate, config.power.max_paths), reason=reason) if reason else estimate


def checked_estimate(estimate: object, sweep: BeamSweep, name: str) -> ChannelEstimate:
    """The result of a user's function, if it is a channel estimate of the sweep's stop; else `ValueError`."""
    if not isinstance(estimate, ChannelEstimate):
        raise ValueError(f"estimator = '{name}': returned {type(estimate).__name__}, a ChannelEstimate is needed")
    if estimate.stop != sweep.stop:
        raise ValueError(f"estimator = '{name}': returned stop {estimate.stop}, the sweep is of stop {sweep.stop}")
    check_estimate(estimate, 1 / float(np.diff(sweep.frequency_offset_hz[:2])[0]))
    return estimate


def _maximum_likelihood(sweep: BeamSweep, method: str, config: ChannelConfig) -> ChannelEstimate:
    settings = config.maximum_likelihood
    capacity = path_capacity(sweep)
    if settings.max_paths > capacity:
        settings = settings.model_copy(update={"max_paths": capacity})
    if method == "coherent":
        fit, reason = fit_over_background(sweep, settings), ""
    elif method == "incoherent":
        fit = fit_incoherent(sweep, settings)
        reason = fit.caveat
    else:
        chosen = fit_auto(sweep, settings)
        fit, reason = chosen.fit, chosen.reason
    most = settings.max_incoherent_paths if isinstance(fit, IncoherentFit) else settings.max_paths
    fit = _widened(fit, config)
    tx, rx = nominal_manifold(sweep.tx_codebook), nominal_manifold(sweep.rx_codebook)
    return _limited(assemble_estimate(sweep, fit, tx, rx, config.los, method, reason), most)


def _widened(fit: PathFit, config: ChannelConfig) -> PathFit:
    """The fit with the floors of the settings added to its covariances."""
    std = np.full(fit.size("parameter"), np.deg2rad(config.angle_std_floor_deg))
    std[0] = 1e-9 * config.delay_std_floor_ns
    std[fit.size("parameter") - fit.size("doppler") :] = 0.0
    return replace(fit, covariance=fit.covariance + np.diag(std**2))


def path_capacity(sweep: BeamSweep) -> int:
    """Largest number of paths (delay, two angles and a complex gain each) that the samples can determine."""
    n_real = 2 * _rank(sweep.tx_codebook) * _rank(sweep.rx_codebook) * int(sweep.samples.shape[2])
    return max(1, n_real // (2 * NUMBERS_PER_PATH))


def _limited(estimate: ChannelEstimate, max_paths: int) -> ChannelEstimate:
    """The estimate, with status and reason 'limited' if it holds as many paths as it may."""
    if len(estimate) < max_paths:
        return estimate
    reason = f"max_paths = {max_paths} reached: there may be more"
    joined = "; ".join(part for part in (estimate.reason, reason) if part)
    return replace(estimate, status=EstimateStatus.LIMITED, reason=joined)


def unusable(sweep: BeamSweep) -> str:
    """The reason why the samples are useless; empty if they are usable."""
    shape = sweep.samples.shape
    if min(shape) == 0 or shape[2] < 2:
        return f"samples has shape {shape}: at least 1 x 1 beams and 2 subcarriers are needed"
    power = summed_power(sweep)
    if not np.isfinite(power).all():
        m, n = np.argwhere(~np.isfinite(power))[0]
        return f"samples of beam pair ({m}, {n}) are not finite"
    if not power.any():
        return "samples are all zero"
    return ""


def blind_ends(sweep: BeamSweep) -> str:
    """The ends that cannot distinguish directions (one beam, or identical beams); empty if there is none."""
    blind = [
        f"{name} beams of rank 1: no angle of {angle}"
        for name, book, angle in (("TX", sweep.tx_codebook, "departure"), ("RX", sweep.rx_codebook, "arrival"))
        if _rank(book) == 1
    ]
    return ", ".join(blind)


def _rank(codebook: Codebook) -> int:
    """Number of linearly independent beams."""
    value = np.linalg.svd(nominal_manifold(codebook).weights(), compute_uv=False)
    return int((value > RANK_TOLERANCE * value[0]).sum())
