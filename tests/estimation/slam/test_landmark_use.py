"""Which landmarks a walk keeps, and which paths are assigned to them."""

import numpy as np

from estimation.slam.config import TrajectoryConfig
from estimation.slam.snapshot.problem import snapshot_problem
from estimation.slam.walk.association import classify_paths, drop_unused_landmarks, reclassify_paths
from estimation.slam.walk.residuals import Association, PathClass, TrajectoryState, observations
from estimation.slam.walk.smoother import minimise_robust_cost
from isac_arena.validation.scenarios.halls import ScenarioConfig, draw_walk
from isac_arena.validation.scenarios.stops import observe_stop
from isac_arena.validation.slam.trials import NOISE

SHARP = ScenarioConfig(n_paths=8, n_pillars=4, delay_std_ns=0.1, angle_std_deg=0.1)
CONFIG = TrajectoryConfig(wall_roughness_m=0.0, object_roughness_m=0.0)


def true_walk(seed: int, n_stops: int = 20):
    """Observations of a walk at its true states, lines of sight and true landmarks (path,)."""
    rng = np.random.default_rng(seed)
    walk = draw_walk(rng, SHARP, n_stops)
    stops = [observe_stop(rng, SHARP, walk.hall, state, k) for k, state in enumerate(walk.state)]
    seen = observations([snapshot_problem(s.estimate, s.tx, NOISE) for s in stops], walk.hall.tx, NOISE.floor)
    now = TrajectoryState(
        state=walk.state.copy(),
        offset_rad=np.zeros(1),
        walls=np.empty((0, 2)),
        objects=np.empty((0, 3)),
        session=np.zeros(n_stops, np.int64),
        anchor=0,
        course=np.zeros((n_stops - 2, 2)),
    )
    is_los = np.concatenate([s.is_los for s in stops])
    return seen, now, is_los, np.concatenate([s.landmark for s in stops])


def test_estimated_walls_get_their_own_paths_and_no_others():
    taken = own = foreign = 0
    for seed in range(4):
        seen, now, is_los, landmark = true_walk(seed)
        link, now, spans = classify_paths(seen, now, is_los, CONFIG, (seen, CONFIG))
        for _ in range(3):
            now = minimise_robust_cost(seen, link, now, CONFIG)
            link = reclassify_paths(seen, now, is_los, spans, CONFIG)
        for wall in range(len(now.walls)):
            members = landmark[(link.kind == PathClass.WALL) & (link.landmark[:, 0] == wall)]
            if not len(members):
                continue
            true = np.bincount(members[members >= 0], minlength=4).argmax()
            taken += np.count_nonzero(members == true)
            foreign += np.count_nonzero(members != true)
            own += np.count_nonzero(landmark == true)
    assert own > 40
    assert taken > 0.9 * own
    assert foreign <= 0.02 * taken


def test_landmarks_without_a_path_are_dropped_and_the_others_renumbered():
    _, now, _, _ = true_walk(0)
    now = TrajectoryState(
        **{**vars(now), "walls": np.arange(8.0).reshape(4, 2), "objects": np.arange(6.0).reshape(2, 3)}
    )
    kind = np.array([PathClass.WALL, PathClass.DOUBLE, PathClass.OBJECT, PathClass.BOUNCE, PathClass.LOS])
    landmark = np.array([[3, -1], [3, 1], [1, -1], [-1, -1], [-1, -1]])
    kept, link = drop_unused_landmarks(now, Association(kind, landmark))
    np.testing.assert_array_equal(kept.walls, now.walls[[1, 3]])
    np.testing.assert_array_equal(kept.objects, now.objects[[1]])
    assert link.landmark.tolist() == [[1, -1], [1, 0], [0, -1], [-1, -1], [-1, -1]]


def test_a_walk_without_landmarks_stays_without():
    seen, now, is_los, _ = true_walk(1)
    none = CONFIG.model_copy(update={"use_landmarks": False})
    link, same, spans = classify_paths(seen, now, is_los, none, (seen, none))
    kept, again = drop_unused_landmarks(same, reclassify_paths(seen, same, is_los, spans, none))
    assert len(kept.walls) == len(kept.objects) == len(spans) == 0
    np.testing.assert_array_equal(again.kind, link.kind)
