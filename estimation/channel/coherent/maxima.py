"""Moves from one maximum of the likelihood to a higher one that steps of the joint fit do not reach."""

from collections.abc import Callable

from estimation.channel.coherent.mirror import PairMirror
from estimation.channel.coherent.moving import move_to_likelier_turns
from estimation.channel.coherent.raised import PathRaiser
from estimation.channel.coherent.refine import Reference, Solution, solve_at
from estimation.channel.coherent.search import DirectionGrid
from estimation.channel.coherent.twins import TwinChooser
from scenes.record import FloatArray

STEPS = 3  # of a path that moves: its neighbours hardly do
PAIR_STEPS = 8  # of a pair, whose two paths move each other

Move = Callable[[Reference, Solution], Solution]


class HigherMaximum:
    """Moves of one stop; a path needs the power `level` to be there."""

    def __init__(self, grids: tuple[DirectionGrid, DirectionGrid], turns: FloatArray, level: float) -> None:
        raise_paths, mirror_pairs, choose_twins = PathRaiser(), PairMirror(), TwinChooser(grids)
        self._moves: tuple[Move, ...] = (
            lambda at, now: raise_paths(at, now, level / 2, STEPS),
            lambda at, now: mirror_pairs(at, now, PAIR_STEPS),
            lambda at, now: choose_twins(at, now, STEPS),
            lambda at, now: move_to_likelier_turns(at, now, turns, STEPS),
        )

    def __call__(self, reference: Reference, solution: Solution) -> Solution:
        """The solution, which is at the reference's paths, with paths raised, mirrored in pairs, or moved to twins
        or to other Doppler shifts.

        The moves are for symmetries of the likelihood: elevations up and down, close pairs, directions in which
        the beams respond alike, and shifts that a scan confuses. It is the same solution if no move explains more.
        """
        for move in self._moves:
            moved = move(reference, solution)
            if moved is not solution:
                reference = Reference(reference.sweep, moved.paths)
                solution = solve_at(reference, moved.paths)
        return solution
