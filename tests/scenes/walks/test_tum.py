"""Trajectories in the TUM format and walks that are made of them."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from scenes.config import SceneConfig, load_scene, referenced_contents
from scenes.toml_config import ConfigError, load_config
from scenes.walks.tum import parse_tum, tum_text

ROOM = (load_scene.__globals__["LIBRARY"] / "box_room.toml").read_text()


@given(st.lists(st.tuples(*3 * [st.floats(-1e3, 1e3)], st.floats(-3.14, 3.14)), min_size=1, max_size=8))
def test_poses_come_back(poses):
    table = np.array(poses)
    time, position, heading = parse_tum(tum_text(np.arange(len(table)), table[:, :3], table[:, 3]))
    assert time.tolist() == list(range(len(table)))
    np.testing.assert_allclose(position, table[:, :3], rtol=1e-8, atol=1e-12)
    np.testing.assert_allclose(heading, table[:, 3], atol=1e-8)


def test_unsolved_stops_are_left_out():
    position = np.array([[1.0, 2.0, 3.0], [np.nan, 0.0, 1.0]])
    time, kept, _ = parse_tum(tum_text(np.arange(2), position, np.zeros(2)))
    assert time.tolist() == [0] and kept.tolist() == [[1, 2, 3]]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "there is no pose"),
        ("# only a remark\n", "there is no pose"),
        ("0 1 2 3 0 0 0\n", "line 1: must be eight finite numbers"),
        ("# x\n0 1 2 3 0 0 zero 1\n", "line 2: must be eight finite numbers"),
        ("0 1 2 nan 0 0 0 1\n", "line 1: must be eight"),
        ("0 1 2 3 0 0 0 0\n", "line 1: the quaternion"),
        ("0 1 2 3 0.5 0 0 0.87\n", "line 1: the quaternion must turn about the vertical"),
    ],
)
def test_other_texts_are_refused(text, message):
    with pytest.raises(ValueError, match=message):
        parse_tum(text)


def walk_from(folder, text):
    head, _, tail = ROOM.partition("[walk]")
    _, bracket, rest = tail.partition("\n[")
    (folder / "room.toml").write_text(f'{head}[walk]\ntype = "tum"\nfile = "way.tum"\n{bracket}{rest}')
    (folder / "way.tum").write_text(text)
    return folder / "room.toml"


def test_a_walk_has_the_poses_of_its_file(tmp_path):
    position = np.array([[4.0, 2.0, 1.5], [5.5, 2.2, 1.6], [5.6, 3.0, 1.4]])
    heading = np.array([0.0, 1.0, -3.0])
    file = walk_from(tmp_path, tum_text(np.arange(3), position, heading))
    scene = load_scene(file)
    np.testing.assert_allclose([pose.position_m for pose in scene.stops], position)
    np.testing.assert_allclose([pose.heading_rad for pose in scene.stops], heading, atol=1e-8)
    assert scene.walk.height_m == pytest.approx(1.5) and scene.walk.line_m().shape == (3, 2)
    assert scene.walk.length_m == pytest.approx(np.linalg.norm(np.diff(position, axis=0), axis=1).sum())
    assert list(referenced_contents(load_config(file, SceneConfig), tmp_path)) == ["scene_files/way.tum"]


def test_a_wrong_walk_is_named(tmp_path):
    with pytest.raises(ConfigError, match=r"way.tum: line 1: must be eight finite numbers"):
        load_scene(walk_from(tmp_path, "1 2 3\n"))
    with pytest.raises(ConfigError, match="must lie within bounds_m"):
        load_scene(walk_from(tmp_path, "0 400 2 1.5 0 0 0 1\n"))
    file = walk_from(tmp_path, "0 4 2 1.5 0 0 0 1\n")
    (tmp_path / "way.tum").unlink()
    with pytest.raises(ConfigError, match=r"way.tum"):
        load_scene(file)
