"""Inputs that are too large, of another kind, or damaged: one line with the name, soon, and without the memory."""

import os
import pickle
import time
import zipfile
import zlib
from pathlib import Path

import numpy as np
import pytest

from isac_arena.exchange.mat import read_measurement
from isac_arena.sweep.cases import design_points
from isac_arena.sweep.config import AxisConfig, SweepConfig
from isac_arena.sweep.plan import make_plan
from scenes.config import LIBRARY, load_scene
from scenes.inputs import InputError, check_matlab, read_input
from scenes.memory import MemoryLimitError, ask_memory, limited_memory
from scenes.meshes.floorplan import merge_segments, parse_geojson, parse_segments
from scenes.meshes.mesh import read_mesh
from scenes.toml_config import ConfigError, parse_toml, read_text, read_toml
from scenes.walks.tum import parse_tum
from sim.config import ArrayConfig, SimulationConfig
from sim.signal.link import line_of_sight_at_1m_dbm, make_link
from tests.command_line import failure
from tests.isac_arena.cli.sweep_files import CAMPAIGN, write_sweep

BUSY_S = 10.0  # of processor time: a cubic or quadratic step takes minutes on these inputs


def test_memory_is_refused_with_the_number_the_limit_and_the_field() -> None:
    with limited_memory("500MB"):
        ask_memory(4e8, "the table", "count")
        with pytest.raises(MemoryLimitError, match=r"^count: the table would take 2 GB, the limit is 500 MB"):
            ask_memory(2e9, "the table", "count")
    for text in ("", "4 apples", "-1GB", "inf", "nanGB"):
        with pytest.raises(ValueError, match="--memory"), limited_memory(text):
            pass
    with limited_memory("0.5GiB"):
        ask_memory(2**29, "the table", "count")


def test_cases_are_counted_before_they_are_made(tmp_path: Path) -> None:
    axes = [AxisConfig(field=name, low=0.0, high=1.0, count=10_000) for name in "abc"]
    config = SweepConfig(name="wide", base="base.toml", axes=axes)
    with pytest.raises(MemoryLimitError, match=r"axes.a.count and axes.b.count .* 1000000000000 points"):
        make_plan("sweep.toml", config, tmp_path, range(1))
    small = SweepConfig(name="small", base="b.toml", axes=[axis.model_copy(update={"count": 3}) for axis in axes])
    assert len(design_points(small)) == 27


def test_a_plan_that_would_take_minutes_is_refused_with_its_fields(tmp_path: Path) -> None:
    drawn = [AxisConfig(field="a", low=0.0, high=1.0)]
    for config, message in (
        (SweepConfig(name="long", base="b.toml", repeats=99_999, axes=[AxisConfig(field="a", values=[1, 2])]),
         r"^axes.a.values and repeats: a plan of 2 points x 99999 repeats: a sweep has at most"),
        (SweepConfig(name="wide", base="b.toml", design="random", n_points=20_001, axes=drawn),
         r"^n_points: a plan of 20001 points x 1 repeats: a sweep has at most 20000 points"),
    ):  # fmt: skip
        with pytest.raises(ConfigError, match=message):
            make_plan("sweep.toml", config, tmp_path, range(config.repeats))


def test_large_arrays_are_refused_before_their_weights_are_made() -> None:
    array = ArrayConfig(rows=256, columns=256, panel_azimuth_deg=[float(each) for each in range(64)])
    config = SimulationConfig(scene="box_room", tx_array=array, rx_array=array)
    with limited_memory("4GB"):
        for make in (make_link, line_of_sight_at_1m_dbm):
            with pytest.raises(MemoryLimitError, match=r"^tx_array.rows, columns, beams_.* 65536 elements"):
                make(config)
    with limited_memory("1GB"):
        make_link(SimulationConfig(scene="box_room"))


def test_the_limit_of_the_command_line_holds(tmp_path: Path) -> None:
    (tmp_path / "c.toml").write_text(CAMPAIGN)
    refused = failure("run", "c.toml", "--out", "out", "--memory", "1MB", cwd=tmp_path)
    assert "the limit is 1 MB (--memory)" in refused and not (tmp_path / "out").exists()


def test_a_floor_plan_of_many_segments_needs_no_table_of_pairs() -> None:
    rng, started = np.random.default_rng(1), time.process_time()
    start = rng.uniform(0, 1000, (20_000, 2))
    walls = merge_segments(np.stack([start, start + rng.normal(0, 1, start.shape)], axis=1))
    assert len(walls) > 19_000
    assert time.process_time() - started < BUSY_S
    with pytest.raises(ValueError, match="too many lie on each other"):
        merge_segments(np.repeat([[[0.0, 0.0], [1.0, 0.0]]], 20_000, axis=0))


