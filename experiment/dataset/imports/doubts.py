"""What is implausible of trials that were read: practice among them, and response times in another unit."""

import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from statistics import median

from palpate.experiment.dataset.imports.layout import ABSENT, ANY, RIGHT, Layout
from palpate.experiment.dataset.imports.refusals import listed
from palpate.experiment.errors import Finding, Remedy
from palpate.experiment.settings.characters import quoted
from palpate.experiment.settings.delimited import Stated

FASTEST_S, SLOWEST_S = 0.05, 60.0
"""Nobody answers in a median time outside of these: another unit is more likely."""

MOST_PHASES = 200
"""A column with more different cells than this does not name phases."""

MOST_SCREENS = 12
"""A column with more different cells than this does not name screens or kinds of rows."""

PRACTICE = re.compile(
    r"(?<![a-z])(practi[cs]|training|warm[ _-]?up|familiari[sz]ation|tutorial|übung|uebung|probe(durchg|lauf|trial)"
    r"|(demo|demos|demonstration|prac)(?![a-z]))"
)
"""What a column or a cell says, in small letters, of trials that are no part of the measurement."""

SUMMARY = re.compile(
    r"(grand |overall )?(totals?|sums?|means?|averages?|avg|medians?|sd|std|overall|all|"
    r"summe|gesamt|insgesamt|mittelwert|mittel|durchschnitt)"
)
"""What a row below those of the participants is called, in small letters, that sums them up."""

LOOP = re.compile(r"\.(this\w*|ran|order|started|stopped)$")
"""How the columns end that PsychoPy fills in the rows of one loop or routine, and leaves empty in others."""


class Practice:
    """Which trials a column calls practice, gathered a row at a time."""

    def __init__(self, layout: Layout) -> None:
        """Begin with no row; what `layout` names has another meaning."""
        self._layout = layout
        self._cells: dict[str, dict[str, str]] = {}
        self._found: dict[str, dict[int, str]] = {}
        self._people: list[str] = []

    def add(self, participant: str, header: Sequence[str], cells: Sequence[str]) -> None:
        """Take the next trial."""
        row = len(self._people)
        self._people.append(participant)
        named = self._layout.columns()
        for column, cell in zip(header, cells, strict=False):
            known = self._cells.setdefault(column, {})
            if column in named or len(known) > MOST_PHASES:
                continue
            if cell not in known:
                known[cell] = _practice(column, cell.strip())
            if value := known[cell]:
                self._found.setdefault(column, {})[row] = value

    def doubts(self, stated: Stated) -> tuple[Finding, ...]:
        """Return each set of trials that a column calls practice, where its participants have others too."""
        reported: set[int] = set()
        found = []
        columns = [one for one in self._found if len(self._cells[one]) <= MOST_PHASES and self._parts(one)]
        for column in sorted(columns, key=lambda one: -len(self._found[one])):
            rows = self._found[column]
            if reported.issuperset(rows):
                continue
            reported |= set(rows)
            values = list(dict.fromkeys(rows.values()))
            says = "a value" if values == [ANY] else " or ".join(map(quoted, values[:3]))
            options = [word for value in values for word in ("--leave-out", f"{column}={value}")]
            found.append(
                Finding(
                    f"{len(rows)} of {len(self._people)} trials with {says} may be practice trials, but they are "
                    "counted",
                    field=f"column {column}",
                    remedy=stated.remedy(
                        "if this is the case, delete the dataset and import again without them", *options
                    ),
                    verdict="warns",
                    check="practice",
                )
            )
        return tuple(found)

    def _parts(self, column: str) -> bool:
        """Return whether somebody has trials of both kinds; a group may be called training."""
        rows = self._found[column]
        practiced = {self._people[row] for row in rows}
        return any(row not in rows and who in practiced for row, who in enumerate(self._people))


class Unanswered:
    """Which value of a column rows without any answer have, such as those of fixation crosses, gathered by the row."""

    def __init__(self, layout: Layout) -> None:
        """Begin with no row; what `layout` names has another meaning."""
        self._named = frozenset(layout.columns())
        self._answers: dict[str, dict[str, list[int]]] = {}
        self._many: set[str] = set()
        self._rows = 0

    def add(self, header: Sequence[str], cells: Sequence[str], *, answered: bool) -> None:
        """Take the next trial."""
        self._rows += 1
        for column, cell in zip(header, cells, strict=False):
            if column in self._many or column in self._named:
                continue
            known = self._answers.setdefault(column, {})
            known.setdefault(cell, [0, 0])[answered] += 1
            if len(known) > MOST_SCREENS:
                self._many.add(column)

    def doubts(self, stated: Stated) -> tuple[Finding, ...]:
        """Return the first column of which some values are never answered, and others are, in a third of all rows."""
        for column, known in self._answers.items():
            never = {cell: none for cell, (none, some) in known.items() if not some and cell.strip() not in ABSENT}
            rows = sum(never.values())
            if column in self._many or len(never) == len(known) or rows * 3 < self._rows:
                continue
            says = " or ".join(map(quoted, list(never)[:3]))
            options = [word for cell in never for word in ("--leave-out", f"{column}={cell}")]
            what = f"{rows} of {self._rows} trials with {says} never have an answer, but they are counted"
            remedy = stated.remedy("if they are not trials, delete the dataset and import again without them", *options)
            return (Finding(what, field=f"column {column}", remedy=remedy, verdict="warns", check="no answer"),)
        return ()


