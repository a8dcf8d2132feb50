"""Who is who in files of trials: spellings that may be one person's, and the labels of the dataset."""

import re
import unicodedata
from collections.abc import Iterator, Sequence
from pathlib import Path

from palpate.experiment.dataset.imports.layout import Layout
from palpate.experiment.dataset.imports.refusals import all_of, refused
from palpate.experiment.dataset.imports.trial_files import Row, Trials
from palpate.experiment.settings.characters import LOOK_ALIKES, quoted, skeleton
from palpate.experiment.settings.delimited import Stated

GERMAN = str.maketrans({"ä": "ae", "ö": "oe", "ü": "ue", "ø": "oe", "æ": "ae", "å": "aa"})
"""How these letters are written where a keyboard lacks them."""

UNMARKED = str.maketrans("øłđ", "old")
"""Letters whose stroke is no mark of its own in Unicode."""

BETWEEN = r"[-_.,'\s]+"
"""What stands between the words of a label."""

NUMBERED = re.compile(r"(\D*?)0*([0-9]{1,6})(?:\.0)?")
"""A label of a prefix and a number, as P02 or 2.0."""


def refuse_alike(paths: Sequence[Path], layout: Layout, trials: Trials, stated: Stated) -> None:
    """Refuse spellings that may be one person's: P01 and 1, Müller and Mueller, Anna Meier and Meier-Anna.

    A cell that `people` maps to itself is a person of its own.
    """
    known: dict[str, str] = {}
    firsts = {row.participant: row for row in reversed(trials.rows)}
    errors = []
    for who in dict.fromkeys(row.participant for row in trials.rows):
        if layout.people.get(who) == who:
            continue
        forms, numbers = set(_forms(who)), set(_numbers(who))
        # Two prefixes may be two groups, and a number alone may be of either.
        akin = {*forms, *(f"{'bare' if prefix else 'prefixed'} {number}" for prefix, number in numbers)}
        if other := next((known[form] for form in sorted(akin) if form in known), ""):
            errors.append(
                refused(
                    paths[firsts[who].file - 1],
                    trials.place(firsts[who]),
                    f"column {layout.participant}" if layout.participant else "--participant-in-name",
                    f"{quoted(who)} and {quoted(other)}, which may be the same person",
                    "one spelling per participant",
                    stated.remedy(
                        "if they are two people, map one label to itself (CELL=CELL); if they are one person, map "
                        "one label to the other",
                        "--map-participant",
                        f"{who}={other}",
                    ),
                )
            )
        forms |= {f"{'prefixed' if prefix else 'bare'} {number}" for prefix, number in numbers}
        known |= {form: other or who for form in forms if form not in known}
    if errors:
        raise all_of(errors, stated)


def labels(rows: Sequence[Row]) -> tuple[dict[str, str], bool]:
    """Return each participant's label by cell, and whether labels keep the cells' numbers, as for P01, P02."""
    cells = list(dict.fromkeys(row.participant for row in rows))
    matches = [re.fullmatch(r"(.*?)0*([0-9]{1,6})(?:\.0)?", cell) for cell in cells]
    prefixes = {match[1] for match in matches if match}
    kept = all(matches) and len(prefixes) == 1 and not re.search(r"[0-9]", min(prefixes))
    numbers = [int(match[2]) if match else 0 for match in matches] if kept else list(range(1, len(cells) + 1))
    width = max(2, len(str(max(numbers))))
    return {cell: f"{number:0{width}d}" for cell, number in zip(cells, numbers, strict=True)}, kept


def _folded(name: str) -> Iterator[str]:
    """Yield a label in small letters, with umlauts as two letters, and without marks."""
    plain = unicodedata.normalize("NFKC", name).translate(LOOK_ALIKES).casefold()
    for one in (plain.translate(GERMAN), plain.translate(UNMARKED)):
        yield re.sub("[\u0300-\u036f]", "", unicodedata.normalize("NFD", one))


def _joined(folded: str) -> str:
    """Return a label without what stands between its words; between digits it parts two numbers: 1-12 is not 11-2."""
    return re.sub(rf"(?<![0-9]){BETWEEN}|{BETWEEN}(?![0-9])", "", folded)


def _forms(name: str) -> Iterator[str]:
    """Yield what a label shares with each other one that may be the same person's."""
    yield skeleton(name)
    for folded in _folded(name):
        yield _joined(folded)
        words = [word for word in re.split(BETWEEN, folded) if word]
        # Of two numbers the order may count: A1 B2 is not B1 A2.
        if len(words) > 1 and sum(bool(re.search("[0-9]", word)) for word in words) < 2 and max(map(len, words)) > 1:
            yield " ".join(sorted(words))
    for prefix, number in _numbers(name):
        yield f"{prefix} {number}"


def _numbers(name: str) -> Iterator[tuple[str, str]]:
    """Yield the prefix and the number of a label that has one number at its end."""
    for form in (skeleton(name), *map(_joined, _folded(name))):
        if number := NUMBERED.fullmatch(form):
            yield number[1], number[2]
