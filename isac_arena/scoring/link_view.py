"""The link as scoring sees it: power of true paths in every cell of a sweep, and their Cramer-Rao bounds."""

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from estimation.channel.coherent.plan import nominal_manifold
from estimation.channel.model.apparent import apparent_angles
from estimation.channel.model.crb import PathBounds, path_bounds
from estimation.channel.model.delay import hann_window
from estimation.channel.model.manifold import Manifold
from estimation.channel.record import ChannelEstimate
from isac_arena.campaign.config import CampaignConfig
from scenes.pose import Pose
from scenes.record import FloatArray, IntArray
from scenes.scene import Scene
from sim.propagation.paths import Paths
from sim.signal.arrays.codebook import Codebook, beam_response
from sim.signal.hardware.apply_impairments import impaired_codebooks, true_tx_pose
from sim.signal.link import Link
from sim.truth import Truth


@dataclass(frozen=True)
class Cells:
    """Cells of a sweep: the delay (cell,) in s with the clock bias, and the best beams (cell,) of TX and RX."""

    delay_s: FloatArray
    tx_beam: IntArray
    rx_beam: IntArray


@dataclass(frozen=True)
class LinkView:
    """The beams as built, the band with the estimator's window, and whether beam pairs keep their phases."""

    link: Link
    tx_pose: Pose  # the true one
    tx_built: Codebook
    rx_built: Codebook
    window: FloatArray  # (subcarrier,) weights of the estimator over the band
    is_coherent: bool
    tx: Manifold = field(repr=False)
    rx: Manifold = field(repr=False)

    def estimated_cells(self, estimate: ChannelEstimate) -> Cells:
        """The cells of estimated paths: the best nominal beams at their angles."""
        tx = np.abs(beam_response(self.link.tx_codebook, estimate.aod_azimuth_rad))
        rx = np.abs(beam_response(self.link.rx_codebook, estimate.aoa_azimuth_rad))
        return Cells(estimate.delay_s, tx.argmax(axis=0), rx.argmax(axis=0))

    def true_cells(self, truth: Truth) -> Cells:
        """The cells in which true paths are strongest."""
        tx, rx = self._amplitudes(truth)
        return Cells(truth.paths.delay_s + truth.clock_bias_s, tx.argmax(axis=0), rx.argmax(axis=0))

    def leaked_dbm(self, truth: Truth, cells: Cells) -> FloatArray:
        """Power (cell, path) in dBm of every true path in every cell, from the responses of beams and band."""
        tx, rx = self._amplitudes(truth)
        offset_s = cells.delay_s[:, None] - truth.paths.delay_s - truth.clock_bias_s
        wave = np.exp(2j * np.pi * offset_s[..., None] * self.link.frequency_offset_hz)
        amplitude = tx[cells.tx_beam] * rx[cells.rx_beam] * np.abs(wave @ self.window) / self.window.sum()
        power_mw = self.link.tx_power_mw * truth.paths.power * amplitude**2
        return np.asarray(10 * np.log10(np.maximum(power_mw, np.finfo(float).tiny)))

    def beam_loss_db(self, truth: Truth) -> FloatArray:
        """Loss (path,) of the best beam at each path below the highest gain of all beams, at the worse device."""
        loss = [
            20 * np.log10(peak / np.maximum(amplitude.max(axis=0), 1e-9))
            for peak, amplitude in zip(self._peaks, self._amplitudes(truth), strict=True)
        ]
        return np.asarray(np.maximum(*loss))

    def bounds(self, truth: Truth) -> PathBounds:
        """Cramer-Rao bounds of all paths of `truth`, estimated jointly with the nominal beams."""
        poses = self.tx_pose, truth.rx_pose
        return true_path_bounds(self.link, (self.tx, self.rx), truth.paths, poses, coherent=self.is_coherent)

    @cached_property
    def _peaks(self) -> tuple[float, float]:
        return _peak(self.tx_built), _peak(self.rx_built)

    def _amplitudes(self, truth: Truth) -> tuple[FloatArray, FloatArray]:
        tx = beam_response(self.tx_built, *_departure(truth.paths, self.tx_pose))
        return np.abs(tx), np.abs(beam_response(self.rx_built, *_arrival(truth.paths, truth.rx_pose)))


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
        tx=nominal_manifold(link.tx_codebook),
        rx=nominal_manifold(link.rx_codebook),
    )


def true_path_bounds(
    link: Link, manifolds: tuple[Manifold, Manifold], paths: Paths, poses: tuple[Pose, Pose], *, coherent: bool
) -> PathBounds:
    """Cramer-Rao bounds of true paths, estimated jointly; manifolds and poses are those of TX and RX."""
    aod, tx_gain = apparent_angles(link.tx_codebook, manifolds[0], *_departure(paths, poses[0]))
    aoa, rx_gain = apparent_angles(link.rx_codebook, manifolds[1], *_arrival(paths, poses[1]))
    return path_bounds(
        *manifolds,
        link.frequency_offset_hz,
        link.noise_power_mw,
        paths.delay_s,
        aod,
        aoa,
        np.sqrt(link.tx_power_mw) * paths.gain * tx_gain * rx_gain,
        coherent=coherent,
    )


def _departure(paths: Paths, tx_pose: Pose) -> tuple[FloatArray, FloatArray]:
    return paths.aod_azimuth_rad - tx_pose.heading_rad, paths.aod_elevation_rad


def _arrival(paths: Paths, rx_pose: Pose) -> tuple[FloatArray, FloatArray]:
    return paths.aoa_azimuth_rad - rx_pose.heading_rad, paths.aoa_elevation_rad


def _peak(book: Codebook) -> float:
    """Highest amplitude of all beams in their own directions."""
    return float(np.abs(beam_response(book, book.azimuth_rad, book.elevation_rad)).max())
