"""Frozen models of a file of printed numbers: what a study prints about its answers, and where each number stands.

Numbers are text, so that their last digit is known. Unknown keys are refused.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field

from analysis.published.printed import POSITIVE
from experiment.settings.load import Broken, Confined, Label, Name, Rules, Text

Number = Annotated[
    str,
    Field(pattern=rf"^-?{POSITIVE}$", description='a number as printed, in quotes, such as "0.20", "-1.5" or "15%"'),
]
Size = Annotated[
    str, Field(pattern=rf"^{POSITIVE}$", description='a number as printed, not negative, in quotes, such as "0.20"')
]
Probability = Annotated[
    str,
    Field(pattern=rf"^< ?{POSITIVE}$|^{POSITIVE}$", description='P as printed, such as "0.016", "5.02e-7", "<0.001"'),
]
Percentage = Annotated[
    str,
    Field(
        pattern=r"^(100(\.0{1,2})?|[0-9]{1,2}(\.[0-9]{1,2})?)%$",
        description='a percentage as printed, from 0 to 100, with at most two decimals, in quotes, such as "43%"',
    ),
]
Share = Annotated[
    str,
    Field(
        pattern=r"^-?([0-9]+(\.[0-9]+)?|[0-9]+/[1-9][0-9]*)$",
        description='a number that is exact, in quotes, such as "0.25" or "1/3"',
    ),
]
Stars = Annotated[str, Field(pattern=r"^\**$", description='stars as printed, such as "**"; "" for none')]
Count = Annotated[int, Field(ge=1, le=100_000)]
Df = Annotated[int, Field(ge=1, le=1_000_000)]


def _list(value: object) -> tuple[Any, ...]:
    return tuple(value) if isinstance(value, tuple | list) else ()


def _dicts(table: object, *keys: str) -> Iterator[tuple[tuple[str | int, ...], dict[str, Any]]]:
    """The tables that stand in lists under these keys, one within the other, each with its path."""
    for i, one in enumerate(_list(table.get(keys[0])) if isinstance(table, dict) else ()):
        if isinstance(one, dict) and len(keys) == 1:
            yield (keys[0], i), one
        elif isinstance(one, dict):
            yield from (((keys[0], i, *path), inner) for path, inner in _dicts(one, *keys[1:]))


class Task(Confined):
    """A task or group: how many took part, and the whole trials behind each of their ratios, where they are known."""

    id: Name
    participants: Count
    trials: Annotated[int | None, Field(ge=1, le=10_000)] = None


class Cell(Confined):
    """A mean ratio of one answer to one material; `stars` only in tables."""

    presented: Name
    answered: Name
    mean: Number
    sd: Size | None = None
    stars: Stars = ""


class Table(Confined):
    """A confusion table; `complete`: its rows hold every answer that could be given."""

    where: Text
    task: Name
    complete: bool = True
    cells: Annotated[tuple[Cell, ...], Field(min_length=1)]


class Passage(Confined):
    """Cells of a table that the text repeats."""

    where: Text
    task: Name
    cells: Annotated[tuple[Cell, ...], Field(min_length=1)]


class Score(Confined):
    """A mean of something else than ratios."""

    name: Name
    mean: Number
    sd: Size | None = None
    stars: Stars = ""


def _scores_rules(table: Any) -> Iterator[Broken]:
    low, high = table.get("low"), table.get("high")
    if isinstance(low, int) and isinstance(high, int) and high <= low:
        yield Broken(("high",), f"a whole number greater than low ({low})")


class Scores(Confined):
    """Means of whole numbers, or of `items` of them, on a scale; without `items` of values that have no steps."""

    RULES: ClassVar[Rules] = _scores_rules

    where: Text
    task: Name
    items: Annotated[int | None, Field(ge=1, le=1000)] = None
    low: Annotated[int | None, Field(ge=-1000, le=1000)] = None
    high: Annotated[int | None, Field(ge=-1000, le=1000)] = None
    cells: Annotated[tuple[Score, ...], Field(min_length=1)]


class Test(Confined):
    """A one-sample t-test of a material's correct answers against `null` (chance, if left out), or of a score."""

    task: Name
    of: Name
    df: Df
    t: Number
    p: Probability | None = None
    null: Share | None = None


class Tests(Confined):
    """The t-tests of one place."""

    where: Text
    tests: Annotated[tuple[Test, ...], Field(min_length=1)]


class OneWay(Confined):
    """A one-way ANOVA of the four ratios of two materials that were taken for one another."""

    where: Text
    task: Name
    pair: Annotated[tuple[Name, ...], Field(min_length=2, max_length=2)]
    df: Annotated[tuple[Df, ...], Field(min_length=2, max_length=2)]
    f: Size
    p: Probability


