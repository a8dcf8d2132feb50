"""The audit: what it must find in the two papers, and what it must never accuse."""

from __future__ import annotations

import json
import statistics
from decimal import ROUND_HALF_EVEN
from fractions import Fraction
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from analysis.audit import Audit, audit
from analysis.audit_lines import print_lines
from analysis.comparison import Comparison
from analysis.verdicts import Line
from experiment.errors import DatasetError, PublishedError
from tests.analysis import printed_study
from tests.analysis.datasets import MATERIALS, balanced, write_dataset


@pytest.fixture(scope="module")
def okamoto() -> Audit:
    return audit("okamoto2012")


@pytest.fixture(scope="module")
def wellman() -> Audit:
    return audit("wellman1995")


def _lines(found: Audit, **wanted: str) -> list[Line]:
    lines = found.comparison.lines
    return [line for line in lines if all(getattr(line, key) == value for key, value in wanted.items())]


def _unlike(lines: list[Line]) -> list[tuple[str, str, str]]:
    return [(line.subject, line.printed, line.verdict) for line in lines if line.verdict != "agrees"]


def test_task_2_prints_d_as_t(okamoto: Audit) -> None:
    """Oracle: the recomputed t of the reference lie in the intervals (README of the reference data)."""
    lines = _lines(okamoto, task="real", quantity="t(9)")
    reference = {"copy paper": 33.73, "polypropylene": 4.81, "aluminum foil": 3.77, "typing paper": 3.66}
    for line in lines:
        assert line.verdict == "differs"
        assert line.reason == f"what is printed as t is Cohen's d = {line.printed}"
        assert line.low is not None
        assert line.high is not None
        assert line.low - 0.005 <= reference.pop(line.subject) <= line.high + 0.005
    assert not reference


def test_task_2_takes_p_from_15_participants(okamoto: Audit) -> None:
    lines = _lines(okamoto, task="real", quantity="P")
    assert [(line.subject, line.verdict) for line in lines] == [
        (material, "differs") for material in ("copy paper", "polypropylene", "aluminum foil", "typing paper")
    ]
    assert {line.reason for line in lines} == {"it is the P of d * sqrt(15) at 14 df, where n is 10"}


def test_the_stars_of_task_2_are_corrected(okamoto: Audit) -> None:
    stars = {line.subject.split(" -> ")[0]: line for line in _lines(okamoto, task="real", quantity="stars")}
    assert {material: (line.recomputed, line.verdict) for material, line in stars.items()} == {
        "copy paper": ("***", "agrees"),
        "polypropylene": ("***", "agrees"),
        "aluminum foil": ("**", "differs"),
        "typing paper": ("**", "differs"),
    }
    assert stars["aluminum foil"].reason.startswith("they follow the printed P = 4.03e-4")


def test_the_truncated_sds_of_table_1(okamoto: Audit) -> None:
    assert _unlike(_lines(okamoto, where="Table 1", quantity="SD")) == [
        ("aluminum foil -> copy paper", "0.048", "agrees if truncated"),
        ("polypropylene -> copy paper", "0.051", "agrees if truncated"),
    ]


def test_the_row_of_table_1_that_cannot_sum(okamoto: Audit) -> None:
    (row,) = [line for line in _lines(okamoto, quantity="row") if line.verdict == "impossible"]
    assert (row.where, row.subject) == ("Table 1", "row of polypropylene")
    assert row.printed.endswith("= 0.973")
    assert row.recomputed == "145 to 148 of 150 trials"
    assert "cannot sum to 1; 3 trials without an answer would explain it" in row.reason


def test_the_truncated_sd_of_table_2_follows_from_its_row_and_the_d_printed_as_t(okamoto: Audit) -> None:
    (row,) = [line for line in _lines(okamoto, where="Table 2", quantity="row") if line.verdict != "agrees"]
    assert (row.subject, row.verdict) == ("row of polypropylene", "agrees if truncated")
    assert "-> typing paper is truncated" in row.reason


def test_nothing_else_is_accused(okamoto: Audit) -> None:
    counted = [line.verdict for line in okamoto.comparison.lines]
    assert len(counted) == 133
    assert {verdict: counted.count(verdict) for verdict in set(counted)} == {
        "agrees": 117,
        "agrees if truncated": 4,
        "differs": 10,
        "impossible": 1,
        "cannot be decided": 1,
    }
    assert [line.quantity for line in okamoto.comparison.lines if line.verdict == "cannot be decided"] == ["ICC"]


