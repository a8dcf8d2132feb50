"""Sections and figures -> the files of a folder of results, path within it -> content."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

from analysis.latex import latex
from analysis.report import Captions
from analysis.tables import Section, comma_separated, markdown

if TYPE_CHECKING:
    from analysis.figures import Sheet


def tables(parts: Iterable[Section], label: str, folder: str = "") -> dict[str, bytes]:
    """The records of every section as CSV, what it says as Markdown, and its tables as LaTeX, as far as it has them."""
    files: dict[str, str] = {}
    for part in parts:
        name = f"{folder}{part.slug}"
        if part.records:
            files[f"{name}.csv"] = comma_separated(part, label)
        if part.tables or part.paragraphs:
            files[f"{name}.md"] = markdown(part, label)
        if part.tables:
            files[f"{name}.tex"] = latex(part, label)
    return {name: content.encode() for name, content in files.items()}


def drawings(sheets: Iterable[Sheet], folder: str = "") -> dict[str, bytes]:
    """Every figure as SVG and as PNG."""
    from analysis import figures

    kinds = {"svg": figures.svg, "png": figures.png}
    return {f"{folder}{one.name}.{kind}": draw(one.figure) for one in sheets for kind, draw in kinds.items()}


def captions(sheets: Sequence[Sheet], methods: Sequence[tuple[str, str]]) -> Captions:
    """Where the figures stand in the report, what they show, and the formulas."""
    places = {one.name: one.section for one in sheets}
    return Captions(places, {one.name: one.caption for one in sheets}, tuple(methods))
