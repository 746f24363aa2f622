"""Choose the likelihood of a sweep: test whether the phases of its beam pairs are coherent.

A coherent fit gains resolution and 2 dB of detection, but unknown phases ruin it. So the incoherent fit comes
first, of the strongest paths. It estimates the phase of every beam pair that a path illuminates. A constant
frequency offset makes these phases a linear ramp over the TX beams and over the RX beams, in either order of a
sweep. The rms residual of that ramp, corrected for noise, decides: if it is small, the ramp is removed and the
sweep is fitted coherently.

Phases that wander are tracked if a pair's neighbours tell its phase (`track_phases`); phases and coherent paths
are then estimated in turn. Where they do not, the incoherent fit of all paths is the answer.

Where many paths share beam pairs and delays, a few of them do not explain the phases. Then all paths of a coherent
fit are the reference, and the phases of the pairs against their sum decide. What even this fit leaves out turns
phases and scales magnitudes alike; unknown phases leave the magnitudes as they are. A few coherent paths tell
whether such a fit is worth its time: before phases are tracked, and where no track of them is found.

A sweep with a clock is fitted coherently with Doppler shifts first: a frequency offset is one common to all paths.
If the phases do not follow that fit, the world is taken as frozen.
"""

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from estimation.channel.coherent.diffuse import fit_over_background
from estimation.channel.coherent.pair_errors import PairErrors
from estimation.channel.coherent.plan import nominal_manifold
from estimation.channel.config import MaximumLikelihoodConfig
from estimation.channel.fit import PathFit
from estimation.channel.incoherent.clock_drift import WANDERING, ClockDrift, without_drift
from estimation.channel.incoherent.paths import IncoherentFit, fit_incoherent
from estimation.channel.incoherent.response_errors import ResponseErrors
from estimation.channel.phases.drift import drift_against, may_drift, settled_drift, with_drift_errors
from estimation.channel.phases.pairs import PairPhases, phases_against, phases_of, without_phases
from estimation.channel.phases.ramp import LARGEST_RESIDUAL_RAD, PhaseRamp, fit_phase_ramp, without_phase_ramp
from estimation.channel.phases.track import PhaseTrack, track_phases, wanders
from sim.observation import BeamSweep
from sim.signal.waveform.prs import PREFIX_SHARE

DOUBTFUL_RAD = np.deg2rad(45.0)  # residual of a few paths up to which all paths decide; random phases show 104 deg
_TELLING_PATHS = 12  # strongest paths that are fitted first: the others change little if phases are coherent
_TRACKING_PATHS = (12, 12, 30)  # paths of the fits between which phases are tracked, before the fit of all
_TRACKED_RAD = np.deg2rad(20.0)  # median error of tracked phases up to which pairs add up: they lose 0.5 dB

NO_RAMP = PhaseRamp(0.0, 0.0, 0.0, 0.0, 0.0, 0)


@dataclass(frozen=True)
class AutoFit:
    """A fit, the chosen mode, and the reason.

    `frequency_offset_hz` causes the ramp, if each pair takes one symbol of the sounded spacing. `steady` is the
    sweep that the paths explain, without drift and phases, with the errors of its pairs where they were tracked.
    """

    fit: PathFit
    mode: Literal["coherent", "tracked", "incoherent"]
    ramp: PhaseRamp
    frequency_offset_hz: float
    reason: str
    steady: BeamSweep
    pair_errors: PairErrors | None = None


