"""How many confirmations right after their key are taken: run `python -m tests.benchmarks.fluent`.

A key and Enter are written to a pseudo-terminal of 80 x 24, 100 ms apart, 200 times: to the console, a process of its
own at the real socket of a session's desk that asks each answer and its confirmation, and then to a process that asks
on lines of text. Then 10,000 keys are pressed before their question is asked or drawn, of which none may answer, and
a key that is held, which counts once.

Not a test: it asserts nothing. With `rough` only 20 and 200 are pressed.
"""

from __future__ import annotations

import fcntl
import os
import pty
import select
import struct
import subprocess
import sys
import tempfile
import termios
import threading
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing, contextmanager
from pathlib import Path

from palpate.experiment.desk.link import Link
from palpate.experiment.desk.link.wire import Hello, Stop, View
from palpate.experiment.desk.linked import LinkedConsole
from palpate.experiment.desk.messages import ENTER
from palpate.experiment.desk.questions import Confirm, TrialAnswer
from palpate.experiment.errors import PauseAsked

APART_S, EVERY_S, BEGINS_S = 0.1, 0.5, 2.0
ANSWERS = {key: f"material {key}" for key in "abcdefgh"}
"""Each comes again after more than a second, so that none counts as held."""

ATTEND = """
import sys
from pathlib import Path
from palpate.experiment.desk.console.app import attend
from palpate.experiment.desk.link.wire import Hello
attend(Path(sys.argv[1]), Hello(role="console", by="benchmark"))
"""

LINES = """
import sys
from palpate.experiment.desk.terminal import TerminalConsole, typed_ahead
from palpate.experiment.desk.questions import Confirm, TrialAnswer
console = TerminalConsole(write=sys.stdout, ask=input, heading="", early=lambda: typed_ahead(sys.stdin))
answers = {key: f"material {key}" for key in "abcdefgh"}
for trial in range(int(sys.argv[1])):
    while True:
        key = console.ask(TrialAnswer(trial + 1, answers, "n", {})).key
        if console.ask(Confirm(key, answers[key])).key == "enter":
            break
    print(f"taken {trial + 1}", flush=True)
"""


@contextmanager
def at_terminal(*command: str) -> Iterator[int]:
    """Run a program at a pseudo-terminal, and yield the terminal's other end."""
    ours, theirs = pty.openpty()
    fcntl.ioctl(theirs, termios.TIOCSWINSZ, struct.pack("HHHH", 24, 80, 0, 0))
    environment = {**os.environ, "TERM": "xterm-256color", "COLORTERM": "truecolor"}
    process = subprocess.Popen(
        [sys.executable, "-c", *command], stdin=theirs, stdout=theirs, stderr=theirs, env=environment
    )
    try:
        yield ours
    finally:
        process.kill()
        process.wait()
        os.close(ours)
        os.close(theirs)


def rest(terminal: int, seconds: float, until: str = "") -> str:
    """Read the terminal for so long, or until these words come; return what came."""
    ends_s, seen = time.monotonic() + seconds, ""
    while (left_s := ends_s - time.monotonic()) > 0 and (not until or until not in seen):
        if select.select([terminal], [], [], left_s)[0]:
            seen += os.read(terminal, 65536).decode("utf-8", "replace")
    return seen


class Session:
    """A session's thread that asks answers, and counts how many were confirmed."""

    def __init__(self) -> None:
        self.linked = LinkedConsole(View(study="benchmark", participant="01"))
        self.confirmed: list[str] = []
        self.asks = threading.Event()
        self.asks.set()
        self.answered = 0
        self._pool = ThreadPoolExecutor(1)
        self._pool.submit(self._ask)

    def _ask(self) -> None:
        try:
            while True:
                self.asks.wait()
                key = self.linked.ask(TrialAnswer(len(self.confirmed) + 1, ANSWERS, "n", {})).key
                self.answered += 1
                if self.linked.ask(Confirm(key, ANSWERS.get(key, key))).key == ENTER:
                    self.confirmed.append(key)
        except PauseAsked:
            pass


@contextmanager
def at_console() -> Iterator[tuple[Session, int]]:
    """Have a console at the socket of a session, and yield both once it is there."""
    with tempfile.TemporaryDirectory() as folder:
        path, session = Path(folder) / "s", Session()
        with closing(Link(path, session.linked)) as link:
            session.linked.wake = link.wake
            with at_terminal(ATTEND, str(path)) as terminal:
                rest(terminal, 30, "material")
                rest(terminal, BEGINS_S)
                yield session, terminal
            session.linked.take(Hello(role="console", by="benchmark"), Stop())


def fluent_at_console(presses: int) -> int:
    """Return how many of these presses of a key and Enter, 100 ms apart, were taken."""
    with at_console() as (session, terminal):
        taken = 0
        for n in range(presses):
            before = len(session.confirmed)
            os.write(terminal, list(ANSWERS)[n % len(ANSWERS)].encode())
            rest(terminal, APART_S)
            os.write(terminal, b"\r")
            ends_s = time.monotonic() + BEGINS_S
            while len(session.confirmed) == before and time.monotonic() < ends_s:
                rest(terminal, 0.01)
            taken += len(session.confirmed) - before
            # So long the next question stands on the screen before its key.
            rest(terminal, EVERY_S)
        return taken


def early_at_console(presses: int) -> tuple[int, int]:
    """Return how many of these keys, pressed while nothing was asked, answered; and of a held key, how many counted."""
    with at_console() as (session, terminal):
        session.asks.clear()
        early = 0
        for _ in range(presses // 100):
            answer(terminal)
            before = session.answered, len(session.confirmed)
            # The question comes right behind them, before they have all been read.
            os.write(terminal, b"bc\rde\rfg\r\r" * 10)
            session.asks.set()
            session.asks.clear()
            rest(terminal, EVERY_S)
            early += session.answered - before[0] + len(session.confirmed) - before[1]
        answer(terminal)
        session.asks.set()
        rest(terminal, EVERY_S)
        before_held = session.answered
        for _ in range(40):
            os.write(terminal, b"h")
            rest(terminal, 0.03)
        rest(terminal, EVERY_S)
        return early, session.answered - before_held


def answer(terminal: int) -> None:
    """Answer what is asked."""
    os.write(terminal, b"a")
    rest(terminal, EVERY_S)
    os.write(terminal, b"\r")
    rest(terminal, EVERY_S)


def fluent_on_lines(presses: int) -> int:
    """Return how many of these answers, a key and Enter twice, each 100 ms apart, were taken on lines of text."""
    with at_terminal(LINES, str(presses)) as terminal:
        rest(terminal, 30, "material")
        rest(terminal, BEGINS_S)
        seen = ""
        for n in range(presses):
            key = list(ANSWERS)[n % len(ANSWERS)].encode()
            for part in (key, b"\n", key, b"\n"):
                os.write(terminal, part)
                seen += rest(terminal, APART_S)
        seen += rest(terminal, BEGINS_S)
        return seen.count("taken ")


def main(*arguments: str) -> None:
    """Print the figures."""
    presses, early = (20, 200) if "rough" in arguments else (200, 10_000)
    print(
        f"a key and Enter {APART_S * 1e3:g} ms apart, at the console: {fluent_at_console(presses)} of {presses} taken"
    )
    print(f"the same on lines of text: {fluent_on_lines(presses)} of {presses} taken")
    counted, held = early_at_console(early)
    print(f"keys before their question: {counted} of {early} answered; a held key counted {held} times")


if __name__ == "__main__":
    main(*sys.argv[1:])
