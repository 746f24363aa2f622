"""Scene files: the library loads, and every mistake ends in one line with file, field and value."""

import re

import numpy as np
import pytest

from scenes.config import LIBRARY, ConfigError, library_scenes, load_scene

ROOM = (LIBRARY / "box_room.toml").read_text()


def test_campus_arena_holds_the_measured_hall():
    scene = load_scene("campus_arena")
    np.testing.assert_allclose(scene.tx.position_m, [2.25, 2.5, 1.8])
    assert scene.tx.heading_rad == pytest.approx(-np.pi / 2)
    position = scene.walk.positions_m()
    assert len(position) == 45
    assert scene.walk.length_m == pytest.approx(22.0, abs=0.2)
    step = np.linalg.norm(np.diff(position, axis=0), axis=1)
    assert step.max() < 0.51
    pillars = [item for item in scene.objects if item.kind == "pillar"]
    assert len(pillars) == 16
    assert sorted({item.contour.radius_m for item in pillars}) == [0.203, 0.229]
    assert all(item.material.conductivity_s_m == 1e7 for item in pillars)
    centers = [piece.center_m for piece in scene.object("right_polygon").contour.pieces if piece.is_curved]
    for expected in ((10.289, -4.926), (10.338, -7.874)):
        assert min(np.linalg.norm(center - expected) for center in centers) < 0.03


def test_campus_arena_surfaces_reflect_as_measured():
    def slab_db(material, incidence_rad):
        index = np.sqrt(material.complex_permittivity(60e9) - np.sin(incidence_rad) ** 2)
        cosine = np.cos(incidence_rad)
        face = (cosine - index) / (cosine + index)
        turn = np.exp(-2j * np.pi * 60e9 / 299_792_458 * index * material.thickness_m)
        around = 1 - face**2 * turn**2
        return 20 * np.log10(np.abs([face * (1 - turn**2) / around, (1 - face**2) * turn / around]))

    scene = load_scene("campus_arena")
    assert slab_db(scene.object("ring_wall").material, np.deg2rad(35))[0] == pytest.approx(-3.8, abs=0.1)
    glazing = scene.object("wall_left_south").material
    for incidence_deg in (0, 20, 40, 50):
        reflected, transmitted = slab_db(glazing, np.deg2rad(incidence_deg))
        assert -4.2 < reflected < -2.9
        assert 14 < -4 * transmitted < 22.5


@pytest.fixture
def load(tmp_path):
    def load_text(text):
        path = tmp_path / "room.toml"
        path.write_text(text)
        return load_scene(path)

    return load_text


def test_library_text_loads_from_any_path(load):
    assert load(ROOM).object_names == load_scene("box_room").object_names


def test_bounds_default_to_the_objects(load):
    scene = load(ROOM.replace("bounds_m = [0.0, 0.0, 10.0, 8.0]", ""))
    np.testing.assert_allclose(scene.bounds_m, (-1.15, -1.15, 11.15, 9.15), atol=1e-5)


