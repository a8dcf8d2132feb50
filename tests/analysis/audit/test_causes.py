"""One wrong number in a made-up study is accused alone, by its kind, and what follows from it is not."""

from __future__ import annotations

import statistics
from collections.abc import Mapping
from decimal import ROUND_HALF_EVEN
from fractions import Fraction
from typing import Any

import pytest
from syrupy.assertion import SnapshotAssertion

from palpate.analysis.audit.mistakes import Line
from palpate.analysis.audit.print_lines import print_lines
from tests.analysis import printed_study

COUNTS = printed_study.draw(3, {"one": 12, "two": 9}, 10)


@pytest.fixture(scope="module")
def made() -> dict[str, Any]:
    """Twelve and nine participants, ten trials, three decimals; numbers by scipy and statsmodels."""
    return printed_study.printed(COUNTS, 10, 3, ROUND_HALF_EVEN)


def _accused(document: dict[str, Any]) -> list[Line]:
    lines = print_lines(printed_study.published(document))
    return [line for line in lines if line.verdict in ("differs", "impossible")]


def _with(document: dict[str, Any], changes: Mapping[int, Mapping[str, str]]) -> dict[str, Any]:
    first, *rest = document["table"]
    cells = tuple({**cell, **changes.get(k, {})} for k, cell in enumerate(first["cells"]))
    return {**document, "table": ({**first, "cells": cells}, *rest)}


def _values(cell: int) -> list[Fraction]:
    return [Fraction(int(count), 10) for count in COUNTS["one"][:, cell // 3, cell % 3]]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda text: text[:2] + text[3] + text[2] + text[4], "two digits are swapped"),
        (lambda text: text[:2] + str((int(text[2]) + 4) % 9) + text[3:], "one digit is wrong"),
        (lambda text: f"{float(text) * 100:.1f}", "it was printed as a percentage"),
        (lambda text: f"{float(text) / 10:.4f}", "it is off by a power of ten"),
    ],
)
def test_a_wrong_mean_is_accused_alone(made: dict[str, Any], change: Any, words: str) -> None:
    right = made["table"][0]["cells"][4]["mean"]
    (line,) = _accused(_with(made, {4: {"mean": change(right)}}))
    assert (line.quantity, line.printed) == ("mean", change(right))
    assert float(line.recomputed) == pytest.approx(float(right), abs=6e-4)
    assert words in line.reason
    assert line.reason.endswith("conflicts")


def test_the_row_of_a_wrong_mean_shows_the_mean_that_is_printed(made: dict[str, Any]) -> None:
    """What would fit for it is told in the row's reason alone."""
    first, right, last = (cell["mean"] for cell in made["table"][0]["cells"][3:6])
    wrong = right[:2] + str((int(right[2]) + 4) % 9) + right[3:]
    lines = print_lines(printed_study.published(_with(made, {4: {"mean": wrong}})))
    (accused,) = (one for one in lines if one.verdict == "differs")
    (row,) = (
        one for one in lines if one.quantity == "row" and f"{accused.recomputed} instead of {wrong}" in one.reason
    )
    added = float(first) + float(wrong) + float(last)
    assert (row.printed, row.verdict) == (f"{first} + {wrong} + {last} = {added:.4g}", "agrees")
    assert not [one for one in lines if one.quantity == "row" and one is not row and " instead of " in one.reason]


def test_a_variance_printed_as_sd_is_accused_alone(made: dict[str, Any], approved: SnapshotAssertion) -> None:
    wrong = printed_study.text(statistics.variance(_values(4)), 3, ROUND_HALF_EVEN)
    (line,) = _accused(_with(made, {4: {"sd": wrong}}))
    assert (line.quantity, line.printed) == ("SD", wrong)
    assert line.reason == approved


def test_the_sd_of_a_binomial_is_accused_alone(made: dict[str, Any]) -> None:
    mean = statistics.mean(_values(4))
    wrong = printed_study.text(printed_study.root(mean * (1 - mean) / 10), 3, ROUND_HALF_EVEN)
    (line,) = _accused(_with(made, {4: {"sd": wrong}}))
    assert (line.quantity, line.printed) == ("SD", wrong)
    assert "binomial" in line.reason


def test_swapped_rows_are_named_and_no_test_is_accused(made: dict[str, Any], approved: SnapshotAssertion) -> None:
    cells = made["table"][0]["cells"]
    new = {k: {part: cells[(k + 3) % 6][part] for part in ("mean", "sd")} for k in range(6)}
    accused = _accused(_with(made, new))
    assert accused
    assert {line.quantity for line in accused} <= {"mean", "SD"}
    assert [line.reason for line in accused] == approved


