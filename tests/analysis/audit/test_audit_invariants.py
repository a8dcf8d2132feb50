"""The audit: what it must never accuse, and that it can be asked of any file."""

from __future__ import annotations

import json
import statistics
from collections.abc import Sequence
from fractions import Fraction
from typing import Any

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy import stats

from palpate.analysis.audit.audit import Audit, Comparison
from palpate.analysis.audit.print_lines import print_lines
from tests.analysis import printed_study


@settings(deadline=None, max_examples=40)
@given(
    st.integers(0, 2**32),
    st.integers(2, 9),
    st.integers(2, 9),
    st.integers(1, 8),
    st.integers(2, 3),
    st.sampled_from((*printed_study.WAYS, printed_study.MIXED)),
    st.booleans(),
    st.booleans(),
    st.sampled_from([1, 2, 3]),
)
def test_no_false_accusation(
    seed: int, first: int, second: int, trials: int, digits: int, way: str, steps: bool, above: bool, kind: int
) -> None:
    """The invariant: whatever the counts, however they were rounded or cut off, no line differs or is impossible."""
    counts = printed_study.draw(seed, {"one": first, "two": second}, trials)
    document = printed_study.printed(counts, trials, digits, way, steps=steps, above=above, kind=kind)
    lines = print_lines(printed_study.published(document))
    assert [line for line in lines if line.verdict in ("differs", "impossible")] == []
    if steps:
        assert [line for line in lines if not line.agrees] == []


@settings(deadline=None, max_examples=200)
@given(
    st.integers(0, 2**32),
    st.integers(3, 30),
    st.integers(1, 3),
    st.integers(1, 3),
    st.sampled_from((*printed_study.WAYS, printed_study.MIXED)),
    st.booleans(),
)
def test_no_false_accusation_of_scores(seed: int, n: int, items: int, digits: int, way: str, ends: bool) -> None:
    """The same for means of `items` whole numbers on a scale from 1 to 7, whether its ends are stated or not."""
    _accuses_nothing(printed_study.scores(seed, n, items), items, digits, way, ends=ends)


def test_more_counts_around_an_sd_than_can_be_tried() -> None:
    """Of three items each: those that give the mean and the SD alone are few enough; hypothesis found it."""
    counts = [16, 10, 14, 18, 13, 1, 2, 6, 17, 11, 8, 7, 15, 8, 2, 9, 10, 12, 18, 17, 7, 11, 1, 2, 6, 3, 15, 16, 15, 18]
    _accuses_nothing([Fraction(3 + count, 3) for count in counts], 3, 1, printed_study.WAYS[0], ends=True)


def _accuses_nothing(values: list[Fraction], items: int, digits: int, way: str, *, ends: bool) -> None:
    n, sd = len(values), printed_study.root(statistics.variance(values))
    t = float(statistics.mean(values) - 4) / (float(sd) / n**0.5)
    text = {"name": "ease", "mean": printed_study.text(statistics.mean(values), digits, way)}
    text["sd"] = printed_study.text(sd, digits, way)
    p = float(2 * stats.t.sf(abs(t), n - 1))
    text["stars"] = "*" if p < 0.05 else ""
    scale = {"low": 1, "high": 7} if ends else {}
    test = {"task": "all", "of": "ease", "df": n - 1, "t": printed_study.text(Fraction(t), 2, way), "null": "4"}
    test["p"] = printed_study.scientific(p, way)
    document = {
        "study": "made",
        "source": "Nobody",
        "chance": "0.25",
        "levels": ({"stars": "*", "p": "0.05"},),
        "task": ({"id": "all", "participants": n},),
        "score": ({"where": "Here", "task": "all", "items": items, **scale, "cells": (text,)},),
        "t": ({"where": "Here", "tests": (test,)},),
    }
    lines = print_lines(printed_study.published(document))
    assert len(lines) == 5 + bool(text["stars"])
    assert [line for line in lines if not line.agrees] == []


@settings(deadline=None)
@given(
    st.integers(1, 70),
    st.lists(st.integers(0, 10**6), min_size=1, max_size=20),
    st.sampled_from((*printed_study.WAYS, printed_study.MIXED)),
)
def test_no_false_accusation_of_percentages(trials: int, drawn: list[int], way: str) -> None:
    """The same for percentages of one number of trials; those printed in one way fit that number."""
    document = printed_study.choices([number % (trials + 1) for number in drawn], trials, way)
    lines = print_lines(printed_study.published(document))
    found = {line.quantity: line.verdict for line in lines if line.quantity != "correct"}
    assert {line.verdict for line in lines if line.quantity == "correct"} <= {"agrees", "cannot be decided"}
    assert "impossible" not in found.values()
    if way != printed_study.MIXED:
        assert set(found.values()) <= {"agrees", "agrees if truncated"}


NUMBERS = st.from_regex(r"(0|[0-9]{1,2})(\.[0-9]{1,3})?(e-[0-9])?%?", fullmatch=True)

