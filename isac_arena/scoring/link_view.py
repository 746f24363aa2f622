"""The link as scoring sees it: power of true paths in every cell of a sweep, and their Cramer-Rao bounds."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from estimation.channel.coherent.plan import nominal_manifold
from estimation.channel.model.apparent import apparent_angles, cone_angles
from estimation.channel.model.crb import PathBounds, path_bounds, path_information
from estimation.channel.model.delay import hann_window
from estimation.channel.model.manifold import Manifold
from estimation.channel.record import ChannelEstimate
from estimation.slam.config import Consider
from isac_arena.campaign.config import CampaignConfig
from scenes.pose import Pose, wrap_angle
from scenes.record import ComplexArray, FloatArray, IntArray
from scenes.scene import Scene
from sim.propagation.paths import Paths
from sim.signal.arrays.codebook import Codebook, beam_response
from sim.signal.generation import path_waves
from sim.signal.hardware.apply_impairments import impaired_codebooks, true_tx_pose
from sim.signal.hardware.config import ImpairmentsConfig
from sim.signal.hardware.impairments import quantiser_gain
from sim.signal.link import Link
from sim.truth import Truth


@dataclass(frozen=True)
class Cells:
    """Cells of a sweep: the delay (cell,) in s with the clock bias, and the best beams (cell,) of TX and RX."""

    delay_s: FloatArray
    tx_beam: IntArray
    rx_beam: IntArray


@dataclass(frozen=True)
class Cones:
    """Cone angles of directions as horizontal beams of a device see them."""

    angle_rad: FloatArray  # (path,) in the device frame
    slope: FloatArray  # (path, 2) over azimuth and elevation
    sine_slope: FloatArray  # (path,) of the sine about the panel's boresight over the angle

    def take(self, rows: IntArray) -> Cones:
        """Some of the directions."""
        return Cones(self.angle_rad[rows], self.slope[rows], self.sine_slope[rows])


@dataclass(frozen=True)
class LinkView:
    """The beams as built, the band with the estimator's window, and whether beam pairs keep their phases."""

    link: Link
    tx_pose: Pose  # the true one of what stands: of an uplink the receiver's
    tx_built: Codebook
    rx_built: Codebook
    window: FloatArray  # (subcarrier,) weights of the estimator over the band
    is_coherent: bool
    hardware: ImpairmentsConfig
    set_up: Consider  # errors of the set-up that no estimator can see
    tx: Manifold = field(repr=False)
    rx: Manifold = field(repr=False)

    def ends(self, truth: Truth) -> tuple[Pose, Pose]:
        """The true poses of TX and RX."""
        if truth.tx_pose is None:
            return self.tx_pose, truth.rx_pose
        return truth.tx_pose, self.tx_pose

    def estimated_cells(self, estimate: ChannelEstimate) -> Cells:
        """The cells of estimated paths: the best nominal beams at their angles."""
        tx = _estimated(self.link.tx_codebook, estimate.aod_azimuth_rad, estimate.aod_elevation_rad)
        rx = _estimated(self.link.rx_codebook, estimate.aoa_azimuth_rad, estimate.aoa_elevation_rad)
        return Cells(estimate.delay_s, tx.argmax(axis=0), rx.argmax(axis=0))

    def true_cells(self, truth: Truth) -> Cells:
        """The cells in which true paths are strongest."""
        tx, rx = self._amplitudes(truth)
        return Cells(truth.paths.delay_s + truth.clock_bias_s, tx.argmax(axis=0), rx.argmax(axis=0))

    def cell_amplitudes(self, truth: Truth, cells: Cells) -> ComplexArray:
        """Amplitude (cell, path) in sqrt(mW) of every true path in every cell: responses of beams and band."""
        tx = beam_response(self.tx_built, *_departure(truth.paths, self.ends(truth)[0]))
        rx = beam_response(self.rx_built, *_arrival(truth.paths, self.ends(truth)[1]))
        frequency_hz = self.link.frequency_offset_hz
        filters = path_waves(-cells.delay_s, frequency_hz) * (self.window / self.window.sum())
        band = filters @ path_waves(truth.paths.delay_s + truth.clock_bias_s, frequency_hz).T
        gain = np.sqrt(self.link.tx_power_mw) * truth.paths.gain
        return np.asarray(tx[cells.tx_beam] * rx[cells.rx_beam] * band * gain)

    def leaked_dbm(self, truth: Truth, cells: Cells) -> FloatArray:
        """Power (cell, path) in dBm of every true path in every cell."""
        power_mw = np.square(np.abs(self.cell_amplitudes(truth, cells)))
        return np.asarray(10 * np.log10(np.maximum(power_mw, np.finfo(float).tiny)))

    def converter_gain_db(self, truth: Truth, cells: Cells) -> FloatArray:
        """Gain (cell,) of the converters in the beam pairs of cells: they raise pairs far below the strongest."""
        if not self.hardware.adc_bits or not len(truth.paths):
            return np.zeros(len(cells.delay_s))
        tx, rx = (np.square(part) for part in self._amplitudes(truth))
        power_mw = self.link.tx_power_mw * np.square(np.abs(truth.paths.gain))
        pair_mw = (tx * power_mw) @ rx.T + self.link.noise_power_mw
        steps = 2.0 ** (self.hardware.adc_bits - 1) * 10 ** (-self.hardware.adc_full_scale_db / 20)
        ratio = steps * np.sqrt(pair_mw[cells.tx_beam, cells.rx_beam] / pair_mw.max())
        return np.asarray(20 * np.log10(quantiser_gain(ratio, self.hardware.adc_bits)))

    def beam_loss_db(self, truth: Truth) -> FloatArray:
        """Loss (path,) of the best beam at each path below the highest gain of all beams, at the worse device."""
        return np.asarray(self.beam_losses_db(truth).max(axis=0))

    def beam_losses_db(self, truth: Truth) -> FloatArray:
        """The same at the TX and at the RX (device, path)."""
        loss = [
            20 * np.log10(peak / np.maximum(amplitude.max(axis=0), 1e-9))
            for peak, amplitude in zip(self._peaks, self._amplitudes(truth), strict=True)
        ]
        return np.array(loss)

    def information(self, truth: Truth, *, coherent: bool) -> FloatArray:
        """Fisher information (path, parameter, path, parameter) of all paths of `truth` with the nominal beams."""
        frequency_hz, noise_mw = self.link.frequency_offset_hz, self.link.noise_power_mw
        seen = self.seen_paths(truth)
        return path_information(self.tx, self.rx, frequency_hz, noise_mw, *seen, coherent=coherent)

    def seen_paths(self, truth: Truth) -> tuple[FloatArray, FloatArray, FloatArray, ComplexArray]:
        """Delays, departures and arrivals (path, angle) as the beams observe them, and amplitudes in sqrt(mW)."""
        return _seen_paths(self.link, (self.tx, self.rx), truth.paths, self.ends(truth))

    def responses(self, truth: Truth) -> tuple[ComplexArray, ComplexArray, ComplexArray]:
        """Responses of TX beams and of RX beams to true paths, and amplitudes in sqrt(mW).

        (path, beam), (path, beam) over the noise amplitude, and (path,).
        """
        paths, link = truth.paths, self.link
        tx = beam_response(link.tx_codebook, *_departure(paths, self.ends(truth)[0])).T
        rx = beam_response(link.rx_codebook, *_arrival(paths, self.ends(truth)[1])).T / self.noise_amplitude
        return tx, rx, np.asarray(np.sqrt(link.tx_power_mw) * paths.gain)

    @property
    def noise_amplitude(self) -> FloatArray:
        """Noise amplitude (rx_beam,) of a sample in sqrt(mW)."""
        return np.sqrt(self.link.noise_power_mw)

    def cones(self, truth: Truth) -> tuple[Cones, Cones]:
        """Cone angles of true departures and arrivals, each about the panel of the strongest nominal beam."""
        return (
            _cones(self.link.tx_codebook, *_departure(truth.paths, self.ends(truth)[0])),
            _cones(self.link.rx_codebook, *_arrival(truth.paths, self.ends(truth)[1])),
        )

    def in_front(self, parameters: FloatArray) -> FloatArray:
        """Delays and azimuths (path, 3), azimuths behind all panels of a device mirrored to the front.

        A flat array has the same phases in both directions, so no estimator can tell them apart.
        """
        delay_s, aod_rad, aoa_rad = parameters.T
        return np.stack([delay_s, self.tx.in_front(aod_rad), self.rx.in_front(aoa_rad)], axis=-1)

    @cached_property
    def resolution_cell(self) -> FloatArray:
        """Rayleigh cells (3,) of delay in s and of the sines of both cone angles: 1 / bandwidth, 2 / columns."""
        return resolution_cell(self.link)

    @cached_property
    def _peaks(self) -> tuple[float, float]:
        return _peak(self.tx_built), _peak(self.rx_built)

    def _amplitudes(self, truth: Truth) -> tuple[FloatArray, FloatArray]:
        tx = beam_response(self.tx_built, *_departure(truth.paths, self.ends(truth)[0]))
        return np.abs(tx), np.abs(beam_response(self.rx_built, *_arrival(truth.paths, self.ends(truth)[1])))


