"""A roughness of its own for every landmark, and rough paths: an upright is a point, a box is not quite a circle.

The roughness common to all surfaces is too wide for most and too narrow for some. Those decide what the walk takes
for certain, so every landmark gets the roughness at which its own paths are most probable.

Most paths of a walk are far more precise than the floors of the noise. Some are not, or are other paths than they
are taken for. A tail of the law bounds their pull; but where a stop has no better paths in some direction, they
would count there as precise as the rest. So these keep the wide noise.
"""

from dataclasses import replace

import numpy as np

from estimation.slam.config import TrajectoryConfig
from estimation.slam.walk.linearise import Linearised, linearise
from estimation.slam.walk.residuals import Association, Observations, PathClass, TrajectoryState
from scenes.record import BoolArray, FloatArray, IntArray

_SHARES = np.array([0.3, 0.6, 1.0, 1.7, 3.0])  # of the common roughness: few paths tell it to about this factor
_UNKNOWNS = {PathClass.WALL: 2, PathClass.OBJECT: 3, PathClass.RAISED: 3}
_LEAST_GAIN = 1.0  # in log likelihood, for another than the common roughness
_EQUATIONS = 3  # of a path
_GAUSSIAN = 1e6  # degrees of freedom: the law of precise paths has no tail, the others are its tail
_SHARE_STEPS = 20  # of the share of rough paths
_LEAST_SHARE, _MOST_SHARE = 0.01, 0.5


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


def is_rough(
    seen: Observations,
    wide: Observations,
    link: Association,
    rough: FloatArray,
    now: TrajectoryState,
    config: TrajectoryConfig,
) -> BoolArray:
    """Paths (path,) in use that `wide` noise explains better than that of `seen`.

    `rough` (path,) are the roughnesses of surfaces with wide noise, as shares of the settings. Two laws are mixed,
    and the share of rough paths is learned.
    """
    narrow = linearise(seen, link, now, config)
    broad = linearise(wide, Association(link.kind, link.landmark, rough), now, config)
    excess = _log_ratio(broad, narrow)
    used = narrow.size > 0
    share = _LEAST_SHARE
    for _ in range(_SHARE_STEPS):
        odds = np.exp(np.clip(excess[used] + np.log(share / (1 - share)), -50.0, 50.0))
        share = float(np.clip((odds / (1 + odds)).mean(), _LEAST_SHARE, _MOST_SHARE)) if used.any() else share
    return np.asarray(used & (excess + np.log(share / (1 - share)) > 0.0))


def _log_ratio(broad: Linearised, narrow: Linearised) -> FloatArray:
    """Log density (path,) with wide noise over that with less.

    One residual has the same gap in both: the ratio of the scales is that of the residuals.
    """
    whole = broad.log_density(_GAUSSIAN) - np.where(narrow.size == 3, narrow.log_density(_GAUSSIAN), 0.0)
    squares = np.maximum(narrow.square(), 1e-12), np.maximum(broad.square(), 1e-12)
    lone = (np.log(squares[1]) - np.log(squares[0]) + squares[0] - squares[1]) / 2
    return np.where(narrow.size == 3, whole, lone)
