"""Errors of the arrays' responses: what they do to the directions of paths, and a noise that grows with the paths.

Elements with errors of their gains and phases, and quantised weights, give beams that differ from the codebook. An
error that is independent from element to element has a known covariance over the beams: it moves the directions of
all paths, and it adds a floor of side lobes below every path that weaker paths would fit. Its level is what the
magnitudes of strong paths show beyond the shift that their directions absorb.
"""

from dataclasses import astuple, dataclass, replace
from typing import Self

import numpy as np
from scipy.special import diric

from estimation.channel.fit import PathFit
from estimation.channel.incoherent.clock_drift import dominant_pairs
from estimation.channel.incoherent.likelihood import LinkBeams, paths_towards
from estimation.channel.incoherent.spectrum import delay_waves
from estimation.channel.model.manifold import Manifold
from estimation.distributions import chi_square_log_density, chi_square_quantile
from scenes.record import ComplexArray, FloatArray, IntArray

MAIN_LOBE = 0.1  # of the power of the best beam: beams whose magnitudes show errors
TELLING = 0.01  # the same of beams that tell a direction: those beside the one that points there have little power
SIGNIFICANT_STD = 3.0  # by which magnitudes exceed the noise where they show errors
LARGEST_LEVEL = 0.3  # power of the error of an element: a third of its own, 30 deg or 5 dB
LEVELS = np.concatenate([[0.0], np.geomspace(1e-4, LARGEST_LEVEL, 36)])
BEFORE = np.append(0.5, np.full(36, 0.5 / 36))  # probability of each: no errors, or errors of an unknown scale
MISLED = 0.1  # share of the paths whose magnitudes a close path changes too, by up to
MISLED_BY = 1e4  # the noise or the errors, on a logarithmic scale
REGULAR = 1e-9  # relative information on an angle below which magnitudes do not show it


@dataclass(frozen=True)
class ResponseErrors:
    """Power of the error of an element over its own: the level, equal at both ends.

    The few magnitudes of one main lobe show a level poorly; so both ends are taken as alike.

    Attributes
    ----------
    level : exceeded as often as not, or 0 if noise may be all: for the floor, which hides paths
    mean : over all levels, as likely as the magnitudes make them: for covariances
    """

    level: float = 0.0
    mean: float = 0.0

    def at_most(self, level: float) -> Self:
        """These errors, or the largest credible ones."""
        return replace(self, level=min(self.level, level), mean=min(self.mean, level))

    def noise(self, ends: LinkBeams, paths: FloatArray, n_bins: int) -> FloatArray:
        """Power (path,) over the noise of the floors of all other paths, as it affects paths (path, parameter)."""
        if not len(paths) or not self.level:
            return np.zeros(len(paths))
        floor = n_bins * ends.energy_shares(paths).T @ self._floor(ends, paths)
        apart_rad = 2 * np.pi / n_bins * (paths[:, None, 0] - paths[:, 0])
        overlap = np.square(diric(apart_rad, n_bins))
        np.fill_diagonal(overlap, 0.0)
        return np.asarray((floor * overlap).sum(axis=1))

    def angle_covariance(self, ends: LinkBeams, paths: FloatArray) -> FloatArray:
        """Covariance (path, angle, angle) of the directions of paths by the errors, departure first."""
        n, size = ends.tx.n_angles, ends.tx.n_angles + ends.rx.n_angles
        covariance = np.zeros((len(paths), size, size))
        for path, (aod, aoa) in enumerate(zip(paths[:, 1 : 1 + n], paths[:, 1 + n : -2], strict=True)):
            covariance[path, :n, :n] = self.mean * EndErrors.of(ends.tx, aod, TELLING).angle_covariance
            covariance[path, n:, n:] = self.mean * EndErrors.of(ends.rx, aoa, TELLING).angle_covariance
        return covariance

    def added_to(self, fit: PathFit, tx: Manifold, rx: Manifold) -> PathFit:
        """A fit with free phases of pairs, its directions as uncertain as the errors make them."""
        ends = LinkBeams(tx, rx, np.ones(rx.n_beams))
        size = 1 + tx.n_angles + rx.n_angles
        covariance = fit.covariance.copy()
        covariance[:, 1:size, 1:size] += self.angle_covariance(ends, paths_towards(fit.aod_rad, fit.aoa_rad))
        return replace(fit, covariance=covariance)

    def _floor(self, ends: LinkBeams, paths: FloatArray) -> FloatArray:
        """Power (pair, path) of the floor below every path in a delay bin."""
        n = ends.tx.n_angles
        aod, aoa = paths[:, 1 : 1 + n], paths[:, 1 + n : -2]
        tx, rx = np.square(np.abs(ends.tx.response(aod))), np.square(np.abs(ends.rx.response(aoa)))
        tx_floor, rx_floor = ends.tx.element_power(aod), ends.rx.element_power(aoa)
        both = tx_floor[:, :, None] * rx[:, None] + tx[:, :, None] * rx_floor[:, None]
        both *= self.level * np.exp(2 * paths[:, -2])[:, None, None] / ends.noise_mw
        return np.asarray(both.reshape(len(paths), -1).T)


