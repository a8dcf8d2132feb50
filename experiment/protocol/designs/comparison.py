"""Comparison in a protocol: a trial presents two materials, and participants say which has more of a quality."""

from collections.abc import Iterator, Sequence

from pydantic import Field

from palpate.experiment.protocol.designs import Meaning, PlannableTest, ProtocolDesign
from palpate.experiment.protocol.kinds import list_at, table_at, tables_at
from palpate.experiment.protocol.models import Protocol, Task
from palpate.experiment.settings.load import Broken, Confined, Key, Name, Table

FIRST, SECOND, TIE = "first", "second", "tie"
WORDS = {FIRST: "the first", SECOND: "the second", TIE: "neither"}
"""What an answer names: the material presented first, the one presented second, or neither."""

NAMED = {FIRST: "the material presented first", SECOND: "the material presented second", TIE: "neither of the two"}
"""The same, as the sidecar of a dataset tells it."""

TESTS = {
    **dict.fromkeys(("Bradley-Terry", "Thurstone", "Davidson"), PlannableTest()),
    **dict.fromkeys(("factors", "delays", "crossover"), PlannableTest(since=7)),
}
"""The planned tests."""


class Comparison(Confined):
    """In each trial, a participant chooses one of two materials.

    Attributes:
        quality: what is compared, such as hardness.
        ordered: whether `[[materials]]` lists them from least to most of the quality; if not, no choice is right or
            wrong.
        first_key: the first was chosen.
        second_key: the second was chosen.
        tie_key: neither was chosen; without this key, participants must choose.
    """

    quality: Name
    ordered: bool = Field(True, json_schema_extra={"since": 7})
    first_key: Key
    second_key: Key
    tie_key: Key | None = None

    @property
    def answers(self) -> dict[str, str]:
        """What participants may answer, by its key: `FIRST`, `SECOND` and, where it is allowed, `TIE`."""
        ties = {} if self.tie_key is None else {self.tie_key: TIE}
        return {self.first_key: FIRST, self.second_key: SECOND, **ties}


def _rules(table: Table) -> Iterator[Broken]:
    """The design `comparison` needs `[comparison]`.

    No material has `key` or `spoken`, `answers.microphone` is false, and the planned tests are `Bradley-Terry`,
    `Thurstone`, `factors`, `delays`, `crossover`, or, with a `tie_key`, `Davidson`. With two or more factors, `ordered`
    is false; then no task has `levels`.
    """
    if table.get("comparison") is None:
        yield Broken(("comparison",), "a table, because tasks with the design 'comparison' need it")
    for i, one in tables_at(table, "materials"):
        for key in ("key", "spoken"):
            if one.get(key):
                yield Broken(("materials", i, key), "no value: participants compare materials but do not name them")
    if table_at(table, "answers").get("microphone") is True:
        yield Broken(("answers", "microphone"), "false: participants do not name materials in pairs")
    ordered = table_at(table, "comparison").get("ordered") is not False
    if ordered and len(list_at(table, "factors")) > 1:
        yield Broken(("comparison", "ordered"), "false: materials with several factors have no single order")
    for i, task in tables_at(table, "tasks") if not ordered else ():
        if task.get("levels") is not None:
            yield Broken(
                ("tasks", i, "levels"), "no table: unless the materials are ordered, no answer is right or wrong"
            )
    tied = table_at(table, "comparison").get("tie_key") is not None
    for i, test in tables_at(table, "analysis"):
        if test.get("test") in TESTS and (test["test"] == "Davidson") != tied:
            allowed = "Davidson: comparison.tie_key allows ties" if tied else "another test, without ties"
            yield Broken(("analysis", i, "test"), allowed)


def _keys(table: Table) -> list[tuple[tuple[str, ...], object]]:
    own = table_at(table, "comparison")
    return [(("comparison", name), own.get(name)) for name in ("first_key", "second_key", "tie_key")]


def _right(protocol: Protocol, presented: Sequence[str], answered: str) -> bool:
    """Return whether the answer names the material that stands later in the file; of one pair no answer is right."""
    first, second = map([material.id for material in protocol.materials].index, presented)
    return answered == (FIRST if first > second else SECOND if first < second else None)


def _answers(protocol: Protocol, laid_out: Sequence[str]) -> dict[str, Meaning]:
    # Whoever laid the samples out knows which one is which.
    lies = {answer: f" ({one})" for answer, one in zip((FIRST, SECOND), laid_out, strict=False)}
    keys = protocol.table(Comparison).answers
    return {key: Meaning(one, f"{WORDS[one]}{lies.get(one, '')}") for key, one in keys.items()}


def _presents(protocol: Protocol, task: Task) -> str:
    pairs, count = len(protocol.presentations(task)), len(protocol.materials_of(task))
    return f"{pairs} pairs of {count} materials, compared in terms of {protocol.table(Comparison).quality}"


DESIGN = ProtocolDesign(
    table=Comparison,
    since=0,
    intervals=(2,),
    tests=TESTS,
    rules=_rules,
    keys=_keys,
    answers=_answers,
    named=lambda protocol: {answer: NAMED[answer] for answer in protocol.table(Comparison).answers.values()},
    presents=_presents,
    right=_right,
    asks=lambda protocol: f"Which of the two has more {protocol.table(Comparison).quality}?",
    shown=lambda protocol: tuple(protocol.table(Comparison).answers.values()),
)