SIGNED = st.one_of(NUMBERS, NUMBERS.map(lambda text: f"-{text}"))

PROBABILITIES = st.one_of(NUMBERS, NUMBERS.map(lambda text: f"<{text}"))

NAMES = st.sampled_from(["a", "b", "c"])

DFS = st.integers(1, 60)

PAIRS = st.tuples(DFS, DFS)


def _some(strategy: st.SearchStrategy[Any], most: int = 2, once: Sequence[str] = ()) -> st.SearchStrategy[Any]:
    by = (lambda one: tuple(one[key] for key in once)) if once else None
    return st.lists(strategy, min_size=1, max_size=most, unique_by=by).map(tuple)


def _table(**fields: st.SearchStrategy[Any]) -> st.SearchStrategy[dict[str, Any]]:
    return st.fixed_dictionaries({"where": st.just("Here"), **fields})


CELL = st.fixed_dictionaries(
    {"presented": NAMES, "answered": NAMES, "mean": SIGNED}, optional={"sd": NUMBERS, "stars": st.just("*")}
)

SCORE = st.fixed_dictionaries({"name": st.sampled_from(["ease", "joy"]), "mean": SIGNED}, optional={"sd": NUMBERS})

TEST = {
    "task": st.just("one"),
    "of": st.sampled_from(["a", "b", "c", "ease"]),
    "df": DFS,
    "t": SIGNED,
    "null": st.sampled_from(["1/3", "4"]),
}

SOURCE = {"name": NAMES, "df": DFS}

DOCUMENTS = st.fixed_dictionaries(
    {
        "study": st.just("any"),
        "source": st.just("Nobody"),
        "chance": st.just("1/3"),
        "levels": st.just(({"stars": "*", "p": "0.05"},)),
        "task": st.fixed_dictionaries(
            {"id": st.just("one"), "participants": st.integers(1, 6)}, optional={"trials": st.integers(1, 4)}
        ).map(lambda task: (task,)),
        "table": _some(
            _table(task=st.just("one"), complete=st.booleans(), cells=_some(CELL, 5, ("presented", "answered"))), 1
        ),
        "score": _some(_table(task=st.just("one"), cells=_some(SCORE, once=("name",)), items=st.integers(1, 2)), 1),
        "t": _some(_table(tests=_some(st.fixed_dictionaries(TEST, optional={"p": PROBABILITIES}), 3)), 1),
        "one_way": _some(
            _table(task=st.just("one"), pair=st.tuples(NAMES, NAMES), df=PAIRS, f=NUMBERS, p=PROBABILITIES)
        ),
        "two_way": _some(_table(effect=st.sampled_from(["task", "material"]), df=PAIRS, f=NUMBERS, p=PROBABILITIES)),
        "anova": _some(
            _table(
                lines=st.lists(
                    st.fixed_dictionaries(
                        SOURCE, optional={"ss": NUMBERS, "ms": NUMBERS, "f": NUMBERS, "p": PROBABILITIES}
                    ),
                    min_size=2,
                    max_size=3,
                ).map(tuple)
            ),
            1,
        ),
        "claim": _some(_table(task=st.just("one"), significant=st.integers(0, 4), of=st.integers(1, 4)), 1),
    }
)


_A = {"presented": "a", "answered": "a"}

NO_COUNTS_BUT_A_T = {
    "study": "any",
    "source": "Nobody",
    "task": ({"id": "one", "participants": 2, "trials": 1},),
    "table": ({"where": "T", "task": "one", "complete": False, "cells": ({**_A, "mean": "0.3", "sd": "1"},)},),
    "text": ({"where": "Here", "task": "one", "cells": ({**_A, "mean": "0", "sd": "0"},)},),
    "t": ({"where": "Here", "tests": ({"task": "one", "of": "a", "df": 1, "t": "0", "null": "1/3"},)},),
}
"""One trial each: no counts give the mean of the table, whose t still fits it, and the text repeats another SD."""


@settings(deadline=None, max_examples=25)
@given(DOCUMENTS)
@example(NO_COUNTS_BUT_A_T)
def test_any_file_that_can_be_read_can_be_audited(document: dict[str, Any]) -> None:
    """However odd the numbers: a line for each, with text, and ends that JSON can hold or none."""
    found = Audit("any", "PRINT", "", Comparison("Nobody", print_lines(printed_study.published(document)), ()))
    json.dumps(found.as_dict(), allow_nan=False)
    assert found.text()


@pytest.mark.parametrize("percent", ["43.25%", "0%", "100.0%"])
def test_percentages_with_decimals(percent: str) -> None:
    cells = ({"pair": ("1", "2"), "correct": percent}, {"pair": ("2", "3"), "correct": "50%"})
    block = {"where": "Here", "task": "x", "participants": 3, "trials": 2, "cells": cells}
    document = {"study": "any", "source": "Nobody", "choices": (block,)}
    assert len(print_lines(printed_study.published(document))) == 4
