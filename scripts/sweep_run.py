"""One case of a sweep, from the scene to the scores; paths and samples are shared by content.

    scenes/HASH/scene.toml     a scene and the files it names
    paths/HASH/stop_000.nc     traced paths, shared by all cases of the same scene and propagation
    signals/HASH/stop_000.nc   samples, while several cases wait for them
    cases/HASH/                campaign.json, scores.json, provenance.nc: there only when whole

Every function here may run in any process and any number of times: files appear whole, under names that follow
from what made them, and what is there is not made again.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

from threadpoolctl import threadpool_limits

from estimation.config import CampaignConfig
from estimation.fingerprint import digest
from estimation.pipeline import channel_estimator, known_receiver, map_known, map_unknown, significance
from estimation.results import CampaignResults
from estimation.scoring.metric import to_json
from estimation.scoring.score import Scores, score_campaign
from estimation.store import CampaignStore
from scenes.scene import Scene
from scripts.campaign_file import campaign_scene
from scripts.sweep_cases import Case
from sim.campaign import clock_biases_s, observe, simulate_truth
from sim.config import WaveformConfig
from sim.hardware import surveyed
from sim.link import best_beam_power_dbm, make_link
from sim.store import complete_file, read_record, write_record, write_text
from sim.sweep import BeamSweep
from sim.truth import Truth


@dataclass(frozen=True)
class Job:
    """A case in the directory of its sweep, and the names its files go by."""

    case: Case
    root: Path

    @cached_property
    def key(self) -> str:
        """Hash of settings, scene, estimator and code: the name of the case."""
        return digest(self._store(self.case.config).score_fingerprint, str(self.case.stop_every))

    @cached_property
    def paths_hash(self) -> str:
        """Hash of what the paths depend on: equal for cases that differ in signal, noise or estimator."""
        return self._store(self.tracing_config).truth_fingerprint

    @cached_property
    def signal_hash(self) -> str:
        """Hash of what the samples depend on."""
        return self._store(self.case.config).truth_fingerprint

    @property
    def tracing_config(self) -> CampaignConfig:
        """The settings that paths depend on, all others at their defaults."""
        config = self.case.config
        return CampaignConfig(
            name="-",
            scene=config.scene,
            tx=config.tx,
            walk=config.walk,
            propagation=config.propagation,
            waveform=WaveformConfig(carrier_ghz=config.waveform.carrier_ghz),
        )

    @property
    def directory(self) -> Path:
        """Where the finished case is."""
        return self.root / "cases" / self.key

    @property
    def is_done(self) -> bool:
        """Whether the case is there, whole."""
        return (self.directory / "scores.json").is_file()

    @cached_property
    def scene(self) -> Scene:
        """The scene of the case, with the TX and the walk it chooses."""
        return campaign_scene(self.case.config, self.scene_file)

    @property
    def scene_file(self) -> Path:
        """The stored scene file of the case."""
        return self.root / "scenes" / self.scene_hash / "scene.toml"

    @cached_property
    def scene_hash(self) -> str:
        """Hash of the scene file and of the files it names."""
        case = self.case
        contents = sorted(
            f"{name} {hashlib.sha256(data).hexdigest()}" for name, data in case.scene_files.items()
        )
        return digest(case.scene_text, *contents)

    @property
    def stops(self) -> range:
        """Indices of the receiver stops that the sweep takes."""
        return range(0, len(self.scene.stops), self.case.stop_every)

    def paths_file(self, stop: int) -> Path:
        """The traced paths of a stop."""
        return self.root / "paths" / self.paths_hash / f"stop_{stop:03d}.nc"

    def signal_file(self, stop: int) -> Path:
        """The samples of a stop."""
        return self.root / "signals" / self.signal_hash / f"stop_{stop:03d}.nc"

    def _store(self, config: CampaignConfig) -> CampaignStore:
        """The case as a campaign of its own, for the fingerprints that tell it from others."""
        case = self.case
        return CampaignStore(
            self.root, config, case.scene_text, case.estimator, scene_files=dict(case.scene_files)
        )


def store_scene(job: Job) -> None:
    """Store the scene of a case with the files it names."""
    if job.scene_file.is_file():
        return
    for name, data in job.case.scene_files.items():
        with complete_file(job.scene_file.parent / name) as partial:
            partial.write_bytes(data)
    write_text(job.scene_file, job.case.scene_text)


def check_case(job: Job) -> None:
    """Raise `ValueError`, one line, where the scene or the estimator of a case cannot be used."""
    channel_estimator(job.case.config, job.case.estimator)
    with tempfile.TemporaryDirectory() as folder:
        stored = replace(job, root=Path(folder))
        store_scene(stored)
        try:
            _ = stored.scene
        except ValueError as error:
            message = str(error).replace(f"{stored.scene_file}: ", "")
            raise ValueError(
                f"scene '{job.case.config.scene}' of point {job.case.point}: {message}"
            ) from error


def trace_stops(job: Job, stops: Sequence[int]) -> None:
    """Trace the paths of the given stops that are not stored yet."""
    missing = [stop for stop in stops if not job.paths_file(stop).is_file()]
    if missing:
        for truth in simulate_truth(job.tracing_config, job.scene, missing):
            write_record(job.paths_file(truth.stop), truth)


def make_signals(job: Job, stops: Sequence[int]) -> None:
    """Store the samples of the given stops for the cases that wait for them."""
    link = make_link(job.case.config)
    for truth in truths(job, [stop for stop in stops if not job.signal_file(stop).is_file()]):
        write_record(job.signal_file(truth.stop), observe(job.case.config, link, job.scene, truth))


def run_case(job: Job) -> None:
    """Run a case from its traced paths to its scores and store them."""
    if not job.is_done:
        store_case(job, score_case(job))


def score_case(job: Job) -> Scores:
    """The scores of a case; nothing is stored but paths not traced before."""
    trace_stops(job, job.stops)
    config, scene, link = job.case.config, job.scene, make_link(job.case.config)
    known = list(truths(job, job.stops))
    with threadpool_limits(limits=1):  # the last digits of sums depend on the number of threads
        estimator = channel_estimator(config, job.case.estimator)
        channel = tuple(estimator(_sweep(job, truth)) for truth in known)
        receiver = known_receiver(surveyed(config, truth) for truth in known)
        results = CampaignResults(
            channel=channel,
            power_maps=(),
            mapping=map_known(config, channel, scene.tx, receiver),
            slam=map_unknown(config, channel, scene.tx),
        )
        return score_campaign(
            scene,
            known,
            results,
            true_power_dbm=lambda truth: best_beam_power_dbm(truth.paths, link, scene.tx, truth.rx_pose),
            significance=significance(config, link),
        )


def store_case(job: Job, scores: Scores) -> None:
    """Write the directory of a case under another name, then give it its own: it is there whole or not at all."""
    partial = job.directory.with_name(f".{job.key}.{os.getpid()}.part")
    shutil.rmtree(partial, ignore_errors=True)
    settings = {
        "point": job.case.point,
        "repeat": job.case.repeat,
        "stop_every": job.case.stop_every,
        "estimator": job.case.estimator,
        "campaign": job.case.config.model_dump(mode="json"),
    }
    try:
        write_text(partial / "campaign.json", json.dumps(settings, indent=1) + "\n")
        write_record(partial / "provenance.nc", scores.tables)
        write_text(partial / "scores.json", json.dumps(to_json(scores.metrics), indent=1) + "\n")
        if not job.is_done:
            partial.rename(job.directory)
    except OSError:
        if not job.is_done:  # another worker may have been first
            raise
    finally:
        shutil.rmtree(partial, ignore_errors=True)


def truths(job: Job, stops: Sequence[int]) -> Iterator[Truth]:
    """The truth of every stop: the traced paths with the clock of the case."""
    biases_s = clock_biases_s(job.case.config, len(job.scene.stops))
    for stop in stops:
        yield replace(read_record(job.paths_file(stop), Truth), clock_bias_s=float(biases_s[stop]))


def _sweep(job: Job, truth: Truth) -> BeamSweep:
    stored = job.signal_file(truth.stop)
    if stored.is_file():
        return read_record(stored, BeamSweep)
    return observe(job.case.config, make_link(job.case.config), job.scene, truth)
