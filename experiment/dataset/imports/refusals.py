"""All that is wrong with files of trials as one error: each kind once, and one command with every option it needs."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from palpate.experiment.errors import DatasetError, Finding, Remedy
from palpate.experiment.findings import shown
from palpate.experiment.settings.characters import quoted
from palpate.experiment.settings.delimited import Stated

MOST_LISTED = 12
"""The most columns or values that an error lists."""


@dataclass(frozen=True)
class Place:
    """The line of a table where a row begins, or the element of a JSON list."""

    number: int
    part: str = "line"


def refused(path: Path, place: Place, field: str, got: str, allowed: str, remedy: Remedy | str) -> DatasetError:
    """Return the error of one value, as `got` quotes it."""
    finding = Finding(
        f"got {got}", path, line=place.number, part=place.part, field=field, allowed=allowed, remedy=remedy
    )
    return DatasetError.at(finding)


def listed(values: Sequence[str] | Mapping[str, None]) -> str:
    """Return the first values between commas, and how many more there are."""
    named = [value if value.isprintable() and value else quoted(value) for value in values]
    more = f" and {len(named) - MOST_LISTED} more" if len(named) > MOST_LISTED else ""
    return ", ".join(named[:MOST_LISTED]) + more


def all_of(errors: Sequence[DatasetError], stated: Stated) -> DatasetError:
    """Return one error of all: the only one as it is, or each kind with how often it occurs and where first.

    The last finding of several kinds has the command with the options of all.
    """
    if len(errors) == 1:
        return errors[0]
    kinds: dict[tuple[str, str, str, str], list[Finding]] = {}
    for error in errors:
        one = error.finding
        kinds.setdefault((one.field, one.what, one.allowed, str(one.remedy)), []).append(one)
    firsts = [replace(same[0], line=None, what=f"{same[0].what} in {_places(same)}") for same in kinds.values()]
    if len(kinds) == 1:
        return DatasetError.at(firsts[0])
    needed = list(dict.fromkeys(options for one in firsts if (options := _options(one.remedy, stated))))
    several = len(needed) > 1
    told = [replace(one, remedy=_short(one.remedy, stated)) if several else one for one in firsts[:MOST_LISTED]]
    if len(kinds) > MOST_LISTED:
        told.append(Finding(f"and {len(kinds) - MOST_LISTED} more kinds of errors"))
    if several:
        command = (*stated.command, *(word for options in needed for word in options))
        told.append(Finding(f"{len(needed)} options are missing", remedy=Remedy("add all at once: {}", command)))
    files = list(dict.fromkeys(str(error.finding.where) for error in errors))
    named = files[0] if len(files) == 1 else f"{files[0]} and {len(files) - 1} other files"
    return DatasetError.in_file(f"{named}, in {len(errors)} places", told)


def _options(remedy: Remedy | str, stated: Stated) -> tuple[str, ...]:
    """Return what a remedy adds to the command."""
    base = stated.command
    adds = isinstance(remedy, Remedy) and bool(base) and remedy.command[: len(base)] == base
    return remedy.command[len(base) :] if isinstance(remedy, Remedy) and adds else ()


def _short(remedy: Remedy | str, stated: Stated) -> Remedy | str:
    """Return a remedy in words, with the option that it adds alone."""
    options = _options(remedy, stated)
    return remedy.words.format(shown(options)) if isinstance(remedy, Remedy) and options else remedy


def _places(same: Sequence[Finding]) -> str:
    """Return where findings of one kind are."""
    one = same[0]
    first = str(one.where) if one.line is None else f"{one.part} {one.line} of {one.where}"
    return first if len(same) == 1 else f"{len(same)} {'files' if one.line is None else 'rows'}, the first in {first}"
