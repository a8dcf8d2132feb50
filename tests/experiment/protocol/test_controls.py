"""A task that controls another one's masking: what a file may say, and what the experimenter confirms."""

from __future__ import annotations

from pathlib import Path

import pytest

from palpate.experiment.desk.questions import NO, Agree, Reply
from palpate.experiment.errors import PalpateError, PauseAsked, ProtocolError
from palpate.experiment.protocol import files, new
from palpate.experiment.protocol.files import shipped
from palpate.experiment.rehearsal.clock import ManualClock
from palpate.experiment.session.answering import control
from tests.experiment.session.scripted import START_NS, ScriptedConsole

STUDY = new.controlled(new.text(new.NewStudy()))


def test_a_control_is_as_its_task_but_for_id_title_and_arrangement(tmp_path: Path) -> None:
    for text in (new.text(new.NewStudy()), shipped("okamoto2012.toml").read_text("utf-8")):
        (tmp_path / "before.toml").write_text(text, "utf-8")
        (tmp_path / "study.toml").write_text(new.controlled(text), "utf-8")
        made = files.load(tmp_path / "study.toml")
        first, own = made.task("virtual"), made.task("control")
        before = files.load(tmp_path / "before.toml")
        assert made.duration is not None
        assert before.duration is not None
        # 40 trials of 25 to 50 s (16.7 to 33.3 min), 3 to 5 min of familiarisation, a break of 5: in fives.
        assert made.duration.shortest_min - before.duration.shortest_min == 25
        assert made.duration.longest_min - before.duration.longest_min == 45
        assert own.control is not None
        assert (own.control.of, own.control.margin) == ("virtual", 0.1)
        assert first.model_copy(update={"id": "control", "title": own.title, "control": own.control}) == own


@pytest.mark.parametrize("tasks", ["real", "virtual"])
def test_nothing_is_controlled_without_a_virtual_task_or_twice(tasks: str) -> None:
    text = new.text(new.NewStudy(tasks=tasks))
    with pytest.raises(PalpateError):
        new.controlled(text if tasks == "real" else new.controlled(text))


@pytest.mark.parametrize("name", ["harder.toml", "rating.toml", "threshold.toml"])
def test_a_study_of_another_design_or_whose_factors_make_its_materials_has_no_control(name: str) -> None:
    with pytest.raises(PalpateError):
        new.controlled(shipped(name).read_text("utf-8"))


@pytest.mark.parametrize(
    ("old", "changed", "field"),
    [
        ('of = "virtual"', 'of = "control"', "tasks[2].control.of"),
        ('of = "virtual"', 'of = "real"', "tasks[2].control.of"),
        ('tasks = ["virtual", "real"]', 'tasks = ["virtual", "control"]', "analysis[0].tasks[1]"),
        ("format = 7", "format = 6", "tasks[2].control"),
    ],
)
def test_a_control_of_anything_else_is_refused(tmp_path: Path, old: str, changed: str, field: str) -> None:
    assert old in STUDY
    (tmp_path / "study.toml").write_text(STUDY.replace(old, changed), "utf-8")
    with pytest.raises(ProtocolError) as refused:
        files.load(tmp_path / "study.toml")
    assert field in [one.field for one in refused.value.findings]


def test_no_trial_begins_where_the_arrangement_is_not_confirmed(tmp_path: Path) -> None:
    (tmp_path / "study.toml").write_text(STUDY, "utf-8")
    protocol = files.load(tmp_path / "study.toml")
    console = ScriptedConsole(ManualClock(START_NS), "")
    console.instead[Agree] = lambda: Reply(NO)
    for task in ("virtual", "control"):
        with pytest.raises(PauseAsked):
            control.confirm(protocol, protocol.task(task), console, log=None)  # type: ignore[arg-type]
    control.confirm(protocol, protocol.task("real"), console, log=None)  # type: ignore[arg-type]
