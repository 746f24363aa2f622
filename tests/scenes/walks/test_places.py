"""Stops on a grid, random drops, given poses, and several walks in one campaign."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from scenes.config import SceneConfig, load_scene
from scenes.scene import Scene
from scenes.toml_config import ConfigError, read_toml, validate_config

ROOM = read_toml(Path(__file__).resolve().parents[3] / "scenes/library/box_room.toml")


def room(**walk: Any) -> Scene:
    return validate_config({**ROOM, "walk": walk}, SceneConfig, "room").build(60e9)


def clearance(scene: Scene) -> float:
    """Least distance of a stop to an object, from the signed distances of the contours."""
    places = scene.walk.positions_m()[:, :2]
    near = [item.contour.signed_distance(places).min() for item in scene.objects if item.name != "box"]
    return float(min(near))


@pytest.mark.parametrize("step", [0.5, 1.0, 1.3])
def test_a_grid_covers_the_free_area(step: float) -> None:
    scene = room(type="grid", height_m=1.5, step_m=step, clearance_m=0.4)
    places = scene.walk.positions_m()
    gap = np.linalg.norm(places[:, None] - places[None], axis=-1) + 1e9 * np.eye(len(places))
    assert gap.min() == pytest.approx(step) and clearance(scene) >= 0.4
    free_m2 = 9.2 * 7.2 - np.pi * 0.7**2
    assert len(places) == pytest.approx(free_m2 / step**2, rel=0.25)
    assert np.linalg.norm(places - scene.tx.position_m, axis=1).min() >= 0.05


def test_drops_repeat_and_spread() -> None:
    walk = {"type": "drops", "n_stops": 400, "seed": 5, "height_m": 1.5, "clearance_m": 0.5}
    one, same, other = room(**walk), room(**walk), room(**{**walk, "seed": 6})
    np.testing.assert_array_equal(one.walk.positions_m(), same.walk.positions_m())
    assert not np.array_equal(one.walk.positions_m(), other.walk.positions_m())
    assert clearance(one) >= 0.5
    np.testing.assert_allclose(one.walk.positions_m()[:, :2].mean(axis=0), [5.0, 4.0], atol=0.4)
    assert abs(np.exp(1j * one.walk.headings_rad()).mean()) < 0.15
    assert np.ptp(room(**walk, heading_deg=30.0).walk.headings_rad()) == 0


def test_poses_are_given_in_the_file_or_beside_it(tmp_path: Path) -> None:
    scene = room(type="poses", poses=[[4.0, 2.0, 1.2, 90.0], [6.0, 2.0, 1.4, -45.0]])
    np.testing.assert_allclose(scene.walk.positions_m(), [[4, 2, 1.2], [6, 2, 1.4]])
    np.testing.assert_allclose(np.rad2deg(scene.walk.headings_rad()), [90, -45])
    text = (Path(__file__).resolve().parents[3] / "scenes/library/box_room.toml").read_text()
    head, _, rest = text.partition("[walk]")
    rest = rest[rest.index("[floor]") :]
    (tmp_path / "room.toml").write_text(f'{head}[walk]\ntype = "poses"\nfile = "poses.csv"\n{rest}')
    (tmp_path / "poses.csv").write_text("x_m,y_m,z_m,heading_deg\n4,2,1.2,90\n6,2,1.4,-45\n")
    np.testing.assert_allclose(load_scene(tmp_path / "room.toml").walk.positions_m(), scene.walk.positions_m())
    (tmp_path / "poses.csv").write_text("4,2,1.2,90\n6,2,nan,-45\n")
    with pytest.raises(ConfigError, match=r"poses.csv: line 2: must be four finite numbers, x_m, y_m, z_m"):
        load_scene(tmp_path / "room.toml")


def test_several_walks_follow_each_other() -> None:
    first = {"name": "aisle", "waypoints_m": [[4.0, 2.0], [8.5, 2.0]], "n_stops": 3, "height_m": 1.5}
    second = {"name": "drops", "type": "drops", "n_stops": 4, "seed": 1, "height_m": 1.0}
    tables = {key: value for key, value in ROOM.items() if key != "walk"} | {"walks": [first, second]}
    scene = validate_config(tables, SceneConfig, "room").build(60e9)
    both = scene.choose(walk=["drops", "aisle"])
    assert both.walk_name == "drops+aisle" and len(both.stops) == 7
    np.testing.assert_array_equal(both.walk.positions_m()[4:], scene.walk.positions_m())
    with pytest.raises(ValueError, match="walk = 'no': must be one of aisle, drops"):
        scene.choose(walk=["aisle", "no"])
