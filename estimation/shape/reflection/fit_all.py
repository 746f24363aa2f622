"""Contours of all objects of a campaign by the reflection law: find them, choose their kinds, fit all at once.

Lines of sight first estimate the common offsets and improve the poses. Objects are found among the other paths,
and all objects together estimate offsets and poses again. Then paths, classes and kinds are chosen. Poses that
SLAM found stop by stop are rotated onto each other where the objects show that the TX heading jumped.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from estimation.execution import one_blas_thread
from estimation.laws.plane import state_columns
from estimation.shape.config import ContourConfig, ReflectionConfig
from estimation.shape.fit import FoundContour, ShapeFit
from estimation.shape.reflection.association import MIN_PATHS, GroupFits, object_agreement
from estimation.shape.reflection.blocks.find import with_columns
from estimation.shape.reflection.bundle import Bundle, BundleObject, fit_bundle
from estimation.shape.reflection.choice import CLASSES, Choice, averaged_band, choose_shape
from estimation.shape.reflection.faces.face import Face, face_choice, part_walls
from estimation.shape.reflection.faces.find import FaceSearch
from estimation.shape.reflection.faces.points import FacePoints
from estimation.shape.reflection.objects import FoundObject, find_objects, refit_objects
from estimation.shape.reflection.paths import CampaignPaths
from estimation.shape.reflection.pillar_prior import prior_from_others
from estimation.shape.reflection.raised import upright_paths
from estimation.shape.reflection.reflections import Reflections, prior_states
from estimation.shape.reflection.search import CHI2_MEDIAN, N_COMMON
from estimation.shape.reflection.tx_sessions import (
    Sessions,
    object_sessions,
    refined_sessions,
    rotated_about_tx,
    with_heading_error,
)
from estimation.steps import steps
from scenes.pose import SPEED_OF_LIGHT_M_S
from scenes.record import FloatArray, IntArray

_UNLIKELY = 0.01  # probability of being a pillar above which the other pillars give the prior
_NOISE_LIMITS = (0.3, 3.0)  # of the measured noise of all paths over the stated noise
_SURVEY_LIMITS = (0.03, 3.0)  # of the deviations of given poses over those of the survey
_SURVEY_ROUNDS = 3
_LEAST_REDUNDANCY = 3.0  # a deviation is known to 40 % from here on
_STATE_PARTS = (slice(2), slice(2, 3), slice(3, None))  # position, heading, clocks
_STATED_PATHS = 4.0  # weight of the stated covariance of an object, in paths
_LIKELY = 0.5  # least probability of a path to belong to its object


@dataclass(frozen=True)
class CampaignFit:
    """Accepted objects with their paths, and the common unknowns."""

    method: str
    shapes: tuple[ShapeFit, ...]
    class_probability: FloatArray  # (object, class)
    paths: tuple[IntArray, ...]  # per object: rows of the incidence points
    bundle: Bundle | None
    sessions: Sessions  # with the offsets removed before the bundle


def fit_campaign(paths: CampaignPaths, config: ContourConfig) -> CampaignFit:
    """Contours of the objects among the paths; none where no object has enough of them."""
    with one_blas_thread():
        if paths.may_turn and len(paths.sessions.offset_rad) == 1:
            paths = _aligned(paths, config)
        data, settings = paths.bounces, paths.config
        if paths.widening == 1:
            paths = _as_surveyed(paths) if config.learn_noise else paths
            data, settings = without_offsets(paths.bounces, _bundle(paths, []), settings)
        objects = find_objects(data, config.eps_m, config.min_samples, settings)
        if (upright := upright_paths(objects, data, settings)) is not None:
            paths, data = paths.only(upright), upright.of(data)
            seeds = [upright.rows(each.paths) for each in objects]
            objects = refit_objects(GroupFits(data, settings), seeds, config.min_samples)
        standing = objects if paths.widening > 1 else _standing(objects, data, paths.los, settings)
        together = _simple_bundle(paths, standing)
        data, settings = without_offsets(paths.bounces, together, paths.config)
        objects = refit_objects(GroupFits(data, settings), [each.paths for each in objects], config.min_samples)
        scale = _within_limits(together.noise_scale) if config.learn_noise else np.ones(3)
        paths = _rescaled(paths, scale)
        together = _simple_bundle(paths, objects)
        data, settings = without_offsets(paths.bounces, together, paths.config)
        return _final(paths, data, objects, settings, config, scale)


def _standing(
    objects: list[FoundObject], data: Reflections, los: Reflections, config: ReflectionConfig
) -> list[FoundObject]:
    """The objects that no face replaces or hides: scattering places do not tell offsets and noise."""
    search = FaceSearch(objects, data, los, config)
    return [objects[k] for k in search.standing(search.run())]


def without_offsets(
    data: Reflections, bundle: Bundle, config: ReflectionConfig
) -> tuple[Reflections, ReflectionConfig]:
    """Paths without the estimated offsets and at the estimated poses; settings with the remaining uncertainty.

    One remaining departure offset holds for all sessions, that of the least certain session.
    """
    n_sessions = len(bundle.offset) - N_COMMON
    known = data.session < n_sessions
    offset = np.zeros((len(data), 3))
    offset[:, 0], offset[:, 2] = bundle.offset[:N_COMMON]
    offset[known, 1] = bundle.offset[N_COMMON + data.session[known]]
    state, covariance = data.rx_state.copy(), data.rx_covariance.copy()
    solved = np.isin(data.stop, bundle.stop)
    row = np.searchsorted(bundle.stop, data.stop[solved])
    column = state_columns(data.clock[solved])
    state[solved] = bundle.rx_state[row[:, None], column]
    covariance[solved] = bundle.rx_covariance[row[:, None, None], column[:, :, None], column[:, None, :]]
    std = bundle.offset_std
    remaining = {
        "delay_offset_std_ns": float(std[0] * 1e9 / SPEED_OF_LIGHT_M_S),
        "aoa_offset_std_deg": float(np.rad2deg(std[1])),
    }
    if known.all() and n_sessions:
        remaining["aod_offset_std_deg"] = float(np.rad2deg(np.max(std[N_COMMON:], initial=0.0)))
    together, measured = np.zeros(len(data), dtype=np.int64), data.measured - offset
    data = replace(data, measured=measured, rx_state=state, rx_covariance=covariance, session=together)
    return data, config.model_copy(update=remaining)


def object_noise(square: FloatArray) -> float:
    """Factor, at least 1, on the covariances of the paths of an object with these squared distances (path,).

    The median ignores ghosts; the stated covariance counts as `_STATED_PATHS` more paths.
    """
    n = len(square)
    found = n * float(np.median(square)) / CHI2_MEDIAN + _STATED_PATHS
    return max(found / (n + _STATED_PATHS), 1.0)


def _aligned(paths: CampaignPaths, config: ContourConfig) -> CampaignPaths:
    """Paths and poses of sessions rotated onto each other, where the objects show more than one session.

    Objects that hold paths of all sessions show the sessions; those found after the rotation refine it.
    """
    data = (paths.bounces, paths.los)
    objects = find_objects(
        with_heading_error(paths.bounces, config.reflection), config.eps_m, config.min_samples, paths.config
    )
    sessions = object_sessions(objects, *data, paths.stop, config.reflection)
    if len(sessions.offset_rad) == 1:
        return paths
    first = rotated_about_tx(paths.bounces, sessions.of_paths(paths.bounces, paths.stop))
    objects = find_objects(first, config.eps_m, config.min_samples, paths.config)
    if objects:
        sessions = refined_sessions(objects, *data, sessions, paths.stop, config.reflection)
    bounces, los = (rotated_about_tx(each, sessions.of_paths(each, paths.stop)) for each in data)
    return replace(paths, bounces=bounces, los=los, sessions=sessions)


def _simple_bundle(paths: CampaignPaths, objects: list[FoundObject]) -> Bundle:
    members = [BundleObject(each.kind, paths.bounces.take("path", each.paths)) for each in objects]
    return _bundle(paths, members)


def _bundle(paths: CampaignPaths, members: list[BundleObject]) -> Bundle:
    """The bundle; poses that SLAM found from the same paths have wider covariances."""

    def widened(data: Reflections) -> Reflections:
        return replace(data, rx_covariance=data.rx_covariance * paths.widening**2)

    wide = [replace(each, paths=widened(each.paths)) for each in members]
    return fit_bundle(wide, widened(paths.los), paths.config)


def _as_surveyed(paths: CampaignPaths) -> CampaignPaths:
    """Given poses with the deviations that the lines of sight show in place of those of the survey."""
    scale = np.repeat(survey_scale(paths.los, paths.config), [2, 1, 1])
    wide = np.outer(scale, scale)
    bounces, los = (replace(data, rx_covariance=data.rx_covariance * wide) for data in (paths.bounces, paths.los))
    return replace(paths, bounces=bounces, los=los)


def survey_scale(los: Reflections, config: ReflectionConfig) -> FloatArray:
    """Deviations (3,) of given positions, headings and clocks over the stated ones, within limits.

    They are variance components: squares of what the lines of sight add to the given states, over the redundancies
    (Foerstner 1979), for the states with their new deviations again. What they do not determine stays 1.
    """
    scale = np.ones(len(_STATE_PARTS))
    for _ in range(_SURVEY_ROUNDS if len(los) else 0):
        each = np.repeat(scale, [2, 1, 1])
        now = replace(los, rx_covariance=los.rx_covariance * np.outer(each, each))
        _, given, weight = prior_states([now])
        found, stated = fit_bundle([], now, config), 1 / np.diagonal(weight, axis1=1, axis2=2)
        square = np.square(found.rx_state - given) / stated
        redundancy = 1 - np.diagonal(found.rx_covariance, axis1=1, axis2=2) / stated
        for k, part in enumerate(_STATE_PARTS):
            if (known := float(redundancy[:, part].sum())) >= _LEAST_REDUNDANCY:
                scale[k] *= np.sqrt(square[:, part].sum() / known)
        scale = np.clip(scale, *_SURVEY_LIMITS)
    return scale


def _within_limits(scale: FloatArray) -> FloatArray:
    return np.clip(np.where(np.isfinite(scale), scale, 1.0), *_NOISE_LIMITS)


def _rescaled(paths: CampaignPaths, scale: FloatArray) -> CampaignPaths:
    """Paths with their standard deviations times factors (3,)."""
    square = np.outer(scale, scale)
    return replace(paths, bounces=_scaled(paths.bounces, square), los=_scaled(paths.los, square))


def _scaled(data: Reflections, factor: FloatArray | float) -> Reflections:
    return replace(data, covariance=data.covariance * factor)


def _final(
    paths: CampaignPaths,
    data: Reflections,
    objects: list[FoundObject],
    settings: ReflectionConfig,
    config: ContourConfig,
    scale: FloatArray,
) -> CampaignFit:
    """Choose kinds and classes, then fit all objects that stand with all poses and offsets; faces with them.

    `scale` (3,) is in the deviations of `paths`. Where it is below 1, the paths that tell it are better than most:
    it holds for the choices, and the last fit has no less than the stated deviations.
    """
    search = FaceSearch(objects, data, paths.los, settings)
    faces = search.run()
    standing = search.standing(faces)
    objects = [objects[k] for k in standing]
    of_wall = {standing.index(face.mirror): face for face in faces if face.mirror in standing}
    parts = [data.take("path", each.paths) for each in objects]
    noise = [1.0] * len(parts)
    if config.learn_noise:
        pairs = zip(objects, parts, strict=True)
        noise = [object_noise(object_agreement(each.kind, each.optimum, part)[0]) for each, part in pairs]
    parts = [_scaled(part, factor) for part, factor in zip(parts, noise, strict=True)]
    choices, priors = _chosen(parts, of_wall, search.points, settings)
    least = 1 / np.minimum(scale, 1.0)
    paths = _rescaled(paths, least)
    wider = [max(factor / float(np.prod(least)) ** (2 / 3), 1.0) for factor in noise]
    members = [
        BundleObject(choice.best.kind, _scaled(paths.bounces.take("path", objects[k].paths), wider[k]), priors[k])
        for k, choice in enumerate(choices)
    ]
    bundle = _bundle(paths, members)
    found: list[FoundContour] = []
    for k, (shape, inlier) in enumerate(zip(bundle.shapes, bundle.inlier, strict=True)):
        if not shape.is_usable or np.count_nonzero(inlier > _LIKELY) < MIN_PATHS:
            continue
        walls, face = [(shape, objects[k].paths[inlier > _LIKELY])], of_wall.get(k)
        if face is not None and shape.kind in CLASSES["wall"]:
            walls = part_walls(face, np.union1d(walls[0][1], face.scattered), search.points, shape)
        probability = list(choices[k].class_probability.values())
        found += [FoundContour(averaged_band(part, choices[k]), own, probability) for part, own in walls]
    for face in faces:
        if face.mirror < 0:
            flats = part_walls(face, face.scattered, search.points)
            found += [FoundContour(*each, face.class_probability) for each in flats]
    found = with_columns(found, search.points.points, data, config)
    return CampaignFit(
        method="reflection",
        shapes=tuple(each.shape for each in found),
        class_probability=np.array([each.class_probability for each in found]).reshape(len(found), len(CLASSES)),
        paths=tuple(paths.upright[each.rows] for each in found),
        bundle=bundle,
        sessions=paths.sessions,
    )


def _chosen(
    parts: Sequence[Reflections], of_wall: Mapping[int, Face], points: FacePoints, settings: ReflectionConfig
) -> tuple[list[Choice], list[ReflectionConfig | None]]:
    """The choice for every object, and the settings with the prior that the other pillars give, None without.

    What the face of a wall, `of_wall`, scatters is evidence for that wall.
    """
    choices = [choose_shape(part, settings) for part in steps(parts, "object")]
    choices = [
        face_choice(choice, of_wall[k], points) if k in of_wall else choice for k, choice in enumerate(choices)
    ]
    priors: list[ReflectionConfig | None] = [None] * len(parts)
    if settings.pillars_resemble:
        alone = list(choices)
        for k, part in enumerate(parts):
            if alone[k].class_probability["pillar"] > _UNLIKELY and k not in of_wall:
                own, shares = prior_from_others(alone, k, settings)
                priors[k] = own
                choices[k] = choose_shape(part, own, shares=shares, known=alone[k].fits)
    return choices, priors
