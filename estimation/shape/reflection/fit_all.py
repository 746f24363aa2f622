"""Contours of all objects of a campaign by the reflection law: find them, choose their kinds, fit all at once.

Lines of sight tell the common offsets and sharpen the poses first; objects are found in what is left, and all of
them together tell offsets and poses once more before paths, classes and kinds are settled. Poses that SLAM found
stop by stop are turned onto each other where the objects show that the TX heading jumped.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from estimation.execution import one_blas_thread
from estimation.shape.config import ContourConfig
from estimation.shape.fit import ShapeFit
from estimation.shape.reflection.association import MIN_PATHS, family_of
from estimation.shape.reflection.bundle import Bundle, fit_bundle
from estimation.shape.reflection.bundle_kinds import BundleObject
from estimation.shape.reflection.choice import CLASSES, choose_shape
from estimation.shape.reflection.objects import Found, find_objects, settle
from estimation.shape.reflection.path_likelihood import N_COMMON
from estimation.shape.reflection.paths import CampaignPaths
from estimation.shape.reflection.posterior import CHI2_MEDIAN, path_squares
from estimation.shape.reflection.reflections import ReflectionConfig, Reflections
from estimation.shape.reflection.resemblance import prior_from_others
from estimation.shape.reflection.tx_sessions import (
    Sessions,
    loosened,
    object_sessions,
    refined_sessions,
    turned_about_tx,
)
from scenes.pose import SPEED_OF_LIGHT_M_S
from scenes.record import FloatArray, IntArray

_UNLIKELY = 0.01  # probability of being a pillar from which on the other pillars count
_NOISE_LIMITS = (0.3, 3.0)  # of the noise of all paths over what they state
_STATED_PATHS = 4.0
_LIKELY = 0.5  # probability of belonging to its object that a path needs


@dataclass(frozen=True)
class CampaignFit:
    """Accepted objects with what they were fitted to, and the common unknowns."""

    method: str
    shapes: tuple[ShapeFit, ...]
    class_probability: FloatArray  # (object, class)
    paths: tuple[IntArray, ...]  # per object: rows of the incidence points
    bundle: Bundle | None
    sessions: Sessions  # with the offsets that the bundle was not told of


def fit_campaign(paths: CampaignPaths, config: ContourConfig) -> CampaignFit:
    """Contours of the objects among the paths; none where no object has enough of them."""
    with one_blas_thread():
        if paths.widening > 1 and len(paths.sessions.offset_rad) == 1:
            paths = _aligned(paths, config)
        data, settings = paths.bounces, paths.config
        if paths.widening == 1:
            data, settings = corrected(data, _bundle(paths, []), settings)
        objects = find_objects(data, config.eps_m, config.min_samples, settings)
        together = _simple_bundle(paths, objects)
        data, settings = corrected(paths.bounces, together, paths.config)
        objects = settle(data, [each.paths for each in objects], config.min_samples, settings)
        if config.learn_noise:
            paths = _rescaled(paths, together.noise_scale)
        together = _simple_bundle(paths, objects)
        data, settings = corrected(paths.bounces, together, paths.config)
        return _final(paths, data, objects, settings, config)


def corrected(
    data: Reflections, bundle: Bundle, config: ReflectionConfig
) -> tuple[Reflections, ReflectionConfig]:
    """Paths without the offsets found and at the poses found; the settings say what is left uncertain.

    What is left of the departure offsets is one for all sessions, the least certain session's.
    """
    n_sessions = len(bundle.offset) - N_COMMON
    known = data.session < n_sessions
    offset = np.zeros((len(data), 3))
    offset[:, 0], offset[:, 2] = bundle.offset[:N_COMMON]
    offset[known, 1] = bundle.offset[N_COMMON + data.session[known]]
    state, covariance = data.rx_state.copy(), data.rx_covariance.copy()
    solved = np.isin(data.stop, bundle.stop)
    row = np.searchsorted(bundle.stop, data.stop[solved])
    state[solved], covariance[solved] = bundle.rx_state[row], bundle.rx_covariance[row]
    left = config.model_copy(
        update={
            "delay_offset_std_ns": float(bundle.offset_std[0] * 1e9 / SPEED_OF_LIGHT_M_S),
            "aoa_offset_std_deg": float(np.rad2deg(bundle.offset_std[1])),
            "aod_offset_std_deg": float(
                np.rad2deg(np.max(bundle.offset_std[N_COMMON:], initial=0.0))
                if known.all() and n_sessions
                else config.aod_offset_std_deg
            ),
        }
    )
    plain = replace(
        data,
        measured=data.measured - offset,
        rx_state=state,
        rx_covariance=covariance,
        session=np.zeros(len(data), dtype=np.int64),
    )
    return plain, left


def object_noise(square: FloatArray) -> float:
    """Factor, at least 1, on the covariances of an object's paths by their squared distances (path,) from it.

    The median leaves out ghosts; the stated covariance counts as `_STATED_PATHS` paths more.
    """
    n = len(square)
    found = n * float(np.median(square)) / CHI2_MEDIAN + _STATED_PATHS
    return max(found / (n + _STATED_PATHS), 1.0)


def _aligned(paths: CampaignPaths, config: ContourConfig) -> CampaignPaths:
    """Paths and poses of sessions turned onto each other, where the objects show more than one.

    Objects that hold the paths of all sessions tell the sessions; those found after the turn the rest of it.
    """
    data = (paths.bounces, paths.los)
    loose = loosened(paths.bounces, config.reflection)
    objects = find_objects(loose, config.eps_m, config.min_samples, paths.config)
    sessions = object_sessions(objects, *data, paths.stop, config.reflection)
    if len(sessions.offset_rad) == 1:
        return paths
    first = turned_about_tx(paths.bounces, sessions.of_paths(paths.bounces, paths.stop))
    objects = find_objects(first, config.eps_m, config.min_samples, paths.config)
    if objects:
        sessions = refined_sessions(objects, *data, sessions, paths.stop, config.reflection)
    bounces, los = (turned_about_tx(each, sessions.of_paths(each, paths.stop)) for each in data)
    return replace(paths, bounces=bounces, los=los, sessions=sessions)


def _simple_bundle(paths: CampaignPaths, objects: list[Found]) -> Bundle:
    return _bundle(
        paths, [BundleObject(each.kind, paths.bounces.take("path", each.paths)) for each in objects]
    )


def _bundle(paths: CampaignPaths, members: list[BundleObject]) -> Bundle:
    """The bundle with poses that were found from the same paths counted less."""
    wide = [replace(each, paths=_widened(each.paths, paths.widening)) for each in members]
    return fit_bundle(wide, _widened(paths.los, paths.widening), paths.config)


def _widened(data: Reflections, factor: float) -> Reflections:
    return replace(data, rx_covariance=data.rx_covariance * factor**2)


def _rescaled(paths: CampaignPaths, scale: FloatArray) -> CampaignPaths:
    """Paths with the standard deviations (3,) that all of them together show, inside limits of belief."""
    factor = np.clip(np.where(np.isfinite(scale), scale, 1.0), *_NOISE_LIMITS)
    both = [
        replace(data, covariance=data.covariance * np.outer(factor, factor))
        for data in (paths.bounces, paths.los)
    ]
    return replace(paths, bounces=both[0], los=both[1])


def _raised(data: Reflections, factor: float) -> Reflections:
    return replace(data, covariance=data.covariance * factor)


def _final(
    paths: CampaignPaths,
    data: Reflections,
    objects: list[Found],
    settings: ReflectionConfig,
    config: ContourConfig,
) -> CampaignFit:
    """Kinds and classes chosen, then all objects with all poses and offsets once more."""
    parts = [data.take("path", each.paths) for each in objects]
    noise = np.ones(len(parts))
    if config.learn_noise:
        squares = [
            path_squares(family_of(each.kind), each.optimum, part)
            for each, part in zip(objects, parts, strict=True)
        ]
        noise = np.array([object_noise(square) for square in squares])
    parts = [_raised(part, float(factor)) for part, factor in zip(parts, noise, strict=True)]
    choices = [choose_shape(part, settings) for part in parts]
    priors: list[ReflectionConfig | None] = [None] * len(parts)
    if settings.pillars_resemble:
        alone = list(choices)
        for k, part in enumerate(parts):
            if alone[k].class_probability["pillar"] > _UNLIKELY:
                own, shares = prior_from_others(alone, k, settings)
                choices[k], priors[k] = choose_shape(part, own, shares=shares), own
    members = [
        BundleObject(choice.best.kind, _raised(paths.bounces.take("path", each.paths), float(factor)), prior)
        for choice, each, factor, prior in zip(choices, objects, noise, priors, strict=True)
    ]
    bundle = _bundle(paths, members)
    kept = [
        k
        for k, shape in enumerate(bundle.shapes)
        if shape.is_usable and np.count_nonzero(bundle.inlier[k] > _LIKELY) >= MIN_PATHS
    ]
    probability = [list(choices[k].class_probability.values()) for k in kept]
    return CampaignFit(
        method="reflection",
        shapes=tuple(bundle.shapes[k] for k in kept),
        class_probability=np.array(probability).reshape(len(kept), len(CLASSES)),
        paths=tuple(objects[k].paths[bundle.inlier[k] > _LIKELY] for k in kept),
        bundle=bundle,
        sessions=paths.sessions,
    )
