"""Export of campaigns in the formats of other tools: which file holds what."""

import json
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from isac_arena.campaign import stored
from isac_arena.campaign.directory import CampaignStore
from isac_arena.campaign.files import write_bytes
from isac_arena.exchange.deepmimo import scene_facets, write_deepmimo
from isac_arena.exchange.geojson import map_geojson
from isac_arena.exchange.mat import measurement_bytes
from isac_arena.exchange.measurement import labelled_stops
from isac_arena.report.figures.path_lines import COLORS, path_kind
from scenes.meshes.mesh import Polyline3d, glb_bytes
from scenes.names import path_in
from scenes.record import FloatArray
from scenes.walks.tum import tum_text
from sim.links import link_nodes
from sim.propagation.deepmimo.scenario import PathScenario
from sim.propagation.paths import Paths
from sim.truth import Truth


def write_mat(store: CampaignStore, folder: Path) -> Iterator[Path]:
    """The estimates and labels as the public measurement file lays them out; of several TX a file for each."""
    scene, tables = store.scene, store.score_tables()
    if tables is None:
        raise ValueError(f"{store.directory}: the score is missing or out of date; run 'arena score' first")
    every = [estimate.channel for estimate in stored.channel_estimates(store, len(scene.stops))]
    for tx, (ending, node) in enumerate(_transmitters(store)):
        channel = [estimate.take("path", estimate.tx == tx) for estimate in every]
        truths = (one for one in stored.known_stops(store, every) if not isinstance(one, Truth) or one.tx == tx)
        labels = tables.paths.take("estimate", tables.paths.tx == tx)
        content = measurement_bytes(scene.txs[node], labelled_stops(channel, truths, labels))
        yield _written(path_in(folder, f"{store.config.name}{ending}.mat"), content)


def write_tum(store: CampaignStore, folder: Path) -> Iterator[Path]:
    """The true trajectory and that of SLAM, one stop per second."""
    scene = store.scene
    poses = scene.stops
    position = np.array([pose.position_m for pose in poses])
    heading = np.array([pose.heading_rad for pose in poses])
    found = stored.stored_results(store, len(poses)).slam.poses
    height = np.where(np.isfinite(found.height_m), found.height_m, scene.walk.height_m)
    estimate = np.column_stack([found.position_m, height])
    time_s = np.arange(len(poses), dtype=float)  # one stop per second: a walk has no clock
    for name, text in (
        ("truth", tum_text(time_s, position, heading)),
        ("slam", tum_text(found.stop.astype(float), estimate, found.heading_rad)),
    ):
        yield _written(path_in(folder, f"{name}.tum"), text.encode())


def write_geojson(store: CampaignStore, folder: Path) -> Iterator[Path]:
    """The maps of mapping and SLAM with the true outlines."""
    scene = store.scene
    results = stored.stored_results(store, len(scene.stops))
    for name, result in (("mapping", results.mapping), ("slam", results.slam)):
        text = json.dumps(map_geojson(scene, result), allow_nan=False)
        yield _written(path_in(folder, f"{name}.geojson"), text.encode())


def write_scenario(store: CampaignStore, folder: Path, max_paths: int) -> Iterator[Path]:
    """The true paths as a DeepMIMO v4 scenario in a folder named after the campaign, of several TX one for each.

    Yields their params.json.
    """
    scene = store.scene
    for tx, (ending, node) in enumerate(_transmitters(store)):
        scenario = PathScenario(
            tx_position_m=scene.txs[node].position_m,
            rx_position_m=np.array([pose.position_m for pose in scene.stops]),
            carrier_hz=store.config.waveform.carrier_ghz * 1e9,
            paths=tuple(truth.paths for truth in _true_paths(store) if truth.tx == tx),
        )
        name = f"{store.config.name}{ending}".lower()
        yield write_deepmimo(path_in(folder, name), scenario, scene_facets(scene), max_paths)


def write_glb(store: CampaignStore, file: Path, stop: int, max_paths: int) -> Path:
    """The scene with the strongest true paths of a stop, of every TX, named by their kind."""
    scene = store.scene
    if stop >= len(scene.stops):
        raise ValueError(f"--stop = {stop}: the walk has stops 0 to {len(scene.stops) - 1}")
    rays: list[Polyline3d] = []
    for truth in (one for one in _true_paths(store) if one.stop == stop):
        ending, node = _transmitters(store)[truth.tx]
        tx, rx = truth.tx_pose or scene.txs[node], truth.rx_pose
        own = _rays(truth.paths, tx.position_m, rx.position_m, max_paths)
        rays += [replace(ray, name=f"{ending[1:]} {ray.name}".strip()) for ray in own]
    return _written(file, glb_bytes(scene, polylines=rays))


def _rays(paths: Paths, tx_m: FloatArray, rx_m: FloatArray, max_paths: int) -> list[Polyline3d]:
    """The strongest paths as lines from TX to RX, numbered by strength within their kind."""
    lines: list[Polyline3d] = []
    seen: Counter[str] = Counter()
    for path in np.argsort(-paths.power, kind="stable")[:max_paths]:
        n = int(paths.n_interactions[path])
        kind = path_kind(paths.bounce_kind[path, :n])
        seen[kind] += 1
        corners = np.vstack([tx_m, paths.vertex_m[path, :n], rx_m])
        lines.append(Polyline3d(f"{kind} {seen[kind]}", COLORS[kind], corners))
    return lines


def _transmitters(store: CampaignStore) -> list[tuple[str, str]]:
    """The ending of the names of files, and the fixed node, of every TX or link; of one TX the ending is empty."""
    nodes = link_nodes(store.config, store.scene)
    return [(f"_{name}" if len(nodes) > 1 else "", node) for name, node in nodes.items()]


def _true_paths(store: CampaignStore) -> Iterator[Truth]:
    if store.measured is not None:
        raise ValueError(f"{store.directory}: a measured campaign has no true paths to export")
    return stored.stored_truths(store, len(store.scene.stops))


def _written(file: Path, content: bytes) -> Path:
    write_bytes(file, content)
    return file
