"""The measured pillars, where their file exists."""

import numpy as np
import pytest

from isac_arena.validation.measured_data import FILE, data_folder
from isac_arena.validation.shape.measured import (
    PILLARS_M,
    check_measured_pillars,
    measured_bundle,
    measured_pillar,
)

pytestmark = pytest.mark.skipif(
    not (data_folder() / FILE).is_file(), reason=f"{FILE} is not in ARENA_DATA: the data is its authors'"
)


def test_measured_pillars_meet_their_bars() -> None:
    rows = check_measured_pillars(1, quick=False)
    assert [row.key for row in rows if not row.met] == []


def test_pillars_lie_within_their_stated_errors() -> None:
    solved = measured_bundle(two_sessions=True)
    for shape, center in zip(solved.shapes, PILLARS_M.values(), strict=True):
        error = shape.parameter[:2] - center
        assert error @ np.linalg.solve(shape.parameter_covariance[:2, :2], error) < 13.8  # 0.999 of chi2(2)


def test_labelled_paths_have_two_sessions() -> None:
    data = measured_pillar("a")
    assert set(data.session) == {0, 1}
    assert np.all(np.diff(data.stop) >= 0)
