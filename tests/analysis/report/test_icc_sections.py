"""Reliabilities as they are shown: who was left out of a matrix, and why a form has no value."""

from __future__ import annotations

from pathlib import Path

from syrupy.assertion import SnapshotAssertion

from palpate.analysis.documents.tables import Section
from palpate.analysis.identification.results import Results, compute
from palpate.analysis.reading.dataset import read
from palpate.analysis.report.plan import Standing
from palpate.analysis.report.sections import anova_section, icc_section
from tests.analysis.datasets import MATERIALS, balanced, trials, write_dataset


def _section(root: Path, sessions: dict[str, dict[str, list[dict[str, object]]]]) -> Section:
    return icc_section(_results(root, sessions))


def _results(root: Path, sessions: dict[str, dict[str, list[dict[str, object]]]]) -> Results:
    return compute(read(write_dataset(root, sessions)), {})


def test_participants_left_out_of_a_matrix_are_named_under_it(tmp_path: Path) -> None:
    """5 was never presented glass; 6 did one task alone."""
    sessions = {str(k): {"virtual": balanced(k), "real": balanced(k + 1)} for k in range(1, 5)}
    sessions["5"] = {"virtual": trials([("sand", "sand"), ("snow", "snow")]), "real": balanced(9)}
    sessions["6"] = {"virtual": balanced(3)}
    notes = [
        tuple(note for note in table.notes if "leaves out participants" in note)
        for table in _section(tmp_path, sessions).tables[:5]
    ]
    in_virtual = ("The matrix of virtual leaves out participants with no trials of a material: 5.",)
    said = "The matrix of all tasks together leaves out participants with no trials of a task or material: 5, 6."
    assert notes == [in_virtual, in_virtual, (), (), (said,)]


def test_many_are_counted_in_the_terminal_and_named_in_the_report(tmp_path: Path, approved: SnapshotAssertion) -> None:
    sessions = {str(k): {"virtual": balanced(k)} for k in range(1, 5)}
    sessions |= {str(k): {"virtual": trials([("sand", "sand"), ("snow", "sand")])} for k in range(5, 19)}
    found = _section(tmp_path, sessions)
    ten = ", ".join(map(str, range(5, 15)))
    assert found.brief[0].notes[0] == approved
    assert found.tables[0].notes[0].endswith(f": {ten}, 15, 16, 17, 18.")


def test_forms_without_a_test_or_a_value_say_why(tmp_path: Path, approved: SnapshotAssertion) -> None:
    """Everyone answers alike: agreement is perfect, and nothing is left to test it against."""
    alike = {str(k): {"virtual": balanced(1, 9)} for k in range(1, 4)}
    notes = _section(tmp_path / "alike", alike).tables[0].notes
    assert notes[0] == approved
    assert notes[1] == approved
    # Correct ratios 1/2, 1/2, 0; 0, 1/2, 1/2; 1/2, 0, 1/2: the materials' means are the same, so that MS targets is 0.
    right = [trials([(m, m if k != i else "sand" if m != "sand" else "snow") for i, m in enumerate(MATERIALS)]
                    + [(m, "sand" if m != "sand" else "snow") for m in MATERIALS]) for k in range(3)]  # fmt: skip
    section = _section(tmp_path / "level", {str(k): {"virtual": rows} for k, rows in enumerate(right)})
    wanted = "its denominator variance is estimated as zero or less, so it is not defined; nor is the interval."
    assert f"ICC(1,k), ICC(2,k), ICC(3,k): {wanted}" in section.tables[1].notes
    assert section.brief[0].notes == approved


def test_dashes_where_every_answer_is_right_have_their_reason(tmp_path: Path, approved: SnapshotAssertion) -> None:
    """Nothing varies, and nothing is taken for anything."""
    right = trials((material, material) for material in MATERIALS)
    results = _results(tmp_path, {str(k): {"virtual": right, "real": right} for k in range(1, 6)})
    components = icc_section(results).brief[-1]
    assert {row[1] for row in components.rows} == {"-"}
    assert components.notes == approved
    assert anova_section(results, (), Standing(frozenset(), frozenset(), frozenset())).paragraphs == approved


def test_a_variance_component_icc_that_cannot_be_is_said(tmp_path: Path, approved: SnapshotAssertion) -> None:
    results = _results(tmp_path, {"1": {"virtual": balanced(1), "real": balanced(2)}})
    assert results.components is None
    assert icc_section(results).paragraphs == approved
