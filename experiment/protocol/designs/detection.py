"""Detection in a protocol: whether anything was felt, or in which of two intervals it was.

With one stimulus in a trial participants say yes or no, and catch trials present nothing. With two, one of which is
nothing, they say which one it was in; in half of the trials with a signal, drawn ahead, it is the first.
"""

from collections.abc import Iterator, Sequence
from typing import Annotated, Literal

from pydantic import Field

from palpate.experiment.protocol.designs import Meaning, PlannableTest, ProtocolDesign
from palpate.experiment.protocol.kinds import NAMES, kind_of, list_at, number_at, table_at, tables_at
from palpate.experiment.protocol.models import Protocol, Task
from palpate.experiment.settings.load import Broken, Confined, Key, Name, Table

YES, NO, FIRST, SECOND = "yes", "no", "first", "second"
KEYS = {1: {"yes_key": YES, "no_key": NO}, 2: {"first_key": FIRST, "second_key": SECOND}}
"""Each key, with the answer that goes on record, by how many stimuli a trial presents."""

WORDS = {YES: "yes", NO: "no", FIRST: "the first", SECOND: "the second"}
NAMED = {
    YES: "something was felt",
    NO: "nothing was felt",
    FIRST: "something was felt in the first interval",
    SECOND: "something was felt in the second interval",
}
"""What an answer says, for the experimenter, and as the sidecar of a dataset tells it."""

ASKS = {1: "Did you feel anything?", 2: "In which of the two intervals did you feel something?"}
"""What participants are asked, by how many stimuli a trial presents."""

TESTS = {name: PlannableTest(since=7, leveled=True) for name in ("threshold", "sensitivity")}
"""The planned tests: thresholds of psychometric functions, and d'."""


class Detection(Confined):
    """Settings for trials of the design `detection`: participants report whether, or in which interval, they felt
    something. Every material except `blank` is a signal.

    Attributes:
        intervals: stimuli per trial: with 1, participants say yes or no; with 2, one is `blank`, and they say which had
            the signal, which is first in half of the trials (drawn in advance).
        blank: the material without a stimulus; needed by catch trials and by two intervals.
        signal_trials: trials of each signal per block.
        catch_trials: trials per block that present only `blank`; only for yes or no.
        yes_key: something was felt.
        no_key: nothing was felt.
        first_key: it was in the first interval.
        second_key: it was in the second.
    """

    intervals: Literal[1, 2]
    blank: Name | None = None
    signal_trials: Annotated[int, Field(ge=1, le=100)] = 1
    catch_trials: Annotated[int, Field(ge=0, le=100)] = 0
    yes_key: Key | None = None
    no_key: Key | None = None
    first_key: Key | None = None
    second_key: Key | None = None

    @property
    def answers(self) -> dict[str, str]:
        """What participants may answer, by its key."""
        return {str(getattr(self, name)): answer for name, answer in KEYS[self.intervals].items()}


def _rules(table: Table) -> Iterator[Broken]:
    """The design `detection` needs `[detection]`, with `yes_key` and `no_key`, or `first_key` and `second_key`.

    `blank` is a material without a stimulus; two intervals and catch trials need it, and every task presents it. There
    are no more `intervals` than stimuli in a trial of the kind. Orders are not `max-run`. With two intervals, there are
    no `catch_trials`, and each signal has an even number of trials. No material has `key` or `spoken`, and
    `answers.microphone` is false. A test `threshold` names tasks with levels.
    """
    if table.get("detection") is None:
        yield Broken(("detection",), "a table, because tasks with the design 'detection' need it")
        return
    own = table_at(table, "detection")
    shown = 2 if own.get("intervals") == 2 else 1
    for number, keys in KEYS.items():
        for key in keys:
            if (own.get(key) is None) == (number == shown):
                yield Broken(("detection", key), "a key" if number == shown else f"no value, with intervals = {shown}")
    for i, one in tables_at(table, "materials"):
        for key in ("key", "spoken"):
            if one.get(key):
                yield Broken(("materials", i, key), "no value: participants detect materials but do not name them")
    if table_at(table, "answers").get("microphone") is True:
        yield Broken(("answers", "microphone"), "false: participants do not name materials")
    yield from _blank(table, own, shown)
    for i, task in tables_at(table, "tasks"):
        yield from _task(task, ("tasks", i), own, shown)
    yield from _limits(table, own)
    fixed = {str(task.get("id")) for _, task in tables_at(table, "tasks") if task.get("levels") is None}
    for i, test in tables_at(table, "analysis"):
        for j, one in enumerate(list_at(test, "tasks")):
            if test.get("test") == "threshold" and one in fixed:
                yield Broken(
                    ("analysis", i, "tasks", j),
                    "a task with levels: a threshold cannot be estimated from a single level",
                )


