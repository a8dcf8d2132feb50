"""The first page: its sentences hold the numbers of the tables, and nothing is said to be found that is not."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from syrupy.assertion import SnapshotAssertion

from palpate.analysis.documents.tables import Section
from palpate.analysis.identification.results import Results, compute
from palpate.analysis.reading.dataset import read
from palpate.analysis.reading.study import Part, Study
from palpate.analysis.report import sections
from palpate.analysis.report.answers import answers_section
from palpate.analysis.report.found import found_section
from palpate.analysis.report.plan import done_of, standing
from palpate.experiment.protocol import files
from palpate.experiment.protocol.files import shipped
from tests.analysis.datasets import MATERIALS, balanced, trials, write_dataset


def _found(study: Study, results: Results) -> Section:
    return found_section(study, results, (), standing(study, None))


def test_what_was_found_follows_the_answers(repository_root: Path, approved: SnapshotAssertion) -> None:
    """Means and stars as in the paper's Tables 1 and 2; typing paper earns none in Task 1."""
    study = read(repository_root / "participants" / "okamoto2012")
    results = compute(study, {})
    answers, first, *_ = sections.sections(study, results, None, None)
    assert (answers.slug, first.slug) == ("answers", "found")
    virtual, real = first.paragraphs
    assert virtual == approved
    assert real == approved
    stars = [(row[0], row[1], row[-1]) for row in first.tables[0].rows if row[1] == "typing paper"]
    assert stars == [("virtual", "typing paper", ""), ("real", "typing paper", "**")]


def test_the_questions_of_the_protocol_stand_above_the_answers(
    repository_root: Path, approved: SnapshotAssertion
) -> None:
    study = read(repository_root / "participants" / "okamoto2012")
    part = Part("one", study.participants, ("virtual", "real"), files.load(shipped("okamoto2012.toml")))
    asked, *_ = _found(study, compute(replace(study, parts=(part,)), {})).paragraphs
    assert not asked.startswith("Asked")
    asked, *_ = _found(replace(study, parts=(part,)), compute(study, {})).paragraphs
    assert asked == approved


def test_where_nothing_is_found_nothing_is_said_to_be(tmp_path: Path, approved: SnapshotAssertion) -> None:
    wrong = trials([(shown, said) for shown in MATERIALS for said in MATERIALS])
    same = [trials([(shown, said) for shown in MATERIALS for _ in range(3)]) for said in MATERIALS]
    sessions = {str(k): {"virtual": rows} for k, rows in enumerate([wrong, wrong, wrong, *same])}
    study = read(write_dataset(tmp_path, sessions, tasks=("virtual",)))
    said, *_ = _found(study, compute(study, {})).paragraphs
    assert said == approved


def test_tasks_that_the_same_people_did_are_compared_as_pairs(tmp_path: Path, approved: SnapshotAssertion) -> None:
    sessions = {str(k): {"virtual": balanced(k), "real": balanced(k + 1, 6)} for k in range(1, 6)}
    study = read(write_dataset(tmp_path, sessions))
    *_, between = answers_section(study, compute(study, {}), standing(study, None), ()).asked
    assert between.answer == approved


def test_sign_flips_of_three_participants_are_said_to_be_unable_to_show_it(
    tmp_path: Path, approved: SnapshotAssertion
) -> None:
    """All above chance: P = 2 / 2^3."""
    sessions = {str(k): {"virtual": balanced(k, 8)} for k in range(3)}
    study = read(write_dataset(tmp_path, sessions, tasks=("virtual",)))
    said, *_ = _found(study, compute(study, {})).paragraphs
    assert said == approved


@pytest.mark.parametrize("people", [1, 2])
def test_the_interval_of_one_participant_is_that_of_the_trials(
    tmp_path: Path, people: int, approved: SnapshotAssertion
) -> None:
    sessions = {str(k): {"virtual": balanced(k, 8)} for k in range(people)}
    study = read(write_dataset(tmp_path, sessions, tasks=("virtual",)))
    results = compute(study, {})
    (note,) = _found(study, results).tables[0].notes
    assert note == approved
    assert answers_section(study, results, standing(study, None), ()).asked[0].lines == approved


def _right(material: str, count: int) -> list[tuple[str, str]]:
    """Twelve trials with a material, `count` of them right, the rest named as the next one."""
    other = MATERIALS[(MATERIALS.index(material) + 1) % len(MATERIALS)]
    return [(material, material)] * count + [(material, other)] * (12 - count)


