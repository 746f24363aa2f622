"""The report page in a real browser: it loads in silence, asks for nothing, and its controls work."""

from __future__ import annotations

import re
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from estimation.shape.reflection.rows import no_contours
from estimation.slam.record import SolveStatus
from isac_arena.report.page.figures import make_figures
from isac_arena.report.page.html import render_report
from isac_arena.report.page.payload.campaign import report_payload
from isac_arena.scoring.chain import score_campaign
from isac_arena.scoring.config import Significance
from scenes.record import concatenate

LIMITS = Significance(dynamic_range_db=28.0, noise_threshold_dbm=-150.0)
BUDGET = [
    {"outcome": "pose", "budget": budget, "objection": objection, "part": part, "effect": effect,
     "share": None if objection else share, "share_low": low, "share_high": high,
     "mean_square_m2": 0.16 * share, "rms_m": rms}
    for budget, objection in (("stages", ""), ("physics", "4 stops or objects, an interval needs 6"))
    for part, share, low, high, rms, effect in (
        ("channel", 0.7, 0.5, 0.8, 0.3, "falls"), ("association", -0.1, -0.2, 0.1, -0.1, "undecided"),
        ("rest", 0.4, 0.3, 0.6, 0.2, ""), ("all errors", 1.0, None, None, 0.4, ""),
    )
]  # fmt: skip


