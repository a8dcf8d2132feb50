r"""Sections and their tables, and the ways to show them: text for a terminal, Markdown, CSV and LaTeX.

LaTeX is one `table` environment a table, for `\input` into a paper, and needs the package booktabs.
"""

from __future__ import annotations

import csv
import io
import math
import re
import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

WIDTH = 100
"""Columns that a terminal table may take."""

WIDEST = 40
"""A cell wider than this is wrapped."""

NARROWEST = 22
"""The last column is wrapped to what is left, but not below this."""

GAP = "  "


@dataclass(frozen=True)
class Table:
    """Cells as text.

    Args:
        title: stands above it.
        header: one name a column.
        rows: each as long as the header.
        left: columns set flush left; the others flush right.
        marked: (row, column) of cells to stand out, where that is possible.
        notes: sentences below it.
    """

    title: str
    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    left: frozenset[int] = frozenset({0})
    marked: frozenset[tuple[int, int]] = frozenset()
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class Section:
    """Part of the report: paragraphs, tables, and the records behind them, one mapping a row of the CSV file.

    `slug` names its files. `brief` are shorter tables that take the tables' place in a terminal, where they are given.
    """

    slug: str
    title: str
    paragraphs: tuple[str, ...] = ()
    tables: tuple[Table, ...] = ()
    records: tuple[Mapping[str, object], ...] = ()
    brief: tuple[Table, ...] = ()


def number(value: float | None, decimals: int = 3) -> str:
    """A number at fixed decimals; `-` for None."""
    return "-" if value is None else f"{value:.{decimals}f}"


def probability(p: float | None) -> str:
    """P to three digits, in powers of ten below 0.01; below 1e-300 it may be nothing but underflow."""
    if p is None:
        return "-"
    if p < 1e-300:
        return "< 1e-300"
    if p >= 0.01:
        return f"{p:.3f}"
    mantissa, _, exponent = f"{p:.2e}".partition("e")
    return f"{mantissa}e{int(exponent)}"


class Limits(Protocol):
    """Something with two ends, of which one may not be defined."""

    @property
    def low(self) -> float | None: ...

    @property
    def high(self) -> float | None: ...


def interval(limits: Limits | None, decimals: int = 3) -> str:
    """Both limits at fixed decimals; `-` where they are not defined."""
    if limits is None or limits.low is None or limits.high is None:
        return "-"
    return f"{limits.low:.{decimals}f} to {limits.high:.{decimals}f}"


def lacks_a_limit(limits: Limits | None) -> bool:
    """Whether an estimate is there and an end of its interval is not."""
    return limits is not None and (limits.low is None or limits.high is None)


def bayes_factor(log: float | None) -> str:
    """A Bayes factor from its natural logarithm, to three digits, in powers of ten where it is far from 1."""
    if log is None:
        return "-"
    if abs(log) < math.log(1000):
        return f"{math.exp(log):.3g}"
    exponent, rest = divmod(log / math.log(10), 1)
    digits, _, carried = f"{10**rest:.2e}".partition("e")
    return f"{digits}e{exponent + int(carried):.0f}"


def text(section: Section, width: int = WIDTH) -> str:
    """The section for a terminal, no line longer than `width`."""
    parts = [f"{section.title}\n{'=' * min(len(section.title), width)}"]
    parts += [textwrap.fill(paragraph, width) for paragraph in section.paragraphs]
    parts += [table_text(table, width) for table in section.brief or section.tables]
    return "\n\n".join(parts)


def table_text(table: Table, width: int = WIDTH) -> str:
    """One table for a terminal: long cells wrapped, and columns that do not fit put below, under the first again."""
    sizes = _sizes(table)
    blocks = []
    for columns in _blocks(sizes, width):
        widths = [sizes[column] for column in columns]
        widths[-1] = min(widths[-1], max(width - sum(widths[:-1]) - len(GAP) * (len(widths) - 1), 1))
        lines = [_line([table.header[c] for c in columns], columns, widths, table.left)]
        lines.append(GAP.join("-" * size for size in widths))
        lines += [_line([row[c] for c in columns], columns, widths, table.left) for row in table.rows]
        blocks.append("\n".join(lines))
    notes = "\n".join(textwrap.fill(note, width) for note in table.notes)
    title = textwrap.fill(table.title, width)
    return "\n".join(part for part in (title, "\n\n".join(blocks), notes) if part)


