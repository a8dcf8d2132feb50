"""Detection in a protocol: what is refused, what a block presents, and what is right."""

from __future__ import annotations

from collections import Counter
from typing import Any

import pytest

from palpate.experiment.protocol.designs import design_of
from palpate.experiment.protocol.designs.detection import signals
from palpate.experiment.protocol.files import ProtocolFile
from palpate.experiment.protocol.levels import facts
from palpate.experiment.protocol.page import advice, page
from palpate.experiment.settings.load import find
from palpate.experiment.study.schedule import block_trials, schedule
from tests.experiment.protocol import detection, rating
from tests.experiment.protocol.detection import CONSTANT, UP_DOWN, detecting, protocol
from tests.experiment.protocol.presented import RECORDED, presenting
from tests.experiment.protocol.small import changed, with_tuples

DESIGN = design_of("detection")


@pytest.mark.parametrize(
    ("intervals", "path", "value", "field"),
    [
        (1, ("detection", "yes_key"), None, "detection.yes_key"),
        (1, ("detection", "first_key"), "3", "detection.first_key"),
        (1, ("detection", "no_key"), "1", "detection.no_key"),
        (1, ("detection", "yes_key"), "0", "answers.no_answer_key"),
        (1, ("detection", "blank"), "felt", "detection.blank"),
        (1, ("detection", "blank"), None, "detection.blank"),
        (1, ("detection", "intervals"), 3, "detection.intervals"),
        (2, ("detection", "intervals"), 1, "detection.first_key"),
        (2, ("detection", "catch_trials"), 1, "detection.catch_trials"),
        (2, ("detection", "signal_trials"), 1, "tasks[0].repetitions"),
        (2, ("presented", "pause_s"), None, "presented.pause_s"),
        (1, ("materials", 0, "key"), "x", "materials[0].key"),
        (1, ("tasks", 0, "order"), {"kind": "max-run", "max_run": 2}, "tasks[0].order.kind"),
        (1, ("tasks", 0, "materials"), ("felt",), "tasks[0].materials"),
        (1, ("analysis", 0, "test"), "threshold", "analysis[0].tasks[0]"),
        (1, ("answers", "microphone"), True, "answers.microphone"),
        (1, ("analysis", 0, "test"), "equivalence", "analysis[0].test"),
    ],
)
def test_what_detection_cannot_be_is_refused_by_its_field(
    intervals: int, path: tuple[str | int, ...], value: object, field: str
) -> None:
    tables = detecting(intervals, repetitions=3 if "signal_trials" in path else 4)
    tables["detection"] = {key: one for key, one in tables["detection"].items() if one is not None}
    broken = changed(tables, path, value)
    if value is None:
        broken[path[0]] = {key: one for key, one in broken[path[0]].items() if one is not None}
    assert field in {one.field for one in find(ProtocolFile, broken, {})}


def test_a_kind_that_plays_no_silence_has_no_blank_and_no_second_interval() -> None:
    tables = with_tuples(rating.study())
    steps = {key: one for key, one in tables.items() if key != "rating"}
    steps |= {"analysis": ({"test": "sensitivity", "tasks": ("virtual",), "question": "?"},)}
    steps["tasks"] = tuple(one | {"design": "detection"} for one in steps["tasks"])

    def fields(**own: Any) -> set[str]:
        return {one.field for one in find(ProtocolFile, steps | {"detection": own}, {})}

    assert not fields(intervals=1, yes_key="1", no_key="2")
    assert "detection.blank" in fields(intervals=1, yes_key="1", no_key="2", blank="copy paper", catch_trials=1)
    assert "detection.intervals" in fields(intervals=2, first_key="1", second_key="2", blank="copy paper")


def test_a_block_has_its_signals_and_catch_trials() -> None:
    yes_no, two = detection.STUDIES
    felt, *_ = signals(yes_no, yes_no.tasks[0])
    blank = yes_no.materials[-1].id
    count = len(yes_no.materials) - 1
    assert Counter(yes_no.presentations(yes_no.tasks[0]))[felt,] == 2
    assert Counter(yes_no.presentations(yes_no.tasks[0]))[blank,] == 1
    assert block_trials(yes_no, yes_no.tasks[0].id) == 2 * count + 1
    assert Counter(two.presentations(two.tasks[0]))[felt, blank] == 2
    assert (yes_no.shown_together(yes_no.tasks[0]), two.shown_together(two.tasks[0])) == (1, 2)


@pytest.mark.parametrize("seed", range(5))
def test_each_signal_is_in_either_interval_alike_and_blocks_are_whole(seed: int) -> None:
    yes_no, two = detection.STUDIES
    order = schedule(protocol=two, participant="01", task_id=two.tasks[0].id, seed=seed)
    blank = two.materials[-1].id
    for signal in signals(two, two.tasks[0]):
        assert Counter(one.presented for one in order if signal in one.presented) == {
            (signal, blank): 4,
            (blank, signal): 4,
        }
    order = schedule(protocol=yes_no, participant="01", task_id=yes_no.tasks[0].id, seed=seed)
    size = block_trials(yes_no, yes_no.tasks[0].id)
    blocks = [order[at : at + size] for at in range(0, len(order), size)]
    assert {sum(one.presented == (blank,) for one in block) for block in blocks} == {1}


def test_right_is_what_was_presented() -> None:
    yes_no, two = detection.STUDIES
    felt, blank = two.materials[0].id, two.materials[-1].id
    right = DESIGN.right
    assert right is not None
    assert [right(yes_no, (one,), answer) for one in (felt, blank) for answer in ("yes", "no")] == [
        True, False, False, True,
    ]  # fmt: skip
    laid = ((felt, blank), (blank, felt))
    assert [right(two, one, answer) for one in laid for answer in ("first", "second")] == [True, False, False, True]
    assert [DESIGN.catches(yes_no, (one,)) for one in (felt, blank)] == [False, True]
    assert not any(DESIGN.catches(two, one) for one in laid)


