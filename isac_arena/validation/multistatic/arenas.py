"""Random arenas with round pillars and many places for TX, and the paths that a receiver estimates there.

Paths are those of the exact solver. Their errors are drawn from their joint bounds, those of poses, clocks and
common offsets from what the contour stage assumes, and radii from its prior: errors are then as large as expected.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from estimation.channel.record import ChannelEstimate
from estimation.shape.config import ContourConfig
from estimation.slam.record import PoseEstimates
from estimation.slam.transmitters import joined_paths
from isac_arena.campaign.campaign import Campaign, load_campaign
from isac_arena.campaign.chain.inputs import known_receiver
from isac_arena.insight.bounds.signal import LinkBounds
from isac_arena.insight.placement.candidates import Candidate
from isac_arena.scoring.stages.poses import plane_paths
from isac_arena.validation.scenarios.estimates import made_estimate
from scenes.pose import SPEED_OF_LIGHT_M_S, Pose, wrap_angle
from scenes.record import FloatArray
from sim.truth import Truth

N_PILLARS = 4
HEIGHT_M = 1.5  # of all devices: paths are level
FROM_WALL_M = 0.4
APART_M = 1.0  # pillars from each other, from walls and from the walk
RADII_M = (0.15, 0.9)
CLOCK_STD_NS = 10.0
OFFSETS: dict[str, Any] = {"delay_offset_std_ns": 0.3, "aod_offset_std_deg": 1.0, "aoa_offset_std_deg": 1.0}
EXACT = {"floor_delay_std_ns": 0.0, "floor_angle_std_deg": 0.0}  # the errors are those stated
SETTINGS: dict[str, Any] = {
    "name": "arena",
    "seed": 0,
    "scene": "-",
    "tx_array": {"beams_per_panel": 16},
    "rx_array": {"beams_per_panel": 12},
    "propagation": {"diffuse_samples": 0, "max_bounces": 1, "diffraction": False},
    "slam": {"noise": EXACT},
    "mapping": {"noise": EXACT},
    "contours": {"reflection": OFFSETS, "learn_noise": False},
}


def draw_arena(rng: np.random.Generator, n_candidates: int, n_stops: int) -> tuple[Campaign, list[Candidate]]:
    """A hall of 12 to 18 m by 9 to 13 m with a walk round its middle, and places for TX along its walls."""
    size = rng.uniform([12.0, 9.0], [18.0, 13.0])
    turn = rng.uniform(0, 2 * np.pi) + np.linspace(0, 1.6 * np.pi, 9)
    walk = size / 2 + size * rng.uniform(0.22, 0.3) * np.column_stack([np.cos(turn), np.sin(turn)])
    scene = {
        "name": "arena",
        "bounds_m": [0.0, 0.0, *size.tolist()],
        "tx": {"position_m": [FROM_WALL_M, FROM_WALL_M, HEIGHT_M], "heading_deg": 45.0},
        "walk": {
            "type": "spline", "waypoints_m": walk.tolist(), "n_stops": n_stops, "height_m": HEIGHT_M,
            "heading_deg": float(rng.uniform(-180, 180)),
        },
        "materials": {"concrete": {"itu": "concrete", "thickness_m": 0.2}},
        "objects": [*_walls(size), *_pillars(rng, size, walk)],
    }  # fmt: skip
    places = [_at_wall(rng, size) for _ in range(n_candidates)]
    return load_campaign(SETTINGS, scene=scene), [Candidate(f"tx_{k}", place) for k, place in enumerate(places)]


def drawn_paths(
    rng: np.random.Generator, links: Sequence[LinkBounds], stops: Sequence[Pose], config: ContourConfig
) -> tuple[list[ChannelEstimate], list[ChannelEstimate], PoseEstimates]:
    """Estimates of every stop without and with common offsets, and the surveyed receiver.

    Clocks of all TX are independent at every stop.
    """
    reflection, survey = config.reflection, config.survey_std
    common_s, arrival = reflection.delay_offset_std_ns * 1e-9, np.deg2rad(reflection.aoa_offset_std_deg)
    departure = np.deg2rad(reflection.aod_offset_std_deg) * rng.standard_normal(len(links))
    offset = np.array([common_s, 0.0, arrival]) * rng.standard_normal(3)
    plain, shifted, surveyed = [], [], []
    for stop, pose in enumerate(stops):
        clock_s = 1e-9 * CLOCK_STD_NS * rng.standard_normal(len(links))
        parts = [_estimate(rng, link, pose, stop, bias) for link, bias in zip(links, clock_s, strict=True)]
        plain.append(joined_paths(parts))
        shift = offset + np.outer(departure, [0.0, 1.0, 0.0])
        turned = [_moved(part, own) for part, own in zip(parts, shift, strict=True)]
        shifted.append(joined_paths(turned))
        error = survey[:3] * rng.standard_normal(3)
        near = Pose(pose.position_m + np.append(error[:2], 0.0), pose.heading_rad + error[2])
        clock_s += survey[3] / SPEED_OF_LIGHT_M_S * rng.standard_normal(len(links))
        none = links[0].propagator.paths(pose.position_m)
        surveyed += [Truth(none, near, stop, bias, tx=tx) for tx, bias in enumerate(clock_s)]
    return plain, shifted, known_receiver(surveyed)


def _estimate(rng: np.random.Generator, link: LinkBounds, pose: Pose, stop: int, bias_s: float) -> ChannelEstimate:
    """The line of sight and the single bounces off objects, with errors from their joint bounds."""
    found = link.at(pose)
    covariance, is_los, bounce = plane_paths(link.run.scene, found)
    used = is_los | bounce
    to_seconds = np.array([1 / SPEED_OF_LIGHT_M_S, 1.0, 1.0])
    own = covariance[used] * np.outer(to_seconds, to_seconds)
    error = np.einsum("nij,nj->ni", np.linalg.cholesky(own), rng.standard_normal((int(used.sum()), 3)))
    values = found.parameters[found.significant[used]] + error + [bias_s, 0.0, 0.0]
    values[:, 1:] = wrap_angle(values[:, 1:])
    lost_db = link.view.beam_loss_db(found.truth)[found.significant[used]]
    estimate = made_estimate(stop, values, found.power_dbm[used], np.eye(3), is_los[used])
    order = np.argsort(values[:, 0], kind="stable")
    return replace(estimate, covariance=own, beam_loss_db=lost_db).take("path", order)


def _moved(estimate: ChannelEstimate, offset: FloatArray) -> ChannelEstimate:
    moved = estimate.plane_parameters + offset
    return replace(
        estimate,
        delay_s=moved[:, 0],
        aod_azimuth_rad=wrap_angle(moved[:, 1]),
        aoa_azimuth_rad=wrap_angle(moved[:, 2]),
    )


def _walls(size: FloatArray) -> list[dict[str, Any]]:
    x, y = size.tolist()
    sides = {
        "south": ([-0.2, x + 0.2], [-0.2, 0.0]),
        "north": ([-0.2, x + 0.2], [y, y + 0.2]),
        "west": ([-0.2, 0.0], [0.0, y]),
        "east": ([x, x + 0.2], [0.0, y]),
    }
    return [
        _object(f"wall_{side}", "wall", {"type": "rectangle", "x_m": x_m, "y_m": y_m})
        for side, (x_m, y_m) in sides.items()
    ]


def _pillars(rng: np.random.Generator, size: FloatArray, walk: FloatArray) -> list[dict[str, Any]]:
    """Round pillars with radii from the prior of the contour stage, clear of each other, of walls and the walk."""
    prior = ContourConfig().reflection
    found: list[tuple[FloatArray, float]] = []
    while len(found) < N_PILLARS:
        radius = float(prior.radius_median_m * np.exp(prior.radius_log_std * rng.standard_normal()))
        center = rng.uniform(APART_M + radius, size - APART_M - radius)
        far = np.linalg.norm(walk - center, axis=1).min() > APART_M + radius
        apart = all(np.linalg.norm(center - other) > APART_M + radius + own for other, own in found)
        if RADII_M[0] < radius < RADII_M[1] and far and apart:
            found.append((center, radius))
    return [
        _object(f"pillar_{k}", "pillar", {"type": "circle", "center_m": center.tolist(), "radius_m": radius})
        for k, (center, radius) in enumerate(found)
    ]


def _object(name: str, kind: str, contour: dict[str, Any]) -> dict[str, Any]:
    return {"name": name, "kind": kind, "material": "concrete", "z_max_m": 3.0, "contour": contour}


def _at_wall(rng: np.random.Generator, size: FloatArray) -> Pose:
    """A TX beside a random wall that looks at the middle, give or take 20 deg."""
    place = rng.uniform(FROM_WALL_M, size - FROM_WALL_M)
    axis, side = rng.integers(2), rng.integers(2)
    place[axis] = (FROM_WALL_M, size[axis] - FROM_WALL_M)[side]
    ahead = size / 2 - place
    heading = np.arctan2(ahead[1], ahead[0]) + np.deg2rad(rng.uniform(-20, 20))
    return Pose(np.append(place, HEIGHT_M), float(heading))
