"""The measurement file: what is read from it, and what is refused."""

from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.io import savemat

from estimation.slam.checks import check_estimates
from isac_arena.campaign.measured import clock_walk_m
from isac_arena.exchange.mat import count_stops, read_measurement
from scenes.pose import SPEED_OF_LIGHT_M_S

N_STOPS, N_PATHS = 3, 4


def content(**changes):
    """A struct `sim` of three stops with four paths each, out of order in delay."""
    rng = np.random.default_rng(1)
    cells = {name: np.empty((1, N_STOPS), object) for name in ("y", "power", "inlier", "MU")}
    for stop in range(N_STOPS):
        ranges = np.array([9.0, 5.0, 12.0, 7.0]) + stop
        cells["y"][0, stop] = np.vstack([ranges, rng.uniform(-1, 1, (2, N_PATHS))])
        cells["power"][0, stop] = np.array([[-45.0, -30.0, -50.0, -48.0]])
        cells["inlier"][0, stop] = np.array([[0, 1, 0, 0], [1, 0, 0, 1]], float)
        landmark = np.full((2, N_PATHS), np.nan)
        landmark[:, [0, 3]] = [[1.0, 2.0], [-3.0, -4.0]]
        cells["MU"][0, stop] = landmark
    tx = np.tile([[2.25], [2.5], [-np.pi / 2]], N_STOPS)
    rx = np.array([[0.0, 0.5, 1.0], [-2.3, -2.3, -2.3], [0.0, 0.0, 0.0]])
    return {"tx": tx, "rx": rx, **cells, **changes}


def saved(folder: Path, **changes) -> Path:
    path = folder / "made_up.mat"
    savemat(path, {"sim": {k: v for k, v in content(**changes).items() if v is not None}})
    return path


def with_cell(name, stop, value):
    cells = content()[name]
    cells[0, stop] = value
    return {name: cells}


def changed(row, column, value, stop=1):
    y = content()["y"][0, stop].copy()
    y[row, column] = value
    return with_cell("y", stop, y)


def test_stops_are_sorted_by_delay_with_their_labels(tmp_path):
    campaign = read_measurement(saved(tmp_path), tx_offset_deg=-1.6, height_m=1.8)
    assert count_stops(saved(tmp_path)) == len(campaign.channel) == N_STOPS
    assert_allclose(campaign.tx.position_m, [2.25, 2.5, 1.8])
    assert campaign.tx.heading_rad == pytest.approx(-np.pi / 2 + np.deg2rad(-1.6))
    estimate, truth = campaign.channel[1], campaign.truths[1]
    assert_allclose(SPEED_OF_LIGHT_M_S * estimate.delay_s, [6.0, 8.0, 10.0, 13.0])
    assert_allclose(estimate.power_dbm, [-30, -48, -45, -50])
    assert estimate.is_los.tolist() == [True, False, False, False]
    assert truth.is_single_bounce.tolist() == [False, True, True, False]
    assert_allclose(truth.landmark_m[1:3], [[2.0, -4.0], [1.0, -3.0]])
    assert np.isnan(truth.landmark_m[[0, 3]]).all()
    assert_allclose(truth.rx_pose.position_m, [0.5, -2.3, 1.8])


def test_the_clock_walk_is_added_to_every_range_of_its_stop(tmp_path):
    bias = clock_walk_m(N_STOPS, np.random.default_rng(4))
    assert bias[0] == pytest.approx(10.0)
    plain, biased = (read_measurement(saved(tmp_path), clock_bias_m=b) for b in (None, bias))
    for stop in range(N_STOPS):
        later = biased.channel[stop].delay_s - plain.channel[stop].delay_s
        assert_allclose(SPEED_OF_LIGHT_M_S * later, bias[stop])
        assert biased.truths[stop].clock_bias_s * SPEED_OF_LIGHT_M_S == pytest.approx(bias[stop])
    many = clock_walk_m(20_000, np.random.default_rng(5))
    assert np.std(np.diff(many)) == pytest.approx(1.0, abs=0.02)


def test_a_file_without_labels_is_read_with_none(tmp_path):
    campaign = read_measurement(saved(tmp_path, inlier=None, MU=None))
    assert not any(truth.is_los.any() or truth.is_single_bounce.any() for truth in campaign.truths)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"y": None}, r"sim.y is missing"),
        ({"rx": np.zeros((2, 3))}, r"sim.rx has shape \(2, 3\)"),
        ({"rx": np.full((3, 3), np.nan)}, r"sim.rx holds values that are not finite"),
        ({"tx": np.arange(9.0).reshape(3, 3)}, r"sim.tx moves"),
        ({"tx": np.zeros((3, 2))}, r"sim.tx has 2 poses"),
        (with_cell("power", 2, np.zeros((1, 7))), r"sim.power\{3\} has shape \(1, 7\)"),
        (with_cell("y", 0, np.zeros((4, 4))), r"sim.y\{1\} has shape \(4, 4\)"),
        (changed(1, 2, np.nan), r"stop 1: aod_azimuth_rad\[3\] = nan: must be finite"),
        (changed(2, 0, 140.0), r"stop 1: aoa_azimuth_rad\[2\] = 140: .* degrees"),
        (with_cell("y", 1, content()["y"][0, 1][:, [0, 0, 1, 2]]), r"stop 1: path 1 is given 2 times"),
    ],
)
def test_other_layouts_and_impossible_paths_are_named_and_refused(tmp_path, changes, message):
    with pytest.raises(ValueError, match=message):
        read_measurement(saved(tmp_path, **changes))


def test_a_stop_with_one_path_is_a_stop(tmp_path):
    cells = content()
    for name in ("y", "power", "inlier", "MU"):
        cells[name][0, 2] = cells[name][0, 2][:, :1]
    path = saved(tmp_path, **{name: cells[name] for name in ("y", "power", "inlier", "MU")})
    assert [len(estimate) for estimate in read_measurement(path).channel][2] == 1


def test_other_files_are_refused(tmp_path):
    text = tmp_path / "text.mat"
    text.write_text("no MATLAB file at all, but long enough to have a header of one" * 10)
    with pytest.raises(ValueError, match="no MATLAB 5 file"):
        read_measurement(text)
    savemat(tmp_path / "other.mat", {"data": np.zeros(3)})
    with pytest.raises(ValueError, match="holds data; one struct 'sim' is needed"):
        read_measurement(tmp_path / "other.mat")
    with pytest.raises(FileNotFoundError):
        read_measurement(tmp_path / "missing.mat")


def test_slam_needs_a_finite_tx_pose(tmp_path):
    campaign = read_measurement(saved(tmp_path))
    with pytest.raises(ValueError, match="tx_pose = None"):
        check_estimates(campaign.channel, None)
    nowhere = type(campaign.tx)(np.array([np.nan, 0.0, 0.0]), 0.0)
    with pytest.raises(ValueError, match=r"tx_pose = .* must be finite"):
        check_estimates(campaign.channel, nowhere)
    check_estimates(campaign.channel, campaign.tx)
