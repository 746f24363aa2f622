from dataclasses import replace

import numpy as np
import pytest

from isac_arena.scoring.chain import score_campaign
from isac_arena.scoring.config import Significance

LIMITS = Significance(dynamic_range_db=28.0, noise_threshold_dbm=-150.0)


@pytest.fixture
def scene_scores(campaign, true_power):
    def score(results=campaign.results):
        found = score_campaign(
            campaign.scene, iter(campaign.truths), results, true_power_dbm=true_power, significance=LIMITS,
        )  # fmt: skip
        return found.tables.mapping.scene

    return score


def test_exact_pillars_are_at_no_distance_and_walls_do_not_count(scene_scores):
    table = scene_scores()
    assert table.method.tolist() == ["shapes", "contours"]
    np.testing.assert_allclose(table.gospa, 0, atol=2e-3)
    assert table.missed.tolist() == table.false.tolist() == [0, 0]


def test_a_missing_pillar_costs_half_a_square(scene_scores, campaign):
    mapping = campaign.results.mapping
    label = np.where(mapping.shapes.label == 0, -1, mapping.shapes.label - 1)
    fewer = replace(mapping.shapes.take("cluster", [1, 2, 3]), label=label)
    table = scene_scores(replace(campaign.results, mapping=replace(mapping, shapes=fewer)))
    assert table.missed[0] == pytest.approx(np.sqrt(0.5))
    assert table.gospa[0] == pytest.approx(np.sqrt(0.5), abs=1e-3)
    assert table.gospa[1] == pytest.approx(0, abs=2e-3)


def test_an_open_contour_of_a_pillar_is_false_and_misses_it(scene_scores, campaign):
    mapping = campaign.results.mapping
    opened = replace(mapping.contours, is_closed=np.zeros(4, bool))
    table = scene_scores(replace(campaign.results, mapping=replace(mapping, contours=opened)))
    assert table.missed[1] == table.false[1] == pytest.approx(1)


def test_phantoms_of_walls_are_false_and_open_contours_of_no_object_are_left_out(scene_scores, campaign):
    mapping = campaign.results.mapping
    flat = np.flatnonzero(~mapping.contours.is_closed)
    around = np.linspace(0, 2 * np.pi, mapping.contours.contour_m.shape[1], endpoint=False)
    ring = np.array([-40.0, -40.0]) + 0.3 * np.stack([np.cos(around), np.sin(around)], axis=1)
    contour_m, is_closed = mapping.contours.contour_m.copy(), mapping.contours.is_closed.copy()
    contour_m[flat[0]], is_closed[flat[0]] = ring, True
    ringed = replace(mapping.contours, contour_m=contour_m, is_closed=is_closed)
    table = scene_scores(replace(campaign.results, mapping=replace(mapping, contours=ringed)))
    assert table.false[1] == pytest.approx(np.sqrt(0.5)) and table.missed[1] == 0
    apart = replace(
        mapping.contours, object=np.where(mapping.contours.object == flat[0], -1, mapping.contours.object)
    )
    table = scene_scores(replace(campaign.results, mapping=replace(mapping, contours=apart)))
    assert table.false[1] == table.missed[1] == 0


def test_a_ring_twice_the_area_is_half_a_unit_off(scene_scores, campaign):
    mapping = campaign.results.mapping
    wide = replace(mapping.shapes, radius_m=mapping.shapes.radius_m * np.sqrt(2))
    table = scene_scores(replace(campaign.results, mapping=replace(mapping, shapes=wide)))
    assert table.gospa[0] == pytest.approx(np.sqrt(2 * 0.25), abs=2e-3)
