"""Records survive the way to a file and back; unfinished files never look finished."""

from dataclasses import dataclass, fields, replace
from pathlib import Path
from tempfile import TemporaryDirectory

import h5py
import numpy as np
import pytest
import xarray as xr
from hypothesis import given, settings
from hypothesis import strategies as st

from isac_arena.campaign.files import complete_file, read_attribute, read_record, write_record
from isac_arena.exchange.frames import to_dataframe
from scenes.config import load_scene
from scenes.pose import Pose
from scenes.record import BoolArray, ComplexArray, FloatArray, IntArray, Record, TextArray, array
from sim.config import PropagationConfig, SimulationConfig
from sim.propagation.paths import empty_paths
from sim.signal.link import Link
from sim.simulate import simulate_truth
from sim.truth import Truth


@dataclass(frozen=True)
class Leaf(Record):
    place_m: FloatArray = array("stop", "xyz", unit="m", doc="places")
    stop: IntArray = array("stop", dtype=np.int64, doc="a coordinate, written after what lies along it")


@dataclass(frozen=True)
class Tree(Record):
    gain: ComplexArray = array("path", "beam", dtype=np.complex64, doc="gains")
    name: TextArray = array("path", dtype=np.str_, doc="names")
    is_seen: BoolArray = array("path", dtype=np.bool_, doc="flags")
    beam: IntArray = array("path", "beam", dtype=np.int64, doc="has the name of an axis, and lies along two")
    width_m: float = array(unit="m", doc="a scalar")
    leaf: Leaf


@settings(deadline=None, max_examples=30)
@given(st.integers(0, 3), st.integers(0, 3), st.integers(0, 3), st.integers(0, 2**32 - 1))
def test_every_reader_finds_the_same_bits(n_path: int, n_beam: int, n_stop: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    tree = Tree(
        gain=rng.standard_normal((n_path, n_beam)) + 1j * rng.standard_normal((n_path, n_beam)),
        name=np.array(["säule", "", "a\tb"])[rng.integers(0, 3, n_path)],
        is_seen=rng.random(n_path) < 0.5,
        beam=rng.integers(-(2**62), 2**62, (n_path, n_beam)),
        width_m=-0.0,
        leaf=Leaf(np.where(rng.random((n_stop, 3)) < 0.3, np.nan, 1.0), np.arange(n_stop)),
    )
    with TemporaryDirectory() as folder:
        file = Path(folder) / "tree.nc"
        write_record(file, tree, {"title": "x"})
        first = file.read_bytes()
        write_record(file, tree, {"title": "x"})
        assert file.read_bytes() == first
        back = read_record(file, Tree)
        with xr.open_datatree(file, engine="h5netcdf") as seen:
            seen.load()
    for mine, other in ((tree, back), (tree.leaf, back.leaf)):
        for spec in fields(mine):
            value = getattr(mine, spec.name)
            if not isinstance(value, Record):
                np.testing.assert_array_equal(getattr(other, spec.name), value)
                assert np.asarray(getattr(other, spec.name)).dtype.kind == np.asarray(value).dtype.kind
    assert np.signbit(back.width_m)
    assert seen["gain_re"].dims == ("path", "beam") and seen["leaf/place_m"].dims == ("stop", "xyz")
    np.testing.assert_array_equal(seen["gain_im"], tree.gain.imag)
    np.testing.assert_array_equal(seen["is_seen"], tree.is_seen)
    np.testing.assert_array_equal(seen["leaf/stop"], tree.leaf.stop)
    assert seen["name"].values.tolist() == tree.name.tolist() and seen.attrs["title"] == "x"


def test_a_changed_value_is_noticed(tmp_path: Path) -> None:
    file = tmp_path / "pose.nc"
    write_record(file, Pose(np.array([1.25, 2.5, 3.75]), 1.0), {"fingerprint": "abc"})
    for change in ("value", "attribute"):
        write_record(file, Pose(np.array([1.25, 2.5, 3.75]), 1.0), {"fingerprint": "abc"})
        if change == "value":  # bytes on the disk, not through the library
            content = file.read_bytes()
            assert content.count(np.float64(2.5).tobytes()) == 1
            file.write_bytes(content.replace(np.float64(2.5).tobytes(), np.float64(2.6).tobytes()))
        else:
            with h5py.File(file, "a") as opened:
                opened.attrs["fingerprint"] = "abd"
        with pytest.raises(ValueError, match=r"pose.nc: not a readable Pose file \(its content is not what was"):
            read_record(file, Pose)


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


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full here")
def test_a_full_disk_names_the_file(tmp_path: Path) -> None:
    full = pytest.raises(OSError, match=r"cannot be written .No space left on device.: '.*scores.json'")
    with full, complete_file(tmp_path / "scores.json") as partial:
        partial.symlink_to("/dev/full")
        partial.write_text("x" * 10_000)
    assert not list(tmp_path.iterdir())


def test_motion_is_kept_and_frozen_truths_have_no_place_for_it(tmp_path: Path) -> None:
    scene = load_scene("box_room")
    scene = replace(scene, walk=replace(scene.walk, speed_m_s=1.0))
    propagation = PropagationConfig(diffuse_samples=0, max_bounces=1)
    [truth] = simulate_truth(SimulationConfig(scene="-", propagation=propagation), scene, [0])
    write_record(tmp_path / "truth.nc", truth)
    back = read_record(tmp_path / "truth.nc", Truth)
    assert truth.motion is not None and back.motion is not None and back.paths.rates is not None
    assert np.array_equal(back.motion.states.delay_s, truth.motion.states.delay_s)
    assert np.array_equal(back.paths.rates.doppler_hz, truth.paths.rates.doppler_hz)
    assert {"delay_s", "doppler_hz"} <= set(to_dataframe(truth.paths).columns)
    frozen = replace(truth, motion=None, paths=replace(truth.paths, rates=None))
    write_record(tmp_path / "frozen.nc", frozen)
    assert read_record(tmp_path / "frozen.nc", Truth).motion is None
    with h5py.File(tmp_path / "frozen.nc") as file:
        assert "motion" not in file and "rates" not in file["paths"]
