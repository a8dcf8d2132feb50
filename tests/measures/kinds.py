"""Decisions by the kind of trial that are made outside of the kinds' own rooms: a new kind would change each.

Such a decision is a line that

- asks whether a protocol has the table of a kind or a design, or a study or task its `answers`, by `is None`,
- asks with `isinstance` or `case` whether something is of a class from a kind's room,
- reads `pairs` of a view, or compares a `kind` or `design` with the name of one,
- or is an entry of a table by the names of several kinds.
"""

from __future__ import annotations

import ast
from collections.abc import Iterator

from palpate.experiment.protocol import designs, kinds
from tests.measures.source import REPOSITORY, Source, is_inside, module_of

NAMES = frozenset(kinds.NAMES)
"""The kinds of trial as a protocol file names them."""

DESIGNS = frozenset(designs.NAMES)
"""The designs."""


def own_rooms(name: str) -> tuple[str, ...]:
    """Return the rooms, modules and files that a kind or a design has under its name."""
    return tuple(
        f"{room}/{name}{end}"
        for room in (
            "analysis/designs",
            "experiment/dataset/kinds",
            "experiment/protocol/designs",
            "experiment/protocol/kinds",
            "experiment/protocol/page/designs",
            "experiment/protocol/page/kinds",
            "experiment/records/kinds",
            "experiment/records/transcript",
            "experiment/rehearsal/designs",
            "experiment/rehearsal/kinds",
            "experiment/session/kinds",
        )
        for end in ("", ".py", ".json", ".toml")
        if (REPOSITORY / f"{room}/{name}{end}").exists()
    )


ROOMS = (
    *(room for name in sorted(NAMES | DESIGNS) for room in own_rooms(name)),
    "analysis/identification",
    "analysis/power/comparisons.py",
    "analysis/report/identification_sections.py",
)
"""Where a kind of trial, or what is asked in it, is at home."""

ABSENT = NAMES | DESIGNS | {"answers"}
"""What is None where a study is of another kind or design."""


def decisions(source: Source) -> Iterator[str]:
    """Yield the place of every line of a file outside of the kinds' rooms that decides by the kind of trial."""
    if is_inside(source.path, ROOMS):
        return
    classes = _kind_names(source)
    places = {found for node in source.nodes for found in _decision_lines(node, classes)}
    yield from (f"{source.path}:{line}" for line in sorted(places))


def _kind_names(source: Source) -> frozenset[str]:
    """Return the names under which a file imports something from a kind's room, or the room itself."""
    rooms = tuple(module_of(room) for room in ROOMS)
    return frozenset(
        each.asname or each.name
        for node in source.nodes
        if isinstance(node, ast.ImportFrom) and node.module
        for each in node.names
        if any(f"{node.module}.{each.name}.".startswith(f"{room}.") for room in rooms)
    )


def _decision_lines(node: ast.AST, classes: frozenset[str]) -> Iterator[int]:
    """Yield the line of a node that decides by the kind of trial, and of each key of a table by kinds."""
    match node:
        case ast.Compare(left=left, ops=[ast.Is() | ast.IsNot()], comparators=[ast.Constant(value=None)]):
            if _last_name(left) in ABSENT:
                yield node.lineno
        case ast.Compare(left=left, ops=[ast.Eq() | ast.NotEq()], comparators=[ast.Constant(value=str(name))]):
            if name in {"kind": NAMES, "design": DESIGNS}.get(_last_name(left).strip("_"), ()):
                yield node.lineno
        case ast.Call(func=ast.Name(id="isinstance"), args=[_, asked]):
            if any(isinstance(each, ast.Name) and each.id in classes for each in ast.walk(asked)):
                yield node.lineno
        case ast.MatchClass(cls=cls):
            if any(isinstance(each, ast.Name) and each.id in classes for each in ast.walk(cls)):
                yield node.lineno
        case ast.Attribute(value=value, attr="pairs"):
            if _last_name(value).strip("_") == "view":
                yield node.lineno
        case ast.Dict(keys=keys):
            named = [key for key in keys if isinstance(key, ast.Constant) and key.value in NAMES]
            if len(named) > 1:
                yield from (key.lineno for key in named)


def _last_name(node: ast.expr) -> str:
    """Return `kind` of `kind`, of `task.kind` and of `_kind(task)`."""
    match node:
        case ast.Name(id=name) | ast.Attribute(attr=name):
            return name
        case ast.Call(func=function):
            return _last_name(function)
    return ""
