"""Levels in a protocol: what a task with them breaks, what its board reads, and what is odd about it.

`rules` and `page` look this up for a study of which a task has levels.
"""

from collections.abc import Iterator
from itertools import pairwise
from math import log10

from palpate.experiment.errors import Finding, mismatch
from palpate.experiment.protocol.blocks import count, number
from palpate.experiment.protocol.designs import NAMES, design_of, plannable_tests
from palpate.experiment.protocol.kinds import list_at, number_at, table_at, tables_at
from palpate.experiment.protocol.models import Levels, Protocol, Task
from palpate.experiment.protocol.page.words import design_words
from palpate.experiment.settings.load import Broken, Table, written


def broken(table: Table) -> Iterator[Broken]:
    """Yield what tasks with levels cannot have."""
    for i, task in tables_at(table, "tasks"):
        if task.get("levels") is None:
            continue
        if (design := task.get("design")) in NAMES and design_of(design).right is None:
            yield Broken(("tasks", i, "levels"), f"no table: in the design '{design}', answers are not right or wrong")
        if task.get("stimulus") == "real":
            yield Broken(("tasks", i, "levels"), "no table: the strength of a real object cannot be changed")
        if table_at(task, "order").get("kind") in ("full-random", "max-run"):
            allowed = "blocked-random: with levels, each block has one trial from each track"
            yield Broken(("tasks", i, "order", "kind"), allowed)
        if table_at(table, "answers").get("progress") is True and table_at(task, "levels").get("method") != "constant":
            allowed = f"false: in tasks[{i}], the number of trials left would reveal which answers were right"
            yield Broken(("answers", "progress"), allowed)
        yield from _unbalanced(table, i, task)
    for i, rule in tables_at(table, "exclusion"):
        if rule.get("when") == "answers-below":
            allowed = "a different rule: in a task with levels, the number of trials depends on the answers"
            yield Broken(("exclusion", i, "when"), allowed)


def _unbalanced(table: Table, place: int, task: Table) -> Iterator[Broken]:
    """Yield constant levels that do not all come equally often."""
    levels, repetitions = table_at(task, "levels"), number_at(task, "repetitions")
    own, name = table_at(table, str(task.get("design"))), task.get("design")
    each, count = number_at(own, "signal_trials") or 1, len(list_at(levels, "grid"))
    orders = design_of(name).shown_together(own) if name in NAMES else 1
    if levels.get("method") != "constant" or not count or repetitions is None:
        return
    if repetitions * each % (count * orders):
        in_order = " in either order" if orders > 1 else ""
        allowed = f"a value that presents each of the {count} levels equally often{in_order}"
        yield Broken(("tasks", place, "repetitions"), allowed)


def facts(task: Task) -> list[tuple[str, str]]:
    """Return what the board reads of the levels of a task; nothing without any."""
    if (levels := task.levels) is None:
        return []
    grid = _numbers(levels.grid)
    tracks = design_words(task).track
    return [
        (
            "Levels",
            f"every vibration of a trial is multiplied by a level: {grid}. The highest level is "
            f"{number(levels.grid[-1])}. Vibrations on this page are given at level 1",
        ),
        ("Chosen", _constant(levels, tracks) if levels.method == "constant" else _chosen(levels, tracks)),
        ("Repeats", "only before the question: a trial with an answer is never repeated"),
    ]


def _chosen(levels: Levels, tracks: str) -> str:
    return f"from the answers to earlier trials, {_rule(levels, tracks)}"


def _constant(levels: Levels, tracks: str) -> str:
    return (
        f"before the first trial, regardless of the answers. For {tracks}, every {len(levels.grid)} trials present "
        f"each of the {len(levels.grid)} levels once, in random order"
    )


def _rule(levels: Levels, tracks: str) -> str:
    """Return how the next level follows from the answers, for `tracks` each on its own."""
    stays = "and a missing answer leaves it unchanged"
    if levels.method == "up-down":
        rises = f" {levels.up} times as far" if (levels.up or 1) > 1 else ""
        sizes = ", then ".join(count(one, "level") for one in levels.steps or ())
        changes = f" Step sizes are {sizes}, changing at each reversal." if sizes else ""
        by = "one" if levels.steps is None else "a step"
        return (
            f"transformed up-down, with a separate track for {tracks}. Each track starts at level "
            f"{number(levels.first or 0.0)}. {count(levels.down or 0, 'right answer')} in a row lower the level by "
            f"{by}, a wrong answer raises it{rises}, {stays}.{changes} The track ends after "
            f"{count(levels.reversals or 0, 'reversal')}"
        )
    of = {"quest-plus": "threshold, spread and lapse rate (QUEST+)", "psi": "threshold and spread (psi)"}[levels.method]
    known = ""
    if levels.precision_db is not None:
        known = f". A track ends when the threshold is known to within {number(levels.precision_db)} dB"
    return (
        f"separately for {tracks}: the next level is the one whose answer is expected to leave the least uncertainty "
        f"about {of}. Initially, thresholds of {_numbers(levels.thresholds)}, spreads of "
        f"{_numbers(levels.spreads_db)} dB and lapse rates of {_numbers(levels.lapses)} are each equally probable; "
        f"the guess rate is {number(levels.guess or 0.0)}. Each answer updates the level, {stays}{known}"
    )


def _numbers(values: tuple[float, ...] | None) -> str:
    return ", ".join(map(number, values or ()))


LEAST_REVERSALS, CLOSE_DB = 4, 0.1
"""A mean of fewer reversals is hardly one, and levels that are closer are felt alike; ours."""


def _odd(protocol: Protocol, task: Task, levels: Levels) -> Iterator[tuple[str, str, str]]:
    trials = task.repetitions * int(getattr(getattr(protocol, task.design, None), "signal_trials", 1))
    if levels.reversals is not None and levels.down is not None:
        # From one turn at the top to the next a track needs `down` right answers and a wrong one at least.
        most = 2 * trials // (levels.down + 1)
        if levels.reversals > most:
            allowed = f"usually at most {most}: a track of {trials} trials cannot reach more reversals"
            yield "reversals", f"{levels.reversals}", allowed
        elif levels.reversals < LEAST_REVERSALS:
            allowed = f"usually {LEAST_REVERSALS} or more: the threshold is the mean of the reversals after the first"
            yield "reversals", f"{levels.reversals}", allowed
    apart_db = [20 * log10(high / low) for low, high in pairwise(levels.grid)]
    if levels.method == "constant" and min(apart_db) < CLOSE_DB:
        low = apart_db.index(min(apart_db))
        allowed = f"usually levels at least {CLOSE_DB:g} dB apart: these two levels feel the same"
        yield "grid", f"{levels.grid[low]:g} and {levels.grid[low + 1]:g}", allowed


def advice(protocol: Protocol) -> Iterator[Finding]:
    """Yield each planned test of a task with levels, and levels of which a track makes little."""
    for place, task in enumerate(protocol.tasks):
        for field, got, allowed in () if task.levels is None else _odd(protocol, task, task.levels):
            yield mismatch(written(("tasks", place, "levels", field)), None, got, allowed)
    adaptive, plannable = {task.id for task in protocol.tasks if task.levels is not None}, plannable_tests()
    for place, test in enumerate(protocol.analysis):
        if (of := adaptive.intersection(test.tasks)) and not plannable[test.test].leveled:
            allowed = "usually tasks without levels: adaptive levels fix the proportion correct"
            yield mismatch(written(("analysis", place, "tasks")), None, ", ".join(sorted(of)), allowed)