def link_view(config: CampaignConfig, link: Link, scene: Scene) -> LinkView:
    """The view of a campaign's link; a CFO or phase noise between beam pairs makes it incoherent."""
    tx_built, rx_built = impaired_codebooks(config, link)
    n = len(link.frequency_offset_hz)
    hardware = config.impairments
    return LinkView(
        link=link,
        tx_pose=true_tx_pose(config, scene.tx),
        tx_built=tx_built,
        rx_built=rx_built,
        window=hann_window(n) if config.channel.method == "power" else np.ones(n),
        is_coherent=not (hardware.cfo_hz or hardware.phase_noise_pair_deg),
        hardware=hardware,
        set_up=config.slam.consider,
        tx=nominal_manifold(link.tx_codebook),
        rx=nominal_manifold(link.rx_codebook),
    )


def true_path_bounds(
    link: Link, manifolds: tuple[Manifold, Manifold], paths: Paths, poses: tuple[Pose, Pose], *, coherent: bool
) -> PathBounds:
    """Cramer-Rao bounds of true paths, estimated jointly; manifolds and poses are those of TX and RX."""
    delay_s, aod_rad, aoa_rad, amplitude = _seen_paths(link, manifolds, paths, poses)
    frequency_hz, noise_mw = link.frequency_offset_hz, link.noise_power_mw
    return path_bounds(*manifolds, frequency_hz, noise_mw, delay_s, aod_rad, aoa_rad, amplitude, coherent=coherent)


