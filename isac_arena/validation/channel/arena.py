"""`arena validate channel`: the ray-traced Campus Arena, its samples and hardware as the campaign makes them.

The hall has about a hundred specular and diffracted paths above the noise at every stop, and diffuse ones between.
The score counts paths that are not diffuse and that the data can resolve. Diffuse power counts as noise where it
passes the path's own matched filter. The joint Fisher information gives the loss caused by the other paths.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import linear_sum_assignment

from estimation.channel.config import ChannelConfig
from estimation.channel.estimate import estimate_channel
from estimation.channel.model.apparent import apparent_angles
from estimation.channel.model.crb import joint_loss_db, path_information, path_snr_db
from estimation.channel.model.manifold import Manifold
from estimation.channel.record import ChannelEstimate
from isac_arena.campaign.chain.inputs import user_estimator
from isac_arena.campaign.config import CampaignConfig
from isac_arena.scoring.link_view import resolution_cell
from isac_arena.validation.channel.matching import Estimator, false_row, rate_row
from isac_arena.validation.measurement import Measurement
from scenes.config import load_scene
from scenes.pose import wrap_angle
from scenes.record import BoolArray, ComplexArray, FloatArray, IntArray
from sim.signal.link import Link, make_link
from sim.simulate import observe, simulate_truth
from sim.truth import Truth

SCENE = "campus_arena"
QUICK_STOPS = (0,)
MAX_PATHS = 120  # about fifty count; some diffuse paths are stronger than some of these
MIN_SNR_DB = 12.0
WEAKEST_DB = -10.0  # the joint information contains no paths below this SNR
GATE_CELLS = 0.5
WEAK_MARGIN_DB = 6.0  # true energy may lie this far below an estimate that it explains


@dataclass(frozen=True)
class ApparentPaths:
    """The true paths of a stop as the beams see them."""

    delay_s: FloatArray  # (path,) with the clock bias
    aod_rad: FloatArray  # (path, angle)
    aoa_rad: FloatArray  # (path, angle)
    amplitude: ComplexArray  # (path,) xi in sqrt(mW)
    snr_db: FloatArray  # (path,)
    is_diffuse: BoolArray  # (path,)

    @property
    def parameters(self) -> FloatArray:
        """Delay in s, AoD and AoA azimuth in rad (path, 3)."""
        return np.stack([self.delay_s, self.aod_rad[:, 0], self.aoa_rad[:, 0]], axis=-1)

    def take(self, chosen: BoolArray | IntArray) -> ApparentPaths:
        """Some of the paths."""
        return ApparentPaths(*(getattr(self, name)[chosen] for name in self.__dataclass_fields__))


def check_campus_arena(seed: int, quick: bool, trials: int = 0, estimator: str = "") -> list[Measurement]:
    """Detection and false paths at the stops of the walk, with the default settings: no impairments but noise."""
    config = arena_settings(seed)
    scene = load_scene(SCENE, config.waveform.carrier_ghz * 1e9)
    link = make_link(config)
    every = np.arange(len(scene.stops))
    stops = QUICK_STOPS if quick else every[:: max(1, len(every) // trials)] if trials else every
    estimate = _estimator(estimator)
    hits, n_false = [], []
    for truth in simulate_truth(config, scene, [int(stop) for stop in stops]):
        found = estimate(observe(config, link, scene, truth))
        seen = seen_paths(link, truth, scene.tx.heading_rad)
        target = seen.take(identifiable(link, seen))
        match = matched(link, found, target)
        hits.append(match >= 0)
        n_false.append(count_unexplained(link, found, np.setdiff1d(np.arange(len(found)), match), seen))
    reason = f"known as well as lone ones from {MIN_SNR_DB:g} dB on, {len(n_false)} stops"
    return [
        rate_row("campus_arena.detection", np.concatenate(hits), 0.95, reason, quick),
        false_row("campus_arena.false_per_stop", np.array(n_false), 0.1, quick),
    ]


def arena_settings(seed: int) -> CampaignConfig:
    """The hall with the link and walk of its campaign: one TX panel, four RX panels, 1,584 subcarriers."""
    return CampaignConfig(name="validation", scene=SCENE, seed=seed)


def seen_paths(link: Link, truth: Truth, tx_heading_rad: float) -> ApparentPaths:
    """True paths in device frames: cone angles where the beams are horizontal, delays with the clock bias."""
    paths = truth.paths
    tx, rx = Manifold(link.tx_codebook), Manifold(link.rx_codebook)
    departure_rad = paths.aod_azimuth_rad - tx_heading_rad
    arrival_rad = paths.aoa_azimuth_rad - truth.rx_pose.heading_rad
    aod, tx_gain = apparent_angles(link.tx_codebook, tx, departure_rad, paths.aod_elevation_rad)
    aoa, rx_gain = apparent_angles(link.rx_codebook, rx, arrival_rad, paths.aoa_elevation_rad)
    amplitude = np.sqrt(link.tx_power_mw) * paths.gain * tx_gain * rx_gain
    n_subcarriers = len(link.frequency_offset_hz)
    snr = path_snr_db(tx, rx, n_subcarriers, link.noise_power_mw, aod, aoa, amplitude)
    return ApparentPaths(paths.delay_s + truth.clock_bias_s, aod, aoa, amplitude, snr, paths.is_diffuse)


def identifiable(link: Link, seen: ApparentPaths) -> IntArray:
    """Indices of the paths that are known as well as a lone one of `MIN_SNR_DB` over noise and diffuse power."""
    candidate = np.flatnonzero(~seen.is_diffuse & (seen.snr_db >= WEAKEST_DB))
    chosen = seen.take(candidate)
    tx, rx = Manifold(link.tx_codebook), Manifold(link.rx_codebook)
    information = path_information(
        tx, rx, link.frequency_offset_hz, link.noise_power_mw, chosen.delay_s, chosen.aod_rad, chosen.aoa_rad,
        chosen.amplitude, coherent=True,
    )  # fmt: skip
    loss_db = joint_loss_db(information) + diffuse_loss_db(link, chosen, seen.take(seen.is_diffuse))
    return candidate[chosen.snr_db - loss_db >= MIN_SNR_DB]


def diffuse_loss_db(link: Link, paths: ApparentPaths, diffuse: ApparentPaths) -> FloatArray:
    """Noise rise (path,) in dB by the diffuse power that passes each path's matched filter."""
    tx, rx = Manifold(link.tx_codebook), Manifold(link.rx_codebook)
    noise = np.sqrt(link.noise_power_mw)
    frequency_hz = link.frequency_offset_hz

    def factors(some: ApparentPaths) -> list[ComplexArray]:
        wave = np.exp(-2j * np.pi * some.delay_s[:, None] * frequency_hz)
        return [tx.response(some.aod_rad), rx.response(some.aoa_rad) / noise, wave]

    power = np.square(np.abs(diffuse.amplitude))
    rise = np.ones((len(paths.delay_s), len(power)))
    for own, other in zip(factors(paths), factors(diffuse), strict=True):
        rise *= np.square(np.abs(own.conj() @ other.T)) / np.square(np.abs(own)).sum(axis=1)[:, None]
    return np.asarray(10 * np.log10(1 + rise @ power))


