"""A practiced session whose parts can be made to stand still; what is heard, felt and shown then, seen from outside.

The session is a process of its own, SIMULATED but for itself: a sound server that waits for nobody, a force device that
keeps what it pushed, and a hand at the far end of the tracker's line, moved from here, that rests inside of the block.
What leaves the sound card is heard here, by another client of its server.
"""

from __future__ import annotations

import ctypes
import os
import pty
import re
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, suppress
from functools import partial
from multiprocessing.process import BaseProcess
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest import mock

import numpy as np

from palpate.experiment import storage
from palpate.experiment.apparatus import rig as rigs
from palpate.experiment.apparatus.rig import tracker_of
from palpate.experiment.desk import link
from palpate.experiment.desk.console import transport
from palpate.experiment.desk.link.wire import Choose, Pause, Reply, Stop, View
from palpate.experiment.desk.messages import TakeNote
from palpate.experiment.records import journal
from palpate.experiment.rehearsal.wires.foot import Foot, Trajectory
from palpate.experiment.rehearsal.wires.serial_line import SerialLine, SimulatedPedal
from tests.faults.live import KEYS, SCREEN
from tests.rig import visited

PR_SET_PDEATHSIG = 1
"""Of Linux's prctl: the signal at the end of the parent."""

BLOCK = 512
EAR_S = 10.0
"""An ear that the server keeps waiting for so long is begun anew, s."""

QUIET_S = 0.1
"""What stops for less goes on: a force device on a busy machine drops its force for some ms, s."""

PUSHES = np.dtype([("at", "<i8"), ("out", "<f4"), ("along", "<f4"), ("why", "<u4"), ("fast", "<u4")])
"""What the force device keeps, as `force_device` has it."""

HAND_MM, INSIDE_MM, STAYS_S = 8.0, -1.0, 3.0
"""Where the hand waits, where it presses, mm, and how long it stays there each time, s."""

LINES = {"familiar": "familiarise", "level": "masker", "armed": "armed", "asked": "question", "confirm": "confirm"}
"""Steps of a session by what its lines say, as `SCREEN` names that."""

PROGRAMS = {
    "sound server": "jackd",
    "panel": "wires.listener",
    "force device": "wires.force_device",
    "servo": "servo.process",
}
"""The processes of a session by what their command holds."""

PEERS = ("console", "screen")
"""Processes at the socket of a session at a desk, as `peer` has them."""


def pushes_file(folder: Path) -> Path:
    """Return where the force device keeps what it pushed: beside everything that hangs."""
    return folder.parents[1] / f"pushes-{folder.name}"


def give(folder: Path, words: tuple[str, ...], port: str, pedal: str, terminal: str) -> None:
    """Give the command in this process, on a card that waits for nobody, with the hand at `port` and a pedal at
    another; at a `terminal` if one is named.
    """
    # A session that stands still must not outlive whoever watches it.
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
    from palpate.experiment.desk import interrupts
    from palpate.experiment.rehearsal import session
    from palpate.experiment.rehearsal.wires import force_device, sound_card

    started, tracked = sound_card.SoundCard.__init__, session.SimulatedEnds.tracker

    def card(self: Any, **asked: Any) -> None:
        started(self, **asked | {"exact": False})

    def tracker(self: Any, opened: ExitStack) -> Any:
        own, clock = tracked(self, opened)
        return port or own, clock

    recorded = partial(force_device.ForceDeviceProcess, pushes_file(folder))
    mock.patch.object(force_device, "ForceDeviceProcess", recorded).start()
    # It is no worker here: a signal is for the session to take.
    mock.patch.object(interrupts, "multiprocessing", SimpleNamespace(parent_process=lambda: None)).start()
    mock.patch.object(session.SimulatedEnds, "pedal", return_value=pedal).start()
    mock.patch.object(session.SimulatedEnds, "tracker", tracker).start()
    mock.patch.object(sound_card.SoundCard, "__init__", card).start()
    visited.give_command(folder, words, simulated=False, terminal=terminal)


