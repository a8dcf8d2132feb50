"""Where each key and element of a TOML file stands: `tomllib` returns values without lines.

The text must be one that `tomllib` accepts, so this reads structure alone: headers, keys, and where values end.
"""

from __future__ import annotations

import re
import tomllib
from bisect import bisect_right

from experiment.protocol.rules import Path

_BLANK = re.compile(r"(?:[ \t\n]|#[^\n]*)*")
_KEY_PART = re.compile(r"[A-Za-z0-9_-]+|\"(?:[^\"\\\n]|\\.)*\"|'[^'\n]*'")
_DOT = re.compile(r"[ \t]*\.[ \t]*")
_STRING = re.compile(
    r'"""(?:[^\\]|\\.)*?"{3,5}(?!")'
    r"|'''.*?'{3,5}(?!')"
    r'|"(?:[^"\\\n]|\\.)*"'
    r"|'[^'\n]*'",
    re.DOTALL,
)
_BARE_VALUE = re.compile(r"[^,\]}#\n]+")


def locate(text: str) -> dict[Path, int]:
    """The line, from 1, on which each key, table and array element of a TOML text begins.

    A table has the line of its header, or of the first key that mentions it; an element of an array of tables the
    line of its own header. Keys are those of the parsed document, elements are numbered from 0.

    Args:
        text: a TOML text that `tomllib.loads` accepts.
    """
    return _Locator(text.replace("\r\n", "\n")).run()


class _Locator:
    def __init__(self, text: str) -> None:
        self._text = text
        self._at = 0
        self._newlines = [match.start() for match in re.finditer("\n", text)]
        self._lines: dict[Path, int] = {}
        self._elements: dict[Path, int] = {}
        self._headed: set[Path] = set()

    def run(self) -> dict[Path, int]:
        table: Path = ()
        while self._skip_blank() < len(self._text):
            if self._text[self._at] == "[":
                table = self._header()
            else:
                self._key_and_value(table)
        return self._lines

    def _line(self) -> int:
        return bisect_right(self._newlines, self._at) + 1

    def _skip_blank(self) -> int:
        self._take(_BLANK)
        return self._at

    def _take(self, pattern: re.Pattern[str]) -> str:
        match = pattern.match(self._text, self._at)
        if match is None:
            return ""
        self._at = match.end()
        return match.group()

    def _take_mark(self, mark: str) -> bool:
        self._skip_blank()
        if not self._text.startswith(mark, self._at):
            return False
        self._at += len(mark)
        return True

    def _key(self) -> tuple[str, ...]:
        parts = []
        while True:
            part = self._take(_KEY_PART)
            # Quoted keys hold escapes, which the parser itself decodes best.
            parts.append(next(iter(tomllib.loads(f"{part}=0"))))
            if not self._take(_DOT):
                return tuple(parts)

    def _header(self) -> Path:
        line = self._line()
        of_array = self._take_mark("[[")
        if not of_array:
            self._take_mark("[")
        self._skip_blank()
        *parents, last = self._key()
        self._take_mark("]]" if of_array else "]")
        path: Path = ()
        for part in parents:
            path = self._last_element((*path, part), line)
        path = (*path, last)
        if of_array:
            self._lines.setdefault(path, line)
            count = self._elements[path] = self._elements.get(path, 0) + 1
            path = (*path, count - 1)
        if path not in self._headed:
            self._headed.add(path)
            self._lines[path] = line
        return path

    def _last_element(self, path: Path, line: int) -> Path:
        """The table that a header's parent names: of an array of tables, its latest element."""
        self._lines.setdefault(path, line)
        return (*path, self._elements[path] - 1) if path in self._elements else path

    def _key_and_value(self, table: Path) -> None:
        line = self._line()
        path = table
        for part in self._key():
            path = (*path, part)
            self._lines.setdefault(path, line)
        self._take_mark("=")
        self._skip_blank()
        self._value(path)

    def _value(self, path: Path) -> None:
        if self._take_mark("["):
            count = 0
            while not self._take_mark("]"):
                self._lines[*path, count] = self._line()
                self._value((*path, count))
                self._take_mark(",")
                count += 1
        elif self._take_mark("{"):
            while not self._take_mark("}"):
                self._key_and_value(path)
                self._take_mark(",")
        elif not self._take(_STRING):
            self._take(_BARE_VALUE)
