"""Every key of a protocol file and of a rig file: `python -m tests.keys` writes them into protocols/keys.md.

What a key means stands under `Attributes:` of its model, and what must hold between keys in the docstring of the
model's rules. Allowed values are those of palpate's own error messages, in short.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any, get_args, get_origin

from palpate.experiment.apparatus.rig import Rig
from palpate.experiment.protocol import designs, kinds
from palpate.experiment.protocol.designs import design_of
from palpate.experiment.protocol.files import ProtocolFile
from palpate.experiment.protocol.kinds import kind_of
from palpate.experiment.protocol.models import PlannedTest
from palpate.experiment.protocol.rules import pairs
from palpate.experiment.settings import load
from palpate.experiment.settings.load import VISIBLE, Confined, none
from palpate.experiment.settings.schema import meanings, summary

FILE = Path(__file__).parent.parent / "protocols" / "keys.md"

KINDS = {
    "text": f"text, not blank, {VISIBLE}",
    "text or none": f"text {VISIBLE}",
    "line": f"one line of text, not blank, {VISIBLE}",
    "name": f"one line of 1 to 40 characters that starts with a letter or digit, does not end with a space, "
    f"and contains no double quotes or right-to-left letters; {VISIBLE}",
    "label": "up to 32 lowercase letters and digits, starting with a letter (it becomes part of file names)",
    "key": "one ASCII character, but no capital letter or space",
    "date": "a date without quotes, such as 2012-04-01",
    "address": "host:port, such as 127.0.0.1:4711, with a separate port for each server",
    "column": "up to 32 lowercase letters, digits and _, starting with a letter (column heading)",
    "class": "package.module:Class for your own driver",
    "table file": "the name of a .csv file in the folder of the rig file",
    "hash": "64 hexadecimal digits, as sha256sum prints them",
    "PsychoPy key": "a key as PsychoPy names it: up, down, left, right, return, space, num_add, a, 1",
    "path": "a path, relative to the rig file's folder or, after ~/, to your home folder",
}
"""What stands for words of palpate's errors, which the head of the file repeats."""

SHORT = (
    (r"greater than (\S+) and at most ", r">\1,≤"),
    (r"greater than (\S+) and less than ", r">\1,<"),
    (r"at least (\S+) and less than ", r"≥\1,<"),
    (r"at least (\S+) and at most ", r"\1–"),
    ("greater than ", ">"),
    ("at least ", "≥"),
    ("at most ", "≤"),
    ("a whole number ", "int "),
    ("a number ?", ""),
    (r"an array of (\S+), each (.+)", r"\2 [\1]"),
    (r"an array, each (.+)", r"\1 []"),
    ("one of: ", ""),
    ("true or false", "yes/no"),
)

EVIDENT = ("line", "text or none", "yes/no")
"""Kinds that a default shows by itself."""

HEAD = f"""# Keys

Written by `python -m tests.keys`. `?` marks an optional key, `=` a default, `[≥2]` an array. Names end with units.
Clean text is text {VISIBLE}.
"""


def keys() -> str:
    """Return the whole file, in Markdown."""
    files = (("A protocol file", ProtocolFile), ("A rig file", Rig))
    kinds_of_value = "\\\n".join(
        f"*{name}*: {words.replace(f'text {VISIBLE}', 'clean text').replace(VISIBLE, 'clean')}"
        for name, words in KINDS.items()
    )
    parts = (f"## {title}\n\n" + "\n\n".join(_tables(model, model, (), {})) for title, model in files)
    return "\n\n".join([HEAD.rstrip(), kinds_of_value, *parts]) + "\n"


def _tables(
    root: type[Confined], model: type[Confined], path: tuple[str | int, ...], shown: dict[type[Confined], str]
) -> Iterator[str]:
    """Yield a list of the keys of a model, and one for each model that it holds, once for each model."""
    if model in shown:
        yield f"**{_header(path)}** As {shown[model]}."
        return
    if path:
        shown[model] = _header(path)
    said = meanings(model)
    rows: list[str] = []
    tables: list[str] = []
    inner: list[str] = []
    for name, field in model.model_fields.items():
        inside, many = held(field.annotation)
        place = (*path, name)
        optional = "" if field.is_required() or field.default not in (None, ()) else "?"
        if inside is not None:
            place = (*place, 0) if many else place
            inner += _tables(root, inside, place, shown)
            least = next((part.min_length for part in field.metadata if hasattr(part, "min_length")), 0)
            tables.append(f"{_header(place)}{optional}{f' (≥{least})' if least else ''}")
            continue
        default = "" if field.is_required() or optional else f"=`{json.dumps(field.default)}`"
        allowed = _shortened(load.field(root, place))
        stated = " ".join(part for part in ("" if default and allowed in EVIDENT else allowed, default) if part)
        rows.append(f"`{name}`{optional}: {said[name]}{f' ({stated})' if stated else ''}")
    rows += [f"Tables: {', '.join(tables)}"] if tables else []
    heading = f"**{_header(path)}** " if path else ""
    parts = [heading + summary(model), "\\\n".join(rows)]
    rules = [model.RULES] if model.RULES is not none else []
    if model is ProtocolFile:
        rules += [
            *(kind_of(name).rules for name in kinds.NAMES),
            *(design_of(name).rules for name in designs.NAMES),
            pairs,
        ]
    parts += [" ".join((rule.__doc__ or "").split()) for rule in rules]
    parts += ["\\\n".join(_planned_tests())] if model is PlannedTest else []
    yield "\n\n".join(parts)
    yield from inner


def _planned_tests() -> Iterator[str]:
    """Yield a line for each test that a design offers: the format it came with, and its keys."""
    for design in designs.NAMES:
        for name, test in design_of(design).tests.items():
            named = ", ".join([*(f"`{key}`" for key in test.needs), *(f"`{key}`?" for key in test.takes)])
            yield f"*{name}* ({design}, {test.since}){f': {named}' if named else ''}"


def held(annotation: Any) -> tuple[type[Confined] | None, bool]:
    """Return the model of a table or of an array of tables, and whether it is an array."""
    if isinstance(annotation, type) and issubclass(annotation, Confined):
        return annotation, False
    for argument in get_args(annotation):
        if isinstance(argument, type) and issubclass(argument, Confined):
            return argument, Ellipsis in get_args(annotation)
        if get_origin(argument) is tuple:
            return held(argument)
    return None, False


def _header(path: tuple[str | int, ...]) -> str:
    """Return how a table is opened in TOML, as code."""
    name = ".".join(part for part in path if isinstance(part, str))
    return f"`[[{name}]]`" if path[-1] == 0 else f"`[{name}]`"


def _shortened(allowed: str) -> str:
    for name, words in sorted(KINDS.items(), key=lambda item: -len(item[1])):
        allowed = allowed.replace(words, name)
    for long, short in SHORT:
        allowed = re.sub(long, short, allowed)
    return allowed


if __name__ == "__main__":
    FILE.write_text(keys(), "utf-8")