def test_the_sums_of_swapped_rows_name_the_swap_once(made: dict[str, Any]) -> None:
    cells = made["table"][0]["cells"]
    new = {k: {part: cells[(k + 3) % 6][part] for part in ("mean", "sd")} for k in range(6)}
    lines = print_lines(printed_study.published(_with(made, new)))
    swapped = {line.reason.partition(";")[0] for line in lines if line.verdict == "differs"}
    rows = {line.subject: (line.verdict, line.reason) for line in lines if line.quantity == "row" and line.reason}
    assert rows == dict.fromkeys(("row of glass", "row of sand"), ("agrees", *swapped))


def test_swapped_rows_whose_stars_went_with_them_are_named(made: dict[str, Any], approved: SnapshotAssertion) -> None:
    cells = made["table"][0]["cells"]
    new = {k: {part: cells[(k + 3) % 6].get(part, "") for part in ("mean", "sd", "stars")} for k in range(6)}
    accused = _accused(_with(made, new))
    assert {line.quantity for line in accused} == {"mean", "SD", "stars"}
    assert [line.reason for line in accused] == approved


def test_swapped_rows_without_a_star_in_them_are_named_and_no_line_beside_them(made: dict[str, Any]) -> None:
    """The stars were left behind where the table shows none; the printed P say which were lost."""
    cells = made["table"][0]["cells"]
    new = {k: {**{part: cells[(k + 3) % 6][part] for part in ("mean", "sd")}, "stars": ""} for k in range(6)}
    accused = _accused(_with(made, new))
    assert {line.subject.partition(" ")[0] for line in accused} == {"glass", "sand"}
    assert {line.where for line in accused} == {made["table"][0]["where"]}
    assert len({line.reason for line in accused}) == 1


def test_an_sd_off_by_ten_beside_right_answers_alone_leaves_the_mean_alone(
    made: dict[str, Any], approved: SnapshotAssertion
) -> None:
    """No row adds up here, and the moved point gives the SD a digit more than its column has."""
    moved = _with(made, {4: {"sd": f"{float(made['table'][0]['cells'][4]['sd']) / 10:.4f}"}})
    tables = [{**t, "complete": False, "cells": tuple(t["cells"][k] for k in (0, 4, 8))} for t in moved["table"]]
    (line,) = _accused({**moved, "table": tuple(tables)})
    assert (line.quantity, line.subject) == ("SD", "sand -> sand")
    assert line.reason == approved


def test_two_digits_of_a_percentage_are_told_as_swapped(made: dict[str, Any], approved: SnapshotAssertion) -> None:
    tables = [
        {
            **t,
            "cells": tuple(
                {**c, **{part: f"{100 * float(c[part]):.1f}%" for part in ("mean", "sd")}} for c in t["cells"]
            ),
        }
        for t in made["table"]
    ]
    right = tables[0]["cells"][4]["mean"]
    (line,) = _accused(_with({**made, "table": tuple(tables)}, {4: {"mean": right[1] + right[0] + right[2:]}}))
    assert line.recomputed == right
    assert line.reason == approved


def test_means_of_answered_trials_are_not_told_as_one_mistake_each(approved: SnapshotAssertion) -> None:
    """Thirds and sevenths are no tenths."""
    names = ("glass", "sand", "snow")
    cells = tuple(
        {"presented": a, "answered": a, "mean": mean}
        for a, mean in zip(names, ("0.333", "0.429", "0.714"), strict=True)
    )
    task = {"id": "one", "participants": 2, "trials": 10}
    table = {"where": "Table", "task": "one", "complete": False, "cells": cells}
    accused = _accused({"study": "made", "source": "Nobody", "task": (task,), "table": (table,)})
    assert len(accused) == 3
    assert [line.reason for line in accused] == approved


@pytest.mark.parametrize(("key", "by"), [("participants", 1), ("trials", 1)])
def test_a_wrong_number_of_participants_or_trials_is_accused_alone(made: dict[str, Any], key: str, by: int) -> None:
    wrong = tuple({**task, key: task[key] + by} for task in made["task"][:1])
    rest = made["task"][1:] if key == "participants" else tuple({**t, key: t[key] + by} for t in made["task"][1:])
    accused = _accused({**made, "task": (*wrong, *rest)})
    assert {line.quantity for line in accused} == {key}
    assert accused[0].recomputed == str(made["task"][0][key])


def test_a_wrong_digit_of_an_f_is_told_from_a_wrong_p(made: dict[str, Any], approved: SnapshotAssertion) -> None:
    (one,) = made["one_way"]
    wrong = one["f"][:-1] + str((int(one["f"][-1]) + 5) % 10)
    accused = _accused({**made, "one_way": ({**one, "f": wrong},)})
    assert [line.quantity for line in accused] == ["F(3,44)"]
    assert accused[0].reason == approved
