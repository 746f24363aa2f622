from isac_arena.setting_differences import first_difference, line_difference, setting_differences


def test_fields_go_by_their_path_and_tables_by_their_name() -> None:
    first = {
        "seed": 1,
        "link": {"power": 3.0, "loss": None},
        "objects": [{"name": "a", "radius": 1.0}, {"name": "b", "radius": 2.0}],
        "beams": [1, 2],
        "steps": [{"at": 1}, {"at": 2}],
    }
    second = {
        "seed": 1,
        "link": {"power": 4.0},
        "objects": [{"name": "b", "radius": 2.5}, {"name": "a", "radius": 1.0}, {"name": "c", "radius": 9.0}],
        "beams": [1, 3],
        "steps": [{"at": 1}, {"at": 5}],
        "more": {"only": True},
    }
    found = {one.field: (one.first, one.second) for one in setting_differences(first, second)}
    assert found == {
        "link.power": (3.0, 4.0),
        "objects.b.radius": (2.0, 2.5),
        "objects.c.name": (None, "c"),
        "objects.c.radius": (None, 9.0),
        "beams": ([1, 2], [1, 3]),
        "steps.1.at": (2, 5),
        "more.only": (None, True),
    }
    assert setting_differences(first, first) == []
    assert [one.field for one in setting_differences({"axes": [1]}, {"axes": [1, 2]})] == ["axes"]


def test_the_first_field_is_told_with_both_values() -> None:
    assert (
        first_difference({"a": 1, "b": {"c": 2.0}}, {"a": 1, "b": {"c": "x"}, "d": 1})
        == 'b.c = 2.0 there, "x" here'
    )
    assert first_difference({"a": 1}, {"a": 1}) is None


def test_the_first_line_that_differs_is_named() -> None:
    assert line_difference("a\nb\n", "a\n c\n") == ", line 2: 'b' there, 'c' here"
    assert line_difference("a", "a\nb") == ", line 2: 'no line' there, 'b' here"
    assert line_difference("a", "a\n") == " differs"
