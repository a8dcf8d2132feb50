r"""Sections, tables and their columns, and the ways to show them: text for a terminal, Markdown, CSV and LaTeX.

A record holds values; CSV and JSON hold the records, and a `Column` shows one value in print. LaTeX needs booktabs.
"""

import csv
import html
import io
import math
import re
import textwrap
from collections.abc import Callable, Container, Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import zip_longest
from pathlib import Path
from string import Template
from typing import Any, Protocol

WIDTH = 100
"""The most columns of characters in a line of a terminal."""

WIDEST = 40
"""A cell wider than this is wrapped."""

NARROWEST = 22
"""The last column is wrapped to the space that is left, but not below this."""

GAP = "  "

Record = Mapping[str, Any]
"""Values by key: None is not defined, and a key that is missing does not apply."""


@dataclass(frozen=True)
class Table:
    """Cells as text; columns in `left` are flush left, and the (row, column) cells in `marked` stand out.

    A terminal breaks the cells of a `matrix` before ± or a bracket, where its columns then fit beside one another.
    `standing` says beside the title how far to trust the table, such as "planned". `records` are those of its rows.
    A table in full and its brief form have the same `key`, if any.
    """

    title: str
    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    left: frozenset[int] = frozenset({0})
    marked: frozenset[tuple[int, int]] = frozenset()
    notes: tuple[str, ...] = ()
    matrix: bool = False
    standing: str = ""
    records: tuple[Record, ...] = ()
    key: str = ""

    @property
    def heading(self) -> str:
        """The title with the standing in brackets; either may be empty."""
        return " ".join(part for part in (self.title, f"[{self.standing}]" if self.standing else "") if part)


@dataclass(frozen=True)
class Asked:
    """A question with its one answer; `standing` as of a table, and each warning says what weakens the answer."""

    question: str
    answer: str
    standing: str = ""
    warnings: tuple[str, ...] = ()

    @property
    def lines(self) -> tuple[str, ...]:
        """The answer, then the warnings."""
        return (self.answer, *(f"Warning: {warning}" for warning in self.warnings))


@dataclass(frozen=True)
class Section:
    """Part of the report: questions `asked`, paragraphs, tables, and records `further` to those of the tables.

    `slug` names the files. A terminal shows `brief` tables, if any, instead of the tables, and `aside`, which follows
    the tables, only with all. The report shows `brief` first where a reader must open a `folded` section. Sections of
    one `part` are under its name.
    """

    slug: str
    title: str
    paragraphs: tuple[str, ...] = ()
    tables: tuple[Table, ...] = ()
    further: tuple[Record, ...] = ()
    brief: tuple[Table, ...] = ()
    folded: bool = False
    aside: tuple[str, ...] = ()
    part: str = ""
    asked: tuple[Asked, ...] = ()

    @property
    def records(self) -> tuple[Record, ...]:
        """The records of the tables, then the further ones: the rows of the CSV file."""
        return (*(record for table in self.tables for record in table.records), *self.further)


@dataclass(frozen=True)
class Column:
    """A column in print: `show` makes each cell from the values under the key, or keys, of a record.

    The heading is the key by default. Without `show`, fractions and intervals (two keys) have fixed `decimals`, and
    None is `-`. The cell of a record without the key is empty. Short tables have the columns that are `brief`.
    """

    key: str | tuple[str, ...]
    heading: str | None = None
    decimals: int = 3
    show: Callable[..., str] | None = None
    left: bool = False
    brief: bool = True

    @property
    def keys(self) -> tuple[str, ...]:
        """The keys of the values of a cell."""
        return (self.key,) if isinstance(self.key, str) else self.key

    def cell(self, record: Record) -> str:
        """Return the cell of a record."""
        if self.keys[0] not in record:
            return ""
        values = [record[key] for key in self.keys]
        if self.show is not None:
            return self.show(*values)
        if len(values) == 2:
            return span(values[0], values[1], self.decimals)
        (value,) = values
        return number(value, self.decimals) if value is None or isinstance(value, float) else str(value)


