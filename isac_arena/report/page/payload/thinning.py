"""Which stops the page draws: all, or evenly spaced ones of a campaign whose page would be too large to open."""

import numpy as np

from isac_arena.campaign.results import CampaignResults

MOST_BYTES = 7e6  # of the data; figures and scripts take 1 - 2 MB more
PATH_BYTES, PAIR_BYTES, STOP_BYTES = 900, 1.4, 400  # of an estimated path with its true one and points; measured


def drawn_stops(results: CampaignResults) -> list[int]:
    """The stops that the page draws, in order."""
    stops = [estimate.stop for estimate in results.channel]
    n_paths, n_pairs = sum(map(len, results.channel)), sum(one.power_dbm.size for one in results.power_maps)
    size = PATH_BYTES * n_paths + PAIR_BYTES * n_pairs + STOP_BYTES * len(stops)
    if size <= MOST_BYTES:
        return stops
    count = max(int(len(stops) * MOST_BYTES / size), 2)
    return [stops[row] for row in np.linspace(0, len(stops) - 1, count).round().astype(int)]
