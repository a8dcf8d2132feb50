"""Errors and run times of methods: `python -m tests.methods FOLDER` takes them from what `palpate numerics` made.

They stand in `benchmarks/results/`. Errors and claims are checked by `tests/analysis/numerics/test_methods.py`; run
times belong to one machine.
"""

from __future__ import annotations

import csv
import sys
from pathlib import Path

FILES = tuple(Path(__file__).parent / "benchmarks" / "results" / name for name in ("methods.csv", "steppers.csv"))


def kept() -> tuple[list[list[str]], ...]:
    """Return the rows of each file, its header first."""
    return tuple(list(csv.reader(file.read_text("utf-8").splitlines())) for file in FILES)


def tables(text: str) -> tuple[list[list[str]], ...]:
    """Return the cells of each table in a Markdown text, its header among them and its rule left out."""
    found: list[list[list[str]]] = [[]]
    for line in text.splitlines():
        if not line.startswith("|"):
            found.append([])
        elif not line.startswith("|:--"):
            found[-1].append([cell.strip() for cell in line.strip("|").split(" | ")])
    return tuple(table for table in found if table)


def write(text: str) -> None:
    """Write the tables of a `methods.md` into their files."""
    for file, rows in zip(FILES, tables(text), strict=True):
        with file.open("w", encoding="utf-8", newline="") as out:
            csv.writer(out, lineterminator="\n").writerows(rows)


if __name__ == "__main__":
    write((Path(sys.argv[1]) / "methods.md").read_text("utf-8"))
