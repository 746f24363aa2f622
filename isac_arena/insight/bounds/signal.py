"""Bounds of the receiver from the signal, the arrays and the joint paths of a campaign: those of its scores.

Every significant path has its Cramer-Rao bound for joint estimation of all of them. Line of sight and single
bounces off upright objects then bound position, heading and clock, with unknown incidence points. Several TX share
the pose of a stop; each has a clock of its own.
"""

from collections.abc import Callable, Iterable
from functools import cached_property
from typing import TypeVar

import numpy as np
from rich.table import Table

from estimation.slam.bounds import StateBound
from isac_arena.campaign.campaign import Campaign
from isac_arena.campaign.chain.inputs import significance
from isac_arena.campaign.driver import CampaignRun
from isac_arena.insight.bounds.position import QUANTITIES, PlanGrid
from isac_arena.report.figures.bound import BoundMap
from isac_arena.scoring.config import Significance
from isac_arena.scoring.link_view import LinkView, link_view
from isac_arena.scoring.stages.channel import TrueStop, significant_alone, true_stop
from isac_arena.scoring.stages.poses import pose_bounds
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
        return significant_alone(true_stop(truth, tx_pose, power_dbm, self._limits, self.view))

    @cached_property
    def _limits(self) -> Significance:
        return significance(self.run.config, self.run.link)


def links_of_walk(campaign: Campaign) -> dict[str, CampaignRun]:
    """The runs of the links with something that moves, by name; `ValueError` where all devices are fixed nodes."""
    names = link_stops(campaign.config, campaign.scene)
    runs = dict(zip(names, campaign.run().links, strict=True))
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

    def at(self, pose: Pose, stop: int | None = None) -> tuple[StateBound, bool]:
        """Bounds (1,) of a receiver there, and whether the line of sight to a TX is a significant path.

        With a `stop` from its links alone.
        """
        heard = [link.at(pose) for link in self.links if stop is None or stop in link.run.chosen_stops]
        return pose_bounds(self.campaign.scene, [heard]), any(one.truth.paths.is_los.any() for one in heard)

    def at_stop(self, stop: int) -> StateBound:
        """Bounds (1,) at a stop of the walk; where bodies move, of the paths at the time of its sweep."""
        if not self.campaign.scene.is_moving:
            return self.at(self.campaign.stops[stop], stop)[0]
        truths = self.campaign.trace([stop])
        rows = [truth.tx if len(self.links) > 1 else 0 for truth in truths]
        stops = [self.links[row].of(truth) for row, truth in zip(rows, truths, strict=True)]
        return pose_bounds(self.campaign.scene, [stops])


def over_plan(bounds: SignalBounds, grid: PlanGrid, track: Track[int] = iter) -> BoundMap:
    """Position error bound at every free place of a grid; the receiver has the heading of the first stop."""
    heading = float(bounds.campaign.scene.walk.headings_rad()[0])
    peb, los = np.full(grid.is_free.shape, np.nan), np.zeros(grid.is_free.shape, bool)
    places = np.argwhere(grid.is_free)
    for index in track(range(len(places))):
        at = tuple(places[index])
        bound, los[at] = bounds.at(Pose(grid.position_m[index], heading))
        peb[at] = bound.position_m[0]
    return BoundMap(grid.x_m, grid.y_m, peb, los)


def along_walk(bounds: SignalBounds, track: Track[int] = iter) -> tuple[Table, list[float]]:
    """A table of the bounds over the stops, and the position error bound of every stop in m."""
    found = [bounds.at_stop(stop) for stop in track(bounds.stops)]
    table = Table("bound at the stops, from the signal", "median", "smallest", "largest", "unit")
    for column in (1, 2, 3):
        table.columns[column].justify = "right"
    for label, name, scale, unit in QUANTITIES:
        values = scale * np.concatenate([getattr(bound, name) for bound in found])
        cells = [f"{value:.3g}" for value in (np.median(values), values.min(), values.max())]
        table.add_row(label, *cells, unit)
    return table, [float(bound.position_m[0]) for bound in found]
