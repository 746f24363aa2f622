"""A campaign as the stops of the public measurement file, and measured paths made into a campaign directory.

`mat.py` reads and writes the public file, `path_table.py` reads tables of paths.
"""

import hashlib
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import get_args

import numpy as np
import tomli_w

from estimation.channel.beam_power_map import BeamPowerMap
from estimation.channel.record import ChannelEstimate
from estimation.slam.config import MappingConfig, PathLoss, PathNoise, SnapshotConfig
from isac_arena.campaign.config import CampaignConfig
from isac_arena.campaign.directory import CampaignStore
from isac_arena.campaign.load import SceneSource, read_scene_source
from isac_arena.campaign.lock import one_run
from isac_arena.campaign.measured import (
    PUBLISHED_MAX_POSITION_STD_M,
    PUBLISHED_NOISE,
    MeasuredFile,
    MeasuredStop,
    MeasuredTruth,
    clock_walk_m,
    measured_campaign,
)
from isac_arena.campaign.recording import recorded_run
from isac_arena.campaign.results import StopEstimate
from isac_arena.campaign.side import swapped_in
from isac_arena.exchange.mat import is_layout, read_layout
from isac_arena.exchange.path_table import measured_file, read_table
from isac_arena.exchange.table import MeasuredTable
from isac_arena.scoring.record import PathKind, PathScores, PathStatus
from scenes.config import load_scene, scene_path
from scenes.names import name_from
from scenes.pose import SPEED_OF_LIGHT_M_S, Pose
from scenes.record import FloatArray, empty_record
from scenes.toml_config import naming_field, parse_toml
from sim.truth import Truth

# Of doubtful tables: different angles, lengths over the straight line, lines of sight off it in m.
LEAST_ANGLES, LONGEST_SHARE, LOS_OFF_M = 10, 100, 1.0
# Where the level of the link is unknown, the strongest path of a stop has about this length. Lengths of half to
# twice of it are 6 dB apart from it, beams add some more.
TYPICAL_LENGTH_M, LEVEL_STD_DB = 10.0, 10.0
METHODS = get_args(SnapshotConfig.model_fields["method"].annotation)


def labelled_stops(
    channel: Sequence[ChannelEstimate], truths: Iterable[Truth | MeasuredTruth], paths: PathScores
) -> list[MeasuredStop]:
    """The stops of a measurement file: estimated paths, their ranges without the true clock bias.

    A path has the label of the true path that it was assigned to; a false path has no label.
    """
    stops = []
    for estimate, truth in zip(channel, truths, strict=True):
        rows = paths.take("estimate", paths.stop == estimate.stop)
        rows = rows.take("estimate", np.argsort(rows.path))
        detected = rows.status == PathStatus.DETECTED
        is_single = detected & (rows.kind == PathKind.SINGLE_BOUNCE)
        range_m = SPEED_OF_LIGHT_M_S * (estimate.delay_s - truth.clock_bias_s)
        stops.append(
            MeasuredStop(
                rx=np.array([*truth.rx_pose.position_m[:2], truth.rx_pose.heading_rad]),
                measured=np.column_stack([range_m, estimate.aod_azimuth_rad, estimate.aoa_azimuth_rad]),
                power_dbm=estimate.power_dbm,
                is_los=detected & (rows.kind == PathKind.LOS),
                is_single_bounce=is_single,
                landmark_m=np.where(is_single[:, None], rows.vertex_m, np.nan),
            )
        )
    return stops


@dataclass(frozen=True)
class ImportOptions:
    """How measured paths become a campaign.

    `tx_offset_deg` is added to the TX heading. `clock_seed` draws a clock bias that is added to the ranges.
    `method` is that of SLAM, `scene` the hall to score against, `noise` that of paths without a covariance,
    `path_loss` the powers of lines of sight, None where the level of the link is not known.
    """

    tx_offset_deg: float = 0.0
    clock_seed: int | None = None
    method: str = "statistical"
    scene: str = "campus_arena"
    noise: PathNoise = PUBLISHED_NOISE
    path_loss: PathLoss | None = None


