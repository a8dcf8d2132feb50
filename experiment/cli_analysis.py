"""The commands of the analyst's desk: export."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

analyst = typer.Typer()


@analyst.command(epilog="Example: palpate export participants/okamoto2012 --out okamoto2012-tables")
def export(
    datasets: Annotated[
        list[Path], typer.Argument(metavar="DATASET...", help="Folders of BIDS datasets; several: pooled.")
    ],
    out: Annotated[Path, typer.Option("--out", help="Folder of the tables, outside of the datasets.")],
) -> None:
    """Write tables for R, JASP and PsychoPy users.

    Tidy trials, counts in the long layout, one row a participant in the wide one, PsychoPy's columns, what was left
    out, and a dictionary of every column.
    """
    from analysis import export as exports

    for path in exports.export(datasets, out):
        typer.echo(path)
