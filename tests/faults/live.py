"""A live laboratory: a sealed study, devices in a process of their own, and `palpate` on a pseudo-terminal.

A `Life` is one process of the command. It is forked from this one, which has imported everything and has no thread, so
that its session begins at once; whoever uses this module runs as a script of its own. The experimenter reads the screen
and types; what counts as confirmed is what the screen says.
"""

from __future__ import annotations

import faulthandler
import gc
import json
import os
import pty
import re
import select
import signal
import subprocess
import sys
import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import suppress
from datetime import date, timedelta
from functools import partial
from importlib import import_module
from pathlib import Path
from types import TracebackType
from typing import Any, NoReturn, Self
from unittest import mock

from palpate.experiment.protocol import files
from palpate.experiment.protocol.files import shipped
from palpate.experiment.rehearsal.kinds.footstep import recorded_takes
from palpate.experiment.study.schedule import allocate, find_allocation
from tests.faults.world import BLOCK
from tests.rig.laboratory import write_rig

WARM = (
    "palpate.experiment.__main__",
    "palpate.experiment.apparatus.audio.masker",
    "palpate.experiment.apparatus.panel.pcm",
    "palpate.experiment.apparatus.tracker.serial_tracker",
    "palpate.experiment.cli.app",
    "palpate.experiment.cli.session",
    "palpate.experiment.dataset.build",
    "palpate.experiment.desk.terminal",
    "palpate.experiment.recordings.manifest",
    "palpate.experiment.session.run",
    "palpate.experiment.synthesis.voltages",
    "palpate.experiment.synthesis.waveforms",
    "scipy.fft",
    "scipy.interpolate",
    "serial",
    "serial.serialposix",
)
"""What a session imports while it starts."""

SCREEN = re.compile(
    r"(?P<familiar>\[Enter\] the participant is familiar with the materials[^\n]*: )"
    r"|(?P<agree>\[y\] [^\n]*: )"
    r"|(?P<level>\[Enter\] keep the level: )"
    r"|(?P<lay>\[Enter\] it is laid out: )"
    r"|(?P<armed>Armed: the participant may step\.|may lift the foot and step\.)"
    r"|Trial (?P<asked>\d+)\.  What did the participant say\?\n[^\n]*WHAT WAS DONE: "
    r"|type (?P<confirm>\S) again to confirm, or anything else to choose again: "
    r"|Trial (?P<trial>\d+): answer saved: (?P<answer>[^\n]*)\.\n"
    r"|(?P<write>Type one line, or leave it blank, and press Enter: )"
    r"|(?P<remarks>\[Enter\] end[^\n]*WHAT WAS DONE: )"
    r"|(?P<ended>\[ended -?\d+\])"
)
"""What the experimenter acts on. `asked` and `trial` are numbers of trials, `confirm` is the key to type again."""

KEYS = {"c": "copy paper", "a": "aluminum foil", "p": "polypropylene", "t": "typing paper", "n": "no answer"}

KEPT = 4000
"""Characters of the screen above what the experimenter acted on last."""

PATIENCE_S = 30.0
"""Whoever says nothing for so long hangs."""


class World:
    """The devices, from outside."""

    def __init__(self, folder: Path, *, sound: bool) -> None:
        self._process = subprocess.Popen(
            [sys.executable, "-m", "tests.faults.world", str(folder), *(["sound"] if sound else [])],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            start_new_session=True,
        )
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._told, self.said = self._process.stdin, self._process.stdout
        self._torn = b""
        self._lines: deque[dict[str, Any]] = deque()
        self.heard: list[dict[str, Any]] = []
        """Every stimulus that the panel was given since the list was emptied last."""
        self.named = self._next()

    def do(self, *words: object) -> None:
        """Give a command, and wait until it is done."""
        self.begin(*words)
        while self._next().get("done") != words[0]:
            pass

    def begin(self, *words: object) -> None:
        self._told.write((" ".join(map(str, words)) + "\n").encode())
        self._told.flush()

    def listen(self) -> bool:
        """Take what it has said; return whether the panel heard something."""
        data = os.read(self.said.fileno(), 65536)
        if not data:
            raise RuntimeError("the devices' process has ended")
        *lines, self._torn = (self._torn + data).split(b"\n")
        said = [json.loads(line) for line in lines]
        self._lines.extend(said)
        heard = [one for one in said if "heard" in one]
        self.heard += heard
        return bool(heard)

    def _next(self) -> dict[str, Any]:
        while not self._lines:
            self.listen()
        return self._lines.popleft()

    def close(self) -> None:
        self._told.close()
        self._process.wait(20)
        self.said.close()


