"""A practised visit over the desk's socket: stopped at every step, in every way, it goes on there and loses nothing."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from experiment import storage
from experiment.dataset.verify import verify
from experiment.desk import link
from experiment.desk.link import Line
from experiment.desk.messages import Choose, Correct, Hello, Pause, Repeat, Reply, Stop, TakeNote, Typed, View, Write
from experiment.records import journal
from experiment.records.entries import Answer, Commanded, Correction, Footer, Ignored, Note, Redo, Visited
from experiment.records.journal import AnyEntry
from experiment.records.progress import progress
from tests.experiment.protocol.small import SMALL

ME = Hello(role="console", by="test")
TASKS = ("one", "two")
"""In the order in which participant 01 practises them."""
PATIENCE_S = 60.0


@dataclass
class Desk:
    """Somebody at a console: runs the session's process, connects to it, and keys what the participant says."""

    folder: Path
    replies: list[Reply] = field(default_factory=list)

    def __post_init__(self) -> None:
        (self.folder / "small.toml").write_text(re.sub("repetitions = [0-9]", "repetitions = 1", SMALL), "utf-8")
        self.socket = self.folder / "s"
        self.process: subprocess.Popen[bytes] | None = None
        self.there: Line | None = None
        self._asked = 0
        self._last: View | None = None

    @property
    def root(self) -> Path:
        return self.folder / "data"

    def connect(self) -> None:
        """Begin the session's process if none listens, and connect to it."""
        if self.process is None or self.process.poll() is not None:
            command = ["run", "small.toml", "--practice", "--dataset", "data", "--session-at", str(self.socket)]
            with (self.folder / "log").open("ab") as log:
                self.process = subprocess.Popen(
                    [sys.executable, "-m", "experiment", *command],
                    cwd=self.folder,
                    env={**os.environ, "PYTHONPATH": str(Path(__file__).parents[2])},
                    stdin=subprocess.DEVNULL,
                    stderr=log,
                    start_new_session=True,
                )
        ends_s = time.monotonic() + PATIENCE_S
        while not link.answers(self.socket):
            assert self.process.poll() is None, (self.folder / "log").read_text("utf-8")
            assert time.monotonic() < ends_s
            time.sleep(0.02)
        self.there = Line(self.socket, ME)

    def close(self) -> None:
        if self.there is not None:
            self.there.close()
        if self.process is not None:
            self.process.kill()
            self.process.wait()

    def press(self, view: View, key: str) -> None:
        assert self.there is not None
        assert view.question is not None
        self.there.send(Choose(question=view.question.number, key=key))

    def answer(self, view: View) -> None:
        """Do what an experimenter does at this question."""
        assert self.there is not None
        asked = view.question
        assert asked is not None
        if asked.kind == "write":
            self.there.send(Write(question=asked.number, text=f"an answer to {asked.text[:8]}"))
        elif asked.kind == "answer":
            said = next(line for line in reversed(view.lines) if line.startswith("The participant says: "))
            words = said.removeprefix("The participant says: ").rstrip(".")
            self.press(view, next(choice.key for choice in asked.choices if choice.answer and words in choice.words))
        else:
            self.press(view, "enter")

    def views(self) -> Iterator[View]:
        """Yield what the session shows, until it is gone; each new question once."""
        assert self.there is not None
        last: tuple[object, ...] = ()
        for message in self.there.messages():
            if isinstance(message, Reply):
                self.replies.append(message)
                continue
            assert isinstance(message, View)
            now = (message.question, message.state, message.trial, message.ended)
            if now != last:
                last = now
                yield message

    def visit(self, at: Callable[[View], bool] = lambda _: False) -> View:
        """Go on with the visit until `at` says so, or its end; return the view at that moment."""
        assert self.there is not None
        if self._last is not None and self._last.question is not None and self._last.question.number != self._asked:
            self._asked = self._last.question.number
            self.answer(self._last)
        for view in self.views():
            self._last = view
            if at(view) or view.ended is not None:
                return view
            if view.question is not None and view.question.number != self._asked:
                self._asked = view.question.number
                self.answer(view)
        raise AssertionError(f"the session is gone: {(self.folder / 'log').read_text('utf-8')}")

    def again(self) -> None:
        """Come back: connect anew, to the session's process or to another."""
        if self.there is not None:
            self.there.close()
        self._asked, self._last = 0, None
        self.connect()


