"""Every setting of campaign, scene, sweep, data set and recording files, from the schemas that check them."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

from isac_arena.campaign.config import CampaignConfig
from isac_arena.datasets.config import DatasetConfig
from isac_arena.exchange.iq.config import RecordingFile
from isac_arena.sweep.config import SweepConfig
from scenes.config import SceneConfig
from scenes.toml_config import ConfigModel

FILES: dict[str, type[ConfigModel]] = {
    "campaign": CampaignConfig, "scene": SceneConfig, "sweep": SweepConfig, "dataset": DatasetConfig,
    "recording": RecordingFile,
}  # fmt: skip
UNITS = {
    "_s_m": "S/m", "_m2": "m²", "_dbm": "dBm", "_db": "dB", "_deg": "deg", "_ghz": "GHz", "_khz": "kHz",
    "_hz": "Hz", "_ns": "ns", "_us": "us", "_ppm": "ppm", "_deg_s": "deg/s", "_m_s": "m/s",
    "_m": "m", "_per_s": "1/s", "_s": "s",
}  # fmt: skip
LIMITS = {"minimum": "≥", "exclusiveMinimum": ">", "maximum": "≤", "exclusiveMaximum": "<"}
LARGEST_PLAIN = 2**31  # larger limits are powers of two
REQUIRED = "required"


@dataclass(frozen=True)
class Setting:
    """One field of a file: its default and what is allowed as people write them, its unit and what it does."""

    name: str
    default: str
    unit: str
    allowed: str
    meaning: str


@dataclass(frozen=True)
class SettingTable:
    """One table of a file by its TOML headings (none at the top), what it is, and its fields in order."""

    headings: tuple[str, ...]
    about: str
    settings: tuple[Setting, ...]
    is_optional: bool

    @property
    def heading(self) -> str:
        """The first heading, empty at the top."""
        return self.headings[0] if self.headings else ""

    @property
    def title(self) -> str:
        """Headings, and the type where tables of several types share them."""
        kind = next((row for row in self.settings if row.name == "type"), None)
        of_type = f", type {kind.allowed}" if kind else ""
        return (" or ".join(f"`{heading}`" for heading in self.headings) or "at the top of the file") + of_type

    @property
    def names(self) -> tuple[str, ...]:
        """The headings without brackets."""
        return tuple(heading.strip("[]") for heading in self.headings)

    def is_called(self, name: str | None) -> bool:
        """Whether this is the table of that name, or one inside it."""
        return any(one == name or one.startswith(f"{name}.") for one in self.names)


def setting_tables(file: str) -> list[SettingTable]:
    """All tables of a kind of file, one of `FILES`. A table of several types has an entry each."""
    schema = _schema(file)
    return list(_tables(schema, schema, "", {}, is_optional=False))


def merged_tables(file: str) -> list[SettingTable]:
    """The same with one entry for all headings of the same table."""
    found: list[SettingTable] = []
    for table in setting_tables(file):
        same = (one for one in found if (one.settings, one.about) == (table.settings, table.about))
        twin = next(same, None)
        if twin is None:
            found.append(table)
        else:
            found[found.index(twin)] = replace(twin, headings=(*twin.headings, *table.headings))
    return found


def settings_page() -> str:
    """The page of all settings in Markdown."""
    lines = ["# Every setting", "", PAGE_HEAD]
    for file in FILES:
        lines += ["", f"## {file.capitalize()} files"]
        for table in merged_tables(file):
            optional = " Off unless given." if table.is_optional else ""
            lines += ["", f"### {table.title[0].upper()}{table.title[1:]}", ""]
            lines += [table.about + optional, "", "| setting | default | unit | allowed | what it does |"]
            lines.append("|---|---|---|---|---|")
            for row in table.settings:
                cells = [f"`{row.name}`", _code(row.default), row.unit, row.allowed, row.meaning]
                lines.append(f"| {' | '.join(cell.replace('|', '/') for cell in cells)} |")
    return "\n".join(lines) + "\n"


PAGE_HEAD = """Made from the schemas that check the files; `arena settings` prints the same. A campaign file
needs a name and a scene, all other settings have defaults. Angles are in deg, azimuths counter-clockwise from +x.
A heading in double brackets, such as `[[objects]]`, may be given several times."""


@cache
def _schema(file: str) -> dict[str, Any]:
    return FILES[file].model_json_schema()


def _tables(
    root: Mapping[str, Any], node: Mapping[str, Any], heading: str, values: Mapping[str, Any], *, is_optional: bool
) -> Iterator[SettingTable]:
    """The table of a schema node with defaults from `values`, then the tables inside it."""
    rows: list[Setting] = []
    inner: list[tuple[Mapping[str, Any], str, Mapping[str, Any], bool]] = []
    for name, field in node["properties"].items():
        default = values[name] if name in values else field.get("default", REQUIRED)
        parts = list(_referenced(root, field))
        path = f"{heading.strip('[]')}.{name}".strip(".")
        is_off = default in (None, [], {}) and name not in node.get("required", [])
        for part, place in parts:
            inner.append((part, place.format(path), default if isinstance(default, dict) else {}, is_off))
        if not parts:
            rows.append(_setting(name, field, default))
    about = " ".join(node.get("description", "").partition("\n\n")[0].split())
    rows.sort(key=lambda row: row.name != "name")
    if heading or rows:
        yield SettingTable((heading,) if heading else (), about, tuple(rows), is_optional)
    for part, place, given, off in inner:
        yield from _tables(root, part, place, given, is_optional=off)


def _referenced(root: Mapping[str, Any], field: Mapping[str, Any]) -> Iterator[tuple[Mapping[str, Any], str]]:
    """Schemas of the tables that a field holds, and the form of their heading: one, a list of them, or by name."""
    for variant in _variants(field):
        table = root["$defs"][variant["$ref"].rpartition("/")[2]] if "$ref" in variant else {}
        if "properties" in table:  # else it holds any value
            yield table, "[{}]"
        for key, heading in (("items", "[[{}]]"), ("additionalProperties", "[{}.NAME]")):
            if isinstance(variant.get(key), dict):
                yield from ((part, heading) for part, _ in _referenced(root, variant[key]))


def _variants(field: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    """The alternatives of a field, null excepted."""
    options = field.get("anyOf") or field.get("oneOf")
    if options is None:
        return [field]
    return [one for option in options for one in _variants(option) if option.get("type") != "null"]


def _setting(name: str, field: Mapping[str, Any], default: Any) -> Setting:
    unit = next((unit for ending, unit in UNITS.items() if name.endswith(ending)), "-")
    meaning = field.get("description") or ("says what the table holds" if "const" in field else "")
    allowed = " or ".join(dict.fromkeys(filter(None, map(_allowed, _variants(field)))))
    return Setting(name, _toml(default), unit, allowed or "-", meaning)


def _allowed(variant: Mapping[str, Any]) -> str:
    """What a field may hold, in words and signs."""
    if "const" in variant:
        return f"`{variant['const']}`"
    if "enum" in variant:
        return ", ".join(f"`{value}`" for value in variant["enum"])
    kind = variant.get("type", "any value")
    if kind == "array":
        of = variant.get("items") or {}
        places = variant.get("prefixItems")
        if places:
            inner = _allowed(places[0])
            return f"{len(places)} numbers" + (f" {inner}" if inner not in ("number", "-") else "")
        return f"list of: {' or '.join(filter(None, map(_allowed, _variants(of))))}"
    limits = [f"{sign} {_number(variant[key])}" for key, sign in LIMITS.items() if key in variant]
    if "multipleOf" in variant:
        limits.append(f"a multiple of {variant['multipleOf']}")
    words = {"integer": "whole", "boolean": "`true`, `false`", "string": "text", "object": "table"}
    return " ".join(filter(None, [words.get(kind, "" if limits else kind), ", ".join(limits)]))


def _number(value: float) -> str:
    return f"2^{int(value).bit_length() - 1}" if value >= LARGEST_PLAIN else f"{value:.15g}"


def _toml(value: Any) -> str:
    """A default as TOML writes it, empty where there is none."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        return value if value == REQUIRED else f'"{value}"'
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(_toml, value))}]"
    return "none" if value is None else f"{value:.15g}" if isinstance(value, int) else repr(value)


def _code(text: str) -> str:
    return text if text in ("none", REQUIRED) else f"`{text}`"
