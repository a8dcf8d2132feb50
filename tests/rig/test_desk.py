"""A visit over the desk's socket: at every step stopped in every way, it goes on there and loses nothing."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from contextlib import closing
from datetime import date, timedelta
from pathlib import Path

import pytest
from syrupy.assertion import SnapshotAssertion

from palpate.experiment import storage
from palpate.experiment.dataset.verify import verify
from palpate.experiment.desk.link import Line
from palpate.experiment.desk.link.wire import Choose, Hello, Pause, Stop, Typed, View
from palpate.experiment.desk.messages import Correct, Prompt, Repeat, TakeNote
from palpate.experiment.records import journal
from palpate.experiment.records.entries import (
    Answer,
    Commanded,
    Correction,
    Entry,
    Footer,
    Ignored,
    Note,
    Redo,
    Visited,
)
from palpate.experiment.records.progress import progress
from palpate.experiment.session.remarks import REPORTS
from tests.conftest import Palpate
from tests.experiment.protocol.small import SMALL
from tests.rig.laboratory import write_rig
from tests.rig.visited import PATIENCE_S, Desk

TASKS = ("one", "two")
"""In the order in which participant 01 practices them."""


@pytest.fixture
def desk(tmp_path: Path) -> Iterator[Desk]:
    (tmp_path / "small.toml").write_text(re.sub("repetitions = [0-9]", "repetitions = 1", SMALL), "utf-8")
    with closing(Desk(tmp_path, ("run", "small.toml", "--practice"))) as one:
        yield one


def entries(desk: Desk, task: str) -> tuple[Entry, ...]:
    return journal.read_if_begun(storage.journal_path(desk.root, "01", task)).entries


def at_question(kind: str, words: str = "") -> Callable[[View], bool]:
    """Return what tells a view of such a question, whose text holds the words."""
    return lambda view: view.question is not None and view.question.kind == kind and words in view.question.text


BREAK_S = 5.0
STEPS: dict[str, Callable[[View], bool]] = {
    "consent": at_question("agree", "consent"),
    "voices": at_question("agree", "recordings"),
    "identity": at_question("agree", "in front of you"),
    "familiarise": lambda view: view.step == TASKS[0] and at_question("familiarise")(view),
    "masker": at_question("level"),
    "say": at_question("say"),
    "rest": at_question("rest"),
    "place": at_question("place"),
    "armed": lambda view: view.state == "armed" and view.question is None,
    "answer": at_question("answer"),
    "confirm": at_question("confirm"),
    "break": at_question("break"),
    "second task": lambda view: view.step == TASKS[1] and at_question("familiarise")(view),
    "report": at_question("write", "report"),
    "payment": at_question("write", "paid"),
    "debrief": at_question("debrief"),
}
"""Every step of a visit, in the order in which they are first met."""

ANEW = {"identity", "masker", "say", "rest", "place", "armed", "answer", "confirm"}
"""What a visit that was stopped may ask again on its way back to where it was; each session has its devices made ready,
and a trial without a confirmed answer is done again."""


@pytest.fixture
def visit(tmp_path: Path, palpate: Palpate, monkeypatch: pytest.MonkeyPatch) -> Iterator[Desk]:
    """A sealed study of one trial a material, and a participant who has not consented yet."""
    text = re.sub("repetitions = [0-9]", "repetitions = 1", SMALL)
    text = text.replace('stimulus = "virtual"', 'stimulus = "real"').replace(
        "break_min_s = 61", f"break_min_s = {BREAK_S}"
    )
    text = text.replace('pause_key = "="', 'pause_key = "="\nmicrophone = true')
    text = text.replace('statement = "You may', 'voice_recordings = true, statement = "You may')
    text = re.sub("min_s = [56]\\b", "min_s = 0", text)
    text = re.sub(r"approved_on = 2020-02-01\nexpires_on = 2021-02-01", "", text)
    (tmp_path / "small.toml").write_text(text, "utf-8")
    rig = write_rig(tmp_path, "rehearsal", port='"/dev/none"', address='"127.0.0.1:1"')
    rig.write_text(rig.read_text("utf-8").replace("[tracker]", "[tracker]\nzeroing_mm = 3.0"), "utf-8")
    monkeypatch.chdir(tmp_path)
    days = ["--approved-on", date.today(), "--expires-on", date.today() + timedelta(9)]
    assert palpate("seal", "small.toml", "--approval-number", "17", *days)[0] == 0
    assert palpate("enrol", "small.toml", "-p", "01", "--dataset", "data", "--seed", "1")[0] == 0
    with closing(Desk(tmp_path, ("run", "small.toml", "-p", "01", "--rig", "rig.toml"), simulated=True)) as one:
        yield one


def reach(visit: Desk, step: str) -> View:
    """Go on to a step; on the way nothing is asked anew that was done, but for what each session asks."""
    names = list(STEPS)
    # While processes begin anew, the break may end.
    there = [STEPS[name] for name in ((step, "second task") if step == "break" else (step,))]
    before = [name for name in names[: names.index(step)] if name not in ANEW]
    passed: set[str] = set()

    def is_there(view: View) -> bool:
        passed.update(name for name in before if STEPS[name](view))
        return any(at(view) for at in there)

    view = visit.visit(is_there)
    assert view.ended is None, (step, view.ended)
    assert passed <= set(before[-1:]), step
    return view


def catch_up(visit: Desk, stopped: View) -> None:
    """Lose the console, and a participant's screen; keys of the question before answer nothing."""
    assert visit.there is not None
    process = visit.process
    if stopped.question is not None:
        for key in ("enter", "f", "y"):
            visit.there.send(Choose(question=stopped.question.number - 1, key=key))
    visit.there.send(Typed(keys="f"))
    with closing(Line(visit.socket, Hello(role="screen", by="screen"))) as screen:
        shown = next(screen.messages())
        assert isinstance(shown, Prompt)
        assert "felt" not in shown.model_dump_json()
    visit.again()
    assert visit.process is process
    view = visit.look()
    if stopped.question is not None:
        assert view.question == stopped.question
        assert (view.state, view.step, view.trial) == (stopped.state, stopped.step, stopped.trial)


