"""Triggers of a session: what happens in it is sent, by a number, on the lines that a rig names.

A line has a thread of its own, and nothing waits for it: one that is slow, hangs or is lost delays no trial. A stimulus
is sent at its onset, once the actuator has it and can no longer take it back. What was sent, how long after its event,
and what was not, goes on record before the next trial is armed and before the session ends.
"""

from __future__ import annotations

import importlib
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from typing import TYPE_CHECKING, Any, Protocol, cast

from palpate.experiment.apparatus import host
from palpate.experiment.apparatus.ports import Actuator
from palpate.experiment.apparatus.wires.own.loading import driver_module
from palpate.experiment.apparatus.wires.settings import LSL, TTL, TriggerRig
from palpate.experiment.clock import Clock
from palpate.experiment.errors import PalpateError, RigError
from palpate.experiment.records import entries
from palpate.experiment.records.entries import Entry, Trigger, Triggers

if TYPE_CHECKING:
    from palpate.experiment.apparatus.panel.conditioning import Played
    from palpate.experiment.apparatus.rig import Rig
    from palpate.experiment.synthesis.waveforms import Waveform

TEST = 255
"""The number that `palpate doctor` sends, and no event has."""

ENDS_S = 1.0
"""So long the end of a session waits for its lines, s."""

HANGS_NS, HANGS = 1_000_000_000, "the line does not respond"
"""A line that has not sent for so long is lost, and what is due for so long is not sent any more, ns."""

DRIVERS = {
    LSL: "palpate.experiment.apparatus.wires.lsl:LslTrigger",
    TTL: "palpate.experiment.apparatus.wires.ttl:SerialTrigger",
}

EXTRA = 'install the extra `lsl`: python -m pip install "palpate[lsl]"'


class TriggerLine(Protocol):
    """What a driver does, which is made with its table of the rig; a fault of any kind is a trigger that was lost."""

    def send(self, number: int, late_s: float) -> None:
        """Send a number now; its event was `late_s` ago, for lines that carry times."""

    def close(self) -> None:
        """Let go of the line."""


def described(settings: TriggerRig) -> str:
    """Return in words where a line goes and what it sends, for whoever judges a rig."""
    where = f"the driver {settings.driver}"
    if settings.driver == TTL:
        where = f"a byte on the serial line {settings.port}"
    elif settings.driver == LSL:
        seen = f"announced on interface {settings.interface}" if settings.interface else "announced on this computer"
        where = f"the Lab Streaming Layer stream '{settings.stream}', {seen}"
    events = settings.events.model_dump(exclude_none=True)
    return f"{where}: {', '.join(f'{event} {number}' for event, number in events.items())}; no labels or answers"


def board_words(rig: Rig) -> str:
    """Return in words what the board reads of a rig's triggers."""
    lines = [described(one) for one in rig.triggers or ()]
    told = " ".join(f"Trigger line {number} is {one}." for number, one in enumerate(lines, start=1))
    streams = any(one.driver == LSL for one in rig.triggers or ())
    port = " liblsl accepts connections from any computer on the network; use a firewall." if streams else ""
    return f"Rig '{rig.rig.name}' sends triggers to other devices as events happen. {told}{port}"


def open_line(rig: Rig, number: int) -> TriggerLine:
    """Open a rig's line by its number from 1. Raises `RigError` for a driver, and what else is no line's."""
    settings = (rig.triggers or ())[number - 1]
    named = DRIVERS.get(settings.driver, settings.driver)
    module, _, name = named.partition(":")
    try:
        file = rig.driver_file(settings.driver)
        found = driver_module(file) if file is not None else importlib.import_module(module)
        return cast("TriggerLine", getattr(found, name)(settings))
    except (Exception, SystemExit) as error:  # a driver may raise anything
        remedy = (
            EXTRA if isinstance(error, ImportError) and error.name == "pylsl" else "plug it in, or correct the rig file"
        )
        what = error.finding.observation() if isinstance(error, PalpateError) else _words(error)
        raise RigError(f"trigger line {number}", f"{described(settings)}: {what}", remedy) from error


