"""Bounds of the significant paths of a stop: jointly, alone, with diffuse power; and which are separable."""

from dataclasses import dataclass, replace

import numpy as np

from estimation.channel.model.crb import path_covariance
from estimation.channel.model.kernels import dirichlet
from estimation.channel.record import AngleKind, ChannelEstimate
from isac_arena.scoring.association import parameter_errors
from isac_arena.scoring.config import DEFAULT_SEPARABILITY, Separability
from isac_arena.scoring.link_view import Cones, LinkView
from scenes.record import BoolArray, ComplexArray, FloatArray, IntArray
from sim.truth import Truth

CONES = (AngleKind.CONE, AngleKind.CONE)

Kinds = tuple[str, str]  # AngleKind of departure and arrival


@dataclass(frozen=True)
class StopBounds:
    """Cramer-Rao bounds of the significant paths of a stop in the angles that its beams observe.

    These are delay, departure and arrival: cone angles where the beams of a device are horizontal, else azimuth
    and elevation. `std` turns them into the angles that an estimate reports.
    """

    joint: FloatArray  # (path, parameter, parameter) all significant paths estimated together
    alone: FloatArray  # (path, parameter, parameter) each without the others
    coherent: FloatArray  # (path, parameter, parameter) as `joint`, with the phases of beam pairs known
    scattered: FloatArray  # (path, parameter, parameter) errors that diffuse power adds to `coherent`
    cones: tuple[Cones, Cones]  # of departures and arrivals
    n_angles: tuple[int, int]  # that the beams of TX and RX observe

    def in_kinds(self, covariance: FloatArray, kinds: Kinds) -> FloatArray:
        """Covariance (path, 3, 3) of delay, departure and arrival as azimuths or cone angles, as `kinds` has them.

        An azimuth that the beams do not observe has the bound of its cone angle at a known elevation.
        """
        turn = np.zeros((len(covariance), 3, covariance.shape[1]))
        turn[:, 0, 0] = 1
        column = 1
        for row, (kind, cones, n) in enumerate(zip(kinds, self.cones, self.n_angles, strict=True), start=1):
            if n == 2:
                turn[:, row, column : column + 2] = cones.slope if kind == AngleKind.CONE else [1.0, 0.0]
            else:
                turn[:, row, column] = 1.0 if kind == AngleKind.CONE else 1 / cones.slope[:, 0]
            column += n
        return _turned(covariance, turn)

    def std(self, covariance: FloatArray, kinds: Kinds) -> FloatArray:
        """Standard deviations (path, 3) of `in_kinds`."""
        variance = np.diagonal(self.in_kinds(covariance, kinds), axis1=1, axis2=2)
        return np.sqrt(np.maximum(variance, 0.0))  # rounding may leave a variance of zero below it

    def scattered_std(self, kinds: Kinds) -> FloatArray:
        """Joint standard deviations (path, 3) with the diffuse paths of the stop as further noise.

        They are those of joint maximum likelihood that takes its noise as white. Without known phases the joint
        bound grows by the same factor as with them.
        """
        plain = self.std(self.coherent, kinds)
        whole = np.sqrt(np.square(plain) + np.square(self.std(self.scattered, kinds)))
        rise = np.divide(whole, plain, out=np.ones_like(plain), where=np.isfinite(plain) & (plain > 0))
        return np.asarray(self.std(self.joint, kinds) * rise)


@dataclass(frozen=True)
class StopInformation:
    """Fisher information of the significant paths of a stop, and what diffuse power adds to their scores."""

    joint: FloatArray  # (path, parameter, path, parameter) as the hardware keeps phases
    coherent: FloatArray  # (path, parameter, path, parameter) with known phases
    diffuse: FloatArray  # (path, parameter, path, parameter) covariance of the coherent score due to diffuse paths
    cones: tuple[Cones, Cones]
    n_angles: tuple[int, int]

    def bounds(self, rows: IntArray) -> StopBounds:
        """The bounds of some of the paths, the others absent."""
        joint, coherent, diffuse = (
            one[np.ix_(rows, np.arange(one.shape[1]), rows, np.arange(one.shape[1]))]
            for one in (self.joint, self.coherent, self.diffuse)
        )
        covariance = path_covariance(coherent)
        finite = np.where(np.isfinite(covariance), covariance, 0.0)
        scattered = np.einsum("iapb,pbqc,qcjd->iajd", finite, diffuse, finite, optimize=True)
        alone = [path_covariance(joint[row : row + 1, :, row : row + 1])[0, :, 0] for row in range(len(rows))]
        tx, rx = self.cones
        return StopBounds(
            joint=_own(path_covariance(joint)),
            alone=np.reshape(alone, (len(rows), *joint.shape[1:2], *joint.shape[1:2]))[:, :-2, :-2],
            coherent=_own(covariance),
            scattered=_own(scattered),
            cones=(tx.take(rows), rx.take(rows)),
            n_angles=self.n_angles,
        )


def stop_information(view: LinkView, truth: Truth, rows: IntArray) -> StopInformation:
    """The information of the paths `rows` of a stop, the significant ones."""
    significant = _paths(truth, rows)
    coherent = view.information(significant, coherent=True)
    joint = coherent if view.is_coherent else view.information(significant, coherent=False)
    n_angles = view.tx.n_angles, view.rx.n_angles
    diffuse = diffuse_scores(view, truth, rows)
    size = coherent.shape[1]
    added = 2 * np.real(diffuse @ diffuse.conj().T).reshape(len(rows), size, len(rows), size)
    return StopInformation(joint, coherent, added, view.cones(significant), n_angles)


