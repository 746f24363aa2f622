"""Typed TOML files. Every error is one line: FILE: field.path = value: allowed values."""

import json
import re
import tomllib
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from difflib import get_close_matches
from pathlib import Path
from typing import Annotated, Any, Self, TypeVar

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator
from pydantic_core import ErrorDetails, PydanticCustomError

from scenes.inputs import LARGEST_TEXT, InputError, read_input
from scenes.memory import MemoryLimitError
from scenes.pose import LARGEST_LENGTH_M

LONGEST_SHOWN_VALUE = 80
LARGEST_NUMBER = 1e12  # its square is far from the largest float
MAX_KEY_PARTS = 32
# Strings and comments of a TOML text, and a key of too many parts in what is left of it
STRINGS = re.compile(r'"""(?s:[^\\]|\\.)*?"""|"(?:[^"\\\n]|\\.)*+"|' + r"'''(?s:.)*?'''|'[^'\n]*+'|#[^\n]*+")
LONG_KEY = re.compile(rf"(?<![\w-])(?:[\w-]++[ \t]*+\.[ \t]*+){{{MAX_KEY_PARTS}}}")

# TOML arrays are read as lists: the tuple accepts a list, its elements stay strict
Pair = Annotated[tuple[float, float], Field(strict=False)]


class ConfigError(ValueError):
    """A configuration file has an error; the message is one line."""


@contextmanager
def naming_field(path: str, joint: str = ".") -> Iterator[None]:
    """Put the path of the field in front of the message of a `ValueError` raised inside."""
    try:
        yield
    except ValueError as error:
        raise ConfigError(f"{path}{joint}{error}") from error