class Hand:
    """A process that rests above the block, and presses again and again from `press` on, whatever the session does."""

    def __init__(self, rig: Path) -> None:
        self._process = subprocess.Popen(
            [sys.executable, "-m", "tests.faults.standing", str(rig)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
        )
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._told = self._process.stdin
        self.port = self._process.stdout.readline().decode().strip()

    def press(self) -> None:
        self._told.write(b"press\n")
        self._told.flush()

    def close(self) -> None:
        self._process.kill()
        self._process.communicate()


def press(rig: Path) -> None:
    """Be a hand above the tracker of a rig, and say at which port; press once a line has come."""
    with suppress(PermissionError):
        os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(1))
    tracker = tracker_of(rigs.load(rig))
    us = np.cumsum([0.0, 0.15, STAYS_S, 0.15, 0.15]) * 1e6
    mm = np.array([HAND_MM, INSIDE_MM, INSIDE_MM, HAND_MM, HAND_MM])
    with SerialLine() as line:
        quiet, tick_s = tracker.noise_mm or 0.0, 1 / tracker.rate_hz
        foot = Foot(line, tracker, real_time=True, rest_mm=HAND_MM, noise_mm=quiet, tick_s=tick_s)
        sys.stdout.write(f"{line.url}\n")
        sys.stdout.flush()
        sys.stdin.readline()
        while True:
            # A block is there for a hand alone that comes from above.
            foot.step(Trajectory(us, mm, 0.0, 0.0, 1e5, float(us[3]), 60.0, "none", 0), 0)
            time.sleep(float(us[-1]) / 1e6)


class Ear:
    """A process that hears every output of the session's sound card: when each was loud last, and when it began to be.

    What lasts for less than `QUIET_S` only begins: blocks that were under way when their process was stopped come when
    it goes on.
    """

    def __init__(self, server: str) -> None:
        # A client of a server that has stood still may wait for it for ever, and is killed.
        self._process = subprocess.Popen([sys.executable, "-m", "tests.faults.ear", server], stdout=subprocess.PIPE)
        self.last_s: dict[int, float] = {}
        """By channel, from 0: when the last loud block was heard of what lasted for `QUIET_S` or more."""
        self.began_s: list[tuple[int, float]] = []
        """Channel, and time at which it was loud after a silence of `QUIET_S` or more."""
        self.listens = False
        self._begins, self._begun_s = True, time.monotonic()
        threading.Thread(target=self._read, daemon=True).start()

    def _read(self) -> None:
        before_s: dict[int, float] = {}
        begun_s: dict[int, float] = {}
        for line in self._process.stdout or ():
            channel, at_s = int(line.split()[0]), float(line.split()[1])
            self._begins = False
            if channel < 0:
                self.listens = channel == -2
                continue
            if at_s - before_s.get(channel, 0.0) > QUIET_S:
                self.began_s.append((channel, at_s))
                begun_s[channel] = at_s
            elif at_s - begun_s[channel] >= QUIET_S:
                self.last_s[channel] = at_s
            before_s[channel] = at_s

    @property
    def failed(self) -> bool:
        """Whether another has to be tried: the server had not begun yet, or keeps this one waiting."""
        late = self._begins and time.monotonic() > self._begun_s + EAR_S
        return late or self._process.poll() is not None

    def close(self) -> None:
        self._process.kill()
        self._process.wait()


