"""What participants are asked beside the trials, which a board allows one by one.

A protocol without a table `[asked]` asks nothing, and a session of one loads nothing of what asks.
"""

import re
from collections.abc import Iterator
from contextlib import suppress
from typing import Annotated, ClassVar, Literal

from pydantic import Field

from palpate.experiment.protocol.designs.groups import COLUMN, groups
from palpate.experiment.protocol.kinds import list_at, number_at, table_at, tables_at
from palpate.experiment.protocol.models import Protocol
from palpate.experiment.protocol.rules import DEVICES, NO_DEVICE
from palpate.experiment.settings.characters import one_line
from palpate.experiment.settings.load import MISSING, Broken, Confined, Label, Line, Name, Rules, Table, Text
from palpate.experiment.storage import Place

ColumnName = Annotated[
    str,
    Field(
        pattern=r"^[a-z][a-z0-9_]{0,31}$",
        description="up to 32 lowercase letters, digits and _, starting with a letter (column heading)",
    ),
]

OURS = ("participant_id", "first_task", "withdrawn", "origin")
"""Columns that stand in participants.tsv already."""

BIDS = {
    "sex": ("female", "male", "other"),
    "handedness": ("left", "right", "ambidextrous"),
    "species": (),
    "strain": (),
    "strain_rrid": (),
    "hed": (),
}
"""Columns of participants.tsv for which BIDS 1.11 allows these values alone, or that are of animals."""

OLDEST = 89
"""BIDS 1.11 allows no higher age in participants.tsv, because few people are older."""

LONGEST = 400
"""Characters of a text."""

MOST = 1e9
"""No number is larger, or smaller with the other sign."""

TOUCH = "touch"
"""Stands for the id of a questionnaire where answers to `[[asked.touch]]` are recorded or shared."""

Value = str | int | float

_NUMBER = re.compile(r"[+-]?([0-9]+([.,][0-9]*)?|[.,][0-9]+)(e[+-]?[0-9]+)?", re.IGNORECASE)
_TWO_NUMBERS = re.compile(r"[+-]?[1-9][0-9]{0,2},[0-9]{3}")
"""What is a thousand times larger where a comma parts thousands."""


def _question(table: Table) -> Iterator[Broken]:
    """Only `choice` has `values`: at least two, each once. `scale` needs `least` and `most`, which are whole numbers.
    `number` may have both; `text` has none of the three.
    """
    answer, values = table.get("answer"), list_at(table, "values")
    if answer == "choice" and len(values) < 2:
        yield Broken(("values",), "at least two values, because this is a choice")
    if answer in ("number", "scale", "text") and values:
        yield Broken(("values",), "no values: only choices have this key")
    for i, one in enumerate(values):
        if one in (*values[:i], *MISSING):
            yield Broken(("values", i), "unique values, none of which means a missing value, such as NA")
    least, most = number_at(table, "least"), number_at(table, "most")
    for key, value in (("least", least), ("most", most)):
        if answer == "scale" and (value is None or value != int(value)):
            yield Broken((key,), "a whole number, because a scale needs one")
        if answer in ("choice", "text") and value is not None:
            yield Broken((key,), "no value: only numbers and scales have this key")
    if least is not None and most is not None and most <= least:
        yield Broken(("most",), f"a number above least ({least:g})")


def _fact(table: Table) -> Iterator[Broken]:
    """The rules for `[[asked.questionnaires.items]]` apply. `id` is not one that palpate or BIDS uses; `age` in years
    is at most 89; only a number has `group`. As in BIDS, `sex` is female, male or other, and `handedness` is left,
    right or ambidextrous.
    """
    yield from _question(table)
    name, values = table.get("id"), list_at(table, "values")
    if name in (*OURS, *(one for one, known in BIDS.items() if not known)):
        yield Broken(("id",), "a different name: palpate or BIDS already uses this one")
    if known := BIDS.get(str(name)):
        if table.get("answer") in ("number", "scale", "text"):
            yield Broken(("answer",), f"choice, for '{name}'")
        for i, one in enumerate(values):
            if one not in known:
                yield Broken(("values", i), f"one of: {', '.join(known)}, as in BIDS; or rename the column")
    if name == "age":
        if table.get("answer") in ("choice", "scale", "text"):
            yield Broken(("answer",), "number, in years; or rename the column, e.g., to age_group")
        elif (most := number_at(table, "most")) is None or most > OLDEST:
            yield Broken(("most",), f"at most {OLDEST}, as in BIDS")
    if table.get("answer") in ("choice", "scale", "text") and table.get("group") is not None:
        yield Broken(("group",), "no value: only numbers have this key")


