"""How soon the console answers a key: run `python -m tests.benchmarks.console`.

A console runs on a pseudo-terminal of 80 x 24, as a process of its own, at a link whose view changes ten times a
second. A key is written to the terminal; the session's end takes it and asks the next question; the time is that until
the question's words come out of the terminal. First as the machine is, then with every core kept busy by another
process.

Not a test: it asserts nothing, because these figures belong to the machine that printed them.
"""

from __future__ import annotations

import fcntl
import multiprocessing
import os
import pty
import select
import statistics
import struct
import subprocess
import sys
import tempfile
import termios
import time
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

from palpate.experiment.desk.link import Link
from palpate.experiment.desk.link.wire import Asked, Choose, Deed, Hello, View
from palpate.experiment.desk.messages import Choice, Gauges, Message

KEYS = "abcdefghijkl"
"""Each comes again after more than a second, so that none counts as held."""
BEGINS_S, EVERY_S = 2.0, 0.25
PRESSES = 200

ATTEND = """
import sys
from pathlib import Path
from palpate.experiment.desk.console.app import attend
from palpate.experiment.desk.link.wire import Hello
attend(Path(sys.argv[1]), Hello(role="console", by="benchmark"))
"""


class Asking:
    """Implements `SessionEnd`: asks one question after the other, and moves all the time."""

    def __init__(self) -> None:
        self.number = 0
        self._told = 0
        self.wake: Callable[[], None] = lambda: None

    def message(self, role: str) -> Message:
        self._told += 1
        choices = tuple(Choice(key=key, words=f"material {key}", answer=True) for key in KEYS)
        trace = tuple(float((self._told + step) % 60) for step in range(90))
        return View(
            study="benchmark",
            trial=self.number + 1,
            question=Asked(number=self.number, kind="answer", text=f"question{self.number:04d}", choices=choices),
            gauges=Gauges(left_s=3000 - self._told / 10, trace=trace, trace_unit="mm", last=f"{self._told} mm/s"),
        )

    def take(self, hello: Hello, deed: Deed) -> tuple[bool, str]:
        if isinstance(deed, Choose):
            self.number += 1
            self.wake()
        return True, ""

    def came(self, consoles: int, screens: int) -> None:
        pass

    def lost(self, why: str) -> None:
        raise AssertionError(why)


def measured() -> list[float]:
    """Return how long each press took, s."""
    with tempfile.TemporaryDirectory() as folder:
        path, end = Path(folder) / "s", Asking()
        ours, theirs = pty.openpty()
        fcntl.ioctl(theirs, termios.TIOCSWINSZ, struct.pack("HHHH", 24, 80, 0, 0))
        with closing(Link(path, end)) as link:
            end.wake = link.wake
            environment = {**os.environ, "TERM": "xterm-256color", "COLORTERM": "truecolor"}
            process = subprocess.Popen(
                [sys.executable, "-c", ATTEND, str(path)], stdin=theirs, stdout=theirs, stderr=theirs, env=environment
            )
            try:
                _until(ours, "question0000")
                _rest(ours, BEGINS_S)
                return [_pressed(ours, end) for _ in range(PRESSES)]
            finally:
                process.kill()
                process.wait()
                os.close(ours)
                os.close(theirs)


def _pressed(terminal: int, end: Asking) -> float:
    _rest(terminal, EVERY_S)
    number = end.number
    begun_s = time.monotonic()
    os.write(terminal, KEYS[number % len(KEYS)].encode())
    _until(terminal, f"question{number + 1:04d}")
    return time.monotonic() - begun_s


def _rest(terminal: int, seconds: float) -> None:
    rests_s = time.monotonic() + seconds
    while (left_s := rests_s - time.monotonic()) > 0:
        if select.select([terminal], [], [], left_s)[0]:
            os.read(terminal, 65536)


def _until(terminal: int, words: str) -> None:
    seen = ""
    while words not in seen:
        if not select.select([terminal], [], [], 30)[0]:
            raise TimeoutError(f"{words} did not come: {seen[-2000:]!r}")
        seen += os.read(terminal, 65536).decode("utf-8", "replace")


def _busy() -> None:
    while True:
        pass


def main() -> None:
    """Print the figures."""
    for load in (0, os.cpu_count() or 1):
        others = [multiprocessing.Process(target=_busy, daemon=True) for _ in range(load)]
        for other in others:
            other.start()
        taken_ms = sorted(1e3 * one for one in measured())
        for other in others:
            other.terminate()
        median, most = statistics.median(taken_ms), taken_ms[int(0.95 * len(taken_ms))]
        print(
            f"{load} busy processes beside it: median {median:.0f} ms, 95th percentile {most:.0f} ms, "
            f"longest {taken_ms[-1]:.0f} ms, of {len(taken_ms)}"
        )


if __name__ == "__main__":
    main()
