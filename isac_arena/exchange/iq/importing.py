"""A recording made into a campaign directory that holds a beam sweep for every stop."""

import hashlib
import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from isac_arena.campaign.config import CampaignConfig
from isac_arena.campaign.directory import RECORDED, CampaignStore
from isac_arena.campaign.load import changed_campaign
from isac_arena.campaign.lock import DirectoryHeldError, one_run
from isac_arena.campaign.measured import MeasuredTruth, unlabelled_stop
from isac_arena.campaign.recording import recorded_run
from isac_arena.campaign.side import swapped_in
from isac_arena.exchange.iq.config import RecordedStop, RecordingConfig
from isac_arena.exchange.iq.cut import cut_channel, scaled
from isac_arena.exchange.iq.refine import left_over
from isac_arena.exchange.iq.samples import IqRecording, read_recording
from isac_arena.exchange.iq.synchronise import Synchronisation, synchronise
from isac_arena.exchange.iq.times import Pilots, SweepTimes, pilots, prefix_s, sweep_times
from isac_arena.exchange.measurement import TYPICAL_LENGTH_M, measured_scene, unknown_level
from scenes.pose import Pose
from scenes.toml_config import read_toml, validate_config
from sim.observation import BeamSweep
from sim.signal.arrays.codebook import Codebook
from sim.signal.link import line_of_sight_at_1m_dbm, make_codebook

# Of the strongest beam pair over a line of sight: more is no link, less is less than reflections have.
LEAST_OVER_DB, MOST_OVER_DB = -40.0, 10.0


@dataclass(frozen=True)
class RecordedSweep:
    """A sweep that was cut from a recording, and how it was synchronised.

    The zero of its delays is the schedule at `synchronisation.offset_s`, in the middle of the sweep.
    """

    sweep: BeamSweep
    synchronisation: Synchronisation
    middle_s: float  # of the schedule


@dataclass(frozen=True)
class Receiver:
    """What is known of the recordings of a campaign: beams, pilots and times."""

    config: RecordingConfig
    tx_codebook: Codebook
    rx_codebook: Codebook
    tx_pose: Pose
    pilots: Pilots
    times: SweepTimes
    carrier_hz: float

    @classmethod
    def make(cls, config: CampaignConfig, recording: RecordingConfig, folder: Path, tx_pose: Pose) -> "Receiver":
        """What settings say of a recording; `folder` has the files that it names."""
        carrier_hz = config.waveform.carrier_ghz * 1e9
        tx, rx = (make_codebook(array, carrier_hz) for array in (config.tx_array, config.rx_array))
        sent = pilots(config.waveform, recording, folder, len(tx))
        times = sweep_times(config.waveform, recording, folder, len(tx), len(rx))
        return cls(recording, tx, rx, tx_pose, sent, times, carrier_hz)

    def sweep(self, recording: IqRecording, stop: int) -> RecordedSweep:
        """The sweep of a stop; `ValueError` where it cannot be synchronised."""
        rate_hz = self.config.sample_rate_hz or recording.sample_rate_hz
        if not np.isfinite(rate_hz):
            raise ValueError("recording.sample_rate_hz: is missing, the files do not state it")
        sync = synchronise(recording, self.times, self.pilots, self.config, rate_hz)
        self._check_length(recording, sync, rate_hz)
        sweep = self._cut(recording, sync, rate_hz, stop)
        time_s = self.times.start_s[..., 0].mean(axis=0)
        middle_s = float(time_s.mean())
        if self.config.refine:
            more_hz, drift = left_over(sweep, time_s)
            offset_s, cfo_hz = sync.offset_s - drift * middle_s, sync.cfo_hz + more_hz
            sync = Synchronisation(offset_s, sync.drift + drift, cfo_hz, sync.n_arrivals)
            sweep = self._cut(recording, sync, rate_hz, stop)
        return RecordedSweep(sweep, sync, middle_s)

    def _check_length(self, recording: IqRecording, sync: Synchronisation, rate_hz: float) -> None:
        """`ValueError` where samples end before the last beam pair."""
        last_s = sync.offset_s + float(self.times.start_s.max()) + 1 / self.pilots.prs.subcarrier_spacing_hz
        end_s = recording.end_tick / rate_hz
        if end_s < last_s - prefix_s(self.pilots.prs):
            raise ValueError(f"samples: end after {end_s:.6g} s, the last beam pair ends after {last_s:.6g} s")

    def _cut(self, recording: IqRecording, sync: Synchronisation, rate_hz: float, stop: int) -> BeamSweep:
        channel, noise = cut_channel(recording, self.times, self.pilots, sync, rate_hz)
        sent = self.pilots.sent(self.times.slot[0, :, 0])
        samples, noise_mw = scaled(channel, noise, sent, self.config)
        return BeamSweep(
            tx_codebook=self.tx_codebook,
            rx_codebook=self.rx_codebook,
            tx_pose=self.tx_pose,
            stop=stop,
            samples=samples,
            prs_symbol=sent.astype(np.complex64),
            frequency_offset_hz=np.asarray(self.pilots.all_tones * self.pilots.prs.subcarrier_spacing_hz, float),
            carrier_hz=self.carrier_hz,
            noise_power_mw=noise_mw,
        )


