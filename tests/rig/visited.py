"""A visit whose session is a process of its own, and somebody at its socket: SIMULATED, but for session and dataset.

The processes are forked from one that has loaded palpate, so that each begins within a moment and not after seconds.
"""

from __future__ import annotations

import multiprocessing
import os
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from multiprocessing.process import BaseProcess
from pathlib import Path

from palpate.experiment.desk.console import transport
from palpate.experiment.desk.link import Line
from palpate.experiment.desk.link.wire import Choose, Hello, Reply, View, Write
from palpate.experiment.desk.questions import WITHOUT
from tests.rig.laboratory import HURRIED

ME = Hello(role="console", by="test")
PATIENCE_S = 60.0
SAYS = "The participant says: "
PRELOADED = (
    "palpate.experiment.cli.session",
    "palpate.experiment.rehearsal.study",
    "palpate.experiment.session.run",
    "tests.rig.in_the_room",
    "tests.rig.visited",
)

servers = multiprocessing.get_context("forkserver")
servers.set_forkserver_preload(list(PRELOADED))


def give_command(folder: Path, words: tuple[str, ...], simulated: bool, terminal: str = "") -> None:
    """Give the command in this process, which has its own folder and log, or a `terminal` of its own."""
    os.setsid()
    os.chdir(folder)
    os.environ["XDG_RUNTIME_DIR"] = str(folder)
    log = os.open(terminal or "log", os.O_RDWR | os.O_CREAT | os.O_APPEND)
    for descriptor in (0, 1, 2) if terminal else (1, 2):
        os.dup2(log, descriptor)
    if terminal:
        sys.stdin = os.fdopen(0, "r", 1, closefd=False)
    if simulated:
        from tests.rig import in_the_room

        in_the_room.simulate()
    from palpate.experiment import __main__
    from palpate.experiment.rehearsal.kinds.footstep import participant

    vars(participant).update(HURRIED)
    sys.argv = ["palpate", *words]
    __main__.main()


@dataclass
class Desk:
    """Somebody at a console: runs the session's process, connects to it, and keys what the participant says.

    `words` are the command, given in `folder`; the devices of a session with a participant are `simulated`.
    """

    folder: Path
    words: tuple[str, ...]
    simulated: bool = False
    replies: list[Reply] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.socket = self.folder / "s"
        self.process: BaseProcess | None = None
        self.there: Line | None = None
        self._asked = 0
        self._last: View | None = None

    @property
    def root(self) -> Path:
        return self.folder / "data"

    @property
    def log(self) -> str:
        return (self.folder / "log").read_text("utf-8")

    def connect(self) -> None:
        """Begin the session's process if none runs, and connect to it."""
        if self.process is None or not self.process.is_alive():
            words = (*self.words, "--dataset", "data", "--session-at", str(self.socket))
            # Not a daemon, which may have no processes of its own.
            self.process = servers.Process(target=give_command, args=(self.folder, words, self.simulated), daemon=False)
            self.process.start()
        ends_s = time.monotonic() + PATIENCE_S
        while not transport.answers(self.socket):
            assert self.process.is_alive(), self.log
            assert time.monotonic() < ends_s
            time.sleep(0.01)
        self.there = Line(self.socket, ME)

    def kill(self) -> None:
        """End the session's process as `kill -9` does."""
        assert self.process is not None
        self.process.kill()
        self.process.join(PATIENCE_S)

    def close(self) -> None:
        if self.there is not None:
            self.there.close()
        if self.process is not None:
            self.kill()

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
            words = view.heard.removeprefix(SAYS).rstrip(".")
            self.press(view, next(choice.key for choice in asked.choices if choice.answer and words in choice.words))
        elif asked.kind == "say":
            self.press(view, WITHOUT)
        elif asked.choices:
            self.press(view, asked.choices[0].key if asked.kind == "agree" else "enter")

    def views(self) -> Iterator[View]:
        """Yield what the session shows, until it is gone; each new question once."""
        assert self.there is not None
        last: tuple[object, ...] = ()
        for message in self.there.messages():
            if isinstance(message, Reply):
                self.replies.append(message)
                continue
            assert isinstance(message, View)
            now = (message.question, message.state, message.trial, message.heard, message.ended)
            if now != last:
                last = now
                yield message

    def visit(self, at: Callable[[View], bool] = lambda _: False) -> View:
        """Go on with the visit until `at` says so, or its end; return the view at that moment."""
        assert self.there is not None
        if self._last is not None and self._last.question is not None and self._is_new(self._last):
            if at(self._last):
                return self._last
            self._asked = self._last.question.number
            self.answer(self._last)
        for view in self.views():
            self._last = view
            if at(view) or view.ended is not None:
                return view
            if view.question is not None and self._is_new(view):
                self._asked = view.question.number
                self.answer(view)
        raise AssertionError(f"the session is gone: {self.log}")

    def _is_new(self, view: View) -> bool:
        """Return whether a question is to be answered now: once, and no earlier than the participant speaks."""
        asked = view.question
        waits = asked is not None and asked.kind == "answer" and SAYS not in view.heard
        return asked is not None and asked.number != self._asked and not waits

    def look(self, at: Callable[[View], bool] = lambda _: True) -> View:
        """Return the first view of which `at` holds, and press no key meanwhile."""
        for view in self.views():
            self._last = view
            if at(view):
                return view
        raise AssertionError(f"the session is gone: {self.log}")

    def again(self) -> None:
        """Come back: connect anew, to the session's process or to another."""
        if self.there is not None:
            self.there.close()
        self._asked, self._last = 0, None
        self.connect()
