"""Tables of a paper as its HTML page or a CSV file holds them, as a file of printed numbers, and tests in sentences.

Numbers stay text, whose last digit shows the rounding, so pages are read by the standard library. Headings show the
kind: confusion tables, ANOVA tables, and t-tests. `Stated` has what a table lacks; stars are left out.
"""

import csv
import re
from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from html.parser import HTMLParser
from itertools import chain, groupby, repeat
from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING, Any

from palpate.analysis.published.numbers import Published
from palpate.analysis.published.printed import POSITIVE
from palpate.experiment.errors import PalpateError, ProtocolError, PublishedError
from palpate.experiment.settings import delimited, load

if TYPE_CHECKING:
    from palpate.analysis.published.prose import Reported

PAGES, TEXTS = (".html", ".htm", ".xhtml"), (".txt", ".md", ".tex", ".pdf", ".docx")
SUFFIXES = (*PAGES, ".csv", ".tsv", *TEXTS)
LARGEST = 2 * 2**20
"""Bytes of a file; a paper's page has hundreds of thousands."""

MOST_CELLS = 20_000
"""Cells of all tables of a file; a paper has thousands."""

MOST_HEADINGS = 3
"""Rows at the top of a table that are tried as its headings."""

WIDEST = 100
"""Columns of a table, and the most rows or columns over which one cell may reach."""


@dataclass(frozen=True)
class Stated:
    """What a paper says outside of its tables: participants of all confusion tables or each, trials, and chance.

    `file` is what is stated of how the file is written.
    """

    participants: tuple[int, ...] = ()
    trials: int | None = None
    chance: str | None = None
    file: delimited.Stated = delimited.NOTHING_STATED


@dataclass(frozen=True)
class Grid:
    """One table as text: its caption or its number in the file, and rows of as many cells each."""

    name: str
    rows: tuple[tuple[str, ...], ...]


@dataclass(frozen=True)
class Paper:
    """The printed numbers of tables, and tests in sentences; `one_tailed`: the paper says so of some.

    `passed_over` are sentences on what was not read, and `unread` is how many cells were not.
    """

    printed: Published
    passed_over: tuple[str, ...]
    unread: int = 0
    tests: "tuple[Reported, ...]" = ()
    one_tailed: bool = False


def read(path: Path, stated: Stated) -> Paper:
    """Return the printed numbers in the tables of an HTML page or a CSV file, and in the sentences of a page or text.

    Raises `PublishedError` in one line, for a file that cannot be read or holds nothing that can be checked.
    """
    from palpate.analysis.published import prose

    suffix = path.suffix.lower()
    text = "" if suffix in (".csv", ".tsv") else _text(path, stated.file)
    words = prose.words(text) if suffix in PAGES else text
    tests, unchecked = prose.reported_tests(words)
    grids = () if suffix in TEXTS else _html(path, text, stated.file) if suffix in PAGES else _csv(path, stated.file)
    passed = _Passed()
    document: dict[str, Any] = {"study": "paper", "source": _clean(f"Tables of {path.name}", 200)}
    confusions = 0
    for grid in grids:
        try:
            confusions += _add(document, grid, stated, confusions, passed)
        except _Unknown as reason:
            passed.append(f"{grid.name} was skipped: {reason}.")
    passed += _tied(document, stated.chance)
    passed += unchecked
    if len(tests) == prose.MOST_TESTS:
        passed.append(f"Tests in sentences after the first {prose.MOST_TESTS:,} were skipped.")
    found = any(key in document for key in ("table", "t", "anova"))
    if not found and not tests:
        told = f"; {' '.join(passed).rstrip('.')}" if passed else ""
        raise PublishedError(
            path,
            f"got {len(grids)} tables and {len(words.split())} words, but nothing that the audit can check{told[:600]}",
            "or write a TOML file",
            allowed="confusion tables (answers by materials), ANOVA tables (SS, df, MS, F, P), tables of "
            "t-tests (t, df, P), and sentences such as 't(11) = 8.14, p < .001'",
        )
    try:
        # Nothing but sentences is no file of printed numbers, which has to hold some.
        words_alone = Published.model_construct(study="paper", source=_clean(f"Sentences of {path.name}", 200))
        printed = load.checked(path, Published, document) if found else words_alone
    except ProtocolError as error:
        raise PublishedError.at(error.findings[0]) from error
    return Paper(printed, tuple(passed), passed.unread, tests, prose.mentions_one_tailed(words))