def import_iq(file: Path, out: Path) -> tuple[list[Synchronisation], list[str]]:
    """Write the campaign directory of a recording; returns how every stop was synchronised, and what is doubtful.

    Raises `ValueError`, one line, where the file is wrong, samples are missing or cannot be synchronised, or the
    directory holds another campaign.
    """
    document = read_toml(file)
    recording = _recording(document, file)
    config, source = changed_campaign({k: v for k, v in document.items() if k != "recording"}, file, [])
    scene = source.build(config)
    receiver = Receiver.make(config, recording, file.parent, scene.standing_tx)
    truths = [_truth(stop, index) for index, stop in enumerate(recording.stops)]
    hall = measured_scene(file, source, config, scene.tx, truths, scene.walk.positions_m()[0])
    names = [[file.parent / name for name in stop.files] for stop in recording.stops]
    first = _named(file, 0, receiver, names[0])
    if recording.full_scale_dbm is None:
        config = _with_unknown_level(config, document, first.sweep)
    store = CampaignStore(
        directory=out, config=config, scene_text=hall.text, measured=_origin(file, names), scene_files=hall.files
    )
    found, over_db, is_new = [], [], not out.is_dir() or not any(out.iterdir())
    try:
        with one_run(out), recorded_run(out), swapped_in(store) as beside:
            beside.open_for_writing()
            for truth, files in zip(truths, names, strict=True):
                one = _named(file, truth.stop, receiver, files) if truth.stop else first
                over_db.append(_over_free_space_db(config, one.sweep, truth.rx_pose))
                beside.write_truth(truth)
                beside.write_sweep(one.sweep)
                found.append(one.synchronisation)
    except DirectoryHeldError:
        raise
    except ValueError:
        if is_new:  # another recording file is another campaign
            shutil.rmtree(out, ignore_errors=True)
        raise
    return found, [] if recording.full_scale_dbm is None else _doubts(float(np.median(over_db)))


def _strongest_dbm(sweep: BeamSweep) -> float:
    """Power in the strongest beam pair."""
    return 10 * float(np.log10(np.mean(np.abs(sweep.samples) ** 2, axis=2).max()))


def _with_unknown_level(config: CampaignConfig, document: dict[str, Any], sweep: BeamSweep) -> CampaignConfig:
    """Settings for samples without calibration: a wide prior about the powers of a sweep, where none is given."""
    level = unknown_level([np.array([_strongest_dbm(sweep)])])
    slam, channel = config.slam, config.channel
    if "path_loss" not in document.get("slam", {}):
        slam = slam.model_copy(update={"path_loss": level})
    if "los" not in document.get("channel", {}):
        stated = {"power_at_1m_dbm": level.intercept_dbm, "tolerance_db": level.std_db}
        channel = channel.model_copy(update={"los": channel.los.model_copy(update=stated)})
    return config.model_copy(update={"slam": slam, "channel": channel})


def _over_free_space_db(config: CampaignConfig, sweep: BeamSweep, rx_pose: Pose) -> float:
    """Power in the strongest beam pair over that of a line of sight, of usual length where the pose is unknown."""
    length_m = float(np.linalg.norm(rx_pose.position_m - sweep.tx_pose.position_m))
    length_m = max(length_m, 1.0) if np.isfinite(length_m) else TYPICAL_LENGTH_M
    return _strongest_dbm(sweep) - line_of_sight_at_1m_dbm(config) + 20 * float(np.log10(length_m))


def _doubts(over_db: float) -> list[str]:
    if LEAST_OVER_DB < over_db < MOST_OVER_DB:
        return []
    where = "above" if over_db > 0 else "below"
    return [
        f"the strongest beam pairs are {abs(over_db):.0f} dB {where} a line of sight of [link]: look at"
        " full_scale_dbm and tx_power_dbm; without full_scale_dbm the level counts as unknown"
    ]


def _named(file: Path, stop: int, receiver: Receiver, files: list[Path]) -> RecordedSweep:
    """The sweep of a stop; errors name file and stop."""
    try:
        return receiver.sweep(read_recording(files), stop)
    except OSError as error:
        raise ValueError(f"{file}: stop {stop}: {error.filename}: {error.strerror}") from error
    except ValueError as error:
        raise ValueError(f"{file}: stop {stop}: {error}") from error


def _recording(document: dict[str, Any], file: Path) -> RecordingConfig:
    if "recording" not in document:
        raise ValueError(f"{file}: the table [recording] is missing; see docs/exchange.md")
    return validate_config(document["recording"], RecordingConfig, f"{file}: recording")


def _truth(stop: RecordedStop, index: int) -> MeasuredTruth:
    if (stop.position_m is None) != (stop.heading_deg is None):
        raise ValueError(f"recording.stops.{index}: position_m, heading_deg: give both, or none of them")
    if stop.position_m is None or stop.heading_deg is None:
        return unlabelled_stop(index, None)
    return unlabelled_stop(index, Pose(np.array(stop.position_m), float(np.deg2rad(stop.heading_deg))))


def _origin(file: Path, names: list[list[Path]]) -> str:
    digest = hashlib.sha256(file.read_bytes())
    for one in (name for files in names for name in files):
        for part in (one, one.with_suffix(".sigmf-data")):
            if part.is_file():
                digest.update(part.read_bytes())
    return f"{RECORDED}{file.name} (sha256 {digest.hexdigest()[:16]})"
