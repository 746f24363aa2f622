"""A placement: candidates and standing TX, the TX chosen, their bounds, and how far from the best they can be."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from rich.table import Table

from isac_arena.campaign.campaign import Campaign
from isac_arena.campaign.driver import CampaignRun
from isac_arena.insight.bounds.several_tx import SeveralTx, WalkBounds
from isac_arena.insight.bounds.signal import LinkBounds, Track
from isac_arena.insight.bounds.tables import cell
from isac_arena.insight.placement.candidates import Candidate
from isac_arena.insight.placement.criterion import Criterion, CriterionName
from isac_arena.insight.placement.search import Found, exhaustive, greedy, least_log_error

TrackSets = Callable[[Iterable[tuple[int, ...]]], Iterable[tuple[int, ...]]]


@dataclass(frozen=True)
class Placement:
    """The result of a search; rows are those of `several.walks`, first the TX that stand already."""

    several: SeveralTx
    candidates: tuple[Candidate, ...]  # of all rows
    kept: tuple[int, ...]
    criterion: CriterionName
    found: Found
    least_log_error: float  # no choice of as many candidates falls below
    is_best: bool  # every choice was tried

    @property
    def chosen(self) -> tuple[int, ...]:
        """Rows of all TX of the placement."""
        return (*self.kept, *self.found.chosen)

    @property
    def error_m(self) -> float:
        """The criterion of the chosen TX: a geometric mean of bounds."""
        return float(np.exp(self.found.log_error[-1]))

    @property
    def above_best(self) -> float:
        """Certificate: the criterion is at most this many times that of the best choice."""
        return 1.0 if self.is_best else float(np.exp(self.found.log_error[-1] - self.least_log_error))

    def bounds(self) -> WalkBounds:
        """Bounds of stops and pillars with the chosen TX."""
        return self.several.bounds(self.chosen)


def place(
    campaign: Campaign,
    candidates: Sequence[Candidate],
    count: int,
    criterion: CriterionName = "both",
    *,
    stops: Sequence[int] | None = None,
    keep: bool = False,
    all_sets: bool = False,
    track: Track[int] = iter,
    track_sets: TrackSets = iter,
) -> Placement:
    """Choose `count` of the candidates over the stops, with `keep` beside the TX of the campaign.

    Raises `ValueError` where there are too few candidates, a candidate stands inside something, or there are too
    many sets to try them all.
    """
    standing = [Candidate(run.scene.tx_name, run.scene.tx) for run in campaign.chain().links] if keep else []
    names = {each.name for each in standing}
    rest = [each for each in candidates if each.name not in names]
    if not 1 <= count <= len(rest):
        raise ValueError(f"--count = {count}: must be 1 to {len(rest)}, the number of candidates")
    every = [*standing, *rest]
    stops = range(len(campaign.stops)) if stops is None else stops
    links = [LinkBounds(_alone(campaign, each), single=True) for each in every]
    several = SeveralTx(links, stops, campaign.config.contours, track)
    kept = tuple(range(len(standing)))
    rows = range(len(standing), len(every))
    objective = Criterion(several, criterion, kept)
    found = exhaustive(objective, rows, count, track_sets) if all_sets else greedy(objective, rows, count)
    least = found.log_error[-1]
    if not all_sets and count > 1:
        least = min(least, least_log_error(objective, rows, count, found.chosen, len(every)))
    return Placement(several, tuple(every), kept, criterion, found, least, all_sets or count == 1)


def with_tx(campaign: Campaign, chosen: Sequence[Candidate], stops: Sequence[int]) -> CampaignRun:
    """A run of the campaign with these TX in place of its own."""
    first, *others = chosen
    scene = replace(
        campaign.scene,
        tx=first.pose,
        tx_name=first.name,
        other_txs={each.name: each.pose for each in others},
        tx_motions={},
    )
    names = [each.name for each in chosen]
    own = {name: table for name, table in campaign.config.transmitters.items() if name in names}
    config = campaign.config.model_copy(update={"tx": names, "transmitters": own})
    return CampaignRun(config, scene, stops=list(stops))


def _alone(campaign: Campaign, candidate: Candidate) -> CampaignRun:
    """The run of one candidate with its own settings."""
    return with_tx(campaign, [candidate], range(len(campaign.stops))).links[0]


def placement_table(placement: Placement) -> Table:
    """The TX in the order in which they were chosen, and the criterion with each."""
    table = Table("TX", "x in m", "y", "z", "heading in deg", f"criterion '{placement.criterion}' in m")
    for column in table.columns[1:]:
        column.justify = "right"
    values = [*len(placement.kept) * [np.nan], *np.exp(placement.found.log_error)]
    for row, value in zip(placement.chosen, values, strict=True):
        each = placement.candidates[row]
        place_m = [f"{part:.2f}" for part in each.pose.position_m]
        name = f"{each.name} (stands)" if row in placement.kept else each.name
        table.add_row(name, *place_m, f"{np.rad2deg(each.pose.heading_rad):.0f}", cell(value))
    return table


def certificate(placement: Placement) -> str:
    """How good the choice is, in a line."""
    head = f"criterion {cell(placement.error_m)} m"
    if placement.is_best:
        return f"{head}: the best of all sets of the candidates"
    least = cell(float(np.exp(placement.least_log_error)))
    return f"{head}: no set is below {least} m, so it is at most {placement.above_best:.3g} times the best"


def as_numbers(placement: Placement) -> dict[str, Any]:
    """The placement for a JSON file."""
    return {
        "criterion": placement.criterion,
        "tx": [
            {
                "name": each.name,
                "position_m": each.pose.position_m.tolist(),
                "heading_deg": float(np.rad2deg(each.pose.heading_rad)),
                "stands": row in placement.kept,
            }
            for row, each in ((row, placement.candidates[row]) for row in placement.chosen)
        ],
        "criterion_m": np.exp(placement.found.log_error).tolist(),
        "above_best_at_most": placement.above_best,
        "is_best": placement.is_best,
        "candidates": [each.name for each in placement.candidates],
    }
