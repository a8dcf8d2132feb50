"""The audit of the two papers: what it must find, and that it finds nothing else."""

from __future__ import annotations

import csv
import json
import re
import tomllib
from collections.abc import Sequence
from decimal import ROUND_DOWN, ROUND_HALF_UP, Decimal
from pathlib import Path

import pytest
from syrupy.assertion import SnapshotAssertion

from palpate.analysis.audit.audit import UNDECIDED, Audit, audit
from palpate.analysis.audit.mistakes import Line
from palpate.analysis.audit.print_lines import print_lines
from palpate.experiment.errors import DatasetError
from tests.analysis import printed_study
from tests.analysis.datasets import MATERIALS, balanced, write_dataset
from tests.approved import Refuses


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
        assert line.reason.endswith(f" = {line.printed}")
        assert line.low is not None
        assert line.high is not None
        assert line.low - 0.005 <= reference.pop(line.subject) <= line.high + 0.005
    assert not reference


def test_task_2_takes_p_from_15_participants(okamoto: Audit, approved: SnapshotAssertion) -> None:
    lines = _lines(okamoto, task="real", quantity="P")
    assert [(line.subject, line.verdict) for line in lines] == [
        (material, "differs") for material in ("copy paper", "polypropylene", "aluminum foil", "typing paper")
    ]
    assert {line.reason for line in lines} == approved


def test_the_stars_of_task_2_are_corrected(okamoto: Audit, approved: SnapshotAssertion) -> None:
    stars = {line.subject.split(" -> ")[0]: line for line in _lines(okamoto, task="real", quantity="stars")}
    assert {material: (line.recomputed, line.verdict) for material, line in stars.items()} == {
        "copy paper": ("***", "agrees"),
        "polypropylene": ("***", "agrees"),
        "aluminum foil": ("**", "differs"),
        "typing paper": ("**", "differs"),
    }
    assert stars["aluminum foil"].reason == approved


def test_the_truncated_sds_of_table_1(okamoto: Audit) -> None:
    assert _unlike(_lines(okamoto, where="Table 1", quantity="SD")) == [
        ("aluminum foil -> copy paper", "0.048", "agrees if truncated"),
        ("polypropylene -> copy paper", "0.051", "agrees if truncated"),
    ]


def test_the_row_of_table_1_that_cannot_sum(okamoto: Audit, approved: SnapshotAssertion) -> None:
    (row,) = [line for line in _lines(okamoto, quantity="row") if line.verdict == "impossible"]
    assert (row.where, row.subject) == ("Table 1", "row of polypropylene")
    assert row.printed.endswith("= 0.973")
    assert row.recomputed == "145 to 148 of 150 trials"
    assert row.reason == approved


def test_the_truncated_sd_of_table_2_follows_from_its_row_and_the_d_printed_as_t(
    okamoto: Audit, approved: SnapshotAssertion
) -> None:
    (row,) = [line for line in _lines(okamoto, where="Table 2", quantity="row") if line.verdict != "agrees"]
    assert (row.subject, row.verdict) == ("row of polypropylene", "agrees if truncated")
    assert row.reason == approved


OKAMOTO = ("copy paper", "aluminum foil", "polypropylene", "typing paper")

MISTAKES = {
    *(("Section 5.2", "real", material, quantity) for material in OKAMOTO for quantity in ("t(9)", "P")),
    *(("Table 2", "real", f"{material} -> {material}", "stars") for material in ("aluminum foil", "typing paper")),
    ("Section 5.2", "both", "reliability of the two-way ANOVA", "ICC"),
}
"""What the issue and the notes on the reference say of Task 2 and of the ICC."""

TRUNCATED = {
    ("Table 1", "virtual", "aluminum foil -> copy paper", "SD"),
    ("Table 1", "virtual", "polypropylene -> copy paper", "SD"),
    ("Table 1", "virtual", "row of aluminum foil", "row"),
    ("Table 2", "real", "row of polypropylene", "row"),
}
"""The truncated SDs, by the notes on the reference, and the rows that they stand in, if those stand at all."""


def _named(lines: Sequence[Line], *verdicts: str) -> set[tuple[str, str, str, str]]:
    return {(line.where, line.task, line.subject, line.quantity) for line in lines if line.verdict in verdicts}


def _numbers(root: Path) -> tuple[int, int]:
    """How many numbers the file of the paper holds, counted in its TOML, and how many rows."""
    document = tomllib.loads((root / "analysis" / "published" / "okamoto2012.toml").read_text(encoding="utf-8"))
    cells = [cell for key in ("table", "text") for block in document[key] for cell in block["cells"]]
    single = sum(key in cell for cell in cells for key in ("mean", "sd", "stars"))
    tests = sum(3 for block in document["t"] for _ in block["tests"])
    ratios = sum(2 + len(block["df"]) for key in ("one_way", "two_way") for block in document[key])
    correct = [cell for block in document["table"] for cell in block["cells"] if cell["presented"] == cell["answered"]]
    unstarred = sum("stars" not in cell for cell in correct)
    rows = sum(len({cell["presented"] for cell in table["cells"]}) for table in document["table"])
    return single + unstarred + tests + ratios + len(document["icc"]) + len(document["claim"]), rows


def test_nothing_else_is_accused(okamoto: Audit, repository_root: Path) -> None:
    lines = okamoto.comparison.lines
    assert len(lines) == sum(_numbers(repository_root))
    assert _named(lines, "agrees if truncated") == TRUNCATED
    accused = _named(lines, "differs", "impossible", "cannot be decided")
    assert accused == {*MISTAKES, ("Table 1", "virtual", "row of polypropylene", "row")}
    assert _named(lines, "cannot be decided") == {one for one in MISTAKES if one[3] == "ICC"}