@pytest.fixture
def desk(tmp_path: Path) -> Iterator[Desk]:
    one = Desk(tmp_path)
    try:
        yield one
    finally:
        one.close()


def entries(desk: Desk, task: str) -> tuple[AnyEntry, ...]:
    return journal.read_if_begun(storage.journal_path(desk.root, "01", task)).entries


STEPS: dict[str, Callable[[View], bool]] = {
    "familiarise": lambda view: view.question is not None and view.question.kind == "familiarise",
    "place": lambda view: view.question is not None and view.question.kind == "place",
    "armed": lambda view: view.state == "armed",
    "answer": lambda view: view.question is not None and view.question.kind == "answer",
    "confirm": lambda view: view.question is not None and view.question.kind == "confirm",
    "second task": lambda view: view.standing.task == TASKS[1] and view.question is not None,
    "write": lambda view: view.question is not None and view.question.kind == "write",
    "debrief": lambda view: view.question is not None and view.question.kind == "debrief",
}


@pytest.mark.parametrize("how", ["key", "console", "kill"])
def test_a_visit_that_is_stopped_at_every_step_goes_on_there(desk: Desk, how: str) -> None:
    """By the stop key, by a console that is closed, and by SIGKILL of the session's process."""
    said: dict[str, set[tuple[int, str | None]]] = {task: set() for task in TASKS}
    for step, at in STEPS.items():
        desk.again()
        stopped = desk.visit(at)
        assert stopped.ended is None, step
        process = desk.process
        assert process is not None
        assert desk.there is not None
        for task in TASKS:
            if found := entries(desk, task):
                now = set(progress(found).said)
                assert said[task] <= now, step
                said[task] = now
        if how == "key":
            desk.there.send(Stop())
            assert desk.visit(lambda view: view.ended is not None).ended is not None, step
            assert process.wait(PATIENCE_S) == 0, step
        elif how == "kill":
            process.send_signal(signal.SIGKILL)
            process.wait()
        else:
            desk.again()
            assert desk.process is process
            # It has caught up with the first view.
            view = next(desk.views())
            assert (view.standing.task, view.step) == (stopped.standing.task, stopped.step), step
    desk.again()
    end = desk.visit()
    assert end.ended is not None
    assert end.ended.exit_code == 0
    for task in TASKS:
        done = progress(entries(desk, task))
        assert done.complete
        assert sorted(done.answered) == list(range(1, len(done.header.order) + 1))
        assert said[task] <= set(done.said)
    assert verify(desk.root).refused == 0


def test_what_is_asked_for_at_any_moment_is_done_answered_and_on_record(desk: Desk) -> None:
    desk.connect()
    assert desk.there is not None
    armed = desk.visit(STEPS["armed"])
    assert armed.trial is not None
    desk.there.send(TakeNote(text="The phone rings.", trial=armed.trial))
    desk.there.send(Typed(keys="ff"))
    desk.there.send(Repeat(trial=armed.trial, reason="the phone rang"))
    later = desk.visit(STEPS["answer"])
    assert later.trial != armed.trial
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
    assert refused == ["Trial 99 has no answer that counts; nothing was changed."]


def test_what_is_said_at_the_end_of_a_visit_is_on_record_once(desk: Desk) -> None:
    desk.connect()
    desk.visit(STEPS["debrief"])
    assert desk.process is not None
    desk.process.send_signal(signal.SIGKILL)
    desk.process.wait()
    desk.again()
    desk.visit()
    assert [e.step for e in entries(desk, TASKS[1]) if isinstance(e, Visited)] == ["report", "payment"]
    assert not [e for e in entries(desk, TASKS[0]) if isinstance(e, Visited)]
    answers = [e for task in TASKS for e in entries(desk, task) if isinstance(e, Answer)]
    assert all(0 < e.response_time_s <= e.confirmed_s for e in answers)
