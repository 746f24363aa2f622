"""The beams of a device: neighbours, nominal amplitude patterns, and angles from beam powers."""

from dataclasses import dataclass

import numpy as np

from estimation.channel.model.delay import parabola_peak
from scenes.pose import wrap_angle
from scenes.record import FloatArray, IntArray
from sim.signal.arrays.codebook import Codebook, beam_response

GRID_STEP_RAD = np.deg2rad(0.1)
NEIGHBOURHOOD = 2  # beams to either side of the strongest that an angle is estimated from


@dataclass(frozen=True)
class AngleFit:
    """An angle fitted to a beam amplitude profile.

    `information` is the Fisher information in rad^-2 about the angle per unit of (amplitude / real noise std)^2,
    `residual` the mean square misfit per degree of freedom relative to the squared peak amplitude.
    """

    azimuth_rad: float
    information: float
    residual: float


class BeamAxis:
    """The beams of one device in order of azimuth, with their nominal amplitude patterns on a fine grid.

    The axis is closed (the last beam is a neighbour of the first) if the gap between them is at most twice the
    widest gap between beams. `peak_gain_db` is the highest gain of any beam in the horizontal plane.
    """

    def __init__(self, codebook: Codebook) -> None:
        self._codebook = codebook
        self._order = np.argsort(codebook.azimuth_rad, kind="stable")
        self._rank = np.argsort(self._order, kind="stable")
        azimuth = codebook.azimuth_rad[self._order]
        gap = 2 * np.pi - (azimuth[-1] - azimuth[0])
        self.is_closed = bool(len(azimuth) > 2 and gap <= 2 * np.diff(azimuth).max())
        self._grid_rad = np.arange(-np.pi, np.pi, GRID_STEP_RAD)
        self._amplitude = np.abs(beam_response(codebook, self._grid_rad))
        self.peak_gain_db = float(20 * np.log10(self._amplitude.max()))

    def neighbour(self, beam: IntArray, step: int) -> IntArray:
        """Index of the beam `step` places further in azimuth; at the end of an open axis the beam itself."""
        place = self._rank[beam] + step
        n = len(self._order)
        if self.is_closed:
            return np.asarray(self._order[place % n])
        return np.asarray(np.where((place < 0) | (place >= n), beam, self._order[np.clip(place, 0, n - 1)]))

    def neighbourhood(self, beam: int) -> IntArray:
        """The strongest beam and up to 2 beams to either side, in order of azimuth, each once."""
        beams = [int(self.neighbour(np.asarray(beam), s)) for s in range(-NEIGHBOURHOOD, NEIGHBOURHOOD + 1)]
        if not self.is_closed:
            places = np.arange(self._rank[beam] - NEIGHBOURHOOD, self._rank[beam] + NEIGHBOURHOOD + 1)
            beams = list(self._order[places[(places >= 0) & (places < len(self._order))]])
        return np.asarray(list(dict.fromkeys(beams)), int)

    def relative_amplitude(self, azimuth_rad: float) -> FloatArray:
        """Nominal amplitude (beam,) towards a direction at zero elevation, 1 in the best beam."""
        amplitude = np.abs(beam_response(self._codebook, azimuth_rad))[:, 0]
        return np.asarray(amplitude / amplitude.max())

    def loss_db(self, azimuth_rad: float) -> float:
        """Nominal gain of the best beam towards a direction, below the highest gain of any beam."""
        best = np.abs(beam_response(self._codebook, azimuth_rad)).max()
        return float(self.peak_gain_db - 20 * np.log10(best))

    def match(self, beams: IntArray, amplitude: FloatArray) -> AngleFit:
        """Angle whose nominal pattern is nearest to the measured `amplitude` of `beams`, up to a scale.

        Minimises |s|^2 - (s.g)^2 / |g|^2 over the azimuth on a 0.1 deg grid, refined by a parabola.
        """
        strongest = self._codebook.azimuth_rad[beams[np.argmax(amplitude)]]
        pointing = wrap_angle(self._codebook.azimuth_rad[beams] - strongest)
        # Identical beams have no spacing.
        margin = np.diff(np.sort(pointing)).max(initial=0.0) or np.pi / 8
        low, high = pointing.min() - margin, pointing.max() + margin
        offset = wrap_angle(self._grid_rad - strongest)
        inside = np.flatnonzero((offset >= low) & (offset <= high))
        inside = inside[np.argsort(offset[inside])]
        pattern = self._amplitude[np.ix_(beams, inside)]
        score = (amplitude @ pattern) ** 2 / (pattern**2).sum(axis=0)
        best = int(np.argmax(score))
        azimuth = strongest + offset[inside[best]] + GRID_STEP_RAD * parabola_peak(score, best)
        return AngleFit(float(wrap_angle(azimuth)), *self._quality(beams, amplitude, azimuth))

    def match_without_patterns(self, beams: IntArray, amplitude: FloatArray) -> AngleFit:
        """Angle of the peak of a Gaussian main lobe through the strongest beam and the two beside it.

        Only where the beams point to has to be known. With fewer beams, or none weaker, it is the strongest's.
        """
        pointing = self._codebook.azimuth_rad[beams]
        best = int(np.argmax(amplitude))
        offset = wrap_angle(pointing - pointing[best])
        order = np.argsort(offset, kind="stable")
        place = int(np.flatnonzero(order == best)[0])
        three = order[place - 1 : place + 2] if place else order[:0]
        spacing = np.diff(np.sort(offset)).max(initial=0.0) or np.pi / 8
        curvature, slope = -4 * np.log(2) / spacing**2, 0.0  # half the power between two beams
        if len(three) == len(np.unique(offset[three])) == 3 and amplitude[three].min() > 0:
            fitted, across, _ = np.polyfit(offset[three], 2 * np.log(amplitude[three]), 2)
            if fitted < 0:
                curvature, slope = fitted, across
        peak = float(np.clip(-slope / (2 * curvature), -spacing / 2, spacing / 2))
        at = np.exp(curvature * np.square(offset - peak) / 2)
        return AngleFit(
            float(wrap_angle(pointing[best] + peak)), _information(at, -curvature * (offset - peak) * at), 0.0
        )

    def _quality(self, beams: IntArray, amplitude: FloatArray, azimuth_rad: float) -> tuple[float, float]:
        step = GRID_STEP_RAD
        before, at, after = np.abs(
            beam_response(self._codebook, azimuth_rad + np.array([-step, 0.0, step]))[beams]
        ).T
        slope = (after - before) / (2 * step)
        scale = (amplitude @ at) / (at @ at)
        misfit = ((amplitude - scale * at) ** 2).sum() / max(len(beams) - 2, 1)
        return _information(at, slope), float(misfit / amplitude.max() ** 2)


def _information(at: FloatArray, slope: FloatArray) -> float:
    """`AngleFit.information` of beams of amplitudes `at`, of unknown scale, with slopes over the angle."""
    return float((slope @ slope - (slope @ at) ** 2 / (at @ at)) / at.max() ** 2)