class Session:
    """One practiced session, and somebody who keys what is asked until a step is reached: at a desk, or on lines."""

    def __init__(self, folder: Path, study: Path, rig: Path, *, taps: bool) -> None:
        self.folder = folder
        self.ear: Ear | None = None
        self.opened = ExitStack()
        self.said: list[tuple[float, str]] = []
        """What the session showed, and when: lines, and of a desk's views and replies what says how it stands."""
        self.begun_s = float("inf")
        """When the journal's first line was written, monotonic s."""
        # As the session's own clock is anchored.
        self._anchor_ns = time.time_ns() - time.monotonic_ns()
        folder.mkdir(parents=True)
        self.pedal = self.opened.enter_context(SimulatedPedal())
        self._hand = Hand(rig) if taps else None
        if self._hand is not None:
            self.opened.callback(self._hand.close)
        words = ("run", str(study), "--practice", "--rig", str(rig), "--task", "virtual", "--dataset", "data")
        self.process = self.begin(words, self._hand.port if self._hand is not None else "")
        self.opened.callback(self._end)

    def begin(self, words: tuple[str, ...], port: str) -> BaseProcess:
        """Begin the session's process."""
        raise NotImplementedError

    @property
    def step(self) -> str:
        """Where the session is, one of `STEPS`; nothing elsewhere."""
        raise NotImplementedError

    def key(self) -> None:
        """Answer what is asked now, once."""
        raise NotImplementedError

    def note(self) -> None:
        """Have an entry written, where that can be asked for."""

    def ask(self, event: str) -> None:
        """Ask for a pause or a stop; "escape" is the participant's."""
        raise NotImplementedError

    @property
    def answered(self) -> int:
        """How many answers the session has confirmed."""
        raise NotImplementedError

    def reach(self, step: str, within_s: float) -> bool:
        """Key what is asked until a step is reached; return whether it was in time."""
        ends_s = time.monotonic() + within_s
        if self._hand is not None:
            self._hand.press()
        while time.monotonic() < ends_s and self.process.is_alive():
            if self.ear is not None and self.ear.failed:
                self.ear.close()
                self.ear = None
            if self.ear is None and (server := self._server()):
                self.ear = Ear(server)
            if self.begun_s == float("inf") and (lines := self.entries()):
                self.begun_s = (lines[0].t_ns - self._anchor_ns) / 1e9
            heard = self.ear is not None and self.ear.listens
            if self.step == step and heard:
                return True
            if self.step != step:
                self.key()
            time.sleep(0.005)
        return False

    def shown_s(self, words: str, after_s: float) -> float:
        """Return how long after a moment one of the words, a regular expression, was shown first, s; or infinity."""
        found = (at for at, said in tuple(self.said) if at > after_s and re.search(words, said, re.IGNORECASE))
        return min(found, default=float("inf")) - after_s

    def part(self, name: str) -> list[int]:
        """Return the processes of a part, by its name in `PROGRAMS`; "session" is the session's own."""
        return self.processes(PROGRAMS.get(name, ""))

    def processes(self, program: str = "") -> list[int]:
        """Return the session's process, or those below it whose command holds a word."""
        root = self.process.pid or 0
        return [pid for pid in _below(root) if program in _command(pid)] if program else [root]

    def _server(self) -> str:
        """Return the name of the sound server, or nothing while none runs."""
        commands = [_command(pid).split("\0") for pid in self.processes("jackd")]
        return next((words[words.index("-n") + 1] for words in commands if "-n" in words), "")

    def pushes(self, within_s: float) -> bool:
        """Wait until the hand is pushed, now and not before; return whether it is in time."""
        ends_s = time.monotonic() + within_s
        while time.monotonic() < ends_s:
            quiet_s = time.monotonic() - self.pushed_until_s()
            time.sleep(0.05)
            if quiet_s > QUIET_S and self.pushed_until_s() > time.monotonic() - QUIET_S:
                return True
        return False

    def pushed_until_s(self) -> float:
        """Return when the force fell to zero last, monotonic s; infinity while it pushes, 0 if it never did."""
        record = pushes_file(self.folder)
        pushes = np.fromfile(record, PUSHES) if record.exists() else np.zeros(0, PUSHES)
        last = np.flatnonzero((pushes["out"] != 0) | (pushes["along"] != 0))[-1:]
        if not last.size:
            return 0.0
        after = pushes["at"][last[0] + 1 :]
        return float(after[0]) / 1e9 if after.size else float("inf")

    def entries(self) -> tuple[journal.Line, ...]:
        return journal.read_if_begun(storage.journal_path(self.folder / "data", "01", "virtual")).lines

    def close(self) -> None:
        self.opened.close()

    def _end(self) -> None:
        for pid in [*self.processes(), *_below(self.process.pid or 0)]:
            with suppress(OSError):
                os.kill(pid, signal.SIGCONT)
        if self.ear is not None:
            self.ear.close()
        self.process.kill()
        self.process.join(10)


