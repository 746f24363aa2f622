import numpy as np
import pytest

from isac_arena.insight.budget.outcome import FinalErrors
from isac_arena.insight.budget.record import Budget, attributions
from isac_arena.insight.budget.stages import STAGE_GROUPS, Physics, coalitions
from isac_arena.report.figures.budget import budget_figure
from isac_arena.report.style import png_bytes

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
        found |= {(name, kind): one for name, one in attributions(variants, groups, rng).items()}
    return Budget("made", tuple(range(8)), ("a", "b", "c"), 1, found)


def test_bars_run_from_all_errors_to_the_rest(budget):
    figure = budget_figure(budget)
    assert len(figure.axes) == 4
    keys = [("pose", kind) for kind in ("stages", "physics")]
    for ax, key in zip(figure.axes[:2], keys, strict=True):
        found = budget.attribution[key]
        assert not found.objection
        bars = list(ax.patches)
        assert len(bars) == len(found.part) + 2
        assert bars[0].get_width() == pytest.approx(100)
        signed = [100 * value / found.total for value in found.contribution]
        assert [bar.get_width() for bar in bars[1:-1]] == pytest.approx(np.abs(signed))
        assert bars[-1].get_x() == 0
        assert bars[-1].get_width() == pytest.approx(100 * found.rest / found.total)
    assert png_bytes(figure) == png_bytes(budget_figure(budget))


def test_a_budget_of_few_units_is_in_squares(budget):
    """Three objects give no interval: parts in cm^2 that add up, without a share."""
    found = budget.attribution["shape", "stages"]
    assert found.n_units == 3 and found.objection
    ax = budget_figure(budget).axes[2]
    assert "cm²" in ax.get_xlabel() and found.objection in ax.get_xlabel()
    bars = list(ax.patches)
    assert bars[0].get_width() == pytest.approx(1e4 * found.total)
    assert [bar.get_width() for bar in bars[1:-1]] == pytest.approx(1e4 * np.abs(found.contribution))
    assert not any("%" in text.get_text() for text in ax.texts)


def test_an_error_of_nothing_and_a_single_unit_can_be_drawn():
    none = {parts: [FinalErrors(np.zeros(1), np.zeros(0), np.zeros(0))] for parts in coalitions(PHYSICS)}
    found = attributions(none, PHYSICS, np.random.default_rng(1))
    assert list(found) == ["pose"]
    assert png_bytes(budget_figure(Budget("made", (0,), (), 1, {("pose", "physics"): found["pose"]})))