MISTAKES = [
    ("n_stops = 4", "n_stop = 4", r"walk\.n_stop = 4: unknown key; did you mean n_stops\?"),
    ("n_stops = 4", "xyzzy = 4", r"walk\.xyzzy = 4: unknown key; allowed: name, type, waypoints_m, height_m"),
    ("n_stops = 4", "n_stops = 0", r"walk\.n_stops = 0: must be greater than or equal to 1"),
    ("n_stops = 4", "n_stops = 4.5", r"walk\.n_stops = 4\.5: must be a valid integer"),
    ("n_stops = 4", 'n_stops = "4"', r'walk\.n_stops = "4": must be a valid integer'),
    ("height_m = 1.5", "", r"walk\.height_m is missing"),
    ("height_m = 1.5", "height_m = nan", r"walk\.height_m = NaN: must be a finite number"),
    ("[[4.0, 2.0], ", "[[4.0, 2.0, 1.0], ", r"walk\.waypoints_m\[0\].* = "),
    ("[[4.0, 2.0], ", "[[5.0, 5.5], ", r"RX stop 0 at \(5\.000, 5\.500, 1\.500\) m lies inside object 'pillar'"),
    ('type = "circle"', 'type = "cirle"', r'objects\[pillar\]\.contour\.type = "cirle": must be one of circle, '),
    ('type = "circle", ', "", r"objects\[pillar\]\.contour\.type is missing"),
    ("radius_m = 0.3", "radius_m = -0.3", r"objects\[pillar\]\.contour\.radius_m = -0\.3: must be greater"),
    (", radius_m = 0.3", "", r"objects\[pillar\]\.contour\.radius_m is missing"),
    ("x_m = [7.0, 8.0]", "x_m = [9.0, 8.0]", r"objects\[box\]\.contour\.x_m = \[9\.0, 8\.0\]: the first must"),
    ('kind = "pillar"', 'kind = "tree"', r"objects\[pillar\]\.kind = \"tree\": must be 'wall', "),
    ('name = "box"', 'name = "pillar"', r"objects: the name 'pillar' is given twice"),
    ('material = "metal"', 'material = "tin"', r"objects\[pillar\]\.material = 'tin': must be one of .*metal"),
    ('itu = "wood"', 'itu = "brick"', r"materials\.wood\.itu = 'brick' at 60 GHz: .*allowed there: .*wood"),
    ('itu = "wood", ', "", r"materials\.wood\.itu: give either itu or both"),
    ('itu = "wood"', 'itu = "wood", conductivity_s_m = 1.0', r"materials\.wood\.itu: give either itu or both"),
    ('itu = "wood"', "relative_permittivity = 0.2", r"materials\.wood\.relative_permittivity = 0\.2: must be"),
    ("z_m = 3.0", "z_m = -3.0", r"ceiling\.z_m = -3\.0: must lie above floor\.z_m = 0\.0"),
    ("z_max_m = 1.2", "z_max_m = -1.2", r"objects\[box\]\.z_max_m = -1\.2: must be greater than z_min_m"),
    ("thickness_m = 0.02, scat", "thickness_m = 10.0, scat", r"thickness_m = 10\.0: must be"),
    ("[tx]", "[tx", r"not valid TOML: .*line"),
    ("[tx]", "[tx]\nname = 'a'\n[tx]", r"the table \[tx\] is there again in line \d+: keep only one"),
    ("[tx]", "[[txs]]\nposition_m = [1.0, 1.0, 1.0]\n[tx]", r"tx: give either one \[tx\] or one or more"),
    ("[walk]", "[[txs]]\nposition_m = [1.0, 1.0, 1.0]\n[walk]", r"tx: give either one \[tx\]"),
    ("[tx]", "[[txs]]\nposition_m = [1.0, 7.0, 1.0]\n[[txs]]", r"txs: the name 'tx' is given twice"),
    ("height_m = 1.5", 'type = "circle"\nheight_m = 1.5', r"walk\.type = \"circle\": must be one of waypoints"),
    (
        "waypoints_m = [[4.0, 2.0], [8.5, 2.0]]",
        'type = "random"\nseed = 1\nclearance_m = 9.0',
        r"walk\.clearance_m = 9\.0: no place of the area",
    ),
    (
        "x_m = [7.0, 8.0], y_m = [5.0, 5.8]",
        "x_m = [4.9, 8.0], y_m = [5.0, 5.8]",
        r"objects 'pillar' and 'box' overlap in 0\.\d+ m\^2: move one of them",
    ),
    (
        'type = "circle", center_m = [5.0, 5.5], radius_m = 0.3',
        'type = "ellipse", center_m = [5.0, 5.5], semi_axes_m = [0.3, 0.0]',
        r"objects\[pillar\]\.contour\.semi_axes_m\[1\] = 0\.0: must be greater than 0",
    ),
    (
        'type = "circle", center_m = [5.0, 5.5], radius_m = 0.3',
        'type = "closed_spline", points_m = [[5, 5], [6, 6], [6, 5], [5, 6]]',
        r"objects\[pillar\]\.contour\.points_m: .* crosses itself",
    ),
    (
        'type = "circle", center_m = [5.0, 5.5], radius_m = 0.3',
        'type = "polygon", vertices_m = [[5, 5], [6, 6], [6, 5], [5, 6]]',
        r"objects\[pillar\]\.contour\.vertices_m = .*must not cross",
    ),
    (
        "x_m = [7.0, 8.0], y_m = [5.0, 5.8]",
        "x_m = [7000.0, 8000.0], y_m = [5000.0, 5800.0]",
        r"objects\[box\] reaches from \(7000, 5000\) to \(8000, 5800\): must lie in or near .*, all in metres",
    ),
    (
        'type = "circle", center_m = [5.0, 5.5]',
        'type = "circle", center_m = [5.0, nan]',
        r"objects\[pillar\]\.contour\.center_m\[1\] = NaN: must be a finite",
    ),
]


@pytest.mark.parametrize(("right", "wrong", "message"), MISTAKES, ids=[m[1] or m[0] for m in MISTAKES])
def test_each_mistake_names_file_field_and_value(load, tmp_path, right, wrong, message):
    assert right in ROOM
    with pytest.raises(ConfigError) as caught:
        load(ROOM.replace(right, wrong, 1))
    text = str(caught.value)
    assert "\n" not in text
    assert re.search(rf"^{re.escape(str(tmp_path / 'room.toml'))}: .*{message}", text), text


def test_polygon_needs_one_radius_per_vertex(load):
    contour = 'type = "polygon", vertices_m = [[7, 5], [8, 5], [8, 6]], corner_radius_m = [0.1]'
    text = ROOM.replace('type = "rectangle", x_m = [7.0, 8.0], y_m = [5.0, 5.8]', contour)
    with pytest.raises(ConfigError, match=r"objects\[box\]\.contour\.corner_radius_m has 1 entries: .* 3$"):
        load(text)
    rounded = load(text.replace("[0.1]", "[0.1, 0.1, 0]"))
    assert rounded.object("box").contour.area_m2() < 0.5