class _Unknown(Exception):
    """A table is of no known kind; the text says why."""


class _Passed(list[str]):
    """Sentences on what was passed over, and the number of cells that hold something and were not read."""

    unread = 0

    def cells(self, where: str, unread: Iterable[tuple[str, str]]) -> None:
        """Tell which cells hold something and could not be read, if any."""
        held = ((name, text) for name, text in unread if plain(text) not in NOTHING)
        found = [f"{name} ('{_clean(text) or text.strip()[:40]}')" for name, text in held]
        more = f" and {len(found) - TOLD} more" if len(found) > TOLD else ""
        self.unread += len(found)
        if found:
            self.append(f"{where}: no number was read in these cells: {', '.join(found[:TOLD])}{more}.")


STAR = "*∗†‡"
MEAN_SD = re.compile(
    rf"^(-?{POSITIVE})(?: ?[{STAR}]+(?= ?[±+(\[]))?"
    rf"(?: ?(?:±|\+/-|\+-) ?({POSITIVE})| ?[(\[] ?(?:SD ?=? ?)?({POSITIVE}) ?[)\]])?$"
)
STARS = re.compile(rf"(?<=[0-9%)\]]) ?[{STAR}]+$|^[{STAR}]+ ?(?=[0-9.])")
POWER = re.compile(r"(?<=[0-9]) ?[×x·*] ?10 ?\^? ?\(?(-[0-9]{1,2})\)?$")
HEADINGS = {
    "ss": ("ss", "sum of squares", "sum sq", "sums of squares", "type iii ss", "type iii sum of squares"),
    "df": ("df", "d.f.", "dof", "degrees of freedom"),
    "ms": ("ms", "mean square", "mean sq", "mean squares"),
    "f": ("f", "f value", "f-value", "f ratio"),
    "t": ("t", "t value", "t-value", "t statistic"),
    "p": ("p", "p value", "p-value", "pr(>f)", "pr(>|t|)", "sig.", "sig", "p (two-tailed)"),
}
"""What stands above the columns of tables of tests, in small letters."""

LARGEST_RATIO_SUM = 10.0
"""A row of ratios adds up to about 1, one of percent to about 100, and a wrong cell or two change neither of most."""

NOTHING = ("", "-", "--", "\u2014")
"""Cells in which a paper prints nothing."""

_DIGITS = re.compile(r"[0-9.,]*[0-9]")
_THOUSANDS = re.compile(r"(?<![0-9.,])[1-9][0-9]{0,2}(?:\.[0-9]{3})+(?![0-9])")
_DEGREES = re.compile(r"[A-Za-z] ?\(")
"""A comma may part degrees of freedom, as in F(3,68)."""

WHOLE = re.compile(r"[1-9][0-9]{0,6}")
TOLD = 12
"""The most cells of a table that are told as not read; the others are counted."""

RESIDUAL = ("error", "residual", "residuals", "within", "within groups")


def plain(text: str) -> str:
    """Return a text with plain minus signs, blanks and powers of ten, without stars behind or before a number."""
    text = re.sub(r"\s+", " ", text.translate({0x2212: "-", 0x2013: "-", 0x2010: "-", 0x2011: "-"})).strip()
    return POWER.sub(r"e\1", STARS.sub("", text)).strip()


def _clean(text: str, most: int = 40) -> str:
    """Return a text as a name: one line, a letter or a digit first."""
    line = re.sub(r"\s+", " ", "".join(sign if sign.isprintable() else " " for sign in text)).replace('"', "'")
    return re.sub(r"^[^\w]+|^_+", "", line)[:most].strip()


def _add(document: dict[str, Any], grid: Grid, stated: Stated, confusions: int, passed: _Passed) -> int:
    """Add a table to the document, and unread cells to `passed`; return 1 for a confusion table, or 0."""
    for at in range(min(MOST_HEADINGS, len(grid.rows) - 1)):
        found = _add_below(document, grid.name, grid.rows[at], grid.rows[at + 1 :], stated, confusions, passed)
        if found is not None:
            return found
    first = next((_clean(", ".join(filter(None, row)), 80) for row in grid.rows if any(row)), "")
    raise _Unknown(f"the audit does not recognize its headings ({first})")


