"""The campaign directory: which file holds what, and whether it still belongs to the campaign.

    campaign.json       resolved settings               scene.toml   the scene as it was
    scene_files/        floor plans and meshes that the scene names
    truth/stop_000.nc   paths, RX pose, clock           sweep/stop_000.nc    samples, when kept
    channel/stop_000.nc paths as estimated              map/NAME.nc  poses, incidence points, shapes, contours
    truth/stops_000-255.zip, channel/...                the same files of many stops: `shards.py`
    channel/calibration.nc  arrays as self-calibrated   channel/hall.nc  heights, classes, versions tied
    scores.json, provenance.nc, report.html, figures/

A measured campaign holds surveyed poses and labels in place of true paths. It has either sweeps, cut from
recordings, or channel estimates from elsewhere.

Every netCDF file carries the fingerprint of the settings, scene and code that made it. A file with another
fingerprint counts as missing, so an interrupted campaign resumes where it stopped and nothing stale is reused.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, TypeVar

from estimation.channel.beam_power_map import beam_power_map
from estimation.channel.calibration.record import Calibration
from estimation.channel.hall.record import HallEstimates
from estimation.channel.record import ChannelEstimate, EstimateStatus
from isac_arena.campaign.config import CampaignConfig
from isac_arena.campaign.files import (
    read_attribute,
    read_record,
    remove_file,
    remove_leftovers,
    write_bytes,
    write_json,
    write_record,
    write_text,
)
from isac_arena.campaign.integrity import code_digest, digest
from isac_arena.campaign.load import campaign_scene
from isac_arena.campaign.measured import MeasuredTruth
from isac_arena.campaign.results import MapName, MapResult, StopEstimate
from isac_arena.campaign.shards import Stored, places, stop_name
from isac_arena.scoring.metrics.metric import to_json
from isac_arena.scoring.record import ScoreTables
from isac_arena.scoring.score import Scores
from isac_arena.setting_differences import first_difference, line_difference
from isac_arena.user_functions.room import functions_digest
from scenes.inputs import LARGEST_TEXT, read_input
from scenes.names import path_in
from scenes.record import Record
from scenes.references import KEPT_FOLDER
from scenes.scene import Scene
from scenes.toml_config import read_text, validate_stored
from sim.config import SimulationConfig
from sim.observation import BeamSweep
from sim.propagation.deepmimo.folder import scenario_digest
from sim.signal.arrays.weights_file import weights_digest
from sim.truth import Truth

RESULTS = ("scores.json", "provenance.nc", "report.html")  # stale when anything before them changes
RECORDED = "samples of "  # start of `measured` where a campaign holds recorded sweeps
FAILED = " failed"  # end of the fingerprint of a stop at which a user's function failed
FOLDERS = ("truth", "sweep", "channel", "map", "figures")
R = TypeVar("R", bound=Record)


@dataclass(frozen=True)
class CampaignStore:
    """A campaign directory under one configuration and scene.

    `measured` names the source of a measured campaign, with a hash; None for a simulated one. `scene_files` holds
    the contents of the files that the scene names, by the path of their copies in the directory. With a `side`
    folder all files are written there, and those there are read first: see `swapped_in`.
    """

    directory: Path
    config: CampaignConfig
    scene_text: str
    measured: str | None = None
    scene_files: Mapping[str, bytes] = field(default_factory=dict)
    side: Path | None = None
    tx: str = ""  # _NAME of one of several: files of a stop are truth/stop_000_NAME.nc, and so on

    def of_tx(self, name: str) -> CampaignStore:
        """The same directory for the files of one TX."""
        return replace(self, tx=f"_{name}")

    @property
    def has_samples(self) -> bool:
        """Whether channel estimates are made here: a measured campaign may hold the estimates alone."""
        return self.measured is None or self.measured.startswith(RECORDED)

    @cached_property
    def scene(self) -> Scene:
        """The scene stored with the campaign."""
        return campaign_scene(self.config, self.directory / "scene.toml")

    @cached_property
    def truth_fingerprint(self) -> str:
        """Fingerprint of all inputs of the simulation, or of the measurement."""
        if self.measured is not None:
            return digest(self.measured, self._scene_digest)
        simulation = {name: getattr(self.config, name) for name in SimulationConfig.model_fields}
        simulation.pop("scene")  # its text counts, not its name
        settings = SimulationConfig.model_construct(**simulation, scene="-").model_dump_json()
        own = [one.array for _, one in sorted(self.config.transmitters.items()) if one.array is not None]
        arrays = (self.config.tx_array, self.config.rx_array, *own)
        weights = [weights_digest(array.weights_file) for array in arrays if array.weights_file is not None]
        paths = [] if (name := self.config.propagation.deepmimo) is None else [scenario_digest(name)]
        return digest(settings, self._scene_digest, code_digest("scenes", "sim"), *weights, *paths)

    @cached_property
    def channel_fingerprint(self) -> str:
        """Fingerprint of all inputs of the channel estimates."""
        if not self.has_samples:
            return self.truth_fingerprint
        estimator = functions_digest(self.config.functions, "channel") or [self.config.channel.model_dump_json()]
        code = code_digest(*(f"estimation/{part}" for part in ("channel", "inference", "laws", "execution.py")))
        return digest(self.truth_fingerprint, *estimator, code)

    @cached_property
    def map_fingerprint(self) -> str:
        """Fingerprint of all inputs of maps and shapes."""
        parts = {"mapping", "slam", "trajectory", "shapes", "contours", "tracks"}
        settings = self.config.model_dump_json(include=parts)
        code = code_digest(*(f"estimation/{part}" for part in ("slam", "shape", "tracks")))
        functions = functions_digest(self.config.functions, "mapping", "slam", "shapes", "tracker")
        return digest(self.channel_fingerprint, settings, *functions, code)

    @cached_property
    def score_fingerprint(self) -> str:
        """Fingerprint of all inputs of the scores."""
        return digest(self.map_fingerprint, code_digest("isac_arena/scoring"))

    def open_for_writing(self) -> None:
        """Write settings and scene; remove temporary files, and scores and report of other functions.

        Raises `ValueError` where the directory already holds another campaign, or files of no campaign.
        """
        is_new = not (self.directory / "campaign.json").exists()
        if is_new and self.directory.is_dir() and not self._is_leftover():
            raise ValueError(f"--out = {self.directory}: holds other files; choose an empty or a new directory")
        if (self.directory / "campaign.json").is_file() and (self.directory / "scene.toml").is_file():
            held = open_campaign(self.directory)
            if difference := self._difference(held):
                raise ValueError(
                    f"--out = {self.directory}: holds another campaign ({difference}); choose another "
                    "directory or remove it"
                )
            if held.config.functions != self.config.functions and self.side is None:
                self.drop_results()
        settings = {"measured": self.measured, "campaign": self.config.model_dump(mode="json")}
        for name, content in self.scene_files.items():
            write_bytes(self.root / path_in(Path(), name), content)
        write_text(self.root / "scene.toml", self.scene_text)
        write_json(self.root / "campaign.json", settings)
        for root in {self.directory, self.root}:
            for name in ("", *FOLDERS, KEPT_FOLDER):
                remove_leftovers(root / name)

    def truth(self, stop: int) -> Truth | None:
        """The truth of a stop, or None where there is none yet."""
        return self.read(self.stop_file("truth", stop), Truth, self.truth_fingerprint)

    def has_truth(self, stop: int) -> bool:
        """Whether the truth of a stop is stored."""
        return self.current(self.stop_file("truth", stop), self.truth_fingerprint) is not None

    def measured_truth(self, stop: int) -> MeasuredTruth | None:
        """What is known about a measured stop, or None where it was not imported."""
        return self.read(self.stop_file("truth", stop), MeasuredTruth, self.truth_fingerprint)

    def has_sweep(self, stop: int) -> bool:
        """Whether the samples of a stop are stored."""
        return self.current(self.stop_file("sweep", stop), self.truth_fingerprint) is not None

    def write_truth(self, truth: Truth | MeasuredTruth) -> None:
        """Store the truth of a stop; scores made before are dropped."""
        self.write(self.stop_file("truth", truth.stop), truth, self.truth_fingerprint)

    def sweep(self, stop: int) -> BeamSweep | None:
        """The samples of a stop, or None where they were not kept."""
        return self.read(self.stop_file("sweep", stop), BeamSweep, self.truth_fingerprint)

    def write_sweep(self, sweep: BeamSweep) -> None:
        """Store the samples of a stop."""
        self.write(self.stop_file("sweep", sweep.stop), sweep, self.truth_fingerprint)

    def channel(self, stop: int) -> StopEstimate | None:
        """The channel estimate of a stop, or that a user's function failed there; None where there is none yet."""
        name, found = self.stop_file("channel", stop), self.channel_fingerprint
        return self.read(name, StopEstimate, found) or self.read(name, StopEstimate, f"{found}{FAILED}")

    def has_channel(self, stop: int) -> bool:
        """Whether the channel estimate of a stop is stored; one that failed is tried again."""
        return self.current(self.stop_file("channel", stop), self.channel_fingerprint) is not None

    def write_channel(self, estimate: StopEstimate) -> None:
        """Store the channel estimate of a stop; scores made before are dropped."""
        mark = FAILED if estimate.channel.status == EstimateStatus.FAILED else ""
        self.write(self.stop_file("channel", estimate.channel.stop), estimate, f"{self.channel_fingerprint}{mark}")

    def estimate(self, stop: int) -> ChannelEstimate | None:
        """The paths of a stop alone, or None where there are none yet."""
        return None if (stored := self.channel(stop)) is None else stored.channel

    def write_estimate(self, estimate: ChannelEstimate, sweep: BeamSweep) -> None:
        """Store the channel estimate of a stop with the beam power map of its sweep; drops scores made before."""
        self.write_channel(StopEstimate(estimate, beam_power_map(sweep)))

    def calibration(self) -> Calibration | None:
        """What self-calibration found, or None where there is none yet."""
        return self.read(f"channel/calibration{self.tx}.nc", Calibration, self.channel_fingerprint)

    def write_calibration(self, calibration: Calibration) -> None:
        """Store what self-calibration found; scores made before are dropped."""
        self.write(f"channel/calibration{self.tx}.nc", calibration, self.channel_fingerprint)

    def hall(self) -> HallEstimates | None:
        """The hall and its paths, or None where there is none yet."""
        return self.read(f"channel/hall{self.tx}.nc", HallEstimates, self.channel_fingerprint)

    def write_hall(self, hall: HallEstimates) -> None:
        """Store the hall; scores made before are dropped."""
        self.write(f"channel/hall{self.tx}.nc", hall, self.channel_fingerprint)

    def map_result(self, name: MapName) -> MapResult | None:
        """The map of mapping or SLAM, or None where there is none yet."""
        return self.read(f"map/{name}.nc", MapResult, self.map_fingerprint)

    def write_map(self, name: MapName, result: MapResult) -> None:
        """Store the map of mapping or SLAM; scores made before are dropped."""
        self.write(f"map/{name}.nc", result, self.map_fingerprint)

    def score_tables(self) -> ScoreTables | None:
        """The tables behind the scores, or None where there are none yet."""
        return self.read("provenance.nc", ScoreTables, self.score_fingerprint)

    def write_scores(self, scores: Scores) -> None:
        """Store the tables behind the scores, then the metrics; a report made before is dropped."""
        self.write("provenance.nc", scores.tables, self.score_fingerprint)
        write_json(self.root / "scores.json", to_json(scores.metrics))

    def write_report(self, page: str, pictures: Mapping[str, bytes]) -> None:
        """Store the figures, then the page."""
        figures = self.root / "figures"
        for name, picture in pictures.items():
            write_bytes(path_in(figures, f"{name}.png"), picture)
        for old in figures.glob("*.png"):
            if old.stem not in pictures:
                remove_file(old)
        write_text(self.root / "report.html", page)

    def drop_results(self) -> None:
        """Remove scores and report, which an upstream change made stale."""
        for name in RESULTS:
            remove_file(self.root / name)

    def _difference(self, held: CampaignStore) -> str | None:
        """The first difference to the stored campaign, the user's functions excepted; None for none."""
        both = (store.config.model_dump(mode="json", exclude={"functions"}) for store in (held, self))
        if found := first_difference(*both):
            return found
        if held.measured != self.measured:
            return f"{held.measured or 'simulated'} there, {self.measured or 'simulated'} here"
        if held.scene_text != self.scene_text:
            return f"scene.toml{line_difference(held.scene_text, self.scene_text)}"
        names = {*held.scene_files, *self.scene_files}
        changed = sorted(name for name in names if held.scene_files.get(name) != self.scene_files.get(name))
        return f"{changed[0]} differs" if changed else None

    def stop_file(self, kind: str, stop: int) -> str:
        """Name of the file of a stop, with that of the TX where there are several; it may be in a shard."""
        return f"{kind}/{stop_name(stop, self.tx)}"

    @property
    def _scene_digest(self) -> str:
        contents = (hashlib.sha256(content).hexdigest() for _, content in sorted(self.scene_files.items()))
        return digest(self.scene_text, *contents)

    def _is_leftover(self) -> bool:
        """Whether all files here are of a run that was stopped at its start."""
        names = {entry.name for entry in self.directory.iterdir() if not entry.name.endswith(".part")}
        return names <= {"scene.toml", KEPT_FOLDER}

    @property
    def root(self) -> Path:
        """The folder that is written."""
        return self.directory if self.side is None else self.side

    def read(self, name: str, kind: type[R], fingerprint: str) -> R | None:
        """The record in a file with this fingerprint, None where there is none."""
        stored = self.current(name, fingerprint)
        return None if stored is None else read_record(stored, kind)

    def current(self, name: str, fingerprint: str) -> Stored | None:
        """The file of that name with this fingerprint; None where there is none."""
        for folder in dict.fromkeys((self.root, self.directory)):
            for stored in places(folder / name):
                if stored.is_file() and read_attribute(stored, "fingerprint") == fingerprint:
                    return stored
        return None

    def write(self, name: str, record: Record, fingerprint: str) -> None:
        """Store a record with its fingerprint; scores made before are dropped."""
        self.drop_results()
        write_record(self.root / name, record, {"title": self.config.name, "fingerprint": fingerprint})