def fit_auto(sweep: BeamSweep, config: MaximumLikelihoodConfig | None = None) -> AutoFit:
    """Paths of one stop by the likelihood that its phases allow; errors are those of `fit_incoherent`."""
    config = config or MaximumLikelihoodConfig()
    few = few_paths(config)
    if sweep.clock is not None:
        ramp = fit_phase_ramp(phases_against(sweep, fit_over_background(sweep, few)))
        is_open = ramp.residual_rad <= DOUBTFUL_RAD
        if is_open and (moving := _coherent(sweep, 0.0, NO_RAMP, config, None, is_sure=False)) is not None:
            return moving
        sweep = replace(sweep, clock=None)
    incoherent = fit_incoherent(sweep, few)
    drift_s = incoherent.drift_s
    steady = without_drift(sweep, drift_s)
    ramp = fit_phase_ramp(phases_of(incoherent))
    start = ramp if ramp.n_pairs else fit_phase_ramp(phases_of(incoherent, all_usable=True))
    is_doubtful = start.residual_rad <= DOUBTFUL_RAD or not ramp.n_pairs
    if ramp.is_coherent:
        coherent = _coherent(sweep, drift_s, ramp, config, incoherent, is_sure=True)
    elif is_doubtful:
        limit_rad = np.inf if start.residual_rad <= DOUBTFUL_RAD else DOUBTFUL_RAD
        coherent = _coherent_by_few(sweep, drift_s, start, config, incoherent, limit_rad)
    else:
        coherent = _coherent_by_few(sweep, drift_s, NO_RAMP, config, incoherent, LARGEST_RESIDUAL_RAD)
    tracked = _tracked_from(steady, incoherent, config) if coherent is None else None
    if coherent is None and tracked is None and not is_doubtful:
        coherent = _coherent_by_few(sweep, drift_s, start, config, incoherent, DOUBTFUL_RAD)
    if tracked is not None:
        joint = fit_phase_ramp(tracked.pairs)
        if joint.is_coherent:
            coherent = _coherent(sweep, drift_s + tracked.drift.per_pair, joint, config, incoherent, is_sure=False)
        if coherent is None:
            tracked = _tracked(steady, tracked.pairs, config, (config.max_paths,), incoherent, tracked.drift)
    if coherent is not None:
        return coherent
    if tracked is not None:
        return _tracked_fit(sweep, tracked, ramp, incoherent)
    offset_hz = _frequency_offset_hz(sweep, ramp)
    has_more = few.max_paths <= len(incoherent) < config.max_incoherent_paths
    incoherent = fit_incoherent(sweep, config if has_more else few, drift_odds=WANDERING)
    words = "; ".join(part for part in (_words(ramp, offset_hz), incoherent.caveat) if part)
    return AutoFit(incoherent, "incoherent", ramp, offset_hz, "incoherent: " + words, steady)


def few_paths(config: MaximumLikelihoodConfig, most: int = _TELLING_PATHS) -> MaximumLikelihoodConfig:
    """The settings of a fit of the strongest paths alone."""
    return config.model_copy(update={"max_paths": min(config.max_paths, most)})


def _coherent_by_few(
    sweep: BeamSweep,
    drift_s: float,
    ramp: PhaseRamp,
    config: MaximumLikelihoodConfig,
    incoherent: IncoherentFit,
    limit_rad: float,
) -> AutoFit | None:
    """The coherent fit if a few coherent paths, without a ramp or without this one, show at most this residual."""
    joint = _joint_ramp(without_drift(sweep, drift_s), ramp, few_paths(config))
    if not joint.residual_rad <= limit_rad:
        return None
    return _coherent(sweep, drift_s, joint, config, incoherent, is_sure=False)