def _add_below(
    document: dict[str, Any], where: str, heading: Sequence[str], rows: Sequence[tuple[str, ...]], stated: Stated,
    confusions: int, passed: _Passed,
) -> int | None:  # fmt: skip
    """Add what stands below a row of headings; return as `_add` does, or None where the headings are not known."""
    header = [re.sub(r"[*†‡]", "", plain(cell)).strip() for cell in heading]
    known = {key: i for i, cell in enumerate(header) for key, names in HEADINGS.items() if cell.lower() in names}
    named = [(_clean(plain(row[0])), row) for row in rows]
    if "df" in known and ("ss" in known or "ms" in known):
        known.pop("t", None)
        passed.cells(where, _unread(named, known))
        document["anova"] = (*document.get("anova", ()), {"where": where, "lines": _sources(named, known)})
        return 0
    if "t" in known and "df" in known:
        known = {key: known[key] for key in ("t", "df", "p") if key in known}
        passed.cells(where, _unread(named, known))
        _add_tests(document, where, tuple(_tests(named, known)))
        return 0
    answers = [_clean(cell) for cell in header]
    materials = [name for name, _ in named if name]
    if len(set(materials) & set(answers[1:])) >= 2:
        _add_confusion(document, where, named, answers, stated, confusions, passed)
        return 1
    return None


def _add_tests(document: dict[str, Any], where: str, tests: tuple[dict[str, Any], ...]) -> None:
    """Add t-tests, and a task for each number of participants that no other task has."""
    if not tests:
        raise _Unknown("no line has both t and df")
    document["t"] = (*document.get("t", ()), {"where": where, "tests": tests})
    groups = {one["id"]: one for one in document.get("task", ())}
    for test in tests:
        groups.setdefault(test["task"], {"id": test["task"], "participants": test["df"] + 1})
    document["task"] = tuple(groups.values())


def _add_confusion(
    document: dict[str, Any], where: str, named: Sequence[tuple[str, tuple[str, ...]]], answers: Sequence[str],
    stated: Stated, number: int, passed: _Passed,
) -> None:  # fmt: skip
    if not stated.participants:
        raise _Unknown("it is a confusion table with an unknown number of participants; give --participants")
    if number >= len(stated.participants) > 1:
        raise _Unknown("--participants gives no number for this table")
    people = stated.participants[min(number, len(stated.participants) - 1)]
    cells, unread = [], list[tuple[str, str]]()
    materials = [name for name, _ in named if name in answers[1:]]
    for name, row in named:
        if name not in materials:
            unread += [(f"the row '{name}', which has no column", next(filter(None, row[1:]), ""))]
            passed.unread += max(sum(plain(one) not in NOTHING for one in row[1:]), 1) - 1
            continue
        for answered, text in zip(answers[1:], row[1:], strict=True):
            match = MEAN_SD.match(plain(text)) if answered in materials else None
            if match is None and plain(text) not in NOTHING:
                unread.append((f"{name} -> {answered or 'a column without a name'}", text))
            elif match:
                sd = match[5] or match[9]
                cells.append({"presented": name, "answered": answered, "mean": match[1], **({"sd": sd} if sd else {})})
    passed.cells(where, unread)
    if not cells:
        raise _Unknown("no cell has a mean, or a mean and an SD")
    cells, turned = _with_answers_in_columns(cells, len(materials))
    where += turned
    percent = _is_percent(cells)
    where += ", read as percent" if percent else ""
    cells = _with_percent(cells, all_of_them=percent)
    task = f"task {number + 1}"
    trials = {"trials": stated.trials} if stated.trials else {}
    document["task"] = (*document.get("task", ()), {"id": task, "participants": people, **trials})
    complete = len(cells) == len(materials) ** 2 and set(filter(None, answers[1:])) == set(materials)
    table = {"where": where, "task": task, "complete": complete, "cells": tuple(cells)}
    document["table"] = (*document.get("table", ()), table)


def _with_answers_in_columns(cells: list[dict[str, str]], size: int) -> tuple[list[dict[str, str]], str]:
    """Return the cells of a table, turned if answers stand in its rows, and what to say of that.

    They do where all columns add up to 1 or 100, as close as they are rounded, and rows do not.
    """
    if len(cells) != size**2:
        return cells, ""
    means = [cell["mean"].rstrip(" %") for cell in cells]
    digits = max(len(mean.partition(".")[2]) for mean in means)
    sums = {key: defaultdict[str, float](float) for key in ("presented", "answered")}
    for cell, mean in zip(cells, means, strict=True):
        for key, of in sums.items():
            of[cell[key]] += float(mean)
    whole = 100.0 if sum(map(float, means)) > LARGEST_RATIO_SUM * len(sums["presented"]) else 1.0
    allowed = 0.5 * 10.0**-digits * len(sums["presented"]) + 1e-9
    rows, columns = (max(abs(one - whole) for one in of.values()) <= allowed for of in sums.values())
    if rows or not columns:
        return cells, ""
    turned = [{**cell, "presented": cell["answered"], "answered": cell["presented"]} for cell in cells]
    return turned, ", answers in rows, because its columns add up"


