"""Records check their shapes and freeze their arrays."""

from dataclasses import dataclass

import numpy as np
import pytest

from scenes.pose import Pose, azimuth_elevation, direction, wrap_angle
from scenes.record import FIELDS, FloatArray, Record, array, concatenate


@dataclass(frozen=True)
class Echo(Record):
    """What came back."""

    delay_s: FloatArray = array("path", unit="s", doc="time of arrival")
    place_m: FloatArray = array("path", "xyz", unit="m", doc="where")
    stop: int = array(dtype=int, doc="which stop")


def test_help_lists_the_fields() -> None:
    assert Echo.__doc__ is not None and Echo.__doc__.startswith("What came back.")
    assert FIELDS in Echo.__doc__ and "    place_m (path, xyz) [m]: where\n    stop: which stop" in Echo.__doc__


def test_arrays_are_converted_and_frozen_without_freezing_the_callers() -> None:
    mine = np.array([1.0, 2.0])
    echo = Echo(mine, np.zeros((2, 3)), np.int32(4))  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="read-only"):
        echo.delay_s[0] = 5
    mine[0] = 7
    assert type(echo.stop) is int


@pytest.mark.parametrize(
    ("delay", "place", "message"),
    [
        ([1.0], np.zeros((2, 3)), r"Echo.place_m: axis 'path' has length 2, expected 1"),
        ([1.0], np.zeros((1, 2)), r"Echo.place_m: axis 'xyz' has length 2, expected 3"),
        (1.0, np.zeros((1, 3)), r"Echo.delay_s: shape \(\) does not fit the axes \('path',\)"),
    ],
)
def test_wrong_shapes_name_the_field(delay: object, place: object, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Echo(delay, place, 0)  # type: ignore[arg-type]


def test_take_and_concatenate_are_inverse() -> None:
    rng = np.random.default_rng(0)
    echo = Echo(rng.random(5), rng.random((5, 3)), 1)
    back = concatenate([echo.take("path", [0, 1]), echo.take("path", slice(2, None))], "path")
    np.testing.assert_array_equal(back.place_m, echo.place_m)
    assert echo.take("path", []).size("path") == 0
    with pytest.raises(ValueError, match="no records given"):
        concatenate([], "path")


def test_directions_and_angles_are_inverse() -> None:
    rng = np.random.default_rng(1)
    azimuth, elevation = rng.uniform(-np.pi, np.pi, 50), rng.uniform(-1.5, 1.5, 50)
    back = azimuth_elevation(direction(azimuth, elevation))
    np.testing.assert_allclose(back, [azimuth, elevation], atol=1e-12)
    assert wrap_angle(np.pi) == -np.pi
    assert Pose([1, 2, 3], 0.5).position_m.dtype == float  # type: ignore[arg-type]


def test_an_axis_cannot_be_named_twice_in_a_field() -> None:
    with pytest.raises(ValueError, match="needs its own name"):
        array("path", "parameter", "parameter")
