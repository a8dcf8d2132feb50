"""How large the house is and how its modules hang together: run `python -m tests.figures`."""

from __future__ import annotations

import subprocess
import sys
import tomllib
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import grimp

REPOSITORY = Path(__file__).parent.parent
PACKAGES = ("experiment", "analysis")

LINES = 60_000
"""31,500 when the house was redrawn; and what proofs of a dataset, exposure at every moment, texts that cannot deceive,
trackers that lie and files that fail, people who ask to be erased, what an experimenter notes and corrects, practice
without a laboratory, the status of a study, answers that are heard, the servo of a virtual block, the causes of a
wrong number in print, and tests in which a participant is the unit have added since. So have modules and imports: the
plan kept room for the desk, and had 165 and 800 without it; a module that outgrew its 500 lines is now several."""


@dataclass(frozen=True)
class Figure:
    """One figure of the house, and the most that it may be."""

    name: str
    found: int
    most: int
    where: tuple[str, ...] = ()
    """What makes it as large as it is, if that can be named."""

    @property
    def line(self) -> str:
        shown = f"{self.name:<46} {self.found:>7,} of at most {self.most:,}"
        return shown + (f": {'; '.join(self.where)}" if self.found > self.most and self.where else "")


def figures() -> tuple[Figure, ...]:
    """Return every figure: of the files that git tracks, and of the imports between modules."""
    sources = [path for path in _tracked() if path.suffix == ".py"]
    rooms = _rooms()
    largest = sorted(rooms, key=lambda room: rooms[room], reverse=True)
    inner = [room for room in largest if room not in PACKAGES]
    graph = grimp.build_graph("palpate", cache_dir=None)
    imports = {(one, other) for one in graph.modules for other in graph.find_modules_directly_imported_by(one)}
    return (
        Figure("modules of source", len(sources), 268),
        Figure("lines of source", sum(len((REPOSITORY / path).read_bytes().splitlines()) for path in sources), LINES),
        *(Figure(f"entries of {package}/", rooms[package], 16) for package in PACKAGES),
        Figure("entries of the largest room", rooms[inner[0]], 12, tuple(f"{r}: {rooms[r]}" for r in inner[:5])),
        Figure("imports from module to module", len(imports), 1_425),
        *(
            Figure(name, len(found), 0, tuple(sorted(found)))
            for name, found in (("circles of imports", _circles(imports)), ("arrows upward", _upward(imports)))
        ),
    )


def _tracked() -> list[Path]:
    listed = subprocess.run(
        ["git", "ls-files", "-z", *PACKAGES], cwd=REPOSITORY, capture_output=True, text=True, check=True
    )
    # What is deleted and not yet committed is no longer part of the house.
    return [Path(name) for name in listed.stdout.split("\0") if name and (REPOSITORY / name).exists()]


def _rooms() -> Counter[str]:
    """Return the number of modules, data files and rooms in every folder, by its path.

    The `__init__.py` that says what a room is for and its documents are no entries: nobody looks for a step there.
    """
    files = [path for path in _tracked() if path.name != "__init__.py" and path.suffix != ".md"]
    entries = {each for path in files for each in (path, *path.parents[:-1])}
    return Counter(each.parent.as_posix() for each in entries if each.parent != Path())


def _circles(imports: set[tuple[str, str]]) -> set[str]:
    """Return every set of modules of which each leads to each other one by its imports."""
    onward: dict[str, set[str]] = {}
    for one, other in imports:
        onward.setdefault(one, set()).add(other)
    reached = {module: _reached(module, onward) for module in onward}
    return {
        ", ".join(sorted({one} | {other for other in reached[one] if one in reached.get(other, set())}))
        for one in onward
        if one in reached[one]
    }


def _reached(module: str, onward: dict[str, set[str]]) -> set[str]:
    found: set[str] = set()
    ahead = list(onward[module])
    while ahead:
        if (one := ahead.pop()) not in found:
            found.add(one)
            ahead += onward.get(one, ())
    return found


def _upward(imports: set[tuple[str, str]]) -> set[str]:
    """Return the imports from a room to a higher one, or to one beside it, by the layers that import-linter is told."""
    with (REPOSITORY / "pyproject.toml").open("rb") as file:
        contracts = tomllib.load(file)["tool"]["importlinter"]["contracts"]
    floor: dict[str, int] = {}
    beside: set[tuple[str, str]] = set()
    for contract in contracts:
        if contract["type"] == "layers":
            (package,) = contract["containers"]
            for number, layer in enumerate(contract["layers"]):
                names = [f"{package}.{name.strip(' ()')}" for name in layer.replace(":", "|").split("|")]
                floor |= dict.fromkeys(names, number)
                if "|" in layer:
                    beside |= {(one, other) for one in names for other in names if one != other}

    def room(module: str) -> str:
        return ".".join(module.split(".")[:3])

    return {
        f"{one} -> {other}"
        for one, other in imports
        if one.split(".")[1:2] == other.split(".")[1:2]
        if room(one) in floor and room(other) in floor
        if floor[room(other)] < floor[room(one)] or (room(one), room(other)) in beside
    }


if __name__ == "__main__":
    found = figures()
    print("\n".join(figure.line for figure in found))
    sys.exit(any(figure.found > figure.most for figure in found))
