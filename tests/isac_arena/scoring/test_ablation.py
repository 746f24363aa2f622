"""Ablation: the variants, their order, and rows for files."""

import numpy as np
import pytest

from isac_arena.insight.ablation import variants
from isac_arena.insight.ablation_ranking import EFFECTS, ranked, table_rows
from isac_arena.report.figures.ablation import ablation_figure
from isac_arena.report.style import png_bytes
from sim.signal.hardware.config import ImpairmentsConfig


def test_variants_are_none_each_alone_and_all() -> None:
    both = ImpairmentsConfig(cfo_hz=100.0, adc_bits=6)
    made = variants(both)
    assert list(made) == ["none", "CFO", "ADC quantisation", "all"]
    assert made["none"] == ImpairmentsConfig() and made["all"] == both
    assert made["CFO"] == ImpairmentsConfig(cfo_hz=100.0)
    with pytest.raises(ValueError, match="impairments: all are off"):
        variants(ImpairmentsConfig())


def test_the_strongest_impairment_comes_first() -> None:
    n = len(EFFECTS)
    doubled_but_one_lost = [2.0] * (n - 1) + [np.nan]
    ablation = ranked({"none": [1.0] * n, "a": [1.1] * n, "b": doubled_but_one_lost, "all": [4.0] * n})
    assert ablation.variant == ("b", "a", "all", "none")
    np.testing.assert_allclose(ablation.growth, [1.0, np.log2(1.1), 2.0, 0.0])
    rows = list(table_rows(ablation))
    assert rows[0]["variant"] == "b" and rows[0][list(EFFECTS)[-1]] is None
    assert png_bytes(ablation_figure(ablation)).startswith(b"\x89PNG")
