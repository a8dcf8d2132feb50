"""Mistakes planted in a made-up study: the audit must name each, and accuse nothing beside it."""

from __future__ import annotations

import math
import re
import statistics
from collections.abc import Iterator, Mapping
from decimal import ROUND_DOWN, ROUND_HALF_EVEN
from fractions import Fraction
from functools import partial
from typing import Any

import pytest
from scipy import stats
from syrupy.assertion import SnapshotAssertion

from palpate.analysis.audit.evidence import TOO_MANY
from palpate.analysis.audit.mistakes import Line
from palpate.analysis.audit.print_lines import print_lines
from tests.analysis import printed_study

SIZES = {"one": 12, "two": 9}

COUNTS = printed_study.draw(3, SIZES, 10)


@pytest.fixture(scope="module")
def made() -> dict[str, Any]:
    """Twelve and nine participants, ten trials, three decimals."""
    return printed_study.printed(COUNTS, 10, 3, ROUND_HALF_EVEN)


def _true(index: int) -> tuple[float, int]:
    """Cohen's d of a test, from the counts, and its participants."""
    task, material = ("one", "two")[index // 3], index % 3
    ratios = COUNTS[task][:, material, material] / 10
    return float((ratios.mean() - 1 / 3) / ratios.std(ddof=1)), len(ratios)


def _accused(document: dict[str, Any], quantity: str) -> list[Line]:
    lines = print_lines(printed_study.published(document))
    return [line for line in lines if line.quantity == quantity and not line.agrees]


@pytest.mark.parametrize("index", range(6))
def test_a_d_in_the_place_of_t_is_named(made: dict[str, Any], index: int) -> None:
    d, n = _true(index)
    document = printed_study.changed(made, lambda test: test.update(t=f"{d:.2f}"), index)
    (line,) = _accused(document, f"t({n - 1})")
    assert line.reason.endswith(f" d = {d:.2f}")
    assert _accused(document, "P") == _accused(document, "stars") == []


@pytest.mark.parametrize("index", range(6))
@pytest.mark.parametrize(
    ("mistake", "expected"),
    [
        ("tail", "it is one-tailed"),
        ("size", "it is the P of d * sqrt({other}) with"),
        ("df", "it was computed with {off} df"),
    ],
)
def test_a_wrong_p_is_named(made: dict[str, Any], index: int, mistake: str, expected: str) -> None:
    """P by scipy, wrong in one way each; the mistake that was made is among those named."""
    d, n = _true(index)
    other = sum(SIZES.values()) - n
    t = d * n**0.5
    wrong = {
        "tail": stats.t.sf(abs(t), n - 1),
        "size": 2 * stats.t.sf(abs(d) * other**0.5, other - 1),
        "df": 2 * stats.t.sf(abs(t), other - 1),
    }
    p = printed_study.scientific(float(wrong[mistake]), ROUND_HALF_EVEN)
    document = printed_study.changed(made, lambda test: test.update(p=p), index)
    (line,) = _accused(document, "P")
    assert expected.format(other=other, off=other - 1) in line.reason


def test_a_wrong_df_is_named(made: dict[str, Any], approved: SnapshotAssertion) -> None:
    document = printed_study.changed(made, lambda test: test.update(df=12))
    (line,) = _accused(document, "df")
    assert line.recomputed == "11"
    assert line.reason == approved


def _with_sd(document: dict[str, Any], sds: Mapping[int, str]) -> dict[str, Any]:
    """The study with other SDs in its first table, by the number of the cell."""
    first, *rest = document["table"]
    cells = tuple({**cell, "sd": sds.get(k, cell["sd"])} for k, cell in enumerate(first["cells"]))
    return {**document, "table": ({**first, "cells": cells}, *rest)}


def _wrong_sd(counts: printed_study.Counts, cell: int, digits: int, kind: str) -> str:
    """An SD of the first task that is none, by the statistics library."""
    values = [Fraction(int(count), 10) for count in counts["one"][:, cell // 3, cell % 3]]
    variance = statistics.pvariance(values) if "population" in kind else statistics.variance(values) / len(values)
    return printed_study.text(math.sqrt(variance), digits, ROUND_HALF_EVEN)


@pytest.mark.parametrize("n", [5, 8, 12, 25])
@pytest.mark.parametrize(
    ("kind", "digits"), [("the standard error", 2), ("the standard error", 3), ("population SD", 3)]
)
@pytest.mark.parametrize("cell", [0, 4, 8])
def test_an_sd_that_is_none_is_accused_once_and_no_test_with_it(n: int, kind: str, digits: int, cell: int) -> None:
    counts = printed_study.draw(n, {"one": n, "two": n - 1}, 10)
    right = printed_study.printed(counts, 10, digits, ROUND_HALF_EVEN)
    wrong = _wrong_sd(counts, cell, digits, kind)
    lines = print_lines(printed_study.published(_with_sd(right, {cell: wrong})))
    (line,) = [line for line in lines if line.verdict in ("differs", "impossible")]
    assert (line.quantity, line.printed) == ("SD", wrong)
    assert line.subject == f"{printed_study.MATERIALS[cell // 3]} -> {printed_study.MATERIALS[cell // 3]}"
    assert kind in line.reason


def test_standard_errors_throughout_a_table_are_named_and_nothing_else_is_accused(
    made: dict[str, Any], approved: SnapshotAssertion
) -> None:
    wrong = {cell: _wrong_sd(COUNTS, cell, 3, "the standard error") for cell in range(9)}
    right = made["table"][0]["cells"]
    lines = print_lines(printed_study.published(_with_sd(made, wrong)))
    accused = [line for line in lines if not line.agrees]
    assert {line.quantity for line in accused} == {"SD"}
    assert len(accused) == sum(float(cell["sd"]) > 0 for cell in right)
    assert [line.reason for line in accused] == approved


def test_the_standard_error_of_a_cell_without_a_test_is_named(
    made: dict[str, Any], approved: SnapshotAssertion
) -> None:
    """An SD printed as 0.043, with the true 0.148 far beyond the neighbouring digits."""
    (line,) = _accused(_with_sd(made, {5: _wrong_sd(COUNTS, 5, 3, "the standard error")}), "SD")
    assert line.verdict == "impossible"
    assert line.reason == approved


@pytest.mark.parametrize(
    ("factor", "reason"),
    [
        (1.0, ", or the SD is the standard error"),
        (math.sqrt(11), "it was computed with sqrt(n - 1), as if from 11 participants, or the SD is the population SD"),
    ],
)
def test_what_explains_a_t_alone_as_well_as_its_sd_says_both(made: dict[str, Any], factor: float, reason: str) -> None:
    """Without P, nothing tells d printed as t from a standard error printed as SD."""

    def change(test: dict[str, Any]) -> None:
        test.update(t=f"{_true(0)[0] * factor:.2f}")
        del test["p"]

    (line,) = [
        line for line in print_lines(printed_study.published(printed_study.changed(made, change))) if not line.agrees
    ]
    assert line.quantity == "t(11)"
    assert reason in line.reason


def test_a_d_printed_as_t_with_its_p_may_be_a_standard_error_printed_as_sd(
    made: dict[str, Any], approved: SnapshotAssertion
) -> None:
    """Score without steps and without F: t and P of d fit the one as well as the other."""
    p = printed_study.scientific(float(2 * stats.t.sf(1.5, 15)), ROUND_HALF_EVEN)
    test = {"task": "all", "of": "ease", "df": 15, "t": "1.50", "p": p, "null": "4"}
    score = {"where": "T", "task": "all", "cells": ({"name": "ease", "mean": "5.500", "sd": "1.000"},)}
    document = {"study": "made", "source": "Nobody", "task": ({"id": "all", "participants": 16},)}
    document |= {"score": (score,), "t": ({"where": "T", "tests": (test,)},)}
    (line,) = [line for line in print_lines(printed_study.published(document)) if line.verdict == "differs"]
    assert line.quantity == "SD"
    assert line.reason == approved


@pytest.fixture(scope="module")
def alone() -> dict[str, Any]:
    """The same with one task."""
    return printed_study.printed({"one": COUNTS["one"]}, 10, 3, ROUND_HALF_EVEN)


@pytest.mark.parametrize("index", range(3))
@pytest.mark.parametrize("size", [11, 13])
def test_a_wrong_n_is_named_in_a_study_of_one_task(alone: dict[str, Any], index: int, size: int) -> None:
    """t and P of d, by scipy, as if there were one participant more or fewer than twelve."""
    d, n = _true(index)
    t, p = d * size**0.5, printed_study.scientific(float(2 * stats.t.sf(abs(d) * size**0.5, size - 1)), ROUND_HALF_EVEN)
    document = printed_study.changed(alone, lambda test: test.update(t=f"{t:.2f}"), index)
    (line,) = _accused(document, f"t({n - 1})")
    assert (f"d * sqrt({size})" if size > n else "sqrt(n - 1)") in line.reason
    (line,) = _accused(printed_study.changed(alone, lambda test: test.update(p=p), index), "P")
    assert f"d * sqrt({size}) with {size - 1} df" in line.reason


def test_the_n_of_a_printed_df_and_of_all_tasks_is_named(made: dict[str, Any]) -> None:
    """12 and 9 participants are 21; nobody else says 17."""
    for size, df in ((21, 11), (17, 16)):
        text = f"{_true(0)[0] * size**0.5:.2f}"
        document = printed_study.changed(made, partial(dict.update, t=text, df=df))
        (line,) = _accused(document, f"t({df})")
        assert f"it is d * sqrt({size}), but n is 12" in line.reason


@pytest.mark.parametrize(
    ("df", "reason"),
    [
        ((3, 47), "it is the total df, from which the effects' df were not subtracted"),
        ((3, 48), "it is the number of values"),
        ((3, 45), "it is the number of values minus the effect's df"),
        ((3, 32), "it was computed from 9 participants, but n is 12"),
        ((3, 33), "it was computed as if for repeated measures"),
        ((4, 44), "it is the number of levels"),
        ((3, 17), ""),
    ],
)
def test_wrong_df_of_an_f_are_named(made: dict[str, Any], df: tuple[int, int], reason: str) -> None:
    """By hand: four groups of twelve, 48 values, 3 and 44 df."""
    document = {**made, "one_way": tuple({**one, "df": df} for one in made["one_way"])}
    accused = [*_accused(document, "df of the effect"), *_accused(document, "df of the residual")]
    assert [line.reason for line in accused] == [reason]


def _types(line: Line) -> list[str]:
    return re.findall(r"\bI+\b", line.recomputed)


@pytest.mark.parametrize("kind", [1, 2, 3])
def test_an_f_of_any_type_agrees_and_its_type_is_named(kind: int) -> None:
    """F by statsmodels. 15 and 5 participants: types I and II are the same, type III is another."""
    counts = printed_study.draw(1, {"one": 15, "two": 5}, 10)
    lines = print_lines(printed_study.published(printed_study.printed(counts, 10, 3, ROUND_HALF_EVEN, kind=kind)))
    by_effect = {effect: [one for one in lines if one.subject.endswith(effect)] for effect in ("task", "material")}
    assert all(line.agrees for found in by_effect.values() for line in found)
    assert [len(found) for found in by_effect.values()] == [4, 4]
    assert "type" not in by_effect["task"][0].recomputed
    assert _types(by_effect["material"][0]) == (["III"] if kind == 3 else ["I", "II"])


def test_an_f_of_no_type_differs(made: dict[str, Any]) -> None:
    changed = tuple({**one, "f": "999.99"} for one in made["two_way"])
    differing = _accused({**made, "two_way": changed}, "F(2,57)")
    assert [_types(line) for line in differing] == [["I", "II", "III"]]


@pytest.mark.parametrize(
    ("n", "items", "mean", "sd", "verdict"),
    [
        # Half at either end of a scale from 1 to 7 give 3 sqrt(n / (n - 1)), the most that there is.
        (30, 3, "4.0", "3.0", "agrees"),
        (30, 3, "4.4", "9.9", "impossible"),
        (30, 1, "4.40", "12.00", "impossible"),
        # 4 and 5 give 0.7071.
        (2, 1, "4.5", "0.7", "agrees"),
        (2, 1, "4.5", "0", "impossible"),
        (2, 1, "4.5000", "0.0000", "impossible"),
        (1000, 10, "4.4", "1.9", "cannot be decided"),
    ],
)
def test_an_sd_of_scores_is_impossible_however_far_off(n: int, items: int, mean: str, sd: str, verdict: str) -> None:
    score = {"where": "T", "task": "all", "items": items, "low": 1, "high": 7}
    score["cells"] = ({"name": "ease", "mean": mean, "sd": sd},)
    document = {"study": "made", "source": "Nobody", "task": ({"id": "all", "participants": n},), "score": (score,)}
    line = print_lines(printed_study.published(document))[1]
    assert (line.quantity, line.verdict) == ("SD", verdict)
    if verdict == "cannot be decided":
        assert line.reason == TOO_MANY


@pytest.mark.parametrize("null", ["4", "7"])
def test_a_test_of_a_score_says_nothing_of_a_claim_about_materials(made: dict[str, Any], null: str) -> None:
    """Significant materials by scipy; the score beside them has a right t, above or below its null."""
    ratios = [COUNTS["one"][:, k, k] / 10 for k in range(3)]
    above = int(sum(stats.ttest_1samp(one, 1 / 3, alternative="greater").pvalue < 0.025 for one in ratios))
    t = (5.5 - int(null)) / 1.0 * math.sqrt(12)
    score = {"where": "T", "task": "one", "cells": ({"name": "ease", "mean": "5.5000", "sd": "1.0000"},)}
    test = {"task": "one", "of": "ease", "df": 11, "t": f"{t:.2f}", "null": null}
    claim = {"where": "Text", "task": "one", "significant": above, "of": 3}
    document = {**made, "score": (score,), "t": (*made["t"], {"where": "T", "tests": (test,)}), "claim": (claim,)}
    (line,) = [one for one in print_lines(printed_study.published(document)) if one.quantity == "significant"]
    assert (line.verdict, line.recomputed) == ("agrees", f"{above} of 3")


@pytest.mark.parametrize(("p", "earned"), [("0.0498", "*"), ("0.0502", "none")])
def test_stars_are_held_against_the_printed_p(p: str, earned: str) -> None:
    """t = 2.20 at 11 df stands for P from 0.0496 to 0.0505 (scipy) and leaves a star open; the P beside it decides."""
    assert 2 * stats.t.sf(2.205, 11) < 0.0498 < 0.0502 < 2 * stats.t.sf(2.195, 11)
    cell = {"presented": "glass", "answered": "glass", "mean": "0.500", "sd": "0.262", "stars": "*"}
    document = {
        "study": "made",
        "source": "Nobody",
        "chance": "1/3",
        "levels": ({"stars": "*", "p": "0.05"},),
        "task": ({"id": "one", "participants": 12},),
        "table": ({"where": "T", "task": "one", "complete": False, "cells": (cell,)},),
        "t": ({"where": "Text", "tests": ({"task": "one", "of": "glass", "df": 11, "t": "2.20", "p": p},)},),
    }
    lines = {line.quantity: line for line in print_lines(printed_study.published(document))}
    assert lines["P"].agrees
    assert (lines["stars"].recomputed, lines["stars"].agrees) == (earned, earned == "*")
    assert ("them is 0.0502" in lines["stars"].reason) is bool(lines["stars"].reason) is (earned != "*")


def _cut_population_sds() -> Iterator[tuple[dict[str, Any], str]]:
    """Studies whose printed SD is the population SD, rounded, and at the same time the SD cut off but not rounded."""
    for seed in range(12):
        counts = printed_study.draw(seed, {"one": 12}, 10)
        values = [Fraction(int(count), 10) for count in counts["one"][:, 0, 0]]
        population = printed_study.text(statistics.pstdev(values), 2, ROUND_HALF_EVEN)
        sd = printed_study.root(statistics.variance(values))
        cut, rounded = (printed_study.text(sd, 2, way) for way in (ROUND_DOWN, ROUND_HALF_EVEN))
        if population == cut != rounded:
            yield _with_sd(printed_study.printed(counts, 10, 2, ROUND_HALF_EVEN), {0: population}), population


@pytest.mark.parametrize(("document", "sd"), list(_cut_population_sds()))
def test_a_population_sd_that_its_t_pins_has_to_be_truncated(document: dict[str, Any], sd: str) -> None:
    """Other counts with the same mean have that SD as rounded, but not the printed t."""
    (line, *_) = [line for line in print_lines(printed_study.published(document)) if line.quantity == "SD"]
    assert (line.printed, line.verdict) == (sd, "agrees if truncated")
    assert "printed t requires this" in line.reason
    assert "population SD" in line.reason


def test_a_recomputed_range_begins_with_its_lower_end() -> None:
    """Means and SDs of two digits leave P open, and the stars follow a P that is printed too small."""
    lines = [line for seed in range(12) for line in _starred_by_another_p(seed)]
    ranges = [re.findall(r"recomputed P = (\S+) to (\S+)", line.reason) for line in lines]
    found = [pair for pairs in ranges for pair in pairs]
    assert found
    assert all(float(low) < float(high) for low, high in found)


def _starred_by_another_p(seed: int) -> list[Line]:
    counts = printed_study.draw(seed, {"one": 9}, 10)
    document = printed_study.printed(counts, 10, 2, ROUND_HALF_EVEN, steps=False)
    first, *rest = document["table"]
    tests = tuple({**test, "p": "1.00e-9"} for test in document["t"][0]["tests"])
    cells = tuple({**cell, "stars": "***"} if "stars" in cell else cell for cell in first["cells"])
    changed = {**document, "table": ({**first, "cells": cells}, *rest), "t": ({"where": "Text", "tests": tests},)}
    return [line for line in print_lines(printed_study.published(changed)) if line.quantity == "stars"]


def test_a_number_that_differs_never_looks_like_the_one_beside_it() -> None:
    """4 and 5 give an SD of 0.7071, and 2 and 7 one of 3.5355; whole numbers, as a bare 0 is, would hide that."""
    score = {"where": "T", "task": "all", "items": 1, "low": 1, "high": 7}
    score["cells"] = ({"name": "ease", "mean": "4.5", "sd": "0"},)
    document = {"study": "made", "source": "Nobody", "task": ({"id": "all", "participants": 2},), "score": (score,)}
    lines = print_lines(printed_study.published(document))
    for line in lines:
        assert line.agrees or line.printed != line.recomputed
    (sd,) = [line for line in lines if line.quantity == "SD"]
    assert (sd.printed, sd.recomputed) == ("0", "0.7 to 3.5")


@pytest.mark.parametrize(("t", "printed", "shown"), [("9.00", "0.005", "<0.0001"), ("9.00", "0.000", "<0.001")])
def test_a_p_without_a_digit_left_is_a_bound(t: str, printed: str, shown: str) -> None:
    """P = 2.1e-6 at 11 df (scipy)."""
    test = {"task": "all", "of": "ease", "df": 11, "t": t, "p": printed, "null": "4"}
    document = {"study": "made", "source": "Nobody", "task": ({"id": "all", "participants": 12},)}
    lines = print_lines(printed_study.published({**document, "t": ({"where": "T", "tests": (test,)},)}))
    (line,) = [line for line in lines if line.quantity == "P"]
    assert line.recomputed == shown
