"""`arena link`, `arena export-sigmf` and beam weights in a campaign file, on the small campaign."""

import re
from pathlib import Path

import numpy as np
import pytest

from isac_arena.campaign.campaign import load_campaign
from isac_arena.campaign.directory import CampaignStore
from isac_arena.exchange.sigmf_recording import read_sigmf
from sim.signal.link import make_link
from sim.signal.waveform.ofdm import cp_lengths, demodulate
from sim.simulate import observe
from tests.command_line import Result, arena_here


def arena(*arguments: object) -> Result:
    return arena_here(*arguments, columns=80)


@pytest.fixture(scope="module")
def generated(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("signal") / "box"
    result = arena("generate", "box_room", "--out", out, "--no-keep-sweeps")
    assert result.returncode == 0, result.stderr
    return out


def test_link_prints_a_row_per_stop() -> None:
    result = arena("link", "box_room")
    assert result.returncode == 0, result.stderr
    assert "EIRP 29.1 dBm" in result.stdout and "thermal -81.2 dBm" in result.stdout
    assert "sweep: 32 x 96 beam pairs, 27.4 ms on the air" in result.stdout
    rows = re.findall(r"^│ +(\d) │ +(\S+) │ +(\S+) │", result.stdout, re.MULTILINE)
    assert [int(stop) for stop, _, _ in rows] == [0, 1, 2, 3]
    for _, distance_m, los_dbm in rows:
        free_space_dbm = -12.9 - 20 * np.log10(float(distance_m))
        assert free_space_dbm - 13 < float(los_dbm) <= free_space_dbm + 0.1


def test_link_of_a_schedule_has_less_noise_and_more_air_time(tmp_path: Path) -> None:
    schedule = "[waveform.schedule]\nperiod_slots = 160\nrepetitions = 4\nmuting_2 = [1, 1, 0, 0]\n"
    (tmp_path / "own.toml").write_text(f'name = "own"\nscene = "box_room"\n{schedule}')
    result = arena("link", tmp_path / "own.toml")
    assert result.returncode == 0, result.stderr
    assert "thermal -84.2 dBm" in result.stdout
    # 95 periods of 20 ms, and in the last one 32 beams of 4 slots, of which the last two are muted
    assert "2 repetitions combined, 1915.8 ms on the air" in " ".join(result.stdout.split())


def test_exported_samples_demodulate_to_the_sweep(generated: Path) -> None:
    result = arena("export-sigmf", generated, "--stop", 1, "--tx-beam", 16, "--rx-beam", 40)
    assert result.returncode == 0, result.stderr
    samples, metadata = read_sigmf(generated / "sigmf" / "stop_001_tx_016_rx_040")
    assert metadata["global"]["core:sample_rate"] == 491.52e6
    assert metadata["captures"] == [{"core:sample_start": 0, "core:frequency": 60e9}]
    from isac_arena.campaign import stages  # noqa: PLC0415

    store = stages.reopen(generated)
    truth = store.truth(1)
    assert truth is not None
    sweep = observe(store.config, make_link(store.config), store.scene, truth)
    grid = demodulate(samples, 3168, cp_lengths(3, 16)[:1])[0, ::2] * np.sqrt(1584)
    expected = sweep.samples[16, 40]
    assert np.abs(grid - expected).max() <= 1e-5 * np.abs(expected).max()


def test_all_rx_beams_by_default(generated: Path, tmp_path: Path) -> None:
    assert arena("export-sigmf", generated, "--stop", 0, "--tx-beam", 0, "--out", tmp_path).returncode == 0
    samples, metadata = read_sigmf(tmp_path / "stop_000_tx_000")
    assert len(metadata["captures"]) == 96 and len(samples) == 96 * (4096 + 544)


def test_bad_beams_and_stops_end_in_one_line(generated: Path) -> None:
    for arguments, message in (
        (("--stop", 9, "--tx-beam", 0), "truth of stop 9"),
        (("--stop", 0, "--tx-beam", 32), "tx_beam = 32: allowed is 0 to 31"),
        (("--stop", 0, "--tx-beam", 0, "--rx-beam", 96), "rx_beam = 96: allowed is 0 to 95"),
    ):
        result = arena("export-sigmf", generated, *arguments)
        lines = result.stderr.strip().splitlines()
        assert result.returncode == 2 and len(lines) == 1 and message in lines[0], result.stderr


def test_weight_files_lie_beside_the_campaign(tmp_path: Path) -> None:
    np.savez(tmp_path / "beams.npz", weights=np.eye(2, 64))
    text = '[rx_array]\ncodebook = "file"\nweights_file = "beams.npz"\npanel_azimuth_deg = [0.0]\n'
    (tmp_path / "own.toml").write_text(f'name = "own"\nscene = "box_room"\n{text}')
    config = load_campaign(str(tmp_path / "own.toml")).config
    assert len(make_link(config).rx_codebook) == 2
    before = CampaignStore(tmp_path / "out", config, "").truth_fingerprint
    np.savez(tmp_path / "beams.npz", weights=np.eye(3, 64))
    assert CampaignStore(tmp_path / "out", config, "").truth_fingerprint != before


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ("[waveform]\ncomb = 4\nn_symbols = 2\n", "waveform.n_symbols = 2: allowed is 4, 12 with comb 4"),
        ("[waveform]\nrb_offset = 4\ncarrier_rb = 264\n", "waveform.rb_offset + n_rb = 268: allowed is up to"),
        ("[link]\nnoise_figure_db = -1.0\n", "link.noise_figure_db = -1.0: must be greater than or equal to 0"),
        ("[tx_array]\ncodebook = 'file'\n", "tx_array.weights_file = None: must be given"),
        (
            "[waveform]\ncyclic_prefix = 'extended'\n",
            "waveform.cyclic_prefix = 'extended' with numerology = 3: allowed is numerology 2 alone",
        ),
        ("[waveform.schedule]\nperiod_slots = 6\n", "schedule.period_slots = 6: allowed is 2^mu times one of 4,"),
        ("[waveform.schedule]\nmuting_1 = [0, 0]\n", "leave nothing that is sent"),
    ],
)
def test_bad_settings_name_the_rule(tmp_path: Path, table: str, message: str) -> None:
    (tmp_path / "bad.toml").write_text(f'name = "bad"\nscene = "box_room"\n{table}')
    with pytest.raises(ValueError, match=re.escape(message)):
        load_campaign(str(tmp_path / "bad.toml"))
