"""`arena validate multistatic`: uplinks against their downlinks, and monostatic nodes against closed forms."""

from dataclasses import replace

import numpy as np
from scipy.optimize import brentq

from estimation.laws import plane as plane_law
from estimation.slam.mapping.point_fit import point_covariance
from isac_arena.campaign.config import CampaignConfig
from isac_arena.campaign.driver import CampaignRun
from isac_arena.campaign.results import CampaignResults
from isac_arena.scoring.record import PathStatus
from isac_arena.scoring.stages.poses import from_node, plane_paths, true_state
from isac_arena.validation.measurement import Measurement, at_most
from isac_arena.validation.monte_carlo import band_rows, generators
from isac_arena.validation.multistatic.arenas import draw_arena
from scenes.contours.smooth import Circle
from scenes.pose import wrap_angle
from scenes.record import FloatArray
from scenes.scene import Scene
from sim.links import with_link_stops
from sim.propagation.paths import Paths
from sim.propagation.propagator import Propagator
from sim.signal.link import best_beam_power_dbm
from sim.truth import Truth

N_STOPS = 4
N_NODES = 3
ISOLATION_DB = 60.0
PANEL_M = 0.2  # apart, along the face of a node
SETTINGS = {"method": "coherent", "maximum_likelihood": {"max_paths": 30}}
SAME = (0.8, 1.25)  # of equal errors with the noise of other samples


def check_uplink(seed: int, quick: bool) -> list[Measurement]:
    """Arenas with an uplink and its downlink: paths traced from both ends, bounds, and errors of maps."""
    apart, bound = np.zeros(3), 0.0
    over: dict[str, list[FloatArray]] = {"walk": [], "tx": []}
    for rng in generators(seed, 2 if quick else 20, 31):
        loaded, _ = draw_arena(rng, 0, N_STOPS)
        up, down = (linked_run(loaded.config, loaded.scene, [ends]) for ends in (("walk", "tx"), ("tx", "walk")))
        for truth in up.truths():
            apart = np.maximum(apart, _apart(truth.paths, _traced_back(down, truth)))
        stops = [list(run.true_stops(run.truths())) for run in (up, down)]
        for one, other in zip(*stops, strict=True):
            own, its = (np.diagonal(each.covariance, axis1=1, axis2=2) for each in (from_node(one), other))
            clear = one.is_separable & other.is_separable
            bound = max(bound, float(np.abs(own[clear] / its[clear] - 1).max()))
        for name, run in (("walk", up), ("tx", down)):
            over[name].append(point_errors(run))
    ratio = {name: float(np.sqrt(np.mean(np.concatenate(each) ** 2))) for name, each in over.items()}
    share = ratio["walk"] / ratio["tx"]
    spread = share * float(np.sqrt(sum(1 / (4 * sum(map(len, each))) for each in over.values())))
    key = "multistatic.uplink"
    return [
        at_most(f"{key}.length_m", apart[0], 1e-9, "paths of the uplink, and of a trace from its other end", "m"),
        at_most(f"{key}.angle_rad", apart[1], 1e-6, "their departures and arrivals", "rad"),
        at_most(f"{key}.gain", apart[2], 1e-6, "their gains, relative"),
        at_most(
            f"{key}.bound", bound, 1e-6, "bounds of its separable paths over the downlink's, less 1: rounding"
        ),
        at_most(f"{key}.points_over_bound", ratio["walk"], 1.5, "RMSE of the points of the map over their bound"),
        at_most(f"{key}.downlink_over_bound", ratio["tx"], 1.5, "the same of the downlink"),
        *band_rows(f"{key}.over_downlink", share, SAME, spread, quick, "an uplink maps as its downlink does"),
    ]