def import_campaign(
    file: Path, out: Path, *, tx_offset_deg: float, clock_seed: int | None, method: str, scene: str
) -> int:
    """Write the campaign directory of a measurement file and return its number of stops.

    Raises `ValueError` where the file has another layout, the method is unknown, or the directory holds another
    campaign.
    """
    options = ImportOptions(tx_offset_deg, clock_seed, method, scene, path_loss=PathLoss())
    return import_measured(file, out, options, read_layout)


def import_paths(file: Path, out: Path, options: ImportOptions) -> tuple[int, list[str]]:
    """Write the campaign directory of a table of paths, or of the public file.

    Returns the number of stops, and lines on columns that are not used and on what is doubtful. Raises as
    `import_campaign`.
    """
    if file.suffix.lower() == ".mat" and is_layout(file):
        return import_measured(file, out, replace(options, path_loss=PathLoss()), read_layout), []
    lines: list[str] = []

    def read(path: Path, scene_tx: Pose) -> MeasuredFile:
        table = read_table(path)
        found = measured_file(table, scene_tx)
        lines.extend([f"not used: {', '.join(table.unused)[:500]}"] * bool(table.unused))
        lines.extend(f"doubtful: {one}" for one in _doubts(table, found))
        return found

    return import_measured(file, out, options, read), lines


def _doubts(table: MeasuredTable, found: MeasuredFile) -> Iterator[str]:
    """Columns that seem to have another unit than their name says."""
    for name in ("aod_azimuth", "aoa_azimuth", "rx_heading"):
        if f"{name}_deg" in table.columns:
            value = table.numbers(f"{name}_deg")
            if len(np.unique(value)) >= LEAST_ANGLES and np.all(np.abs(value) <= 2 * np.pi):
                yield f"{name}_deg: no value is beyond 6.28; are they radians?"
    bias_m = np.zeros(len(found.stops)) if found.bias_m is None else found.bias_m
    away_m = np.array([np.linalg.norm(stop.rx[:2] - found.tx.position_m[:2]) for stop in found.stops])
    straight_m = np.where(np.isnan(bias_m), np.nan, away_m)  # the lengths are not known without the clock
    length_m = np.concatenate([stop.measured[:, 0] for stop in found.stops])
    is_los = np.concatenate([stop.is_los for stop in found.stops])
    straight_m = np.repeat(straight_m, [len(stop.measured) for stop in found.stops])
    with np.errstate(invalid="ignore"):  # the pose may be unknown
        off = is_los & (np.abs(length_m - straight_m) > LOS_OFF_M)
        short, far = length_m < straight_m / 2, length_m > LONGEST_SHARE * (straight_m + 1.0)
    for count, words in ((short.sum(), "shorter than half"), (far.sum(), f"longer than {LONGEST_SHARE} times")):
        if 2 * count > len(length_m):
            yield (
                f"{count} of {len(length_m)} paths are {words} the straight line from the TX to the receiver:"
                " look at the unit of delays, the clock bias and the poses"
            )
            return
    if 2 * off.sum() > max(1, is_los.sum()):
        yield (
            f"{off.sum()} of {is_los.sum()} lines of sight are not as long as the straight line, by more than"
            f" {LOS_OFF_M:g} m: leave clock_bias_s empty where the clock is not known"
        )


def import_measured(
    file: Path, out: Path, options: ImportOptions, read: Callable[[Path, Pose], MeasuredFile]
) -> int:
    """Write the campaign directory of what `read` finds in a file; returns its number of stops."""
    if options.method not in METHODS:
        raise ValueError(f"--method = '{options.method}': must be one of {', '.join(METHODS)}")
    source = read_scene_source(scene_path(options.scene))
    scene = load_scene(options.scene)
    found, first_m = read(file, scene.tx), scene.walk.positions_m()[0]
    n_stops = len(found.stops)
    bias_m = np.zeros(n_stops) if found.bias_m is None else found.bias_m
    if options.clock_seed is not None:
        if np.isnan(bias_m).any():
            stop = int(np.flatnonzero(np.isnan(bias_m))[0])
            raise ValueError(f"--clock-seed: adds to a known clock bias; that of stop {stop} is not in the file")
        bias_m = bias_m + clock_walk_m(n_stops, np.random.default_rng(options.clock_seed))
    tx = Pose(found.tx.position_m, found.tx.heading_rad + float(np.deg2rad(options.tx_offset_deg)))
    try:
        campaign = measured_campaign(tx, found.stops, bias_m, float(tx.position_m[2]), options.noise)
    except ValueError as error:
        raise ValueError(f"{file}: {error}") from error
    is_known = all(stop.covariance is not None for stop in found.stops)
    path_loss = options.path_loss or unknown_level([stop.power_dbm for stop in found.stops])
    config = settings(name_from(file.stem), options.method, None if is_known else options.noise, path_loss)
    hall = measured_scene(file, source, config, campaign.tx, campaign.truths, first_m)
    store = CampaignStore(
        directory=out, config=config, scene_text=hall.text, measured=_origin(file, options), scene_files=hall.files
    )
    with one_run(out), recorded_run(out), swapped_in(store) as beside:
        beside.open_for_writing()
        for truth, channel in zip(campaign.truths, campaign.channel, strict=True):
            beside.write_truth(truth)
            no_power_map = replace(empty_record(BeamPowerMap), stop=channel.stop)
            beside.write_channel(StopEstimate(channel, no_power_map))
    return n_stops


