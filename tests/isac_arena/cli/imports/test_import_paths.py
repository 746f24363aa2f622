"""Tables of paths in four formats become the campaign that the public measurement file becomes."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pandas as pd
import pytest
from scipy.io import netcdf_file, savemat

from isac_arena.campaign import stages
from isac_arena.exchange.mat import read_layout
from isac_arena.exchange.path_table import COLUMNS, _known_names, measured_file, read_table
from isac_arena.exchange.table import table_of
from scenes.pose import SPEED_OF_LIGHT_M_S, Pose
from tests.command_line import ROOT, arena_here, failure
from tests.isac_arena.cli.imports.test_import_mat import made_up_file

SCENE_TX = Pose(np.array([1.0, 2.0, 1.8]), 0.5)
HALL_LEVEL = ("--los-power-dbm", "-13", "--los-slope-db", "-17")  # that import-mat takes
LABELS = np.array(["none", "los", "single_bounce"])


def layout_table(file: Path) -> pd.DataFrame:
    """The table of a public measurement file."""
    found = read_layout(file, Pose(np.zeros(3), 0.0))
    rows: list[dict[str, Any]] = []
    for number, stop in enumerate(found.stops):
        for path, (range_m, aod, aoa) in enumerate(stop.measured):
            rows.append(
                {
                    "stop": number, "range_m": range_m, "aod_azimuth_rad": aod, "aoa_azimuth_rad": aoa,
                    "power_dbm": stop.power_dbm[path], "rx_x_m": stop.rx[0], "rx_y_m": stop.rx[1],
                    "rx_heading_rad": stop.rx[2], "tx_x_m": found.tx.position_m[0],
                    "tx_y_m": found.tx.position_m[1], "tx_heading_rad": found.tx.heading_rad,
                    "label": LABELS[stop.is_los[path] + 2 * stop.is_single_bounce[path]],
                    "ip_x_m": stop.landmark_m[path, 0], "ip_y_m": stop.landmark_m[path, 1],
                }
            )  # fmt: skip
    return pd.DataFrame(rows)


def write_hdf5(frame: pd.DataFrame, file: Path) -> None:
    with h5py.File(file, "w") as stored:
        for name in frame.columns:
            value = frame[name].to_numpy()
            stored[name] = value.astype("S") if value.dtype == object else value


def write_classic(frame: pd.DataFrame, file: Path) -> None:
    with netcdf_file(file, "w") as stored:
        stored.createDimension("path", len(frame))
        for name in frame.columns:
            value = frame[name].to_numpy()
            value = np.searchsorted(np.sort(LABELS), value) if value.dtype == object else value
            value = np.array([1, 0, 2])[value] if name == "label" else value  # los, none, single_bounce
            stored.createVariable(name, "i4" if value.dtype.kind == "i" else "f8", ("path",))[:] = value


WRITERS: dict[str, Any] = {
    "csv": lambda frame, file: frame.to_csv(file, index=False),
    "parquet": lambda frame, file: frame.to_parquet(file),
    "mat": lambda frame, file: savemat(file, {name: frame[name].to_numpy() for name in frame.columns}),
    "h5": write_hdf5,
    "nc": write_classic,
}


@pytest.fixture(scope="module")
def table(tmp_path_factory: pytest.TempPathFactory) -> pd.DataFrame:
    return layout_table(made_up_file(tmp_path_factory.mktemp("layout")))


@pytest.mark.parametrize("kind", WRITERS)
def test_every_format_gives_the_records_of_the_public_file(kind: str, table: pd.DataFrame, tmp_path: Path) -> None:
    (tmp_path / "public").mkdir()
    public = made_up_file(tmp_path / "public")
    WRITERS[kind](table, tmp_path / f"walk.{kind}")
    options = ("--tx-offset-deg", "0", "--clock-seed", "2", "--scene", "campus_arena")
    assert arena_here("import-mat", public, "--out", tmp_path / "a", *options, cwd=tmp_path).returncode == 0
    done = arena_here("import-paths", f"walk.{kind}", "--out", "b", *options, *HALL_LEVEL, cwd=tmp_path)
    assert done.returncode == 0 and "12 stops imported" in done.stdout, done.stderr
    one, other = (stages.reopen(tmp_path / name) for name in "ab")
    assert one.config.model_dump(exclude={"name"}) == other.config.model_dump(exclude={"name"})
    for stop in range(12):
        for get in ("channel", "measured_truth"):
            a, b = (getattr(store, get)(stop) for store in (one, other))
            a, b = (a.channel, b.channel) if get == "channel" else (a, b)
            for name in vars(a):
                x, y = getattr(a, name), getattr(b, name)
                if isinstance(x, Pose):
                    assert x.position_m.tolist() == y.position_m.tolist() and x.heading_rad == y.heading_rad
                else:
                    np.testing.assert_array_equal(x, y, err_msg=name)


@pytest.mark.whole
def test_the_map_has_the_same_bits_as_that_of_the_public_file(table: pd.DataFrame, tmp_path: Path) -> None:
    table.to_csv(tmp_path / "table.csv", index=False)
    made_up_file(tmp_path)
    maps = []
    for verb, file, out in (("import-mat", "walk.mat", "a"), ("import-paths", "table.csv", "b")):
        options = ("--tx-offset-deg", "0", "--scene", "campus_arena", "--out", out)
        level = HALL_LEVEL if verb == "import-paths" else ()
        assert arena_here(verb, file, *options, *level, cwd=tmp_path).returncode == 0
        for step in ("estimate", "score", "report") if verb == "import-paths" else ("estimate",):
            done = arena_here(step, out, cwd=tmp_path)
            assert done.returncode == 0, done.stderr
        store = stages.reopen(tmp_path / out)
        maps.append([store.map_result(name) for name in ("mapping", "slam")])
    for one, other in zip(*maps, strict=True):
        for part in ("poses", "ips", "shapes", "contours"):
            for name, value in vars(getattr(one, part)).items():
                np.testing.assert_array_equal(value, getattr(getattr(other, part), name), err_msg=f"{part}.{name}")
    scores = {row["key"]: row["value"] for row in json.loads((tmp_path / "b" / "scores.json").read_text())}
    assert scores["mapping.ip_position.rms_m"] < 1e-6 and (tmp_path / "b" / "report.html").is_file()


def few(**changes: Any) -> dict[str, Any]:
    """Four paths at two stops, numbered 7 and 3, with headings of their own."""
    columns: dict[str, Any] = {
        "stop": [7, 3, 7, 3], "delay_ns": [30.0, 40.0, 20.0, 50.0], "aod_azimuth_deg": [10.0, 20.0, 30.0, 40.0],
        "aoa_azimuth_deg": [-10.0, -20.0, -30.0, -40.0], "power_dbm": [-50.0, -60.0, -40.0, -70.0],
        "rx_x_m": [1.0, 2.0, 1.0, 2.0], "rx_y_m": [0.0, 0.5, 0.0, 0.5], "rx_heading_deg": [0.0, 90.0, 0.0, 90.0],
    }  # fmt: skip
    return {name: value for name, value in {**columns, **changes}.items() if value is not None}


def read(folder: Path, **changes: Any) -> Any:
    file = folder / "few.csv"
    pd.DataFrame(few(**changes)).to_csv(file, index=False)
    return measured_file(read_table(file), SCENE_TX)


def test_units_order_and_defaults(tmp_path: Path) -> None:
    found = read(tmp_path)
    assert found.tx.position_m.tolist() == [1.0, 2.0, 1.8] and found.tx.heading_rad == 0.5 and found.bias_m is None
    first, second = found.stops  # 3, then 7
    assert first.rx.tolist() == [2.0, 0.5, pytest.approx(np.pi / 2)] and second.rx.tolist() == [1.0, 0.0, 0.0]
    assert first.height_m == 1.8 and first.covariance is None and first.elevation_rad is None
    np.testing.assert_allclose(first.measured[:, 0], SPEED_OF_LIGHT_M_S * np.array([40e-9, 50e-9]))
    np.testing.assert_allclose(second.measured[:, 1:], np.deg2rad([[10.0, -10.0], [30.0, -30.0]]))
    assert not first.is_los.any() and not first.is_single_bounce.any()


def test_optional_columns(tmp_path: Path) -> None:
    elevations = {"aod_elevation_deg": [1.0, 2.0, 3.0, 4.0], "aoa_elevation_deg": [-1.0, -2.0, -3.0, -4.0]}
    names = ("aod_azimuth", "aoa_azimuth", "aod_elevation", "aoa_elevation")
    std = {f"{name}_std_deg": [0.5] * 4 for name in names} | {"delay_std_ns": [0.2, 0.3, 0.4, 0.5]}
    found = read(
        tmp_path, **elevations, **std, correlation_aod_azimuth_aoa_azimuth=[0.5] * 4, clock_bias_ns=[5.0, 6.0] * 2,
        rx_z_m=[1.2, 1.3] * 2, label=["los", "", "single_bounce", None], is_los=[1, 0, 0, 0],
        ip_x_m=[np.nan, np.nan, 3.0, np.nan], ip_y_m=[np.nan, np.nan, 4.0, np.nan],
        tx_x_m=[9.0] * 4, tx_y_m=[8.0] * 4, tx_heading_deg=[-90.0] * 4,
    )  # fmt: skip
    assert found.tx.position_m.tolist() == [9.0, 8.0, 1.8] and found.tx.heading_rad == pytest.approx(-np.pi / 2)
    np.testing.assert_allclose(found.bias_m, SPEED_OF_LIGHT_M_S * np.array([6e-9, 5e-9]))
    second = found.stops[1]
    np.testing.assert_allclose(second.measured[:, 0], SPEED_OF_LIGHT_M_S * np.array([25e-9, 15e-9]))
    assert second.height_m == 1.2 and second.is_los.tolist() == [True, False]
    assert second.landmark_m[1].tolist() == [3.0, 4.0] and np.isnan(second.landmark_m[0]).all()
    assert second.is_los_estimate.tolist() == [True, False]
    deviations = np.sqrt(np.diagonal(second.covariance, axis1=1, axis2=2))
    np.testing.assert_allclose(deviations[:, 0], [0.2e-9, 0.4e-9])
    np.testing.assert_allclose(deviations[:, 1:], np.deg2rad(0.5))
    np.testing.assert_allclose(second.covariance[:, 1, 2], 0.5 * np.deg2rad(0.5) ** 2)
    np.testing.assert_allclose(second.elevation_rad, np.deg2rad([[1.0, -1.0], [3.0, -3.0]]))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"power_dbm": None}, "few.csv: the column power_dbm is missing; there are stop, delay_ns"),
        (
            {"delay_ns": None, "delays_ns": [1.0] * 4},
            "the column delay_s or delay_ns or range_m is missing; did you",
        ),
        ({"range_m": [1.0] * 4}, "delay_ns, range_m: two columns for the same; leave one out"),
        ({"power_dbm": [1.0, np.nan, 1.0, 1.0]}, "row 2: power_dbm = nan: must be finite"),
        ({"power_dbm": [1e9, 1.0, 1.0, 1.0]}, r"row 1: power_dbm = 1e\+09: must be within 300 dBm"),
        ({"power_dbm": ["a", "b", "1", "2"]}, "row 1: power_dbm = a: must be a number"),
        ({"stop": [1.5, 1, 2, 2]}, "row 1: stop = 1.5: must be a whole number"),
        ({"rx_x_m": [1.0, 2.0, 1.1, 2.0]}, "row 3: rx_x_m = 1.1: differs from row 1 of the same stop"),
        ({"rx_x_m": [1e9, 2.0, 1e9, 2.0]}, r"row 1: rx_x_m = 1e\+09: must be within 1e\+06 m"),
        ({"tx_x_m": [1.0] * 4}, "tx_y_m is missing: give tx_x_m, tx_y_m and tx_heading, or none of them"),
        ({"aod_elevation_deg": [1.0] * 4}, "aod_elevation, aoa_elevation: give both, or none of them"),
        ({"delay_std_ns": [1.0] * 4}, "give the standard deviations of all parameters, or of none: delay_std"),
        ({"label": ["wall"] * 4}, "row 1: label = wall: must be los, single_bounce or none; or 1, 2, 0"),
        ({"is_los": [2, 0, 0, 0]}, r"row 1: is_los = 2.0: must be 0 or 1"),
        ({"is_los": [1, 1, 1, 0]}, "row 3: is_los = 1: the line of sight of this stop is in row 1; there is one"),
        ({"label": ["los"] * 4}, "row 3: label = los: the line of sight of this stop is in row 1; there is one"),
        (
            {"aod_azimuth_deg": None, "aod_azimuth_rad": [1.0, 40.0, 2.0, 3.0]},
            r"row 2: aod_azimuth_rad = 40.0: must be within -6\.283 and 6\.283 rad; it looks like degrees",
        ),
        (
            {"aoa_azimuth_deg": [1e9, 1.0, 2.0, 3.0]},
            "row 1: aoa_azimuth_deg = 1000000000.0: must be within -360 and",
        ),
        (
            {"rx_heading_deg": None, "rx_heading_rad": [0.0, 90.0, 0.0, 90.0]},
            "row 2: rx_heading_rad = 90.0: must be within -6.283 and 6.283 rad; it looks like degrees",
        ),
        (
            {"aod_elevation_deg": [1.0] * 4, "aoa_elevation_deg": [100.0] * 4},
            "row 1: aoa_elevation_deg = 100.0: must be within -90 and 90 deg",
        ),
        (
            {"label": ["single_bounce"] * 4, "ip_x_m": [1.0] * 4, "ip_y_m": [1.0, np.nan, 1.0, 1.0]},
            "row 2: ip_y_m = nan: give both, ip_x_m and ip_y_m, or none of them",
        ),
        (
            {"label": ["single_bounce"] * 4, "ip_x_m": [1e30] * 4, "ip_y_m": [1.0] * 4},
            r"row 1: ip_x_m = 1e\+30: must be within 1e\+06 m",
        ),
    ],
)
def test_wrong_tables_name_row_column_and_value(tmp_path: Path, changes: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message) as told:
        read(tmp_path, **changes)
    assert "\n" not in str(told.value) and str(told.value).startswith(f"{tmp_path}")


def test_impossible_covariances_are_refused(tmp_path: Path) -> None:
    std = {f"{name}_std_deg": [0.5] * 4 for name in ("aod_azimuth", "aoa_azimuth")} | {"delay_std_ns": [1.0] * 4}
    with pytest.raises(ValueError, match=r"row 1: delay_std = -0\.299792 m: must be within 1e-06 and 1e\+06 m"):
        read(tmp_path, **{**std, "delay_std_ns": [-1.0] * 4})
    with pytest.raises(ValueError, match=r"row 1: delay_std = 1\.49896e\+08 m: must be within"):
        read(
            tmp_path,
            **{name: value for name, value in std.items() if name != "delay_std_ns"},
            delay_std_s=[0.5] * 4,
        )
    with pytest.raises(ValueError, match="row 1: correlation = they: must make a positive definite covariance"):
        read(tmp_path, **std, correlation_delay_aod_azimuth=[1.5] * 4)


def test_damaged_and_other_files_end_in_one_line_and_write_nothing(table: pd.DataFrame, tmp_path: Path) -> None:
    for kind, writer in WRITERS.items():
        file = tmp_path / f"table.{kind}"
        writer(table, file)
        content = file.read_bytes()
        for damaged in (b"", content[: len(content) // 2], b"\0" * 2000, b"\x89HDF\r\n\x1a\n" + b"x" * 3000):
            file.write_bytes(damaged)
            if damaged and kind == "csv" and damaged == content[: len(content) // 2]:
                continue  # half a text is a table of half the rows, or ends in a row that is told
            line = failure("import-paths", file.name, "--out", "out", "--scene", "campus_arena", cwd=tmp_path)
            assert file.name in line, line
            assert not (tmp_path / "out").exists()
    line = failure("import-paths", "table.txt", "--out", "out", "--scene", "campus_arena", cwd=tmp_path)
    assert "must end with .csv, .parquet, .mat, .nc, .h5" in line
    line = failure("import-paths", "none.csv", "--out", "out", "--scene", "campus_arena", cwd=tmp_path)
    assert "none.csv: no such file" in line


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"rx_z_m": [-300.0] * 4}, "few.csv: RX stop 0 at (2.000, 0.500, -300.000) m must lie between floor and"),
        (
            {"tx_x_m": [1e9] * 4, "tx_y_m": [0.0] * 4, "tx_heading_deg": [0.0] * 4},
            "few.csv: scene.tx.position_m = 1e+09",
        ),
    ],
)
def test_poses_that_are_in_no_hall_leave_no_directory(
    tmp_path: Path, changes: dict[str, Any], message: str
) -> None:
    pd.DataFrame(few(**changes)).to_csv(tmp_path / "few.csv", index=False)
    line = failure("import-paths", "few.csv", "--out", "out", "--scene", "box_room", cwd=tmp_path)
    assert message in line and not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("scale", "words"), [(1.0, ""), (1e-3, "4 of 4 paths are shorter than half"), (1e3, "4 of 4 paths are longer")]
)
def test_delays_in_another_unit_are_doubtful(tmp_path: Path, scale: float, words: str) -> None:
    changes = {"delay_ns": (scale * np.array(few()["delay_ns"])).tolist(), "rx_y_m": [2.0, 2.5] * 2}
    pd.DataFrame(few(**changes)).to_csv(tmp_path / "few.csv", index=False)
    done = arena_here("import-paths", "few.csv", "--out", "out", "--scene", "box_room", cwd=tmp_path)
    assert done.returncode == 0 and ("doubtful" in done.stdout) == bool(words) and words in done.stdout


def test_an_unknown_clock_is_that_of_the_line_of_sight(table: pd.DataFrame, tmp_path: Path) -> None:
    """Labels without places tell no objects: those scores are empty."""
    late = table.drop(columns=["ip_x_m", "ip_y_m"]).assign(range_m=table["range_m"] + 5.0 + 2.0 * table["stop"])
    places_m, told = [], []
    for out, walk in {"none": late, "unknown": late.assign(clock_bias_ns=np.nan)}.items():
        walk.to_csv(tmp_path / "walk.csv", index=False)
        done = arena_here(
            "import-paths", "walk.csv", "--scene", "campus_arena", "--out", out, *HALL_LEVEL, cwd=tmp_path
        )
        told.append(done.stdout)
        assert arena_here("estimate", out, cwd=tmp_path).returncode == 0
        assert arena_here("score", out, cwd=tmp_path).returncode == 0
        places_m.append(stages.reopen(tmp_path / out).map_result("mapping").ips.position_m)
    assert "lines of sight are not as long as the straight line" in told[0] and "doubtful" not in told[1]
    scores = {one["key"]: one["value"] for one in json.loads((tmp_path / "unknown/scores.json").read_text())}
    assert scores["slam.clock.rmse_ns"] is None and scores["mapping.objects_found.wall"] is None
    assert scores["contours.mapping.ghosts"] is None and scores["mapping.ip_to_surface.median_m"] < 0.05
    assert len(places_m[1]) and not np.array_equal(*places_m)


def test_tables_without_poses_have_no_known_clock(tmp_path: Path) -> None:
    nowhere = {name: None for name in ("rx_x_m", "rx_y_m", "rx_heading_deg")}
    found = read(tmp_path, **nowhere)
    assert np.isnan(found.bias_m).all() and len(found.bias_m) == 2
    with pytest.raises(ValueError, match="row 3: clock_bias = nan: differs from row 1 of the same stop"):
        read(tmp_path, clock_bias_ns=[1.0, 1.0, np.nan, 1.0])
    with pytest.raises(ValueError, match="row 2: clock_bias_ns = inf: must be finite"):
        read(tmp_path, clock_bias_ns=[1.0, np.inf, 1.0, np.inf])
    pd.DataFrame(few(**nowhere)).dropna(axis=1).to_csv(tmp_path / "few.csv", index=False)
    line = failure(
        "import-paths", "few.csv", "--out", "out", "--scene", "box_room", "--clock-seed", "1", cwd=tmp_path
    )
    assert "--clock-seed: adds to a known clock bias; that of stop 0 is not in the file" in line


def test_slam_needs_no_level_of_the_link(table: pd.DataFrame, tmp_path: Path) -> None:
    places_m = []
    for level_db in (0, -40, 60):
        walk = table.assign(power_dbm=table["power_dbm"] + level_db)
        walk.to_csv(tmp_path / "walk.csv", index=False)
        out = f"out{level_db}"
        assert (
            arena_here(
                "import-paths", "walk.csv", "--scene", "campus_arena", "--out", out, cwd=tmp_path
            ).returncode
            == 0
        )
        assert arena_here("estimate", out, cwd=tmp_path).returncode == 0
        places_m.append(stages.reopen(tmp_path / out).map_result("slam").poses.position_m)
    np.testing.assert_allclose(places_m[1:], [places_m[0]] * 2, atol=1e-6)
    true_m = table.groupby("stop").first()[["rx_x_m", "rx_y_m"]].to_numpy()
    np.testing.assert_allclose(places_m[0], true_m, atol=0.05)


def test_columns_that_are_not_used_are_named_and_all_known_are_in_the_page(tmp_path: Path) -> None:
    file = tmp_path / "few.csv"
    pd.DataFrame({**few(), "weather": [1] * 4, "stop ": [0] * 4}).to_csv(file, index=False)
    assert table_of(file, {"weather": np.zeros(1), "stop": np.zeros(1)}, _known_names()).unused == ["weather"]
    page = (ROOT / "docs" / "exchange.md").read_text(encoding="utf-8")
    assert all(f"| `{names}` |" in page for names in COLUMNS)
    assert {"stop", "delay_ns", "correlation_delay_aod_azimuth", "tx_heading_deg"} <= set(_known_names())