class Life:
    """One process of palpate on a pseudo-terminal, from its fork to its end."""

    def __init__(self, world: World, run: Callable[[], object], *, piped: bool = False) -> None:
        """Fork; `piped` has standard output lead into a pipe instead, which can be closed."""
        self._world = world
        self._out, into = os.pipe() if piped else (-1, -1)
        self.text = ""
        self._at = 0
        self.status: int | None = None
        """As `os.waitpid` gives it; None while it lives."""
        # Ctrl-C is meant for the command: it is held back until that has begun, and nothing is typed before the
        # terminal knows whom to interrupt.
        before = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])
        try:
            self.pid, self._terminal = pty.fork()
            if self.pid == 0:
                if piped:
                    os.dup2(into, 1)
                _child(run)
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)
        ended = os.WEXITED | os.WNOHANG | os.WNOWAIT
        while os.tcgetpgrp(self._terminal) != self.pid and os.waitid(os.P_PID, self.pid, ended) is None:
            time.sleep(0.0005)
        if piped:
            os.close(into)

    def type(self, text: str) -> None:
        with suppress(OSError):
            os.write(self._terminal, text.encode())

    def next(self, until_s: float) -> re.Match[str] | str:
        """Return what the experimenter acts on next, "heard", "end" or, at that moment of the clock, "late"."""
        while True:
            if (found := SCREEN.search(self.text, self._at)) is not None:
                self._at = found.end()
                return found
            if self.status is not None:
                return "end"
            read = [self._terminal, self._world.said.fileno(), *([self._out] if self._out >= 0 else [])]
            ready, _, _ = select.select(read, [], [], max(until_s - time.monotonic(), 0.0))
            if not ready:
                return "late"
            if self._out in ready:
                self._read_pipe()
            elif self._terminal in ready:
                self._read()
            elif self._world.listen():
                return "heard"

    def kill(self, number: int = signal.SIGKILL) -> None:
        os.kill(self.pid, number)

    def hang_up(self) -> None:
        """Close the terminal, as a window that is closed does."""
        os.close(self._terminal)
        self._terminal = os.open(os.devnull, os.O_RDONLY)

    def close_out(self) -> None:
        """Close the far end of the pipe that standard output leads into."""
        os.close(self._out)
        self._out = -1

    def _read(self) -> None:
        try:
            data = os.read(self._terminal, 65536)
        except OSError:
            data = b""
        if data:
            self._show(data)
            return
        _, self.status = os.waitpid(self.pid, 0)
        os.close(self._terminal)
        while self._out >= 0:
            self._read_pipe()

    def _read_pipe(self) -> None:
        data = os.read(self._out, 65536)
        self._show(data)
        if not data:
            self.close_out()

    def _show(self, data: bytes) -> None:
        # Little is kept of what was seen before, however long the session.
        gone = max(self._at - KEPT, 0)
        self.text = self.text[gone:] + data.decode("utf-8", "replace").replace("\r", "")
        self._at -= gone


def _child(run: Callable[[], object]) -> NoReturn:
    """What the forked process does: nothing of its parent's is open, and it ends here."""
    code = 1
    try:
        os.closerange(3, 256)
        # Whoever runs the campaign by `nohup`, or in the background of a shell, has it ignore these.
        signal.signal(signal.SIGHUP, signal.SIG_DFL)
        signal.signal(signal.SIGINT, signal.default_int_handler)
        sys.stdin, sys.stdout, sys.stderr = (os.fdopen(n, mode, 1, closefd=False) for n, mode in enumerate("rww"))
        # A library that crashes says where, on the screen that is kept.
        faulthandler.enable()
        # From within `palpate.experiment.__main__`, which tells of an interrupt.
        command = import_module("palpate.experiment.cli.app")
        mock.patch.object(command, "main", partial(_interruptible, command.main)).start()
        run()
        code = 0
    except SystemExit as end:
        code = int(end.code or 0)
    except BaseException as error:
        # The terminal may be gone.
        with suppress(OSError):
            os.write(2, f"FAULT {type(error).__name__}: {error}\n".encode())
    finally:
        with suppress(BaseException):
            sys.stdout.flush()
        os._exit(code)