def _seen_paths(
    link: Link, manifolds: tuple[Manifold, Manifold], paths: Paths, poses: tuple[Pose, Pose]
) -> tuple[FloatArray, FloatArray, FloatArray, ComplexArray]:
    """Delays, departures and arrivals (path, angle) as the manifolds observe them, and amplitudes in sqrt(mW)."""
    aod, tx_gain = apparent_angles(link.tx_codebook, manifolds[0], *_departure(paths, poses[0]))
    aoa, rx_gain = apparent_angles(link.rx_codebook, manifolds[1], *_arrival(paths, poses[1]))
    return paths.delay_s, aod, aoa, np.sqrt(link.tx_power_mw) * paths.gain * tx_gain * rx_gain


def _estimated(codebook: Codebook, azimuth_rad: FloatArray, elevation_rad: FloatArray) -> FloatArray:
    """Amplitudes (beam, path) of the beams at estimated directions, level ones where elevations are unknown."""
    level = np.where(np.isfinite(elevation_rad), elevation_rad, 0.0)
    return np.asarray(np.abs(beam_response(codebook, azimuth_rad, level)))


def resolution_cell(link: Link) -> FloatArray:
    """Rayleigh cells (3,) of delay in s and of the sines of departure and arrival: 1 / bandwidth, 2 / columns."""
    step_hz = float(np.diff(link.frequency_offset_hz[:2])[0])
    columns = [len(np.unique(book.element_position_m[:, 1])) for book in (link.tx_codebook, link.rx_codebook)]
    return np.array([1 / (step_hz * len(link.frequency_offset_hz)), *(2 / np.array(columns))])


def _cones(codebook: Codebook, azimuth_rad: FloatArray, elevation_rad: FloatArray) -> Cones:
    response = np.abs(beam_response(codebook, azimuth_rad, elevation_rad))
    panel_rad = codebook.panel_azimuth_rad[response.argmax(axis=0)]
    angle_rad, slope = cone_angles(azimuth_rad, elevation_rad, panel_rad)
    return Cones(wrap_angle(angle_rad), slope, np.cos(angle_rad - panel_rad))


def _departure(paths: Paths, tx_pose: Pose) -> tuple[FloatArray, FloatArray]:
    return paths.aod_azimuth_rad - tx_pose.heading_rad, paths.aod_elevation_rad


def _arrival(paths: Paths, rx_pose: Pose) -> tuple[FloatArray, FloatArray]:
    return paths.aoa_azimuth_rad - rx_pose.heading_rad, paths.aoa_elevation_rad


def _peak(book: Codebook) -> float:
    """Highest amplitude of all beams in their own directions."""
    return float(np.abs(beam_response(book, book.azimuth_rad, book.elevation_rad)).max())
