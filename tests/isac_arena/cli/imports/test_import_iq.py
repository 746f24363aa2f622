"""Samples that were exported, or made by an independent transmitter, become sweeps again."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
import tomli_w

import isac_arena as ia
from isac_arena.campaign.directory import open_campaign
from isac_arena.exchange.iq.config import RecordingConfig
from isac_arena.exchange.iq.importing import Receiver
from isac_arena.exchange.iq.samples import IqRecording, read_recording
from isac_arena.exchange.iq.times import pilots, sweep_times
from isac_arena.exchange.sigmf_recording import read_sigmf
from isac_arena.validation.exchange import independent as other
from isac_arena.validation.exchange.recordings import draw, late_s, receiver
from sim.config import WaveformConfig
from tests.command_line import arena_here, failure

ARRAY = {"rows": 1, "columns": 8, "beams_per_panel": 8}
N_TX = 5
SMALL = {
    "name": "small", "scene": "box_room", "waveform": {"n_rb": 24, "comb": 4},
    "tx_array": ARRAY | {"beams_per_panel": N_TX},
    "rx_array": ARRAY | {"panel_azimuth_deg": [0.0, 180.0]}, "propagation": {"diffuse_samples": 0},
    "channel": {"method": "power"}, "clock": {"walk_std_ns": 0.0},
}  # fmt: skip

KNOWN = {
    "search_us": 1.0,
    "largest_cfo_hz": 0.0,
    "largest_drift_ppm": 0.0,
    "refine": False,
    "noise_power_dbm": -70.0,
}  # exported samples hold no noise beside the pilots


def recording_file(folder: Path, stops: list[dict[str, object]], **changes: object) -> Path:
    file = folder / "recording.toml"
    file.write_text(tomli_w.dumps(SMALL | {"recording": {"stops": stops} | changes}))
    return file


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two stops of a campaign as SigMF files, a TX beam each."""
    folder = tmp_path_factory.mktemp("recorded")
    (folder / "small.toml").write_text(tomli_w.dumps(SMALL))
    done(folder, "generate", "small.toml", "--out", "made", "--keep-sweeps")
    for stop in range(2):
        for beam in range(N_TX):
            done(folder, "export-sigmf", "made", "--stop", stop, "--tx-beam", beam, "--out", "iq")
    return folder


def done(folder: Path, *arguments: object) -> str:
    result = arena_here(*arguments, cwd=folder)
    assert result.returncode == 0, result.stderr
    return result.stdout


def stops_of(folder: Path, *, with_poses: bool = True) -> list[dict[str, object]]:
    found: list[dict[str, object]] = []
    for stop in range(2):
        truth = open_campaign(folder / "made").truth(stop)
        assert truth is not None
        pose = {
            "position_m": truth.rx_pose.position_m.tolist(),
            "heading_deg": float(np.rad2deg(truth.rx_pose.heading_rad)),
        }
        files = [f"iq/stop_{stop:03d}_tx_{beam:03d}.sigmf-meta" for beam in range(N_TX)]
        found.append({"files": files} | (pose if with_poses else {}))
    return found


def test_exported_samples_are_imported_and_run_the_whole_chain(recorded: Path) -> None:
    recording_file(recorded, stops_of(recorded), **KNOWN)
    told = done(recorded, "import-iq", "recording.toml", "--out", "back")
    assert "2 stops imported" in told
    one, other_one = open_campaign(recorded / "made").sweep(1), open_campaign(recorded / "back").sweep(1)
    assert one is not None and other_one is not None
    channel, back = (sweep.samples / sweep.prs_symbol[:, None] for sweep in (one, other_one))
    steps = [sweep[..., 1:] * sweep[..., :-1].conj() for sweep in (back, channel)]
    late = np.angle((steps[0] * steps[1].conj()).sum())
    turned = back * np.exp(-1j * late * np.arange(back.shape[2]))
    scale = np.vdot(turned, channel) / np.vdot(turned, turned)
    assert abs(abs(scale) - 1) < 1e-3
    assert np.abs(scale * turned - channel).max() < 1e-3 * np.abs(channel).max()
    for command in ("estimate", "score", "report"):
        done(recorded, command, "back")
    assert (recorded / "back" / "report.html").is_file()
    run = ia.open(recorded / "back")
    assert len(run.channel) == 2
    states, ips = run.mapping.poses, run.mapping.ips  # the clock is that of the line of sight
    assert np.isfinite(states.clock_bias_s).all()
    assert ips.is_inlier.any()


