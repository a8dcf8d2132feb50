"""What a session does to its participant, watched at every moment: its time and the masker's dose.

Vibrations are counted; the limiter bounds their peak.

In real time one thread looks ten times a second and waits for nobody: it silences everything once the session's time or
the dose is used up, the session pauses, a signal comes, or disk or sound stand still. Another thread writes the
exposure every few seconds, so that a kill loses none of it. In simulated time the session's own questions suffice.
"""

from __future__ import annotations

import socket
import threading
from collections import defaultdict
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from itertools import chain, pairwise
from typing import TYPE_CHECKING

from palpate.experiment.apparatus import host
from palpate.experiment.desk import interrupts
from palpate.experiment.desk.questions import BY_PARTICIPANT, INTERRUPTED, STOPPED, Notice, Stopped
from palpate.experiment.errors import PalpateError, ScreenGone, cause
from palpate.experiment.records.entries import Commanded, Exposure, Footer, Header, MaskerSet, Resumed
from palpate.experiment.session.kind import nothing_more

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Sequence

    from palpate.experiment.apparatus.audio.stream import AudioStream
    from palpate.experiment.clock import Clock
    from palpate.experiment.desk.questions import Console
    from palpate.experiment.records.journal import Contents, Line
    from palpate.experiment.session.kind import Kind, Log
    from palpate.experiment.session.masker import Masking

LOOK_S, LATE_NS = 0.1, 10**9
"""Between two looks, s, and two of a session that did not stand still, ns."""

SLOW_S = 2.0
"""After so long without an answer from the disk the experimenter is told, s."""

SLOW = (
    "The disk is not responding. Answers and notes will be saved when it does. A pause still silences everything "
    "immediately."
)

EVERY_NS = 5 * 10**9
"""Between two entries, ns."""

GONE_S = 5.0
"""After so long without an answer from the disk the exposure ends, s: what is not on record stays bounded."""

GONE = f"the disk did not respond for {GONE_S:g} s"

KILLED_NS = EVERY_NS + int(GONE_S * 1e9) + 500_000_000
"""A killed runner counts as playing its masker for so long after its last line, ns: without one it ends sooner."""

WINDOW_NS = 24 * 3600 * 10**9
"""Doses are added over so long, ns: neither midnight nor a time zone changes them."""