class ConfigModel(BaseModel):
    """Base of all configuration tables: frozen, strict types, finite numbers, unknown keys are errors."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)

    @model_validator(mode="before")
    @classmethod
    def _refuse_unknown_keys(cls, data: Any) -> Any:
        unknown = [key for key in data if key not in cls.model_fields] if isinstance(data, dict) else []
        if unknown:
            allowed = [key for key in cls.model_fields if key not in data]
            close = get_close_matches(unknown[0], allowed, n=2)
            close = close or get_close_matches(unknown[0], cls.model_fields, n=2)  # a change to one that is there
            hint = f"did you mean {' or '.join(close)}?" if close else f"allowed: {', '.join(cls.model_fields)}"
            raise PydanticCustomError("unknown_key", "{hint}", {"hint": hint, "key": unknown[0]})
        return data

    @model_validator(mode="after")
    def _refuse_what_overflows(self) -> Self:
        for name, value in self:
            is_length = name.endswith("_m") and not name.endswith("_s_m")
            most = LARGEST_LENGTH_M if is_length else LARGEST_NUMBER
            for number in _floats(value):
                if abs(number) > most:
                    raise ValueError(f"{name} = {number:g}: must be within -{most:g} and {most:g}")
        return self


def _floats(value: Any) -> Iterator[float]:
    if isinstance(value, float):
        yield value
    elif isinstance(value, list | tuple):
        for item in value:
            yield from _floats(item)


M = TypeVar("M", bound=ConfigModel)


def load_config(path: str | Path, model: type[M]) -> M:
    """Read a TOML file into a typed model. Raises `ConfigError` (one line) for any error in the file."""
    return validate_config(read_toml(path), model, str(path))


def read_toml(path: str | Path) -> dict[str, Any]:
    """The tables of a TOML file. Raises `ConfigError` (one line) if it is missing or not valid TOML."""
    try:
        return parse_toml(read_input(path, LARGEST_TEXT).decode("utf-8"))
    except (InputError, MemoryLimitError) as error:
        raise ConfigError(str(error)) from error
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read ({error.strerror}); it must be a TOML file") from error
    except ValueError as error:  # TOML syntax or text that is not UTF-8
        raise ConfigError(f"{path}: not valid TOML: {_shortened(_syntax(_one_line(str(error))))}") from error


def _syntax(message: str) -> str:
    """The message of the parser; of a table that stands there twice, in words."""
    found = re.fullmatch(r"Cannot declare \((.*?),?\) twice \(at line (\d+).*\)", message)
    if not found:
        return message
    table = ".".join(re.findall(r"'([^']*)'", found[1]))
    return f"the table [{table}] is there again in line {found[2]}: keep only one"


def parse_toml(text: str) -> dict[str, Any]:
    """The tables of a TOML text.

    Raises `ValueError` for a key of more parts than any table is deep, whose cost is their square, and for nesting
    that is too deep.
    """
    if found := LONG_KEY.search(STRINGS.sub("s", text)):
        raise ValueError(f"the key {found[0][:20]}... has more than {MAX_KEY_PARTS} parts")
    try:
        return tomllib.loads(text.replace("\r\n", "\n"))
    except RecursionError:
        raise ValueError("nested too deep") from None


def read_text(path: str | Path, encoding: str = "utf-8-sig") -> str:
    """The text of a file. Raises `ConfigError` (one line) if it is missing or not UTF-8."""
    try:
        return read_input(path, LARGEST_TEXT).decode(encoding)
    except (InputError, MemoryLimitError) as error:
        raise ConfigError(str(error)) from error
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read ({error.strerror})") from error
    except ValueError as error:
        raise ConfigError(f"{path}: not UTF-8 text") from error


def validate_config(data: dict[str, Any], model: type[M], source: str) -> M:
    """Convert plain tables into a typed model; the `ConfigError` names the file `source`."""
    return _validated(data, model, source, model.model_validate)


def validate_stored(data: Any, model: type[M], source: str) -> M:
    """As `validate_config`, for tables that were stored as JSON, which has lists in place of tuples."""
    return _validated(data, model, source, lambda found: model.model_validate_json(json.dumps(found)))


def _validated(data: Any, model: type[M], source: str, validate: Callable[[Any], M]) -> M:
    try:
        return validate(data)
    except ValidationError as error:
        problems = error.errors(include_url=False)
        rest = len(problems) - 1
        more = f" (and {rest} more {'error' if rest == 1 else 'errors'})" if rest else ""
        message = f"{source}: {_sentence(problems[0], data)}{more}"
        raise ConfigError(message) from None  # its own traceback tells no more


def _sentence(problem: ErrorDetails, data: dict[str, Any]) -> str:
    path = _field_path(problem["loc"], data, is_missing=problem["type"] == "missing")
    context, value = problem.get("ctx", {}), problem["input"]
    message = _one_line(problem["msg"]).removeprefix("Value error, ").replace("Input should", "must")
    match problem["type"]:
        case "missing":
            return f"{path} is missing: it has no default, so it must be given"
        case "unknown_key":
            key = context["key"]
            return f"{_join(path, key)} = {_shown(value[key])}: unknown key; {message}"
        case "union_tag_not_found":
            return f"{_join(path, 'type')} is missing: it says what the table holds"
        case "union_tag_invalid":
            expected = context["expected_tags"].replace("'", "")
            return f"{_join(path, 'type')} = {_shown(context['tag'])}: must be one of {expected}"
        case "value_error" if isinstance(value, dict):
            return _join(path, message)
        case _:
            return f"{path} = {_shown(value)}: {message}"


def _field_path(location: Sequence[str | int], data: Any, *, is_missing: bool) -> str:
    """Dotted path of an error location. A table in a list is identified by its name if it has one."""
    path = ""
    for depth, part in enumerate(location):
        if isinstance(part, int) and isinstance(data, list) and part < len(data):
            data = data[part]
            name = data.get("name") if isinstance(data, dict) else None
            path += f"[{name}]" if isinstance(name, str) else f"[{part}]"
        elif isinstance(data, dict) and part in data:
            data = data[part]
            path = _join(path, str(part))
        elif is_missing and depth == len(location) - 1:
            path = _join(path, str(part)) if isinstance(part, str) else f"{path}[{part}]"
    return path


def _join(path: str, rest: str) -> str:
    return f"{path}.{rest}" if path else rest


def _shown(value: Any) -> str:
    return _shortened(_one_line(json.dumps(value, default=str, ensure_ascii=False)))


def _shortened(text: str) -> str:
    return text if len(text) <= LONGEST_SHOWN_VALUE else text[: LONGEST_SHOWN_VALUE - 3] + "..."


def _one_line(text: str) -> str:
    return " ".join(text.split())
