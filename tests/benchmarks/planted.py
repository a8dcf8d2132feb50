"""What the audit says of planted mistakes: run `python -m tests.benchmarks.planted [STUDIES [RIGHT]]`.

SIMULATED studies with known seeds are printed by scipy, statsmodels and decimal, and one mistake is planted in each.
A mistake is found where a number or a row is in conflict; it is named where the number is accused with the kind of
mistake among the reasons. A right line is a printed number that is as it should be and yet accused; a row that holds a
wrong number is no right line. RIGHT studies without a mistake follow. Not a test.
"""

from __future__ import annotations

import math
import statistics
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from decimal import ROUND_HALF_EVEN
from fractions import Fraction
from itertools import pairwise
from typing import Any

import numpy as np
from scipy import stats

from palpate.analysis.audit.mistakes import Line
from palpate.analysis.audit.print_lines import print_lines
from tests.analysis import printed_study
from tests.analysis.printed_study import MATERIALS, text

Document = dict[str, Any]
Random = np.random.Generator
CONFLICTS = ("differs", "impossible")
CHANCE = Fraction(1, 3)


@dataclass(frozen=True)
class Study:
    """The counts behind a right document, and how it was printed."""

    counts: printed_study.Counts
    trials: int
    digits: int
    document: Document


def study(seed: int) -> Study:
    """Return a study of two tasks that 8 to 20 participants did, with 10 or 20 trials and two or three digits."""
    random = np.random.default_rng(seed)
    first = int(random.integers(10, 21))
    sizes = {"one": first, "two": int(random.integers(8, first))}
    trials, digits = int(random.choice([10, 20])), int(random.choice([2, 3]))
    counts = printed_study.draw(seed, sizes, trials)
    return Study(counts, trials, digits, printed_study.printed(counts, trials, digits, ROUND_HALF_EVEN))


@dataclass(frozen=True)
class Planted:
    """A wrong document, the lines that are wrong by subject and quantity, and words of which a reason has one."""

    document: Document
    wrong: frozenset[tuple[str, str, str]]
    words: tuple[str, ...]


Plant = Callable[[Study, Random], Planted | None]
"""Plants one mistake; None where the study has no number that it would change."""


def _cells(document: Document, task: int, changes: Mapping[int, Mapping[str, str]]) -> Document:
    tables = list(document["table"])
    cells = tuple({**cell, **changes.get(k, {})} for k, cell in enumerate(tables[task]["cells"]))
    tables[task] = {**tables[task], "cells": cells}
    return {**document, "table": tuple(tables)}


def _key(cell: Mapping[str, str], task: int, quantity: str) -> tuple[str, str, str]:
    return ("one", "two")[task], f"{cell['presented']} -> {cell['answered']}", quantity


def _of_cell(
    quantity: str, wrong: Callable[[str, Study, int, int, Random], str | None], *words: str, tested: bool
) -> Plant:
    """Return what changes one mean or SD of a table; `tested` says that it is one with a t-test."""

    def plant(made: Study, random: Random) -> Planted | None:
        places = [(task, k) for task in range(2) for k in ((0, 4, 8) if tested else range(9))]
        for task, k in random.permutation(places).tolist():
            cell = made.document["table"][task]["cells"][k]
            changed = wrong(cell[quantity], made, task, k, random)
            if changed is not None and float(changed) != float(cell[quantity]) and float(cell[quantity]) > 0:
                document = _cells(made.document, task, {k: {quantity: changed}})
                return Planted(document, frozenset({_key(cell, task, quantity.replace("sd", "SD"))}), words)
        return None

    return plant


def digit(number: str, random: Random) -> str | None:
    """One significant digit is another."""
    places = [i for i, sign in enumerate(number.partition("e")[0]) if sign.isdigit()]
    significant = [i for i in places if number[: i + 1].strip("-0.")] or places[-1:]
    i = int(random.choice(significant))
    others = [sign for sign in "0123456789" if sign != number[i] and not (sign == "0" and i == significant[0])]
    return number[:i] + str(random.choice(others)) + number[i + 1 :]


def transposed(number: str, random: Random) -> str | None:
    """Two neighbouring digits after one another have changed places."""
    places = [i for i, sign in enumerate(number.partition("e")[0]) if sign.isdigit()]
    pairs = [(i, j) for i, j in pairwise(places) if number[i] != number[j]]
    if not pairs:
        return None
    i, j = pairs[int(random.integers(len(pairs)))]
    signs = list(number)
    signs[i], signs[j] = signs[j], signs[i]
    return "".join(signs)