def _coherent(
    sweep: BeamSweep,
    drift_s: float,
    ramp: PhaseRamp,
    config: MaximumLikelihoodConfig,
    incoherent: IncoherentFit | None,
    *,
    is_sure: bool,
) -> AutoFit | None:
    """The coherent fit without the ramp; None if it has no paths, or if its phases do not hold and must.

    A drift of the clock that pairs show one by one is found again with some coherent paths: other paths in a pair
    look like one. One that pairs do not show, all paths do. Phases that hold may still wander by a few degrees:
    then they are tracked, with the errors of elements that the `incoherent` fit shows, and must be followed where
    nothing else says that they hold. Without such a fit they are not. Noise in proportion to the signal changes
    the paths: they are fitted again with it.
    """
    drift = ClockDrift()
    if drift_s:
        drift = _drift_by_some(sweep, ramp, config, drift_s)
    steady = without_drift(sweep, drift.per_pair)
    turned = without_phase_ramp(steady, ramp.tx_step_rad, ramp.rx_step_rad)
    fit = fit_over_background(turned, config)
    if not len(fit):
        return None
    pairs = phases_against(steady, fit)
    if not is_sure:
        ramp = fit_phase_ramp(pairs)
    if not ramp.is_coherent:
        return None
    if incoherent is not None and not drift_s and may_drift(turned, fit):
        found = _drift_by_some(sweep, ramp, config, 0.0)
        if found.is_likely:
            return _coherent(sweep, found.per_pair, ramp, config, incoherent, is_sure=is_sure)
    if incoherent is not None and wanders(pairs):
        tracked = _tracked(sweep, pairs, config, (config.max_paths,), incoherent, drift)
        if tracked is not None or not is_sure:
            return None if tracked is None else _tracked_fit(sweep, tracked, ramp, incoherent)
    errors = None
    if incoherent is not None and pairs.adds_noise:
        errors = PairErrors(pairs.noise_excess, np.zeros(pairs.snr.shape))
        fit = fit_over_background(turned, config, pair_errors=errors)
        if not len(fit):
            return None
    offset_hz = _frequency_offset_hz(sweep, ramp)
    certain = with_drift_errors(steady, fit, drift)
    return AutoFit(certain, "coherent", ramp, offset_hz, "coherent: " + _words(ramp, offset_hz), turned, errors)


def _drift_by_some(
    sweep: BeamSweep, ramp: PhaseRamp, config: MaximumLikelihoodConfig, start_s: float
) -> ClockDrift:
    """The drift of the clock near a first value, with the strongest coherent paths."""
    some = few_paths(config, _TRACKING_PATHS[-1])
    back = without_phase_ramp(sweep, ramp.tx_step_rad, ramp.rx_step_rad)
    return settled_drift(back, lambda steady: fit_over_background(steady, some), start_s)


@dataclass(frozen=True)
class _Tracked:
    """A coherent fit with tracked phases, the sweep without them, and its phases against the paths."""

    fit: PathFit
    track: PhaseTrack
    turned: BeamSweep
    errors: PairErrors
    pairs: PairPhases
    drift: ClockDrift  # of the sweep that was given


def _tracked_fit(sweep: BeamSweep, tracked: _Tracked, ramp: PhaseRamp, incoherent: IncoherentFit) -> AutoFit:
    """The tracked fit of a sweep, its directions as uncertain as the errors of elements make them."""
    ends = nominal_manifold(sweep.tx_codebook), nominal_manifold(sweep.rx_codebook)
    fit = ResponseErrors(mean=incoherent.element_error).added_to(tracked.fit, *ends)
    words = "coherent, pair phases tracked: " + _track_words(tracked.track)
    offset_hz = _frequency_offset_hz(sweep, ramp)
    return AutoFit(fit, "tracked", ramp, offset_hz, words, tracked.turned, tracked.errors)


def _tracked_from(sweep: BeamSweep, incoherent: IncoherentFit, config: MaximumLikelihoodConfig) -> _Tracked | None:
    """Tracked phases from those of an incoherent fit: without its ambiguous directions first, else with them.

    A few paths may know their pairs' phases poorly: those that are not yet found turn them. More paths decide.
    """
    found = _tracked(sweep, phases_of(incoherent), config, _TRACKING_PATHS, incoherent, limit_rad=DOUBTFUL_RAD)
    if found is None and incoherent.is_ambiguous.any():
        pairs = phases_of(incoherent, all_usable=True)
        found = _tracked(sweep, pairs, config, _TRACKING_PATHS, incoherent, limit_rad=DOUBTFUL_RAD)
    return found


