"""The commands of the analyst's desk: export, audit."""

from __future__ import annotations

import json
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


@analyst.command(epilog="Example: palpate audit okamoto2012")
def audit(
    target: Annotated[
        str,
        typer.Argument(metavar="STUDY|FILE|DATASET", help="Id of a shipped study, TOML of printed numbers, or folder."),
    ],
    against: Annotated[
        Path | None, typer.Option("--against", help="For a dataset: TOML of its paper; by default by its study's id.")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON document and nothing else.")] = False,
) -> None:
    """Do printed numbers agree with one another, or with a dataset?

    Recomputes every statistic as the interval that rounding or truncation of the other numbers allows, asks whether
    whole counts can stand behind means, SDs and rows, and names the simplest mistake that gives a number that
    disagrees. A disagreement is a finding, not an error: the exit code is 0.
    """
    from analysis import audit as audits

    result = audits.audit(target, against)
    if as_json:
        typer.echo(json.dumps(result.as_dict(), indent=2, ensure_ascii=False, allow_nan=False))
    else:
        typer.echo(result.text())