@dataclass(kw_only=True, eq=False)
class Exposed:
    """Implements `Limits` for one runner of a session; nothing is watched before it begins.

    From the session time `ends_ns` on, ns, nothing may be felt, and `ended` says why. `pressed` is as `Pedal` has it,
    and `answered` has the participant's buttons answer.
    """

    ends_ns: int
    ended: str
    masking: Masking | None
    console: Console
    clock: Clock
    log: Log
    stream: AudioStream | None = None
    pressed: Callable[[], bool] | None = None
    answered: Callable[[], None] | None = None

    def __post_init__(self) -> None:
        self._kind: Kind | None = None
        self._over = self._asked = self._skipped = ""
        self._failed: Exception | None = None
        self._told = self._slow = self._stopped = False
        self._due_ns = self._looked_ns = self.clock.now_ns()
        self.free_bytes: int | None = None
        """The free space on the disk when an exposure was written last, bytes; None if the disk did not say."""
        self._writer: threading.Thread | None = None
        self._settled = threading.Event()
        self._closing = False
        self._opened = ExitStack()

    def begin(self, kind: Kind) -> None:
        """Watch trials from now on; the journal has its header, or the entry that it was resumed."""
        self._kind = kind
        if self.answered is not None:
            self._opened.callback(self._start("buttons", self._heed, self.answered).join)
        if self.clock.simulated:
            return
        self.record()
        woken, wakes = socket.socketpair()
        wakes.setblocking(False)
        self._opened.callback(woken.close)
        self._opened.callback(self._start("limits", self._watch, woken).join)
        self._opened.callback(wakes.close)
        # A signal is seen while the main thread is in a call that does not return.
        self._opened.callback(interrupts.report_to, interrupts.report_to(wakes.fileno()))
        if self.pressed is not None:
            self._opened.callback(self._start("pedal", self._follow, self.pressed).join)
        self._writer = self._start("exposure", self._write)

    def settle(self) -> None:
        """Write nothing from when this returns; limits are watched on."""
        self._settled.set()
        if self._writer is not None:
            self._writer.join()

    def close(self) -> None:
        """Write nothing more, and watch no longer."""
        self.settle()
        self._closing = True
        self._opened.close()

    def pause(self, why: str) -> None:
        """Have nothing felt or heard from now on, as `why` says, whatever the disk does."""
        self._asked = why
        with suppress(PalpateError):
            # The thread that watches meets it too.
            self._silence()

    def _start(self, name: str, loop: Callable[..., None], *given: object) -> threading.Thread:
        thread = threading.Thread(target=self._run, args=(host.joining(), loop, *given), name=name, daemon=True)
        thread.start()
        return thread

    def _run(self, join: Callable[[], None], loop: Callable[..., None], *given: object) -> None:
        """Run a thread; what fails is raised where the session asks next, and silence does not wait for that."""
        try:
            join()
            loop(*given)
        except Exception as failed:
            self._failed = failed
            with suppress(PalpateError):
                self._silence()
            if not isinstance(failed, ScreenGone):
                self._tell_over(cause(failed))

    def skip(self, reason: str) -> None:
        """Have nothing felt until `skipped` is called, so that the attempt under way breaks off."""
        self._skipped = reason

    def skipped(self) -> str:
        """Return why the attempt is skipped, or nothing, and let what follows be felt."""
        reason, self._skipped = self._skipped, ""
        return reason

    def end_reason(self, ahead_ns: int = 0) -> str:
        """Return why nothing may be felt `ahead_ns` from now, or nothing; what is over stays over.

        Raises `PalpateError` if a part that is watched failed.
        """
        if self._failed is not None:
            raise self._failed
        self._silence()
        if not self._over and self.clock.now_ns() + ahead_ns > self.ends_ns:
            self._over = self.ended
        return self._over or self._asked or self._skipped

    @property
    def left_s(self) -> float:
        """How long it is until the session's end, s."""
        return max((self.ends_ns - self.clock.now_ns()) / 1e9, 0.0)

    def look(self) -> None:
        """Keep the devices alive, silence what is over, and tell why. Raises `AudioError` if the sound stands still."""
        if self.log.waiting_s > GONE_S:
            self._over = self._over or GONE
        self._silence()
        if self._kind is not None:
            self._kind.beat(self.ends_ns)
        if not self._told and self.end_reason() and (why := self._over):
            self._told = True
            self._tell_over(why)
        before_ns, self._looked_ns = self._looked_ns, self.clock.now_ns()
        # A session that stood still itself knows nothing of its device yet.
        if self.stream is not None and self._looked_ns - before_ns < LATE_NS:
            self.stream.check()
        if self._slow != (self.log.waiting_s > SLOW_S):
            self._slow = not self._slow
            self._tell(SLOW if self._slow else "The disk is responding again.")

    def record(self) -> None:
        """Put what nobody waits for on disk: what the masker did, and the exposure if that is due."""
        if self._stopped:
            self._stopped = False
            self.log.write(Commanded(by="pedal", command="pause", taken=True, reply=STOPPED))
        if self.masking is not None and (said := self.masking.keep_up()):
            self._tell(said)
        now_ns = self.clock.now_ns()
        if now_ns >= self._due_ns:
            self._due_ns = now_ns + EVERY_NS
            self.log.write(self._exposure())
            with suppress(OSError):
                self.free_bytes = self.log.free_bytes()

    def _silence(self) -> None:
        if self.masking is not None:
            self._over = self._over or self.masking.spent()
        why = self._over or self._asked or ("a part failed" if self._failed is not None else "")
        if self.clock.now_ns() > self.ends_ns:
            why = why or self.ended
        if not why:
            return
        if self.stream is not None:
            self.stream.silence()
        if self.masking is not None:
            self.masking.silence()
        if self._kind is not None:
            self._kind.quiet(why)

    def _exposure(self) -> Exposure:
        uptime, done = self.clock.uptime(), self.log.done
        return Exposure(
            dose=self.masking.exposure.dose if self.masking is not None else None,
            stimuli=done.stimuli,
            vibration_s=done.vibration_s,
            boot=uptime.boot if uptime is not None else None,
            up_ns=uptime.ns if uptime is not None else None,
        )

    def _tell_over(self, why: str) -> None:
        self._tell(f"\n{nothing_more(why)} The session ends or pauses after the next answer.")

    def _tell(self, text: str) -> None:
        """Show a line; a terminal that stands still holds up a thread of its own."""
        self._opened.callback(self._start("lines", self.console.tell, Notice(text)).join, 1.0)

    def _watch(self, woken: socket.socket) -> None:
        while not self._closing:
            self.look()
            woken.settimeout(min(LOOK_S, self.left_s) or LOOK_S)
            with suppress(TimeoutError, BlockingIOError):
                if set(woken.recv(64)).intersection(interrupts.SIGNALS):
                    self._asked = self._asked or INTERRUPTED
                    self._silence()
                    self._tell(f"\n{nothing_more(INTERRUPTED)} The session pauses.")
        self._silence()

    def _follow(self, pressed: Callable[[], bool]) -> None:
        """Stop everything once the participant's pedal is pressed; a pedal that fails is a part that failed."""
        while not self._closing:
            if pressed():
                self.pause(BY_PARTICIPANT)
                self._stopped = True
                self._opened.callback(self._start("lines", self.console.tell, Stopped()).join, 1.0)
                return

    def _heed(self, answered: Callable[[], None]) -> None:
        """Have the participant's buttons answer until the end; buttons that fail are a part that failed."""
        while not self._closing:
            answered()

    def _write(self) -> None:
        while not self._settled.wait(LOOK_S):
            self.record()
        # What came since the last look.
        self.record()