def tabulate(
    title: str,
    columns: Iterable[Column],
    records: Iterable[Record],
    notes: Iterable[str] = (),
    *,
    brief: bool = False,
    standing: str = "",
    marked: frozenset[tuple[int, int]] = frozenset(),
    key: str = "",
    in_print: Container[str] = (),
) -> Table:
    """Return the table of these records, a row each, with the columns, or `brief` columns, that have values.

    Values under the keys `in_print` are in no CSV file.
    """
    rows = tuple(records)
    known = {key for record in rows for key in record}
    shown = [
        column for column in columns if (column.brief or not brief) and (not rows or known.issuperset(column.keys))
    ]
    return Table(
        title,
        tuple(column.keys[0] if column.heading is None else column.heading for column in shown),
        tuple(tuple(column.cell(record) for column in shown) for record in rows),
        frozenset(place for place, column in enumerate(shown) if column.left),
        marked,
        tuple(notes),
        standing=standing,
        records=without_keys(rows, in_print),
        key=key,
    )


def without_keys(records: Iterable[Record], keys: Container[str]) -> tuple[Record, ...]:
    """Return the records without the values under these keys."""
    return tuple({key: value for key, value in record.items() if key not in keys} for record in records)


def crossed(records: Iterable[Record], row: str, column: str) -> list[Record]:
    """Return a record for each value under the key `row`: it is under "", and each record under its `column`."""
    rows: dict[str, dict[str, Any]] = {}
    for record in records:
        rows.setdefault(record[row], {"": record[row]})[record[column]] = record
    return list(rows.values())


def side_by_side(records: Iterable[Record]) -> list[Record]:
    """Return a record for each thing that records hold quantities `of`, one quantity each.

    What a record has under `value`, `low` and `high` is under `QUANTITY`, `QUANTITY_low` and `QUANTITY_high`.
    """
    wide: dict[object, dict[str, Any]] = {}
    for record in records:
        name = record["quantity"]
        values = {name: record["value"], f"{name}_low": record["low"], f"{name}_high": record["high"]}
        wide.setdefault(record["of"], {"of": record["of"]}).update(values)
    return list(wide.values())


def number(value: float | None, decimals: int = 3) -> str:
    """Return a number at fixed decimals, or `-` for None."""
    return "-" if value is None else f"{value:.{decimals}f}"


def probability(p: float | None, decimals: int = 3) -> str:
    """Return P to so many decimals; below the last of them as a bound."""
    if p is None:
        return "-"
    least = 10.0**-decimals
    return f"< {least:.{decimals}f}" if p < least else f"{p:.{decimals}f}"


def p_is(p: float) -> str:
    """Return P within a sentence: `P = 0.023`, or `P < 0.001`."""
    shown = probability(p)
    return f"P {shown}" if shown.startswith("<") else f"P = {shown}"


def p_at_most(p: float) -> str:
    """Return the largest of several P within a sentence: `each P ≤ 0.023`, or `each P < 0.001`."""
    shown = probability(p)
    return f"each P {shown}" if shown.startswith("<") else f"each P ≤ {shown}"


class Limits(Protocol):
    """Two limits, either of which may be undefined."""

    @property
    def low(self) -> float | None: ...

    @property
    def high(self) -> float | None: ...


def interval(limits: Limits | None, decimals: int = 3) -> str:
    """Return both limits at fixed decimals, or `-` if one is not defined."""
    return "-" if limits is None else span(limits.low, limits.high, decimals)


def span(low: float | None, high: float | None, decimals: int = 3) -> str:
    """Return two limits at fixed decimals, or `-` if one is not defined."""
    return "-" if low is None or high is None else f"{low:.{decimals}f} to {high:.{decimals}f}"


