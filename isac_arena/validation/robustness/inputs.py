"""Hostile settings and damaged input files: every attempt in a folder of its own."""

import random
import shutil
import tomllib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import tomli_w

from isac_arena.campaign import stages
from isac_arena.campaign.config import CampaignConfig
from isac_arena.sweep.config import SweepConfig
from isac_arena.sweep.plan import make_plan
from isac_arena.validation.robustness.attempt import Trial, attempt, call, command, tree
from isac_arena.validation.robustness.files import DAMAGES, write_inputs, write_tables
from isac_arena.validation.robustness.made import write_campaign
from isac_arena.validation.robustness.schemas import attacks
from scenes.config import SceneConfig
from scenes.toml_config import load_config
from sim.signal.link import make_link

OWNED = Path("/tmp/owned")  # where absolute names lead; nothing may appear there
Run = Callable[[], None]


def prepare_campaign(file: Path) -> None:
    """Read a campaign with its scene, make its beams, and open its directory."""
    make_link(stages.prepare(str(file), Path("out"), None).config)


def plan_sweep(file: Path) -> None:
    """Read a sweep and make all its cases."""
    config = load_config(file, SweepConfig)
    make_plan(str(file), config, Path("out"), range(config.repeats))


def hostile_settings() -> list[tuple[str, str, dict[str, Any]]]:
    """Kind, field and document of every attack on the settings of campaigns, scenes and sweeps.

    An attack on a field is laid over a valid document, so that what passes its type goes on to the code behind.
    """
    found = []
    valid = _valid_documents()
    for kind, model in (("campaign", CampaignConfig), ("scene", SceneConfig), ("sweep", SweepConfig)):
        for field, document in attacks(model.model_json_schema()):
            if not isinstance(document, dict):
                continue
            name = field.partition(".")[0]
            whole = {**valid[kind], name: document[name]} if name in document else {**valid[kind], **document}
            base = valid[kind].get(name)
            if isinstance(base, list) and isinstance(whole[name], list):
                whole[name] = [*base, *whole[name]]
            elif isinstance(base, dict) and isinstance(whole.get(name), dict) and kind == "scene":
                whole[name] = {**base, **whole[name]}
            found.append((kind, field, whole))
    return found


def _valid_documents() -> dict[str, dict[str, Any]]:
    from tempfile import TemporaryDirectory  # noqa: PLC0415

    with TemporaryDirectory() as folder:
        write_campaign(Path(folder))
        names = {"campaign": "small", "scene": "room", "sweep": "sweep"}
        return {
            kind: tomllib.loads((Path(folder) / f"{name}.toml").read_text(encoding="utf-8"))
            for kind, name in names.items()
        }


def try_settings(box: Path, rng: random.Random, count: int | None) -> Iterator[Trial]:
    """Attack the settings of a campaign, its scene and a sweep; all of them, or some."""
    documents = hostile_settings()
    if count is not None:
        documents = rng.sample(documents, count)
    for kind, field, document in documents:
        with Sandbox(box) as sandbox:
            file = sandbox.work / {"campaign": "small.toml", "scene": "room.toml", "sweep": "sweep.toml"}[kind]
            try:
                file.write_text(tomli_w.dumps(document), encoding="utf-8")
            except (TypeError, ValueError, RecursionError):  # no TOML can hold it
                continue
            run = {
                "campaign": call(prepare_campaign, file),
                "scene": command("scene", "export", "room.toml", "--format", "xml", "--out", "out"),
                "sweep": call(plan_sweep, file),
            }[kind]
            yield sandbox.attempt(f"{kind} {field} = {_shown(document, field)}", run)


def try_files(box: Path, rng: random.Random, count: int | None) -> Iterator[Trial]:
    """Damage every input file and read it with the command that its settings are for."""
    with Sandbox(box) as sandbox:
        settings = [*write_inputs(sandbox.work), *write_tables(sandbox.work)]
        kept = tree(sandbox.work)
    cases = [
        (name, file, damage)
        for name in settings
        for file in kept
        if _names(kept, name, file)
        for damage in DAMAGES
    ]
    for name, file, damage in cases if count is None else rng.sample(cases, count):
        with Sandbox(box) as sandbox:
            write_inputs(sandbox.work)
            write_tables(sandbox.work)
            content = DAMAGES[damage](kept[file], rng)
            (sandbox.work / file).unlink() if content is None else (sandbox.work / file).write_bytes(content)
            path = sandbox.work / name
            verbs = {
                "scene": command("scene", "export", name, "--format", "glb", "--out", "out/s.glb"),
                "paths": command("import-paths", name, "--out", "out", "--scene", "room.toml"),
            }
            run = verbs.get(name[:5], call(prepare_campaign, path))
            yield sandbox.attempt(f"{name}: {damage} {file}", run)


def _shown(document: dict[str, Any], field: str) -> str:
    return repr(document.get(field.partition(".")[0]))[:120]


def _names(kept: dict[str, bytes], name: str, file: str) -> bool:
    """Whether a settings file is, or names, a file."""
    return file == name or f'"{file}"'.encode() in kept[name]


class Sandbox:
    """A folder for one attempt, and a check that nothing appears outside its output folder."""

    def __init__(self, box: Path) -> None:
        self.box, self.work = box, box / "deep" / "er" / "work"

    def __enter__(self) -> "Sandbox":
        shutil.rmtree(self.box, ignore_errors=True)
        self.work.mkdir(parents=True)
        write_campaign(self.work)
        return self

    def __exit__(self, *error: object) -> None:
        shutil.rmtree(self.box, ignore_errors=True)

    def attempt(self, what: str, run: Run) -> Trial:
        """An attempt; its outcome is `outside` where a file appeared beside the output folder."""
        before = set(self.box.rglob("*"))
        made = attempt(what, run, self.work)
        own = {self.work.parent / f"{self.work.name}.{end}" for end in ("json", "err", "part")}
        new = set(self.box.rglob("*")) - before - own
        outside = sorted(file for file in new if file.is_file() and not file.is_relative_to(self.work / "out"))
        if outside or OWNED.exists():
            return Trial(made.what, "outside", str([*outside, OWNED][0]), made.peak_mb)
        return made