def spent_ns(contents: Contents) -> int:
    """Return how long the session has lasted so far, without the pauses between its runners, ns."""
    return sum(_footer_ns(lines, lines[-1].t_ns + KILLED_NS) - lines[0].t_ns for lines in _runners(contents))


def since_ended_ns(contents: Contents, clock: Clock) -> int:
    """Return how long ago a session that has begun ended last, by its footer or its last line, ns.

    The machine's uptime tells it. After a restart of the machine its clock does, and one that went back tells 0.
    """
    last, today = _runners(contents)[-1], clock.uptime()
    ended_ns = _footer_ns(last, last[-1].t_ns)
    up_ns = [up_ns + ended_ns - t_ns for boot, up_ns, t_ns in _uptimes(last) if today and boot == today.boot]
    return today.ns - up_ns[-1] if today and up_ns else max(clock.now_ns() - ended_ns, 0)


def _footer_ns(lines: Sequence[Line], otherwise_ns: int) -> int:
    """Return the session time of a runner's footer, ns; what is noted in a pause stands behind it."""
    return next((line.t_ns for line in lines if isinstance(line.entry, Footer)), otherwise_ns)


def dose_before(journals: Iterable[Contents], clock: Clock) -> float:
    """Return what the sessions of these journals used up of the masker's dose in the last 24 hours.

    How long ago it was is known from the machine's uptime. The clock, which may be set, tells only for how long the
    machine was off; where it went back, that was no time. A label's tasks and their runners come in order, and the
    sessions of several labels as the clock has them.
    """
    begun = sorted((one for one in journals if one.lines), key=lambda contents: contents.header.task_position)
    if len({one.header.participant for one in begun}) > 1:
        begun.sort(key=lambda contents: contents.lines[0].t_ns)
    runners = list(chain.from_iterable(map(_runners, begun)))
    up_now_ns = _uptimes_now(runners, clock)
    spent = 0.0
    for lines in runners:
        now_ns = clock.now_ns()
        for boot, up_ns, t_ns in _uptimes(lines):
            # By the runner's own clock, which nobody sets.
            now_ns = t_ns + up_now_ns[boot] - up_ns
        spent += _played(lines, now_ns)
    return spent


def _runners(contents: Contents) -> list[Sequence[Line]]:
    """Return the lines of each runner of a session, in order."""
    begun = [n for n, entry in enumerate(contents.entries) if isinstance(entry, Header | Resumed)]
    return [contents.lines[first:last] for first, last in pairwise([*begun, len(contents.lines)])]


def _uptimes(lines: Sequence[Line]) -> Iterator[tuple[str, int, int]]:
    """Yield boot and uptime, ns, wherever a runner told them, and what its own clock was, ns."""
    for line in lines:
        entry = line.entry
        if isinstance(entry, Exposure) and entry.boot is not None and entry.up_ns is not None:
            yield entry.boot, entry.up_ns, line.t_ns


def _uptimes_now(runners: Iterable[Sequence[Line]], clock: Clock) -> dict[str, int]:
    """Return what the uptime of each boot would be now without any time off since, ns; runners come in their order."""
    told: dict[str, list[tuple[int, int]]] = defaultdict(list)
    for boot, up_ns, t_ns in chain.from_iterable(map(_uptimes, runners)):
        told[boot].append((up_ns, t_ns))
    later_ns, age_ns, today = clock.now_ns(), 0, clock.uptime()
    if today is not None:
        told[today.boot].append((today.ns, later_ns))
    now_ns: dict[str, int] = {}
    for boot, entries in reversed(told.items()):
        up_ns, t_ns = max(entries)
        age_ns += max(later_ns - t_ns, 0)
        now_ns[boot] = up_ns + age_ns
        first_up_ns, later_ns = min(entries)
        age_ns += up_ns - first_up_ns
    return now_ns


def _played(lines: Sequence[Line], now_ns: int) -> float:
    """Return the dose that one runner's masker brought in the window before `now_ns`; a time to come counts as now."""
    told: list[tuple[int, float]] = []
    level_db_a: float | None = None
    for line in lines:
        entry = line.entry
        if isinstance(entry, MaskerSet):
            level_db_a = entry.level_db_a
        if isinstance(entry, MaskerSet | Exposure) and entry.dose is not None:
            told.append((line.t_ns, entry.dose))
    spent = sum(dose - before for (_, before), (t_ns, dose) in pairwise(told) if now_ns - t_ns < WINDOW_NS)
    since_ns = now_ns - lines[-1].t_ns
    if level_db_a is None or since_ns >= WINDOW_NS:
        return spent
    from palpate.experiment.apparatus.audio import masker

    # It was killed while the masker played.
    played_ns = lines[-1].t_ns - told[-1][0] + min(max(since_ns, 0), KILLED_NS)
    return spent + masker.dose(level_db_a=level_db_a, duration_s=played_ns / 1e9)