def bounds(limits: Limits | None, decimals: int = 3) -> str:
    """Return both limits at fixed decimals, or what a value is at least, or at most, where the other end is open."""
    if limits is None or (limits.low is None and limits.high is None):
        return "-"
    if limits.low is None:
        return f"at most {limits.high:.{decimals}f}"
    if limits.high is None:
        return f"at least {limits.low:.{decimals}f}"
    return span(limits.low, limits.high, decimals)


def ends(limits: Limits | None, name: str = "") -> dict[str, float | None]:
    """Return an interval as values of a record: `low` and `high`, behind the name of what it is of."""
    low, high = (limits.low, limits.high) if limits is not None else (None, None)
    return {f"{name}low": low, f"{name}high": high}


def count_of(count: int, total: int) -> str:
    """Return `3 of 10`."""
    return f"{count} of {total}"


def lacks_a_limit(limits: Limits | None) -> bool:
    """Return whether an estimate lacks a limit of its interval."""
    return limits is not None and (limits.low is None or limits.high is None)


def bayes_factor(log: float | None) -> str:
    """Return a Bayes factor from its natural logarithm, to three digits, in powers of ten far from 1."""
    if log is None:
        return "-"
    if abs(log) < math.log(1000):
        return f"{math.exp(log):.3g}"
    exponent, rest = divmod(log / math.log(10), 1)
    digits, _, carried = f"{10**rest:.2e}".partition("e")
    return f"{digits}e{exponent + int(carried):.0f}"


def text(section: Section, width: int = WIDTH, *, full: bool = False) -> str:
    """Return the section for a terminal, with no line longer than `width`; brief tables and no aside unless `full`."""
    parts = [f"{section.title}\n{'=' * min(len(section.title), width)}"]
    parts += [_answer_text(one, width) for one in section.asked]
    parts += [textwrap.fill(paragraph, width) for paragraph in section.paragraphs]
    whole = full and not section.folded
    parts += [table_text(table, width) for table in (section.tables if whole else section.brief or section.tables)]
    parts += [textwrap.fill(paragraph, width) for paragraph in section.aside * full]
    return "\n\n".join(parts)


def _answer_text(one: Asked, width: int) -> str:
    lines = [textwrap.fill(f"{one.question} [{one.standing}]" if one.standing else one.question, width)]
    lines += [textwrap.fill(line, width, initial_indent=GAP, subsequent_indent=GAP) for line in one.lines]
    return "\n".join(lines)


def table_text(table: Table, width: int = WIDTH) -> str:
    """Return one table for a terminal: long cells are wrapped, and columns that do not fit follow below the first."""
    rows = [table.header, *table.rows]
    sizes = [max(1, *(len(row[column]) for row in rows)) for column in range(len(table.header))]
    sizes[:-1] = [min(size, WIDEST) for size in sizes[:-1]]
    if table.matrix and len(_blocks(sizes, width)) > 1:
        sizes, rows = _broken(table, sizes, rows, width)
    naming = _named(table, sizes, width) if len(_blocks(sizes, width)) > 1 else 1
    blocks = []
    for columns in _blocks(sizes, width, naming):
        widths = [sizes[column] for column in columns]
        widths[-1] = min(widths[-1], max(width - sum(widths[:-1]) - len(GAP) * (len(widths) - 1), 1))
        header, *below = (_line(row, columns, widths, table.left) for row in rows)
        lines = [header, GAP.join("-" * size for size in widths), *below]
        blocks.append("\n".join(lines))
    notes = "\n".join(textwrap.fill(note, width) for note in table.notes)
    title = textwrap.fill(table.heading, width)
    return "\n".join(part for part in (title, "\n\n".join(blocks), notes) if part)


