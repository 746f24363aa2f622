"""The movers of the report: tracks and truth over time, and the Doppler shifts of a stop."""

from typing import Any

import numpy as np
import pytest

from isac_arena.report.page.html import render_report
from isac_arena.report.page.payload.campaign import report_payload
from isac_arena.report.page.payload.tracks import N_FRAMES, track_payload
from isac_arena.scoring.chain import score_campaign
from isac_arena.validation.scenarios.perfect_campaign import MadeCampaign, make_moving_campaign
from tests.isac_arena.report.test_payload import LIMITS

SPEED_M_S = np.array([0.4, -0.2, 0.0])


@pytest.fixture(scope="module")
def moving() -> MadeCampaign:
    return make_moving_campaign(SPEED_M_S)


def test_the_page_is_told_tracks_movers_and_shifts(moving: MadeCampaign) -> None:
    found = track_payload(moving.scene, moving.results.channel, moving.results.slam.tracks)
    assert found is not None
    (mover,), (track,) = found["movers"], found["tracks"]
    way = np.reshape(mover["xy"], (N_FRAMES, 2))
    np.testing.assert_allclose(way[-1] - way[0], found["frame_s"][-1] * SPEED_M_S[:2], atol=2e-3)
    np.testing.assert_allclose(np.reshape(track["xy"], (-1, 2))[0], way[0], atol=2e-3)
    shifts = found["shifts"][0]
    assert shifts["track"][1] == 0 and shifts["doppler_hz"][1] == 120 and not shifts["still"][1]
    assert set(shifts["track"][2:]) == {-1} and all(shifts["still"][2:])
    assert track_payload(moving.scene, moving.results.channel, None) is None


def test_the_slider_moves_the_world(tab: Any, folder: Any, moving: MadeCampaign, true_power: Any) -> None:
    scores = score_campaign(
        moving.scene, moving.truths, moving.results, true_power_dbm=true_power, significance=LIMITS
    )
    assert scores.value("tracks.found_share") == 1.0 and scores.value("tracks.gospa_all.mean_m") < 1e-9
    page = folder / "moving.html"
    payload = report_payload("made up", moving.scene, moving.results, scores.tables)
    page.write_text(render_report(payload, scores, {}, {"seed": "1"}), encoding="utf-8")
    tab.show(page, "#stop=0")
    assert tab.count("#figure-tracks .mover") == 1 and tab.count("#figure-tracks .track-here") == 1
    before = tab.evaluate("document.querySelector('#figure-tracks .mover').getAttribute('d')")
    slide = (
        "const s = document.getElementById('track-slider'); s.value = s.max; s.dispatchEvent(new Event('input'));"
    )
    tab.evaluate(f"(() => {{ {slide} }})()")
    tab.settle()
    assert tab.evaluate("document.querySelector('#figure-tracks .mover').getAttribute('d')") != before
    n_stops = len(moving.results.channel)
    assert tab.text("#stop-title") == f"Stop {n_stops - 1}" and tab.count("#figure-tracks .track-state") == n_stops
    n_paths = len(moving.results.channel[-1])
    assert tab.count("#figure-range-doppler .shift") == tab.count("#figure-angle-doppler .shift") == n_paths
    tab.click("#track-play")
    assert tab.text("#track-play") == "Pause"
    tab.click("#track-play")
    assert tab.is_silent()