def test_every_printed_number_of_the_reference_has_a_row(okamoto: Audit, reference: Path) -> None:
    held = {(line.task, line.subject, line.printed) for line in okamoto.comparison.lines}
    for number, task in ((1, "virtual"), (2, "real")):
        with (reference / f"okamoto2012_table{number}.csv").open(newline="") as file:
            for row in csv.DictReader(file):
                subject = f"{row['presented']} -> {row['answered']}"
                for printed in filter(None, (row["mean"], row["sd"], row["stars"])):
                    assert (task, subject, printed) in held


@pytest.mark.parametrize(("table", "mixed"), [("Table 2", "51, 53, 56"), ("Table 3", "52")])
def test_the_tapping_percentages_fit_no_common_number_of_trials(
    wellman: Audit, reference: Path, table: str, mixed: str
) -> None:
    """Oracle: every count of every number of trials up to 7 x 120 / 15 = 56, rounded and truncated by the decimal
    library. None gives a whole table in one way; with some rounded and some truncated, those named do.
    """
    (file,) = reference.glob(f"wellman1995_table{table[-1]}_*.csv")
    with file.open(newline="") as rows:
        percentages = {row["percent_correct"] for row in csv.DictReader(rows)}
    fitting: dict[str, list[int]] = {"rounded": [], "truncated": [], "mixed": []}
    for trials in range(1, 57):
        shares = [Decimal(100 * count) / trials for count in range(trials + 1)]
        rounded = {f"{share.quantize(Decimal(1), rounding=ROUND_HALF_UP)}" for share in shares}
        truncated = {f"{share.quantize(Decimal(1), rounding=ROUND_DOWN)}" for share in shares}
        for name, printed in (("rounded", rounded), ("truncated", truncated), ("mixed", rounded | truncated)):
            fitting[name] += [trials] * (percentages <= printed)
    assert fitting == {"rounded": [], "truncated": [], "mixed": [int(trials) for trials in mixed.split(", ")]}
    (line,) = _lines(wellman, where=table, quantity="common number of trials")
    assert line.recomputed.startswith("none from 1 to 56")
    assert line.verdict == "fits no one rounding"
    assert line.reason.endswith(f": {mixed}")
    assert not line.agrees


def test_percentages_that_no_mix_of_ways_gives_are_impossible() -> None:
    """By hand: 1, 2 or 3 trials give no 43 %, not even cut off."""
    cells = ({"pair": ("1", "2"), "correct": "43%"}, {"pair": ("2", "3"), "correct": "50%"})
    block = {"where": "Here", "task": "x", "participants": 3, "trials": 2, "cells": cells}
    lines = print_lines(printed_study.published({"study": "any", "source": "Nobody", "choices": (block,)}))
    assert [line.verdict for line in lines if line.quantity == "common number of trials"] == ["impossible"]


def test_a_percentage_whose_denominator_is_not_printed_is_never_accused(wellman: Audit) -> None:
    lines = _lines(wellman, quantity="correct")
    assert len(lines) == 30
    assert {line.verdict for line in lines} == {"agrees", "cannot be decided"}


def test_the_dictionary_is_json(okamoto: Audit, repository_root: Path) -> None:
    document = json.loads(json.dumps(okamoto.as_dict(), allow_nan=False))
    assert (document["study"], document["against"]) == ("okamoto2012", "print")
    assert len(document["lines"]) == sum(_numbers(repository_root))
    assert set(document["lines"][0]) >= {"where", "printed", "recomputed", "low", "high", "verdict", "reason", "agrees"}


def test_a_block_in_print_is_held_against_its_device(wellman: Audit, okamoto: Audit) -> None:
    """100 N s/m at 175 mm/s are 17.5 N, and 2500 N/m at 2.5 kHz take half a newton second a metre more."""
    (told,) = wellman.blocks
    assert re.findall(r"\d[\d.]*(?= N\b)", told) == ["17.5", "3", "100.5"]
    assert okamoto.blocks == ()


def test_no_line_of_the_text_is_longer_than_a_terminal(okamoto: Audit, wellman: Audit) -> None:
    for found in (okamoto, wellman):
        assert max(map(len, found.text().split("\n"))) <= 80


def test_what_cannot_be_decided_is_not_said_to_disagree(okamoto: Audit) -> None:
    disagrees, _, undecided = okamoto.text().partition("Cannot be decided\n")
    assert "ICC = 0.97" in undecided
    differing = disagrees.partition("Does not agree as rounded\n")[2]
    assert differing
    assert UNDECIDED[0] not in differing


def test_a_dataset_is_held_against_its_paper(repository_root: Path) -> None:
    found = audit(str(repository_root / "participants" / "okamoto2012"))
    assert found.text().startswith("RECONSTRUCTION")
    assert "changed" in found.text()
    lines = found.comparison.lines
    assert len(lines) == _numbers(repository_root)[0]
    assert {one for line in lines if not line.agrees for one in _named([line], line.verdict)} == MISTAKES
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


def test_a_dataset_without_a_paper_says_what_to_do(tmp_path: Path, refuses: Refuses) -> None:
    root = write_dataset(tmp_path, {"1": {"virtual": balanced(1, 9, MATERIALS)}})
    with refuses(DatasetError):
        audit(str(root))


def test_the_result_comes_first(okamoto: Audit, approved: SnapshotAssertion) -> None:
    heading, rule, _, *rest = okamoto.text().splitlines()
    result = " ".join(rest[:2]).strip()
    assert set(rule) == {"="}
    assert [heading, result] == approved
