"""A share of the cases of a sweep computed again, and its tables against its cases."""

import json
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

import pyarrow as pa
import pyarrow.parquet as pq

from isac_arena.campaign.config import CampaignConfig
from isac_arena.campaign.directory import stored_settings
from isac_arena.campaign.files import read_record
from isac_arena.campaign.load import SceneSource
from isac_arena.scoring.metrics.metric import to_json
from isac_arena.scoring.record import ScoreTables
from isac_arena.sweep.cases import Case
from isac_arena.sweep.job import make_job, scene_file, store_scene
from isac_arena.sweep.run import check_case, score_case
from isac_arena.sweep.store import is_done, read_failures, read_plan, read_scores, read_sweep
from isac_arena.sweep.table import result_rows, write_tables
from isac_arena.verification.campaign import draw_share
from isac_arena.verification.compare import Finding, compare_metrics, compare_records
from scenes.names import path_in
from scenes.references import KEPT_FOLDER
from scenes.toml_config import validate_stored


def checked_tables(directory: Path) -> Iterator[Finding]:
    """Whether the tables hold the results of all cases, once each, and nothing else."""
    config, _ = read_sweep(directory)
    cases, failures = read_plan(directory), read_failures(directory)
    missing = [one.key for one in cases if not is_done(directory, one.key) and one.key not in failures]
    if missing:
        yield Finding(
            "cases", 0.0, reason=f"{len(missing)} of {len(cases)} are missing, the first is {missing[0]}"
        )
    try:
        rows = result_rows(directory, config, cases, failures)
    except ValueError as error:
        yield Finding("tables", 0.0, reason=str(error))
        return
    with TemporaryDirectory() as folder:
        write_tables(Path(folder), config, rows)
        folders = (directory, Path(folder))
        for name, read in (("results.csv", Path.read_bytes), ("results.parquet", pq.read_table)):
            try:
                stored, again = (read(each / name) for each in folders)
                same = bool(stored == again)
            except (OSError, ValueError, pa.ArrowException):
                same = False
            yield Finding(name, 0.0, reason="" if same else "does not hold what the cases hold")


def recomputed_cases(directory: Path, share: float, seed: int) -> Iterator[Finding]:
    """Findings of a share of the finished cases, from their scene to their scores; none for a share of 0."""
    done = [case.key for case in read_plan(directory) if is_done(directory, case.key)]
    if share == 0 or not done:
        return
    for index in draw_share(len(done), share, seed):
        try:
            yield from _recomputed(directory, done[index])
        except (ValueError, FileNotFoundError) as error:
            yield Finding(f"cases/{done[index]}", 0.0, reason=" ".join(str(error).split()))


def stored_case(directory: Path, key: str) -> Case:
    """A finished case with its scene; `ValueError`, one line, where its files are damaged or missing."""
    file = path_in(directory / "cases", key) / "campaign.json"
    try:
        settings = json.loads(file.read_text(encoding="utf-8"))
        scene = scene_file(directory, settings["scene"])
        kept = sorted((scene.parent / KEPT_FOLDER).glob("*"))
        source = SceneSource(
            scene.read_text(encoding="utf-8"), {f"{KEPT_FOLDER}/{item.name}": item.read_bytes() for item in kept}
        )
        case = Case(
            point=settings["point"],
            repeat=settings["repeat"],
            values=(),
            config=validate_stored(stored_settings(settings), CampaignConfig, "settings"),
            scene=source,
            stop_every=settings["stop_every"],
            stages=settings["stages"],
        )
    except (OSError, ValueError, KeyError, TypeError, RecursionError) as error:
        reason = " ".join(str(error).split())
        raise ValueError(f"{file}: missing or damaged, or its scene is ({reason})") from error
    if source.hash != settings["scene"]:
        raise ValueError(f"{scene.parent}: the scene was edited since its cases ran")
    return case


def _recomputed(directory: Path, key: str) -> Iterator[Finding]:
    case = stored_case(directory, key)
    scene = check_case(case)
    with TemporaryDirectory() as folder:
        store_scene(Path(folder), case.scene)
        job = make_job(case, Path(folder), len(scene.stops))
        scores = score_case(job)
    tables = read_record(path_in(directory / "cases", key) / "provenance.nc", ScoreTables)
    yield compare_records(f"cases/{key}/provenance.nc", tables, scores.tables)
    yield compare_metrics(f"cases/{key}/scores.json", read_scores(directory, key), to_json(scores.metrics))