def check_is_campaign(directory: Path) -> None:
    """Raise `ValueError`, one line, where a directory holds no campaign."""
    for name in ("campaign.json", "scene.toml"):
        if not (directory / name).is_file():
            raise ValueError(f"{directory}: holds no campaign (no {name}); make one with 'arena run'")


def stored_settings(content: Mapping[str, Any]) -> dict[str, Any]:
    """The campaign table of a stored campaign.json; versions before 0.3 named a user's estimator beside it."""
    settings = dict(content["campaign"])
    if name := content.get("estimator"):
        settings["functions"] = {"channel": {"function": name}}
    return settings


def open_campaign(directory: Path) -> CampaignStore:
    """The campaign in a directory, with the settings and the scene it was made with.

    Raises `ValueError` where the directory holds no campaign, or its settings are damaged.
    """
    check_is_campaign(directory)
    settings, text = directory / "campaign.json", read_text(directory / "scene.toml", "utf-8")
    try:
        content = json.loads(read_input(settings, LARGEST_TEXT))
        config = validate_stored(stored_settings(content), CampaignConfig, "settings")
        files = {
            f"{KEPT_FOLDER}/{file.name}": file.read_bytes()
            for file in sorted((directory / KEPT_FOLDER).glob("*"))
            if not file.name.endswith(".part")
        }
        return CampaignStore(directory, config, text, content.get("measured"), files)
    except (ValueError, LookupError, TypeError, AttributeError, RecursionError) as error:
        reason = (str(error).splitlines() or [type(error).__name__])[0]
        remedy = "put it back as it was, or run the campaign in a new directory"
        raise ValueError(f"{settings}: damaged, or of another version ({reason}); {remedy}") from error