def markdown(section: Section, label: str) -> str:
    """The section as Markdown, below the dataset's label."""
    parts = [f"**{label}**"] if label else []
    parts += [f"## {section.title}", *section.paragraphs]
    for table in section.tables:
        if table.title:
            parts.append(f"### {table.title}")
        rule = "|".join(":--" if column in table.left else "--:" for column in range(len(table.header)))
        rows = [_markdown_row(table.header), f"|{rule}|", *map(_markdown_row, table.rows)]
        parts += ["\n".join(rows), *table.notes]
    return "\n\n".join(parts) + "\n"


def comma_separated(section: Section, label: str) -> str:
    """The records as CSV with full precision; the first column repeats the dataset's label."""
    columns = list(dict.fromkeys(key for record in section.records for key in record))
    file = io.StringIO()
    writer = csv.writer(file, lineterminator="\n")
    writer.writerow(["dataset", *columns])
    for record in section.records:
        cells = [record.get(column) for column in columns]
        writer.writerow([label or "measured", *("" if cell is None else cell for cell in cells)])
    return file.getvalue()


def _sizes(table: Table) -> list[int]:
    sizes = []
    for column, name in enumerate(table.header):
        cells = [name, *(row[column] for row in table.rows)]
        longest = max(1, *map(len, cells))
        sizes.append(longest if column == len(table.header) - 1 else min(longest, WIDEST))
    return sizes


def _blocks(sizes: Sequence[int], width: int) -> list[list[int]]:
    """Columns of each block: as many as fit beside the first; the table's last column may be narrowed to fit."""
    blocks, block, used = [], [0], sizes[0]
    for column in range(1, len(sizes)):
        last = column == len(sizes) - 1
        least = min(sizes[column], NARROWEST) if last else sizes[column]
        if used + len(GAP) + least > width and len(block) > 1:
            blocks.append(block)
            block, used = [0], sizes[0]
        block.append(column)
        used += len(GAP) + sizes[column]
    return [*blocks, block]


def _line(cells: Sequence[str], columns: Sequence[int], widths: Sequence[int], left: frozenset[int]) -> str:
    wrapped = [textwrap.wrap(cell, size) or [""] for cell, size in zip(cells, widths, strict=True)]
    lines = []
    for depth in range(max(map(len, wrapped))):
        parts = []
        for column, size, part in zip(columns, widths, wrapped, strict=True):
            cell = part[depth] if depth < len(part) else ""
            parts.append(cell.ljust(size) if column in left else cell.rjust(size))
        lines.append(GAP.join(parts).rstrip())
    return "\n".join(lines)


def _markdown_row(cells: Sequence[str]) -> str:
    return "| " + " | ".join(re.sub(r"([|*<\\])", r"\\\1", cell) for cell in cells) + " |"


SPECIAL = {
    "\\": r"\textbackslash{}",
    "&": r"\&",
    "%": r"\%",
    "$": r"\$",
    "#": r"\#",
    "_": r"\_",
    "{": r"\{",
    "}": r"\}",
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
    "±": r"$\pm$",
    "²": r"$^2$",
    "η": r"$\eta$",
    "√": r"$\surd$",
    "→": r"$\to$",
    "<": r"$<$",
    ">": r"$>$",
    "|": r"$|$",
}


def latex(section: Section, label: str) -> str:
    """The section's tables, each with the dataset's label in its caption; `label` is empty for a study's own data."""
    parts = [f"% {section.title}", *([f"% {label}"] if label else [])]
    return "\n".join([*parts, *(_table(table, section.title, label) for table in section.tables)]) + "\n"


def escaped(text: str) -> str:
    """Text in which every character stands for itself."""
    return "".join(SPECIAL.get(character, character) for character in text.replace("->", "→"))


def _table(table: Table, title: str, label: str) -> str:
    columns = "".join("l" if column in table.left else "r" for column in range(len(table.header)))
    caption = ". ".join(part for part in (label, table.title or title) if part)
    lines = [
        "",
        r"\begin{table}",
        rf"\caption{{{escaped(caption)}}}",
        rf"\begin{{tabular}}{{{columns}}}",
        r"\toprule",
        _row(table.header),
        r"\midrule",
        *map(_row, table.rows),
        r"\bottomrule",
        r"\end{tabular}",
    ]
    notes = [rf"\par\small {escaped(note)}" for note in table.notes]
    return "\n".join([*lines, *notes, r"\end{table}"])


def _row(cells: tuple[str, ...]) -> str:
    return " & ".join(map(escaped, cells)) + r" \\"


def plural(count: int, noun: str) -> str:
    """`1 trial`, `2 trials`."""
    return f"{count} {noun}{'s' * (count != 1)}"
