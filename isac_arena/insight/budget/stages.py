"""What an error budget replaces by truth or switches off, and the admissible orders."""

from collections.abc import Iterator, Sequence
from enum import StrEnum
from itertools import chain, permutations, product

Part = str
Groups = tuple[tuple[Part, ...], ...]  # parts of a group are replaced in any order, groups in the given one


class Stage(StrEnum):
    """Stages of the chain that truth can replace."""

    DETECTION = "detection"  # which paths there are
    GEOMETRY = "path geometry"  # their delays and angles
    ASSOCIATION = "association"  # which is the line of sight, which a single bounce
    POSE = "pose"  # receiver states
    CLUSTERS = "clusters"  # which incidence point belongs to which object
    FIT = "contour fit"  # the contours themselves


class Physics(StrEnum):
    """Physics that can be switched off."""

    DIFFUSE = "diffuse paths"
    MULTI_BOUNCE = "multi-bounce paths"
    NOISE = "noise"
    IMPAIRMENTS = "impairments"


# Errors propagate downstream, so truth replaces the first stages first: given poses depend on no path.
PATHS = (Stage.DETECTION, Stage.GEOMETRY, Stage.ASSOCIATION)
STAGE_GROUPS: Groups = (PATHS, (Stage.POSE,), (Stage.CLUSTERS,), (Stage.FIT,))


def orders(groups: Groups) -> Iterator[tuple[Part, ...]]:
    """All orders of the parts that keep the order of the groups."""
    for order in product(*(permutations(group) for group in groups)):
        yield tuple(chain.from_iterable(order))


def coalitions(groups: Groups) -> list[frozenset[Part]]:
    """All sets of parts that some order passes through, and each part alone; the empty set first."""
    met: dict[frozenset[Part], None] = {frozenset(): None}
    for order in orders(groups):
        for length in range(1, len(order) + 1):
            met[frozenset(order[:length])] = None
    for part in chain.from_iterable(groups):
        met[frozenset({part})] = None
    return sorted(met, key=lambda parts: (len(parts), sorted(parts)))


def label(parts: frozenset[Part], groups: Groups) -> str:
    """A file name for a set of parts: their names in order; 'none' for no part."""
    names: Sequence[Part] = [part for part in chain.from_iterable(groups) if part in parts]
    return "+".join(name.replace(" ", "_") for name in names) or "none"
