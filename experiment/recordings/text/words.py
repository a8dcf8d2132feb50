"""Words among the numbers of a recording: columns of phases, markers and activities, which are no channels, and names
before each number, as sketches of the Arduino write them.
"""  # fmt: skip

import csv
import io
import re
from collections import Counter
from itertools import islice, pairwise
from math import isfinite, nan

from palpate.experiment.errors import RecordingError
from palpate.experiment.recordings.text.cells import is_missing, is_number
from palpate.experiment.settings.delimited import DELIMITERS, SAMPLE, number, records

FEWEST, MOST = 0.9, 0.1
"""Of the rows of a sample, this share or more has a number in a channel, and this share or less in words. Ours."""


_HEXADECIMAL = re.compile(r"(?<![^\s;,|\"'])0[xX]([0-9A-Fa-f]{1,8})(?![^\s;,|\"'])")
_NAMED = re.compile(r"([A-Za-z_]\w*)\s*[:=]\s*([+-]?[0-9.]+(?:[eE][+-]?[0-9]+)?)[\s,;]*")


def without_names(text: str) -> str | None:
    """Return a text whose lines are `x:1.5 y:2` as columns with a heading; None for another.

    What stands above the first such line is left out, and each line stays a line of its own.
    """
    lines = text.splitlines()
    rows = [_NAMED.findall(one) if _NAMED.sub("", one).strip() == "" else [] for one in lines]
    names = Counter(tuple(name for name, _ in row) for row in rows if row)
    if len(names) != 1 or names.total() < 2 or (not rows[0] and names.total() < len(lines) / 2):
        return None
    (header,) = names
    begins = next(place for place, row in enumerate(rows) if row)
    body = [",".join(value for _, value in row) for row in rows[begins:]]
    return "\n".join([*[""] * (begins - 1), ",".join(header), *body, ""])


def without_hexadecimals(text: str) -> str | None:
    """Return a text with whole numbers for those such as 0x1F2; None without any, and where they may be negative.

    They may where all have two, four or eight digits at most, and the first bit of these is set in some.
    """
    found = _HEXADECIMAL.findall(text) if "0x" in text or "0X" in text else []
    widest = max(map(len, found), default=0)
    signed = widest in (2, 4, 8) and any(len(one) == widest and one[0] in "89ABCDEFabcdef" for one in found)
    return None if signed or not found else _HEXADECIMAL.sub(lambda match: str(int(match[1], 16)), text)


def refuse_hexadecimals(text: str) -> None:
    """Refuse numbers such as 0xFFFE, which may be negative."""
    if found := _HEXADECIMAL.search(text):
        raise RecordingError(
            f"got hexadecimal numbers such as {found[0].strip()[:40]!r}, which may or may not be signed",
            remedy="export decimal numbers",
            allowed="hexadecimal numbers whose first bit is not set",
            line=text.count("\n", 0, found.start()) + 1,
        )


def without_words(text: str) -> str | None:
    """Return a text without its columns of words, headings included; None where fewer than two others are left.

    Each line stays a line of its own.
    """
    for delimiter in DELIMITERS:
        width, kept = _channels(text, delimiter)
        if not 2 <= len(kept) < width:
            continue
        if (width, kept) == (3, [0, 1]):
            _refuse_labels(text, delimiter)
        lines = []
        for one in text.splitlines():
            cells = next(csv.reader([one], delimiter=delimiter), [])
            lines.append(_line([cells[place] for place in kept], delimiter) if len(cells) == width else one)
        return "\n".join([*lines, ""])
    return None


def _refuse_labels(text: str, delimiter: str) -> None:
    """Refuse beginnings, ends and labels of what is in a recording, as Audacity exports them: no one overlaps another.

    A line that begins with a backslash has the frequencies of the label above.
    """
    lines = [one for one in text.splitlines() if one and not one.startswith("\\")]
    edges = (_number(cell) for line in lines for cell in line.split(delimiter)[:2])
    if all(before <= after for before, after in pairwise(edges)):
        raise RecordingError(
            f"got {len(lines)} labels with start and end times",
            remedy="give the recording itself",
            allowed="samples of a recording",
        )


def _number(cell: str) -> float:
    """Return a number with a decimal point or a decimal comma; NaN for another cell."""
    return next(filter(isfinite, (number(cell, decimal) for decimal in ".,")), nan)


def _channels(text: str, delimiter: str) -> tuple[int, list[int]]:
    """Return how many cells most records have, and the places of numbers; no place where a column is neither."""
    sample = [one.cells for one in islice(records(text, delimiter, strict=False), SAMPLE) if not one.comment]
    widths = Counter(len(cells) for cells in sample if len(cells) > 1)
    if not widths:
        return 0, []
    width, _ = widths.most_common(1)[0]
    rows = [cells for cells in sample if len(cells) == width and any(map(is_number, cells))]
    shares = [sum(is_number(row[at]) or is_missing(row[at]) for row in rows) / max(len(rows), 1) for at in range(width)]
    if any(MOST < share < FEWEST for share in shares):
        return width, []
    return width, [place for place, share in enumerate(shares) if share >= FEWEST]


def _line(cells: list[str], delimiter: str) -> str:
    made = io.StringIO()
    csv.writer(made, delimiter=delimiter, lineterminator="").writerow(cells)
    return made.getvalue()