@dataclass(frozen=True)
class LevelEvidence:
    """Weighted squares of magnitudes that no shift explains: found, and expected by noise and by a level of one.

    `noise_squared` and `errors_squared` are the sums of the squared eigenvalues of their covariances.
    """

    found: float
    by_noise: float
    noise_squared: float
    by_errors: float
    errors_squared: float

    def joined(self, other: "LevelEvidence") -> "LevelEvidence":
        """Both together."""
        both = zip(astuple(self), astuple(other), strict=True)
        return LevelEvidence(*(one + another for one, another in both))

    @property
    def level(self) -> float:
        """The level that is exceeded as often as not; 0 if noise alone may explain the magnitudes.

        A weighted sum of a few chi-squares has about the median of one with as many degrees of freedom as give the
        same variance (Satterthwaite, 1946).
        """
        if self.found < self.by_noise + SIGNIFICANT_STD * np.sqrt(2 * self.noise_squared):
            return 0.0
        freedom = self.by_errors**2 / self.errors_squared
        median = float(chi_square_quantile(0.5, freedom))
        return max(0.0, self.found - self.by_noise) * freedom / median / self.by_errors

    def log_likelihood(self) -> FloatArray:
        """Of `LEVELS` (level,): a scaled chi-square of this mean and variance, or anything if a path misleads."""
        mean = self.by_noise + LEVELS * self.by_errors
        variance = 2 * np.square(np.sqrt(self.noise_squared) + LEVELS * np.sqrt(self.errors_squared))
        freedom = 2 * np.square(mean) / variance
        value = max(self.found, np.finfo(float).tiny)
        shown = np.exp(chi_square_log_density(value * freedom / mean, freedom)) * freedom / mean
        return np.asarray(np.log((1 - MISLED) * shown + MISLED / (value * np.log(MISLED_BY))))