def test_what_one_of_the_two_tests_shows_is_said_of_it_alone_and_stars_without_sign_flips_stand_in_brackets(
    tmp_path: Path,
    approved: SnapshotAssertion,
) -> None:
    """Above 4 of 12 by 4, 4, 4, 4, 4, 0: t(5) = 5, P = 0.004; sign flips, 4 of 2^6. By 1, 1, 1, 1, 1, 8: t(5) = 1.86,
    P = 0.12; sign flips, 2 of 2^6."""
    right = zip([8, 8, 8, 8, 8, 4], [5, 5, 5, 5, 5, 12], [4, 3, 5, 4, 3, 5], strict=True)
    sessions = {
        str(k): {"virtual": trials([*_right("glass", one), *_right("sand", two), *_right("snow", three)])}
        for k, (one, two, three) in enumerate(right)
    }
    study = read(write_dataset(tmp_path, sessions, tasks=("virtual",)))
    results = compute(study, {})
    found = _found(study, results)
    said, table = found.paragraphs[0], found.tables[0]
    assert said == approved
    assert "for sand (0.51" in said
    first = table.header.index("P")
    assert [row[first : first + 2] for row in table.rows[:2]] == [("0.004", "0.062"), ("0.122", "0.031")]
    assert [row[-1] for row in table.rows[:2]] == ["(**)", ""]
    (planned, *_) = files.load(shipped("okamoto2012.toml")).analysis
    told = done_of(results, planned)
    assert told == approved
    brackets = " Exact sign-flip tests do not confirm the stars in brackets."
    assert table.notes[0].endswith(brackets)
    for section in (sections.confusion_section(results), sections.tests_section(results)):
        shown = [table for table in section.brief or section.tables if "(**)" in str(table.rows)]
        assert len(shown) == 1
        assert brackets in " ".join(shown[0].notes)
    marks = [[one["stars"] for one in section.records if one.get("stars")] for section in (
        found, sections.confusion_section(results), sections.tests_section(results))]  # fmt: skip
    assert marks == [["(**)"]] * 3


def test_a_material_without_a_t_counts_in_holms_family_which_the_table_and_the_methods_say(
    tmp_path: Path, approved: SnapshotAssertion
) -> None:
    """Of three planned tests one has no variance: the smaller P is taken three times, the other one twice."""
    right = zip([8, 8, 8, 8, 8, 4], [5, 6, 5, 6, 5, 6], [12] * 6, strict=True)
    sessions = {
        str(k): {"virtual": trials([*_right("glass", one), *_right("sand", two), *_right("snow", three)])}
        for k, (one, two, three) in enumerate(right)
    }
    results = compute(read(write_dataset(tmp_path, sessions, tasks=("virtual",))), {})
    glass, sand, snow = results.tasks[0].tests
    assert snow.result.p is None
    assert snow.p_holm is None
    assert round(sand.p_holm or 0, 12) == round(3 * (sand.result.p or 1), 12)
    assert round(glass.p_holm or 0, 12) == round(2 * (glass.result.p or 1), 12)
    (table,) = sections.tests_section(results).tables
    assert table.notes == approved
    (said,) = (text for title, text in sections.methods() if title == "Holm's correction")
    assert said == approved


def test_where_sign_flips_are_not_defined_nothing_is_said_of_them(tmp_path: Path, approved: SnapshotAssertion) -> None:
    sessions = {str(k): {"virtual": balanced(k, 8)} for k in range(3)}
    study = read(write_dataset(tmp_path, sessions, tasks=("virtual",)))
    results = compute(study, {})
    task = results.tasks[0]
    tests = tuple(replace(test, flip=None, flip_holm=None, flip_least=None) for test in task.tests)
    results = replace(results, tasks=(replace(task, tests=tests),))
    said, *_ = _found(study, results).paragraphs
    assert said == approved
    (planned, *_) = files.load(shipped("okamoto2012.toml")).analysis
    assert done_of(results, planned) == approved


def test_at_the_ceiling_t_has_no_p_and_sign_flips_have_one(tmp_path: Path, approved: SnapshotAssertion) -> None:
    """Seven participants, all answers right: P = 2 / 2^7 = 0.0156."""
    right = trials([(material, material) for material in MATERIALS for _ in range(4)])
    study = read(write_dataset(tmp_path, {str(k): {"virtual": right} for k in range(7)}, tasks=("virtual",)))
    (said,) = _found(study, compute(study, {})).paragraphs
    assert "not shown" not in said
    assert said == approved


def test_one_participant_is_no_test(tmp_path: Path, approved: SnapshotAssertion) -> None:
    study = read(write_dataset(tmp_path, {"1": {"virtual": balanced(1)}}, tasks=("virtual",)))
    said, *_ = _found(study, compute(study, {})).paragraphs
    assert said == approved
    assert "Sign flips" not in said
    (planned, *_) = files.load(shipped("okamoto2012.toml")).analysis
    told = done_of(compute(study, {}), planned)
    assert told == approved


def test_every_number_of_the_sentences_has_a_row(repository_root: Path) -> None:
    """Means as in the paper's Tables 1 and 2."""
    study = read(repository_root / "participants" / "okamoto2012")
    section = _found(study, compute(study, {}))
    rows = {(row["quantity"], row.get("task"), row.get("of")): row for row in section.records}
    foil = rows["correct answer ratio", "virtual", "aluminum foil"]
    assert (round(float(str(foil["value"])), 2), foil["n"], foil["also_in"]) == (0.39, 15, "tests.csv")