def test_without_poses_there_is_slam_alone(recorded: Path) -> None:
    recording_file(recorded, stops_of(recorded, with_poses=False), **KNOWN)
    done(recorded, "import-iq", "recording.toml", "--out", "alone")
    for command in ("estimate", "score", "report"):
        done(recorded, command, "alone")
    run = ia.open(recorded / "alone")
    assert not len(run.mapping.ips)
    assert len(run.slam.poses.stop) == 2


def test_a_level_is_stated_or_unknown(recorded: Path) -> None:
    """Samples of the right level; 40 dB too strong; of no stated level, which SLAM takes from them."""
    for out, changes in (("right", {"full_scale_dbm": 0.0}), ("strong", {"full_scale_dbm": 40.0}), ("none", {})):
        recording_file(recorded, stops_of(recorded), **KNOWN, **changes)
        told = done(recorded, "import-iq", "recording.toml", "--out", out)
        assert ("doubtful: the strongest beam pairs are" in told) == (out == "strong")
    right, none = (open_campaign(recorded / out).config for out in ("right", "none"))
    assert (right.slam.path_loss.level_std_db, none.slam.path_loss.level_std_db) == (3.0, 10.0)
    assert abs(none.slam.path_loss.intercept_dbm - right.slam.path_loss.intercept_dbm) < 10.0
    assert none.channel.los.power_at_1m_dbm == none.slam.path_loss.intercept_dbm


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"search_us": 0.0}, "search_us"),
        ({"sample_rate_hz": 1e8}, "whole multiple of the subcarrier spacing"),
        ({"start_s": 9.0}, "no pilots within"),
        ({"sequence_ids": [1, 2]}, "the TX has 5 beams"),
        ({"pairs": "pairs.csv"}, "pairs.csv"),
    ],
)
def test_what_cannot_be_read_is_one_line(recorded: Path, changes: dict[str, object], told: str) -> None:
    recording_file(recorded, stops_of(recorded), **changes)
    assert told in failure("import-iq", "recording.toml", "--out", "never", cwd=recorded)


def test_a_missing_recording_leaves_nothing(recorded: Path) -> None:
    stops = stops_of(recorded)
    stops[1]["files"] = ["nowhere.sigmf-meta"]
    recording_file(recorded, stops, **KNOWN)
    told = failure("import-iq", "recording.toml", "--out", "never", cwd=recorded)
    assert "recording.toml: stop 1: nowhere.sigmf-meta: No such file or directory" in told
    assert not (recorded / "never").exists()


def test_formats_hold_the_same_samples(recorded: Path, tmp_path: Path) -> None:
    base = recorded / "iq/stop_000_tx_000"
    samples, about = read_sigmf(base)
    np.savez(tmp_path / "one.npz", samples=samples, sample_rate_hz=about["global"]["core:sample_rate"])
    with h5py.File(tmp_path / "one.h5", "w") as stored:
        stored["samples_real"], stored["samples_imag"] = samples.real, samples.imag
    largest = np.abs(samples.view(np.float32)).max()
    whole = np.round(samples.view(np.float32) / largest * 32767).astype("<i2")
    (tmp_path / "whole.sigmf-data").write_bytes(whole.tobytes())
    about["global"] |= {"core:datatype": "ci16_le"}
    del about["global"]["core:sha512"]
    (tmp_path / "whole.sigmf-meta").write_text(json.dumps(about))
    first = read_recording([base.with_suffix(".sigmf-meta")])
    for name in ("one.npz", "one.h5"):
        assert np.array_equal(read_recording([tmp_path / name]).samples, first.samples)
    found = read_recording([tmp_path / "whole.sigmf-meta"]).samples
    assert np.abs(found * largest - samples).max() < 2e-4 * largest
    assert read_recording([tmp_path / "one.npz"]).sample_rate_hz == first.sample_rate_hz


@pytest.mark.parametrize(
    ("row", "told"),
    [
        ("0,0,nan,0", "row 1: start_s = nan: must be finite"),
        ("0,0,-5,0", "row 1: start_s = -5.0: must be within 0 and 10000 s"),
        ("0.5,0,0,0", "row 1: tx_beam = 0.5: must be a whole number from 0 to 1"),
        ("a,0,0,0", "row 1: tx_beam = a: must be a number"),
        ("9,0,0,0", "row 1: tx_beam = 9.0: must be a whole number from 0 to 1"),
        ("1,0,0,0", "row 2: tx_beam, rx_beam = 1, 0: is in another row already"),
    ],
)
def test_wrong_tables_of_pairs_name_row_and_value(tmp_path: Path, row: str, told: str) -> None:
    (tmp_path / "pairs.csv").write_text(f"tx_beam,rx_beam,start_s,slot\n{row}\n1,0,1e-3,0\n")
    stated = RecordingConfig.model_validate({"stops": [{"files": ["-"]}], "pairs": "pairs.csv"})
    with pytest.raises(ValueError, match=re.escape(f"pairs.csv: {told}")):
        sweep_times(WaveformConfig(), stated, tmp_path, 2, 1)


