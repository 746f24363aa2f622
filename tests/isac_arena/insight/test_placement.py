"""`arena place` and `arena bound --contours`: search, certificate, candidates, both commands on a small room."""

import json
from itertools import combinations

import numpy as np
import pytest

from isac_arena.campaign.campaign import load_campaign
from isac_arena.insight.bounds.known_contour import known_contour
from isac_arena.insight.bounds.signal import SignalBounds
from isac_arena.insight.placement.candidates import read_candidates
from isac_arena.insight.placement.placement import with_tx
from isac_arena.insight.placement.search import exhaustive, greedy, least_log_error
from scenes.contours.smooth import Circle, Ellipse
from scenes.objects.scene_object import SceneObject
from tests.command_line import arena_here


class Volume:
    """Half the log of the trace of the inverse of summed informations: an error with many local optima."""

    def __init__(self, seed: int, n: int) -> None:
        rng = np.random.default_rng(seed)
        self.parts = np.einsum("ni,nj->nij", *2 * [rng.standard_normal((n, 4))])

    def relaxed(self, weight):
        inverse = np.linalg.inv(1e-3 * np.eye(4) + np.tensordot(weight, self.parts, 1))
        slope = -np.einsum("ij,njk,ki->n", inverse, self.parts, inverse)
        return 0.5 * np.log(np.trace(inverse)), slope / (2 * np.trace(inverse))

    def __call__(self, chosen):
        return self.relaxed(np.isin(np.arange(len(self.parts)), chosen).astype(float))[0]


@pytest.mark.parametrize("seed", range(4))
def test_no_set_is_below_the_certificate_and_none_above_is_found(seed):
    objective, rows = Volume(seed, 9), list(range(1, 9))
    values = [objective(chosen) for chosen in combinations(rows, 4)]
    best, found = exhaustive(objective, rows, 4), greedy(objective, rows, 4)
    assert best.log_error[-1] == pytest.approx(min(values))
    assert best.log_error[-1] <= found.log_error[-1] + 1e-12 <= best.log_error[-1] + 0.2
    least = least_log_error(objective, rows, 4, found.chosen, 9)
    assert least <= min(values) + 1e-12 and 0 not in found.chosen
    assert least > objective(range(9)) - 1.0  # the certificate says something
    assert np.all(np.diff(found.log_error) < 0)


def test_an_exhaustive_search_has_a_limit():
    with pytest.raises(ValueError, match="--exhaustive: 5852925 sets of 8 of 30 candidates"):
        exhaustive(Volume(0, 30), range(30), 8)


def test_outlines_are_known_by_their_nearest_kind():
    material = load_campaign("box_room").scene.objects[0].material
    for contour, kind in ((Circle([1.0, 2.0], 0.4), "circle"), (Ellipse([1.0, 2.0], [0.5, 0.2], 0.7), "ellipse")):
        found = known_contour(SceneObject("it", "pillar", contour, 0.0, 3.0, material))
        assert found.kind == kind
        np.testing.assert_allclose(found.parameter[:2], [1.0, 2.0], atol=1e-3)
        np.testing.assert_allclose(np.exp(found.parameter[2]), np.sqrt(contour.area_m2() / np.pi), rtol=1e-2)


def test_candidates_are_names_files_or_a_grid(tmp_path):
    scene = load_campaign("pillar_hall").scene
    assert [each.name for each in read_candidates("all", scene)] == list(scene.txs)
    grid = read_candidates("grid:4", scene, n_headings=2)
    assert len(grid) == len({each.name for each in grid}) and len(grid) % 2 == 0
    places = np.array([each.pose.position_m for each in grid])
    assert (scene.object_index_at(places) < 0).all()
    file = tmp_path / "places.csv"
    file.write_text("name,x_m,y_m,z_m,heading_deg\na, 1.0, 2.0, 3.0, 90\n")
    (only,) = read_candidates(str(file), scene)
    np.testing.assert_allclose([*only.pose.position_m, only.pose.heading_rad], [1.0, 2.0, 3.0, np.pi / 2])
    file.write_text("name,x_m,y_m,z_m,heading_deg\na,1.0,2.0\n")
    for text, why in (
        (str(file), "line 2 = 'a,1.0,2.0', must be a name and four numbers"),
        ("grid:no", "the step after grid: must be 0.1 to 100 m"),
        ("south_west,attic", "'attic' must be one of south_west"),
        ("south_west,south_west", "a name is given twice"),
        ("grid:0.4", "candidates, 1 to 500 are allowed"),
    ):
        with pytest.raises(ValueError, match=why):
            read_candidates(text, scene)


def test_a_run_has_the_chosen_tx_in_place_of_its_own():
    campaign = load_campaign("pillar_hall_two")
    places = read_candidates("north_west,south_west,south_east", campaign.scene)
    run = with_tx(campaign, places, [0])
    assert [link.scene.tx_name for link in run.links] == ["north_west", "south_west", "south_east"]
    assert len({link.config.waveform.re_offset for link in run.links}) > 1


def test_the_commands_print_bounds_and_choose(tmp_path):
    figure, rows = tmp_path / "bound.png", tmp_path / "bound.json"
    result = arena_here("bound", "box_room", "--contours", "--out", figure, "--json", rows)
    assert result.returncode == 0, result.stderr
    (found,) = json.loads(rows.read_text())["from"].values()
    (pillar,) = found["pillars"].values()
    assert 0 < pillar["lit_share"] < 1 and 0 < pillar["radius_m"] < 1 and len(found["position_m"]) == 4
    assert figure.read_bytes().startswith(b"\x89PNG")
    bounds = SignalBounds(load_campaign("box_room"))  # those of `arena bound`, and of the scores
    np.testing.assert_allclose(found["position_m"], [bounds.at_stop(stop).position_m[0] for stop in range(4)])
    places = tmp_path / "places.csv"
    places.write_text("name,x_m,y_m,z_m,heading_deg\na,1,1,1.5,45\nb,7,1,1.5,135\nc,1,5,1.5,0\n")
    figure, rows = tmp_path / "place.png", tmp_path / "place.json"
    result = arena_here(
        "place", "box_room", "--candidates", places, "--count", 2, "--every", 2, "--out", figure, "--json", rows
    )
    assert result.returncode == 0, result.stderr
    chosen = json.loads(rows.read_text())
    assert len(chosen["tx"]) == 2 and chosen["above_best_at_most"] >= 1 and figure.exists()
    assert chosen["criterion_m"][1] < chosen["criterion_m"][0]
    result = arena_here("place", "box_room", "--count", 2, "--out", figure)
    assert result.returncode == 2 and "--count = 2: must be 1 to 1, the number of candidates" in result.stderr
    result = arena_here("place", "box_room", "--criterion", "size", "--out", figure)
    assert result.returncode == 2 and "--criterion = size: must be one of pose, contours, both" in result.stderr
