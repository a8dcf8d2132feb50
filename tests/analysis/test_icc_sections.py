"""Reliabilities as they are shown: who was left out of a matrix, and why a form has no value."""

from __future__ import annotations

from pathlib import Path

from analysis.dataset import read
from analysis.icc_sections import icc_section
from analysis.results import compute
from analysis.tables import Section
from tests.analysis.datasets import balanced, trials, write_dataset


def _section(root: Path, sessions: dict[str, dict[str, list[dict[str, object]]]]) -> Section:
    return icc_section(compute(read(write_dataset(root, sessions)), {}))


def test_participants_left_out_of_a_matrix_are_named_under_it(tmp_path: Path) -> None:
    """5 was never presented glass; 6 did one task alone."""
    sessions = {str(k): {"virtual": balanced(k), "real": balanced(k + 1)} for k in range(1, 5)}
    sessions["5"] = {"virtual": trials([("sand", "sand"), ("snow", "snow")]), "real": balanced(9)}
    sessions["6"] = {"virtual": balanced(3)}
    notes = [table.notes for table in _section(tmp_path, sessions).tables[:5]]
    in_virtual = ("Left out of virtual, having had no trial of a material: 5.",)
    in_both = ("Left out of every task together, having had no trial of a task or a material: 5, 6.",)
    assert notes == [in_virtual, in_virtual, (), (), in_both]


def test_many_are_counted_in_the_terminal_and_named_in_the_report(tmp_path: Path) -> None:
    sessions = {str(k): {"virtual": balanced(k)} for k in range(1, 5)}
    sessions |= {str(k): {"virtual": trials([("sand", "sand"), ("snow", "sand")])} for k in range(5, 19)}
    found = _section(tmp_path, sessions)
    ten = ", ".join(map(str, range(5, 15)))
    assert found.brief[0].notes[0].endswith(f": {ten} and 4 more, named in the report.")
    assert found.tables[0].notes[0].endswith(f": {ten}, 15, 16, 17, 18.")