class TwoWay(Confined):
    """One effect of the two-way ANOVA of all correct ratios by task and material."""

    where: Text
    effect: Literal["task", "material"]
    df: Annotated[tuple[Df, ...], Field(min_length=2, max_length=2)]
    f: Size
    p: Probability


class Source(Confined):
    """One line of a printed ANOVA table; the last line is the residual."""

    name: Name
    ss: Size | None = None
    df: Df
    ms: Size | None = None
    f: Size | None = None
    p: Probability | None = None


class SourceTable(Confined):
    """An ANOVA table as printed, line by line."""

    where: Text
    lines: Annotated[tuple[Source, ...], Field(min_length=2)]


class Reliability(Confined):
    """An intraclass correlation whose formula the study does not print."""

    where: Text
    value: Number


class Claim(Confined):
    """How many of a task's materials the text calls significantly above chance."""

    where: Text
    task: Name
    significant: Annotated[int, Field(ge=0, le=1000)]
    of: Count


class Choice(Confined):
    """A percentage of one pair."""

    pair: Annotated[tuple[Name, ...], Field(min_length=2, max_length=2)]
    correct: Percentage


def _choices_rules(table: Any) -> Iterator[Broken]:
    trials, people, pairs = table.get("trials"), table.get("participants"), len(_list(table.get("cells")))
    if isinstance(trials, int) and isinstance(people, int) and trials * people < pairs:
        yield Broken(("trials",), f"so many that {people} participants have one for each of the {pairs} pairs")


class Choices(Confined):
    """Percentages of pairs whose denominators are not printed; `trials` as printed, of a participant or of all."""

    RULES: ClassVar[Rules] = _choices_rules

    where: Text
    task: Name
    participants: Count
    trials: Count
    cells: Annotated[tuple[Choice, ...], Field(min_length=1)]


class Level(Confined):
    """Stars, and the P below which they are given: to any mean, or to those `above` the null alone.

    A table that shows no stars is not asked for any.
    """

    stars: Annotated[str, Field(pattern=r"^\*+$", description='stars, such as "**"')]
    p: Size
    above: bool = False


def _document_rules(table: Any) -> Iterator[Broken]:
    yield from _tasks_known(table)
    printed = [key for key in PRINTED if table.get(key)]
    if not printed:
        yield Broken(("table",), f"at least one of: {', '.join(PRINTED)}")
    yield from _levels_stated(table)
    yield from _nulls_stated(table)


def _nulls_stated(table: Any) -> Iterator[Broken]:
    """Chance is that of ratios: a score has none."""
    scores = {
        (block.get("task"), one.get("name")) for _, block in _dicts(table, "score") for _, one in _dicts(block, "cells")
    }
    for path, test in _dicts(table, "t", "tests"):
        if test.get("null") is not None:
            continue
        if (test.get("task"), test.get("of")) in scores:
            yield Broken((*path, "null"), "a number, where the test is of a score")
        elif table.get("chance") is None:
            yield Broken((*path, "null"), "a number, where the file states no chance")


def _levels_stated(table: Any) -> Iterator[Broken]:
    """Stars and claims of significance mean something only beside the level of each."""
    cells = [cell for key in ("table", "score") for _, cell in _dicts(table, key, "cells")]
    if not _list(table.get("levels")) and (table.get("claim") or any(cell.get("stars") for cell in cells)):
        yield Broken(("levels",), "the P below which each number of stars is given, where there are stars or claims")


def _tasks_known(table: Any) -> Iterator[Broken]:
    known = {task.get("id") for _, task in _dicts(table, "task")}
    places = [(key,) for key in ("table", "text", "score", "one_way", "claim")]
    for keys in (*places, ("t", "tests")):
        for path, block in _dicts(table, *keys):
            if isinstance(block.get("task"), str) and block["task"] not in known:
                yield Broken((*path, "task"), f"one of: {', '.join(sorted(map(str, known)))}")


PRINTED = ("table", "score", "t", "one_way", "two_way", "anova", "choices", "icc")
"""Keys that hold printed numbers."""


class Document(Confined):
    """A whole file."""

    RULES: ClassVar[Rules] = _document_rules

    study: Label
    source: Text
    chance: Share | None = None
    levels: tuple[Level, ...] = ()
    task: tuple[Task, ...] = ()
    table: tuple[Table, ...] = ()
    text: tuple[Passage, ...] = ()
    score: tuple[Scores, ...] = ()
    t: tuple[Tests, ...] = ()
    one_way: tuple[OneWay, ...] = ()
    two_way: tuple[TwoWay, ...] = ()
    anova: tuple[SourceTable, ...] = ()
    icc: tuple[Reliability, ...] = ()
    claim: tuple[Claim, ...] = ()
    choices: tuple[Choices, ...] = ()
