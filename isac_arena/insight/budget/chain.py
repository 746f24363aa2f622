"""The chain of a campaign behind its channel estimates, with truth in place of any of its stages."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from estimation.channel.record import ChannelEstimate
from estimation.slam.record import IncidencePoints, PoseEstimates
from isac_arena.campaign.chain.inputs import known_receiver
from isac_arena.campaign.driver import CampaignRun
from isac_arena.campaign.results import Oracle
from isac_arena.insight.budget.oracles import (
    TracedPaths,
    object_labels,
    typical_covariance,
    with_true_association,
    with_true_detection,
    with_true_geometry,
)
from isac_arena.insight.budget.outcome import (
    FinalErrors,
    LitObject,
    object_errors,
    outlines_of_contours,
    outlines_of_shapes,
    pose_errors,
)
from isac_arena.insight.budget.stages import Part, Stage
from isac_arena.scoring.provenance import cluster_origin
from isac_arena.scoring.stages.channel import score_stop
from isac_arena.scoring.true_stop import TrueStop
from scenes.record import FloatArray, IntArray, TextArray

UPSTREAM = (Stage.DETECTION, Stage.GEOMETRY, Stage.ASSOCIATION, Stage.POSE)
FALLBACK_STD = np.array([1e-9, np.deg2rad(1.0), np.deg2rad(1.0)])  # where no path has a covariance


@dataclass(frozen=True)
class Mapped:
    """Results before the contours: receiver states, incidence points and their objects, and the oracle behind."""

    oracle: Oracle
    poses: PoseEstimates
    ips: IncidencePoints
    ip_object: TextArray  # (ip,) upright object of the true single bounce behind it, else empty


@dataclass(frozen=True)
class Chain:
    """The run behind the channel estimates, with the truth of the same stops for the oracles."""

    run: CampaignRun
    stops: list[TrueStop]
    paths: list[TracedPaths]
    objects: list[LitObject]
    _maps: dict[frozenset[Part], Mapped] = field(default_factory=dict, repr=False)

    @property
    def estimates(self) -> list[ChannelEstimate]:
        """The channel estimates of the run."""
        return [one.estimate for one in self.paths]

    def final_errors(self, replaced: frozenset[Part]) -> FinalErrors:
        """Final errors with truth in place of some stages."""
        key = replaced & set(UPSTREAM)
        if key not in self._maps:
            self._maps[key] = self._map(key)
        mapped = self._maps[key]
        return FinalErrors(pose_errors(mapped.poses, self.stops), *self._shapes(mapped, replaced))

    def _map(self, replaced: frozenset[Part]) -> Mapped:
        """Receiver states and incidence points."""
        paths = self._channel(replaced)
        channel = [one.estimate for one in paths]
        known = known_receiver(stop.truth for stop in self.stops) if Stage.POSE in replaced else None
        oracle = Oracle(channel, known, has_all_points=Stage.ASSOCIATION in replaced)
        poses, ips = replace(self.run, oracle=oracle).locate(self.estimates)
        row = {int(stop): index for index, stop in enumerate(poses.stop)}
        names = [
            np.append(self.stops[row[stop]].origin.object, "")[paths[row[stop]].true_path[path]]
            for stop, path in zip(ips.stop.tolist(), ips.path.tolist(), strict=True)
        ]
        upright = np.isin(np.array(names, str), self.run.scene.object_names)
        return Mapped(oracle, poses, ips, np.where(upright, np.array(names, str), ""))

    def _channel(self, replaced: frozenset[Part]) -> list[TracedPaths]:
        typical = typical_covariance(self.estimates, FALLBACK_STD**2)
        found = []
        for estimated, stop in zip(self.paths, self.stops, strict=True):
            paths = estimated
            if Stage.DETECTION in replaced:
                paths = with_true_detection(paths, stop, typical)
            if Stage.GEOMETRY in replaced:
                paths = with_true_geometry(paths, stop)
            if Stage.ASSOCIATION in replaced:
                paths = with_true_association(paths, stop, self.run.scene)
            found.append(paths)
        return found

    def _shapes(self, mapped: Mapped, replaced: frozenset[Part]) -> tuple[FloatArray, FloatArray]:
        """Errors (object,) of the paper's contours and of ours; ours are empty where their method is off."""
        ips, names = mapped.ips, mapped.ip_object
        true_label, shown = object_labels(ips, names)
        clusters = (lambda _: true_label) if Stage.CLUSTERS in replaced else None
        run = replace(self.run, oracle=replace(mapped.oracle, clusters=clusters))
        made = run.shape(self.estimates, mapped.poses, ips)
        if clusters is None:
            shown = _majority(made.shapes.label, names, len(made.shapes.center_m))
        paper = object_errors(self.objects, outlines_of_shapes(made.shapes, ips.position_m, shown))
        ours = np.zeros(0)
        if self.run.config.contours.method != "none":
            owner = _majority(made.contours.object, names, len(made.contours))
            ours = object_errors(self.objects, outlines_of_contours(made.contours, ips.position_m, owner))
        if Stage.FIT not in replaced:
            return paper, ours
        # true contours of all objects with a cluster, and of all with an inlier
        return self._exact(paper, np.asarray(shown)), self._exact(ours, names[ips.is_inlier])

    def _exact(self, errors: FloatArray, found: TextArray) -> FloatArray:
        """Errors (object,) with the true contour in place of the estimate for every object found."""
        is_found = np.isin([item.name for item in self.objects], found)
        return np.where(is_found, 0.0, errors) if len(errors) else errors


def _majority(label: IntArray, ip_object: TextArray, count: int) -> TextArray:
    """Object (cluster,) of at least half of the points of each cluster, empty for none."""
    return cluster_origin(label, ip_object, count).object


def make_chain(
    run: CampaignRun, stops: list[TrueStop], channel: Sequence[ChannelEstimate], objects: list[LitObject]
) -> Chain:
    """The chain of a campaign; `stops` and `channel` are of the same stops in the same order."""
    scored = [score_stop(stop, one)[0] for stop, one in zip(stops, channel, strict=True)]
    paths = [TracedPaths(one, rows.true_path) for one, rows in zip(channel, scored, strict=True)]
    return Chain(run, stops, paths, objects)
