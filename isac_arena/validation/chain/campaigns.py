"""The campaigns of `arena validate chain`: random halls, halls of thin or thick columns, and the library.

All have one set of settings: the channel method `auto` with up to 120 paths, all stops of a walk together, and
contours by the reflection law. The rest are the defaults, or those of the campaign file.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from itertools import count
from typing import Any

import numpy as np

from isac_arena.campaign.config import CampaignConfig
from isac_arena.campaign.load import SceneSource, campaign_path, changed_campaign, library_campaigns
from isac_arena.sweep.cases import Case
from isac_arena.user_functions.config import with_functions
from isac_arena.validation.scenarios.random_halls import LONGEST_M, draw_hall
from scenes.toml_config import read_toml

N_ROOMS, MAX_PATHS = 24, 120
FEWEST_STOPS, MOST_STOPS = 12, 24  # of the walk through a room
# Radii of columns that the rules of rooms hardly draw, and the rooms that have them in place of the others.
THIN_M, THICK_M = (0.1, 0.2), (0.8, 1.5)
COLUMN_ROOMS = (THIN_M, THICK_M, THIN_M, THICK_M)
FEWEST_COLUMNS = 2  # of such a room
# 126 x 252 beam pairs in the hall of campus_arena, 400 MB of samples a stop: every third stop is enough
STOP_EVERY = {"campus_arena_63": 3}
QUICK_CAMPAIGN, N_QUICK_STOPS, LONGEST_QUICK_M, QUICK_PATHS = "box_room", 6, 12.0, 16


class ChainGroup(StrEnum):
    """Where a campaign comes from."""

    ROOMS = "rooms"
    COLUMNS = "columns"
    LIBRARY = "library"


@dataclass(frozen=True)
class ChainCampaign:
    """A campaign of the chain: where it comes from, and the case that runs."""

    name: str
    group: ChainGroup
    case: Case


@dataclass(frozen=True)
class ChainOptions:
    """What a user may choose: the method and its most paths, or an estimator of his own."""

    method: str = "auto"
    max_paths: int = MAX_PATHS
    estimator: str | None = None


def chain_campaigns(seed: int, n_rooms: int, options: ChainOptions) -> list[ChainCampaign]:
    """The campaigns of a seed, longest first: the library, rooms of thin or thick columns, `n_rooms` rooms."""
    library = [
        library_campaign(name, seed, options, stop_every=STOP_EVERY.get(name, 1)) for name in our_campaigns()
    ]
    columns = [column_campaign(seed, index, options) for index in range(len(COLUMN_ROOMS))]
    return [*library, *columns, *(room_campaign(seed, room, options) for room in range(n_rooms))]


def quick_campaigns(seed: int, options: ChainOptions) -> list[ChainCampaign]:
    """A small room with a short walk, and the smallest campaign of the library."""
    room = _room(seed, 0, ChainGroup.ROOMS, options, N_QUICK_STOPS, longest_m=LONGEST_QUICK_M)
    return [library_campaign(QUICK_CAMPAIGN, seed, options), room]


def walk_length(seed: int, room: int) -> int:
    """Number of stops of the walk through a room."""
    rng = np.random.default_rng([seed, room, MOST_STOPS])
    return int(rng.integers(FEWEST_STOPS, MOST_STOPS, endpoint=True))


def room_campaign(seed: int, room: int, options: ChainOptions) -> ChainCampaign:
    """The campaign of a room with a walk of 12 to 24 stops."""
    return _room(seed, room, ChainGroup.ROOMS, options, walk_length(seed, room))


def column_campaign(seed: int, index: int, options: ChainOptions) -> ChainCampaign:
    """The same in a room of thin or thick columns, the first of rooms 24 + `index`, 28 + `index`, ... with two."""
    for room in count(N_ROOMS + index, len(COLUMN_ROOMS)):
        hall = draw_hall(seed, room, column_half_m=COLUMN_ROOMS[index])
        if hall.scene_text.count('name = "column') >= FEWEST_COLUMNS:
            break
    n_stops = walk_length(seed, room)
    return _room(seed, room, ChainGroup.COLUMNS, options, n_stops, column_half_m=COLUMN_ROOMS[index])


def our_campaigns() -> list[str]:
    """The campaigns of the library without the paper's way, whose settings are its own."""
    return [name for name in library_campaigns() if not name.endswith("_paper")]


def library_campaign(
    name: str, seed: int, options: ChainOptions, stop_every: int = 1, changes: Sequence[tuple[str, Any]] = ()
) -> ChainCampaign:
    """A campaign of the library with the seed, the settings of the chain and changed fields."""
    file = campaign_path(name)
    config, scene = changed_campaign(read_toml(file), file, [("seed", seed), *changes])
    return ChainCampaign(name, ChainGroup.LIBRARY, _case(config, scene, options, stop_every))


def chain_settings(config: CampaignConfig, method: str, max_paths: int) -> CampaignConfig:
    """The campaign with the settings of the chain; its other settings stay."""
    likelihood = config.channel.maximum_likelihood.model_copy(update={"max_paths": max_paths})
    channel = {**config.channel.model_dump(), "method": method, "maximum_likelihood": likelihood.model_dump()}
    return config.model_copy(
        update={
            "channel": type(config.channel).model_validate(channel),
            "contours": config.contours.model_copy(update={"method": "reflection"}),
        }
    )


def cases_of(campaigns: Sequence[ChainCampaign]) -> list[Case]:
    """The cases of some campaigns."""
    return [campaign.case for campaign in campaigns]


def _room(
    seed: int,
    room: int,
    group: ChainGroup,
    options: ChainOptions,
    n_stops: int,
    longest_m: float = LONGEST_M,
    **columns: tuple[float, float],
) -> ChainCampaign:
    hall = draw_hall(seed, room, n_stops, longest_m, **columns)
    return ChainCampaign(hall.config.name, group, _case(hall.config, SceneSource(hall.scene_text, {}), options))


def _case(config: CampaignConfig, scene: SceneSource, options: ChainOptions, stop_every: int = 1) -> Case:
    settings = chain_settings(config, options.method, options.max_paths)
    settings = with_functions(settings, {"channel": options.estimator})
    return Case(0, 0, (), settings, scene, stop_every, stages="all_kept")
