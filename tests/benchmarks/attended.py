"""A desk as it stands in a laboratory, for benchmarks: a console, the participant's screen, a microphone, all open.

The console is a process of its own on a pseudo-terminal, and the participant's screen one with a window on an X server
of its own; both hang on the session's socket, which tells what is measured ten times a second. Where there are no Xvfb
and no PsychoPy, the screen is missing, and `DESK` says so.
"""

from __future__ import annotations

import fcntl
import importlib.util
import os
import pty
import shutil
import struct
import subprocess
import sys
import termios
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, closing, contextmanager
from pathlib import Path

import numpy as np

from palpate.experiment.apparatus.audio.stream import AudioStream
from palpate.experiment.apparatus.rig import Rig
from palpate.experiment.clock import Clock, monotonic_ns
from palpate.experiment.desk.link import Link
from palpate.experiment.desk.link.wire import View
from palpate.experiment.desk.linked import LinkedConsole
from palpate.experiment.desk.messages import Gauges, Lamp, Prompt
from palpate.experiment.desk.questions import Console, Remark
from palpate.experiment.desk.voice import ear as ears
from palpate.experiment.desk.voice.ear import Ear
from palpate.experiment.desk.voice.matching import enrolled
from palpate.experiment.records.progress import Progress
from tests.benchmarks.console import ATTEND
from tests.benchmarks.pictures import display
from tests.experiment.desk.attended import done

OPENS_S = 60.0
MOVES_S, HEIGHTS = 3.0, 90
FRAMES = (40, 12)
"""Of a take, with the numbers of each."""


class Moving:
    """Implements `Attended`: what is measured changes all the time."""

    def __init__(self, ear: Ear | None) -> None:
        self._ear = ear

    def gauges(self) -> Gauges:
        heights = 40 + 40 * np.sin(monotonic_ns() / 1e9 + np.linspace(0, MOVES_S, HEIGHTS))
        lamps = (self._ear.lamp(),) if self._ear is not None else ()
        ours = (Lamp(name="tracker", good=True, words="1000 Hz"), *lamps)
        return Gauges(left_s=3000.0, trace=tuple(heights.tolist()), trace_unit="mm", last="200 mm/s", lamps=ours)

    def done(self) -> Progress:
        return done("REHEARSAL", trials=40, answered=3)

    def remark(self, remark: Remark) -> tuple[bool, str]:
        raise AssertionError(f"nobody said {remark}")

    def pause(self, why: str) -> None:
        raise AssertionError(why)

    def commanded(self, *, by: str, command: str, taken: bool, words: str) -> None:
        """Keep no record: nobody commands."""

    def shown(self, prompt: Prompt, ago_ns: int) -> None:
        """Keep no record of what is shown."""


class Desk:
    """Both processes, how many of them there are, and what a session asks there."""

    def __init__(self, console: LinkedConsole, *, screen: bool) -> None:
        self.console: Console = console
        self.says = "console and screen" if screen else "console alone (no Xvfb, or no PsychoPy)"
        self._linked = console

    def attend(self, ear: Ear | None) -> None:
        """Have a session attended whose microphone is listened to by this ear."""
        self._linked.attend(Moving(ear))


@contextmanager
def desk(folder: Path) -> Iterator[Desk]:
    """Open the console and the participant's screen at a socket in a folder, and yield the desk once both are there."""
    linked = LinkedConsole(View(study="benchmark", participant="01"))
    with ExitStack() as opened:
        path = folder / "desk"
        there = opened.enter_context(closing(Link(path, linked)))
        linked.wake = there.wake
        linked.attend(Moving(None))
        ours, theirs = pty.openpty()
        opened.callback(os.close, ours)
        opened.callback(os.close, theirs)
        fcntl.ioctl(theirs, termios.TIOCSWINSZ, struct.pack("HHHH", 24, 80, 0, 0))
        environment = {**os.environ, "TERM": "xterm-256color", "COLORTERM": "truecolor"}
        _started([sys.executable, "-c", ATTEND, str(path)], environment, opened, terminal=theirs)
        threading.Thread(target=_drained, args=(ours,), daemon=True).start()
        seen = shutil.which("Xvfb") is not None and importlib.util.find_spec("psychopy") is not None
        if seen:
            name = opened.enter_context(display())
            environment = {**os.environ, "DISPLAY": str(name), "HOME": str(folder)}
            command = [sys.executable, "-m", "palpate.experiment", "screen", "okamoto2012", "--session-at", str(path)]
            _started(command, environment, opened)
        ends_s = time.monotonic() + OPENS_S
        while (linked._consoles, linked._screens) != (1, int(seen)):
            if time.monotonic() > ends_s:
                raise TimeoutError("the console or the participant's screen did not open")
            time.sleep(0.05)
        yield Desk(linked, screen=seen)


@contextmanager
def listening(rig: Rig, stream: AudioStream, clock: Clock, desk: Desk) -> Iterator[Ear]:
    """Listen to the rig's microphone as a session does that compares what it hears with an enrolment."""
    microphone = ears.open_microphone(rig, stream=stream)
    if microphone is None:
        raise ValueError("the rig has no microphone")
    with ears.computing() as computing:
        ear = Ear(
            microphone=microphone,
            computing=computing,
            console=desk.console,
            clock=clock,
            write=lambda _: None,
            task="virtual",
            voices=None,
        )
        rng = np.random.default_rng(0)
        words = ("copy paper", "aluminum foil", "typing paper", "polypropylene")
        # Nobody speaks; what is compared is as much as that of four words said twice.
        sounds = {word: rng.normal(size=FRAMES) for word in words}
        ear.enrolment = enrolled({word: [said, said + rng.normal(0, 0.01, FRAMES)] for word, said in sounds.items()})
        desk.attend(ear)
        try:
            yield ear
        finally:
            ear.close()


def _started(
    command: list[str], environment: dict[str, str], opened: ExitStack, *, terminal: int | None = None
) -> None:
    ends = subprocess.DEVNULL if terminal is None else terminal
    process = subprocess.Popen(command, stdin=ends, stdout=ends, stderr=ends, env=environment)
    opened.callback(process.wait)
    opened.callback(process.kill)


def _drained(terminal: int) -> None:
    """Read what a console draws, as its terminal would."""
    try:
        while os.read(terminal, 65536):
            pass
    except OSError:
        return
