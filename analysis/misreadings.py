"""Which printed SDs are something else: those whose reading as such leaves fewer printed numbers in conflict.

A standard error in the place of an SD makes a right t look like Cohen's d, P look wrong, and F with them. One mistake
that explains them all is simpler than one mistake each.
"""

from __future__ import annotations

from collections.abc import Sequence

from analysis.evidence import Misreading
from analysis.from_print import MISREADINGS, FromPrint
from analysis.published import PrintedCell, PrintedTable, Published
from analysis.verdicts import Line, Verdict
from analysis.walk import Walk

CONFLICTS: tuple[Verdict, ...] = ("differs", "impossible")


def read_print(published: Published) -> FromPrint:
    """The printed numbers, with those SDs read as something else that two or more of them speak for."""
    evidence = FromPrint(published)
    tested = {(test.task, test.material, test.material) for test in published.tests}
    for cell in published.tables():
        if cell.sd is not None and cell.key in tested:
            evidence = _better(published, evidence, cell)
    for table in published.confusions:
        evidence = _throughout(published, evidence, table, tested)
    return evidence


def _better(published: Published, evidence: FromPrint, cell: PrintedCell) -> FromPrint:
    """The reading of a cell that leaves the fewest conflicts; as printed, unless its tests all fit another."""
    own = _conflicts(published, evidence, cell)
    least = len(own) + _in_f(published, evidence, [cell])
    if not own or least < 2:
        return evidence
    for misreading in MISREADINGS:
        other = evidence.reading([cell], misreading)
        if other is None:
            continue
        own = _conflicts(published, other, cell)
        left = len(own) + _in_f(published, other, [cell])
        if left < least and all(line.quantity in ("mean", "SD") for line in own):
            evidence, least = other, left
    return evidence


def _throughout(
    published: Published, evidence: FromPrint, table: PrintedTable, tested: set[tuple[str, str, str]]
) -> FromPrint:
    """Cells without a test read as all those with one are, where that leaves fewer F in conflict."""
    kinds = {evidence.misreading(cell) for cell in table.cells if cell.key in tested and cell.sd is not None}
    rest = [cell for cell in table.cells if cell.key not in tested and cell.sd is not None and cell.sd.exact]
    misreading: Misreading | None = kinds.pop() if len(kinds) == 1 else None
    if misreading is None or not rest:
        return evidence
    other = evidence.reading(rest, misreading)
    before, after = (_in_f(published, one, rest) if one else 0 for one in (evidence, other))
    return other if other is not None and after < before else evidence


def _conflicts(published: Published, evidence: FromPrint, cell: PrintedCell) -> list[Line]:
    """The lines of the cell and its test that are in conflict."""
    lines = Walk(published, evidence, diagnose=False).about(cell)
    return [line for line in lines if line.verdict in CONFLICTS]


def _in_f(published: Published, evidence: FromPrint, cells: Sequence[PrintedCell]) -> int:
    walk = Walk(published, evidence, diagnose=False)
    return sum(line.verdict in CONFLICTS for line in walk.ratios_of(cells))