def write_page(path: Path, campaign: Any, results: Any, true_power: Any, **more: Any) -> Path:
    scores = score_campaign(
        campaign.scene, campaign.truths, results, true_power_dbm=true_power, significance=LIMITS
    )
    figures = make_figures(campaign.scene, results, scores)
    payload = report_payload("made up", campaign.scene, results, scores.tables, **more)
    path.write_text(render_report(payload, scores, figures, {"seed": "1"}), encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def page(folder: Path, campaign: Any, true_power: Any) -> Path:
    """A page whose stop 0 has a missed and a false path, and whose first stop SLAM did not solve."""
    first = campaign.results.channel[0]
    extra = replace(first.take("path", slice(1, 2)), delay_s=first.delay_s[1:2] + 60e-9)
    changed = concatenate([first.take("path", np.array([0, 1, 3, 4, 5])), extra], "path")
    results = replace(campaign.results, channel=(changed, *campaign.results.channel[1:]))
    return write_page(folder / "page.html", campaign, results, true_power, truths=campaign.truths, budget=BUDGET)


@pytest.fixture(scope="module")
def measured_page(folder: Path, campaign: Any, true_power: Any) -> Path:
    results = replace(campaign.results, power_maps=())
    return write_page(folder / "measured.html", campaign, results, true_power)


def address(tab: Any) -> str:
    return str(tab.evaluate("location.hash"))


def test_it_loads_without_a_complaint_and_asks_for_nothing(tab: Any, page: Path) -> None:
    tab.show(page)
    assert tab.is_silent()
    assert tab.count("svg.drawing:not([hidden])") >= 6
    assert tab.text("#stop-title") == "Stop 0"


def test_the_address_selects_stop_object_and_map(tab: Any, page: Path) -> None:
    tab.show(page, "#stop=7&object=pillar_b&map=slam&contours=both&hide=band")
    assert tab.text("#stop-title") == "Stop 7"
    assert tab.text("#object-title") == "Object pillar_b"
    shown = "[...document.querySelectorAll('.plans .chart')].map(one => one.hidden)"
    assert tab.evaluate(shown) == [True, False]
    assert tab.count("#drawing-plan-slam .band") == 0
    assert tab.count("#drawing-plan-slam .contour") == 8
    assert tab.evaluate("document.querySelector('#pick-stop').value") == "7"
    assert tab.is_silent()


def test_rays_of_several_bounces_are_hidden_at_first(tab: Any, page: Path) -> None:
    tab.show(page)
    assert tab.count("#drawing-plan-mapping .ray") > 0
    assert tab.count("#drawing-plan-mapping .kind-two-reflections") == 0
    tab.click("#layer-several")
    assert tab.count("#drawing-plan-mapping .kind-two-reflections") > 0
    assert tab.count("#drawing-plan-mapping .estimate.weak") == 0
    tab.click("#layer-weak")
    assert "hide=&" in address(tab) + "&"
    tab.show(page, "#stop=0&hide=")
    assert tab.count("#drawing-plan-mapping .kind-two-reflections") > 0


def test_what_the_address_does_not_know_stays(tab: Any, page: Path) -> None:
    tab.show(page, "#stop=999&object=no_such&map=upside&path=x9&hide=everything")
    assert tab.text("#stop-title") == "Stop 0" and tab.text("#object-title") == "Objects"
    assert tab.is_silent()


def test_a_point_in_the_plan_selects_its_stop_and_object(tab: Any, page: Path) -> None:
    tab.show(page, "#stop=0&map=mapping&hide=true,estimated")
    place = tab.evaluate(
        "(() => { const plan = document.querySelector('#drawing-plan-mapping');"
        " plan.scrollIntoView({block: 'center'}); const box = plan.getBoundingClientRect();"
        " const path = [...plan.querySelectorAll('.stop')].pop().getAttribute('d').split('M').filter(Boolean)[9];"
        " const [x, y] = path.split(/[ a]/).map(Number); return [box.left + x + 3, box.top + y]; })()"
    )
    tab.press(*place)
    assert "stop=9" in address(tab) and tab.text("#stop-title") == "Stop 9"
    assert tab.is_silent()


def test_rows_lead_from_paths_to_points_and_back(tab: Any, page: Path) -> None:
    tab.show(page, "#stop=3&map=mapping&object=pillar_a")
    rows = "document.querySelectorAll('#point-table-mapping tbody tr').length"
    assert tab.evaluate(rows) == 12
    tab.click("#point-table-mapping tbody tr:nth-child(6) button")
    assert tab.text("#stop-title") == "Stop 5" and "path=e1" in address(tab)
    chosen = "[...document.querySelectorAll('#path-table tr.chosen')].map(row => row.innerText)"
    (row,) = tab.evaluate(chosen)
    assert "S pillar_a" in row
    assert "pillar" in tab.text(".classes") and "100.0 %" in tab.text(".classes")
    tab.click("#path-table tbody tr:nth-child(2) button")
    assert "path=" not in address(tab)
    assert tab.is_silent()


def test_missed_and_false_paths_stand_in_the_table(tab: Any, page: Path) -> None:
    tab.show(page, "#stop=0")
    table = tab.text("#path-table")
    assert re.search(r"missed: \w+", table) and "false" in table
    assert tab.count("#drawing-delay-aoa .missed") == 1
    assert tab.count("#drawing-power-map .estimate-mark.false") == 1


def test_controls_answer_to_mouse_and_keys(tab: Any, page: Path) -> None:
    tab.show(page)
    tab.click("#stop-after")
    assert tab.text("#stop-title") == "Stop 1"
    tab.click("#stop-before")
    tab.click("#stop-before")
    assert tab.text("#stop-title") == "Stop 11"
    tab.click("#layer-points")
    assert tab.count("#drawing-plan-mapping .point") == 0
    tab.evaluate("document.querySelector('#drawing-plan-mapping').focus()")
    before = tab.evaluate("document.querySelector('#drawing-plan-mapping .tx').getAttribute('d')")
    tab.key("+", "+")
    tab.key("ArrowLeft")
    assert tab.evaluate("document.querySelector('#drawing-plan-mapping .tx').getAttribute('d')") != before
    tab.key("0", "0")
    assert tab.evaluate("document.querySelector('#drawing-plan-mapping .tx').getAttribute('d')") == before
    both = "document.querySelector('#drawing-plan-slam .tx').getAttribute('d')"
    assert tab.evaluate(both) == before  # both maps move together
    assert tab.is_silent()


def test_every_control_can_be_reached_and_is_named(tab: Any, page: Path) -> None:
    tab.show(page, "#object=pillar_a")
    nameless = (
        "[...document.querySelectorAll('button, select, input, svg.drawing')].filter(one =>"
        " !(one.getAttribute('aria-label') || one.innerText || one.closest('label')?.innerText)).length"
    )
    assert tab.evaluate(nameless) == 0
    assert tab.evaluate("[...document.querySelectorAll('button, select, input')].every(x => x.tabIndex >= 0)")


def test_figures_can_be_saved(tab: Any, page: Path, folder: Path) -> None:
    tab.show(page, "#stop=2")
    for figure, kind in (("plan-slam", "SVG"), ("power-map", "PNG"), ("residuals", "SVG")):
        tab.click(f"#figure-{figure} .buttons button:nth-last-of-type({2 if kind == 'SVG' else 1})")
        path = folder / f"made_up_{figure}.{kind.lower()}"
        until = time.monotonic() + 20
        while not (path.is_file() and path.stat().st_size) and time.monotonic() < until:
            time.sleep(0.05)
        data = path.read_bytes()
        if kind == "PNG":
            assert data.startswith(b"\x89PNG") and len(data) > 10_000
        else:
            assert data.startswith(b"<svg") and b"var(" not in data and b"class=" not in data
    assert tab.count("figure img + .buttons button") == 13
    assert tab.is_silent()


@pytest.mark.parametrize(("width", "height"), [(390, 844), (320, 640), (820, 1180)])
def test_nothing_is_wider_than_a_phone(tab: Any, page: Path, width: int, height: int) -> None:
    tab.size(width, height, 2, is_phone=True)
    tab.show(page, "#stop=0&object=pillar_a")
    assert tab.evaluate("document.documentElement.scrollWidth") <= width
    tab.size(1300, 900)


@pytest.mark.parametrize("width", [800, 1400])
def test_the_last_column_of_the_path_table_can_be_reached(tab: Any, page: Path, width: int) -> None:
    tab.size(width, 900)
    tab.show(page, "#stop=0")
    box = "document.querySelector('#path-table').parentElement"
    assert tab.evaluate(f"{box}.getBoundingClientRect().right") <= width
    assert tab.evaluate(f"{box}.clientHeight") <= 900  # so the bar below it is within the window
    tab.evaluate(f"{box}.scrollLeft = 1e6")
    last = tab.evaluate("document.querySelector('#path-table th:last-child').getBoundingClientRect().right")
    assert last <= tab.evaluate(f"{box}.getBoundingClientRect().right") + 1
    is_cut = tab.evaluate(f"{box}.scrollWidth > {box}.clientWidth")
    assert is_cut == (width == 800)
    assert "linear-gradient" in tab.evaluate(f"getComputedStyle({box}).backgroundImage")  # the shadow that says so
    tab.size(1300, 900)


def test_the_theme_follows_the_system_and_the_button(tab: Any, page: Path) -> None:
    paper = "getComputedStyle(document.body).backgroundColor"
    tab.media(prefers_color_scheme="dark")
    tab.show(page)
    dark = tab.evaluate(paper)
    tab.click("#theme")
    light = tab.evaluate(paper)
    assert light == "rgb(255, 255, 255)" and dark != light
    tab.click("#theme")
    assert tab.evaluate(paper) == dark
    tab.media("print", prefers_color_scheme="dark")
    assert tab.evaluate(paper) == "rgb(255, 255, 255)"
    assert tab.evaluate("getComputedStyle(document.querySelector('.controls')).display") == "none"
    tab.media()


def test_it_prints(tab: Any, page: Path) -> None:
    tab.show(page, "#stop=0&object=pillar_a")
    answer = tab.call("Page.printToPDF", paperWidth=8.27, paperHeight=11.69)
    assert len(answer["data"]) > 50_000
    tab.settle()
    assert tab.is_silent()


def test_the_budget_is_a_waterfall_that_adds_up(tab: Any, page: Path) -> None:
    tab.show(page)
    bars = tab.evaluate(
        "[...document.querySelectorAll('#drawing-budget-pose-stages rect.budget')].map(one =>"
        " [one.getAttribute('class'), +one.getAttribute('x'), +one.getAttribute('width')])"
    )
    assert [kind.split()[1] for kind, *_ in bars] == ["whole", "falls", "grows", "rest"]
    assert [kind.endswith("undecided") for kind, *_ in bars] == [False, False, True, False]
    (_, zero, whole), (_, at, fall), (_, grown_at, growth), (_, rest_at, rest) = bars
    assert fall == pytest.approx(0.7 * whole) and growth == pytest.approx(0.1 * whole)
    assert at == pytest.approx(zero + 0.3 * whole) and grown_at == pytest.approx(at)
    assert rest_at == pytest.approx(zero) and rest == pytest.approx(0.4 * whole)
    drawn = tab.evaluate("document.querySelector('#drawing-budget-pose-stages').textContent")
    assert "70.0 %, 30.0 cm" in drawn and "share of the mean square error, %" in drawn


def test_a_budget_without_shares_is_in_squares_and_says_why(tab: Any, page: Path) -> None:
    tab.show(page)
    drawn = tab.evaluate("document.querySelector('#drawing-budget-pose-physics').textContent")
    assert "30.0 cm" in drawn and "mean square error, cm²" in drawn and "%" not in drawn
    assert "No shares: 4 stops or objects" in tab.text("#figure-budget-pose-physics figcaption")
    assert tab.is_silent()


def test_the_text_of_a_stop_keeps_its_digits(tab: Any, page: Path) -> None:
    """Bounds of tenths of a millimetre and of picoseconds are no zeros."""
    tab.show(page)
    script = tab.evaluate("document.querySelector('script:not([type])').textContent")
    parts = [re.search(rf"function {name}\(.*?\n}}\n", script, re.DOTALL)[0] for name in ("shown", "measured")]
    given = "[[0.000043, 'm'], [0.0123, 'm'], [1.5, 'm'], [0.000999, 'm'], [0.00052, 'deg'], [-0.0316, 'ns'],"
    given += " [0, 'm'], [null, 'm']]"
    calls = f"return {given}.map(([value, unit]) => measured(value, unit));"
    shown = tab.evaluate(f"(() => {{ {''.join(parts)} {calls} }})()")
    assert shown == ["0.0430 mm", "1.23 cm", "1.50 m", "0.999 mm", "0.000520 deg", "−31.6 ps", "0 m", "–"]
    assert not re.search(r"\b0\.0+\b", tab.text("#stop-facts"))


def test_a_stop_solved_without_a_line_of_sight_says_which_path_slam_does_not_trust(
    tab: Any, folder: Path, campaign: Any, true_power: Any
) -> None:
    slam = campaign.results.slam
    poses = replace(slam.poses, status=np.full(len(slam.poses.stop), SolveStatus.NLOS))
    results = replace(campaign.results, slam=replace(slam, poses=poses))
    tab.show(write_page(folder / "nlos.html", campaign, results, true_power, truths=campaign.truths))
    named = int(np.flatnonzero(results.channel[0].is_los)[0])
    words = (
        f"from reflections alone (SLAM does not trust path {named}, which the channel estimate takes as the line"
    )
    assert words in tab.text("#stop-facts")
    assert "taken as LOS by the channel estimate" in tab.text("#path-table") and tab.is_silent()


def test_stops_tell_fitted_from_reported_paths_and_shared_azimuths(
    tab: Any, folder: Path, campaign: Any, true_power: Any
) -> None:
    channel = campaign.results.channel
    cut = replace(channel[0], reason="max_paths = 120 reached: there may be more")
    maps = [
        replace(one, tx_azimuth_rad=np.tile(one.tx_azimuth_rad, 2), power_dbm=np.tile(one.power_dbm, (2, 1)))
        for one in campaign.results.power_maps
    ]
    results = replace(campaign.results, channel=(cut, *channel[1:]), power_maps=tuple(maps))
    tab.show(write_page(folder / "cut.html", campaign, results, true_power, truths=campaign.truths))
    assert f"120 paths were fitted, {len(cut)} of them are reported" in tab.text("#stop-facts")
    assert "of pairs with the same two azimuths" in tab.text("#figure-power-map figcaption") and tab.is_silent()


def test_doubts_stand_before_the_words_and_counts_of_nothing_in_no_table(
    folder: Path, campaign: Any, true_power: Any
) -> None:
    text = write_page(folder / "order.html", campaign, campaign.results, true_power).read_text(encoding="utf-8")
    assert text.index('<div class="facts">') < text.index('<p class="words">') < text.index('id="explore"')
    assert "<code>mapping.objects_found.pillar</code>" in text and "objects_found.kiosk" not in text
    assert "<code>channel.missed_per_stop</code>" in text and "channel.missed.diffuse" not in text


def test_a_measured_campaign_shows_what_can_be_known(tab: Any, measured_page: Path) -> None:
    tab.show(measured_page, "#stop=4&object=pillar_a")
    assert tab.evaluate("document.querySelector('#drawing-power-map') === null")
    assert tab.evaluate("document.querySelector('#layer-true') === null")
    assert "labelled" in tab.text("#path-table") and "measured paths" in tab.text("#stop-facts")
    assert tab.count("#drawing-plan-mapping .point") > 0
    assert tab.evaluate("document.querySelector('#budget-panel').childElementCount") == 0
    assert tab.is_silent()


def test_an_empty_campaign_does_not_break_it(tab: Any, folder: Path, campaign: Any, true_power: Any) -> None:
    def emptied(result: Any) -> Any:
        shapes = result.shapes.take("ip", slice(0, 0)).take("cluster", slice(0, 0))
        poses = replace(result.poses, position_m=np.full((12, 2), np.nan))
        return replace(
            result, poses=poses, shapes=shapes, ips=result.ips.take("ip", slice(0, 0)),
            contours=no_contours(0, 12),
        )  # fmt: skip

    results = campaign.results
    silent = tuple(estimate.take("path", slice(0, 0)) for estimate in results.channel)
    empty = replace(results, channel=silent, mapping=emptied(results.mapping), slam=emptied(results.slam))
    page = write_page(folder / "empty.html", campaign, empty, true_power, truths=campaign.truths)
    tab.show(page, "#stop=5&object=pillar_a")
    assert "No contour" in tab.text("#object-body")
    assert tab.is_silent()
