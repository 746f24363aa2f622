import numpy as np
import pytest

from estimation.budget.outcome import FinalErrors
from estimation.budget.record import Budget, take_apart
from estimation.budget.stages import STAGE_GROUPS, Physics, coalitions
from estimation.report.budget_figure import budget_figure
from estimation.report.style import png_bytes

PHYSICS = ((Physics.DIFFUSE, Physics.NOISE),)


@pytest.fixture
def budget():
    rng = np.random.default_rng(1)
    found = {}
    for kind, groups in (("stages", STAGE_GROUPS), ("physics", PHYSICS)):
        variants = {
            parts: [FinalErrors(rng.uniform(0, 0.1, 8), rng.uniform(0, 0.2, 3), np.zeros(0))]
            for parts in coalitions(groups)
        }
        found |= {(name, kind): one for name, one in take_apart(variants, groups, rng).items()}
    return Budget("made", tuple(range(8)), ("a", "b", "c"), 1, found)


def test_bars_run_from_all_errors_to_the_rest(budget):
    figure = budget_figure(budget)
    assert len(figure.axes) == 4
    keys = [(outcome, kind) for outcome in ("pose", "shape") for kind in ("stages", "physics")]
    for ax, key in zip(figure.axes, keys, strict=True):
        found = budget.attribution[key]
        bars = list(ax.patches)
        assert len(bars) == len(found.part) + 2
        assert bars[0].get_width() == pytest.approx(100)
        signed = [100 * value / found.total for value in found.contribution]
        assert [bar.get_width() for bar in bars[1:-1]] == pytest.approx(np.abs(signed))
        assert bars[-1].get_x() == 0
        assert bars[-1].get_width() == pytest.approx(100 * found.rest / found.total)
    assert png_bytes(figure) == png_bytes(budget_figure(budget))


def test_an_error_of_nothing_and_a_single_unit_can_be_drawn():
    none = {parts: [FinalErrors(np.zeros(1), np.zeros(0), np.zeros(0))] for parts in coalitions(PHYSICS)}
    found = take_apart(none, PHYSICS, np.random.default_rng(1))
    assert list(found) == ["pose"]
    assert png_bytes(budget_figure(Budget("made", (0,), (), 1, {("pose", "physics"): found["pose"]})))
