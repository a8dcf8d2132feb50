"""The comparison with the paper as a section: one line a printed cell or test."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from itertools import groupby

from analysis.comparison import Comparison, Line
from analysis.tables import Section, Table

OWN = {"REHEARSAL": "rehearsed", "RECONSTRUCTION": "recomputed", "PARTICIPANT": "measured"}
"""Heading of the dataset's own numbers, by origin."""

ABOUT = {
    "REHEARSAL": "A rehearsal's answers are simulated. What follows says how close the simulation comes to the "
    "paper, and nothing about the paper's results.",
    "RECONSTRUCTION": "The dataset was searched for so that it agrees with the printed tables: agreement shows that "
    "the printed numbers can stand together, not that they are right. Means must agree to the printed digit, other "
    "numbers to one unit of the last one.",
    "PARTICIPANT": "New answers are expected to differ from the paper's. Means are called the same at the printed "
    "digit, other numbers within one unit of the last one.",
}

OTHERWISE = {
    "differs": "differ",
    "cannot be decided": "cannot be decided",
    "not in this dataset": "are not in this dataset",
}
"""How a sentence counts the verdicts that are no agreement."""

SAME = {"agrees": "same", "agrees within one unit": "same within one unit"}
"""Verdicts in words that fit answers of one's own."""


def comparison_section(origin: str, comparison: Comparison) -> Section:
    """Every printed number beside the one from this dataset.

    Args:
        origin: PARTICIPANT, REHEARSAL or RECONSTRUCTION; it decides the wording.
        comparison: see `analysis.comparison.compare`.
    """
    own, word = OWN[origin], "agree" if origin == "RECONSTRUCTION" else "are the same"
    tables = []
    for (where, task), lines in groupby(comparison.lines, key=lambda line: (line.where, line.task)):
        groups = [list(group) for _, group in groupby(lines, key=lambda line: line.subject)]
        rows = tuple(_row(group, origin) for group in groups)
        doubtful = [i for i, group in enumerate(groups) if not all(line.agrees for line in group)]
        marked = frozenset((i, 3) for i in doubtful if origin == "RECONSTRUCTION")
        header = ("quantity", "printed", own, "agrees?" if origin == "RECONSTRUCTION" else "same?")
        tables.append(Table(f"{where}, {task}", header, rows, left=frozenset(range(4)), marked=marked))
    records: list[Mapping[str, object]] = [
        {
            "where": line.where,
            "task": line.task,
            "subject": line.subject,
            "quantity": line.quantity,
            "printed": line.printed,
            own: line.recomputed,
            "value": line.value,
            "verdict": _verdict(line, origin),
            "reason": line.reason,
        }
        for line in comparison.lines
    ]
    correlations = " ".join(
        f"{c.task}: the {c.cells} cells of the printed table correlate with this dataset's at "
        + (f"r = {c.r:.4f}." if c.r is not None else f"no r: {c.statement}.")
        for c in comparison.correlations
    )
    paragraphs = (
        f"{comparison.source}. {ABOUT[origin]}",
        f"Of {len(comparison.lines)} printed numbers {comparison.agreeing} {word}{_rest(comparison)}.",
        correlations,
    )
    return Section("comparison", "Against the paper", paragraphs, tuple(tables), tuple(records))


def _rest(comparison: Comparison) -> str:
    others = Counter(line.verdict for line in comparison.lines if not line.agrees)
    return "".join(f", {count} {OTHERWISE[verdict]}" for verdict, count in others.items())


def _verdict(line: Line, origin: str) -> str:
    return line.verdict if origin == "RECONSTRUCTION" else SAME.get(line.verdict, line.verdict)


def _row(lines: Sequence[Line], origin: str) -> tuple[str, str, str, str]:
    if lines[0].quantity == "mean":
        printed = _cell([(line.quantity, line.printed) for line in lines])
        found = _cell([(line.quantity, line.recomputed) for line in lines])
    else:
        printed = ", ".join(f"{line.quantity} = {line.printed}" for line in lines)
        found = ", ".join(line.recomputed for line in lines)
    alike = all((line.verdict, line.reason) == (lines[0].verdict, lines[0].reason) for line in lines)
    remarks = [_remark(line, origin, alone=alike) for line in lines if line.verdict != "agrees"] or ["agrees"]
    if alike:
        remarks = [_remark(lines[0], origin, alone=True)]
    return lines[0].subject, printed, found, "; ".join(remarks)


def _remark(line: Line, origin: str, *, alone: bool) -> str:
    subject = "" if alone else f"{line.quantity} "
    verdict = _verdict(line, origin)
    if line.quantity == "stars":
        verdict = verdict.replace("differs", "differ")
    explained = line.reason and (origin == "RECONSTRUCTION" or line.verdict not in SAME)
    return f"{subject}{verdict}{f': {line.reason}' if explained else ''}"


def _cell(parts: Sequence[tuple[str, str]]) -> str:
    marks = {"mean": "", "SD": " ± ", "stars": ""}
    return "".join(f"{marks[quantity]}{text}" for quantity, text in parts if text != "none")