class AtDesk(Session):
    """A session with a console at its socket."""

    view = View()
    _asked = 0

    def begin(self, words: tuple[str, ...], port: str) -> BaseProcess:
        at = self.folder / "s"
        process = visited.servers.Process(
            target=give, args=(self.folder, (*words, "--session-at", str(at)), port, self.pedal.url, ""), daemon=False
        )
        process.start()
        ends_s = time.monotonic() + visited.PATIENCE_S
        while not transport.answers(at):
            if not process.is_alive() or time.monotonic() > ends_s:
                raise RuntimeError((self.folder / "log").read_text("utf-8"))
            time.sleep(0.01)
        self._line = link.Line(at, visited.ME)
        self.opened.callback(self._line.close)
        self._peers = {role: self._begin_peer(at, role) for role in PEERS}
        threading.Thread(target=self._read, daemon=True).start()
        return process

    def _begin_peer(self, at: Path, role: str) -> subprocess.Popen[bytes]:
        command = [sys.executable, "-m", "tests.faults.peer", str(at), role]
        peer = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
        self.opened.callback(peer.communicate)
        self.opened.callback(peer.kill)
        if peer.stdout is not None:
            # A key that is pressed before stops nothing.
            peer.stdout.readline()
        return peer

    def part(self, name: str) -> list[int]:
        return [self._peers[name].pid] if name in self._peers else super().part(name)

    def _read(self) -> None:
        shown = ""
        with suppress(OSError, ValueError):
            for message in self._line.messages():
                if isinstance(message, Reply):
                    self.said.append((time.monotonic(), f"{'taken' if message.taken else 'refused'}: {message.words}"))
                elif isinstance(message, View):
                    self.view = message
                    lamps = message.gauges.lamps if message.gauges is not None else ()
                    bad = [f"lamp {lamp.name}: {lamp.words}" for lamp in lamps if lamp.good is False]
                    now = "\n".join([message.state, *bad, *message.lines])
                    if now != shown:
                        self.said.append((time.monotonic(), now.removeprefix(shown)))
                        shown = now

    @property
    def step(self) -> str:
        asked = self.view.question
        if asked is None:
            return "armed" if self.view.state == "armed" else ""
        return {"level": "masker", "answer": "question"}.get(asked.kind, asked.kind)

    def key(self) -> None:
        asked = self.view.question
        if asked is None or asked.number == self._asked:
            return
        self._asked = asked.number
        keys = [one.key for one in asked.choices if asked.kind != "answer" or one.answer]
        self._line.send(Choose(question=asked.number, key=keys[0] if asked.kind in ("agree", "answer") else "enter"))

    def note(self) -> None:
        self._line.send(TakeNote(text="a note"))

    def ask(self, event: str) -> None:
        if event != "escape":
            self._line.send(Pause() if event == "pause" else Stop())
        elif (keys := self._peers["screen"].stdin) is not None:
            keys.write(b"\n")
            keys.flush()

    @property
    def answered(self) -> int:
        return self.view.standing.answered


class OnLines(Session):
    """A session that asks on lines of text, at a terminal."""

    def begin(self, words: tuple[str, ...], port: str) -> BaseProcess:
        self._ours, theirs = pty.openpty()
        self._text, self._at, self._step, self._key, self._confirmed = "", 0, "", "", 0
        name = os.ttyname(theirs)
        process = visited.servers.Process(
            target=give, args=(self.folder, (*words, "--lines"), port, self.pedal.url, name), daemon=False
        )
        process.start()
        self.opened.callback(os.close, theirs)
        threading.Thread(target=self._read, daemon=True).start()
        return process

    def _read(self) -> None:
        with suppress(OSError):
            while data := os.read(self._ours, 65536):
                text = data.decode("utf-8", "replace").replace("\r", "")
                self.said.append((time.monotonic(), text))
                self._text += text

    @property
    def step(self) -> str:
        while (seen := SCREEN.search(self._text, self._at)) is not None:
            self._at = seen.end()
            self._confirmed += seen["trial"] is not None
            if seen["trial"] is None:
                self._step = LINES.get(seen.lastgroup or "", "other")
                self._key = seen["confirm"] or ("y" if seen["agree"] else next(iter(KEYS)) if seen["asked"] else "")
                if seen["asked"] and self._hand is not None:
                    self._key = "1"
        return self._step

    def key(self) -> None:
        if self._step and self._step != "armed":
            self._step = ""
            os.write(self._ours, f"{self._key}\n".encode())

    def ask(self, event: str) -> None:
        if event == "pause":
            os.write(self._ours, b"\x03")
        else:
            os.kill(self.processes()[0], signal.SIGTERM)

    @property
    def answered(self) -> int:
        _ = self.step
        return self._confirmed


def _command(pid: int) -> str:
    try:
        return (Path("/proc") / str(pid) / "cmdline").read_text("utf-8", "replace")
    except OSError:
        return ""


def _below(root: int) -> Iterator[int]:
    try:
        children = [
            int(one) for task in Path(f"/proc/{root}/task").iterdir() for one in (task / "children").read_text().split()
        ]
    except OSError:
        return
    for child in children:
        yield child
        yield from _below(child)


def with_faults(library: Path, below: Path, hang: Path) -> None:
    """Have every session of this process be one whose file calls can hang; before the first begins."""
    preload = {"LD_PRELOAD": str(library), "FAULT_BELOW": str(below), "FAULT_HANG": str(hang)}
    before = dict(os.environ)
    os.environ.update(preload)
    visited.servers.set_forkserver_preload([*visited.PRELOADED, __name__])
    server = visited.servers.Process(target=sys.exit, args=(0,))
    server.start()
    server.join()
    os.environ.clear()
    os.environ.update(before)


if __name__ == "__main__":
    press(Path(sys.argv[1]))
