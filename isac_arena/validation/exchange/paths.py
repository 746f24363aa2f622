"""Measured paths as a table through `import-paths`, against the same paths through `import-mat`."""

from dataclasses import fields
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pyarrow as pa
from pyarrow.csv import write_csv

from estimation.slam.config import PathLoss
from isac_arena.campaign.chain.inputs import known_receiver
from isac_arena.campaign.directory import CampaignStore, open_campaign
from isac_arena.campaign.results import MapResult
from isac_arena.exchange.mat import read_layout
from isac_arena.exchange.measurement import ImportOptions, import_campaign, import_paths
from isac_arena.validation.measured_data import FILE, data_folder, with_values
from isac_arena.validation.measurement import Measurement, at_most
from isac_arena.workers.stops import campaign_run
from scenes.pose import Pose
from scenes.record import Record, parts_of

TX_OFFSET_DEG = -1.6
QUICK_STOPS = 8


def check_paths(seed: int, quick: bool) -> list[Measurement]:
    """The measured hall as a CSV table: the same bits in the maps of mapping and SLAM."""
    del seed
    row = at_most(
        "exchange.paths.other_bits", np.nan, 0, "values of the maps that differ from those of import-mat"
    )
    return with_values([row], lambda: [_differing(QUICK_STOPS if quick else None)])


def path_table(file: Path, n_stops: int | None) -> pa.Table:
    """The paths of a public measurement file as a table, of its first stops or all."""
    found = read_layout(file, Pose(np.zeros(3), 0.0))
    columns: dict[str, list[Any]] = {}
    for number, stop in enumerate(found.stops[:n_stops]):
        n = len(stop.measured)
        rows = {
            "stop": [number] * n,
            "range_m": stop.measured[:, 0], "aod_azimuth_rad": stop.measured[:, 1],
            "aoa_azimuth_rad": stop.measured[:, 2], "power_dbm": stop.power_dbm,
            "rx_x_m": [stop.rx[0]] * n, "rx_y_m": [stop.rx[1]] * n, "rx_heading_rad": [stop.rx[2]] * n,
            "tx_x_m": [found.tx.position_m[0]] * n, "tx_y_m": [found.tx.position_m[1]] * n,
            "tx_heading_rad": [found.tx.heading_rad] * n,
            "label": np.select([stop.is_los, stop.is_single_bounce], ["los", "single_bounce"], "none"),
            "ip_x_m": stop.landmark_m[:, 0], "ip_y_m": stop.landmark_m[:, 1],
        }  # fmt: skip
        for name, values in rows.items():
            columns.setdefault(name, []).extend(np.asarray(values).tolist())
    return pa.table(columns)


def _differing(n_stops: int | None) -> int:
    file = data_folder() / FILE
    with TemporaryDirectory() as name:
        folder = Path(name)
        import_campaign(
            file,
            folder / "mat",
            tx_offset_deg=TX_OFFSET_DEG,
            clock_seed=1,
            method="statistical",
            scene="campus_arena",
        )
        write_csv(path_table(file, None), str(folder / "table.csv"))
        options = ImportOptions(TX_OFFSET_DEG, clock_seed=1, path_loss=PathLoss())  # of that hall, as import-mat
        import_paths(folder / "table.csv", folder / "csv", options)
        one, other = (_maps(open_campaign(folder / kind), n_stops) for kind in ("mat", "csv"))
    return sum(_other_values(one[name], other[name]) for name in one)


def _maps(store: CampaignStore, n_stops: int | None) -> dict[str, MapResult]:
    run = campaign_run(store)
    stops = list(run.chosen_stops)[:n_stops]
    estimates, truths = [store.estimate(stop) for stop in stops], [store.measured_truth(stop) for stop in stops]
    channel = [one for one in estimates if one is not None]
    receiver = known_receiver(one for one in truths if one is not None)
    run = type(run)(store.config, store.scene, stops=stops)
    return {str(name): found for name, found in run.maps(channel, receiver).items()}


def _other_values(one: Record, other: Record) -> int:
    """How many values of two records differ; of arrays of other shapes all count."""
    count = 0
    for spec in fields(one):
        if "axes" in spec.metadata:
            a, b = np.asarray(getattr(one, spec.name)), np.asarray(getattr(other, spec.name))
            same = a.shape == b.shape and np.array_equal(a, b, equal_nan=a.dtype.kind == "f")
            count += 0 if same else max(a.size, b.size, 1)
    inner = parts_of(other)
    return count + sum(_other_values(part, inner[name]) for name, part in parts_of(one).items())
