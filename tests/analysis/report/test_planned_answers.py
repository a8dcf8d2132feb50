"""The first screen of planned tests over participants: a question, its one answer, and what weakens it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from syrupy.assertion import SnapshotAssertion

from palpate.analysis.designs.identification import DESIGN
from palpate.analysis.documents.tables import text
from palpate.analysis.identification.identify import ChoiceIntervals
from palpate.analysis.identification.maps import similarity_choice
from palpate.analysis.identification.planned import TESTS, Line, Planned
from palpate.analysis.identification.results import compute
from palpate.analysis.reading.dataset import read
from palpate.analysis.reading.study import Part
from palpate.analysis.report.answers import WORDS, answers_section, planned_sections, weak
from palpate.analysis.report.plan import PLANNED, done_of, standing
from palpate.analysis.report.prose import write_up
from palpate.analysis.report.sections import sections
from palpate.analysis.statistics.participants import Misfit
from palpate.experiment.protocol import files
from palpate.experiment.protocol.asked import Asked, Fact
from palpate.experiment.protocol.files import shipped
from palpate.experiment.protocol.models import PlannedTest
from palpate.experiment.records import software
from tests.analysis.datasets import MATERIALS, trials, write_dataset

BOTH = ("virtual", "real")
PLANS: tuple[dict[str, object], ...] = (
    {"test": "sign flips against chance", "chance": 1 / 3, "correction": "materials"},
    {"test": "sign flips between tasks", "question": "Do the tasks differ? By sign flips."},
    {"test": "sign flips between materials", "correction": "materials"},
    {"test": "repeated measures"},
    {"test": "logit with participants", "alpha": 0.01},
    {"test": "equivalence", "margin": 0.2, "alpha": 0.01},
    {"test": "equivalence", "margin": 0.2, "tasks": ("virtual",)},
    {"test": "order of tasks", "materials": ("glass", "snow")},
    {"test": "difference of groups", "groups": "diagnosis", "tasks": ("real",)},
)


def test_each_planned_question_has_one_answer(tmp_path: Path, approved: SnapshotAssertion) -> None:
    rng = np.random.default_rng(8)
    people = {
        str(k): {task: trials([(m, m if rng.random() < share else "sand") for m in ("glass", "sand", "snow") * 4])
                 for task, share in zip(BOTH, (0.6, 0.8), strict=True)}
        for k in range(8)
    }  # fmt: skip
    study = read(write_dataset(tmp_path, people))
    plans = tuple(PlannedTest.model_validate({"tasks": BOTH, "question": "And this?", **plan}) for plan in PLANS)
    fact = Fact(id="diagnosis", question="?", answer="choice", values=("patient", "control"), reason="-")
    changed = {"analysis": plans, "asked": Asked(people=(fact,))}
    own = files.load(shipped("okamoto2012.toml")).model_copy(update=changed)
    first = {str(k): BOTH[k % 2] for k in range(8)}
    study = replace(
        study,
        parts=(Part("p", study.participants, BOTH, own, anchors=("2026-05-01 0a-1", "2026-05-02 0b-2")),),
        first_tasks=first,
        facts={(str(k), "diagnosis"): fact.values[k > 2] for k in range(8)},
    )
    results = compute(study, {})
    table = np.full((3, 3), 4)
    badly = ChoiceIntervals(similarity_choice(table, MATERIALS), Misfit(20.0, 1, 40, 6e-5), None, None, 0, "")
    first_task, *others = results.identifications
    results = replace(results, identifications=(replace(first_task, choice=badly), *others))
    section = answers_section(study, results, standing(study, None), ())
    assert [one.standing for one in section.asked] == [PLANNED] * len(PLANS)
    assert text(section, 80) == approved
    assert text(planned_sections(results)[0], 150) == approved
    assert [done_of(results, plan) for plan in plans] == approved
    said = write_up(study, sections(study, results, None, None), 100)
    assert said.replace(software.this().version, "N") == approved
    assert [one["plan"]["test"] for one in DESIGN.numbers(results)["planned"]] == [plan["test"] for plan in PLANS]


def test_a_guesser_among_others_widens_the_interval_of_the_first_screen(
    tmp_path: Path, approved: SnapshotAssertion
) -> None:
    """Five are right in 11 or 12 of 12 with glass, the sixth in 3: the mean is 0.85."""
    people = {
        str(k): {"real": trials([("glass", "glass" if k or place < 3 else "sand") for place in range(12)])}
        for k in range(6)
    }
    study = read(write_dataset(tmp_path, people, tasks=("real",)))
    results = compute(study, {})
    assert [test.interval and test.interval.over for test in results.tasks[0].tests] == ["any population", None, None]
    assert text(answers_section(study, results, standing(study, None), ()), 80) == approved


def test_a_smaller_group_that_varies_more_weakens_its_answer() -> None:
    plan = PlannedTest.model_validate(
        {"test": "difference of groups", "groups": "sex", "tasks": ("a", "b"), "question": "?"}
    )
    lines = tuple(Line((task,), f"{task} less c", 9, 0.04, 0.1, loose=task == "b", shown=True) for task in "ab")
    (warned,) = weak(Planned(plan, lines, {}))
    assert "b less c in b" in warned
    assert "a less c" not in warned


def test_every_test_has_its_words() -> None:
    assert set(WORDS) == set(TESTS)
