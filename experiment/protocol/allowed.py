"""What a field of a model may hold, in words for whoever writes the file."""

from __future__ import annotations

import difflib
import functools
from collections.abc import Iterable, Mapping
from typing import Any

from pydantic import BaseModel

from experiment.protocol.rules import Path

Schema = Mapping[str, Any]


def field(model: type[BaseModel], path: Path) -> str:
    """What the field at `path` inside a document of `model` may hold."""
    root = _schema(model)
    return _in_words(root, _follow(root, path))


def unknown_key(model: type[BaseModel], path: Path) -> str:
    """What may stand instead of the unknown key at the end of `path`."""
    root = _schema(model)
    known = sorted(_follow(root, path[:-1]).get("properties", {}))
    near = difflib.get_close_matches(str(path[-1]), known, n=1)
    suggestion = f"did you mean '{near[0]}'? " if near else ""
    return f"no such key; {suggestion}allowed keys: {', '.join(known)}"


@functools.cache
def _schema(model: type[BaseModel]) -> Schema:
    return model.model_json_schema()


def _resolve(root: Schema, schema: Schema) -> Schema:
    if "$ref" in schema:
        return _resolve(root, root["$defs"][schema["$ref"].rpartition("/")[2]])
    if "anyOf" in schema:
        (only,) = (option for option in schema["anyOf"] if option.get("type") != "null")
        return _resolve(root, only)
    return schema


def _follow(root: Schema, path: Path) -> Schema:
    schema = root
    for part in path:
        schema = _resolve(root, schema["items"] if isinstance(part, int) else schema["properties"][part])
    return schema


def _in_words(root: Schema, schema: Schema) -> str:
    match schema:
        case {"const": only}:
            return str(only)
        case {"enum": options}:
            return f"one of: {', '.join(map(str, options))}"
        case {"type": "string", "format": "date"}:
            return "a date without quotes, such as 2012-04-01"
        case {"type": "string"}:
            return str(schema.get("description", "text"))
        case {"type": "integer"}:
            return _number("a whole number", schema)
        case {"type": "number"}:
            return _number("a number", schema)
        case {"type": "boolean"}:
            return "true or false"
        case {"type": "array", "items": items}:
            least = schema.get("minItems", 0)
            count = f" of at least {least}" if least else ""
            return f"an array{count}, each {_in_words(root, _resolve(root, items))}"
        case {"properties": properties}:
            return f"a table with the keys: {', '.join(_required_first(schema, properties))}"
    raise NotImplementedError(f"no words for the schema {dict(schema)}")


def _number(noun: str, schema: Schema) -> str:
    bounds = (
        ("greater than", schema.get("exclusiveMinimum")),
        ("at least", schema.get("minimum")),
        ("less than", schema.get("exclusiveMaximum")),
        ("at most", schema.get("maximum")),
    )
    stated = " and ".join(f"{relation} {bound:.15g}" for relation, bound in bounds if bound is not None)
    return f"{noun} {stated}" if stated else noun


def _required_first(schema: Schema, properties: Iterable[str]) -> list[str]:
    required = schema.get("required", ())
    return [*required, *(f"{name} (optional)" for name in properties if name not in required)]
