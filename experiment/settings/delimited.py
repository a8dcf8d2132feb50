"""Delimited text from any program, as records of cells, and how it was read.

A file does not say how it is written. Its encoding is that of its mark, UTF-8, or the one that is stated: any bytes are
text in a code page, so none is guessed. Its delimiter is the sign under which most records have one width and, where
several do, most cells are numbers. Its decimal sign is the one under which its cells are numbers. What can be read in
two ways is refused, with the option that states it.
"""

import codecs
import csv
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import islice
from math import inf, nan
from pathlib import Path

from palpate.experiment import storage
from palpate.experiment.errors import PalpateError, Remedy

LARGEST = 256 * 2**20
"""No table is read that is larger, bytes."""

DELIMITERS = ("\t", ";", ",", "|")
"""What may stand between cells, besides blanks; of two that fit as well the first is taken."""

SAMPLE = 400
"""Records from which the delimiter is decided."""

HEADINGS = 40
"""Records among which the header of a table is looked for."""

CODE_PAGES = {"cp1252": "Western Europe", "cp1250": "Central Europe", "cp1251": "Cyrillic", "shift_jis": "Japan",
              "gb18030": "China", "mac_roman": "old Macs"}  # fmt: skip
"""Encodings that a refusal names, with where they are usual."""

FOREIGN = {
    **{b"\x80" + bytes([protocol]): "a pickle (such as a psydat file), which could run code when opened"
       for protocol in (2, 3, 4, 5)},
    b"\x1f\x8b": "a compressed file (gzip)",
    b"PK\x03\x04": "a spreadsheet or an archive (zip)",
    b"\xd0\xcf\x11\xe0": "a file from an old version of Excel or Word",
    b"SQLite format": "a database (SQLite)",
    b"%PDF": "a PDF",
    b"    -1\n": "a universal file (UFF)",
    b"    -1\r\n": "a universal file (UFF)",
}  # fmt: skip
"""What a file is that begins so, and is no text."""

COMMENT_SIGN = re.compile(r"\A\s*(?:#+|%+|//+|;+)\s?")
"""What a comment begins with; a semicolon that is the delimiter is none."""

_MARKS = {codecs.BOM_UTF8: "utf-8-sig", codecs.BOM_UTF32_LE: "utf-32", codecs.BOM_UTF32_BE: "utf-32",
          codecs.BOM_UTF16_LE: "utf-16", codecs.BOM_UTF16_BE: "utf-16"}  # fmt: skip
_NAMES = {"utf-8": "UTF-8", "utf-8-sig": "UTF-8 with a byte-order mark", "utf-16": "UTF-16", "utf-32": "UTF-32",
          "utf-16-le": "UTF-16 without a byte-order mark", "utf-16-be": "UTF-16 without a byte-order mark"}  # fmt: skip
_WORDS = {"\t": "tabs", ";": "semicolons", ",": "commas", "|": "bars", "": "spaces"}
_MARK_OF_LINE = re.compile("(?:^|(?<=[\r\n]))\ufeff")
"""The mark of a file; files that were joined have one where each of them begins."""

_ZEROS = re.compile(r"(?:\A|(?<=[\r\n]))\0+|\0+(?=[\r\n]|\Z)")
"""Zero bytes outside of all cells: a board writes some when it is switched on, and a logger when it is switched off."""

_LINE = re.compile(r"[^\r\n]*(?:\r\n|\n|\r)|[^\r\n]+")
_COMMENT = re.compile(r"\s*(?:#|%|//)")
_NUMBERS = {
    decimal: re.compile(
        rf"[+-]?(?={re.escape(decimal)}?[0-9])(?:[0-9]+|[1-9][0-9]{{0,2}}(?:([{other}'’\u00a0\u202f])[0-9]{{3}})(?:\1[0-9]{{3}})*)?"
        rf"(?:{re.escape(decimal)}[0-9]*)?(?:[eEdD][+-]?[0-9]+)?"
    )
    for decimal, other in (".,", ",.")
}