def _is_percent(cells: Sequence[dict[str, str]]) -> bool:
    """Return whether bare numbers are percent: most rows add up to far more than 1, and no number has a sign."""
    if any("%" in text for cell in cells for text in (cell["mean"], cell.get("sd", ""))):
        return False
    rows: defaultdict[str, float] = defaultdict(float)
    for cell in cells:
        rows[cell["presented"]] += float(cell["mean"])
    return median(rows.values()) > LARGEST_RATIO_SUM


def _with_percent(cells: Sequence[dict[str, str]], *, all_of_them: bool) -> list[dict[str, str]]:
    """Return cells with a sign of percent at each number, or where a sign behind the SD is meant for the mean too."""
    signed: list[dict[str, str]] = []
    for cell in cells:
        both = all_of_them or "%" in cell.get("sd", "")
        told: dict[str, str] = {key: f"{cell[key].rstrip(' %')}%" for key in ("mean", "sd") if key in cell and both}
        signed.append({**cell, **told})
    return signed


def _tied(document: dict[str, Any], chance: str | None) -> list[str]:
    """Pair each t-test with the confusion table of its participants; return why others have none.

    Of several tables the one in the place of the t-tests' is taken; a df that no table has is taken for the others'.
    """
    presented = {table["task"]: {cell["presented"] for cell in table["cells"]} for table in document.get("table", ())}
    people = {task["id"]: task["participants"] for task in document.get("task", ()) if task["id"] in presented}
    blocks, passed = document.get("t", ()), []
    for number, block in enumerate(blocks):
        for test in sorted(block["tests"], key=lambda test: test["df"] + 1 not in people.values()):
            sizes = {id_: people[id_] for id_, names in presented.items() if test["of"] in names}
            fitting = [id_ for id_, size in sizes.items() if size == test["df"] + 1]
            fitting = fitting[number : number + 1] if len(fitting) == len(blocks) else fitting
            fitting = fitting or _table_of_others(test, block["tests"], sizes)
            name = f"{block['where']}, {test['of']}: t"
            if sizes and not fitting:
                df = f"{test['df']} df, and no confusion table with it has {test['df'] + 1} participants"
                passed.append(f"{name} has {df}.")
            elif len(fitting) == 1 and chance:
                test["task"] = fitting[0]
                del test["null"]
            elif fitting:
                why = "several have its participants" if chance else "chance is unknown; give --chance"
                passed.append(f"{name} was not compared with a confusion table: {why}.")
    if chance:
        document["chance"] = chance
    _drop_tasks(document, presented)
    return passed


def _table_of_others(test: dict[str, Any], tests: Sequence[dict[str, Any]], sizes: dict[str, int]) -> list[str]:
    """Return the one table of the other tests that has too few participants for the df; none if there are several."""
    larger = {one["task"] for one in tests} & {id_ for id_, size in sizes.items() if test["df"] >= size}
    return list(larger) if len(larger) == 1 else []


def _drop_tasks(document: dict[str, Any], with_tables: Iterable[str]) -> None:
    """Leave out the tasks that have neither a table nor a test any more."""
    used = {test["task"] for block in document.get("t", ()) for test in block["tests"]} | set(with_tables)
    if "task" in document:
        document["task"] = tuple(task for task in document["task"] if task["id"] in used)


def _unread(named: Sequence[tuple[str, tuple[str, ...]]], known: dict[str, int]) -> Iterator[tuple[str, str]]:
    """Yield each cell of a table of tests that holds no number that can stand there."""
    for name, row in named:
        held = _numbers(row, known)
        for key, i in known.items():
            if key not in held or (key == "df" and not WHOLE.fullmatch(held[key])):
                yield f"{name or 'a line without a name'}, {key}", row[i]


def _numbers(row: Sequence[str], known: dict[str, int]) -> dict[str, str]:
    found = {key: plain(row[i]).replace(" ", "") for key, i in known.items()}
    return {key: text for key, text in found.items() if re.match(rf"^(-|< ?)?{POSITIVE}$", text)}


