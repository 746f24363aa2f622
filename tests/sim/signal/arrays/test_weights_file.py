"""Beam weights from files."""

from pathlib import Path

import numpy as np
import pytest

from sim.config import ArrayConfig
from sim.signal.arrays.weights_file import read_weights
from sim.signal.link import make_codebook

WEIGHTS = np.array([[1, 1j, -1, 0.5 - 0.25j], [1, 1, 1, 1]])


def test_both_file_types_hold_the_same(tmp_path: Path) -> None:
    np.savez(tmp_path / "w.npz", weights=WEIGHTS)
    (tmp_path / "w.csv").write_text("1, 1j, -1, 0.5-0.25j\n\n1,1,1,1\n")
    np.testing.assert_array_equal(read_weights(tmp_path / "w.npz"), WEIGHTS)
    np.testing.assert_array_equal(read_weights(tmp_path / "w.csv"), WEIGHTS)


def test_an_array_takes_its_beams_from_a_file(tmp_path: Path) -> None:
    np.savez(tmp_path / "w.npz", weights=WEIGHTS)
    config = ArrayConfig(
        rows=1, columns=4, codebook="file", weights_file=str(tmp_path / "w.npz"), panel_azimuth_deg=[0.0, 90.0]
    )
    codebook = make_codebook(config, 60e9)
    norm = np.linalg.norm(WEIGHTS, axis=1, keepdims=True)
    np.testing.assert_allclose(codebook.weights, np.tile(WEIGHTS / norm, (2, 1)))
    np.testing.assert_allclose(codebook.azimuth_rad[[1, 3]], [0, np.pi / 2], atol=1e-12)
    with pytest.raises(ValueError, match="4 per beam, the array has 64 elements"):
        make_codebook(ArrayConfig(codebook="file", weights_file=str(tmp_path / "w.npz")), 60e9)


def test_bad_files_are_named(tmp_path: Path) -> None:
    (tmp_path / "text.csv").write_text("1, one\n")
    (tmp_path / "ragged.csv").write_text("1,2\n1\n")
    (tmp_path / "empty.csv").write_text("")
    (tmp_path / "bad.npz").write_bytes(b"PK nothing")
    np.savez(tmp_path / "other.npz", beams=WEIGHTS)
    for name in ("text.csv", "ragged.csv", "bad.npz", "other.npz"):
        with pytest.raises(ValueError, match=rf"weights_file = .*{name}: not readable"):
            read_weights(tmp_path / name)
    with pytest.raises(ValueError, match=r"empty.csv: shape \(0,\)"):
        read_weights(tmp_path / "empty.csv")
    with pytest.raises(ValueError, match=r"must end in \.npz or \.csv"):
        read_weights(tmp_path / "w.mat")
    with pytest.raises(FileNotFoundError, match=r"none\.npz: no such file"):
        read_weights(tmp_path / "none.npz")
