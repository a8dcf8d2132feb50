"""The source as the figures read it: which files there are, and each with its module and its syntax tree."""

from __future__ import annotations

import ast
import subprocess
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path, PurePosixPath

REPOSITORY = Path(__file__).parent.parent.parent
PACKAGE = "palpate"
FOLDERS = ("experiment", "analysis")
"""The folders of the repository that are subpackages of `PACKAGE`."""


@dataclass(frozen=True)
class Source:
    """One Python file."""

    path: str
    """From the root of the repository, with slashes."""
    text: str

    @property
    def lines(self) -> int:
        return len(self.text.splitlines())

    @cached_property
    def module(self) -> str:
        return module_of(self.path)

    @cached_property
    def tree(self) -> ast.Module:
        return ast.parse(self.text)

    @cached_property
    def nodes(self) -> tuple[ast.AST, ...]:
        """Every node of the tree."""
        return tuple(ast.walk(self.tree))

    def place(self, node: ast.expr | ast.stmt | ast.pattern) -> str:
        """Return where a node begins, as `path:line`."""
        return f"{self.path}:{node.lineno}"


def module_of(path: str) -> str:
    """Return the dotted name of the module or the room at a path."""
    parts = PurePosixPath(path).with_suffix("").parts
    return ".".join((PACKAGE, *(parts[:-1] if parts[-1] == "__init__" else parts)))


def is_inside(path: str, rooms: Iterable[str]) -> bool:
    """Return whether a path is one of the rooms or modules, or in one of them."""
    return any(path == room or path.startswith(f"{room}/") for room in rooms)


def tracked_files(*folders: str) -> list[Path]:
    """Return the paths of the files of some folders that git tracks and that are there, from the repository's root."""
    listed = subprocess.run(
        ["git", "ls-files", "-z", *folders], cwd=REPOSITORY, capture_output=True, text=True, check=True
    )
    # What is deleted and not yet committed is no longer part of the house.
    return [Path(name) for name in listed.stdout.split("\0") if name and (REPOSITORY / name).is_file()]


def read_sources(paths: Iterable[Path]) -> tuple[Source, ...]:
    """Return the Python files among the paths."""
    return tuple(
        Source(path.as_posix(), (REPOSITORY / path).read_text("utf-8")) for path in paths if path.suffix == ".py"
    )


def entries(paths: Iterable[Path]) -> Counter[str]:
    """Return the number of modules, data files and rooms in every folder, by its path.

    The `__init__.py` that says what a room is for and its documents are no entries: nobody looks for a step there.
    """
    files = [path for path in paths if path.name != "__init__.py" and path.suffix != ".md"]
    found = {each for path in files for each in (path, *path.parents[:-1])}
    return Counter(each.parent.as_posix() for each in found if each.parent != Path())
