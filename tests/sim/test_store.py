"""Records survive the way to a file and back; unfinished files never look finished."""

from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from scenes.pose import Pose
from sim.link import Link
from sim.paths import empty_paths
from sim.store import complete_file, read_attribute, read_record, write_record
from sim.truth import Truth


def test_nested_records_come_back_bit_by_bit(tmp_path: Path, full_link: Link) -> None:
    write_record(tmp_path / "link.nc", full_link, {"fingerprint": "abc"})
    back = read_record(tmp_path / "link.nc", Link)
    np.testing.assert_array_equal(back.rx_codebook.weights, full_link.rx_codebook.weights)
    np.testing.assert_array_equal(back.prs_symbol, full_link.prs_symbol)
    assert back.prs_symbol.dtype == full_link.prs_symbol.dtype
    assert back.tx_codebook.element_pattern == "tr38901"
    assert read_attribute(tmp_path / "link.nc", "fingerprint") == "abc"


def test_empty_axes_and_names_are_kept(tmp_path: Path) -> None:
    truth = Truth(empty_paths(["north wall", "säule"], 2), Pose(np.zeros(3), 1.0), 7, 1e-9)
    write_record(tmp_path / "truth.nc", truth)
    back = read_record(tmp_path / "truth.nc", Truth)
    assert len(back.paths) == 0 and back.stop == 7
    assert back.paths.object_name.tolist() == ["north wall", "säule"]


def test_files_name_axes_and_units(tmp_path: Path) -> None:
    truth = Truth(empty_paths(["wall"], 2), Pose(np.zeros(3), 1.0), 7, 1e-9)
    write_record(tmp_path / "truth.nc", truth)
    paths = xr.open_dataset(tmp_path / "truth.nc", group="paths", engine="h5netcdf")
    assert paths["vertex_m"].dims == ("path", "bounce", "xyz")
    assert paths["delay_s"].attrs["units"] == "s"
    assert "propagation delay" in paths["delay_s"].attrs["long_name"]


def test_damaged_and_missing_files_are_named(tmp_path: Path) -> None:
    (tmp_path / "bad.nc").write_bytes(b"not a file")
    with pytest.raises(ValueError, match=r"bad.nc: not a readable Truth file"):
        read_record(tmp_path / "bad.nc", Truth)
    with pytest.raises(FileNotFoundError, match=r"none.nc: no such file"):
        read_record(tmp_path / "none.nc", Truth)
    assert read_attribute(tmp_path / "bad.nc", "fingerprint") is None


def test_another_record_in_the_file_is_refused(tmp_path: Path) -> None:
    write_record(tmp_path / "pose.nc", Pose(np.zeros(3), 1.0))
    with pytest.raises(ValueError, match=r"pose.nc: not a readable Truth file"):
        read_record(tmp_path / "pose.nc", Truth)


def test_an_error_while_writing_leaves_the_old_file(tmp_path: Path) -> None:
    target = tmp_path / "scores.json"
    target.write_text("old")
    with pytest.raises(RuntimeError), complete_file(target) as partial:
        partial.write_text("half")
        raise RuntimeError
    assert [file.name for file in tmp_path.iterdir()] == ["scores.json"]
    assert target.read_text() == "old"
