"""Everything that is wrong in a parsed file, at once: wrong types, missing and unknown keys, broken rules."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from datetime import date, time
from typing import Any, get_args

from pydantic import ValidationError

from experiment.errors import Problem
from experiment.protocol import allowed
from experiment.protocol.models import BROKEN_RULE, Confined
from experiment.protocol.rules import Path, Table, written

_MISSING = object()


def find(model: type[Confined], document: Table, lines: Mapping[Path, int]) -> tuple[Problem, ...]:
    """Every problem of `document` as a `model`, in the order of their lines.

    Args:
        model: what the document should be.
        document: tables, tuples and values, as the file states them.
        lines: line of each path in the file, as `locate` returns it.
    """
    found = {**dict(_broken_rules(model, document)), **dict(_invalid_fields(model, document))}
    problems = (
        Problem(written(path), _nearest(lines, path), _shown(_value(document, path)), words)
        for path, words in found.items()
    )
    return tuple(sorted(problems, key=lambda problem: (problem.line or 0, problem.path)))


def _invalid_fields(model: type[Confined], document: Table) -> Iterator[tuple[Path, str]]:
    try:
        model.model_validate(document)
    except ValidationError as error:
        for one in error.errors(include_url=False):
            path = one["loc"]
            # Only valid elements are counted there: an array with a bad one is called too short though it is not.
            if one["type"] == "too_short" and len(one["input"]) >= one["ctx"]["min_length"]:
                continue
            if one["type"] == "extra_forbidden":
                yield path, allowed.unknown_key(model, path)
            elif one["type"] != BROKEN_RULE:
                yield path, allowed.field(model, path)


def _broken_rules(model: type[Confined], value: object, at: Path = ()) -> Iterator[tuple[Path, str]]:
    if not isinstance(value, Mapping):
        return
    for broken in model.RULES(value):
        yield (*at, *broken.path), broken.allowed
    for name, field in model.model_fields.items():
        nested = _model_in(field.annotation)
        if nested is None:
            continue
        held = value.get(name)
        if isinstance(held, tuple):
            for i, element in enumerate(held):
                yield from _broken_rules(nested, element, (*at, name, i))
        else:
            yield from _broken_rules(nested, held, (*at, name))


def _model_in(annotation: Any) -> type[Confined] | None:
    """The model of a field's table or tables, if it holds any."""
    if isinstance(annotation, type) and issubclass(annotation, Confined):
        return annotation
    return next((model for argument in get_args(annotation) if (model := _model_in(argument))), None)


def _nearest(lines: Mapping[Path, int], path: Path) -> int | None:
    while path and path not in lines:
        path = path[:-1]
    return lines.get(path)


def _value(document: object, path: Path) -> object:
    for part in path:
        if isinstance(document, Mapping):
            document = document.get(part, _MISSING)
        elif isinstance(document, tuple) and isinstance(part, int):
            document = document[part]
        else:
            return _MISSING
    return document


def _shown(value: object) -> str:
    if value is _MISSING:
        return "nothing"
    if isinstance(value, Mapping):
        return "a table"
    if isinstance(value, tuple):
        return f"an array of {len(value)}"
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, date | time):
        return f"the date or time {value.isoformat()}"
    shown = f"'{value}'" if isinstance(value, str) else str(value)
    shown = " ".join(shown.split())
    return shown if len(shown) <= 60 else shown[:57] + "..."