def _interruptible(command: Callable[[], None]) -> None:
    signal.pthread_sigmask(signal.SIG_UNBLOCK, [signal.SIGINT])
    command()


def palpate(*arguments: object) -> None:
    """The command, in this process."""
    sys.argv = ["palpate", *map(str, arguments)]
    import_module("palpate.experiment.__main__").main()


def rig_of(world: World, folder: Path) -> Path:
    """Write the rig file of devices into a folder."""
    port, address = (f'"{world.named[name]}"' for name in ("port", "address"))
    return write_rig(folder, "rehearsal", port=port, address=address)


class Laboratory:
    """A folder with study, seal, rig file and recordings, beside the devices that the rig file names."""

    def __init__(self, folder: Path, *, repetitions: int, sound: bool = False) -> None:
        folder.mkdir(parents=True)
        self.folder = folder
        self.study = folder / "study.toml"
        text = shipped("okamoto2012.toml").read_text("utf-8")
        for old, new in (
            ("min_s = 180", "min_s = 0"),
            ("break_min_s = 300", "break_min_s = 0"),
            ("limit = 36", "limit = 1"),
            # Few takes, so that a session begins soon.
            ("takes = 3", "takes = 1"),
            ("speeds_mm_s = [50, 100, 200, 300]", "speeds_mm_s = [50, 300]"),
            ("repetitions = 10", f"repetitions = {repetitions}"),
        ):
            assert old in text, old
            text = text.replace(old, new)
        self.study.write_text(text, "utf-8")
        self.protocol = files.load(self.study)
        self.recordings = folder / "recordings"
        manifest = recorded_takes.make_recordings(self.recordings, protocol=self.protocol, seed=1)
        # From here on they stand in for a laboratory's own.
        manifest.write_text(manifest.read_text("utf-8").replace("simulated = true", "simulated = false"), "utf-8")
        self.world = World(folder, sound=sound)
        self.rig = rig_of(self.world, folder)
        if sound:
            os.environ |= {"JACK_DEFAULT_SERVER": self.world.named["server"], "JACK_NO_START_SERVER": "1"}
            audio = shipped("rigs/headless.toml").read_text("utf-8").partition("\n[audio]")[2]
            audio = re.sub(r"calibrated_on = \S+", f"calibrated_on = {date.today()}", audio)
            audio = audio.replace('device = "rehearsal"', 'device = "system"').replace(
                "block = 128", f"block = {BLOCK}"
            )
            self.rig.write_text(self.rig.read_text("utf-8") + "\n[audio]" + audio, "utf-8")
        for module in WARM:
            import_module(module)
        gc.collect()
        gc.freeze()
        today = date.today()
        approval = ["--approved-on", today, "--expires-on", today + timedelta(9)]
        self.call("seal", self.study, "--approval-number", "17", *approval)

    def call(self, *arguments: object) -> str:
        """Run a command that asks for nothing, and return what it printed."""
        life = Life(self.world, lambda: palpate(*arguments))
        while life.next(time.monotonic() + PATIENCE_S) != "end":
            pass
        if life.status != 0:
            raise RuntimeError(f"palpate {arguments[0]}: {life.text}")
        return life.text

    def enrol(self, dataset: Path, participant: str, seed: int) -> tuple[str, ...]:
        """Enrol the next participant of a dataset, and return the tasks in order."""
        first = ["--seed", seed] if not dataset.exists() else []
        self.call("enrol", self.study, "-p", participant, "--consent-on", date.today(), "--dataset", dataset, *first)
        return find_allocation(allocate(self.protocol, seed), participant).tasks

    def command(self, dataset: Path, participant: str, task: str, rig: Path | None = None) -> list[str]:
        """Return the arguments that begin or continue a session, on the laboratory's rig or another."""
        where = ["--rig", rig or self.rig, "--dataset", dataset, "--recordings", self.recordings, "--lines"]
        return [str(word) for word in ("run", self.study, "-p", participant, "--task", task, *where)]

    def datasets(self) -> Iterator[Path]:
        """Name one new dataset after the other."""
        return (self.folder / f"dataset-{number}" for number in range(10**6))

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.world.close()
