"""A campaign as the stops of the public measurement file, and such a file made into a campaign directory.

`mat.py` reads and writes the file itself.
"""

import hashlib
import re
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import get_args

import numpy as np

from estimation.channel.beam_power_map import BeamPowerMap
from estimation.channel.record import ChannelEstimate
from estimation.slam.config import MappingConfig, SnapshotConfig
from isac_arena.campaign.config import CampaignConfig
from isac_arena.campaign.directory import CampaignStore, StopEstimate
from isac_arena.campaign.load import read_scene_source
from isac_arena.campaign.lock import one_run
from isac_arena.campaign.measured import (
    PUBLISHED_MAX_POSITION_STD_M,
    PUBLISHED_NOISE,
    MeasuredCampaign,
    MeasuredStop,
    MeasuredTruth,
    clock_walk_m,
)
from isac_arena.campaign.recording import recorded_run
from isac_arena.campaign.side import swapped_in
from isac_arena.exchange.mat import count_stops, read_measurement
from isac_arena.scoring.record import PathKind, PathScores, PathStatus
from scenes.config import load_scene, scene_path
from scenes.names import name_from
from scenes.pose import SPEED_OF_LIGHT_M_S
from scenes.record import empty_record
from sim.truth import Truth

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


def import_campaign(
    file: Path, out: Path, *, tx_offset_deg: float, clock_seed: int | None, method: str, scene: str
) -> int:
    """Write the campaign directory of a measurement file and return its number of stops.

    Raises `ValueError` where the file has another layout, the method is unknown, or the directory holds another
    campaign.
    """
    if method not in METHODS:
        raise ValueError(f"--method = '{method}': must be one of {', '.join(METHODS)}")
    height_m, bias_m = float(load_scene(scene).tx.position_m[2]), None
    if clock_seed is not None:
        bias_m = clock_walk_m(count_stops(file), np.random.default_rng(clock_seed))
    source = read_scene_source(scene_path(scene))
    campaign = read_measurement(file, tx_offset_deg=tx_offset_deg, clock_bias_m=bias_m, height_m=height_m)
    store = CampaignStore(
        directory=out,
        config=settings(name_from(file.stem), method),
        scene_text=scene_text(source.text, campaign),
        measured=_origin(file, tx_offset_deg, clock_seed),
        scene_files=source.files,
    )
    with one_run(out), recorded_run(out), swapped_in(store) as beside:
        beside.open_for_writing()
        load_scene((beside.side or out) / "scene.toml")
        for truth, channel in zip(campaign.truths, campaign.channel, strict=True):
            beside.write_truth(truth)
            no_power_map = replace(empty_record(BeamPowerMap), stop=channel.stop)
            beside.write_channel(StopEstimate(channel, no_power_map))
    return len(campaign.truths)


def settings(name: str, method: str) -> CampaignConfig:
    """Settings of a measured campaign: all paths have the published covariance, as the file holds none."""
    slam = SnapshotConfig.model_validate(
        {"method": method, "noise": PUBLISHED_NOISE, "max_position_std_m": PUBLISHED_MAX_POSITION_STD_M}
    )
    mapping = MappingConfig(noise=PUBLISHED_NOISE)
    return CampaignConfig(name=name, scene="measured", mapping=mapping, slam=slam)


def scene_text(text: str, campaign: MeasuredCampaign) -> str:
    """A scene file with the measured TX and receiver stops in place of its own."""
    position, height_m = campaign.tx.position_m, float(campaign.tx.position_m[2])
    stops = [truth.rx_pose for truth in campaign.truths]
    headings = {stop.heading_rad for stop in stops}
    if len(headings) > 1:
        raise ValueError("sim.rx: the heading changes; only one heading for all stops is known")
    points = ",\n".join(f"    [{x!r}, {y!r}]" for x, y, _ in (stop.position_m.tolist() for stop in stops))
    tx = f"position_m = {position.tolist()}\nheading_deg = {float(np.rad2deg(campaign.tx.heading_rad))!r}\n"
    walk = f"waypoints_m = [\n{points},\n]\nheight_m = {height_m!r}\n"
    walk += f"heading_deg = {float(np.rad2deg(headings.pop()))!r}\n"
    return _with_table(_with_table(text, "tx", tx), "walk", walk)


def _with_table(text: str, name: str, body: str) -> str:
    """TOML with the content of one table replaced."""
    pattern = re.compile(rf"^\[{name}\][^\n]*\n.*?(?=^\[[^\n]*\]|\Z)", re.MULTILINE | re.DOTALL)
    replaced, count = pattern.subn(lambda _: f"[{name}]\n{body}\n", text)
    if count != 1:
        raise ValueError(f"scene: the table [{name}] is found {count} times, once is needed")
    return replaced


def _origin(file: Path, tx_offset_deg: float, clock_seed: int | None) -> str:
    digest = hashlib.sha256(file.read_bytes()).hexdigest()[:16]
    clock = "as in the file" if clock_seed is None else f"10 m and a random walk, seed {clock_seed}"
    return f"{file.name} (sha256 {digest}), TX heading offset {tx_offset_deg:g} deg, clock {clock}"