def settings(name: str, method: str, noise: PathNoise | None, path_loss: PathLoss) -> CampaignConfig:
    """Settings of a measured campaign: with `noise` all paths have it, without their own covariances count."""
    slam: dict[str, object] = {"method": method, "path_loss": path_loss}
    if noise is None:
        return CampaignConfig(name=name, scene="measured", slam=SnapshotConfig.model_validate(slam))
    slam |= {"noise": noise, "max_position_std_m": PUBLISHED_MAX_POSITION_STD_M}
    mapping = MappingConfig(noise=noise)
    return CampaignConfig(name=name, scene="measured", mapping=mapping, slam=SnapshotConfig.model_validate(slam))


def unknown_level(power_dbm: Sequence[FloatArray]) -> PathLoss:
    """Powers of lines of sight on a link whose level nobody states: a wide prior about those of stops (path,)."""
    strongest_dbm = [power.max() for power in power_dbm if len(power)]
    level_dbm = float(np.median(strongest_dbm) + 20 * np.log10(TYPICAL_LENGTH_M))
    width = {"std_db": LEVEL_STD_DB, "level_std_db": LEVEL_STD_DB}
    return PathLoss.model_validate({"intercept_dbm": level_dbm, "slope_db": -20.0, **width})


def measured_scene(
    file: Path,
    source: SceneSource,
    config: CampaignConfig,
    tx: Pose,
    truths: Sequence[MeasuredTruth],
    first_m: FloatArray,
) -> SceneSource:
    """The hall with the measured TX and stops; `ValueError` that names the file where they do not fit it."""
    hall = SceneSource(_measured_text(source.text, tx, truths, first_m), source.files)
    with naming_field(str(file), ": "):
        hall.build(config)
    return hall


def _measured_text(text: str, tx: Pose, truths: Sequence[MeasuredTruth], unknown_m: FloatArray) -> str:
    """A scene file with the measured TX and receiver stops in place of its own.

    A stop that was not surveyed stands at `unknown_m` (xyz,): a scene has a place for every stop.
    """
    tables = parse_toml(text)
    for name in ("tx", "txs", "walk", "walks"):
        tables.pop(name, None)
    poses = []
    for pose in (truth.rx_pose for truth in truths):
        is_known = bool(np.isfinite(pose.heading_rad))
        heading_deg = float(np.rad2deg(pose.heading_rad)) if is_known else 0.0
        poses.append([*(pose.position_m if is_known else unknown_m).tolist(), heading_deg])
    heading_deg = float(np.rad2deg(tx.heading_rad))
    tables["tx"] = {"position_m": tx.position_m.tolist(), "heading_deg": heading_deg}
    tables["walk"] = {"type": "poses", "poses": poses}
    return tomli_w.dumps(tables)


def _origin(file: Path, options: ImportOptions) -> str:
    digest = hashlib.sha256(file.read_bytes()).hexdigest()[:16]
    seed = options.clock_seed
    clock = "as in the file" if seed is None else f"10 m and a random walk, seed {seed}"
    return f"{file.name} (sha256 {digest}), TX heading offset {options.tx_offset_deg:g} deg, clock {clock}"
