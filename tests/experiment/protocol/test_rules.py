"""Rules between fields, each broken alone; a model built without a file keeps them as well."""

from __future__ import annotations

from typing import Any

import pytest
from pydantic import ValidationError

from palpate.experiment.protocol.files import ProtocolFile
from palpate.experiment.protocol.kinds.footstep import Synthesis
from palpate.experiment.protocol.models import (
    ExclusionRule,
    Familiarisation,
    Order,
    PlannedTest,
    Step,
)
from palpate.experiment.settings import load
from tests.experiment.protocol.asking import asked
from tests.experiment.protocol.small import changed, document

SLOW = {"id": "slow", "when": "speed-below", "limit": 30, "action": "exclude-trial", "reason": "x"}
FAST = {"id": "fast", "when": "speed-above", "limit": 30, "action": "exclude-trial", "reason": "x"}
FEW = {"id": "few", "when": "answers-below", "limit": 4, "action": "exclude-participant", "reason": "x"}
GONE = {"id": "gone", "when": "withdrawn", "action": "exclude-participant", "reason": "x"}
UNPLAYED = {"id": "unplayed", "when": "undelivered", "action": "repeat-trial", "reason": "x"}
LOST = {"id": "lost", "when": "frames-lost", "limit": 0, "action": "repeat-trial", "reason": "x"}


def with_rules(*rules: dict[str, Any]) -> dict[str, Any]:
    return {**document(), "exclusion": rules}


def with_tasks(count: int) -> dict[str, Any]:
    study = document()
    tasks = tuple({**study["tasks"][0], "id": name} for name in ("one", "two", "c", "d", "e", "f", "g")[:count])
    return {**study, "tasks": tasks}


NEWEST = {**document(), "format": 7}
T = {"test": "t against chance", "tasks": ("one",), "chance": 0.5, "question": "?"}
PAIRED = {"test": "one-way ANOVA", "tasks": ("one",), "question": "?"}
SAME = {"test": "equivalence", "margin": 0.1, "question": "?"}


def presenting(*materials: object, other: tuple[str, ...] = (), analysis: dict[str, Any] = T) -> dict[str, Any]:
    """The small protocol, whose task `one` is not of an order `max-run` and presents these, and `two` the `other`."""
    study = changed(document(), ("tasks", 0, "order"), {"kind": "full-random"})
    study = changed(study, ("tasks", 0, "materials"), materials)
    if other:
        study = changed(study, ("tasks", 1, "materials"), other)
    return {**study, "analysis": (analysis,)}