@dataclass(frozen=True)
class Stated:
    """What whoever gives a file says of it, where that is not read from the file itself.

    `command` is the command line so far, to which a remedy adds an option; without it, a remedy names the option alone.
    `resample`: samples at uneven times are brought onto an even grid. `rate_hz` counts more than any times.
    `section` is the name or number, from 1, of one of several tables in a text.
    """

    encoding: str | None = None
    decimal: str | None = None
    time_unit: str | None = None
    time_column: str | None = None
    command: tuple[str, ...] = ()
    resample: bool = False
    rate_hz: float | None = None
    section: str | None = None

    def __post_init__(self) -> None:
        """Raise `PalpateError` for what is no decimal sign."""
        if self.decimal not in (None, ".", ","):
            raise PalpateError("--decimal", f"got {self.decimal!r}", "choose one of them", allowed="a point, a comma")
        if self.rate_hz is not None and not 0 < self.rate_hz < inf:
            raise PalpateError("--rate", f"got {self.rate_hz} Hz", "choose another rate", allowed="a rate above 0")

    def remedy(self, words: str, *options: str) -> Remedy | str:
        """Return what to do: these words, and the command with the options that are missing."""
        if self.command:
            return Remedy(f"{words}: {{}}", (*self.command, *options))
        return f"{words}: {' '.join(options)}"


NOTHING_STATED = Stated()


@dataclass(frozen=True)
class Understood:
    """How a file was read, for whoever has to judge it.

    `delimiter` is empty for blanks. `decimal` is empty where no number has one. `heading_lines` are those of names and
    units, from 1. `names` and `units` are those of the columns, in order, and `repeated` the names that several have.
    `section` is the name of the one that was read, empty where a text has no others.
    """

    encoding: str
    delimiter: str
    decimal: str
    heading_lines: tuple[int, ...]
    names: tuple[str, ...]
    units: tuple[str, ...]
    first_line: int
    rows: int
    section: str = ""

    @property
    def repeated(self) -> tuple[str, ...]:
        """Return each name that several columns have."""
        return tuple(name for name, times in Counter(self.names).items() if name and times > 1)

    def sentence(self) -> str:
        """Return it for a reader, in one line."""
        decimal = {".": ", decimal points", ",": ", decimal commas", "": ""}[self.decimal]
        lines = ", ".join(map(str, self.heading_lines[:HEADINGS])).rpartition(", ")
        headings = f"headings on line {' and '.join(filter(None, lines[::2]))}" if self.heading_lines else "no headings"
        section = f"section {self.section!r}, " if self.section else ""
        return (
            f"{section}read as {self.encoding}, cells separated by {_WORDS[self.delimiter]}{decimal}; {headings}; "
            f"{self.rows} rows from line {self.first_line}"
        )

    def as_dict(self) -> dict[str, object]:
        """Return it for JSON."""
        return {
            "encoding": self.encoding,
            "delimiter": self.delimiter or " ",
            "decimal": self.decimal or None,
            "heading_lines": list(self.heading_lines),
            "names": list(self.names),
            "units": list(self.units),
            "repeated": list(self.repeated),
            "first_line": self.first_line,
            "rows": self.rows,
            "section": self.section or None,
        }


@dataclass(frozen=True)
class Record:
    """One record: its first line, from 1, where that is in the text, its cells, and whether it is a comment."""

    line: int
    start: int
    cells: list[str]
    comment: bool = False

    @property
    def blank(self) -> bool:
        """Whether nothing stands in any cell."""
        return not any(cell.strip() for cell in self.cells)


@dataclass(frozen=True)
class Table:
    """A table with a header: the records below it, and how it was read."""

    header: tuple[str, ...]
    rows: tuple[Record, ...]
    understood: Understood

    def number(self, cell: str) -> float:
        """Return the number in a cell, NaN where there is none."""
        return number(cell, self.understood.decimal or ".")


def content(path: Path, most: int = LARGEST) -> bytes:
    """Return a file's bytes. Raises `PalpateError` for a file that is too large or cannot be read."""
    try:
        return storage.read_bytes(path, most)
    except OSError as error:
        large = path.is_file() and path.stat().st_size > most
        raise PalpateError(
            path,
            f"cannot be read ({storage.why(error)})",
            "shorten it, or choose another file" if large else "choose another file",
            allowed=f"a text file of at most {most // 2**20} MiB",
        ) from error