def open_triggers(rig: Rig, clock: Clock, tell: Callable[[str], None], opened: ExitStack) -> SessionTriggers:
    """Open every line of a rig until `opened` closes, and report what is lost on the way. Raises `RigError`."""
    lines = []
    for number, settings in enumerate(rig.triggers or (), start=1):
        line = _Line(number, settings, open_line(rig, number), clock, tell)
        opened.callback(line.close)
        lines.append(line)
    return SessionTriggers(lines, clock)


class SessionTriggers:
    """The lines of one session, which follow what it puts on record and what its actuator plays."""

    def __init__(self, lines: Sequence[_Line], clock: Clock) -> None:
        self._lines, self._clock = lines, clock
        self._armed = False

    def before(self, entry: Entry) -> tuple[Triggers, ...]:
        """Return what goes on record before an entry: what was sent since; a session that ends is sent first."""
        if isinstance(entry, entries.Footer):
            self.put("pause" if entry.reason == "paused" else "end", self._clock.now_ns())
            for line in self._lines:
                line.settle(ENDS_S)
        elif not isinstance(entry, entries.Armed):
            return ()
        sent = tuple(one for line in self._lines for one in line.take())
        return (Triggers(sent=sent),) if sent else ()

    def after(self, entry: Entry) -> None:
        """Send what an entry that is on record stands for."""
        now_ns = self._clock.now_ns()
        match entry:
            case entries.Header() | entries.Resumed():
                self.put("start", now_ns)
            case entries.Armed():
                self._armed = True
                self.put("trial", now_ns)
            case entries.Answer():
                self._armed = False
                self.put("answer", now_ns)
            case entries.Redo():
                self._armed = False

    def put(self, event: str, due_ns: int) -> None:
        """Have every line send an event at the session time `due_ns`."""
        for line in self._lines:
            line.put(event, due_ns)

    def stimulus(self, due_ns: int) -> None:
        """Have the stimulus of a trial sent at its onset."""
        if self._armed:
            self.put("stimulus", due_ns)

    def take_back(self) -> list[_Line]:
        """Take back the stimulus that is not due yet; return the lines that had one."""
        return [line for line in self._lines if line.withdraw("stimulus")]

    def following(self, actuator: Actuator) -> Actuator:
        """Return an actuator whose stimuli are sent."""
        return cast("Actuator", _Followed(actuator, self, self._clock))


class _Followed:
    """An actuator, and the triggers of what it plays; none is due while it decides whether it still can."""

    def __init__(self, actuator: Actuator, triggers: SessionTriggers, clock: Clock) -> None:
        self._actuator, self._triggers, self._clock = actuator, triggers, clock
        self._onset_ns: int | None = None

    def prepare(self, stimulus: Waveform) -> Played:
        self._triggers.take_back()
        self._onset_ns = None
        return self._actuator.prepare(stimulus)

    def aim(self, onset_ns: int) -> bool:
        lines = self._triggers.take_back()
        aimed = self._actuator.aim(onset_ns)
        if aimed and self._actuator.lead_ns:
            self._onset_ns = onset_ns
            self._triggers.stimulus(onset_ns)
        else:
            self._put_back(lines)
        return aimed

    def landed(self, contact_ns: int) -> None:
        self._actuator.landed(contact_ns)
        if self._onset_ns is None:
            # What an audio card is given now is heard after its buffers.
            self._onset_ns = self._clock.now_ns() + self._actuator.lead_ns
            self._triggers.stimulus(self._onset_ns)

    def withdraw(self) -> bool:
        lines = self._triggers.take_back()
        silent = self._actuator.withdraw()
        if not silent:
            self._put_back(lines)
        return silent

    def _put_back(self, lines: Sequence[_Line]) -> None:
        for line in lines:
            if self._onset_ns is not None:
                line.put("stimulus", self._onset_ns)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._actuator, name)


