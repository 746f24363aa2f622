"""Cramer-Rao bounds of the channel parameters of a campaign, over the plan and along the walk."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from rich.table import Table

from estimation.channel.model.crb import PathBounds
from estimation.channel.model.manifold import Manifold
from isac_arena.insight.bounds.position import BoundInputs, PlanGrid
from isac_arena.report.figures.bound import ChannelBoundMap
from isac_arena.scoring.link_view import true_path_bounds
from isac_arena.scoring.provenance import path_origin
from isac_arena.scoring.record import PathKind
from scenes.pose import SPEED_OF_LIGHT_M_S, Pose
from scenes.record import BoolArray, FloatArray
from sim.propagation.paths import Paths
from sim.signal.link import Link, best_beam_power_dbm, make_link
from sim.simulate import in_direction
from sim.truth import Truth

LEAST_SNR_DB = 10.0  # weaker paths are not detected


@dataclass(frozen=True)
class ChannelModel:
    """A campaign's link, the manifolds of its beams, and whether its hardware keeps phases between beam pairs."""

    prepared: BoundInputs
    link: Link
    tx: Manifold
    rx: Manifold
    is_coherent: bool


def channel_model(prepared: BoundInputs) -> ChannelModel:
    """The channel model of a campaign; a CFO or phase noise between beam pairs makes it incoherent."""
    link = make_link(prepared.config)
    hardware = prepared.config.impairments
    keeps_phase = not (hardware.cfo_hz or hardware.phase_noise_pair_deg)
    return ChannelModel(prepared, link, Manifold(link.tx_codebook), Manifold(link.rx_codebook), keeps_phase)


def stop_bounds(model: ChannelModel, paths: Paths, rx_pose: Pose, *, coherent: bool) -> tuple[Paths, PathBounds]:
    """The paths of a place with at least `LEAST_SNR_DB` and their bounds, for joint estimation of all of them.

    In an uplink what is at the place sends.
    """
    link, scene = model.link, model.prepared.scene
    truth = in_direction(model.prepared.config, scene, Truth(paths, rx_pose, 0, 0.0))
    paths, rx_pose, tx_pose = truth.paths, truth.rx_pose, truth.tx_pose or scene.tx
    power_dbm = best_beam_power_dbm(paths, link, tx_pose, rx_pose)
    noise_dbm = 10 * np.log10(link.noise_power_mw.min() / len(link.frequency_offset_hz))
    paths = paths.take("path", power_dbm - noise_dbm >= LEAST_SNR_DB)
    manifolds, poses = (model.tx, model.rx), (tx_pose, rx_pose)
    return paths, true_path_bounds(link, manifolds, paths, poses, coherent=coherent)


def over_plan(model: ChannelModel, grid: PlanGrid) -> ChannelBoundMap:
    """Bounds of the strongest path at every place; the receiver has the heading of the first stop."""
    shape = grid.is_free.shape
    std = np.full((3, *shape), np.nan)
    heading = float(model.prepared.scene.walk.headings_rad()[0])
    for at, position, paths in zip(np.argwhere(grid.is_free), grid.position_m, grid.paths, strict=True):
        pose = Pose(position, heading)
        kept, bounds = stop_bounds(model, paths, pose, coherent=model.is_coherent)
        if not len(kept):
            std[(slice(None), *at)] = np.inf
            continue
        best = int(np.argmax(bounds.snr_db))
        angles = bounds.aod_std_rad[best, 0], bounds.aoa_std_rad[best, 0]
        std[(slice(None), *at)] = bounds.delay_std_s[best], *angles
    return ChannelBoundMap(grid.x_m, grid.y_m, std[0], std[1], std[2], grid.has_los, model.is_coherent)


def along_walk(model: ChannelModel, stops: Sequence[int]) -> Table:
    """Median bounds of LOS and single bounces over some stops of the walk, coherent and incoherent."""
    poses = [model.prepared.scene.stops[stop] for stop in stops]
    position_m = np.array([pose.position_m for pose in poses])
    places = list(zip(poses, model.prepared.solver.paths(position_m), strict=True))
    table = Table(
        "median bound", "LOS", "LOS, by power", "1 bounce", "1 bounce, by power", "unit",
        caption="Cramér-Rao bounds over the stops of the walk, of all paths of a stop together: a strong path "
        "within a cell of another can have a larger bound than a weak one that stands alone. "
        "SNR: of a path in its best beam pair, over the noise there, after summing its subcarriers. "
        "By power: from the powers of the beam pairs without their phases, which a frequency offset (CFO) or "
        "phase noise changes from pair to pair",
        caption_justify="left",
    )  # fmt: skip
    for column in range(1, 5):
        table.columns[column].justify = "right"
    kinds: dict[PathKind, list[FloatArray]] = {PathKind.LOS: [], PathKind.SINGLE_BOUNCE: []}
    for coherent in (True, False):
        found = [stop_bounds(model, paths, pose, coherent=coherent) for pose, paths in places]
        for kind, columns in kinds.items():
            rows = [_table_rows(bounds, path_origin(kept).kind == kind) for kept, bounds in found]
            columns.append(_median(np.concatenate(rows)))
    values = np.stack([column for columns in kinds.values() for column in columns])
    for index, (label, unit) in enumerate(
        [
            ("SNR", "dB"),
            ("delay", "ps"),
            ("path length", "mm"),
            ("AoD azimuth", "0.001 deg"),
            ("AoA azimuth", "0.001 deg"),
        ]
    ):
        cells = ["-" if np.isnan(value) else f"{value:.3g}" for value in values[:, index]]
        table.add_row(label, *cells, unit)
    return table


def _table_rows(bounds: PathBounds, chosen: BoolArray) -> FloatArray:
    """SNR in dB, delay in ps and mm, AoD and AoA azimuth in 0.001 deg (path, 5) of the chosen paths."""
    delay = bounds.delay_std_s
    angles = 1e3 * np.rad2deg(np.stack([bounds.aod_std_rad[:, 0], bounds.aoa_std_rad[:, 0]], axis=1))
    return np.column_stack([bounds.snr_db, 1e12 * delay, 1e3 * SPEED_OF_LIGHT_M_S * delay, angles])[chosen]


def _median(rows: FloatArray) -> FloatArray:
    return np.asarray(np.median(rows, axis=0)) if len(rows) else np.full(rows.shape[1], np.nan)