def _limits(table: Table, own: Table) -> Iterator[Broken]:
    """Yield limits of `answers-below` above the trials of the shortest task."""
    each, catches = number_at(own, "signal_trials") or 1, number_at(own, "catch_trials") or 0
    every, trials = [one.get("id") for _, one in tables_at(table, "materials")], []
    for _, task in tables_at(table, "tasks"):
        signals = [one for one in list_at(task, "materials") or every if one != own.get("blank")]
        trials.append((number_at(task, "repetitions") or 0) * (len(signals) * each + catches))
    for i, rule in tables_at(table, "exclusion"):
        limit, most = number_at(rule, "limit"), min(trials, default=0)
        if rule.get("when") == "answers-below" and limit is not None and limit > most > 0:
            yield Broken(("exclusion", i, "limit"), f"at most {most}, the trials of the shortest task")


def _blank(table: Table, own: Table, shown: int) -> Iterator[Broken]:
    kinds = [kind_of(str(task["kind"])) for _, task in tables_at(table, "tasks") if task.get("kind") in NAMES]
    blank, silent = own.get("blank"), [one for kind in kinds[:1] for one in kind.silent(table)]
    catches = number_at(own, "catch_trials") or 0
    if shown == 2 and catches:
        yield Broken(("detection", "catch_trials"), "0: with two intervals, every trial has a signal")
    needed = shown == 2 or catches
    if blank not in silent and (needed or blank is not None):
        every = ", ".join(map(str, silent)) or "no material has one"
        yield Broken(("detection", "blank"), f"a material whose stimulus is silence, one of: {every}")
    for kind in kinds[:1]:
        if shown not in kind.intervals:
            yield Broken(
                ("detection", "intervals"), f"{kind.intervals[0]}, the number that a trial of this kind presents"
            )


def _task(task: Table, place: tuple[str | int, ...], own: Table, shown: int) -> Iterator[Broken]:
    presented, repetitions = task.get("materials"), number_at(task, "repetitions")
    if isinstance(presented, tuple) and presented and (own.get("blank") or presented[0]) not in presented:
        yield Broken((*place, "materials"), "detection.blank and other materials")
    if isinstance(presented, tuple) and [*presented] == [own.get("blank")]:
        yield Broken((*place, "materials"), "a signal and other materials")
    if table_at(task, "order").get("kind") == "max-run":
        yield Broken((*place, "order", "kind"), "one of: full-random, blocked-random, for a detection task")
    if shown == 2 and repetitions is not None and repetitions * (number_at(own, "signal_trials") or 1) % 2:
        allowed = "a value that gives each signal an even number of trials, half in each interval"
        yield Broken((*place, "repetitions"), allowed)


def _keys(table: Table) -> list[tuple[tuple[str, ...], object]]:
    own = table_at(table, "detection")
    return [(("detection", name), own.get(name)) for keys in KEYS.values() for name in keys]


def signals(protocol: Protocol, task: Task) -> tuple[str, ...]:
    """Return the materials of a task that can be felt."""
    blank = protocol.table(Detection).blank
    return tuple(one for one in protocol.materials_of(task) if one != blank)


def _presentations(protocol: Protocol, task: Task) -> tuple[tuple[str, ...], ...]:
    own = protocol.table(Detection)
    beside = (own.blank or "",) * (own.intervals - 1)
    of_signals = tuple((one, *beside) for one in signals(protocol, task)) * own.signal_trials
    return (*of_signals, *(((own.blank or "",),) * own.catch_trials))


def _right(protocol: Protocol, presented: Sequence[str], answered: str) -> bool:
    own = protocol.table(Detection)
    if own.intervals == 1:
        return answered == (NO if presented[0] == own.blank else YES)
    return answered == (SECOND if presented[0] == own.blank else FIRST)


def _answers(protocol: Protocol, _: Sequence[str]) -> dict[str, Meaning]:
    return {key: Meaning(one, WORDS[one]) for key, one in protocol.table(Detection).answers.items()}


def _presents(protocol: Protocol, task: Task) -> str:
    own, of = protocol.table(Detection), ", ".join(signals(protocol, task))
    catches = f" and {own.catch_trials} without a signal" if own.catch_trials else ""
    how = "in one of two intervals" if own.intervals == 2 else "yes or no"
    block = len(protocol.presentations(task))
    return f"Detection of {of}, {how}; blocks of {block}, {own.signal_trials} with each signal{catches}"


DESIGN = ProtocolDesign(
    table=Detection,
    since=7,
    intervals=(1, 2),
    tests=TESTS,
    rules=_rules,
    keys=_keys,
    answers=_answers,
    named=lambda protocol: {answer: NAMED[answer] for answer in protocol.table(Detection).answers.values()},
    presents=_presents,
    right=_right,
    shown=lambda protocol: tuple(WORDS[one] for one in protocol.table(Detection).answers.values()),
    presentations=_presentations,
    asks=lambda protocol: ASKS[protocol.table(Detection).intervals],
    catches=lambda protocol, presented: {*presented} == {protocol.table(Detection).blank},
)
