"""Channel estimates of synthetic halls: plan paths with vertical versions by image sources, noise and clutter."""

from dataclasses import dataclass

import numpy as np

from estimation.channel.config import LosConfig
from estimation.channel.hall.geometry import ELEVATION_SIGNS, Heights
from estimation.channel.hall.model import HallLink
from estimation.channel.model.apparent import apparent_angles
from estimation.channel.model.manifold import Manifold
from estimation.channel.record import AngleKind, ChannelEstimate
from scenes.pose import SPEED_OF_LIGHT_M_S, wrap_angle
from scenes.record import FloatArray, IntArray
from sim.config import ArrayConfig
from sim.signal.link import make_codebook

CARRIER_HZ = 60e9
LEVEL_DBM = -13.0
WEAK = -1


@dataclass(frozen=True)
class TrueHall:
    """Estimates of a campaign and their truth, a list entry per stop.

    `version` (path,) is -1 for clutter; `plan` (path, 3) has plan length, departure and arrival azimuth.
    """

    estimates: list[ChannelEstimate]
    version: list[IntArray]
    plan: list[FloatArray]
    clock_m: FloatArray
    heights: Heights
    link: HallLink


def hall_link(*, sees_elevation: bool) -> HallLink:
    """A TX panel and four RX panels of 4 x 8 elements."""
    beams = {"columns": 8, "beam_elevation_deg": [-25.0, 0.0, 25.0] if sees_elevation else [0.0]}
    tx = make_codebook(ArrayConfig(**beams, beams_per_panel=10, sector_deg=140.0), CARRIER_HZ)
    panels = [-180.0, -90.0, 0.0, 90.0]
    rx = make_codebook(
        ArrayConfig(**beams, beams_per_panel=7, sector_deg=90.0, panel_azimuth_deg=panels), CARRIER_HZ
    )
    return HallLink(tx, rx, LosConfig(power_at_1m_dbm=LEVEL_DBM), 2.5e-9)


def synthetic_hall(
    rng: np.random.Generator,
    heights: Heights,
    link: HallLink,
    *,
    n_stops: int = 4,
    n_plan: int = 10,
    n_weak: int = 10,
) -> TrueHall:
    """A campaign with a line of sight at every stop, versions of most plan paths, and weak clutter."""
    sees_elevation = Manifold(link.rx_codebook).n_angles == 2
    parts = [_stop(rng, stop, heights, link, n_plan, n_weak, sees_elevation) for stop in range(n_stops)]
    estimates, version, plan, clock = (list(part) for part in zip(*parts, strict=True))
    return TrueHall(estimates, version, plan, np.array(clock), heights, link)


def _stop(
    rng: np.random.Generator, stop: int, heights: Heights, link: HallLink, n_plan: int, n_weak: int, sees: bool
) -> tuple[ChannelEstimate, IntArray, FloatArray, float]:
    clock_m = float(rng.uniform(-10, 10))
    sight_m = float(rng.uniform(4, 12))
    length = np.concatenate([[sight_m], sight_m + rng.uniform(1, 20, n_plan)])
    departure, arrival = rng.uniform(-1.0, 1.0, n_plan + 1), rng.uniform(-np.pi, np.pi, n_plan + 1)
    plan_loss = np.concatenate([[0.0], rng.uniform(6, 16, n_plan)])
    plan, version, loss = [], [], []
    for index in range(n_plan + 1):
        for kind in range(5):
            if kind == 0 or rng.random() < (0.8 if kind < 3 else 0.1):
                plan.append((length[index], departure[index], arrival[index]))
                version.append(kind)
                loss.append(plan_loss[index] + (0.0 if kind == 0 else rng.uniform(3, 9)))
    for _ in range(n_weak):
        plan.append((sight_m + rng.uniform(1, 25), rng.uniform(-1.0, 1.0), rng.uniform(-np.pi, np.pi)))
        version.append(WEAK)
        loss.append(rng.uniform(38, 50))
    kinds, where = np.array(version), np.array(plan)
    estimate = _estimate(rng, stop, where, kinds, np.array(loss), heights, link, clock_m, sees)
    order = np.argsort(estimate.delay_s, kind="stable")
    return estimate.take("path", order), kinds[order], where[order], clock_m


def _estimate(
    rng: np.random.Generator, stop: int, plan: FloatArray, kinds: IntArray, loss: FloatArray, heights: Heights,
    link: HallLink, clock_m: float, sees: bool,
) -> ChannelEstimate:  # fmt: skip
    n, version = len(plan), np.maximum(kinds, 0)
    difference = np.where(kinds == WEAK, 0.0, heights.differences_m[version])
    range_m = np.hypot(plan[:, 0], difference)
    shown, hidden_db = np.empty((n, 4)), np.zeros(n)
    for end, book in enumerate((link.tx_codebook, link.rx_codebook)):
        elevation = np.arctan2(ELEVATION_SIGNS[version, end] * difference, plan[:, 0])
        elevation[kinds == WEAK] = rng.uniform(-0.5, 0.5, int((kinds == WEAK).sum())) if sees else 0.0
        angles, gain = apparent_angles(book, Manifold(book), plan[:, 1 + end], elevation)
        shown[:, end], shown[:, 2 + end] = angles[:, 0], elevation
        hidden_db += -20 * np.log10(np.maximum(np.abs(gain), 1e-4))
    is_weak = kinds == WEAK
    std = np.stack([np.where(is_weak, 0.05, 0.004), *(np.where(is_weak, 0.012, 0.0012),) * 4], axis=1)
    covariance = np.einsum("pa,ab->pab", std**2, np.eye(5))
    error = std * rng.standard_normal(std.shape)
    n_angles = 5 if sees else 3
    unit = np.array([1 / SPEED_OF_LIGHT_M_S, 1, 1, 1, 1])
    power_dbm = LEVEL_DBM - 20 * np.log10(range_m) - loss - hidden_db
    kind = AngleKind.AZIMUTH if sees else AngleKind.CONE
    return ChannelEstimate(
        stop=stop,
        delay_s=(range_m + clock_m + error[:, 0]) / SPEED_OF_LIGHT_M_S,
        aod_azimuth_rad=wrap_angle(shown[:, 0] + error[:, 1]),
        aoa_azimuth_rad=wrap_angle(shown[:, 1] + error[:, 2]),
        power_dbm=power_dbm,
        beam_loss_db=np.zeros(n),
        snr_db=power_dbm + 100,
        covariance=(covariance * unit[:, None] * unit)[:, :n_angles, :n_angles],
        is_los=np.zeros(n, bool),
        aod_elevation_rad=shown[:, 2] + error[:, 3] if sees else None,
        aoa_elevation_rad=shown[:, 3] + error[:, 4] if sees else None,
        aod_angle_kind=kind,
        aoa_angle_kind=kind,
    )