BROKEN = [
    (
        changed(NEWEST, ("tasks", 1, "pictures"), tuple({"file": "foot.png", "sha256": 64 * one} for one in "ab")),
        "tasks[1].pictures[1].sha256",
        "the same value everywhere",
    ),
    *(
        (
            presenting(*wrong),
            "tasks[0].materials",
            "some of the protocol's materials, each once, in the protocol's order: felt, cork",
        )
        for wrong in (("tin",), ("felt", "tin"), ("cork", "felt"), ("cork", "cork"))
    ),
    (
        changed(presenting("cork"), ("tasks", 0, "order"), {"kind": "max-run", "max_run": 9}),
        "tasks[0].order.kind",
        "one of: full-random, blocked-random, for a single material",
    ),
    (
        {**presenting("cork"), "exclusion": ({**FEW, "limit": 4},)},
        "exclusion[0].limit",
        "at most 3, the trials of the shortest task",
    ),
    (
        presenting("cork", analysis={"test": "one-way ANOVA", "tasks": ("one",), "question": "?"}),
        "analysis[0].tasks",
        "tasks that each present at least 2 materials",
    ),
    *(
        (presenting("felt", "cork", analysis={**PAIRED, "materials": pair}), "analysis[0].materials[1]", allowed)
        for pair, allowed in (
            (("felt", "tin"), "a material that its tasks present, one of: felt, cork"),
            (("felt", "felt"), "another material"),
        )
    ),
    (
        changed(document(), ("analysis", 0, "materials"), ("felt", "cork")),
        "analysis[0].materials",
        "no value: only 'one-way ANOVA', 'equivalence', 'sign flips against chance',",
    ),
    (
        presenting("cork", analysis={"test": "two-way ANOVA", "tasks": ("one", "two"), "question": "?"}),
        "analysis[0].tasks",
        "at least 2 materials that the tasks share",
    ),
    (
        presenting("cork", analysis={"test": "ICC", "tasks": ("one",), "form": "ICC(2,1)", "question": "?"}),
        "analysis[0].tasks",
        "at least 2 materials that the tasks share",
    ),
    (
        presenting("cork", other=("felt",), analysis={**SAME, "tasks": ("one", "two")}),
        "analysis[0].tasks",
        "at least 1 materials that the tasks share",
    ),
    (
        presenting("cork", analysis={**SAME, "tasks": ("one",)}),
        "analysis[0].tasks",
        "at least 2 materials that the tasks share",
    ),
    (with_rules({**FEW, "limit": 5}), "exclusion[0].limit", "at most 4, the trials of the shortest task"),
    (with_rules(SLOW, FAST), "exclusion[1].limit", "greater than the limit of the rule 'speed-below'"),
    (with_rules({**GONE, "limit": 1}), "exclusion[0].limit", "no value: 'withdrawn' needs no limit"),
    (with_rules({**LOST, "action": "exclude-participant"}), "exclusion[0].action", "one of: repeat-trial, exclude-tri"),
    (with_rules({**UNPLAYED, "limit": 1}), "exclusion[0].limit", "no value: 'undelivered' needs no limit"),
    (
        with_rules({**UNPLAYED, "action": "exclude-participant"}),
        "exclusion[0].action",
        "'undelivered' is about a trial",
    ),
    (changed(document(), ("materials", 0, "key"), "+"), "materials[0].key", "any key except + and -, which set the m"),
    (with_rules({**FEW, "action": "repeat-trial"}), "exclusion[0].action", "'answers-below' is about a participant"),
    (changed(document(), ("analysis", 1, "margin"), 0.1), "analysis[1].margin", "only 'equivalence' has this key"),
    (
        changed(document(), ("analysis", 1, "correction"), "materials"),
        "analysis[1].correction",
        "only 't against chance'",
    ),
    (with_tasks(7), "task_order.kind", "fixed, or at most 6 tasks"),
    (changed(document(), ("study", "participants"), 8), "study.participants", "6, the number in the largest task"),
    (changed(document(), ("tasks", 1, "order", "max_run"), 2), "tasks[1].order.max_run", "only kind 'max-run' has"),
    *(
        (changed(document(), ("materials", 1, "id"), name), "materials[1].id", "a unique name: materials[0].id already")
        for name in ("F E L T", "Fe lt")
    ),
    *(
        (
            changed(document(), ("materials", 1, "id"), name),
            "materials[1].id",
            "materials[0].id is 'felt', which looks",
        )
        for name in ("fe1t", "FeIt", "f\u00e9lt")
    ),
    (
        changed(
            changed(document(), ("materials", 0, "id"), "cocoa"),
            ("materials", 1, "id"),
            "\u0441\u043e\u0441\u043e\u0430",
        ),
        "materials[1].id",
        "a unique name: materials[0].id already has this value",
    ),
    (
        changed(changed(document(), ("materials", 0, "spoken"), ("cloth",)), ("materials", 1, "spoken"), ("Felt",)),
        "materials[1].spoken[0]",
        "a unique phrase: materials[0].id already has this name",
    ),
    *(
        (changed(document(), ("materials", 0, "id"), name), "materials[0].id", f"any name except '{name}'")
        for name in ("n/a", "NA", "NaN", "null")
    ),
]
KEPT = [
    document(),
    presenting("cork", analysis=T),
    presenting("felt", "cork", other=("cork",)),
    presenting("felt", "cork", other=("cork",), analysis={**SAME, "tasks": ("one", "two")}),
    presenting("felt", "cork", analysis={**SAME, "tasks": ("two",)}),
    with_rules(FEW, GONE, LOST, SLOW, {**FAST, "limit": 31}, UNPLAYED),
    with_rules({**UNPLAYED, "action": "exclude-trial"}),
    with_tasks(6),
    changed(with_tasks(7), ("task_order", "kind"), "fixed"),
    changed(document(), ("tasks", 0, "repetitions"), 200),
]


