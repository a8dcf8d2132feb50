"""What a laboratory says of its tables of trials: which column holds what, and which rows and times count."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from palpate.experiment.dataset.imports.times import is_several
from palpate.experiment.errors import DatasetError
from palpate.experiment.settings.characters import quoted
from palpate.experiment.settings.delimited import number

ABSENT = ("", "None", "null", "NA")
"""Cells in which nothing stands: empty, and as PsychoPy and OpenSesame, jsPsych, and R write it."""

RIGHT = dict.fromkeys(("1", "1.0", "true", "correct", "yes", "right", "hit"), True)
WRONG = dict.fromkeys(("0", "0.0", "false", "incorrect", "no", "wrong", "miss"), False)
"""What stands for right and wrong, in small letters."""

ANY = "*"
"""In `leave_out`: any cell that is not empty."""

SEVERAL = "[*, *]"
"""In `leave_out`: any list of several elements."""

AGAIN = (ANY, "again")
"""In `leave_out`: each row that stands above, too, cell by cell."""

MISSING_TIMES = ("negative", "zero")
"""Rules by which a response time counts as missing; anything else is the number or word that stands for one."""


@dataclass(frozen=True)
class Layout:
    """Which column holds what.

    `presented` is that of the material, `second` of the one that it is compared with, if any. Either `answered` names
    the answer, or `correct` says whether it was right. `participant` is a column; without it `in_name` shows with `{}`
    where the label stands in a file's name, and `*` for anything else. `session` tells sessions of one task apart.
    `answers`, `materials` and `people` translate cells; `where` gives the cells that make a row a trial, `leave_out`
    those that leave a row out. At most one of `time_s` and `time_ms` names the column of response times, and
    `missing_times` are rules for these.
    """

    presented: str
    answered: str | None
    participant: str | None
    task: str | None = None
    trial: str | None = None
    time_s: str | None = None
    time_ms: str | None = None
    answers: Mapping[str, str] = field(default_factory=dict)
    materials: Mapping[str, str] = field(default_factory=dict)
    where: Mapping[str, str] = field(default_factory=dict)
    people: Mapping[str, str] = field(default_factory=dict)
    second: str | None = None
    correct: str | None = None
    in_name: str | None = None
    leave_out: Sequence[tuple[str, str]] = ()
    missing_times: Sequence[str] = ()
    session: str | None = None

    def __post_init__(self) -> None:
        """Raise `DatasetError` where what is stated cannot hold together."""
        if self.presented in (self.answered, self.second):
            other = "--answered" if self.presented == self.answered else "--second"
            raise DatasetError(
                other, f"got the column {self.presented}, as for --presented", "give the column of the answers",
                allowed="another column",
            )  # fmt: skip
        if (self.answered is None) == (self.correct is None):
            got = "neither" if self.correct is None else "both"
            raise DatasetError(f"got {got} of --answered and --correct", remedy="give one", allowed="one of them")
        if self.correct is not None and self.second is not None:
            raise DatasetError("got --correct and --second", remedy="give the chosen material with --answered")
        if (self.participant is None) == (self.in_name is None):
            got = "neither" if self.in_name is None else "both"
            raise DatasetError(
                f"got {got} of --participant and --participant-in-name", remedy="give one", allowed="one of them"
            )
        for rule in self.missing_times:
            if not rule.strip():
                raise DatasetError(
                    "--missing-time", f"got {quoted(rule)}", "choose one", allowed="negative, zero, a number, or a word"
                )

    @property
    def time(self) -> str | None:
        """The column of response times."""
        return self.time_s or self.time_ms

    def columns(self) -> tuple[str, ...]:
        """Return every column that is read, once."""
        return tuple(dict.fromkeys((*self.needed(), *(column for column, _ in self.leave_out))))

    def needed(self) -> tuple[str, ...]:
        """Return every column that each file must have, once; one that leaves rows out may be in some alone."""
        named = (self.presented, self.second, self.answered, self.correct, self.participant, self.task, self.trial)
        given = (*named, self.session, self.time, *self.where)
        return tuple(dict.fromkeys(one for one in given if one is not None))

    def is_left_out(self, cell: str, value: str) -> bool:
        """Return whether a value of `leave_out` is this cell's; `*` is any that is not empty, `[*, *]` a list of
        several.
        """  # fmt: skip
        return cell == value or (value == ANY and cell not in ABSENT) or (value == SEVERAL and is_several(cell))

    def label_in(self, path: Path) -> str:
        """Return the participant in a file's name. Raises `DatasetError` for a name that is not as stated."""
        shape = self.in_name or ""
        parts = [re.escape(part).replace(r"\*", ".*?") for part in shape.split("{}")]
        match = re.fullmatch("(.+?)".join(parts), path.name) if len(parts) == 2 else None
        if match is None:
            allowed = f"a name such as {shape}" if len(parts) == 2 else "{} once, for example 'sub-{}_*.csv'"
            raise DatasetError(
                path, f"--participant-in-name: got {quoted(shape)}", "use {} for the label", allowed=allowed
            )
        return match[1]

    def is_missing(self, cell: str, time: float) -> bool:
        """Return whether a rule takes a cell of response times, and the time in it, for a missing one."""
        rules = set(self.missing_times)
        named = cell in rules - set(MISSING_TIMES) or any(number(rule, ".") == time for rule in rules)
        return named or ("negative" in rules and time < 0) or ("zero" in rules and time == 0)


def pairs(option: str, texts: Sequence[str]) -> dict[str, str]:
    """Return left -> right of the texts of an option, such as `f=felt`. Raises `DatasetError` for any other text."""
    found: dict[str, str] = {}
    for text in texts:
        left, equals, right = (part.strip() for part in text.rpartition("="))
        if not (equals and right) or left in found:
            again = " a second time" if left in found else ""
            raise DatasetError(option, f"got {quoted(text)}{again}", "correct it", allowed="LEFT=RIGHT, each LEFT once")
        found[left] = right
    return found


def cells(texts: Sequence[str]) -> tuple[tuple[str, str], ...]:
    """Return the columns and cells of `--leave-out`, such as `practice=yes`, or `participant=` for an empty cell.

    Raises `DatasetError` for any other text.
    """
    found = [text.rpartition("=") for text in texts]
    for text, (column, equals, _) in zip(texts, found, strict=True):
        if not (equals and column.strip()):
            raise DatasetError(
                "--leave-out",
                f"got {quoted(text)}",
                "correct it",
                allowed=f"COLUMN=VALUE, COLUMN= for an empty cell, COLUMN=* for any other, COLUMN={SEVERAL}, *=again",
            )
    return tuple((column.strip(), value.strip()) for column, _, value in found)