def _sources(named: Sequence[tuple[str, tuple[str, ...]]], known: dict[str, int]) -> tuple[dict[str, Any], ...]:
    """Return the lines of an ANOVA table, its residual last and the totals left out."""
    lines: list[dict[str, Any]] = []
    for name, row in named:
        found = _numbers(row, known)
        if WHOLE.fullmatch(found.get("df", "")) and not re.match(r"(corrected )?total", name.lower()):
            unsigned = {key: text for key, text in found.items() if not text.startswith("-")}
            lines.append({"name": name or f"line {len(lines) + 1}", **unsigned, "df": int(found["df"])})
    residual = [line for line in lines if line["name"].lower() in RESIDUAL]
    if len(residual) != 1 or len(lines) < 2:
        raise _Unknown("an ANOVA table needs lines with df, and one of them named error, residual or within")
    return (*(line for line in lines if line is not residual[0]), residual[0])


def _tests(named: Sequence[tuple[str, tuple[str, ...]]], known: dict[str, int]) -> Iterator[dict[str, Any]]:
    for number, (name, row) in enumerate(named, 1):
        found = _numbers(row, known)
        if "t" in found and WHOLE.fullmatch(found.get("df", "")):
            p = {"p": found["p"]} if "p" in found else {}
            # Nothing but the test is known, so that what it was against decides nothing.
            df = int(found["df"])
            yield {"task": f"{df} df", "of": name or f"line {number}", "df": df, "t": found["t"], **p, "null": "0"}


def _text(path: Path, stated: delimited.Stated) -> str:
    try:
        data = delimited.content(path, LARGEST)
        # Every byte is a letter there; a page of another encoding shows other names and the same digits.
        given = stated if stated.encoding or _is_unicode(data) else replace(stated, encoding="latin-1")
        return delimited.decoded(data, path, given)[0]
    except PalpateError as error:
        raise PublishedError.saying(error) from error


def _is_unicode(data: bytes) -> bool:
    try:
        data.decode()
    except UnicodeDecodeError:
        return data[:2] in (b"\xff\xfe", b"\xfe\xff")
    return True


def _csv(path: Path, stated: delimited.Stated) -> tuple[Grid, ...]:
    """Return the tables of a CSV file: a line without cells parts them, and one cell alone above a table names it.

    Decimal commas become points.
    """
    try:
        text, _ = delimited.decoded(delimited.content(path, LARGEST), path, stated)
        delimiter = delimited.delimiter_of(text)
        rows = [[cell.strip() for cell in one.cells] for one in delimited.records(text, delimiter, below=False)]
        digits = (part for row in rows for cell in row for part in _DIGITS.findall(cell))
        if (decimal := stated.decimal or delimited.decimal_sign(digits, delimiter, printed=True)) is None:
            raise delimited.unclear_decimal(path, stated)
    except PalpateError as error:
        raise PublishedError.saying(error) from error
    except csv.Error as error:
        raise PublishedError(
            path, f"it is not CSV ({error})", "save the table again", allowed="rows of cells"
        ) from error
    if decimal == ",":
        rows = [[_with_point(cell) for cell in row] for row in rows]
    return _grids(path, (list(block) for filled, block in groupby(rows, any) if filled))


def _with_point(cell: str) -> str:
    if _DEGREES.search(cell):
        return cell
    whole = _THOUSANDS.sub(lambda match: match[0].replace(".", ""), cell)
    return re.sub(r",(?=[0-9])", ".", whole)


def _grids(path: Path, tables: Iterable[list[list[str]]], names: Iterable[str] = ()) -> tuple[Grid, ...]:
    found: list[Grid] = []
    left = MOST_CELLS
    for table, given in zip(tables, chain(names, repeat("")), strict=False):
        rows, name = table, given
        if not name and len(rows) > 1 and sum(map(bool, rows[0])) == 1 and len(rows[0]) != len(rows[1]):
            name, rows = next(filter(None, rows[0])), rows[1:]
        width = max(map(len, rows), default=0)
        left -= width * len(rows)
        if width > WIDEST or left < 0:
            raise PublishedError(
                path,
                f"got tables of more than {WIDEST} columns or {MOST_CELLS} cells",
                "remove everything that is not a table",
                allowed="the tables of one paper",
            )
        number = f"table {len(found) + 1}"
        name = _clean(name, 60) or number
        name = f"{name} ({number})" if any(one.name == name for one in found) else name
        found.append(Grid(name, tuple((*row, *[""] * (width - len(row))) for row in rows)))
    return tuple(found)


