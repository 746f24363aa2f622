"""The path record: readable ids."""

from dataclasses import replace

import numpy as np

from sim.propagation.paths import BounceKind, Paths, empty_paths, path_labels

S, D, R, NONE = BounceKind.SPECULAR, BounceKind.DIFFUSE, BounceKind.REFRACTION, BounceKind.NONE


def some_paths() -> Paths:
    delay = np.array([3e-8, 1e-8, 4e-8, 2e-8])
    level = np.zeros(4)
    return Paths(
        gain=np.ones(4, complex),
        delay_s=delay,
        aod_azimuth_rad=np.array([0.0, np.pi / 2, 0.0, 0.0]),
        aod_elevation_rad=level,
        aoa_azimuth_rad=np.array([0.0, np.pi, np.pi / 3, 0.0]),
        aoa_elevation_rad=level,
        bounce_kind=np.array([[S, NONE], [NONE, NONE], [S, NONE], [R, D]]),
        bounce_object=np.array([[0, -1], [-1, -1], [0, -1], [1, 0]]),
        vertex_m=np.full((4, 2, 3), np.nan),
        object_name=np.array(["wall", "door"]),
    )


def test_labels_name_the_chain_and_number_equals_by_delay() -> None:
    paths = some_paths()
    assert path_labels(paths).tolist() == ["S wall", "LOS", "S wall #1", "R door > D wall"]
    order = [2, 0, 3, 1]
    assert path_labels(paths.take("path", order)).tolist() == [path_labels(paths)[i] for i in order]
    assert path_labels(empty_paths(["wall"])).tolist() == []


def test_a_way_through_a_wall_is_neither_line_of_sight_nor_bounce() -> None:
    kinds = [[NONE, NONE], [R, NONE], [R, R], [S, NONE], [R, S], [S, R], [S, S], [D, NONE]]
    n = len(kinds)
    empty = empty_paths(["wall"], 2)
    paths = Paths(
        *(np.zeros(n) for _ in range(6)),
        bounce_kind=np.array(kinds), bounce_object=np.zeros((n, 2), int),
        vertex_m=np.zeros((n, 2, 3)), object_name=empty.object_name,
    )  # fmt: skip
    assert paths.is_los.tolist() == [True] + 7 * [False]
    assert paths.n_interactions.tolist() == [0, 1, 2, 1, 2, 2, 2, 1]
    assert paths.n_bounces.tolist() == [0, 0, 0, 1, 1, 1, 2, 1]
    assert paths.is_single_bounce.tolist() == [False, False, False, True, True, True, False, True]
    assert path_labels(paths).tolist()[:5] == ["LOS", "R wall", "R wall > R wall", "S wall", "R wall > S wall"]


def test_labels_of_paths_over_unknown_objects():
    paths = empty_paths([]).take("path", [])
    one = replace(
        paths,
        **{name: np.zeros(1) for name in ("delay_s", "aod_azimuth_rad", "aod_elevation_rad", "aoa_azimuth_rad",
                                          "aoa_elevation_rad")},
        gain=np.ones(1, complex),
        bounce_kind=np.array([[BounceKind.SPECULAR]]),
        bounce_object=np.array([[-1]]),
        vertex_m=np.zeros((1, 1, 3)),
    )  # fmt: skip
    assert path_labels(one).tolist() == ["S ?"]