def diffuse_scores(view: LinkView, truth: Truth, rows: IntArray) -> ComplexArray:
    """Products J^H a (parameter of all paths, diffuse path) of the slopes of paths and the diffuse waves.

    Parameters are ordered as in `estimation.channel.model.crb`; samples are in units of their noise.
    """
    delay_s, aod_rad, aoa_rad, amplitude = view.seen_paths(_paths(truth, rows))
    scattered = _paths(truth, np.flatnonzero(truth.paths.is_diffuse))
    tx, rx, diffuse = view.responses(scattered)
    t = np.einsum("iab,pb->aip", view.tx.tangents(aod_rad).conj(), tx, optimize=True)
    r = np.einsum("iab,pb->aip", (view.rx.tangents(aoa_rad) / view.noise_amplitude).conj(), rx, optimize=True)
    apart_s = delay_s[:, None] - scattered.paths.delay_s
    w, slope = band_products(apart_s, view.link.frequency_offset_hz)
    gain = amplitude.conj()[:, None] * diffuse
    level = t[0] * r[0] * w
    rows_of = [t[0] * r[0] * slope, *(t[1:] * r[0] * w), *(t[0] * r[1:] * w), level, -1j * level]
    return np.stack([gain * one for one in rows_of], axis=1).reshape(len(rows) * len(rows_of), len(diffuse))


def band_products(apart_s: FloatArray, frequency_hz: FloatArray) -> tuple[ComplexArray, ComplexArray]:
    """Sums (...) of exp(j 2 pi f tau) over subcarriers of equal steps, and their slopes over tau in 1/s."""
    n = len(frequency_hz)
    band_hz = n * (frequency_hz[-1] - frequency_hz[0]) / max(n - 1, 1)
    centre = 2j * np.pi * (frequency_hz[-1] + frequency_hz[0]) / 2
    kernel = n * dirichlet(np.zeros(1, int), -band_hz * apart_s.ravel(), n)
    level, slope = kernel[:, 0].reshape(apart_s.shape), kernel[:, 1].reshape(apart_s.shape)
    turn = np.exp(centre * apart_s)
    return level * turn, (band_hz * slope + centre * level) * turn


def separable_paths(
    view: LinkView,
    truth: Truth,
    rows: IntArray,
    information: StopInformation,
    limits: Separability = DEFAULT_SEPARABILITY,
) -> tuple[BoolArray, FloatArray]:
    """Which of the paths `rows` can be told apart from their neighbours and from diffuse power.

    Returns a mask (path,), and the joint bound (path,) of all of them, diffuse power included, as the largest
    share of a resolution cell in delay and in the sines of both cone angles. A path is separable where this share
    is small enough. Of paths that are not, the strongest of every cell stays and the others are left out, until
    all that stay are separable: a group of paths in one place counts as one path.
    """
    kept, cell = np.arange(len(rows)), view.resolution_cell
    tx, rx = information.cones
    place = np.column_stack([truth.paths.delay_s[rows], tx.angle_rad, rx.angle_rad])
    share = first = _share_of_cell(information, kept, cell)
    while (is_poor := ~(share <= limits.share_of_cell)).any():
        poor = kept[is_poor]
        apart = parameter_errors(place[poor, None], place[poor][None]) / cell
        power = truth.paths.power[rows[poor]]
        is_weaker = ((np.abs(apart) < 1).all(axis=2) & (power[None] > power[:, None])).any(axis=1)
        kept = np.setdiff1d(kept, poor[is_weaker] if is_weaker.any() else poor)
        share = _share_of_cell(information, kept, cell)
    return np.isin(np.arange(len(rows)), kept), first


def _share_of_cell(information: StopInformation, rows: IntArray, cell: FloatArray) -> FloatArray:
    bounds = information.bounds(rows)
    sine_slope = [np.ones(len(rows)), *(cones.sine_slope for cones in bounds.cones)]
    share = bounds.scattered_std(CONES) * np.column_stack(sine_slope) / cell
    return np.asarray(share.max(axis=1, initial=0.0))


def kinds_of(estimate: ChannelEstimate) -> Kinds:
    """Whether the departures and arrivals of an estimate are azimuths or cone angles."""
    return estimate.aod_angle_kind, estimate.aoa_angle_kind


def observed_kinds(view: LinkView) -> Kinds:
    """The angles that the beams of TX and RX observe: cone angles, where they are horizontal."""
    tx, rx = (AngleKind.AZIMUTH if n == 2 else AngleKind.CONE for n in (view.tx.n_angles, view.rx.n_angles))
    return tx, rx


def _paths(truth: Truth, rows: IntArray) -> Truth:
    return replace(truth, paths=truth.paths.take("path", rows))


def _own(covariance: FloatArray) -> FloatArray:
    """Blocks (path, parameter, parameter) of every path with itself, gains left out."""
    return np.asarray(np.einsum("iaib->iab", covariance)[:, :-2, :-2])


def _turned(covariance: FloatArray, turn: FloatArray) -> FloatArray:
    """The product turn @ covariance @ turn', where infinite variances stay infinite."""
    unknown = ~np.isfinite(np.diagonal(covariance, axis1=1, axis2=2))
    known = np.where(np.isfinite(covariance), covariance, 0.0)
    result = turn @ known @ np.swapaxes(turn, 1, 2)
    path, row = np.nonzero((np.abs(turn) * unknown[:, None]).any(axis=2))
    result[path, row, row] = np.inf
    return np.asarray(result)