def test_missing_file_and_unknown_name(tmp_path):
    missing = tmp_path / "none.toml"
    with pytest.raises(ConfigError, match=f"^{re.escape(str(missing))}: cannot be read \\(No such file"):
        load_scene(missing)
    with pytest.raises(
        ConfigError, match=r"^scene = 'attic': must be one of box_room, box_room_heights, campus_arena, .*, or"
    ):
        load_scene("attic")
    binary = tmp_path / "binary.toml"
    binary.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(ConfigError, match="not valid TOML"):
        load_scene(binary)


def test_carrier_decides_which_materials_are_allowed():
    with pytest.raises(ConfigError, match=r"materials\.concrete\.itu = 'concrete' at 500 GHz"):
        load_scene("box_room", 500e9)


def test_contour_types_and_walks(load):
    ellipse = '{ type = "ellipse", center_m = [5.0, 5.5], semi_axes_m = [0.4, 0.2], rotation_deg = 90 }'
    text = ROOM.replace('{ type = "circle", center_m = [5.0, 5.5], radius_m = 0.3 }', ellipse)
    np.testing.assert_allclose(load(text).object("pillar").contour.bounds_m, (4.8, 5.1, 5.2, 5.9), atol=1e-5)
    spline = '{ type = "closed_spline", points_m = [[5, 5], [5.5, 5.5], [5, 6], [4.5, 5.5]] }'
    text = ROOM.replace('{ type = "circle", center_m = [5.0, 5.5], radius_m = 0.3 }', spline)
    assert load(text).object("pillar").contour.closed
    smooth = load(ROOM.replace("height_m = 1.5", 'type = "spline"\nheight_m = 1.5'))
    assert smooth.walk.is_smooth and len(smooth.stops) == 4
    old = "waypoints_m = [[4.0, 2.0], [8.5, 2.0]]"
    assert old in ROOM
    text = ROOM.replace(old, 'type = "random"\nseed = 4\nstart_m = [2.0, 2.0]\narea_m = [0, 0, 10, 4]')
    first, second = load(text), load(text)
    assert first.walk.waypoints_m.tobytes() == second.walk.waypoints_m.tobytes()
    assert first.walk.waypoints_m[:, 1].max() <= 3.7
    other = load(text.replace("seed = 4", "seed = 5"))
    assert other.walk.waypoints_m.tobytes() != first.walk.waypoints_m.tobytes()


def test_several_txs_and_walks_by_name():
    scene = load_scene("pillar_hall")
    assert list(scene.txs) == ["south_west", "north_east", "north_west", "south_east"]
    assert list(scene.walks) == ["aisle", "visitor", "stations"]
    assert scene.tx_name == "south_west" and scene.choose(tx=1).tx_name == "north_east"


@pytest.mark.parametrize("name", library_scenes())
def test_library_scenes_load_with_plausible_materials(name):
    scene = load_scene(name)
    assert scene.name == name and len(scene.stops) >= 4 and scene.floor and scene.ceiling
    for material in scene.materials.values():
        assert 1 <= material.relative_permittivity <= 15 and 5e-4 <= material.thickness_m <= 0.3
    high = max(item.z_max_m for item in scene.objects)
    assert high <= scene.ceiling.z_m


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("[8.5, 2.0]", "[14.5, 2.0]", ["walk 'walk'", "bounds_m"]),
        ("bounds_m = [0.0, 0.0, 10.0, 8.0]", "bounds_m = [10.0, 0.0, 0.0, 8.0]", ["bounds_m", "min below max"]),
        ("[4.0, 2.0]", "[1.5, 4.0]", ["stop 0", "from the TX"]),
        ('name = "box_room"', 'name = "../room"', ["name", "letters, digits"]),
    ],
)
def test_places_that_cannot_be_are_refused(tmp_path, old, new, words):
    text = (LIBRARY / "box_room.toml").read_text()
    assert old in text
    path = tmp_path / "room.toml"
    path.write_text(text.replace(old, new, 1))
    with pytest.raises(ConfigError) as caught:
        load_scene(path)
    assert all(word in str(caught.value) for word in words), caught.value


def test_a_scene_adds_to_one_of_the_library() -> None:
    busy, empty = load_scene("campus_arena_busy"), load_scene("campus_arena")
    assert [item.name for item in busy.fixtures] == empty.object_names
    assert len(busy.objects) == len(empty.objects) + 8
    assert (
        busy.walk.speed_m_s == 1.0
        and len(busy.stops) == 12
        and np.array_equal(busy.tx.position_m, empty.tx.position_m)
    )


def test_a_base_is_one_of_the_library(tmp_path):
    file = tmp_path / "scene.toml"
    file.write_text('name = "mine"\nbase = "other"\n')
    with pytest.raises(ConfigError, match="base = 'other': must be one of box_room, "):
        load_scene(file)
