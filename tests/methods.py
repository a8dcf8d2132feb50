"""The table of methods in tests/README.md: `python -m tests.methods FOLDER` takes it from what `palpate numerics` made.

Errors and claims in it are checked by `tests/analysis/numerics/test_methods.py`; run times belong to one machine.
"""

from __future__ import annotations

import sys
from pathlib import Path

README = Path(__file__).parent / "README.md"
BEGIN, END = "<!-- methods: written by python -m tests.methods -->", "<!-- end of methods -->"


def written(readme: str, methods: str) -> str:
    """Return the text of the README with the table that `methods.md` holds, without its title."""
    before, _, rest = readme.partition(BEGIN)
    _, _, after = rest.partition(END)
    tables = methods.partition("\n")[2].strip().replace("### ", "#### ")
    return f"{before}{BEGIN}\n\n{tables}\n\n{END}{after}"


def tables(readme: str) -> tuple[list[list[str]], ...]:
    """Return the cells of each table between the markers, its header among them and its rule left out."""
    _, _, rest = readme.partition(BEGIN)
    found: list[list[list[str]]] = [[]]
    for line in rest.partition(END)[0].splitlines():
        if not line.startswith("|"):
            found.append([])
        elif not line.startswith("|:--"):
            found[-1].append([cell.strip() for cell in line.strip("|").split(" | ")])
    return tuple(table for table in found if table)


if __name__ == "__main__":
    README.write_text(
        written(README.read_text("utf-8"), (Path(sys.argv[1]) / "methods.md").read_text("utf-8")), "utf-8"
    )