def matched(link: Link, found: ChannelEstimate, target: ApparentPaths) -> IntArray:
    """Estimate (path,) of every true path within half a resolution cell on all axes, -1 for none; one to one."""
    distance = _cells(link, found.plane_parameters[None] - target.parameters[:, None]) / GATE_CELLS
    cost = np.minimum(distance.max(axis=2, initial=0.0), 1.0)
    rows, columns = linear_sum_assignment(cost)
    match = np.full(len(target.delay_s), -1)
    inside = cost[rows, columns] < 1
    match[rows[inside]] = columns[inside]
    return match


def count_unexplained(link: Link, found: ChannelEstimate, unmatched: IntArray, seen: ApparentPaths) -> int:
    """How many estimates have over 6 dB less true power within a cell around them than their own power."""
    offset = found.plane_parameters[unmatched, None] - seen.parameters[None]
    near = (_cells(link, offset) < 2 * GATE_CELLS).all(axis=2)
    near_power = near @ 10 ** (seen.snr_db / 10)
    return int((near_power < 10 ** ((found.snr_db[unmatched] - WEAK_MARGIN_DB) / 10)).sum())


def _cells(link: Link, error: FloatArray) -> FloatArray:
    """Magnitudes of errors (..., 3) in Rayleigh cells: 1 / bandwidth, and 2 over the columns of both arrays."""
    error[..., 1:] = wrap_angle(error[..., 1:])
    return np.asarray(np.abs(error) / resolution_cell(link))


def _estimator(estimator: str) -> Estimator:
    if estimator:
        return user_estimator(estimator)
    settings = ChannelConfig()
    update = {"max_paths": MAX_PATHS, "whiten_background": False}  # dense power lies in few directions
    many = settings.maximum_likelihood.model_copy(update=update)
    settings = settings.model_copy(update={"maximum_likelihood": many})
    return lambda sweep: estimate_channel(sweep, method="coherent", config=settings).reported