class _Page(HTMLParser):
    """Collects the tables of a page; a table within a table stands after it."""

    def __init__(self, path: Path) -> None:
        super().__init__(convert_charrefs=True)
        self._path = path
        self.tables: list[list[list[str]]] = []
        self.captions: list[str] = []
        self._open: list[int] = []
        self._text: list[str] | None = None
        self._caption = False
        self._reach: dict[tuple[int, int, int], str] = {}
        self._span = (1, 1)
        self._hidden = 0
        self._cells = 0

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        if tag in ("script", "style"):
            self._hidden += 1
        elif tag == "table":
            self._end()
            self._count(1)
            self._open.append(len(self.tables))
            self.tables.append([])
            self.captions.append("")
        elif self._open and tag == "tr":
            self._end()
            self._count(1)
            self.tables[self._open[-1]].append([])
        elif self._open and tag in ("td", "th", "caption"):
            self._end()
            self._text, self._caption = [], tag == "caption"
            spans = {name: value or "" for name, value in attrs}
            self._span = _reaches(spans.get("rowspan")), _reaches(spans.get("colspan"))
        elif tag == "br" and self._text is not None:
            self._text.append(" ")
        elif tag == "sup" and self._text is not None and re.search(r"10\s*$", "".join(self._text[-2:])):
            self._text.append("^")

    def handle_endtag(self, tag: str) -> None:
        if tag in ("script", "style"):
            self._hidden = max(0, self._hidden - 1)
        elif tag in ("td", "th", "caption", "tr"):
            self._end()
        elif tag == "table" and self._open:
            self._end()
            self._open.pop()

    def handle_data(self, data: str) -> None:
        if self._text is not None and not self._hidden:
            self._text.append(data)

    def _end(self) -> None:
        """Put the cell that ends here into its row, and into those that it reaches."""
        if self._text is None or not self._open:
            return
        text, self._text = "".join(self._text)[:500], None
        table = self._open[-1]
        if self._caption:
            self.captions[table] = text
            return
        rows = self.tables[table]
        if not rows:
            rows.append([])
        row = rows[-1]
        down, across = self._span
        self._fill(table, row, len(rows) - 1)
        for _ in range(across):
            for below in range(1, down):
                self._reach[table, len(rows) - 1 + below, len(row)] = text
            row.append(text)
        self._fill(table, row, len(rows) - 1)
        self._count(across * down)

    def _count(self, cells: int) -> None:
        self._cells += cells
        if self._cells > MOST_CELLS:
            allowed = "the tables of one paper"
            raise PublishedError(self._path, f"got more than {MOST_CELLS} cells", allowed=allowed)

    def _fill(self, table: int, row: list[str], index: int) -> None:
        while (table, index, len(row)) in self._reach:
            row.append(self._reach.pop((table, index, len(row))))


def _reaches(text: str | None) -> int:
    return min(int(text), WIDEST) if text and re.fullmatch(r"[1-9][0-9]{0,3}", text) else 1


def _html(path: Path, text: str, stated: delimited.Stated) -> tuple[Grid, ...]:
    """Return the tables of a page. Decimal commas become points in each table of which most numbers have them."""
    page = _Page(path)
    try:
        # Without `close`, which tries every `<` of an unfinished page again.
        page.feed(text)
    except (AssertionError, ValueError, RecursionError) as error:
        raise PublishedError(path, "got HTML that cannot be parsed", allowed="a page as a browser saves it") from error
    filled = [[row for row in table if any(cell.strip() for cell in row)] for table in page.tables]
    whole = stated.decimal or _sign(filled)
    signs = [stated.decimal or _sign([table]) or whole for table in filled]
    filled = [
        [[_with_point(cell) for cell in row] for row in table] if sign == "," else table
        for sign, table in zip(signs, filled, strict=True)
    ]
    return _grids(path, filled, page.captions)


def _sign(tables: Sequence[Sequence[Sequence[str]]]) -> str:
    """Return the decimal sign of the numbers in tables, empty where none has one."""
    cells = (cell for table in tables for row in table for cell in row if not _DEGREES.search(cell))
    return delimited.decimal_sign((part for cell in cells for part in _DIGITS.findall(cell)), ",", printed=True) or ""