@dataclass(frozen=True)
class EndErrors:
    """How errors of the elements show in the magnitudes of one path at one end, per unit of their level.

    Attributes
    ----------
    beam : (beam,) beams of the main lobe, or of at least another share of the power of the best beam
    weight : (beam,) power of these beams over that of the best
    remainder : (beam, beam) from relative magnitudes to those that no shift of gain and direction explains
    covariance : (beam, beam) of relative magnitudes by errors of a level of one
    angle_covariance : (angle, angle) in rad^2, by errors of a level of one
    """

    beam: IntArray
    weight: FloatArray
    remainder: FloatArray
    covariance: FloatArray
    angle_covariance: FloatArray

    @classmethod
    def of(cls, manifold: Manifold, angles: FloatArray, least_power: float = MAIN_LOBE) -> "EndErrors":
        """The errors of a path in a direction (angle,), in beams above a share of the power of the best one."""
        tangents = manifold.tangents(angles[None])[0]
        power = np.square(np.abs(tangents[0]))
        power = power / power.max()
        beam = np.flatnonzero(power > least_power)
        value, weight = tangents[0, beam], power[beam]
        covariance = manifold.element_covariance(angles, beam) / np.outer(value, value.conj())
        relative = covariance.real / 2  # the phase of a beam pair is unknown: only magnitudes count
        slope = np.column_stack([np.ones(len(beam)), (tangents[1:, beam] / value).real.T])
        scale = 1 / np.sqrt(np.maximum((weight[:, None] * np.square(slope)).sum(axis=0), 1e-300))
        scaled = np.sqrt(weight)[:, None] * slope * scale
        inverse = np.linalg.pinv(scaled, rcond=np.sqrt(REGULAR)) * np.sqrt(weight)
        shift = scale[:, None] * inverse
        return cls(beam, weight, np.eye(len(beam)) - slope @ shift, relative, (shift @ relative @ shift.T)[1:, 1:])

    def evidence(self, magnitude: FloatArray, variance: FloatArray) -> LevelEvidence:
        """What relative magnitudes (beam,), of this `variance` by noise, show of the level."""
        root = np.sqrt(self.weight)[:, None] * self.remainder
        by_errors, by_noise = root @ self.covariance @ root.T, (root * variance) @ root.T
        return LevelEvidence(
            found=float(np.square(root @ magnitude).sum()),
            by_noise=float(np.trace(by_noise)),
            noise_squared=float(np.square(by_noise).sum()),
            by_errors=float(np.trace(by_errors)),
            errors_squared=float(np.square(by_errors).sum()),
        )


def response_errors(
    ends: LinkBeams,
    paths: FloatArray,
    phasor: ComplexArray,
    residual: ComplexArray,
    bins: IntArray,
    n_bins: int,
    known: ResponseErrors,
) -> ResponseErrors:
    """The errors that fitted paths (path, parameter) show: those that dominate their main lobes tell.

    `residual` (pair, bin) is that of all paths, `phasor` (pair,) the phase of every pair. Where no path dominates,
    these are the errors `known` before.
    """
    n, shape = ends.tx.n_angles, (ends.tx.n_beams, ends.rx.n_beams)
    amplitude = ends.amplitudes(paths)
    is_dominant = dominant_pairs(ends, paths, phasor, n_bins)
    wave, _ = delay_waves(bins, paths[:, 0], n_bins)
    evidence = []
    for path in np.flatnonzero(is_dominant.any(axis=0)):
        tx = EndErrors.of(ends.tx, paths[path, 1 : 1 + n])
        rx = EndErrors.of(ends.rx, paths[path, 1 + n : -2])
        pair = (tx.beam[:, None] * shape[1] + rx.beam).ravel()
        if not is_dominant[pair, path].all():
            continue
        power = np.square(np.abs(amplitude[pair, path]))
        matched = (residual[pair] @ wave[:, path]) / np.square(wave[:, path]).sum()
        error = (matched * (amplitude[pair, path] * phasor[pair]).conj()).real / power
        error, power = error.reshape(len(tx.beam), -1), power.reshape(len(tx.beam), -1)
        by_noise = 0.5 / n_bins
        shown = tx.evidence(error @ power[0] / power[0].sum(), by_noise / power.sum(axis=1)).joined(
            rx.evidence(power[:, 0] @ error / power[:, 0].sum(), by_noise / power.sum(axis=0))
        )
        if shown.by_errors > REGULAR:
            evidence.append(shown)
    if not evidence:
        return known
    typical = float(np.median([one.level for one in evidence]))
    return ResponseErrors(min(LARGEST_LEVEL, typical), expected_level(evidence))


def expected_level(evidence: list[LevelEvidence]) -> float:
    """Mean of the level over `LEVELS`, given what several paths show."""
    log_likelihood = np.sum([one.log_likelihood() for one in evidence], axis=0)
    return float(np.average(LEVELS, weights=BEFORE * np.exp(log_likelihood - log_likelihood.max())))