class Question(Confined):
    """Base of what is asked: one question, and what may be answered. Nobody has to answer."""

    RULES: ClassVar[Rules] = _question

    id: ColumnName
    question: Text
    answer: Literal["choice", "number", "scale", "text"]
    values: Annotated[tuple[Name, ...], Field(max_length=20)] = ()
    least: float | None = None
    most: float | None = None
    unit: Line | None = None

    @property
    def allowed(self) -> str:
        """What may be answered, in words."""
        match self.answer:
            case "choice":
                return f"one of: {', '.join(self.values)}"
            case "text":
                return f"one line of at most {LONGEST} characters"
        noun = "a whole number" if self.answer == "scale" else "a number"
        ends = [f"{word} {end:g}" for word, end in (("from", self.least), ("to", self.most)) if end is not None]
        return " ".join([noun, *ends, *([self.unit] if self.unit else [])])

    def read(self, typed: str) -> Value | None:
        """Return what somebody answered, None where they did not. Raises `ValueError` for what is not `allowed`."""
        if not (text := " ".join(typed.split())):
            return None
        if self.answer == "choice":
            by_place = {str(place): one for place, one in enumerate(self.values, start=1)}
            by_name = {one.casefold(): one for one in self.values}
            value: Value | None = by_name.get(text.casefold()) or by_place.get(text)
        elif self.answer == "text":
            value = one_line(text) if len(text) <= LONGEST and text not in MISSING else None
        else:
            value = self._number(text)
        if value is None:
            raise ValueError(self.allowed)
        return value

    def has(self, cell: str) -> bool:
        """Return whether a cell of a table is an answer to this, not the number of one."""
        if self.answer == "choice":
            return cell in self.values
        with suppress(ValueError):
            return self.read(cell) is not None
        return False

    def _number(self, text: str) -> int | float | None:
        if not _NUMBER.fullmatch(text) or _TWO_NUMBERS.fullmatch(text):
            return None
        value = float(text.replace(",", "."))
        least, most = (-MOST if self.least is None else self.least), (MOST if self.most is None else self.most)
        if not least <= value <= most or (self.answer == "scale" and value != int(value)):
            return None
        return int(value) if value == int(value) else value

    def column(self) -> dict[str, object]:
        """Return what the sidecar of a table says of the answers (BIDS 1.11, tabular files)."""
        levels = {"Levels": {one: one for one in self.values}} if self.values else {}
        return {"Description": self.question, **levels, **({"Units": self.unit} if self.unit else {})}


class Fact(Question):
    """A question to participants about themselves; the answers are a column of participants.tsv.

    Attributes:
        id: heads the column.
        question: what is asked.
        answer: one of `values`, a number, a whole number from `least` to `most`, or a line of text.
        values: the choices.
        least: the smallest number.
        most: the largest number.
        unit: unit of the number.
        reason: why the study needs it, for the board.
        group: width of the bins that replace a number when shared.
    """

    RULES: ClassVar[Rules] = _fact

    reason: Text
    group: Annotated[float, Field(gt=0)] | None = None


class Item(Question):
    """One question of a questionnaire; it is a column of the questionnaire's table.

    Attributes:
        id: heads the column.
        question: what is asked.
        answer: one of `values`, a number, a whole number from `least` to `most`, or a line of text.
        values: the choices.
        least: the smallest number.
        most: the largest number.
        unit: unit of the number.
    """


class Questionnaire(Confined):
    """A short questionnaire before or after a task, asked at the console.

    Attributes:
        id: names its table under `phenotype/`.
        title: its title.
        task: id of its task.
        when: before the task's familiarization, or after its last trial.
        items: its questions, in order.
    """

    id: Label
    title: Text
    task: Label
    when: Literal["before", "after"]
    items: Annotated[tuple[Item, ...], Field(min_length=1, max_length=50)]