def test_every_printed_number_of_the_reference_has_a_row(okamoto: Audit, shared: Path) -> None:
    import csv

    held = {(line.task, line.subject, line.printed) for line in okamoto.comparison.lines}
    for number, task in ((1, "virtual"), (2, "real")):
        with (shared / "reference" / f"okamoto2012_table{number}.csv").open(newline="") as file:
            for row in csv.DictReader(file):
                subject = f"{row['presented']} -> {row['answered']}"
                for printed in filter(None, (row["mean"], row["sd"], row["stars"])):
                    assert (task, subject, printed) in held


@pytest.mark.parametrize(("table", "least"), [("Table 2", "80"), ("Table 3", "80")])
def test_the_tapping_percentages_fit_no_common_number_of_trials(wellman: Audit, table: str, least: str) -> None:
    """Oracle: 7 x 120 / 15 = 56 is the most; trying every N by hand gives 80 as the first that rounds to all."""
    (line,) = _lines(wellman, where=table, quantity="common number of trials")
    assert (line.recomputed, line.verdict) == ("none from 1 to 56", "impossible")
    assert f"rounded, {least} at least ({int(least) * 15} trials)" in line.reason


def test_a_percentage_whose_denominator_is_not_printed_is_never_accused(wellman: Audit) -> None:
    lines = _lines(wellman, quantity="correct")
    assert len(lines) == 30
    assert {line.verdict for line in lines} == {"agrees", "cannot be decided"}


@settings(deadline=None, max_examples=40)
@given(
    st.integers(0, 2**32),
    st.integers(2, 9),
    st.integers(2, 9),
    st.integers(1, 8),
    st.integers(2, 3),
    st.sampled_from((*printed_study.WAYS, printed_study.MIXED)),
    st.booleans(),
)
def test_no_false_accusation(
    seed: int, first: int, second: int, trials: int, digits: int, way: str, steps: bool
) -> None:
    """The invariant: whatever the counts, however they were rounded or cut off, no line differs or is impossible."""
    counts = printed_study.draw(seed, {"one": first, "two": second}, trials)
    document = printed_study.printed(counts, trials, digits, way, steps=steps)
    lines = print_lines(printed_study.published(document))
    assert [line for line in lines if line.verdict in ("differs", "impossible")] == []
    if steps:
        assert [line for line in lines if not line.agrees] == []


@settings(deadline=None, max_examples=60)
@given(
    st.lists(st.integers(0, 18), min_size=3, max_size=30).filter(lambda counts: len(set(counts)) > 1),
    st.integers(1, 3),
    st.integers(1, 3),
    st.sampled_from((*printed_study.WAYS, printed_study.MIXED)),
    st.booleans(),
)
def test_no_false_accusation_of_scores(counts: list[int], items: int, digits: int, way: str, ends: bool) -> None:
    """The same for means of `items` whole numbers on a scale from 1 to 7, whether its ends are stated or not."""
    values = [Fraction(items + count % (6 * items + 1), items) for count in counts]
    if len(set(values)) == 1:
        return
    n, sd = len(values), statistics.stdev(map(float, values))
    t = (float(statistics.mean(values)) - 4) / (sd / n**0.5)
    text = {"name": "ease", "mean": printed_study.text(statistics.mean(values), digits, way)}
    text["sd"] = printed_study.text(Fraction(sd), digits, way)
    scale = {"low": 1, "high": 7} if ends else {}
    test = {"task": "all", "of": "ease", "df": n - 1, "t": printed_study.text(Fraction(t), 2, way), "null": "4"}
    test["p"] = printed_study.scientific(float(2 * stats.t.sf(abs(t), n - 1)), way)
    document = {
        "study": "made",
        "source": "Nobody",
        "task": ({"id": "all", "participants": n},),
        "score": ({"where": "Here", "task": "all", "items": items, **scale, "cells": (text,)},),
        "t": ({"where": "Here", "tests": (test,)},),
    }
    lines = print_lines(printed_study.published(document))
    assert len(lines) == 5
    assert [line for line in lines if not line.agrees] == []


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
    assert line.reason.startswith("what is printed as t is Cohen's d")
    assert _accused(document, "P") == _accused(document, "stars") == []