def _tracked(
    sweep: BeamSweep,
    pairs: PairPhases,
    config: MaximumLikelihoodConfig,
    limits: tuple[int, ...],
    incoherent: IncoherentFit,
    drift: ClockDrift | None = None,
    *,
    limit_rad: float = _TRACKED_RAD,
) -> _Tracked | None:
    """The coherent paths of a sweep with tracked pair phases; None where they are not known to `limit_rad`.

    Phases and paths are estimated in turn, with more and more paths: those that are not yet found turn the phases
    of the pairs that they light. What the paths leave of a pair is its noise. The drift of the clock is found in
    the same turns, unless the `drift` is given.
    """
    found, known = None, drift or ClockDrift()
    for limit in limits:
        track = track_phases(pairs)
        if track.error_rad > limit_rad:
            return None
        steady = without_drift(sweep, known.per_pair)
        turned = without_phases(steady, track.phase_rad)
        level = min(incoherent.element_floor, incoherent.element_error)  # few lobes show it: rather too low
        errors = PairErrors(pairs.noise_excess, track.variance, level)
        fit = fit_over_background(turned, few_paths(config, limit), pair_errors=errors)
        if not len(fit):
            return None
        pairs = phases_against(steady, fit)
        certain = with_drift_errors(steady, fit, known)
        known = drift or drift_against(steady, fit, known, track.drift_odds)
        found = _Tracked(certain, track, turned, errors, pairs, known)
    return found


def _joint_ramp(sweep: BeamSweep, ramp: PhaseRamp, few: MaximumLikelihoodConfig) -> PhaseRamp:
    """The ramp against the sum of a few coherent paths.

    They are fitted to the sweep as it is; where its phases do not hold, also without the given ramp.
    A ramp that turns the phases over the whole sweep by less than the limit is left: undetected paths make such
    ramps.
    """
    found = []
    for steps in ((0.0, 0.0), *([(ramp.tx_step_rad, ramp.rx_step_rad)] if ramp.n_pairs else ())):
        back = without_phase_ramp(sweep, *steps)
        rest = fit_phase_ramp(phases_against(back, fit_over_background(back, few)))
        found.append(
            replace(rest, tx_step_rad=rest.tx_step_rad + steps[0], rx_step_rad=rest.rx_step_rad + steps[1])
        )
        if rest.residual_rad <= DOUBTFUL_RAD:  # no ramp comes first: a ramp may stand for wrong directions
            break
    best = min(found, key=lambda one: one.residual_rad if one.n_pairs else np.inf)
    best = best if best.n_pairs else ramp
    over_sweep = np.abs([best.tx_step_rad, best.rx_step_rad]) * sweep.samples.shape[:2]
    return best if over_sweep.max() > LARGEST_RESIDUAL_RAD else replace(best, tx_step_rad=0.0, rx_step_rad=0.0)


def _frequency_offset_hz(sweep: BeamSweep, ramp: PhaseRamp) -> float:
    """Frequency offset that causes a ramp if each pair takes one symbol of the sounded spacing."""
    spacing_hz = float(np.ptp(sweep.frequency_offset_hz)) / (sweep.samples.shape[2] - 1)
    return ramp.frequency_offset_hz(sweep.samples.shape[1], (1 + PREFIX_SHARE["normal"]) / spacing_hz)


def _words(ramp: PhaseRamp, offset_hz: float) -> str:
    if not ramp.n_pairs:
        return "too few beam pairs have a phase to test"
    limit = np.rad2deg(LARGEST_RESIDUAL_RAD)
    text = (
        f"phases of {ramp.n_pairs} beam pairs follow a ramp of {np.rad2deg(ramp.tx_step_rad):.3g} deg per TX beam"
        f" and {np.rad2deg(ramp.rx_step_rad):.3g} deg per RX beam ({offset_hz:.4g} Hz at one symbol per pair)"
        f" with a residual of {np.rad2deg(ramp.residual_rad):.2g} deg rms, at most"
        f" {np.rad2deg(ramp.upper_rad):.2g} deg; the limit is {limit:.0f} deg"
    )
    if ramp.upper_rad > LARGEST_RESIDUAL_RAD and np.isfinite(ramp.walk_rad):
        text += f"; from one pair to the next they change by {np.rad2deg(ramp.walk_rad):.2g} deg rms"
    return text


def _track_words(track: PhaseTrack) -> str:
    step, own, error = np.rad2deg([track.step_rad, track.own_rad, track.error_rad])
    return (
        f"phases of {track.n_pairs} beam pairs walk by {step:.2g} deg from pair to pair and differ by"
        f" {own:.2g} deg beside it; half of all pairs are known to {error:.2g} deg"
    )
