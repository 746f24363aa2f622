"""Class probabilities of paths: agreement with other paths, power and elevation, with priors learned by EM.

Every path has a state: weak, line of sight, or one of the versions of a plan path. The evidence for a state is the
density f of its features (loss beyond free space, accuracy of range and azimuths), the density g of its
elevations, and its agreement with other paths:

    q_i(s) ~ share_s f_s(features_i) g_s(elevation_i) [1 - p_s + p_s sum_j sum_s' q_j(s') ratio_ij(s, s')],

iterated from equal support (a mean field over the pairs); p_s is how often such a path has versions among
the others. Shares, f and p are those of the campaign, by EM. Per stop at most one path is the line of sight.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from estimation.channel.hall.geometry import Version
from estimation.channel.hall.pairs import VERSION_PAIRS, Agreement, agreement
from estimation.channel.hall.paths import PlanPoints, RangedPaths, elevation_log_likelihood, plan_points
from estimation.channel.hall.power import SIGHT_STD_DB, StopPowers
from estimation.channel.hall.record import ClassPriors, HallClass
from scenes.record import FloatArray

WEAK, SIGHT, FIRST = 0, 1, 2  # states; then the versions in their order
N_STATES = FIRST + len(Version)
GEOMETRY = np.array([0, 0, *Version])  # version whose plan path a state has
SHARED = ([WEAK], [SIGHT], [FIRST], [FIRST + 1, FIRST + 2, FIRST + 3, FIRST + 4])  # states with common features
ROUNDS = 8
PSEUDO = 3000.0  # paths that the prior of features and versions counts for
SHARE_PSEUDO = 1000.0  # and that of shares: fewer let one class grow on what it took
ADDED_LOSS_DB, ADDED_STD_DB = 9.0, 8.5  # of floor or ceiling, over 317 pairs of random rooms of seed 100
MOST_LOSS_RATIO = 4.0  # logarithm; powers of close paths are uncertain
MERGED_M = 0.15  # versions closer in length are mostly estimated as one path
MOST_GAIN = 60.0  # of the squared gain over free space, which is limited: powers of poor estimates are too large


STATE_CLASS = np.array([3, 0, 1, 2, 2, 2, 2])  # class of each state


def _start() -> ClassPriors:
    """Priors as in walks through random rooms of seeds 106 and 107, of both kinds of hardware: a start for EM."""
    mean = np.array([[41, -1.3, -1.85], [0, -2.7, -3.0], [18, -2.2, -2.6], [14, -2.1, -2.6]], float)
    std = np.array([[10.5, 0.35, 0.37], [SIGHT_STD_DB, 0.95, 0.98], [10.6, 0.58, 0.63], [9.4, 0.69, 0.75]])
    correlation = np.array([[1, 0.4, 0.3], [0.4, 1, 0.8], [0.3, 0.8, 1]])
    group = np.array([0, 1, 2, 3, 3, 3, 3])
    covariance = std[:, :, None] * std[:, None] * correlation
    covariance[1] = np.diag(std[1] ** 2)
    return ClassPriors(
        share=np.array([0.75, 1.0, 0.16, 0.03, 0.045, 0.005, 0.01]),
        mean=mean[group],
        covariance=covariance[group],
        has_versions=np.array([0.0, 0.6, 0.2, 0.9, 0.9, 0.9, 0.9]),
    )


START = _start()


@dataclass(frozen=True)
class StopStates:
    """The states of the paths of one stop.

    Attributes
    ----------
    probability : (path, state)
    alone : (path, state) without support by other paths
    support : (path, state) by versions among the other paths
    evidence : log evidence of the stop; support counts half, because a pair supports both of its paths
    points : plan paths at the heights and clock bias
    pairs : agreement of pairs
    weight : (pair, pair of versions) probability that the pair are these versions of one plan path
    features : (path, state, feature)
    """

    probability: FloatArray
    alone: FloatArray
    support: FloatArray
    evidence: float
    points: PlanPoints
    pairs: Agreement
    weight: FloatArray
    features: FloatArray


def stop_states(
    paths: RangedPaths, powers: StopPowers, clock_m: float, differences_m: FloatArray, priors: ClassPriors
) -> StopStates:
    """States of the paths of a stop at a clock bias in m and height differences (version,)."""
    points = plan_points(paths, clock_m, differences_m)
    features = state_features(paths, powers, clock_m, differences_m)
    pairs = agreement(paths, points)
    pairs = replace(pairs, ratio=pairs.ratio * _loss_ratio(pairs, features[:, FIRST:, 0], priors))
    alone = feature_log_density(features, priors)
    elevation = elevation_log_likelihood(paths, points.value[..., 0], differences_m)[:, GEOMETRY]
    elevation[:, WEAK] = np.where(paths.sees_elevation, np.log(1 / np.pi), 0.0).sum(axis=1)
    alone += elevation
    other = np.log1p(-np.exp(np.minimum(powers.sight_log_prior, -1e-3)))
    alone += np.log(priors.share) + other[:, None]
    alone[:, SIGHT] += powers.sight_log_prior - other
    alone[:, FIRST:] -= np.log(merged_versions(paths.range_m - clock_m, differences_m))
    allowed = points.is_possible[:, GEOMETRY]
    allowed[:, WEAK] = True
    alone = np.where(allowed, alone, -np.inf)
    by_itself = _normalised(alone)
    probability, total, support = by_itself, alone, np.ones(alone.shape)
    for _ in range(ROUNDS):
        support = _support(pairs, probability)
        total = alone + np.log(1 - priors.has_versions + priors.has_versions * support)
        probability = _normalised(total)
    evidence = float(np.logaddexp.reduce([total, alone], axis=2).sum() / 2) if len(paths) else 0.0
    return StopStates(
        probability, by_itself, support, evidence, points, pairs, _weights(pairs, probability), features
    )


def state_features(
    paths: RangedPaths, powers: StopPowers, clock_m: float, differences_m: FloatArray
) -> FloatArray:
    """Features (path, state, feature): the loss beyond free space of each state, then those of the path."""
    loss_db = powers.loss_db(paths, clock_m, differences_m)[:, GEOMETRY]
    loss_db[:, WEAK] = powers.loss_as_weak_db(paths)
    same = np.broadcast_to(powers.features[:, None], (*loss_db.shape, powers.features.shape[1]))
    return np.concatenate([loss_db[..., None], same], axis=2)


def merged_versions(length_m: FloatArray, differences_m: FloatArray) -> FloatArray:
    """Number (path, version) of versions that a version of this length merges with, itself included.

    Floor and ceiling at equal distances make one path, not two.
    """
    square = np.square(differences_m)
    apart = (square[:, None] - square) / (2 * np.maximum(length_m, MERGED_M)[:, None, None] * MERGED_M)
    return np.asarray(np.exp(-0.5 * apart**2).sum(axis=2))


def feature_log_density(features: FloatArray, priors: ClassPriors) -> FloatArray:
    """Log density (path, state) of features: normal, and damped where a path has more power than in free space."""
    root = np.linalg.cholesky(priors.covariance)
    error = (features - priors.mean)[..., None]
    distance = np.square(np.linalg.solve(root, error)[..., 0]).sum(axis=2)
    volume = np.log(np.einsum("sii->si", root)).sum(axis=1)
    gain = np.minimum(features[..., 0], 0.0) / SIGHT_STD_DB
    gain[:, SIGHT] = 0.0
    return np.asarray(-0.5 * distance - volume - 0.5 * np.minimum(gain**2, MOST_GAIN))


def _loss_ratio(pairs: Agreement, loss_db: FloatArray, priors: ClassPriors) -> FloatArray:
    """How much more likely (pair, pair of versions) the losses (path, version) are as those of one plan path.

    Floor and ceiling add their loss to that of the level path. Other pairs of versions tell nothing here.
    """
    first, second = VERSION_PAIRS.T
    one, two = loss_db[pairs.one][:, first], loss_db[pairs.two][:, second]
    is_child = np.stack([first, second]) != Version.LEVEL
    child, level = np.where(is_child[0], one, two), np.where(is_child[0], two, one)
    mean, std = priors.mean[FIRST + Version.FLOOR, 0], np.sqrt(priors.covariance[FIRST + Version.FLOOR, 0, 0])
    given = ((child - level - ADDED_LOSS_DB) / ADDED_STD_DB) ** 2
    alone = ((child - mean) / std) ** 2
    ratio = np.exp(np.clip((alone - given) / 2, -MOST_LOSS_RATIO, MOST_LOSS_RATIO)) * std / ADDED_STD_DB
    return np.where(is_child.sum(axis=0) == 1, ratio, 1.0)


def version_probabilities(probability: FloatArray) -> FloatArray:
    """Probability (path, version) from that of states (path, state): the line of sight is level."""
    by_version = probability[:, FIRST:].copy()
    by_version[:, Version.LEVEL] += probability[:, SIGHT]
    return by_version


def _support(pairs: Agreement, probability: FloatArray) -> FloatArray:
    """Support (path, state) by versions among the other paths; weak ones have none."""
    by_version = version_probabilities(probability)
    first, second = VERSION_PAIRS.T
    support = np.zeros(by_version.shape)
    np.add.at(support, (pairs.one[:, None], first), pairs.ratio * by_version[pairs.two][:, second])
    np.add.at(support, (pairs.two[:, None], second), pairs.ratio * by_version[pairs.one][:, first])
    return np.concatenate([np.ones((len(support), 1)), support[:, :1], support], axis=1)


def _weights(pairs: Agreement, probability: FloatArray) -> FloatArray:
    """Probability (pair, pair of versions) that two paths are these versions of one plan path."""
    by_version = version_probabilities(probability)
    first, second = VERSION_PAIRS.T
    share = pairs.ratio / (1 + pairs.ratio)
    return np.asarray(share * by_version[pairs.one][:, first] * by_version[pairs.two][:, second])


def _normalised(total: FloatArray) -> FloatArray:
    """Probabilities (path, state); at most one path is the line of sight."""
    if not len(total):
        return total
    weight = np.exp(total - total.max(axis=1, keepdims=True))
    probability = weight / weight.sum(axis=1, keepdims=True)
    rest = np.maximum(1 - probability[:, SIGHT], 1e-12)
    odds = probability[:, SIGHT] / rest
    sight = odds / (1 + odds.sum())
    probability = probability * ((1 - sight) / rest)[:, None]
    probability[:, SIGHT] = sight
    return np.asarray(probability / probability.sum(axis=1, keepdims=True))


def learned_priors(stops: Sequence[StopStates]) -> ClassPriors:
    """A step of EM: shares, features and versions of the states over the campaign; `START` counts as few paths."""
    q = np.concatenate([stop.probability for stop in stops])
    features = np.concatenate([stop.features for stop in stops])
    support = np.concatenate([stop.support for stop in stops])
    count = q.sum(axis=0) + SHARE_PSEUDO * START.share
    count[SIGHT] = 0.0
    share = count / count.sum()
    share[SIGHT] = 1.0
    mean, covariance = START.mean.copy(), START.covariance.copy()
    for states in SHARED:
        weight, value = q[:, states].ravel(), features[:, states].reshape(-1, features.shape[2])
        total = weight.sum() + PSEUDO
        start = states[0]
        centre = (weight @ value + PSEUDO * START.mean[start]) / total
        error = value - centre
        spread = np.einsum("p,pa,pb->ab", weight, error, error)
        shift = centre - START.mean[start]
        spread += PSEUDO * (START.covariance[start] + shift[:, None] * shift)
        mean[states], covariance[states] = centre, spread / total
    mean[SIGHT, 0], covariance[SIGHT, 0], covariance[SIGHT, :, 0] = 0.0, 0.0, 0.0
    covariance[SIGHT, 0, 0] = SIGHT_STD_DB**2
    odds = START.has_versions * support
    having = odds / np.maximum(1 - START.has_versions + odds, 1e-12)
    has_versions = ((q * having).sum(axis=0) + PSEUDO * START.has_versions) / (q.sum(axis=0) + PSEUDO)
    has_versions[WEAK] = 0.0
    return ClassPriors(share, mean, covariance, np.minimum(has_versions, 0.98))


def class_probabilities(states: StopStates) -> FloatArray:
    """Probability (path, class) in the order of `HallClass`."""
    result = np.zeros((len(states.probability), len(HallClass)))
    np.add.at(result.T, STATE_CLASS, states.probability.T)
    return result