@pytest.mark.parametrize("index", range(6))
@pytest.mark.parametrize(
    ("mistake", "expected"),
    [("tail", "it is one-tailed"), ("size", "it is the P of d * sqrt({other}) at"), ("df", "it was taken at {off} df")],
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


def test_a_wrong_df_is_named(made: dict[str, Any]) -> None:
    document = printed_study.changed(made, lambda test: test.update(df=12))
    (line,) = _accused(document, "df")
    assert (line.recomputed, line.reason) == ("11", "it is the number of participants")


SCORES = """
study = "scores"
source = "Somebody"

[[task]]
id = "all"
participants = 28

[[score]]
where = "Table 1"
task = "all"
items = 1
cells = [
  { name = "ease", mean = "5.19", sd = "1.60" },
  { name = "joy", mean = "5.21", sd = "1.60" },
]

[[t]]
where = "Text"
tests = [
  { task = "all", of = "joy", df = 27, t = "4.03", p = "<0.001", null = "4" },
  { task = "all", of = "fear", df = 27, t = "2.05", p = "0.02", null = "4" },
]

[[anova]]
where = "Table 2"
lines = [
  { name = "groups", ss = "20.0", df = 2, ms = "10.0", f = "5.00", p = "0.026" },
  { name = "error", ss = "24.0", df = 12, ms = "2.4" },
]
"""


@pytest.fixture
def scores(tmp_path: Path) -> Path:
    file = tmp_path / "scores.toml"
    file.write_text(SCORES, encoding="utf-8")
    return file


def test_scores_tests_and_anova_tables_of_any_study(scores: Path) -> None:
    """By hand: 5.19 of 28 is the opening example of Brown and Heathers 2017. 5.21 is 146 / 28, so that 1.60 leaves the
    sum of squares 830 alone: variance (830 - 146^2 / 28) / 27 = 2.545, t = (146 / 28 - 4) sqrt(28 / 2.545) = 4.03.
    24 / 12 is 2, not 2.4, and 10 / 2.4 is 4.2.
    """
    found = audit(str(scores))
    verdicts = {(line.subject, line.quantity): line.verdict for line in found.comparison.lines}
    assert verdicts == {
        ("ease", "mean"): "impossible",
        ("ease", "SD"): "cannot be decided",
        ("joy", "mean"): "agrees",
        ("joy", "SD"): "agrees",
        ("joy", "t(27)"): "agrees",
        ("joy", "P"): "agrees",
        ("joy", "df"): "agrees",
        ("fear", "t(27)"): "cannot be decided",
        ("fear", "P"): "differs",
        ("fear", "df"): "agrees",
        ("groups", "MS"): "agrees",
        ("groups", "F"): "differs",
        ("groups", "P"): "agrees",
        ("error", "MS"): "differs",
    }


def test_p_of_a_lone_t_is_held_against_it(scores: Path) -> None:
    (line,) = [one for one in audit(str(scores)).comparison.lines if (one.subject, one.quantity) == ("fear", "P")]
    # 2.05 stands for all from 2.045, rounded, to below 2.06, truncated.
    assert line.low == pytest.approx(2 * stats.t.sf(2.06, 27), rel=1e-6)
    assert line.high == pytest.approx(2 * stats.t.sf(2.045, 27), rel=1e-6)
    assert line.reason == "it is one-tailed"


def test_the_dictionary_is_json(okamoto: Audit) -> None:
    document = json.loads(json.dumps(okamoto.as_dict(), allow_nan=False))
    assert (document["study"], document["against"], len(document["lines"])) == ("okamoto2012", "print", 133)
    assert set(document["lines"][0]) >= {"where", "printed", "recomputed", "low", "high", "verdict", "reason", "agrees"}


def test_no_line_of_the_text_is_longer_than_a_terminal(okamoto: Audit, wellman: Audit) -> None:
    for found in (okamoto, wellman):
        assert max(map(len, found.text().split("\n"))) <= 100


def test_a_dataset_is_held_against_its_paper(repository_root: Path) -> None:
    found = audit(str(repository_root / "participants" / "okamoto2012"))
    assert found.text().startswith("RECONSTRUCTION")
    counted = [line.verdict for line in found.comparison.lines]
    assert (len(counted), sum(line.agrees for line in found.comparison.lines)) == (125, 114)
    assert (counted.count("differs"), counted.count("cannot be decided")) == (10, 1)
    assert found.as_dict()["against"] == "dataset"


def test_a_dataset_is_held_against_any_file(tmp_path: Path) -> None:
    root = write_dataset(tmp_path / "data", {str(k): {"virtual": balanced(k, 9, MATERIALS)} for k in range(1, 4)})
    paper = tmp_path / "paper.toml"
    paper.write_text(
        'study = "lab"\nsource = "We"\n[[task]]\nid = "virtual"\nparticipants = 3\n[[table]]\nwhere = "Table 1"\n'
        'task = "virtual"\ncomplete = false\ncells = [{ presented = "glass", answered = "glass", mean = "2.00" }]\n'
    )
    (line,) = audit(str(root), paper).comparison.lines
    assert (line.verdict, line.reason) == ("differs", "")


@pytest.mark.parametrize(
    ("target", "message"),
    [
        ("okamoto1999", "got no study, file or folder; allowed: okamoto2012, wellman1995, or a path"),
        ("nowhere.toml", "no such file"),
    ],
)
def test_what_cannot_be_audited_is_refused(target: str, message: str) -> None:
    with pytest.raises(PublishedError, match=message):
        audit(target)


def test_a_file_is_refused_with_every_problem_at_once(scores: Path) -> None:
    text = scores.read_text(encoding="utf-8")
    changes = [('"5.19"', "5.19"), ('task = "all"', 'task = "a"'), ('null = "4"', 'nulll = "4"'), ('"1.60"', '"-1"')]
    for old, new in changes:
        text = text.replace(old, new, 1)
    scores.write_text(text, encoding="utf-8")
    with pytest.raises(PublishedError) as caught:
        audit(str(scores))
    for problem in (
        "mean: got 5.19; allowed: a number as printed, in quotes",
        "score[0].task: got 'a'; allowed: one of: all",
        "no such key; did you mean 'null'?",
        "sd: got '-1'; allowed: a number as printed, not negative",
        "null: got nothing; allowed: a number, where the file states no chance",
    ):
        assert problem in str(caught.value)


def test_stars_need_their_levels(scores: Path) -> None:
    text = scores.read_text(encoding="utf-8").replace('sd = "1.60" }', 'sd = "1.60", stars = "*" }', 1)
    scores.write_text(text, encoding="utf-8")
    with pytest.raises(PublishedError, match="levels: got nothing; allowed: the P below which"):
        audit(str(scores))


def test_a_dataset_without_a_paper_says_what_to_do(tmp_path: Path) -> None:
    root = write_dataset(tmp_path, {"1": {"virtual": balanced(1, 9, MATERIALS)}})
    with pytest.raises(DatasetError, match="give the file to --against"):
        audit(str(root))


def test_against_is_for_datasets(scores: Path) -> None:
    with pytest.raises(PublishedError, match="is no dataset"):
        audit("okamoto2012", scores)


NUMBERS = st.from_regex(r"(0|[0-9]{1,2})(\.[0-9]{1,3})?(e-[0-9])?%?", fullmatch=True)
SIGNED = st.one_of(NUMBERS, NUMBERS.map(lambda text: f"-{text}"))
PROBABILITIES = st.one_of(NUMBERS, NUMBERS.map(lambda text: f"<{text}"))
NAMES = st.sampled_from(["a", "b", "c"])
DFS = st.integers(1, 60)
PAIRS = st.tuples(DFS, DFS)


def _some(strategy: st.SearchStrategy[Any], most: int = 2) -> st.SearchStrategy[Any]:
    return st.lists(strategy, min_size=1, max_size=most).map(tuple)


def _table(**fields: st.SearchStrategy[Any]) -> st.SearchStrategy[dict[str, Any]]:
    return st.fixed_dictionaries({"where": st.just("Here"), **fields})


CELL = st.fixed_dictionaries(
    {"presented": NAMES, "answered": NAMES, "mean": SIGNED}, optional={"sd": NUMBERS, "stars": st.just("*")}
)
SCORE = st.fixed_dictionaries({"name": NAMES, "mean": SIGNED}, optional={"sd": NUMBERS})
TEST = {"task": st.just("one"), "of": NAMES, "df": DFS, "t": SIGNED}
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
        "table": _some(_table(task=st.just("one"), complete=st.booleans(), cells=_some(CELL, 5)), 1),
        "score": _some(_table(task=st.just("one"), cells=_some(SCORE), items=st.integers(1, 2)), 1),
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


@settings(deadline=None, max_examples=25)
@given(DOCUMENTS)
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
