"""The oracle is a writer of TOML that knows on which line it put each key."""

from __future__ import annotations

import json
import math
import tomllib
from collections.abc import Callable
from datetime import date, datetime
from typing import Any, TypeVar

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from palpate.experiment.settings.load import locate
from tests.experiment.protocol.small import SMALL, document, places

KEYS = st.sampled_from(["a", "b-1", "c_2", "0", "a b", "x.y", 'q"', "#", "=", "[t]", "ü", "", "line\nbreak", "'"])
TEXTS = st.sampled_from(
    [
        "",
        "plain",
        "# no comment",
        "a = 1",
        "[table]\n[[array]]\na = 1\n",
        '"""',
        "'''",
        'ends in quotes""',
        "ends in apostrophes''",
        "back\\slash",
        "trailing backslash \\",
        "], }, =",
    ]
)
SCALARS = st.one_of(
    st.integers(-5, 10**12),
    st.sampled_from([1.5, -2e-7, math.inf, True, False, date(2012, 4, 1), datetime(2012, 4, 1, 7, 32)]),
    TEXTS,
)
VALUES = st.recursive(
    SCALARS,
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(KEYS, inner, max_size=3),
    max_leaves=8,
)
DOCUMENTS = st.dictionaries(KEYS, VALUES | st.lists(st.dictionaries(KEYS, VALUES, max_size=3), max_size=3), max_size=5)

T = TypeVar("T")


class Writer:
    """Writes a document in one of the many ways that TOML allows, as `draw` chooses."""

    def __init__(self, draw: Callable[[st.SearchStrategy[Any]], Any]) -> None:
        self.draw = draw
        self.text = ""
        self.lines: dict[tuple[str | int, ...], int] = {}

    def choose(self, *options: T) -> T:
        chosen: T = self.draw(st.sampled_from(options))
        return chosen

    def mark(self, *path: str | int) -> None:
        self.lines.setdefault(path, self.text.count("\n") + 1)

    def blank(self) -> str:
        return self.choose("", " ", "\t")

    def lines_between(self) -> str:
        return self.choose("", "\n", "  # [no] = 'header'\n", "\n\n\t")

    def key(self, key: str) -> str:
        spellings = [json.dumps(key, ensure_ascii=self.choose(True, False))]
        if key and all(c.isascii() and (c.isalnum() or c in "-_") for c in key):
            spellings.append(key)
        if "'" not in key and "\n" not in key:
            spellings.append(f"'{key}'")
        return self.choose(*spellings)

    def string(self, text: str) -> str:
        escaped = text.replace("\\", "\\\\").replace('"""', '""\\"')
        spellings = [json.dumps(text), f'"""\n{escaped}"""', f'"""\\\n   {escaped}"""']
        if text[:1] in " \t\n":
            spellings.pop()
        if "'''" not in text:
            spellings.append(f"'''\n{text}'''")
        if "'" not in text and "\n" not in text:
            spellings.append(f"'{text}'")
        return self.choose(*spellings)

    def value(self, path: tuple[str | int, ...], value: Any) -> None:
        """A value after `=`, in a bracket, or as an element."""
        if isinstance(value, dict):
            self.text += "{" + self.blank()
            for i, (key, held) in enumerate(value.items()):
                self.text += ("," if i else "") + self.blank()
                self.pair(path, key, held)
            self.text += self.blank() + "}"
        elif isinstance(value, list):
            self.text += "[" + self.lines_between()
            for i, held in enumerate(value):
                self.mark(*path, i)
                self.value((*path, i), held)
                self.text += self.lines_between()
                if i < len(value) - 1 or self.choose(True, False):
                    self.text += "," + self.lines_between()
            self.text += "]"
        elif isinstance(value, str):
            self.text += self.string(value)
        elif isinstance(value, bool):
            self.text += str(value).lower()
        elif isinstance(value, datetime):
            self.text += value.isoformat(sep=self.choose(" ", "T"))
        elif isinstance(value, date):
            self.text += value.isoformat()
        else:
            self.text += repr(value)

    def pair(self, path: tuple[str | int, ...], key: str, value: Any) -> None:
        """`key = value`, or `key.inner = value` for a table of one key."""
        self.mark(*path, key)
        self.text += self.key(key)
        path = (*path, key)
        while isinstance(value, dict) and len(value) == 1 and self.choose(True, False):
            ((inner, value),) = value.items()
            self.text += self.blank() + "." + self.blank() + self.key(inner)
            path = (*path, inner)
            self.mark(*path)
        self.text += self.blank() + "=" + self.blank()
        self.value(path, value)

    def table(self, path: tuple[str | int, ...], header: str, table: dict[str, Any]) -> None:
        """The keys below a header, then the tables with headers of their own."""
        later = []
        for key, value in table.items():
            is_tables = isinstance(value, list) and value and all(isinstance(one, dict) for one in value)
            if (isinstance(value, dict) or is_tables) and self.choose(True, False):
                later.append((key, value))
                continue
            self.text += self.lines_between() + self.blank()
            self.pair(path, key, value)
            self.text += self.blank() + self.choose("\n", " # a comment with \"quotes' [\n")
        for key, value in later:
            name = f"{header}{self.blank()}.{self.blank()}" if header else ""
            name += self.key(key)
            if isinstance(value, dict):
                # A table that holds tables alone needs no header of its own.
                implied = bool(value) and all(isinstance(held, dict) for held in value.values())
                if implied and self.choose(True, False):
                    for inner, held in value.items():
                        self.header(f"[{name}.{self.key(inner)}]", (*path, key), (*path, key, inner))
                        self.table((*path, key, inner), f"{name}.{self.key(inner)}", held)
                    continue
                self.header(f"[{self.blank()}{name}{self.blank()}]", (*path, key))
                self.table((*path, key), name, value)
            else:
                for i, one in enumerate(value):
                    self.header(f"[[{name}]]", (*path, key), (*path, key, i))
                    self.table((*path, key, i), name, one)

    def header(self, text: str, *paths: tuple[str | int, ...]) -> None:
        self.text += self.lines_between() + self.blank()
        for path in paths:
            self.mark(*path)
        self.text += text + self.blank() + self.choose("\n", "# after\n")


