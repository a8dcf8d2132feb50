"""Planned tests of simulated studies: for each study the numbers that `analyse` finds in the same answers."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from pandas import DataFrame
from statsmodels.stats.multitest import multipletests
from syrupy.assertion import SnapshotAssertion

from palpate.analysis import published
from palpate.analysis.identification.confusion import Confusion
from palpate.analysis.identification.planned import planned_tests as analysed
from palpate.analysis.identification.results import Results, compute
from palpate.analysis.power import planned_tests, simulate
from palpate.analysis.power.choice_models import draw
from palpate.analysis.power.planned_tests import FLIPS, REPEATED, Question
from palpate.analysis.reading import dataset
from palpate.analysis.reading.study import Part, Study
from palpate.experiment.errors import PowerError
from palpate.experiment.protocol import files
from palpate.experiment.protocol.asked import Asked
from palpate.experiment.protocol.files import shipped
from palpate.experiment.protocol.models import PlannedTest, Protocol
from palpate.experiment.records.events import NO_ANSWER
from tests.analysis.datasets import trials, write_dataset
from tests.benchmarks import power as benchmark

MATERIALS = ("copy paper", "aluminum foil", "polypropylene", "typing paper")
STUDIES = 2
ICC_FORM = PlannedTest(test="ICC", tasks=("virtual", "real"), question="?", form="ICC(2,k)", alpha=0.01)


@pytest.fixture(scope="module")
def protocol() -> Protocol:
    shipped_protocol = files.load(shipped("okamoto2012.toml"))
    return shipped_protocol.model_copy(update={"analysis": (*shipped_protocol.analysis, ICC_FORM)})


def study(root: Path, counts: dict[str, np.ndarray], presented: Mapping[str, tuple[str, ...]] | None = None) -> Study:
    """The dataset of these answers, as `analyse` reads it from disk."""
    said = (*MATERIALS, NO_ANSWER)
    sessions: dict[str, dict[str, Sequence[Mapping[str, object]]]] = {}
    for task, cells in counts.items():
        for person in range(cells.shape[2]):
            answers = [
                (shown, said[j])
                for i, shown in enumerate(MATERIALS)
                for j in range(5)
                for _ in range(cells[i, j, person])
            ]
            sessions.setdefault(f"{person:02d}", {})[task] = trials(answers)
    return dataset.read(write_dataset(root, sessions, materials=MATERIALS, origin="REHEARSAL", presented=presented))


def expected(results: Results, question: Question) -> float | None:
    """P of one question, or the estimate where it asks for one."""
    subject = question.subject
    if question.test == "t against chance":
        task = results.task(question.tasks[0])
        assert task is not None
        if subject.endswith(FLIPS):
            flip = task.test(subject.removesuffix(FLIPS)).flip
            return flip.p if flip else None
        test = task.test(subject)
        return test.p_holm if question.adjusted else test.result.p
    if question.test == REPEATED:
        lines = results.beside.materials.get(question.tasks[0])
        return lines[0].p if lines else None
    if question.test == "one-way ANOVA":
        wanted = "most confused" if subject.startswith("most confused") else "published"
        pair = next((p for p in results.pairs if p.task == question.tasks[0] and wanted in p.chosen), None)
        return pair.anova.effects[0].p if pair is not None and pair.anova else None
    if question.test == "two-way ANOVA":
        effect, _, kinds = subject.partition(", type")
        kind_numbers = {"I": 0, "II": 1, "III": 2}
        found = [
            results.two_way[kind_numbers[kind.strip()]].effect(effect).p for kind in kinds.removeprefix("s").split(",")
        ]
        assert found == pytest.approx([found[0]] * len(found), rel=1e-10)
        return found[0]
    if question.alpha is None:
        assert results.components is not None
        return results.components.by_k[0][2]
    form, _, matrix = subject.partition(" of ")
    reliability = next(r for r in results.reliabilities if r.task == question.tasks[0] and matrix in r.matrix)
    return reliability.icc.form(form).p if reliability.icc else None


@pytest.mark.parametrize("participants", [2, 6, 15])
def test_every_number_is_that_of_analyse(tmp_path: Path, protocol: Protocol, participants: int) -> None:
    printed = published.load("okamoto2012")
    assert printed is not None
    design = planned_tests.design(protocol, printed.pairs())
    model = simulate.find("published", protocol)
    random = np.random.default_rng(participants)
    drawn = {
        task.id: draw(answers, trials=10, participants=size, studies=STUDIES, random=random)
        for task, answers, size in zip(design.tasks, model.tasks, design.sizes(participants), strict=True)
    }
    answers = planned_tests.answer(design, drawn)
    # t 4 + Holm 4 + sign flips 4 in two tasks, two pairs, four distinct effects, repeated measures in two tasks, one
    # coefficient, two matrices in two tasks.
    assert len(answers) == 24 + 2 + (3 if len(set(design.sizes(participants))) == 1 else 4) + 2 + 1 + 4
    for number in range(STUDIES):
        made = study(tmp_path / str(number), {task: cells[:, :, number] for task, cells in drawn.items()})
        results = compute(made, printed.pairs())
        for question, answer in answers.items():
            wanted = expected(results, question)
            values = answer.estimate if question.alpha is None else answer.p
            assert values is not None
            if wanted is None:
                assert math.isnan(values[number]), question
            else:
                assert values[number] == pytest.approx(wanted, rel=1e-10, abs=1e-10), question


def test_a_task_that_presents_some_of_the_materials_is_simulated_and_tested_as_it_is_analysed(
    tmp_path: Path, protocol: Protocol
) -> None:
    some = {"virtual": ("copy paper", "aluminum foil", "typing paper"), "real": ("aluminum foil", "typing paper")}
    tasks = tuple(task.model_copy(update={"materials": some[task.id]}) for task in protocol.tasks)
    study_of = protocol.model_copy(update={"tasks": tasks})
    printed = published.load("okamoto2012")
    assert printed is not None
    design = planned_tests.design(study_of, printed.pairs())
    assert design.places("virtual", "real") == [1, 3]
    for model in (chosen := simulate.find("published", study_of), chosen.control(study_of)):
        assert [answers.shares.sum(axis=1).round(9).tolist() for answers in model.tasks] == [[1, 1, 0, 1], [0, 1, 0, 1]]
        random = np.random.default_rng(3)
        drawn = {
            task.id: draw(answers, trials=10, participants=size, studies=1, random=random)
            for task, answers, size in zip(tasks, model.tasks, design.sizes(6), strict=True)
        }
        assert [cells.sum(axis=(1, 2))[:, 0].tolist() for cells in drawn.values()] == [[10, 10, 0, 10], [0, 10, 0, 10]]
        made = study(tmp_path / str(id(model)), {task: cells[:, :, 0] for task, cells in drawn.items()}, some)
        results = compute(made, printed.pairs())
        answered = planned_tests.answer(design, drawn)
        # t, Holm and sign flips of 3 and 2 materials.
        assert sum(question.test == "t against chance" for question in answered) == 15
        for question, answer in answered.items():
            wanted, values = expected(results, question), answer.estimate if question.alpha is None else answer.p
            assert values is not None
            if wanted is None:
                assert math.isnan(values[0]), question
            else:
                assert values[0] == pytest.approx(wanted, rel=1e-10, abs=1e-10), question


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("loop", [benchmark.ByName, benchmark.Least])
def test_every_p_is_that_of_the_loops_of_the_benchmark(protocol: Protocol, loop: type[benchmark.ByName]) -> None:
    """scipy, statsmodels and pingouin, who warn where nothing varies; there, and only there, palpate finds no P."""
    printed = published.load("okamoto2012")
    assert printed is not None
    design = planned_tests.design(protocol, printed.pairs())
    model = simulate.find("published", protocol)
    random = np.random.default_rng(7)
    compared = 0
    for _ in range(12):
        drawn = benchmark.one_study(design, model, random)
        mine = benchmark.ours(design, drawn)
        apart = benchmark.differences(benchmark.looped(design, drawn, loop(design), icc=True), mine)
        # t 4 + Holm 4 in two tasks, two pairs, four distinct effects, one coefficient in two tasks.
        assert apart.shape == (16 + 2 + 4 + 2,)
        assert np.nanmax(apart) < 1e-12
        correct = [counts[range(4), range(4)] for counts in drawn.values()]
        constant = np.concatenate([np.repeat([np.ptp(cells, axis=1) == 0], 2, axis=0).ravel() for cells in correct])
        assert np.array_equal(np.isnan(mine[:16]), constant)
        compared += int(np.isfinite(apart).sum())
    assert compared > 200


def test_tasks_keep_the_protocols_proportion(protocol: Protocol) -> None:
    design = planned_tests.design(protocol, {})
    assert [design.sizes(n) for n in (1, 2, 3, 15, 30, 1000)] == [
        (1, 1), (2, 1), (3, 2), (15, 10), (30, 20), (1000, 667),
    ]  # fmt: skip


def test_alpha_may_be_changed_for_all(protocol: Protocol) -> None:
    design = planned_tests.design(protocol, {}, alpha=0.2)
    assert {test.alpha for test in design.tests} == {0.2}
    assert {test.alpha for test in planned_tests.design(protocol, {}).tests} == {0.05, 0.01}


def test_a_form_nobody_knows_is_stated(approved: SnapshotAssertion) -> None:
    protocol = files.load(shipped("okamoto2012.toml"))
    plan = ICC_FORM.model_copy(update={"form": "the usual one"})
    design = planned_tests.design(protocol.model_copy(update={"analysis": (plan,)}), {})
    (sentence,) = planned_tests.otherwise(design, range(len(design.tests)))
    assert sentence == approved
    drawn = {task.id: np.ones((4, 5, 1, 3), dtype=np.int64) for task in design.tasks}
    assert planned_tests.answer(design, drawn) == {}


@pytest.mark.parametrize(("form", "name"), [("ICC(A,1), absolute agreement", "ICC(2,1)"), ("ICC(3,k)", "ICC(3,k)")])
def test_both_families_of_names_are_known(form: str, name: str, repository_root: Path) -> None:
    protocol = files.load(repository_root / "protocols" / "okamoto2012.toml")
    plan = ICC_FORM.model_copy(update={"form": form})
    design = planned_tests.design(protocol.model_copy(update={"analysis": (plan,)}), {})
    drawn = {task.id: np.random.default_rng(1).integers(0, 9, size=(4, 5, 2, 3)) for task in design.tasks}
    assert {question.subject.split(" of ")[0] for question in planned_tests.answer(design, drawn)} == {name}


def test_a_family_of_all_tasks_is_adjusted_as_one(protocol: Protocol) -> None:
    plan = protocol.analysis[0].model_copy(update={"correction": "materials and tasks"})
    design = planned_tests.design(protocol.model_copy(update={"analysis": (plan,)}), {})
    model = simulate.find("published", protocol)
    random = np.random.default_rng(3)
    drawn = {
        task.id: draw(answers, trials=10, participants=8, studies=3, random=random)
        for task, answers in zip(design.tasks, model.tasks, strict=True)
    }
    found = planned_tests.answer(design, drawn)
    plain, adjusted = (
        np.array([one.p for asked, one in found.items() if asked.adjusted == how and FLIPS not in asked.subject])
        for how in (False, True)
    )
    for study_p, study_adjusted in zip(plain.T, adjusted.T, strict=True):
        assert multipletests(study_p, method="holm")[1] == pytest.approx(study_adjusted)


OVER_PEOPLE: tuple[dict[str, object], ...] = (
    {"test": "sign flips against chance", "chance": 0.25, "correction": "materials and tasks"},
    {"test": "sign flips between tasks", "materials": ("aluminum foil", "typing paper")},
    {"test": "sign flips between materials", "correction": "materials"},
    {"test": "repeated measures"},
    {"test": "repeated measures", "tasks": ("real",)},
    {"test": "equivalence", "margin": 0.2},
    {"test": "equivalence", "tasks": ("virtual",), "margin": 0.3},
    {"test": "logit with participants"},
    {"test": "order of tasks"},
)


def test_planned_tests_over_participants_are_those_of_analyse(protocol: Protocol) -> None:
    tests = tuple(
        PlannedTest.model_validate({"tasks": ("virtual", "real"), "question": "?", **of}) for of in OVER_PEOPLE
    )
    plan = protocol.model_copy(update={"analysis": tests})
    design, model, random = (
        planned_tests.design(plan, {}),
        simulate.find("published", protocol),
        np.random.default_rng(3),
    )
    drawn = {
        task.id: draw(answers, trials=10, participants=7, studies=1, random=random)
        for task, answers in zip(design.tasks, model.tasks, strict=True)
    }
    answers = planned_tests.answer(design, drawn)
    who = tuple(map(str, range(7)))
    made = {task: Confusion(design.materials, who, np.moveaxis(of[:, :, 0], 2, 0)) for task, of in drawn.items()}
    part = Part("p", who, tuple(made), plan)
    study = Study("s", "s", "REHEARSAL", "", design.materials, (), who, {}, {}, DataFrame(), (), (), (part,), {})
    study = replace(study, first_tasks={person: design.tasks[int(person) % 2].id for person in who})
    found = [line for one in analysed(study, made, np.random.default_rng(1)) for line in one.lines]
    plain = [answer.p for question, answer in answers.items() if not question.adjusted and answer.p is not None]
    assert np.concatenate(plain) == pytest.approx([line.p for line in found], abs=1e-9)
    holm = [answer.p for question, answer in answers.items() if question.adjusted and answer.p is not None]
    assert np.concatenate(holm) == pytest.approx([line.p_holm for line in found if line.p_holm is not None], abs=1e-9)
    assert len(planned_tests.otherwise(design, range(len(design.tests)))) == 2


@pytest.mark.parametrize(("right", "defined"), [((8, 9), True), ((9, 10), False), ((1, 0), False)])
def test_tasks_near_0_or_1_have_no_equivalence_as_in_analyse(
    protocol: Protocol, right: tuple[int, int], defined: bool
) -> None:
    tasks = [task.model_copy(update={"materials": None, "repetitions": 10}) for task in protocol.tasks]
    plan = PlannedTest(test="equivalence", tasks=("virtual", "real"), margin=0.1, question="?")
    design = planned_tests.design(protocol.model_copy(update={"analysis": (plan,), "tasks": tuple(tasks)}), {})
    count = len(design.materials)
    drawn = {}
    for task, hits in zip(design.tasks, right, strict=True):
        of = np.zeros((count, count, 1, 6), dtype=np.int64)
        of[range(count), range(count)] = [hits + k % 2 * (1 if hits < 9 else -1) for k in range(6)]
        drawn[task.id] = of
    (found,) = planned_tests.answer(design, drawn).values()
    assert found.p is not None
    assert np.isfinite(found.p).tolist() == [defined]


def test_groups_of_three_are_not_simulated_as_two(protocol: Protocol) -> None:
    test = {"test": "difference of groups", "tasks": ("virtual",), "question": "?", "groups": "hand"}
    asked = {"id": "hand", "question": "?", "answer": "choice", "values": ("left", "right", "both"), "reason": "None."}
    three = {"analysis": (PlannedTest.model_validate(test),), "asked": Asked.model_validate({"people": (asked,)})}
    with pytest.raises(PowerError) as error:
        simulate.prepare(protocol.model_copy(update=three), "published")
    assert error.value.finding.allowed.startswith("two")


def test_what_the_control_has_of_equivalence_and_order(protocol: Protocol) -> None:
    """Tasks that differ by the margin: one-sided tests err in at most 5 %, and being first adds nothing."""
    tests = tuple(
        PlannedTest.model_validate({"tasks": ("virtual", "real"), "question": "?", **of})
        for of in (
            {"test": "equivalence", "margin": 0.3},
            {"test": "order of tasks"},
            {"test": "difference of groups", "groups": "diagnosis"},
        )
    )
    plan = protocol.model_copy(update={"analysis": tests})
    design, model = planned_tests.design(plan, {}), simulate.find("published", protocol)
    found = [
        {question.test: float((answer.p < 0.05).mean()) for question, answer in every.items() if answer.p is not None}
        for one in (model, model.control(plan))
        for every, _ in [one.answers(design, 24, 400, np.random.default_rng(1))]
    ]
    assert found[0]["order of tasks"] > 0.5
    assert found[0]["difference of groups"] > 3 * found[1]["difference of groups"]
    assert max(found[1].values()) < 0.08


def test_a_planned_test_of_which_nothing_is_simulated_is_named() -> None:
    protocol = files.load(shipped("harder.toml"))
    planned, model = simulate.prepare(protocol, "0.7,0.5")
    runner = partial(simulate.on_cores, jobs=1)
    found = simulate.run(protocol, planned, model, participants=(4,), studies=2, seed=1, target=0.8, runner=runner)
    assert {question.test for question in found.questions} == {"Bradley-Terry"}
    (note,) = found.notes
    assert "factors" in note