def stop(visit: Desk, deed: Pause | Stop) -> None:
    """Stop by key, and go on: in the same process after a pause, and in another one after the end for today."""
    assert visit.there is not None
    assert visit.process is not None
    visit.there.send(deed)
    if isinstance(deed, Pause):
        visit.look(at_question("continue"))
        return
    assert visit.look(lambda view: view.ended is not None).ended is not None
    visit.process.join(PATIENCE_S)
    assert visit.process.exitcode == 0
    visit.again()


def test_a_visit_that_is_stopped_at_every_step_in_every_way_goes_on_there(visit: Desk) -> None:
    """One visit: at each step its console and its screen are lost, it is stopped by key, and its process is killed."""
    said: dict[str, set[tuple[int, str | None]]] = {task: set() for task in TASKS}
    visit.connect()
    for number, step in enumerate(STEPS):
        catch_up(visit, reach(visit, step))
        for task in TASKS:
            if found := entries(visit, task):
                now = set(progress(found).said)
                assert said[task] <= now, step
                said[task] = now
        stop(visit, Pause() if number % 2 else Stop())
        reach(visit, step)
        visit.kill()
        visit.again()
        reach(visit, step)
    end = visit.visit()
    assert end.ended is not None
    assert end.ended.exit_code == 0
    for task in TASKS:
        done = progress(entries(visit, task))
        assert done.complete
        assert sorted(done.answered) == list(range(1, len(done.header.order) + 1))
        assert said[task] <= set(done.said)
    made = [entry for task in TASKS for entry in entries(visit, task)]
    stated = [entry.step for entry in made if isinstance(entry, Visited)]
    assert [step for step in stated if step != "identity"] == list(REPORTS)
    assert all(0 < entry.response_time_s <= (entry.confirmed_s or 0.0) for entry in made if isinstance(entry, Answer))
    assert verify(visit.root).refused == 0


def test_the_order_of_the_tasks_is_shown_once_it_is_known_who_is_at_the_panel(visit: Desk) -> None:
    visit.connect()
    asked = visit.visit(STEPS["identity"])
    assert (asked.step, asked.steps) == ("", ())
    assert not [line for line in asked.lines if line.startswith("──")]
    assert visit.visit(STEPS["familiarise"]).steps == (*TASKS, "debriefing")


def test_what_is_asked_for_at_any_moment_is_done_answered_and_on_record(
    desk: Desk, approved: SnapshotAssertion
) -> None:
    desk.connect()
    assert desk.there is not None
    armed = desk.visit(STEPS["armed"])
    assert armed.trial is not None
    desk.there.send(TakeNote(text="The phone rings.", trial=armed.trial))
    desk.there.send(Typed(keys="ff"))
    desk.look(STEPS["answer"])
    desk.there.send(Repeat(trial=armed.trial, reason="the phone rang"))
    later = desk.look(lambda view: STEPS["answer"](view) and view.trial != armed.trial)
    desk.visit(lambda view: view.standing.answered == 1)
    desk.there.send(Correct(trial=later.trial or 0, key="0", reason="said nothing"))
    desk.there.send(Correct(trial=99, key="0", reason="no such trial"))
    desk.there.send(Pause(minutes=0.01))
    assert desk.visit(lambda view: view.state == "paused").pause_until_ns is not None
    desk.visit(lambda view: view.standing.task == TASKS[1])
    found = entries(desk, TASKS[0])
    assert [(e.trial, e.text) for e in found if isinstance(e, Note)] == [(armed.trial, "The phone rings.")]
    assert [e.typed for e in found if isinstance(e, Ignored)][:1] == ["ff"]
    assert [e.trial for e in found if isinstance(e, Redo) and e.reason == "the phone rang"] == [armed.trial]
    assert [(e.trial, e.answered) for e in found if isinstance(e, Correction)] == [(later.trial, None)]
    assert sum(isinstance(e, Footer) and e.reason == "paused" for e in found) == 1
    commands = [(e.command.split()[0], e.taken) for e in found if isinstance(e, Commanded) and e.by == "test"]
    for asked in ("note", True), ("repeat", True), ("correct", True), ("correct", False), ("pause", True):
        assert asked in commands
    assert len(desk.replies) == len({one.id for one in desk.replies})
    refused = [one.words for one in desk.replies if not one.taken]
    assert refused == approved
