from dataclasses import fields, replace

import numpy as np
import pytest

from estimation.channel.correlation import CorrelatedPaths, PointingErrors
from estimation.channel.record import PathMotion, PathsInHall, check_estimate
from estimation.slam.mapping.incidence_points import map_stops
from isac_arena.campaign.chain.inputs import known_receiver
from isac_arena.insight.budget.oracles import (
    TracedPaths,
    object_labels,
    typical_covariance,
    with_true_association,
    with_true_detection,
    with_true_geometry,
)
from isac_arena.scoring.association import parameter_errors
from scenes.record import concatenate

STD = np.array([1e-9, 0.02, 0.02])


def parameters(estimate):
    return np.stack([estimate.delay_s, estimate.aod_azimuth_rad, estimate.aoa_azimuth_rad], axis=-1)


@pytest.fixture
def traced(chain):
    return chain.paths[4], chain.stops[4]


def test_detection_keeps_found_paths_drops_false_ones_and_adds_missed_ones(traced):
    paths, stop = traced
    assert (paths.true_path == -1).sum() == 1
    found = with_true_detection(paths, stop, np.diag(STD**2))
    assert sorted(found.true_path) == sorted(stop.significant)
    check_estimate(found.estimate, 1e-6)
    added = ~np.isin(found.true_path, paths.true_path)
    error = parameter_errors(parameters(found.estimate), stop.parameters[found.true_path])
    np.testing.assert_allclose(error[added], 0, atol=1e-15)
    assert (np.abs(error[~added]) > 0).all()
    np.testing.assert_array_equal(found.estimate.covariance[added][0], np.diag(STD**2))
    assert not found.estimate.is_los[added].any()


def test_added_paths_have_what_an_estimate_tells_of_its_paths(traced):
    paths, stop = traced
    n, size = len(paths.estimate), paths.estimate.size("parameter")
    told = replace(
        paths.estimate,
        motion=PathMotion(np.ones(n, bool), np.ones(n), np.ones(n), np.zeros(n)),
        hall=PathsInHall(np.eye(4)[np.zeros(n, int)], np.eye(5)[np.zeros(n, int)], np.ones(n), np.ones(3)),
        correlated=CorrelatedPaths(np.array([0]), np.array([1]), np.ones((1, size, size))),
        pointing=PointingErrors(np.ones((n, size, size))),
    )
    found = with_true_detection(TracedPaths(told, paths.true_path), stop, np.diag(STD**2))
    plain = with_true_detection(paths, stop, np.diag(STD**2))
    np.testing.assert_array_equal(parameters(found.estimate), parameters(plain.estimate))
    added = ~np.isin(found.true_path, paths.true_path)
    np.testing.assert_allclose(found.estimate.hall.class_probability[added], 0.25)
    np.testing.assert_array_equal(found.estimate.hall.class_probability[~added, 0], 1.0)
    assert added.any() and not found.estimate.motion.is_moving[added].any()
    assert found.estimate.motion.is_moving[~added].all()


def test_geometry_is_exact_where_there_is_truth_and_as_estimated_elsewhere(traced):
    paths, stop = traced
    found = with_true_geometry(paths, stop)
    known = found.true_path >= 0
    error = parameter_errors(parameters(found.estimate), stop.parameters[found.true_path])
    np.testing.assert_allclose(error[known], 0, atol=1e-15)
    false = paths.true_path < 0
    np.testing.assert_array_equal(parameters(found.estimate)[~known], parameters(paths.estimate)[false])
    check_estimate(found.estimate, 1e-6)


def test_geometry_never_puts_two_paths_in_one_place(traced):
    paths, stop = traced
    twice = TracedPaths(
        concatenate([paths.estimate, paths.estimate.take("path", [1])], "path"),
        np.append(paths.true_path, paths.true_path[1]),
    )
    found = parameters(with_true_geometry(twice, stop).estimate)
    assert len(np.unique(found[:-1], axis=0)) == len(found) - 1  # as many as before: the second stays as it was


def test_association_leaves_the_line_of_sight_and_upright_single_bounces(traced, chain):
    paths, stop = traced
    found = with_true_association(paths, stop, chain.run.scene)
    assert found.true_path[found.estimate.is_los].tolist() == [0]
    assert set(found.true_path) <= {0, 1, 2, 3, 4}
    assert 5 not in found.true_path  # the double bounce
    np.testing.assert_array_equal(found.estimate.los_probability, found.estimate.is_los)
    lonely = with_true_association(paths, replace(stop, origin=replace(stop.origin, kind=stop.origin.kind + 1)),
                                   chain.run.scene)  # fmt: skip
    assert not lonely.estimate.is_los.any()


def test_all_path_oracles_together_give_the_exact_incidence_points(chain):
    """The map of equation (4) from paths by truth lies on the true points."""
    paths = [
        with_true_association(
            with_true_geometry(with_true_detection(one, stop, np.diag(STD**2)), stop), stop, chain.run.scene
        )
        for one, stop in zip(chain.paths, chain.stops, strict=True)
    ]
    receiver = known_receiver(stop.truth for stop in chain.stops)
    ips = map_stops([one.estimate for one in paths], receiver, chain.run.scene.tx, chain.run.config.mapping)
    truth = np.array(
        [chain.stops[s].origin.vertex_m[paths[s].true_path[p]] for s, p in zip(ips.stop, ips.path, strict=True)]
    )
    assert len(ips) == 4 * len(chain.stops)
    np.testing.assert_allclose(ips.position_m, truth, atol=1e-9)


def test_oracles_change_nothing_of_a_perfect_estimate(campaign, stops):
    for estimate, stop in zip(campaign.results.channel, stops, strict=True):
        perfect = TracedPaths(estimate, stop.significant)
        ordered = perfect.sorted_by_delay()
        for oracle in (with_true_detection(perfect, stop, np.diag(STD**2)), with_true_geometry(perfect, stop)):
            found = oracle.sorted_by_delay()
            for spec in fields(type(estimate)):
                np.testing.assert_array_equal(
                    getattr(found.estimate, spec.name), getattr(ordered.estimate, spec.name)
                )


def test_typical_covariance_is_the_median_of_what_is_known(campaign):
    estimates = list(campaign.results.channel)
    expected = np.diag(estimates[0].covariance[0])
    np.testing.assert_allclose(np.diag(typical_covariance(estimates, STD**2)), expected)
    unknown = [replace(one, covariance=np.full_like(one.covariance, np.nan)) for one in estimates]
    np.testing.assert_allclose(np.diag(typical_covariance(unknown, STD**2)), STD**2)
    np.testing.assert_allclose(np.diag(typical_covariance([], STD**2)), STD**2)


def test_labels_follow_the_objects(campaign):
    ips = campaign.results.mapping.ips
    names = np.array(["pillar_a", "", "wall_east", "pillar_a"] * (len(ips) // 4))
    inlier = np.arange(len(ips)) > 0
    label, shown = object_labels(replace(ips, is_inlier=inlier), names)
    assert shown.tolist() == ["pillar_a", "wall_east"]
    assert label[:5].tolist() == [-1, -1, 1, 0, 0]
