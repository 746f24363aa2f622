"""The plan of a run: what is done, what is doubtful and what is refused, before the first stop is computed."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from isac_arena.campaign.chain.inputs import walk_settings
from isac_arena.campaign.config import CampaignConfig, methods
from isac_arena.progress import counted, listed
from isac_arena.scoring.doubts import few_stops
from scenes.objects.clutter import Clutter
from scenes.pose import SPEED_OF_LIGHT_M_S
from scenes.record import FloatArray, concatenate
from scenes.scene import Scene, SceneObject
from scenes.walks.trajectory import LEAST_STOPS, follow_one_another
from sim.config import ArrayConfig, LinkKind, PropagationConfig
from sim.links import TxLink, tx_links
from sim.propagation.paths import Paths
from sim.signal.link import Link, best_beam_power_dbm, line_of_sight_at_1m_dbm

MOST_STOPS = 60  # looked at, evenly over the walk
LEAST_BIAS_M = 0.02  # of positions, from heights that the beams do not see: smaller ones are not told
BEHIND_DB = 25.0  # a line of sight weaker than this in the best beams lies behind the panels
COARSE = 4.0  # a delay cell of so many times the extent of an object shows it as a point
LARGE_MESH = 3.0  # times the extent of all else: a mesh in another unit is a hundred times larger
SMALL_MESH_M = 0.05  # ten wavelengths at 60 GHz: smaller things reflect next to nothing
FAR_M = 1.0  # beyond bounds, floor or ceiling: walls have a thickness
OTHER_UNIT = 300.0  # times the extent of TX and walk, or of the objects: the other is in another unit
LONGEST_M = 1000.0  # extent of TX and walk; a link at 60 GHz reaches less
ELEVATION_METHODS = "'coherent', 'incoherent' or 'auto'"
SAMPLE_BYTES = 8
ROLES = {
    LinkKind.DOWNLINK: "downlink",
    LinkKind.UPLINK: "uplink",
    LinkKind.NODES: "node to node",
    LinkKind.MONOSTATIC: "monostatic",
}
HEIGHTS = "see 'Heights' in the README for the settings that mend it"


@dataclass(frozen=True)
class RunPlan:
    """What a run does in one line, a sentence for everything doubtful, and the notices of the scene."""

    does: str
    doubts: tuple[str, ...]
    notices: tuple[str, ...] = ()


def check_elevations(config: CampaignConfig) -> None:
    """Raise `ValueError` where beams have several elevations and the channel method ignores them."""
    for name, array in (("tx_array", config.tx_array), ("rx_array", config.rx_array)):
        if len(elevations_deg(array)) > 1 and methods(config)["channel"] == "power":
            raise ValueError(
                f"channel.method = 'power': estimates no elevation, but {name} has beams at several; take "
                f"{ELEVATION_METHODS}, or one beam_elevation_deg and one panel_tilt_deg"
            )


def elevations_deg(array: ArrayConfig) -> list[float]:
    """The elevations of the beams of an array in the device frame."""
    return sorted({tilt + beam for tilt in array.panel_tilt_deg for beam in array.beam_elevation_deg})


def plan_run(config: CampaignConfig, scene: Scene, link: Link) -> RunPlan:
    """The plan of a campaign that passes `check_elevations`."""
    n_pairs = len(link.tx_codebook) * len(link.rx_codebook)
    megabytes = 1e-6 * SAMPLE_BYTES * n_pairs * link.prs_symbol.shape[1]
    links = tx_links(config, scene)
    what = "links" if config.links else "TX"
    sweeps = f" of each of {len(links)} {what}" if len(links) > 1 else ""
    does = (
        f"{len(scene.stops)} stops, {n_pairs} beam pairs{sweeps}, channel estimates by "
        f"{methods(config)['channel']}, {slam_of(config, scene, links)}; {megabytes:.0f} MB of samples a stop"
        f"{'; links: ' + link_roles(links) if config.links else ''}"
    )
    if config.propagation.deepmimo is not None:
        return RunPlan(does, tuple(_about_settings(config, scene)), scene.notices)
    step = -(-len(scene.stops) // MOST_STOPS)
    by_tx = [_seen_paths(config, one, step) for one in links]
    of_any = {stop: [seen[stop] for seen in by_tx if stop in seen] for stop in range(0, len(scene.stops), step)}
    seen = {stop: concatenate(parts, "path") for stop, parts in of_any.items()}
    walks = links[0].config.role.receiver is None
    heights = _about_heights(config, scene, link, by_tx[0]) if walks else ()
    in_sight = (*heights, *_about_sight(scene, seen))
    about = (*_about_settings(config, scene), *in_sight, *scene_doubts(scene), *_about_cells(scene, link))
    return RunPlan(does, (*about, *_about_stops(config, scene)), scene.notices)


def slam_of(config: CampaignConfig, scene: Scene, links: Sequence[TxLink[CampaignConfig]]) -> str:
    """What SLAM does: fixed nodes have known poses, and are not asked for theirs."""
    walking = sorted({stop for link in links if link.config.role.receiver is None for stop in link.stops})
    if not walking:
        return "no SLAM: all poses are those of fixed nodes"
    if function := config.functions.of("slam"):
        return f"SLAM of all stops by {function.function}"
    together = walk_settings(config, scene.walk.positions_m()[walking])
    n_nodes = len(scene.stops) - len(walking)
    rest = f" but the {n_nodes} at fixed nodes" if n_nodes else ""
    return f"SLAM of all stops{rest} together" if together else f"SLAM of every stop{rest} alone"


def link_roles(links: Sequence[TxLink[CampaignConfig]]) -> str:
    """The links of every kind."""
    parts = []
    for kind in LinkKind:
        names = [link.name for link in links if link.config.role.kind == kind]
        if names:
            parts.append(f"{ROLES[kind]} {listed(names)}")
    return "; ".join(parts)


def _seen_paths(config: CampaignConfig, link: TxLink[CampaignConfig], step: int) -> dict[int, Paths]:
    """Line of sight and single reflections at every step-th stop that a link has, by the stop."""
    stops = [stop for stop in range(0, len(link.scene.stops), step) if stop in link.stops]
    return _first_paths(link.scene, config.waveform.carrier_ghz * 1e9, config.propagation, stops)


def _first_paths(
    scene: Scene, carrier_hz: float, settings: PropagationConfig, stops: Iterable[int]
) -> dict[int, Paths]:
    """Line of sight and single reflections at some stops."""
    from sim.propagation.propagator import Propagator  # noqa: PLC0415  (slow to import)

    changes = {"max_bounces": min(1, settings.max_bounces), "diffuse_samples": 0, "diffraction": False}
    propagator = Propagator(scene, carrier_hz, settings.model_copy(update=changes))
    return {stop: propagator.paths(scene.stops[stop].position_m) for stop in stops}


def _about_settings(config: CampaignConfig, scene: Scene) -> Iterator[str]:
    """What the settings alone tell: heights that are neither seen nor used, no movers, stops without an order."""
    sees = any(len(elevations_deg(array)) > 1 for array in (config.tx_array, config.rx_array))
    known_use = _use_of_heights(config)
    if not sees and known_use:
        bias_m, height_m = _height_bias_m(scene)
        if bias_m > LEAST_BIAS_M:
            yield (
                f"TX and receiver differ by up to {height_m:.2g} m in height, the beams are horizontal and the "
                f"known heights are {known_use}: expect positions and points "
                f"about {bias_m:.2g} m off; {HEIGHTS}"
            )
    elif sees and (not config.slam.solves_in_space or not config.mapping.use_elevation):
        yield "elevations are estimated, but slam or mapping ignores them (slam.method, use_elevation)"
    if (tracker := config.functions.of("tracker")) and not scene.is_moving:
        yield f"nothing moves in scene '{scene.name}': {tracker.function} (functions.tracker) is not called"
    trajectory = walk_settings(config, scene.walk.positions_m())
    if len(scene.stops) >= LEAST_STOPS and trajectory and not follow_one_another(scene.walk.positions_m()):
        yield (
            f"the stops do not follow one another, but trajectory.method = '{trajectory.method}' takes them "
            "for one walk: leave it out"
        )


def sight_doubts(scene: Scene, carrier_hz: float) -> Iterator[str]:
    """Stops of a scene that receive nothing, and objects and meshes that reflect to none, by default settings."""
    step = -(-len(scene.stops) // MOST_STOPS)
    return _about_sight(
        scene, _first_paths(scene, carrier_hz, PropagationConfig(), range(0, len(scene.stops), step))
    )


def scene_doubts(scene: Scene) -> Iterator[str]:
    """What has another unit than all else, lies out of the bounds, or where something else stands."""
    devices = np.vstack([scene.walk.positions_m()[:, :2], scene.tx.position_m[:2]])
    around = [corner[:2] for item in scene.fixtures for corner in item.bounds_m]
    devices_m, objects_m = _extent_m(devices), _extent_m(np.reshape(around, (-1, 2))) if around else 0.0
    spans = f"TX and walk span {devices_m:.1f} m, the objects {objects_m:.1f} m"
    if around and max(devices_m, objects_m) > OTHER_UNIT * max(1.0, min(devices_m, objects_m)):
        yield f"{spans}: are some in millimetres? All lengths are in metres"
    elif devices_m > LONGEST_M:
        yield f"{spans}: are they in millimetres? All lengths are in metres"
    places_m = np.vstack([devices, *around])
    low, high, extent_m = places_m.min(axis=0), places_m.max(axis=0), _extent_m(places_m)
    for mesh in scene.clutter:
        mesh_m = np.array(mesh.bounds_m)[:, :2]
        if (size_m := _extent_m(mesh_m)) > LARGE_MESH * extent_m:
            yield f"mesh {mesh.name} is {size_m:.4g} m large, all else {extent_m:.3g} m: {mesh.unit_hint}"
        elif (size_m := float(np.ptp(mesh.bounds_m, axis=0).max())) < SMALL_MESH_M:
            larger = f"scale = 1000 makes it {1000 * size_m:.2g} m"
            hint = larger if mesh.scale == 1.0 else mesh.unit_hint
            yield f"mesh {mesh.name} is {1000 * size_m:.2g} mm large, too small for an echo: {hint}"
        elif (mesh_m[1] < low).any() or (mesh_m[0] > high).any():
            yield f"mesh {mesh.name} lies outside of all else: check its position_m and scale"
        met = [item.name for item in scene.fixtures if not item.may_overlap and mesh.overlaps(item)]
        if met and not scene.movers.keys() & {mesh.name, *met}:
            yield f"mesh {mesh.name} overlaps {listed(met)}: move one of them"
    solids: list[SceneObject | Clutter] = [*scene.fixtures, *scene.clutter]
    beyond = {item.name: _beyond_m(scene, item) for item in solids}
    if far := [name for name, out_m in beyond.items() if out_m > FAR_M]:
        yield (
            f"up to {max(beyond.values()):.3g} m out of bounds_m, floor or ceiling: {listed(far)}; "
            "check their units and places, or bounds_m"
        )


def _beyond_m(scene: Scene, item: SceneObject | Clutter) -> float:
    """How far something reaches out of the bounds, below the floor or above the ceiling."""
    x_min, y_min, x_max, y_max = scene.bounds_m
    low = np.array([x_min, y_min, scene.floor.z_m if scene.floor else -np.inf])
    high = np.array([x_max, y_max, scene.ceiling.z_m if scene.ceiling else np.inf])
    item_low, item_high = item.bounds_m
    return float(max(*(low - item_low), *(item_high - high)))


def _about_stops(config: CampaignConfig, scene: Scene) -> Iterator[str]:
    """Walks that are too short for SLAM or contours."""
    if walk_settings(config, scene.walk.positions_m()):
        yield from few_stops(len(scene.stops))
    if len(scene.stops) < config.contours.min_samples:
        yield (
            f"{counted(len(scene.stops), 'stop')}: an object reflects to each stop once, and clusters need "
            f"{config.contours.min_samples} close points (contours.min_samples): few contours or none"
        )


def _use_of_heights(config: CampaignConfig) -> str:
    """How known heights are used, if not everywhere; empty if they are."""
    if not config.heights.use:
        return "not used (heights.use = false)"
    if function := config.functions.of("channel"):
        what = "gives cone angles and says so (aod_angle_kind = 'cone', as the file of 'arena new estimator' does)"
        return f"used only where {function.function} {what}. Elsewhere"
    return "not used (slam.method = 'reference')" if config.slam.method == "reference" else ""


def _height_bias_m(scene: Scene) -> tuple[float, float]:
    """Median excess of the line of sight over its length in the plan, and the largest difference in height."""
    offset = scene.walk.positions_m() - scene.tx.position_m
    excess = np.linalg.norm(offset, axis=1) - np.linalg.norm(offset[:, :2], axis=1)
    return float(np.median(excess)), float(np.abs(offset[:, 2]).max())


def _about_sight(scene: Scene, seen: dict[int, Paths]) -> Iterator[str]:
    """Stops that receive nothing, and objects and meshes that reflect to no stop."""
    dark = [stop for stop, paths in seen.items() if not len(paths)]
    if dark:
        yield f"no line of sight and no single reflection reaches stop {listed(dark)}"
    names = np.array([*scene.object_names, *(mesh.name for mesh in scene.clutter)])
    reflecting = {
        str(paths.object_name[item])
        for paths in seen.values()
        for item in np.unique(paths.bounce_object)
        if item >= 0
    }
    unseen = [name for name in names.tolist() if name not in reflecting]
    meshes = [mesh.name for mesh in scene.clutter if mesh.name in unseen]
    objects = [name for name in unseen if name not in meshes]
    if objects:
        yield f"no single reflection reaches a stop from {listed(objects)}: at most an edge of these is found"
    if meshes:
        yield (
            f"no flat facet of mesh {listed(meshes)} reflects to a stop: it only blocks and scatters; what is "
            "round reflects where it is drawn as a circle or spline"
        )


def _about_heights(config: CampaignConfig, scene: Scene, link: Link, seen: dict[int, Paths]) -> Iterator[str]:
    """Lines of sight that the beams pass above or below, and those behind the panels."""
    level_dbm = line_of_sight_at_1m_dbm(config)
    reflection_db = config.channel.los.reflection_loss_db  # a line of sight with this loss is taken for a bounce
    passed: dict[str, float] = {}
    behind: list[str] = []
    for stop, paths in seen.items():
        los = paths.take("path", paths.is_los)
        if not len(los):
            continue
        flat = replace(los, aod_elevation_rad=np.zeros(len(los)), aoa_elevation_rad=np.zeros(len(los)))
        free_dbm = level_dbm - 20 * np.log10(SPEED_OF_LIGHT_M_S * los.delay_s[0])
        loss_db, flat_loss_db = (
            free_dbm - best_beam_power_dbm(one, link, scene.tx, scene.stops[stop])[0] for one in (los, flat)
        )
        if flat_loss_db > BEHIND_DB:
            behind.append(str(stop))
        elif loss_db >= reflection_db and flat_loss_db < loss_db / 2:
            passed[str(stop)] = loss_db
    if passed:
        yield (
            f"the beams pass above or below the line of sight of stop {listed(passed)}: it arrives up to "
            f"{max(passed.values()):.0f} dB too weak; {_expected(config)}; {HEIGHTS}"
        )
    if behind:
        yield f"the beams do not cover the line of sight of stop {listed(behind)}: turn or add panels"


def _expected(config: CampaignConfig) -> str:
    """What becomes of stops with a weak line of sight: `arena validate heights` has both cases."""
    method = config.channel.method
    if method == "power" or config.functions.of("channel"):
        return "taken for a reflection, such stops may be lost or decimetres off"
    return f"'{method}' still places such stops to centimetres or better, but not floor and ceiling"


def _about_cells(scene: Scene, link: Link) -> Iterator[str]:
    """Objects that are small beside the delay cell of the signal."""
    step_hz = float(np.diff(link.frequency_offset_hz[:2])[0])
    cell_m = SPEED_OF_LIGHT_M_S / (step_hz * len(link.frequency_offset_hz))
    small = [
        item.name for item in scene.fixtures
        if item.contour.closed and item.kind != "wall"
        and _extent_m(np.reshape(item.contour.bounds_m, (2, 2))) * COARSE < cell_m
    ]  # fmt: skip
    if small:
        yield f"a delay cell is {cell_m:.2g} m long, these are far smaller and look like points: {listed(small)}"


def _extent_m(point_m: FloatArray) -> float:
    """The longer side of the box around points (point, xy)."""
    return float(np.ptp(point_m, axis=0).max())
