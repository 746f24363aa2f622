"""Ablation: the variants, their order, rows for files, and self-calibration."""

import numpy as np
import pytest

from estimation.channel.calibration.record import Calibration
from estimation.channel.config import ChannelConfig, SelfCalibrationConfig
from isac_arena.campaign import driver
from isac_arena.campaign.driver import CampaignRun
from isac_arena.insight.ablation import EFFECTS, ranked, table_rows, variants
from isac_arena.report.figures.ablation import ablation_figure
from isac_arena.report.style import png_bytes
from isac_arena.validation.scenarios.perfect_campaign import SMALL_LINK
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


def test_every_variant_calibrates_itself(campaign, monkeypatch: pytest.MonkeyPatch) -> None:
    """The arrays are learned from the variant's own sweeps: wrong elements are found, right ones are kept."""
    made: list[Calibration | None] = []
    make = driver.channel_estimator

    def recorded(config, calibration=None, **others):
        made.append(calibration)
        return make(config, calibration, **others)

    monkeypatch.setattr(driver, "channel_estimator", recorded)
    settings = ChannelConfig(method="power", self_calibration=SelfCalibrationConfig(use="always", stops=3))
    right = SMALL_LINK.model_copy(update={"channel": settings})
    wrong = ImpairmentsConfig(element_gain_std_db=1.0, element_phase_std_deg=10.0)
    for config in (right, right.model_copy(update={"impairments": wrong})):
        CampaignRun(config, campaign.scene, paths=campaign.truths[:4]).scores()
    errors = [np.std(np.abs(one.tx_element)) if one else np.nan for one in made]
    assert errors[0] < 0.05 < errors[1]
