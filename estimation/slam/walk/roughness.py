"""A roughness of its own for every landmark of a walk: an upright is a point, a box is not quite a circle.

The roughness common to all surfaces is too wide for most and too narrow for some. Those decide what the walk takes
for certain, so every landmark gets the roughness at which its own paths are most probable.
"""

from dataclasses import replace

import numpy as np

from estimation.slam.config import TrajectoryConfig
from estimation.slam.walk.linearise import linearise
from estimation.slam.walk.residuals import Association, Observations, PathClass, TrajectoryState
from scenes.record import FloatArray, IntArray

_SHARES = np.array([0.3, 0.6, 1.0, 1.7, 3.0])  # of the common roughness: few paths tell it to about this factor
_UNKNOWNS = {PathClass.WALL: 2, PathClass.OBJECT: 3, PathClass.RAISED: 3}
_LEAST_GAIN = 1.0  # in log likelihood, for another than the common roughness
_EQUATIONS = 3  # of a path


def own_roughness(
    seen: Observations, link: Association, now: TrajectoryState, config: TrajectoryConfig
) -> Association:
    """The association with the most probable roughness of every landmark, at the present unknowns.

    The unknowns of a landmark are fitted to its paths, which makes their residuals small: squares are scaled to
    the equations that are left, as in restricted maximum likelihood (Patterson and Thompson, 1971). A landmark
    with no path to spare keeps the common roughness.
    """
    mine = np.flatnonzero(np.isin(link.kind, list(_UNKNOWNS)))
    if not len(mine):
        return link
    name = np.column_stack([link.kind[mine], link.landmark[mine, 0]])
    names, member, count = np.unique(name, axis=0, return_inverse=True, return_counts=True)
    member = member.reshape(-1)
    unknowns = np.array([_UNKNOWNS[PathClass(kind)] for kind in names[:, 0]])
    spare = _EQUATIONS * count - unknowns
    left = np.maximum(spare, 1) / (_EQUATIONS * count)
    likelihood = np.array(
        [
            left * np.bincount(member, _log_density(seen, link, now, config, share, left[member], mine))
            for share in _SHARES
        ]
    )
    likelihood[_SHARES != 1.0] -= _LEAST_GAIN
    best = np.where(spare > _EQUATIONS, _SHARES[np.argmax(likelihood, axis=0)], 1.0)
    rough = np.ones(len(link.kind))
    rough[mine] = best[member]
    return replace(link, rough=rough)


def _log_density(
    seen: Observations,
    link: Association,
    now: TrajectoryState,
    config: TrajectoryConfig,
    share: float,
    left: FloatArray,
    mine: IntArray,
) -> FloatArray:
    """Log density (path,) of some paths at a share of the common roughness, their squares over `left`."""
    freedom = config.degrees_of_freedom
    lin = linearise(seen, replace(link, rough=np.full(len(link.kind), share)), now, config)
    square = lin.square()[mine]
    excess = np.log1p(square / left / freedom) - np.log1p(square / freedom)
    return np.asarray(lin.log_density(freedom)[mine] - (freedom + _EQUATIONS) / 2 * excess)