class _Line:
    """One line and its thread."""

    def __init__(
        self, number: int, settings: TriggerRig, driver: TriggerLine, clock: Clock, tell: Callable[[str], None]
    ) -> None:
        self._number, self._driver, self._clock, self._tell = number, driver, clock, tell
        self._numbers: dict[str, int] = settings.events.model_dump(exclude_none=True)
        self._due: list[tuple[int, str]] = []
        self._sending: tuple[int, str] | None = None
        self._sent: list[Trigger] = []
        self._hung = self._lost = self._closing = False
        self._changed = threading.Condition()
        name = f"trigger line {number}"
        self._thread = threading.Thread(target=self._run, args=(host.joining(),), name=name, daemon=True)
        with host.elsewhere():
            self._thread.start()

    def put(self, event: str, due_ns: int) -> None:
        with self._changed:
            if event in self._numbers:
                self._due = sorted([*self._due, (due_ns, event)], key=lambda one: one[0])
                self._changed.notify_all()

    def withdraw(self, event: str) -> bool:
        """Take back what is not due yet; return whether there was any."""
        with self._changed:
            now_ns, before = self._clock.now_ns(), len(self._due)
            self._due = [one for one in self._due if one[1] != event or one[0] <= now_ns]
            return len(self._due) < before

    def settle(self, timeout_s: float) -> None:
        """Wait until nothing is left to send, but no longer than this."""
        with self._changed:
            self._changed.wait_for(lambda: not self._due and self._sending is None, timeout_s)

    def take(self) -> tuple[Trigger, ...]:
        """Return what was sent or lost since the last call; what hangs is lost."""
        with self._changed:
            now_ns = self._clock.now_ns()
            hanging = [self._sending] if self._sending is not None and not self._hung else []
            hanging = [one for one in hanging if one[0] <= now_ns - HANGS_NS]
            self._hung = self._hung or bool(hanging)
            if self._hung:
                hanging += [one for one in self._due if one[0] <= now_ns]
                self._due = [one for one in self._due if one[0] > now_ns]
                newly, self._lost = not self._lost, True
                if newly:
                    # Whoever asks holds the journal.
                    threading.Thread(target=self._complain, args=(HANGS,), daemon=True).start()
            lost = [self._record(*one, None, HANGS) for one in hanging]
            sent, self._sent = [*self._sent, *lost], []
        return tuple(sent)

    def close(self) -> None:
        """Send no more. A driver that hangs is left behind."""
        with self._changed:
            self._closing = True
            self._changed.notify_all()
        self._thread.join(ENDS_S)

    def _run(self, join: Callable[[], None]) -> None:
        join()
        try:
            for due_ns, event in self._upcoming():
                self._send(due_ns, event)
        finally:
            try:
                self._driver.close()
            except (Exception, SystemExit) as error:  # a driver may raise anything
                self._tell(f"Trigger line {self._number} did not close: {_words(error)}.")

    def _upcoming(self) -> Iterator[tuple[int, str]]:
        """Yield events as they are due, until the line closes."""
        while True:
            with self._changed:
                while not self._closing:
                    left_ns = self._due[0][0] - self._clock.now_ns() if self._due else None
                    if left_ns is not None and left_ns <= 0:
                        break
                    self._changed.wait(None if left_ns is None else left_ns / 1e9)
                else:
                    return
                self._sending = self._due.pop(0)
                one = self._sending
            yield one

    def _send(self, due_ns: int, event: str) -> None:
        late_ns = self._clock.now_ns() - due_ns
        problem = HANGS if late_ns >= HANGS_NS else ""
        try:
            if not problem:
                self._driver.send(self._numbers[event], late_ns / 1e9)
        except (Exception, SystemExit) as error:  # a driver may raise anything, and the session goes on
            problem = _words(error)
        # A byte that waited in the driver left when it returned.
        late_ms = None if problem else (self._clock.now_ns() - due_ns) / 1e6
        with self._changed:
            if self._hung:  # It is on record as lost.
                problem = HANGS
            else:
                self._sent.append(self._record(due_ns, event, late_ms, problem))
            self._sending, self._hung = None, False
            newly, self._lost = bool(problem) and not self._lost, bool(problem)
            self._changed.notify_all()
        if newly:
            self._complain(problem)

    def _complain(self, problem: str) -> None:
        what = f"Trigger line {self._number} is lost: {problem}."
        self._tell(f"{what} The session continues without it; the journal records the triggers that were not sent.")

    def _record(self, due_ns: int, event: str, late_ms: float | None, problem: str) -> Trigger:
        number = self._numbers[event]
        return Trigger(line=self._number, event=event, number=number, due_ns=due_ns, late_ms=late_ms, problem=problem)


def _words(error: BaseException) -> str:
    return f"{type(error).__name__}: {' '.join(str(error).split())}".removesuffix(": ")[:200]
