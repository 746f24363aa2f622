"""Campaign files: found by library name or path, with the scene they name, and with some fields changed."""

import copy
import hashlib
import re
import tempfile
import tomllib
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import tomli_w

from isac_arena.campaign.config import CampaignConfig, with_link_levels
from isac_arena.campaign.files import write_bytes
from isac_arena.campaign.integrity import digest
from scenes.arguments import need
from scenes.config import LIBRARY as SCENES
from scenes.config import SceneConfig, load_scene, referenced_contents, scene_path, with_base
from scenes.names import path_in
from scenes.scene import Scene
from scenes.toml_config import ConfigError, load_config, naming_field, read_text, validate_config
from sim.links import tx_links, with_link_stops
from sim.transmitters import ALL, first_tx

LIBRARY = Path(__file__).parent / "library"
FIELD = re.compile(r"[\w.]+(\[[^]]*\][\w.]*)*( = | is missing|: | reaches)")  # at the start of a message


@dataclass(frozen=True)
class SceneSource:
    """The text of a scene file, and the contents of the files that it names by the names of their copies.

    `file` is the scene file where there is one with this text.
    """

    text: str
    files: Mapping[str, bytes]
    file: Path | None = None

    @cached_property
    def hash(self) -> str:
        """Hash of the scene file and of the files it names: the name of the scene in a sweep."""
        contents = sorted(f"{name} {hashlib.sha256(data).hexdigest()}" for name, data in self.files.items())
        return digest(self.text, *contents)

    def write(self, folder: Path) -> Path:
        """Write the scene file into a folder, after the files it names; returns its path."""
        for name, data in self.files.items():
            write_bytes(path_in(folder, name), data)
        file = folder / "scene.toml"
        write_bytes(file, self.text.encode())
        return file

    def build(self, config: CampaignConfig) -> Scene:
        """The scene as `campaign_scene` makes it; a `ValueError` names the scene file where there is one."""
        if self.file is not None:
            return campaign_scene(config, self.file)
        with tempfile.TemporaryDirectory() as folder:
            file = self.write(Path(folder))
            try:
                return campaign_scene(config, file)
            except ValueError as error:
                message = str(error).removeprefix(f"{file}: ")
                raise ValueError(f"scene.{message}" if FIELD.match(message) else message) from error


def read_scene_source(file: Path) -> SceneSource:
    """A scene file with the files that it names; `ConfigError` where one is missing or wrong."""
    text, config = read_text(file), load_config(file, SceneConfig)
    with naming_field(str(file), ": "):
        files = referenced_contents(config, file.parent)
    tables = tomllib.loads(text)
    if "base" in tables:  # the whole scene, as it is now
        return SceneSource(tomli_w.dumps(with_base(tables)), files)
    return SceneSource(text, files, file)


def python_scene_source(tables: Mapping[str, Any]) -> SceneSource:
    """The tables of a scene file made in Python, with the files that they name in the working folder."""
    config = validate_config(dict(tables), SceneConfig, "scene")
    return SceneSource(tomli_w.dumps(dict(tables)), referenced_contents(config, Path()))


def changed_campaign(
    document: Mapping[str, Any],
    path: Path,
    changes: Iterable[tuple[str, Any]],
    scene_of: Callable[[Path], SceneSource] = read_scene_source,
) -> tuple[CampaignConfig, SceneSource]:
    """Settings and scene of the campaign in the tables of a file at `path`, with some fields changed.

    A field is a dotted path into the campaign, or after `scene.` into its scene file; tables in a list have names.

    Raises `ConfigError` as `load_campaign` does.
    """
    changed, changes = copy.deepcopy(dict(document)), list(changes)
    in_scene = [(field, value) for field, value in changes if field.startswith("scene.")]
    for field, value in changes:
        if not field.startswith("scene."):
            put_field(changed, field, value)
    config, scene_file = resolve_campaign(changed, path)
    scene = scene_of(scene_file)
    if in_scene:
        tables = before = tomllib.loads(scene.text)
        for field, value in in_scene:
            tried = {"scene": copy.deepcopy(tables)}
            put_field(tried, field, value)
            if not _is_same_scene(tried["scene"], tables):
                tables = tried["scene"]
        if tables is not before:
            scene = replace(scene, text=tomli_w.dumps(tables), file=None)
    return config, scene