def decoded(data: bytes, where: Path | str, stated: Stated = NOTHING_STATED) -> tuple[str, str]:
    """Return the text of a file, and the name of its encoding. Raises `PalpateError` where that is not known."""
    for mark, what in FOREIGN.items():
        if data.startswith(mark):
            remedy = "export it as CSV from the program that wrote it"
            raise PalpateError(where, f"got {what}", remedy, allowed="text, such as CSV")
    encoding = stated.encoding or _encoding(data)
    try:
        text = data.decode(encoding)
    except LookupError:
        raise PalpateError(
            where, f"got the encoding {encoding!r}", "choose another one", allowed=f"UTF-8, UTF-16, {_code_pages()}"
        ) from None
    except UnicodeDecodeError as error:
        at = data.count(b"\n", 0, error.start) + 1
        raise PalpateError(
            where,
            f"got the byte 0x{data[error.start]:02x}, which is not {_NAMES.get(encoding, encoding)}",
            stated.remedy("give the file's code page", "--encoding", _other_code_page(encoding)),
            allowed=f"UTF-8, UTF-16, or a code page that you give: {_code_pages()}",
            line=at,
        ) from None
    # Both are looked for first: to try such a pattern everywhere takes twenty times as long as to read the numbers.
    text, zeros = _ZEROS.subn("", text) if "\0" in text else (text, 0)
    if "\0" in text:
        line = text.count("\n", 0, text.index("\0")) + 1
        raise PalpateError(where, "got U+0000, a zero byte", "export it as text", allowed="text", line=line)
    without = ", without zero bytes at line endings" if zeros else ""
    text = _MARK_OF_LINE.sub("", text) if "\ufeff" in text else text
    return text, _NAMES.get(encoding, f"{encoding}, as you stated") + without


def _encoding(data: bytes) -> str:
    for mark, encoding in _MARKS.items():
        if data.startswith(mark):
            return encoding
    # Of UTF-16 without a mark every other byte is zero, where most letters are those of ASCII.
    head = data[:4096]
    for encoding, zeros in (("utf-16-le", head[1::2]), ("utf-16-be", head[::2])):
        if zeros and zeros.count(0) > len(zeros) / 2 and not len(data) % 2:
            return encoding
    return "utf-8"


def _code_pages() -> str:
    return ", ".join(f"{name} ({where})" for name, where in CODE_PAGES.items())


def _other_code_page(encoding: str) -> str:
    return next(name for name in CODE_PAGES if name != encoding)


def records(
    text: str, delimiter: str, start: int = 0, line: int = 1, *, strict: bool = True, below: bool = True
) -> Iterator[Record]:
    """Yield every record from a place in the text on, where such a line begins; blank lines have no cells.

    A line that begins with `#`, `%`, `//`, or a semicolon that is no delimiter, is a comment, unless a quoted cell goes
    on there; below the first record only if `below`. Raises `csv.Error` where `strict`, for quotes without end too.
    """
    # `csv` bounds the length of a cell for the whole process; the file itself is bounded.
    csv.field_size_limit(max(csv.field_size_limit(), len(text)))
    lines = ((match.start(), match[0]) for match in _LINE.finditer(text, start))
    reached, comments = 0, True

    def following(first: str) -> Iterator[str]:
        nonlocal reached
        reached += 1
        yield first
        for _, more in lines:
            reached += 1
            yield more

    for place, one in lines:
        begun = line + reached
        if not one.strip():
            reached += 1
            yield Record(begun, place, [])
        elif comments and (_COMMENT.match(one) or (delimiter != ";" and one.lstrip().startswith(";"))):
            reached += 1
            yield Record(begun, place, [one], comment=True)
        elif delimiter:
            comments = below
            yield Record(begun, place, next(csv.reader(following(one), delimiter=delimiter, strict=strict)))
        else:
            reached += 1
            yield Record(begun, place, [cell.strip('"') for cell in re.findall(r'"[^"]*"|[^\s"]+', one)])


def number(cell: str, decimal: str) -> float:
    """Return the number in a cell, NaN where there is none.

    It may have thousands in groups of three, an exponent as Fortran writes it, and no digit before its decimal sign.
    """
    text = cell.strip().replace("\u2212", "-")
    match = _NUMBERS[decimal].fullmatch(text)
    if match is None:
        return nan
    text = text.replace(match[1], "") if match[1] else text
    return float(text.replace(decimal, ".").lower().replace("d", "e"))


def decimal_sign(cells: Iterable[str], delimiter: str, *, printed: bool = False) -> str | None:
    """Return the sign under which more of these cells are numbers, empty where none has one, None where it is unclear.

    Three digits behind a point are decimals, unless semicolons part the cells: then commas may be the decimal signs.
    Where no other number has thousands, such a number beside others with the other sign is unclear, unless it is
    `printed`: a logger, or whoever typed it, may have written one number as another country does.
    """
    bad, differ, either, parts = {".": 0, ",": 0}, "", set[str](), {".": False, ",": False}
    for cell in cells:
        if "." not in cell and "," not in cell:
            continue
        text = cell.strip().replace("\u2212", "-")
        fits = {decimal: bool(_NUMBERS[decimal].fullmatch(text)) for decimal in bad}
        for decimal, is_number in fits.items():
            bad[decimal] += not is_number
            parts[decimal] |= is_number and not all(fits.values()) and ("," if decimal == "." else ".") in text
        if all(fits.values()):
            either.add("," if "," in text else ".")
            differ = "," if "," in cell else differ or "."
    if bad["."] != bad[","]:
        decimal = min(bad, key=bad.__getitem__)
        return decimal if printed or parts[decimal] or either <= {decimal} else None
    if not differ:
        return "." if bad["."] else ""
    return "." if differ == "." and delimiter != ";" else None


