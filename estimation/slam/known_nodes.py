"""Records of campaigns where some stops are fixed nodes: their states are known, and only what walks is located.

What walks is a run of its own with the links that reach it. Its records count these links alone; here they get the
numbers of all links of the campaign.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from estimation.channel.record import ChannelEstimate
from estimation.slam.record import N_STATE, IncidencePoints, PoseEstimates
from scenes.record import IntArray, concatenate

FIRST_CLOCK = N_STATE - 1


def of_links(estimates: Sequence[ChannelEstimate], links: IntArray) -> list[ChannelEstimate]:
    """Estimates with the paths of some `links`, counted among these alone."""
    own = (estimate.take("path", np.isin(estimate.tx, links)) for estimate in estimates)
    return [replace(estimate, tx=np.searchsorted(links, estimate.tx)) for estimate in own]


def joined_states(walks: PoseEstimates, links: IntArray, nodes: PoseEstimates) -> PoseEstimates:
    """States of what walks, with clocks against `links` (or the first ones), and those of nodes, by stop."""
    links = links[: walks.n_tx]
    n_stops, n_state = len(walks.stop), FIRST_CLOCK + nodes.n_tx
    state = np.append(np.arange(FIRST_CLOCK), FIRST_CLOCK + links)
    clock_s, covariance = np.full((n_stops, nodes.n_tx), np.nan), np.full((n_stops, n_state, n_state), np.nan)
    clock_s[:, links] = walks.tx_clock_bias_s
    covariance[:, state[:, None], state] = walks.covariance
    height, alternative = np.full((2, n_stops, n_state), np.nan)
    height[:, state], alternative[:, state] = walks.height_covariance, walks.alternative
    wide = replace(
        walks,
        clock_bias_s=clock_s[:, 0],
        tx_clock_bias_s=clock_s,
        covariance=covariance,
        height_covariance=height,
        alternative=alternative,
    )
    every = concatenate([wide, nodes], "stop")
    return every.take("stop", np.argsort(every.stop))


def joined_points(walks: IncidencePoints, links: IntArray, nodes: IncidencePoints) -> IncidencePoints:
    """Incidence points of what walks, by `links`, and those of fixed nodes, in order of stops and paths."""
    every = concatenate([replace(walks, tx=links[walks.tx]), nodes], "ip")
    return every.take("ip", np.lexsort([every.path, every.stop]))