@pytest.mark.parametrize(("study", "path", "allowed"), BROKEN, ids=[case[1] for case in BROKEN])
def test_a_broken_rule_is_the_one_problem(study: dict[str, Any], path: str, allowed: str) -> None:
    (problem,) = load.find(ProtocolFile, study, {})
    assert problem.field == path
    assert allowed in problem.allowed


@pytest.mark.parametrize(("study", "path", "allowed"), BROKEN, ids=[case[1] for case in BROKEN])
def test_a_protocol_made_without_a_file_keeps_the_rules(study: dict[str, Any], path: str, allowed: str) -> None:
    with pytest.raises(ValidationError) as caught:
        ProtocolFile.model_validate(study)
    assert allowed in str(caught.value)


@pytest.mark.parametrize("study", KEPT)
def test_what_is_just_within_the_rules_is_accepted(study: dict[str, Any]) -> None:
    assert load.find(ProtocolFile, study, {}) == ()
    ProtocolFile.model_validate(study)


@pytest.mark.parametrize(
    ("build", "match"),
    [
        (
            lambda: Step(gate_top_mm=10, gate_bottom_mm=20, contact_mm=0),
            r"gate_bottom_mm: .*less than gate_top_mm \(10",
        ),
        (lambda: Order(kind="max-run"), "max_run: .*kind 'max-run' needs it"),
        (lambda: Familiarisation(min_s=3, max_s=2, instruction="x"), r"max_s: .*at least min_s \(3"),
        (
            lambda: Synthesis(rate_hz=5000, samples=10, takes=1, speeds_mm_s=(50, 50)),
            r"speeds_mm_s\[1\]: .*greater than",
        ),
        (lambda: PlannedTest(test="ICC", tasks=("one",), question="x"), "form: .*'ICC' needs it"),
        (lambda: ExclusionRule(id="x", when="frames-lost", action="repeat-trial", reason="x"), "limit: .*needs it"),
    ],
)
def test_a_part_made_alone_keeps_its_own_rules(build: Any, match: str) -> None:
    with pytest.raises(ValidationError, match=match):
        build()


def test_a_test_of_two_materials_says_so() -> None:
    (problem,) = load.find(ProtocolFile, presenting("felt", "cork", analysis={**PAIRED, "materials": ("felt",)}), {})
    assert (problem.field, problem.allowed.partition(",")[0]) == ("analysis[0].materials", "2 materials")


OFFERED: list[dict[str, Any]] = [
    {"test": "sign flips against chance", "tasks": ("one",), "chance": 0.5, "correction": "materials"},
    {"test": "sign flips between tasks", "tasks": ("one", "two"), "correction": "tasks"},
    {"test": "sign flips between materials", "tasks": ("one",), "materials": ("felt", "cork")},
    {"test": "repeated measures", "tasks": ("one", "two")},
    {"test": "logit with participants", "tasks": ("one",), "alpha": 0.01},
    {"test": "equivalence", "tasks": ("one", "two"), "margin": 0.1, "materials": ("felt",)},
    {"test": "order of tasks", "tasks": ("one", "two")},
]


def _planning(test: dict[str, Any], number: int = 6) -> dict[str, Any]:
    study = changed(document(), ("task_order", "kind"), "counterbalanced")
    return {**study, "format": number, "analysis": ({"question": "?", **test},)}


