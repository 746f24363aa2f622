"""Hostile values for every field of a settings file, by its type, from its JSON schema: new fields come along."""

import math
from collections.abc import Iterator, Mapping
from typing import Any

Schema = Mapping[str, Any]

NUMBERS = (math.nan, math.inf, -math.inf, 1e308, -1e308, 5e-324, 1e12, -1e12, 0.0, -0.0, -1.0, 0.5)
INTEGERS = (0, -1, 2**31, 2**63 - 1, 2**63, 2**70, -(2**70))
TEXTS = (
    "", " ", "x", "..", "../../owned", "/tmp/owned/x", "a/b", "a\\b", "\x00", "a\x00b", "x" * 5000, "\u202eabc",
    "é\n", "/dev/zero", "/dev/stdin", "/proc/self/mem", ".", "~", "$(id)", "%s%n", "a.toml", "nan", "os:system",
)  # fmt: skip
OTHERS: tuple[Any, ...] = (True, "text", 3, 2.5, [], [[]], {}, {"a": {"b": []}}, [[[[[1.0]]]]], {"type": "circle"})
REFERENCES = {"material": "plasterboard", "itu": "wood", "base": "base.toml", "scene": "box_room", "metric": "x"}


def attacks(schema: Schema, root: Schema | None = None) -> Iterator[tuple[str, Any]]:
    """Dotted field and a document with one hostile value in it, for all fields and all values of a schema."""
    root = schema if root is None else root
    for kind in _variants(schema, root):
        for value in _hostile(kind):
            yield "", value
        base = example(kind, root)
        for name, field in kind.get("properties", {}).items():
            for path, value in attacks(field, root):
                yield f"{name}.{path}".rstrip("."), {**base, name: value}
        if isinstance(items := kind.get("items"), Mapping):
            for path, value in attacks(items, root):
                yield path, [value]
        if isinstance(others := kind.get("additionalProperties"), Mapping):
            for path, value in attacks(others, root):
                yield path, {"made": value}


def example(schema: Schema, root: Schema, name: str = "") -> Any:  # noqa: PLR0911
    """A small document that fits a schema."""
    if name in REFERENCES:
        return REFERENCES[name]
    kind = next(_variants(schema, root))
    if "const" in kind or "enum" in kind:
        return kind.get("const", kind.get("enum", [None])[0])
    match kind.get("type"):
        case "object":
            fields = kind.get("properties", {})
            return {each: example(fields[each], root, each) for each in kind.get("required", ())}
        case "array":
            items = kind.get("prefixItems") or [kind.get("items", {})] * kind.get("minItems", 1)
            return [example(each, root) for each in items]
        case "number" | "integer":
            low, high = kind.get("minimum", kind.get("exclusiveMinimum", 0)), kind.get("maximum", math.inf)
            value = min(low + 1, high)
            return int(value) if kind["type"] == "integer" else float(value)
        case "boolean":
            return False
        case _:
            return "x"


def _variants(schema: Schema, root: Schema) -> Iterator[Schema]:
    """A schema without references; all of them where it may be one of several, none for the empty one."""
    if "$ref" in schema:
        found: Any = root
        for part in schema["$ref"].removeprefix("#/").split("/"):
            found = found[part]
        yield from _variants(found, root)
    elif parts := schema.get("anyOf") or schema.get("oneOf") or schema.get("allOf"):
        for part in parts:
            yield from _variants(part, root)
    elif schema.get("type") != "null":
        yield schema


def _hostile(kind: Schema) -> Iterator[Any]:
    """Values at and beyond the borders of a type, and values of other types."""
    match kind.get("type"):
        case "number" | "integer":
            yield from NUMBERS
            yield from INTEGERS
            for border in ("minimum", "maximum", "exclusiveMinimum", "exclusiveMaximum"):
                if border in kind:
                    yield from (kind[border], kind[border] - 1, kind[border] + 1)
        case "string":
            yield from TEXTS
            yield from kind.get("enum", ())
        case "array":
            yield from ([0.0] * 10_000, [[0.0, 0.0]] * 3, [[1e308, 1e308]] * 4, [math.nan], [""])
            deep: Any = []
            for _ in range(50):
                deep = [deep]
            yield deep
        case "object":
            yield {"extra": 1}
    yield from OTHERS