@settings(max_examples=100)
@given(st.data())
def test_every_place_has_the_line_on_which_it_was_written(data: st.DataObject) -> None:
    written = data.draw(DOCUMENTS)
    writer = Writer(data.draw)
    writer.table((), "", written)
    text = writer.text.replace("\n", data.draw(st.sampled_from(["\n", "\r\n"])))
    assert tomllib.loads(text) == written
    assert locate(text) == writer.lines


def test_places_are_those_of_the_parsed_document() -> None:
    assert set(locate(SMALL)) == {path for path, _ in places(document())}


@pytest.mark.parametrize(
    ("text", "path", "line"),
    [
        ("[a.b]\nx = 1\n[a]\ny = 2", ("a",), 3),
        ("[[a]]\n[a.b]\n[[a]]\n[a.b]\nx = 1", ("a", 1, "b", "x"), 5),
        ("[[a]]\n[[a.b]]\n[[a.b]]\n[[a]]\n[[a.b]]", ("a", 0, "b", 1), 3),
        ("[[a]]\n[[a.b]]\n[[a.b]]\n[[a]]\n[[a.b]]", ("a", 1, "b", 0), 5),
        ('a = """\n"\n[b]\n"""\nb = 1', ("b",), 5),
        ("a.b.c = 1\na.b.d = 2", ("a", "b"), 1),
        ("a = [\n  [1, 2],\n  [\n    3]]", ("a", 1, 0), 4),
    ],
)
def test_examples_counted_by_hand(text: str, path: tuple[str | int, ...], line: int) -> None:
    assert locate(text)[path] == line