def test_a_task_without_materials_and_a_study_without_a_blank_are_refused_in_words() -> None:
    tables = detecting(1)
    tables["detection"] = {"intervals": 1, "yes_key": "1", "no_key": "2"}
    broken = changed(tables, ("tasks", 0, "materials"), ())
    assert "tasks[0].materials" in {one.field for one in find(ProtocolFile, broken, {})}


@pytest.mark.parametrize(("limit", "is_refused"), [(12, False), (13, True)])
def test_a_limit_of_answers_is_at_most_the_trials_of_the_shortest_task(limit: int, is_refused: bool) -> None:
    """4 blocks of 2 trials of a signal and 1 catch trial, 4 (2 + 1) = 12."""
    tables = detecting(1)
    assert len(tables["materials"]) == 2
    few = {"id": "few", "when": "answers-below", "limit": limit, "action": "exclude-participant", "reason": "few"}
    tables["exclusion"] = (*tables["exclusion"], few)
    fields = {one.field for one in find(ProtocolFile, tables, {})}
    assert fields == ({f"exclusion[{len(tables['exclusion']) - 1}].limit"} if is_refused else set())


def test_a_board_reads_no_other_answers_than_there_are() -> None:
    tables = detecting(1)
    names = tuple(one["id"] for one in tables["materials"])
    tables["tasks"] = ({**tables["tasks"][0], "materials": names},)
    known = ProtocolFile.model_validate(tables)
    assert "answers may" not in " ".join(page(known, "study.toml").split())


def test_constant_levels_come_equally_often_or_are_refused() -> None:
    fields = {one.field for one in find(ProtocolFile, detecting(2, CONSTANT, repetitions=2), {})}
    assert fields == {"tasks[0].repetitions"}
    fields = {one.field for one in find(ProtocolFile, detecting(1, CONSTANT, repetitions=3), {})}
    assert fields == {"tasks[0].repetitions"}
    known = protocol(1, CONSTANT, repetitions=2)
    assert dict(facts(known.tasks[0])).keys() == {"Levels", "Chosen", "Repeats"}
    broken = detecting(1, CONSTANT | {"first": 0.125})
    assert {one.field for one in find(ProtocolFile, broken, {})} == {"tasks[0].levels.first"}


def test_a_planned_threshold_of_a_task_with_levels_is_not_odd() -> None:
    assert not [one for one in advice(protocol(2, UP_DOWN)) if one.field.startswith("analysis")]


QUEST: dict[str, Any] = {
    "method": "quest-plus",
    "grid": (0.25, 0.5, 1.0),
    "thresholds": (0.25, 0.5, 1.0),
    "spreads_db": (3.0,),
    "lapses": (0.02,),
}


@pytest.mark.parametrize(
    ("intervals", "levels", "own", "fields"),
    [
        (2, UP_DOWN, {"repetitions": 20}, []),
        (2, {**UP_DOWN, "down": 1}, {"repetitions": 20}, ["tasks[0].levels.down"]),
        (2, {**UP_DOWN, "down": 1, "up": 3}, {"repetitions": 20}, []),
        (1, {**UP_DOWN, "down": 1}, {"repetitions": 20}, []),
        (2, {**QUEST, "guess": 0.0}, {}, ["tasks[0].levels.guess"]),
        (2, {**QUEST, "guess": 0.5}, {}, []),
        (2, {**UP_DOWN, "reversals": 60}, {"repetitions": 20}, ["tasks[0].levels.reversals"]),
        (2, {**UP_DOWN, "reversals": 1}, {"repetitions": 20}, ["tasks[0].levels.reversals"]),
        (1, None, {"catch_trials": 0}, ["detection.catch_trials"]),
        (2, {**CONSTANT, "grid": (0.25, 0.2501, 0.5, 1.0)}, {}, ["tasks[0].levels.grid"]),
    ],
)
def test_what_a_threshold_cannot_come_from_is_worth_a_second_look(
    intervals: int, levels: dict[str, Any] | None, own: dict[str, Any], fields: list[str]
) -> None:
    assert [one.field for one in advice(protocol(intervals, levels, **own)) if one.field.startswith(LOOKED)] == fields


LOOKED = ("tasks[0].levels", "detection.")


def test_stimuli_that_tell_nothing_or_too_much_are_worth_a_second_look() -> None:
    study = detecting(2)
    one, *others = study["presented"]["stimuli"]
    weak = {"sinusoid": {**one["parts"][0]["sinusoid"], "amplitude_m_s2": 0.0}}
    longer = {**others[-1], "parts": ({"silence": {"lasts_s": 0.5}},)}
    stimuli = ({**one, "parts": (weak,)}, *others[:-1], longer)
    odd = advice(ProtocolFile.model_validate(study | {"presented": study["presented"] | {"stimuli": stimuli}}))
    fields = [f"presented.stimuli[{place}].parts" for place in (0, len(stimuli) - 1)]
    assert [found.field for found in odd if found.field.startswith("presented")] == fields


def test_one_recording_under_two_names_is_worth_a_second_look() -> None:
    study = presenting(first=(RECORDED,))
    first, second, *others = study["presented"]["stimuli"]
    named = {"recorded": {**RECORDED["recorded"], "file": "other.wav"}}
    stimuli = (first, {**second, "parts": (named,)}, *others)
    odd = advice(ProtocolFile.model_validate(study | {"presented": study["presented"] | {"stimuli": stimuli}}))
    (field,) = (found.field for found in odd if found.field.startswith("presented"))
    assert "[1]" in field