def delimiter_of(text: str, wanted: Sequence[str] = ()) -> str:
    """Return the delimiter of a table: the one under which most wanted names are in one record, then the one that
    makes most records equally wide, then the one that makes most cells numbers.
    """  # fmt: skip

    heads: dict[str, list[Record]] = {}
    for delimiter in DELIMITERS:
        try:
            head = [one for one in islice(records(text, delimiter, strict=False), SAMPLE) if not one.comment]
        except csv.Error:
            continue
        heads[delimiter] = [one for one in head if not one.blank]

    def merit(delimiter: str) -> tuple[int, float]:
        head = heads[delimiter]
        named = max((len(set(wanted) & {cell.strip() for cell in one.cells}) for one in head[:HEADINGS]), default=0)
        widths = Counter(len(one.cells) for one in head)
        width, count = widths.most_common(1)[0] if widths else (0, 0)
        return named, count / len(head) if width > 1 else 0.0

    def numbers(delimiter: str) -> float:
        cells = [cell for one in heads[delimiter] for cell in one.cells]
        found = sum(any(_NUMBERS[decimal].fullmatch(cell.strip()) for decimal in ".,") for cell in cells)
        return found / max(len(cells), 1)

    merits = {delimiter: merit(delimiter) for delimiter in heads}
    best = [delimiter for delimiter in merits if merits[delimiter] == max(merits.values())]
    return max(best, key=numbers) if len(best) > 1 else next(iter(best), DELIMITERS[0])


def read_table(
    path: Path, wanted: Sequence[str], numbers: Sequence[str] = (), stated: Stated = NOTHING_STATED
) -> Table:
    """Return the table in a file, as `table_of` does."""
    return table_of(path, content(path), wanted, numbers, stated)


def table_of(
    path: Path, data: bytes, wanted: Sequence[str], numbers: Sequence[str] = (), stated: Stated = NOTHING_STATED
) -> Table:
    """Return a table whose header has the `wanted` columns, those of `numbers` with one decimal sign.

    Its header is the first record that has them all, or else the first record. Raises `PalpateError` for a file that
    cannot be read, and where a name or the decimal sign is not clear.
    """
    text, encoding = decoded(data, path, stated)
    delimiter = delimiter_of(text, wanted)
    every = _all_records(path, text, delimiter)
    heads = [[cell.strip() for cell in one.cells] for one in every[:HEADINGS]]
    at = next((place for place, cells in enumerate(heads) if set(wanted) <= set(cells)), 0)
    header, rows = tuple(heads[at]) if heads else (), tuple(every[at + 1 :])
    places = [header.index(name) for name in numbers if name in header]
    cells = [one.cells[place] for one in rows for place in places if place < len(one.cells)]
    decimal = stated.decimal or decimal_sign(cells, delimiter)
    if decimal is None:
        raise unclear_decimal(path, stated, decimal_sign(cells, delimiter, printed=True))
    lines = (every[at].line,) if every else ()
    first = rows[0].line if rows else 0
    return Table(header, rows, Understood(encoding, delimiter, decimal, lines, header, (), first, len(rows)))


def _all_records(path: Path, text: str, delimiter: str) -> list[Record]:
    every: list[Record] = []
    try:
        every += (one for one in records(text, delimiter, below=False) if not one.comment and not one.blank)
    except csv.Error as error:
        line = every[-1].line + 1 if every else 1
        raise PalpateError(path, str(error), "write plain CSV", line=line) from error
    return every


def unclear_decimal(where: Path | str, stated: Stated, likely: str | None = None) -> PalpateError:
    """Return the error for numbers such as 1,234, which are thousands in one country and decimals in another."""
    return PalpateError(
        where,
        "got numbers such as 1,234, where the sign may separate thousands or decimals",
        stated.remedy("give the decimal separator", "--decimal", likely or ","),
        allowed="a number that makes this clear, or the decimal separator",
    )