def check_monostatic(seed: int, quick: bool) -> list[Measurement]:
    """Arenas with nodes that hear themselves: echoes against closed forms, leakage, clock, and errors of maps."""
    length_m, angle_rad, leak_db, clock_s, count = 0.0, 0.0, 0.0, 0.0, 0
    over = []
    for rng in generators(seed, 3 if quick else 30, 32):
        loaded, places = draw_arena(rng, N_NODES, 1)
        scene = replace(loaded.scene, other_txs={one.name: one.pose for one in places})
        run = linked_run(loaded.config, scene, [(one.name, one.name) for one in places])
        for truth in run.truths():
            link = run.link_of(truth)
            errors = _echo_errors(link.scene, truth)
            length_m, angle_rad = max(length_m, *errors[:, 0]), max(angle_rad, *errors[:, 1])
            count += len(errors)
            clock_s = max(clock_s, abs(truth.clock_bias_s))
            los = truth.paths.take("path", truth.paths.is_los)
            found = best_beam_power_dbm(los, link.link, link.scene.tx, truth.rx_pose)
            wanted = link.config.link.tx_power_dbm - ISOLATION_DB
            leak_db = max(leak_db, float(np.abs(found - wanted).max()))
        over.append(point_errors(run))
    ratio = float(np.sqrt(np.mean(np.concatenate(over) ** 2)))
    key = "multistatic.monostatic"
    return [
        at_most(f"{key}.length_m", length_m, 1e-9, f"{count} echoes of walls and round pillars", "m"),
        at_most(f"{key}.angle_rad", angle_rad, 1e-6, "their departures and arrivals", "rad"),
        at_most(f"{key}.leakage_db", leak_db, 1e-9, "leakage in the best beams, off the isolation", "dB"),
        at_most(f"{key}.clock_s", clock_s, 0.0, "one clock sends and receives", "s"),
        at_most(f"{key}.points_over_bound", ratio, 1.5, "RMSE of the points of the map over their bound"),
    ]


def linked_run(config: CampaignConfig, scene: Scene, ends: list[tuple[str, str]]) -> CampaignRun:
    """The run of an arena with some links."""
    own = {"panel_offset_m": [0.0, PANEL_M, 0.0], "isolation_db": ISOLATION_DB}
    links = [{"tx": tx, "rx": rx, **own} for tx, rx in ends]
    tables = config.model_dump(exclude_unset=True) | {"links": links, "channel": SETTINGS}
    linked = CampaignConfig.model_validate(tables)
    return CampaignRun(linked, with_link_stops(linked, scene))


def point_errors(run: CampaignRun) -> FloatArray:
    """Errors (ip,) of incidence points over the standard deviation that the bound of their path allows.

    Of the points taken as single bounces whose path is a detected, separable one in front of both arrays: a flat
    array sees what is behind it in front.
    """
    truths = list(run.truths())
    channel = tuple(run.channel(truths))
    maps = run.maps(channel, run.surveyed_receiver(truths))
    tables = run.score(truths, CampaignResults(channel, (), **maps)).tables
    stops = {(one.truth.stop, one.truth.tx): one for one in run.true_stops(truths)}
    ips, paths, errors = tables.mapping.ips, tables.paths, []
    for row in np.flatnonzero(ips.is_inlier & np.isfinite(ips.position_error_m)):
        own = np.flatnonzero((paths.stop == ips.stop[row]) & (paths.path == ips.path[row]))[0]
        seen = stops[int(paths.stop[own]), int(paths.tx[own])]
        stop = from_node(seen)
        at = np.flatnonzero(stop.significant == paths.true_path[own])
        if paths.status[own] != PathStatus.DETECTED or not len(at) or not stop.is_separable[at[0]]:
            continue
        parameters = seen.parameters[seen.significant[at]]
        if seen.view is None or not np.allclose(wrap_angle(seen.view.in_front(parameters) - parameters), 0.0):
            continue
        covariance = plane_paths(run.scene, stop)[0][at]
        state, point = true_state(stop.truth)[None], stop.origin.vertex_m[stop.significant[at]]
        limit, _ = point_covariance(plane_law, stop.tx_pose, state, point, covariance)
        errors.append(ips.position_error_m[row] / np.sqrt(np.trace(limit[0])))
    return np.array(errors)