def _broken(
    table: Table, sizes: list[int], rows: list[tuple[str, ...]], width: int
) -> tuple[list[int], list[tuple[str, ...]]]:
    """Return the sizes and rows of a matrix with cells broken before ± or a bracket, if it then fits."""
    broken = [tuple(re.sub(r" (?=± |\()", "\n", cell) for cell in row) for row in rows]
    parts = [[*table.header[place].split(), *(part for row in broken for part in row[place].split("\n"))]
             for place in range(1, len(sizes))]  # fmt: skip
    narrow = [max(1, *map(len, column)) for column in parts]
    fits = sizes[0] + sum(narrow) + len(GAP) * len(narrow) <= width
    return ([sizes[0], *narrow], broken) if fits else (sizes, rows)


def _named(table: Table, sizes: list[int], width: int) -> int:
    """Narrow the columns that name rows where that leaves room for one beside them; return how many each part shows."""
    count = len(table.rows)
    naming = next((n for n in range(1, len(sizes)) if len({row[:n] for row in table.rows}) == count), 1)
    for most in (WIDEST, NARROWEST):
        names = [min(size, most) for size in sizes[:naming]]
        beside = max(*sizes[naming:-1], min(sizes[-1], NARROWEST), 0)
        if sum(names) + len(GAP) * naming + beside <= width:
            sizes[:naming] = names
            return naming
    return 1


def markdown(section: Section, label: str) -> str:
    """Return the section as Markdown, below the dataset's label."""
    parts = [f"**{_markdown(label)}**"] if label else []
    parts.append(f"## {_markdown(section.title)}")
    parts += [_markdown(line) for one in section.asked for line in (one.question, *one.lines)]
    parts += map(_markdown, section.paragraphs)
    for table in section.tables:
        if table.heading:
            parts.append(f"### {_markdown(table.heading)}")
        rule = "|".join(":--" if column in table.left else "--:" for column in range(len(table.header)))
        rows = [_markdown_row(table.header), f"|{rule}|", *map(_markdown_row, table.rows)]
        parts += ["\n".join(rows), *map(_markdown, table.notes)]
    parts += map(_markdown, section.aside)
    return "\n\n".join(parts) + "\n"


def comma_separated(section: Section, label: str) -> str:
    """Return the records as CSV with full precision, cells as by `cell`, behind a column of the label."""
    records = section.records
    columns = list(dict.fromkeys(key for record in records for key in record))
    file = io.StringIO()
    writer = csv.writer(file, lineterminator="\n")
    writer.writerow(["dataset", *columns])
    first = cell(label or "measured")
    writer.writerows([first, *map(cell, map(record.get, columns))] for record in records)
    return file.getvalue()


FORMULA = re.compile(r"[=+\-@\t\r\n\uff1d\uff0b\uff0d\uff20]")
"""What a text begins with that a spreadsheet takes for a formula; the last four are the wide signs."""

NUMBER = re.compile(r"[-+]?([0-9]+(\.[0-9]*)?|\.[0-9]+)(e[-+]?[0-9]+)?%?", re.IGNORECASE)


def cell(value: object) -> object:
    """Return a cell of a CSV file: None is empty, names are joined, and a formula follows an apostrophe."""
    if isinstance(value, tuple):
        value = " and ".join(value)
    if isinstance(value, str):
        return f"'{value}" if FORMULA.match(value) and not NUMBER.fullmatch(value) else value
    return "" if value is None else value


def _blocks(sizes: Sequence[int], width: int, naming: int = 1) -> list[list[int]]:
    """Return the columns of each block: as many as fit beside the naming ones; the last column may be narrowed."""
    begun = list(range(naming)), sum(sizes[:naming]) + len(GAP) * (naming - 1)
    blocks, block, used = [], [*begun[0]], begun[1]
    for column in range(naming, len(sizes)):
        last = column == len(sizes) - 1
        least = min(sizes[column], NARROWEST) if last else sizes[column]
        if used + len(GAP) + least > width and len(block) > naming:
            blocks.append(block)
            block, used = [*begun[0]], begun[1]
        block.append(column)
        used += len(GAP) + sizes[column]
    return [*blocks, block]