def test_what_unpacks_to_more_than_the_memory_is_refused(tmp_path: Path) -> None:
    with zipfile.ZipFile(tmp_path / "bomb.zip", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("bomb.obj", b" " * 300_000_000)
    packed = zlib.compress(bytes(300_000_000))
    head = b"MATLAB 5.0".ljust(124) + b"\x00\x01IM"
    bomb = head + (15).to_bytes(4, "little") + len(packed).to_bytes(4, "little") + packed
    (tmp_path / "bomb.mat").write_bytes(bomb)
    with limited_memory("200MB"):
        with pytest.raises(MemoryLimitError, match=r"bomb.zip: its content when unpacked would take 900 MB"):
            read_mesh(tmp_path / "bomb.zip")
        with pytest.raises(MemoryLimitError, match=r"bomb\.mat: its content when unpacked"):
            check_matlab(tmp_path / "bomb.mat")


def test_only_regular_files_are_read(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.toml")
    (tmp_path / "folder.toml").mkdir()
    for name in ("/dev/zero", tmp_path / "pipe.toml", tmp_path / "folder.toml"):
        for read in (read_toml, read_text):
            with pytest.raises(ConfigError, match="no regular file"):
                read(name)
    with pytest.raises(ConfigError, match="holds no NUL"):
        read_toml("a\0.toml")
    (tmp_path / "long.csv").write_bytes(bytes(2000))
    with pytest.raises(InputError, match="has 2000 bytes, at most 1000"):
        read_input(tmp_path / "long.csv", 1000)


@pytest.mark.parametrize(
    ("parse", "text", "message"),
    [
        (parse_geojson, '{"type": "GeometryCollection", "geometries": [' * 4000 + "]}" * 4000, "nested too deep"),
        (parse_toml, f"{'a.' * 20_000}a = 1", "more than 32 parts"),
        (parse_toml, f"[{'a .' * 20_000}a]", "more than 32 parts"),
        (parse_toml, '"x".' * 20_000 + "a = 1", "more than 32 parts"),
        (parse_toml, f"a = {'[' * 100_000}", "nested too deep"),
        (parse_tum, "0 1 2 3 0 0 0 1\n" * 300_000, "300000 poses: at most 100000"),
        (parse_tum, "0 1 2 3 0 0 0 1\n" * 99_999 + "0 1 2 3 0 0 0\n", "line 100000: must be eight"),
        (parse_segments, f"x0_m,y0_m,x1_m,y1_m\n0,0,1,{'9' * 200_000}\n", "line 2: no CSV"),
        (parse_segments, f"x0_m,y0_m,x1_m,y1_m\n0,0,1,{'9' * 100_000}\n", r"y1_m = '9{40}\.\.\.'"),
    ],
    ids=["geojson", "keys", "table", "quoted", "arrays", "poses", "pose", "digits", "number"],
)
def test_parsers_are_linear(parse: object, text: str, message: str) -> None:
    started = time.process_time()
    with pytest.raises(ValueError, match=message):
        parse(text)  # type: ignore[operator]
    assert time.process_time() - started < BUSY_S


def test_strings_with_many_dots_are_no_keys() -> None:
    text = f'a = "{"x." * 100}"\nb = """\n{"y." * 100} "quoted" """\n# {"z." * 100}\nc = [{"1.5, " * 100}]\n'
    assert set(parse_toml(text)) == {"a", "b", "c"}


@pytest.mark.parametrize(
    ("old", "new", "field"),
    [
        ("waypoints_m = [[4.0, 2.0]", "waypoints_m = [[1e308, 2.0]", "walk.waypoints_m = 1e+308: must be within"),
        ("height_m = 1.5", "height_m = 1e300", "walk.height_m = 1e+300"),
    ],
)
def test_numbers_that_overflow_name_their_field(tmp_path: Path, old: str, new: str, field: str) -> None:
    text = (LIBRARY / "box_room.toml").read_text()
    assert old in text
    (tmp_path / "s.toml").write_text(text.replace(old, new, 1))
    with pytest.raises(ConfigError) as caught:
        load_scene(tmp_path / "s.toml")
    assert field in str(caught.value)


def test_damaged_files_name_themselves(tmp_path: Path) -> None:
    (tmp_path / "p.mat").write_bytes(pickle.dumps({"sim": [1, 2]}))
    with pytest.raises(ValueError, match=r"p.mat: no MATLAB 5 file"):
        read_measurement(tmp_path / "p.mat")
    (tmp_path / "b.stl").write_bytes(bytes(80) + (99).to_bytes(4, "little") + bytes(range(256)))
    with pytest.raises(ValueError, match=r"b.stl': cannot be read as a mesh") as caught:
        read_mesh(tmp_path / "b.stl")
    assert "normalizer" not in str(caught.value)
    for kind in (".3mf", ".dae"):
        (tmp_path / f"m{kind}").write_bytes(b"x")
        with pytest.raises(ValueError, match=r"isac-arena\[meshes\]|cannot be read as a mesh"):
            read_mesh(tmp_path / f"m{kind}")
    (tmp_path / "m.dwg").touch()
    with pytest.raises(ValueError, match=r"must be one of \.obj, \.stl"):
        read_mesh(tmp_path / "m.dwg")


def test_a_damaged_scene_is_not_blamed_on_the_settings(tmp_path: Path) -> None:
    write_sweep(tmp_path)
    run = tmp_path / "run"
    run.mkdir()
    (run / "campaign.json").write_text("{}")
    (run / "scene.toml").write_bytes(b"\xff\xfe")
    line = failure("score", run)
    assert "scene.toml" in line and "campaign.json" not in line
