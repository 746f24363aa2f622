"""Bounds of the receiver from the signal, the arrays and the joint paths of a campaign: those of its scores.

Every significant path has its Cramer-Rao bound for joint estimation of all of them. Line of sight and single
bounces off upright objects then bound position, heading and clock, with unknown incidence points. Several TX share
the pose of a stop; each has a clock of its own.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import fields
from functools import cached_property
from typing import TypeVar

import numpy as np

from estimation.slam.bounds import StateBound
from isac_arena.campaign.campaign import Campaign
from isac_arena.campaign.chain.inputs import significance
from isac_arena.campaign.driver import CampaignRun
from isac_arena.insight.bounds.position import PlanGrid
from isac_arena.report.figures.bound import BoundMap
from isac_arena.scoring.config import Significance
from isac_arena.scoring.link_view import LinkView, link_view
from isac_arena.scoring.stages.poses import pose_bounds
from isac_arena.scoring.true_stop import TrueStop, significant_alone, true_stop
from scenes.pose import Pose
from sim.links import link_stops
from sim.propagation.propagator import Propagator
from sim.simulate import in_direction
from sim.truth import Truth

T = TypeVar("T")
Track = Callable[[Iterable[T]], Iterable[T]]  # shows progress


class LinkBounds:
    """One TX or link of a campaign prepared for bounds at any place of what moves.

    With `single` the paths are the line of sight and single bounces alone, which takes a tenth of the time.
    """

    def __init__(self, run: CampaignRun, *, single: bool = False) -> None:
        self.run, self._single = run, single

    @cached_property
    def view(self) -> LinkView:
        """The link as scores see it."""
        return link_view(self.run.config, self.run.link, self.run.scene)

    @cached_property
    def propagator(self) -> Propagator:
        """All paths of the TX except diffuse ones, which are no significant paths."""
        config = self.run.config
        changes: dict[str, int | bool] = {"diffuse_samples": 0, "compare_planar": False}
        if self._single:
            changes |= {"max_bounces": min(1, config.propagation.max_bounces), "diffraction": False}
        propagation = config.propagation.model_copy(update=changes)
        return Propagator(self.run.scene, config.waveform.carrier_ghz * 1e9, propagation)

    def at(self, pose: Pose) -> TrueStop:
        """The significant paths to a receiver there, with their bounds; in an uplink from what sends there."""
        truth = Truth(self.propagator.paths(pose.position_m), pose, 0, 0.0)
        return self.of(in_direction(self.run.config, self.run.scene, truth))

    def of(self, truth: Truth) -> TrueStop:
        """The same from the true paths of a stop."""
        power_dbm = self.run.true_power_dbm(truth)
        tx_pose = truth.tx_pose or self.run.scene.tx
        return significant_alone(true_stop(truth, tx_pose, power_dbm, self._limits, self.view, separates=False))

    @cached_property
    def _limits(self) -> Significance:
        return significance(self.run.config, self.run.link)


def links_of_walk(campaign: Campaign) -> dict[str, CampaignRun]:
    """The runs of the links with something that moves, by name; `ValueError` where all devices are fixed nodes."""
    names = link_stops(campaign.config, campaign.scene)
    runs = dict(zip(names, campaign.chain().links, strict=True))
    moving = {name: run for name, run in runs.items() if run.config.role.kind.has_walk}
    if not moving:
        raise ValueError("links: none has a walk; bounds are of positions, and those of fixed nodes are known")
    return moving


class SignalBounds:
    """A campaign prepared for bounds at any place from all of its TX, or all links of its walks."""

    def __init__(self, campaign: Campaign) -> None:
        self.campaign = campaign
        self.links = [LinkBounds(run) for run in links_of_walk(campaign).values()]

    @property
    def stops(self) -> list[int]:
        """The stops whose position is to be found."""
        return sorted({stop for link in self.links for stop in link.run.chosen_stops})

    def at(self, pose: Pose, stop: int | None = None) -> StateBound:
        """Bounds (1,) of a receiver there; with a `stop` from its links alone."""
        heard = [link.at(pose) for link in self.links if stop is None or stop in link.run.chosen_stops]
        return pose_bounds(self.campaign.scene, [heard])

    def at_stop(self, stop: int) -> StateBound:
        """Bounds (1,) at a stop of the walk; where bodies move, of the paths at the time of its sweep."""
        if not self.campaign.scene.is_moving:
            return self.at(self.campaign.stops[stop], stop)
        truths = self.campaign.trace([stop])
        rows = [truth.tx if len(self.links) > 1 else 0 for truth in truths]
        stops = [self.links[row].of(truth) for row, truth in zip(rows, truths, strict=True)]
        return pose_bounds(self.campaign.scene, [stops])


def over_plan(bounds: SignalBounds, grids: Sequence[PlanGrid], track: Track[int] = iter) -> BoundMap:
    """Position error bound at every place that is free on the grids of all links, which are over the same places.

    The receiver has the heading of the first stop.
    """
    heading = float(bounds.campaign.scene.walk.headings_rad()[0])
    is_free, has_los = (
        reach([getattr(grid, name) for grid in grids], axis=0)
        for name, reach in (("is_free", np.all), ("has_los", np.any))
    )
    x_m, y_m, height_m = grids[0].x_m, grids[0].y_m, bounds.campaign.scene.walk.height_m
    peb, places = np.full(is_free.shape, np.nan), np.argwhere(is_free)
    for index in track(range(len(places))):
        row, column = places[index]
        place = Pose(np.array([x_m[column], y_m[row], height_m]), heading)
        peb[row, column] = bounds.at(place).position_m[0]
    return BoundMap(x_m, y_m, peb, has_los & is_free)


def along_walk(bounds: SignalBounds, track: Track[int] = iter) -> StateBound:
    """Bounds (stop,) at the stops of the walk, in their order."""
    found = [bounds.at_stop(stop) for stop in track(bounds.stops)]
    return StateBound(*(np.concatenate([getattr(one, each.name) for one in found]) for each in fields(StateBound)))