def _traced_back(down: CampaignRun, truth: Truth) -> Paths:
    """The paths from what walks to the node, traced in a scene with the TX there."""
    config = down.config
    assert truth.tx_pose is not None
    scene = replace(down.scene, tx=truth.tx_pose, other_txs={})
    return Propagator(scene, config.waveform.carrier_ghz * 1e9, config.propagation).paths(truth.rx_pose.position_m)


def _apart(paths: Paths, other: Paths) -> FloatArray:
    """Largest differences (3,) of lengths, angles and relative gains; infinite where paths are missing."""
    if len(paths) != len(other):
        return np.full(3, np.inf)
    order = [np.lexsort([each.aoa_azimuth_rad, each.length_m.round(9)]) for each in (paths, other)]
    one, two = paths.take("path", order[0]), other.take("path", order[1])
    angles = [
        wrap_angle(getattr(one, name) - getattr(two, name))
        for name in ("aod_azimuth_rad", "aod_elevation_rad", "aoa_azimuth_rad", "aoa_elevation_rad")
    ]
    gain = np.abs(one.gain - two.gain) / np.abs(one.gain)
    return np.array([np.abs(one.length_m - two.length_m).max(), np.abs(angles).max(), gain.max()])


def _echo_errors(scene: Scene, truth: Truth) -> FloatArray:
    """Errors (echo, 2) of length and angle of single reflections off walls and round pillars."""
    paths = truth.paths
    tx, rx = scene.tx.position_m[:2], truth.rx_pose.position_m[:2]
    rows = []
    for row in np.flatnonzero(paths.n_interactions == 1):
        name = str(paths.object_name[paths.bounce_object[row, 0]])
        contour = scene.object(name).contour
        if isinstance(contour, Circle):
            point = _near_point(np.asarray(contour.center_m), contour.radius_m, tx, rx)
        else:
            point = _wall_point(name, scene, tx, rx)
        legs = point - tx, point - rx
        angles = [np.arctan2(leg[1], leg[0]) for leg in legs]
        found = paths.aod_azimuth_rad[row], paths.aoa_azimuth_rad[row]
        length = sum(float(np.linalg.norm(leg)) for leg in legs)
        turned = np.abs(wrap_angle(np.subtract(angles, found))).max()
        rows.append([abs(length - paths.length_m[row]), turned])
    return np.array(rows).reshape(-1, 2)


def _near_point(center: FloatArray, radius: float, tx: FloatArray, rx: FloatArray) -> FloatArray:
    """The point of a circle over which the way from TX to RX is shortest."""
    ahead = float(np.arctan2(*((tx + rx) / 2 - center)[::-1]))

    def point(turn: float) -> FloatArray:
        return center + radius * np.array([np.cos(ahead + turn), np.sin(ahead + turn)])

    def slope(turn: float) -> float:
        """Derivative of the way over the angle: zero at the point."""
        across = np.array([-np.sin(ahead + turn), np.cos(ahead + turn)])
        return float(sum(across @ (point(turn) - end) / np.linalg.norm(point(turn) - end) for end in (tx, rx)))

    return point(float(brentq(slope, -0.5, 0.5, xtol=1e-14)))


def _wall_point(name: str, scene: Scene, tx: FloatArray, rx: FloatArray) -> FloatArray:
    """Where the way from TX to RX meets a wall of the arena, by the image of the RX."""
    axis = 0 if name in ("wall_west", "wall_east") else 1
    face = 0.0 if name in ("wall_west", "wall_south") else scene.bounds_m[2 + axis]
    image = rx.copy()
    image[axis] = 2 * face - rx[axis]
    return np.asarray(tx + (face - tx[axis]) / (image[axis] - tx[axis]) * (image - tx))