def test_a_pair_that_no_row_holds_is_named(tmp_path: Path) -> None:
    (tmp_path / "pairs.csv").write_text("tx_beam,rx_beam,start_s\n1,0,1e-3\n")
    stated = RecordingConfig.model_validate({"stops": [{"files": ["-"]}], "pairs": "pairs.csv"})
    with pytest.raises(ValueError, match="the pair of TX beam 0 and RX beam 0 is missing: all 2 x 1 are needed"):
        sweep_times(WaveformConfig(), stated, tmp_path, 2, 1)


@pytest.mark.parametrize("arrays", [{"pilots": np.ones((2, 8))}, {"grid": np.array(["a"])}])
def test_a_reference_without_grid_is_one_line(tmp_path: Path, arrays: dict[str, Any]) -> None:
    np.savez(tmp_path / "pilots.npz", **arrays)
    stated = RecordingConfig.model_validate({"stops": [{"files": ["-"]}], "reference": "pilots.npz"})
    with pytest.raises(ValueError, match=r"pilots.npz: holds no grid \(tx_beam, subcarrier\) of numbers"):
        pilots(WaveformConfig(), stated, tmp_path, 2)


def test_samples_that_are_no_numbers_are_named(tmp_path: Path) -> None:
    np.savez(tmp_path / "words.npz", samples=np.array(["a", "b"]))
    with pytest.raises(ValueError, match=r"words.npz: samples, first, count: must be numbers"):
        read_recording([tmp_path / "words.npz"])


def test_segments_have_their_place_in_time() -> None:
    samples = np.arange(1, 9).astype(np.complex64)
    recording = IqRecording(samples, np.array([0, 3]), np.array([0, 10]), 1.0)
    found = recording.windows(np.array([-1, 1, 9, 13]), 4).real
    assert np.array_equal(found, [[0, 1, 2, 3], [2, 3, 0, 0], [0, 4, 5, 6], [7, 8, 0, 0]])


def test_times_are_those_of_the_standard(tmp_path: Path) -> None:
    waveform = WaveformConfig.model_validate(
        {"n_rb": 24, "comb": 4, "combine_symbols": True, "schedule": {"period_slots": 32, "offset_slots": 3}}
    )
    stated = RecordingConfig.model_validate({"stops": [{"files": ["-"]}]})
    times = sweep_times(waveform, stated, tmp_path, 12, 10)
    assert times.slot[0, 5, 7] == 3 + 5 + 7 * 32
    for beam, rx in ((0, 0), (5, 7), (11, 9)):
        expected = [other.symbol_start_s(int(times.slot[0, beam, rx]), symbol) for symbol in range(4)]
        assert times.start_s[0, beam, rx] == pytest.approx(expected, abs=1e-12)


def test_an_independent_transmitter_is_heard(tmp_path: Path) -> None:
    """Timing, carrier 2.5 subcarriers off, and 5 ppm of sampling."""
    rng = np.random.default_rng(7)
    paths, errors = draw(rng)
    wrong = other.ReceiverErrors(errors.timing_s, -301e3, 5e-6, errors.noise)
    samples = other.record(paths, wrong, np.random.default_rng(8)).astype(np.complex64)
    heard: Receiver = receiver(tmp_path)
    half = IqRecording(samples[: len(samples) // 2], np.zeros(1, int), np.zeros(1, int), other.RATE_HZ)
    with pytest.raises(ValueError, match=r"samples: end after 0\.0\d+ s, the last beam pair ends after 0\.0\d+ s"):
        heard.sweep(half, 0)
    found = heard.sweep(IqRecording(samples, np.zeros(1, int), np.zeros(1, int), other.RATE_HZ), 0)
    assert found.synchronisation.cfo_hz == pytest.approx(-301e3, abs=0.5)
    assert found.synchronisation.drift == pytest.approx(5e-6, abs=5e-8)
    assert abs(late_s(found, wrong)) < 300e-9
    expected = errors.noise**2 / other.SIZE * other.N_SUBCARRIERS / other.COMB
    assert found.sweep.noise_power_mw == pytest.approx(expected, rel=0.15)