def _line(row: Sequence[str], columns: Sequence[int], widths: Sequence[int], left: frozenset[int]) -> str:
    wrapped = [
        [line for part in row[column].split("\n") for line in textwrap.wrap(part, size)]
        for column, size in zip(columns, widths, strict=True)
    ]
    lines = []
    for parts in [*zip_longest(*wrapped, fillvalue="")] or [("",) * len(columns)]:
        cells = zip(columns, widths, parts, strict=True)
        shown = (part.ljust(size) if column in left else part.rjust(size) for column, size, part in cells)
        lines.append(GAP.join(shown).rstrip())
    return "\n".join(lines)


def _markdown_row(cells: Sequence[str]) -> str:
    return "| " + " | ".join(_markdown(cell) for cell in cells) + " |"


def _markdown(text: str) -> str:
    """Return text on one line in which no character makes a cell, a tag, a link or emphasis, by any reader's rules."""
    return re.sub(r"([\\`|*\[\]])", r"\\\1", html.escape(" ".join(text.split()), quote=False))


SPECIAL = {
    "\\": r"\textbackslash{}", "&": r"\&", "%": r"\%", "$": r"\$", "#": r"\#", "_": r"\_", "{": r"\{", "}": r"\}",
    "~": r"\textasciitilde{}", "^": r"\textasciicircum{}", "±": r"$\pm$", "²": r"$^2$", "η": r"$\eta$",
    "√": r"$\surd$", "→": r"$\to$", "<": r"$<$", ">": r"$>$", "|": r"$|$", "[": "{[}",
}  # fmt: skip


def latex(section: Section, label: str) -> str:
    """Return the section's tables, each with the dataset's label, if it has one, in its caption."""
    parts = [f"% {' '.join(text.split())}" for text in (section.title, label) if text]
    return "\n".join([*parts, *(_table(table, section.title, label) for table in section.tables)]) + "\n"


def escaped(text: str) -> str:
    """Return text on one line in which every character stands for itself."""
    return "".join(SPECIAL.get(character, character) for character in " ".join(text.replace("->", "→").split()))


def _table(table: Table, title: str, label: str) -> str:
    columns = "".join("l" if column in table.left else "r" for column in range(len(table.header)))
    caption = ". ".join(part for part in (label, table.title or title) if part)
    caption += f" ({table.standing})" if table.standing else ""
    head = r"\begin{table}", rf"\caption{{{escaped(caption)}}}", rf"\begin{{tabular}}{{{columns}}}"
    rows = (r"\toprule", _row(table.header), r"\midrule", *map(_row, table.rows), r"\bottomrule", r"\end{tabular}")
    notes = (rf"\par\small {escaped(note)}" for note in table.notes)
    return "\n".join(["", *head, *rows, *notes, r"\end{table}"])


def _row(cells: tuple[str, ...]) -> str:
    return " & ".join(map(escaped, cells)) + r" \\"


def blocks(file: Path) -> dict[str, Template]:
    """Return the text below each heading of a Markdown file, with `$` names for values."""
    parts = (part.partition("\n") for part in re.split(r"^## ", file.read_text("utf-8"), flags=re.MULTILINE)[1:])
    return {name: Template(" ".join(text.split())) for name, _, text in parts}


def formulas(file: Path, **known: object) -> tuple[tuple[str, str], ...]:
    """Return the name and formula of each heading of a Markdown file; `known` stands for its `$` names."""
    return tuple((name, text.substitute(known)) for name, text in blocks(file).items())


def joined(parts: Sequence[str]) -> str:
    """Return `a`, `a and b`, or `a, b and c`."""
    return " and ".join([", ".join(parts[:-1]), parts[-1]] if len(parts) > 1 else parts)


def plural(count: int, noun: str) -> str:
    """Return `1 trial` or `2 trials`."""
    return f"{count} {noun}" if count == 1 else f"{count} {noun}s"