class Asked(Confined):
    """What participants are asked outside the trials.

    Attributes:
        people: facts about themselves, at enrolment.
        questionnaires: questions before or after a task.
        touch: what the skin touches, such as its temperature, footwear, posture and static force, recorded before every
            task; a number is best measured.
    """

    people: tuple[Fact, ...] = ()
    questionnaires: tuple[Questionnaire, ...] = ()
    touch: Annotated[tuple[Item, ...], Field(max_length=20)] = ()

    def of_task(self, task_id: str, when: str) -> tuple[Questionnaire, ...]:
        """Return the questionnaires before or after a task; what the skin touches comes last before it."""
        own = tuple(one for one in self.questionnaires if (one.task, one.when) == (task_id, when))
        if not self.touch or when == "after":
            return own
        touch = Questionnaire(id=TOUCH, title="What the skin touches", task=task_id, when="before", items=self.touch)
        return (*own, touch)


def values(protocol: Protocol, fact: str) -> tuple[str, ...]:
    """Return what may be chosen of a fact about people, or the drawn groups; nothing where a protocol has neither."""
    if fact == COLUMN and (drawn := groups(protocol)):
        return tuple(one.id for one in drawn)
    asked = protocol.find(Asked)
    return next((one.values for one in asked.people if one.id == fact), ()) if asked else ()


def broken(table: Table) -> Iterator[Broken]:
    """Yield ids that are not unique, tasks that are none, and what `[sharing]` names that cannot be shared."""
    asked, sharing = table_at(table, "asked"), table_at(table, "sharing")
    people, questionnaires = tables_at(asked, "people"), tables_at(asked, "questionnaires")
    yield from _once(people, ("asked", "people"))
    yield from _once(questionnaires, ("asked", "questionnaires"))
    yield from _once(tables_at(asked, "touch"), ("asked", "touch"))
    tasks = [one.get("id") for _, one in tables_at(table, "tasks")]
    for i, one in questionnaires:
        if one.get("id") in DEVICES:
            yield Broken(("asked", "questionnaires", i, "id"), NO_DEVICE)
        if one.get("id") == TOUCH:
            yield Broken(
                ("asked", "questionnaires", i, "id"), f"a different name: '{TOUCH}' is reserved for [[asked.touch]]"
            )
        if one.get("task") not in tasks:
            yield Broken(("asked", "questionnaires", i, "task"), f"a task, one of: {', '.join(map(str, tasks))}")
        items = tables_at(one, "items")
        yield from _once(items, ("asked", "questionnaires", i, "items"))
        for j, item in items:
            if item.get("id") == OURS[0]:
                yield Broken(("asked", "questionnaires", i, "items", j, "id"), f"a name other than {OURS[0]}")
    for i, name in enumerate(list_at(sharing, "questionnaires")):
        known = [one.get("id") for _, one in questionnaires] + [TOUCH] * bool(list_at(asked, "touch"))
        if name not in known:
            allowed = f"the id of one of [[asked.questionnaires]], or '{TOUCH}' for [[asked.touch]]"
            yield Broken(("sharing", "questionnaires", i), allowed)
    of = {one.get("id"): one for _, one in people}
    columns: set[str] = set()
    for i, name in enumerate(list_at(sharing, "facts")):
        answer = of.get(name, {}).get("answer")
        if (column := f"{name}_group" if answer == "number" else str(name)) in columns:
            yield Broken(("sharing", "facts", i), f"a fact with its own column: '{column}' already exists")
        columns.add(column)
        if answer in (None, "text"):
            yield Broken(("sharing", "facts", i), "the id of one of [[asked.people]] that is not text")
        elif answer == "number" and of[name].get("group") is None:
            at = next(place for place, one in people if one.get("id") == name)
            yield Broken(
                ("asked", "people", at, "group"), "a number greater than 0, because sharing.facts lists this fact"
            )


def _once(tables: list[tuple[int, Table]], at: Place) -> Iterator[Broken]:
    seen: set[object] = set()
    for i, one in tables:
        if one.get("id") in seen:
            yield Broken((*at, i, "id"), "a unique id")
        seen.add(one.get("id"))
