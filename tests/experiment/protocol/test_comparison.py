"""A protocol of comparisons: its own table, its rules, its canonical form and its page."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest
from syrupy.assertion import SnapshotAssertion

from palpate.experiment.errors import ProtocolError
from palpate.experiment.protocol import designs, files
from palpate.experiment.protocol.designs import design_of
from palpate.experiment.protocol.designs.comparison import Comparison
from palpate.experiment.protocol.files import ProtocolFile
from palpate.experiment.protocol.kinds import kind_of
from palpate.experiment.protocol.kinds.footstep import Footstep
from palpate.experiment.protocol.kinds.tapping import Tapping
from palpate.experiment.protocol.page import page
from palpate.experiment.settings import load
from tests.approved import Refuses
from tests.experiment.protocol import small
from tests.experiment.protocol.small import changed
from tests.experiment.protocol.tapping import comparing, live_alone, protocol, rendering, varied

LOST = {"id": "lost", "when": "frames-lost", "limit": 0, "action": "repeat-trial", "reason": "x"}
STEPS = small.document()["footstep"]
SURFACES = rendering()["tapping"]["surfaces"]
SECOND = ("tapping", "surfaces", 1, "material")
CROSSED = varied("crossover_hz", 30.0, 60.0, 120.0)
OF_TAPS = ", ".join(name for name in designs.NAMES if {*design_of(name).intervals} & {*kind_of("tapping").intervals})

BROKEN = [
    (changed(comparing(), ("footstep",), STEPS), "footstep", "no table: the kind of the tasks is 'tapping'"),
    (
        {key: table for key, table in comparing().items() if key != "comparison"},
        "comparison",
        "a table, because tasks with the design 'comparison' need it",
    ),
    ({key: t for key, t in small.document().items() if key != "footstep"}, "footstep", "tasks of the kind 'footstep'"),
    (changed(comparing(), ("materials", 0, "key"), "f"), "materials[0].key", "participants compare materials"),
    (changed(comparing(), ("materials", 0, "spoken"), ("felt",)), "materials[0].spoken", "participants compare mat"),
    (
        {key: table for key, table in rendering().items() if key != "tapping"},
        "tapping",
        "a task with virtual surfaces needs",
    ),
    (changed(rendering(), ("exposure", "force_peak_n"), None), "exposure.force_peak_n", "a number of newtons"),
    (changed(rendering(), ("tapping", "surfaces"), SURFACES[:2]), "tapping.surfaces", "missing: tin"),
    (changed(rendering(), SECOND, "tin"), "tapping.surfaces[2].material", "each once: felt, cork, tin"),
    (changed(rendering(), SECOND, "oak"), "tapping.surfaces[1].material", "each once: felt, cork, tin"),
    (changed(rendering(), ("tapping", "switch_key"), "1"), "tapping.switch_key", "a unique key"),
    (changed(CROSSED, (*SECOND[:3], "crossover_hz"), None), "tapping.surfaces[1].crossover_hz", "a number of hertz"),
    # 800 N/m over 2 pi 3.9984 N s/m, 31.84373 Hz, rounded up.
    (changed(CROSSED, ("tapping", "damping_n_s_m"), 3.9984), "tapping.surfaces[0].crossover_hz", "at least 31.844 Hz"),
    (changed(CROSSED, ("tapping", "damping_n_s_m"), 0.0), "tapping.damping_n_s_m", "a number above 0"),
    (changed(CROSSED, ("tapping", "mass_kg"), 2.0), "tapping.mass_kg", "no value"),
    (changed(CROSSED, ("tapping", "force_error_max"), 0.5), "tapping.force_error_max", "no value"),
    (changed(rendering(), ("tapping", "mass_kg"), -1.0), "tapping.mass_kg", "greater than 0"),
    (changed(rendering(), ("tapping", "stiffness"), 9.0), "tapping.stiffness", "no such key"),
    (changed(small.document(), ("tapping",), rendering()["tapping"]), "tapping", "is 'footstep'"),
    (changed(comparing(), ("tasks", 0, "design"), "identification"), "tasks[0].design", f"one of: {OF_TAPS}, for"),
    (changed(comparing(), ("tasks", 0, "repetitions"), 3), "tasks[0].repetitions", "an even number"),
    (
        changed(comparing(), ("tasks", 0, "order"), {"kind": "max-run", "max_run": 2}),
        "tasks[0].order.kind",
        "one of: full-random, blocked-random",
    ),
    (changed(comparing(), ("exclusion",), (LOST,)), "exclusion[0].when", "one of: answers-below, withdrawn"),
    (
        changed(comparing(), ("masker", "probe"), {"material": "felt", "speed_mm_s": 100.0}),
        "masker.probe",
        "no table: there is no probe for real samples",
    ),
    (changed(comparing(), ("answers", "microphone"), True), "answers.microphone", "do not name materials"),
    (changed(comparing(), ("analysis", 0, "test"), "Davidson"), "analysis[0].test", "without ties"),
    (changed(comparing(tie_key="3"), ("analysis", 0, "test"), "Thurstone"), "analysis[0].test", "tie_key allows ties"),
    (changed(comparing(), ("analysis", 0, "test"), "one-way ANOVA"), "analysis[0].test", "one of: Bradley-Terry, Thu"),
    (changed(comparing(), ("comparison", "second_key"), "1"), "comparison.second_key", "a unique key"),
    (changed(comparing(), ("comparison", "first_key"), "0"), "answers.no_answer_key", "a unique key"),
    (changed(comparing(), ("comparison", "first_key"), "+"), "comparison.first_key", "which set the masker's level"),
    (
        changed(comparing(), ("tasks", 0, "materials"), ("felt",)),
        "tasks[0].materials",
        "no value: a task with pairs presents every material",
    ),
    (
        changed(
            comparing(),
            ("exclusion",),
            ({"id": "few", "when": "answers-below", "limit": 13, "action": "exclude-participant", "reason": "x"},),
        ),
        "exclusion[0].limit",
        "at most 12, the trials of the shortest task",
    ),
    (changed(small.document(), ("tasks", 1, "design"), "comparison"), "tasks[1].design", "identification, as in the"),
    (changed(small.document(), ("tasks", 1, "kind"), "tapping"), "tasks[1].kind", "footstep, as in the first task"),
    (changed(small.document(), ("analysis", 0, "test"), "Thurstone"), "analysis[0].test", "one of: t against chance"),
]


def without_a_chance(study: dict[str, Any]) -> dict[str, Any]:
    study["analysis"] = tuple(
        {k: v for k, v in one.items() if k not in ("chance", "form")} for one in study["analysis"]
    )
    return study


@pytest.mark.parametrize(("study", "path", "allowed"), BROKEN, ids=[f"{n}-{case[1]}" for n, case in enumerate(BROKEN)])
def test_a_broken_rule_is_the_one_problem(study: dict[str, Any], path: str, allowed: str) -> None:
    problems = [one for one in load.find(ProtocolFile, without_a_chance(study), {}) if one.field == path]
    assert [allowed in one.allowed for one in problems] == [True]


def test_virtual_surfaces_are_within_the_rules_and_the_board_reads_how_they_are_rendered() -> None:
    assert load.find(ProtocolFile, rendering(), {}) == ()
    text = " ".join(page(ProtocolFile.model_validate(rendering()), "study.toml").split())
    assert "800 N/m and a damper of 5 N s/m" in text
    assert "2000 times a second" in text
    assert "at most 2 N" in text
    assert '"tin": 900 Hz, 20 m/s^2.' in text
    assert "the experimenter presses [s]" in text
    assert "two real samples" not in text


def test_the_page_of_a_study_without_a_virtual_task_does_not_tell_how_one_would_be_rendered(tmp_path: Path) -> None:
    """The tables stay in a file that was copied; the board reads of what participants will feel."""
    live = files.load(live_alone(tmp_path))
    text = " ".join(page(live, "study.toml").split())
    assert live.table(Tapping).stiffness_n_m == 2500.0
    assert "two real samples" in text
    assert not [one for one in ("spring", "servo", "vibrated", "on a virtual surface") if one in text]
    both = files.load(files.shipped("okamoto2012.toml"))
    alone = both.model_copy(update={"tasks": both.tasks[1:], "analysis": ()})
    assert ["Virtual stimuli are" in page(one, "study.toml") for one in (both, alone)] == [True, False]


@pytest.mark.parametrize("how", [{}, {"tie_key": "3"}, {"repetitions": 8, "order": "blocked-random"}])
def test_what_is_within_the_rules_is_accepted(how: dict[str, Any]) -> None:
    assert load.find(ProtocolFile, comparing(**how), {}) == ()


@pytest.mark.parametrize(
    ("key", "named"), [("key", "one ASCII character"), ("spoken", "an array of at least 1")], ids=["key", "spoken"]
)
def test_a_footstep_study_still_needs_what_its_answers_are_called(key: str, named: str) -> None:
    study = small.document()
    study["materials"] = tuple({k: v for k, v in one.items() if k != key} for one in study["materials"])
    found = load.find(ProtocolFile, study, {})
    assert [(one.field, named in one.allowed) for one in found] == [(f"materials[{i}].{key}", True) for i in range(2)]


def test_it_presents_every_pair_and_a_material_with_itself() -> None:
    pairs = {"felt felt", "felt cork", "felt tin", "cork cork", "cork tin", "tin tin"}
    study = protocol(repetitions=4)
    assert {" ".join(pair) for pair in study.presentations(study.tasks[0])} == pairs
    assert study.trials(study.tasks[0]) == 24
    assert (plain := small.protocol()).presentations(plain.tasks[0]) == (("felt",), ("cork",))


def test_the_other_kind_of_study_is_refused_in_words(refuses: Refuses) -> None:
    with refuses(ProtocolError):
        _ = protocol().table(Footstep)
    with refuses(ProtocolError):
        _ = small.protocol().table(Comparison)


def test_the_board_reads_what_is_compared_how_often_and_by_which_answers(approved: SnapshotAssertion) -> None:
    text = page(protocol(tie_key="3", order="blocked-random"), "study.toml")
    assert "6 x 2 = 12" in text
    assert "foot" not in text
    assert re.sub(r"\b[0-9a-f]{64}\b", "HASH", text) == approved
    assert "must choose one" in " ".join(page(protocol(), "study.toml").split())


def test_the_shipped_study_is_that_of_the_paper() -> None:
    """Live and Virtual Tapping Experiments: five surfaces, random pairs of them, 120 trials, seven subjects."""
    study = files.load(files.shipped("wellman1995.toml"))
    assert (study.study.participants, study.masker.noise) == (7, "white")
    assert len(study.presentations(study.tasks[0])) == 15
    assert [(task.id, study.trials(task)) for task in study.tasks] == [("live", 120), ("virtual", 120)]
    virtual = study.table(Tapping)
    assert (virtual.rate_hz, virtual.stiffness_n_m, virtual.damping_n_s_m) == (2500, 2500.0, 100.0)
    assert (virtual.decay_per_s, virtual.fastest_mm_s, study.exposure.force_peak_n) == (100.0, 175.0, 3.0)
    # Table 1.
    assert [(one.attack_hz, one.amplitude) for one in virtual.surfaces] == [
        (43.0, 0.033),
        (50.0, 0.034),
        (100.0, 0.113),
        (1000.0, 0.472),
        (4000.0, 1.0),
    ]
    assert study.table(Comparison).tie_key is None