def _values(made: Study, task: int, k: int) -> list[Fraction]:
    counts = made.counts[("one", "two")[task]][:, k // 3, k % 3]
    return [Fraction(int(count), made.trials) for count in counts]


def _spread(kind: str) -> Callable[[str, Study, int, int, Random], str | None]:
    def wrong(_: str, made: Study, task: int, k: int, __: Random) -> str | None:
        values = _values(made, task, k)
        mean, variance = float(statistics.mean(values)), float(statistics.variance(values))
        found = {
            "population": math.sqrt(variance * (len(values) - 1) / len(values)),
            "error": math.sqrt(variance / len(values)),
            "variance": variance,
            "binomial": math.sqrt(mean * (1 - mean) / made.trials),
        }
        return text(found[kind], made.digits, ROUND_HALF_EVEN)

    return wrong


def _moved(number: str, by: int) -> str:
    _, _, part = number.partition(".")
    return f"{float(number) * 10**by:.{max(len(part) - by, 0)}f}"


def _rows_swapped(made: Study, random: Random) -> Planted:
    task = int(random.integers(2))
    one, other = random.permutation(3)[:2].tolist()
    cells = made.document["table"][task]["cells"]
    changes, wrong = {}, set()
    for j in range(3):
        for here, there in ((one, other), (other, one)):
            own, new = cells[3 * here + j], cells[3 * there + j]
            changes[3 * here + j] = {"mean": new["mean"], "sd": new["sd"]}
            wrong |= {_key(own, task, name) for name in ("mean", "SD", "stars")}
    subject = ("one", "two")[task]
    for m in (one, other):
        wrong.add((subject, f"row of {MATERIALS[m]}", "row"))
    return Planted(_cells(made.document, task, changes), frozenset(wrong), ("rows", "swapped"))


def _cells_swapped(made: Study, random: Random) -> Planted | None:
    task, i = int(random.integers(2)), int(random.integers(3))
    cells = made.document["table"][task]["cells"]
    for j in random.permutation([j for j in range(3) if j != i]).tolist():
        one, other = 3 * i + i, 3 * i + j
        if cells[one]["mean"] != cells[other]["mean"]:
            new = {k: {name: cells[m][name] for name in ("mean", "sd")} for k, m in ((one, other), (other, one))}
            keys = {_key(cells[k], task, name) for k in (one, other) for name in ("mean", "SD")}
            return Planted(_cells(made.document, task, new), frozenset(keys), ("swapped",))
    return None


def _of_test(field: str, wrong: Callable[[dict[str, Any], Study, Random], str | int | None], *words: str) -> Plant:
    """Return what changes t, P or df of one t-test."""

    def plant(made: Study, random: Random) -> Planted | None:
        tests = made.document["t"][0]["tests"]
        for index in random.permutation(len(tests)).tolist():
            test = tests[index]
            changed = wrong(test, made, random)
            if changed is None or changed == test[field]:
                continue
            document = printed_study.changed(made.document, lambda one: one.update({field: changed}), index)  # noqa: B023
            quantity = {"t": f"t({test['df']})", "p": "P", "df": "df"}[field]
            return Planted(document, frozenset({(test["task"], test["of"], quantity)}), words)
        return None

    return plant


def _true(test: dict[str, Any], made: Study) -> tuple[float, int]:
    """Cohen's d of a test, and its participants."""
    values = [float(v) for v in _values(made, ("one", "two").index(test["task"]), 4 * MATERIALS.index(test["of"]))]
    return float((np.mean(values) - float(CHANCE)) / np.std(values, ddof=1)), len(values)


def _d(test: dict[str, Any], made: Study, _: Random) -> str:
    return text(_true(test, made)[0], 2, ROUND_HALF_EVEN)


def _squared(test: dict[str, Any], made: Study, _: Random) -> str:
    d, n = _true(test, made)
    return text(d * d * n, 2, ROUND_HALF_EVEN)


def _p(factor: float, *, df: int = 0) -> Callable[[dict[str, Any], Study, Random], str | None]:
    def wrong(test: dict[str, Any], made: Study, _: Random) -> str | None:
        d, n = _true(test, made)
        t = d * math.sqrt(n)
        p = factor * float(2 * stats.t.sf(abs(t), test["df"] + df))
        return printed_study.scientific(p, ROUND_HALF_EVEN) if p < 1 else None

    return wrong


def _star(made: Study, random: Random) -> Planted | None:
    for task, k in random.permutation([(task, k) for task in range(2) for k in (0, 4, 8)]).tolist():
        cell = made.document["table"][task]["cells"][k]
        marks = cell.get("stars", "")
        changed = marks[:-1] if len(marks) == 3 else marks + "*"
        if any(one.get("stars") for one in made.document["table"][task]["cells"]):
            document = _cells(made.document, task, {k: {"stars": changed}})
            return Planted(document, frozenset({_key(cell, task, "stars")}), ("",))
    return None


def _of_f(wrong: Callable[[str, Random], str | None], *words: str) -> Plant:
    def plant(made: Study, random: Random) -> Planted | None:
        for name, of in (("one_way", "one"), ("two_way", "both"))[:: int(random.choice([-1, 1]))]:
            for block in made.document.get(name, ())[:1]:
                changed = wrong(block["f"], random)
                if changed is not None and changed != block["f"]:
                    rest = made.document[name][1:]
                    ways = f"{name.replace('_', '-')} ANOVA, " + " and ".join(block.get("pair", (block.get("effect"),)))
                    key = (of, ways, f"F({block['df'][0]},{block['df'][1]})")
                    return Planted({**made.document, name: ({**block, "f": changed}, *rest)}, frozenset({key}), words)
        return None

    return plant


def _of_task(field: str, by: int, *words: str) -> Plant:
    def plant(made: Study, random: Random) -> Planted:
        tasks = list(made.document["task"])
        if field == "trials":
            tasks = [{**task, field: task[field] + by} for task in tasks]
            keys = {(task["id"], field, field) for task in tasks}
        else:
            k = int(random.integers(2))
            tasks[k] = {**tasks[k], field: tasks[k][field] + by}
            keys = {(tasks[k]["id"], field, field)}
        return Planted({**made.document, "task": tuple(tasks)}, frozenset(keys), words)

    return plant


def _table_of_errors(made: Study, random: Random) -> Planted:
    task, kind = int(random.integers(2)), _spread("error")
    cells = made.document["table"][task]["cells"]
    changes = {k: {"sd": kind("", made, task, k, random) or ""} for k in range(9)}
    wrong = frozenset(_key(cell, task, "SD") for cell in cells)
    return Planted(_cells(made.document, task, changes), wrong, ("standard error",))


def _number(
    change: Callable[[str, Random], str | None], field: str
) -> Callable[[dict[str, Any], Study, Random], str | None]:
    return lambda test, _, random: change(test[field], random)


def _tenfold(number: str, random: Random) -> str | None:
    p = float(number) * float(random.choice([0.1, 10.0]))
    return printed_study.scientific(p, ROUND_HALF_EVEN) if p < 1 else None


DIGIT = ("digit",)
KINDS: Mapping[str, Plant] = {
    "mean: a wrong digit": _of_cell("mean", lambda n, *a: digit(n, a[-1]), *DIGIT, tested=False),
    "mean: two digits swapped": _of_cell("mean", lambda n, *a: transposed(n, a[-1]), "digits", tested=False),
    "mean: the point moved": _of_cell("mean", lambda n, *a: _moved(n, -1), "power of ten", tested=False),
    "mean: a percentage without its sign": _of_cell("mean", lambda n, *a: _moved(n, 2), "percent", tested=False),
    "two rows swapped": _rows_swapped,
    "two cells of a row swapped": _cells_swapped,
    "SD: a wrong digit": _of_cell("sd", lambda n, *a: digit(n, a[-1]), *DIGIT, tested=True),
    "SD: two digits swapped": _of_cell("sd", lambda n, *a: transposed(n, a[-1]), "digits", tested=True),
    "SD: the point moved": _of_cell("sd", lambda n, *a: _moved(n, -1), "power of ten", tested=True),
    "SD: the population SD": _of_cell("sd", _spread("population"), "population SD", tested=True),
    "SD: the standard error": _of_cell("sd", _spread("error"), "standard error", tested=True),
    "SD: the variance": _of_cell("sd", _spread("variance"), "variance", tested=True),
    "SD: that of a binomial": _of_cell("sd", _spread("binomial"), "binomial", tested=True),
    "SDs of a table: standard errors": _table_of_errors,
    "t: a wrong digit": _of_test("t", _number(digit, "t"), *DIGIT),
    "t: two digits swapped": _of_test("t", _number(transposed, "t"), "digits"),
    "t: Cohen's d": _of_test("t", _d, "Cohen's d"),
    "t: squared": _of_test("t", _squared, "square"),
    "P: a wrong digit": _of_test("p", _number(digit, "p"), *DIGIT),
    "P: one-tailed": _of_test("p", _p(0.5), "one-tailed"),
    "P: off by a power of ten": _of_test("p", _number(_tenfold, "p"), "power of ten"),
    "stars: one too many or too few": _star,
    "df of t: n": _of_test("df", lambda test, *_: test["df"] + 1, "number of participants"),
    "F: a wrong digit": _of_f(digit, *DIGIT),
    "F: its root": _of_f(lambda n, _: text(math.sqrt(float(n)), 2, ROUND_HALF_EVEN), "root"),
    "participants: one too many": _of_task("participants", 1, "participants"),
    "trials: one too many": _of_task("trials", 1, "trials"),
}

BEYOND: Mapping[str, Plant] = {
    "SD of a cell without a test: a wrong digit": _of_cell(
        "sd", lambda n, made, task, k, random: digit(n, random) if k % 4 else None, *DIGIT, tested=False
    ),
}
"""What stands outside of the 27, because little in print speaks against it."""


@dataclass(frozen=True)
class Found:
    """What an audit said of one planted mistake: whether it was found and named, and the right lines it accused."""

    found: bool
    named: bool
    right: int
    accused: tuple[Line, ...]


def judged(planted: Planted) -> Found:
    """Return what the audit says."""
    lines = print_lines(printed_study.published(planted.document))
    accused = [line for line in lines if line.verdict in CONFLICTS]
    wrong = {(line.task, line.subject, line.quantity): line for line in accused}
    named = any(_names(line, planted) for line in accused)
    touched = {(task, subject.partition(" -> ")[0]) for task, subject, _ in planted.wrong}
    rows = {(task, f"row of {name}") for task, name in touched}
    right = [key for key in wrong if key not in planted.wrong and key[:2] not in rows]
    return Found(bool(accused), named, len(right), tuple(accused))


def _names(line: Line, planted: Planted) -> bool:
    """Whether a line accuses the wrong number, or its row with its answer, and names the mistake."""
    if (line.task, line.subject, line.quantity) in planted.wrong:
        return any(word in line.reason for word in planted.words)
    for task, subject, quantity in planted.wrong:
        shown, _, answered = subject.partition(" -> ")
        if (line.task, line.subject, quantity) == (task, f"row of {shown}", "mean"):
            _, found, told = line.reason.partition(f"-> {answered} (")
            return bool(found) and any(word in told.partition(")")[0] for word in planted.words)
    return False


def run(studies: int, kinds: Mapping[str, Plant]) -> Iterator[tuple[str, list[Found]]]:
    """Yield every kind with what was said of it, in so many studies that have a number for it."""
    for number, (kind, plant) in enumerate(kinds.items()):
        found: list[Found] = []
        seed = 1000 * number
        while len(found) < studies:
            seed += 1
            made = study(seed)
            if planted := plant(made, np.random.default_rng(seed)):
                found.append(judged(planted))
        yield kind, found


def _row(kind: str, found: Sequence[Found]) -> str:
    rights = [one.right for one in found]
    shares = (sum(one.found for one in found), sum(one.named for one in found))
    return f"| {kind} | {shares[0]} of {len(found)} | {shares[1]} of {len(found)} | {max(rights)} | {sum(rights)} |"


def main(studies: int = 8, right: int = 100) -> None:
    """Print the table."""
    begun = time.process_time()
    print("| planted | found | named | right lines accused, most | in all |")
    print("|:--|--:|--:|--:|--:|")
    every: list[Found] = []
    for kind, found in run(studies, KINDS):
        every += found
        print(_row(kind, found), flush=True)
    print(_row("all", every))
    for kind, found in run(studies, BEYOND):
        print(_row(kind, found), flush=True)
    alarms = 0
    for seed in range(right):
        lines = print_lines(printed_study.published(study(100_000 + seed).document))
        alarms += any(line.verdict in CONFLICTS for line in lines)
    print(f"\nfalse alarms in {right} right studies: {alarms}; {time.process_time() - begun:.0f} s of processor time")


if __name__ == "__main__":
    main(*map(int, sys.argv[1:3]))