def _is_same_scene(changed: dict[str, Any], tables: dict[str, Any]) -> bool:
    """Whether two scene files mean the same: a default may be written out, or not."""
    if changed == tables:
        return True
    try:
        one, other = (validate_config(each, SceneConfig, "scene") for each in (changed, tables))
    except ConfigError:  # told where the scene is built
        return False
    return bool(one == other)


def put_field(document: dict[str, Any], field: str, value: Any) -> None:
    """Set a dotted path in nested tables; tables of a list have names or numbers. Missing tables are made."""
    *parents, last = field.split(".")
    here: Any = document
    for part in parents:
        here = here.setdefault(part, {}) if isinstance(here, dict) else here[_index(here, part, field)]
        if not isinstance(here, dict | list):
            raise ConfigError(f"field = '{field}': '{part}' is a value, not a table")
    if isinstance(here, dict):
        here[last] = copy.deepcopy(value)
    else:
        here[_index(here, last, field)] = copy.deepcopy(value)


def _index(items: list[Any], part: str, field: str) -> int:
    names = [item.get("name") if isinstance(item, dict) else None for item in items]
    if part in names:
        return names.index(part)
    if part.isdecimal() and int(part) < len(items):
        return int(part)
    known = ", ".join(str(name) for name in names if name) or f"0 to {len(items) - 1}"
    raise ConfigError(f"field = '{field}': there is no '{part}'; allowed: {known}")


def resolve_campaign(document: dict[str, Any], path: Path) -> tuple[CampaignConfig, Path]:
    """The settings in the tables of a campaign file at `path`, and the file of its scene.

    Raises `ConfigError` as `load_campaign` does.
    """
    config = validate_config(document, CampaignConfig, str(path))
    for device in ("tx_array", "rx_array"):
        array = getattr(config, device)
        if array.weights_file is not None:
            file = str((path.parent / array.weights_file).resolve())
            config = config.model_copy(update={device: array.model_copy(update={"weights_file": file})})
    if config.propagation.deepmimo is not None:
        folder = str((path.parent / config.propagation.deepmimo).resolve())
        propagation = config.propagation.model_copy(update={"deepmimo": folder})
        config = config.model_copy(update={"propagation": propagation})
    try:
        config = with_link_levels(config)
    except (ValueError, OSError) as error:  # a file of weights, or arrays that are too large
        raise ConfigError(f"{path}: {error}") from error
    is_file = config.scene.endswith(".toml")
    return config, path.parent / config.scene if is_file else scene_path(config.scene)


def campaign_scene(config: CampaignConfig, scene_file: Path) -> Scene:
    """The scene of a campaign, materials at its carrier, with the TX and the walk that it names in use.

    Of several TX the first is in use. Raises `ConfigError` where the scene file is wrong, `ValueError` where it
    has no TX or walk of that name and as `sim.links.tx_links` does.
    """
    need("config", config, CampaignConfig)
    need("scene_file", scene_file, Path)
    scene = scene_in_use(scene_file, config.waveform.carrier_ghz, first_tx(config), config.walk)
    scene = with_link_stops(config, scene)
    tx_links(config, scene)
    return scene


def scene_in_use(scene_file: Path, carrier_ghz: float, tx: str | None, walk: str | Sequence[str] | None) -> Scene:
    """A scene, materials at a carrier, with a TX and a walk (or walks) by name in use, or its first ones.

    Raises as `campaign_scene` does.
    """
    scene = load_scene(scene_file, carrier_ghz * 1e9)
    is_all = tx == ALL and ALL not in scene.txs
    return scene.choose(0 if is_all else tx or 0, walk or 0)


def campaign_path(name_or_path: str) -> Path:
    """The file of a campaign: a name of the library, or the path of a TOML file."""
    if name_or_path.endswith(".toml"):
        return Path(name_or_path)
    if name_or_path not in library_campaigns():
        known = ", ".join(library_campaigns())
        raise ConfigError(f"campaign = '{name_or_path}': must be one of {known}, or the path of a .toml file")
    return LIBRARY / f"{name_or_path}.toml"


def without_library_paths(message: str) -> str:
    """A message with the names of campaigns and scenes of the library in place of their files."""
    for folder, what in ((LIBRARY, "campaign"), (SCENES, "scene")):
        message = re.sub(rf"{re.escape(str(folder))}/(\w+)\.toml", rf"{what} \1", message)
    return message


def library_campaigns() -> list[str]:
    """Names of the campaigns that come with the project."""
    return sorted(file.stem for file in LIBRARY.glob("*.toml"))