@pytest.mark.parametrize("test", OFFERED, ids=[test["test"] for test in OFFERED])
def test_tests_of_participants_are_planned_from_format_6_on(test: dict[str, Any]) -> None:
    assert load.find(ProtocolFile, _planning(test), {}) == ()
    fields = [problem.field for problem in load.find(ProtocolFile, _planning(test, 5), {})]
    new = "materials" if test["test"] == "equivalence" else "test"
    assert f"analysis[0].{new}" in fields


@pytest.mark.parametrize(
    ("place", "wrong", "field"),
    [
        (0, {"margin": 0.1}, "analysis[0].margin"),
        (0, {"correction": "tasks"}, "analysis[0].correction"),
        (0, {"chance": None}, "analysis[0].chance"),
        (1, {"correction": "materials"}, "analysis[0].correction"),
        (1, {"tasks": ("one",)}, "analysis[0].tasks"),
        (2, {"materials": ("felt",)}, "analysis[0].materials"),
        (3, {"correction": "materials"}, "analysis[0].correction"),
        (4, {"materials": ("felt",)}, "analysis[0].materials"),
        (5, {"tasks": ("one",)}, "analysis[0].materials"),
        (5, {"correction": "materials"}, "analysis[0].correction"),
        (6, {"tasks": ("one",)}, "analysis[0].tasks"),
    ],
)
def test_a_field_that_is_not_of_a_test_is_refused(place: int, wrong: dict[str, Any], field: str) -> None:
    assert [one.field for one in load.find(ProtocolFile, _planning({**OFFERED[place], **wrong}), {})] == [field]


def test_groups_are_those_of_a_choice_among_the_facts_about_people() -> None:
    known = {"asked": {"people": asked("one")["people"]}}
    test = {"test": "difference of groups", "tasks": ("one",), "groups": "sex", "correction": "tasks"}
    study = {**_planning(test, 7), **known}
    assert load.find(ProtocolFile, study, {}) == ()
    (of_no_choice,) = load.find(ProtocolFile, {**study, **_planning({**test, "groups": "age"}, 7)}, {})
    assert of_no_choice.field == "analysis[0].groups"
    assert "analysis[0].groups" in [one.field for one in load.find(ProtocolFile, _planning(test, 7), {})]
    assert "analysis[0].test" in [one.field for one in load.find(ProtocolFile, _planning(test, 6), {})]


def test_the_order_of_tasks_is_planned_where_it_changes() -> None:
    study = changed(_planning(OFFERED[6]), ("task_order", "kind"), "fixed")
    assert [one.field for one in load.find(ProtocolFile, study, {})] == ["task_order.kind"]


def test_a_file_in_json_holds_the_same_protocol() -> None:
    study = ProtocolFile.model_validate(document())
    assert ProtocolFile.model_validate_json(study.model_dump_json()) == study


@pytest.mark.parametrize(("number", "fields"), [(6, []), (7, ["study.id"])])
def test_no_study_is_named_as_a_device_from_format_7_on(number: int, fields: list[str]) -> None:
    study = {**changed(document(), ("study", "id"), "aux"), "format": number}
    assert [problem.field for problem in load.find(ProtocolFile, study, {})] == fields


def test_no_questionnaire_is_named_as_a_device_and_no_two_shared_facts_have_one_column() -> None:
    both = asked("one")
    people = (*both["people"], {**both["people"][1], "id": "age_group"})
    forms = ({**both["questionnaires"][0], "id": "con"}, both["questionnaires"][1])
    sharing = {"statement": "May your trials be shared?", "facts": ("age", "age_group")}
    study = {**document(), "format": 7, "asked": {"people": people, "questionnaires": forms}, "sharing": sharing}
    fields = [problem.field for problem in load.find(ProtocolFile, study, {})]
    assert fields == ["asked.questionnaires[0].id", "sharing.facts[1]"]
