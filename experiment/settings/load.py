"""Read a settings file as its model, or refuse it with every problem at once."""

from __future__ import annotations

import difflib
import re
import tomllib
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any, TypeVar

from experiment.errors import Problem, ProtocolError
from experiment.settings import model as models
from experiment.settings import problems
from experiment.settings.problems import locate

Model = TypeVar("Model", bound=models.Confined)


def read(path: Path, model: type[Model]) -> Model:
    """Read the TOML file at `path` as a `model`.

    Raises:
        ProtocolError: with every problem of the file; of its syntax, the first.
    """
    return checked(path, model, *parsed(path))


def parsed(path: Path) -> tuple[dict[str, Any], Mapping[models.Path, int]]:
    """Return the document of the TOML file at `path`, and the line of each path in it.

    Raises:
        ProtocolError: with the first problem of its syntax.
    """
    text = _text(path)
    return _document(path, text), locate(text)


def checked(
    path: Path, model: type[Model], document: Mapping[str, Any], lines: Mapping[models.Path, int] = MappingProxyType({})
) -> Model:
    """Return `document` as a `model`.

    Args:
        path: the file that holds it, or will.
        model: what it should be.
        document: tables, arrays and values as a TOML parser returns them.
        lines: the line of each path in the file, as far as known.

    Raises:
        ProtocolError: with every problem of the document.
    """
    frozen = _frozen(document)
    found = problems.find(model, frozen, lines)
    if found:
        raise ProtocolError(str(path), found)
    return model.model_validate(frozen)


def _text(path: Path) -> str:
    if path.is_dir():
        raise ProtocolError(str(path), [Problem("file", None, "a folder", _existing(path / "protocol.toml"))])
    try:
        data = path.read_bytes()
    except FileNotFoundError as error:
        raise ProtocolError(str(path), [Problem("file", None, "no such file", _existing(path))]) from error
    except OSError as error:
        got = f"a file that cannot be read ({error.strerror})"
        raise ProtocolError(str(path), [Problem("file", None, got, "a TOML file that you may read")]) from error
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        before = data[: error.start]
        column = error.start - (before.rfind(b"\n") + 1) + 1
        raise ProtocolError(
            str(path),
            [
                Problem(
                    f"byte {column} of the line",
                    before.count(b"\n") + 1,
                    f"the byte 0x{data[error.start]:02x}, which is no UTF-8",
                    "UTF-8 text; save the file in that encoding",
                )
            ],
        ) from error


def _existing(path: Path) -> str:
    files = sorted(file.name for file in path.parent.glob("*.toml")) if path.parent.is_dir() else []
    near = difflib.get_close_matches(path.name, files, n=1)
    suggestion = f"; did you mean {path.parent / near[0]}?" if near else ""
    return f"the path of a TOML file{suggestion}"


def _document(path: Path, text: str) -> dict[str, Any]:
    try:
        return tomllib.loads(text)
    except (ValueError, RecursionError) as error:
        # Before Python 3.14 the position stands in the message alone; numbers of absurd length have none.
        message, line, column, lines = str(error), None, None, text.split("\n")
        if place := re.search(r" \(at (?:line (\d+), column (\d+)|end of document)\)$", message):
            message = message[: place.start()]
            line = int(place[1]) if place[1] else len(lines)
            column = int(place[2]) if place[2] else len(lines[-1]) + 1
        got = f"'{lines[line - 1].strip()[:60]}'" if line else "text that cannot be parsed"
        where = f"column {column}" if column else "file"
        raise ProtocolError(str(path), [Problem(where, line, got, f"TOML; {message}; mend this first")]) from error


def _frozen(value: Any) -> Any:
    """Arrays as tuples, which strict models ask for; every other type stays what TOML says it is."""
    if isinstance(value, dict):
        return {key: _frozen(held) for key, held in value.items()}
    if isinstance(value, list):
        return tuple(_frozen(held) for held in value)
    return value