def _practice(column: str, cell: str) -> str:
    """Return what `leave_out` names a cell by that says practice, or nothing."""
    if cell in ABSENT:
        return ""
    if PRACTICE.search(column.lower()):
        if LOOP.search(column):
            return ANY
        if RIGHT.get(cell.lower()) or cell.lower() in ("y", "x", "t"):
            return cell
    return cell if len(cell) <= 40 and PRACTICE.search(cell.lower()) else ""


def wide_doubts(columns: Iterable[str], layout: Layout) -> tuple[Finding, ...]:
    """Return the columns that look like further trials of each row: t2_material beside t1_material."""
    shape, number = re.sub("[0-9]+", "#", layout.presented), re.compile("[0-9]+")
    further = sorted(
        one for one in columns if one not in layout.columns() and "#" in shape and number.sub("#", one) == shape
    )
    if not further:
        return ()
    what = f"is read, but {listed(further)} are not, although they look like additional trials in the same rows"
    remedy = "write one row per trial, for example with R's pivot_longer"
    return (Finding(what, field=f"column {layout.presented}", remedy=remedy, verdict="warns", check="wide"),)


def summary_doubts(participants: Iterable[str], layout: Layout, stated: Stated) -> tuple[Finding, ...]:
    """Return the participant of each trial that is called as rows are which sum up the others."""
    trials = Counter(participants)
    called = {who for who in trials if SUMMARY.fullmatch(re.sub(r"[\s_-]+", " ", who.lower()).strip(" .:="))}
    if not called or layout.participant is None or called == set(trials):
        return ()
    written = dict.fromkeys((*(cell for cell, who in layout.people.items() if who in called), *sorted(called)))
    what = (
        f"{listed([quoted(who) for who in sorted(called)])} may be a summary of the others, but counts as a participant"
    )
    options = [word for cell in written for word in ("--leave-out", f"{layout.participant}={cell}")]
    remedy = stated.remedy("if this is the case, delete the dataset and import again without such rows", *options)
    return (Finding(what, field=f"column {layout.participant}", remedy=remedy, verdict="warns", check="summary"),)


def time_doubts(times: Mapping[str, Sequence[float]], layout: Layout, stated: Stated) -> tuple[Finding, ...]:
    """Return what is implausible of the response times in seconds of each participant."""
    medians = {who: median(some) for who, some in times.items() if some}
    strange = {who: usual for who, usual in medians.items() if not FASTEST_S <= usual <= SLOWEST_S}
    if not strange:
        return _slow_doubts([time for some in times.values() for time in some], layout, stated)
    if len(strange) == len(medians):
        usual = median(time for some in times.values() for time in some)
        what = f"the median response time of {usual:.3g} s is implausible"
        remedy = _in_unit(strange, layout, stated)
    else:
        named = listed([f"{quoted(who)} ({usual:.3g} s)" for who, usual in strange.items()])
        what = f"the median response times of {len(strange)} of {len(medians)} participants are implausible: {named}"
        remedy = _unit_remedy(strange, layout, stated)
    allowed = f"{FASTEST_S:g} to {SLOWEST_S:g} s"
    field = f"column {layout.time}"
    return (Finding(what, field=field, allowed=allowed, remedy=remedy, verdict="warns", check="response times"),)


def _slow_doubts(times: Sequence[float], layout: Layout, stated: Stated) -> tuple[Finding, ...]:
    """Return single times in which nobody answers; a program may write such a number where no answer came."""
    slow = Counter(time for time in times if time > SLOWEST_S)
    if not slow:
        return ()
    factor = 1.0 if layout.time_s is not None else 1e3
    options = [word for time in slow for word in ("--missing-time", f"{time * factor:.10g}")]
    remedy = stated.remedy("if they mean no response, delete the dataset and import again", *options)
    if len(slow) > MOST_SCREENS:
        remedy = f"check {layout.time}"
    what = f"{slow.total()} of {len(times)} response times are above {SLOWEST_S:g} s, the longest {max(slow):.4g} s"
    field = f"column {layout.time}"
    return (Finding(what, field=field, remedy=remedy, verdict="warns", check="response times"),)


def _likely_unit(medians: Mapping[str, float], layout: Layout) -> str:
    """Return the unit in which all these would be plausible, or nothing."""
    unit, factor = ("milliseconds", 1e-3) if layout.time_s is not None else ("seconds", 1e3)
    return unit if all(FASTEST_S <= usual * factor <= SLOWEST_S for usual in medians.values()) else ""


def _in_unit(medians: Mapping[str, float], layout: Layout, stated: Stated) -> Remedy | str:
    """Return what to do about times of everybody."""
    unit = _likely_unit(medians, layout)
    if not unit:
        return f"check the unit of {layout.time}"
    words = tuple(f"--{unit}" if word in ("--seconds", "--milliseconds") else word for word in stated.command)
    command = words or ("palpate", "import-trials", f"--{unit}", str(layout.time))
    return Remedy(f"if they are in {unit}, delete the dataset and import again: {{}}", command)


def _unit_remedy(medians: Mapping[str, float], layout: Layout, stated: Stated) -> Remedy | str:
    """Return what to do about times of some participants."""
    unit = _likely_unit(medians, layout)
    likely = f"; these times may be in {unit}" if unit else ""
    words = f"check the unit of {layout.time} in their files{likely}, and export all files with the same unit"
    if layout.participant is None:
        return words
    meant = {cell: label for cell, label in layout.people.items() if label in medians}
    cells = dict.fromkeys((*meant, *(who for who in medians if layout.people.get(who, who) == who)))
    options = [word for cell in cells for word in ("--leave-out", f"{layout.participant}={cell}")]
    return stated.remedy(f"{words}, or delete the dataset and import again without these times", *options)
