"""Run one session: one participant doing one task, from familiarisation to the footer."""

from __future__ import annotations

import hashlib
import math
import shutil
import threading
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass
from datetime import date
from importlib import import_module
from pathlib import Path
from typing import Literal

from palpate.experiment.apparatus import opening
from palpate.experiment.apparatus.rig import DOCTOR
from palpate.experiment.clock import Clock, day, minutes, monotonic_ns
from palpate.experiment.desk import interrupts, questions
from palpate.experiment.desk.questions import INTERRUPTED, YES, Agree, Familiarise, Instructed, Notice, Silent
from palpate.experiment.errors import (
    Finding,
    JournalError,
    PalpateError,
    PauseAsked,
    Remedy,
    ScreenGone,
    TrackerStopped,
)
from palpate.experiment.protocol.models import Protocol
from palpate.experiment.records import chain, entries, journal
from palpate.experiment.records.entries import Entry
from palpate.experiment.records.progress import Progress, progress
from palpate.experiment.session.attempt import FELT, Attempts, Devices, Event, State, follow
from palpate.experiment.session.exposure import Exposed, spent_ns
from palpate.experiment.session.kind import Signals, session_kind
from palpate.experiment.session.masker import Masking
from palpate.experiment.session.remarks import Attendance
from palpate.experiment.storage import journal_path, raw_path, rig_path, roster_path, voices_folder
from palpate.experiment.study.roster import Roster

MOST_ATTEMPTS = 10
"""Attempts at one trial by one runner, so that a rule which no step satisfies cannot go on for ever."""

SLICE_S = 5.0
"""Longest wait for a device before a pause counts, s: a board that restarts at each opening needs 2 s to speak."""

FAMILIARISED = "familiarised"
"""The state that goes on record when the participant is familiar with the materials."""

MOST_UNDELIVERED = 8
"""After so many attempts in a row whose stimulus did not count as delivered, the rig must be at fault."""


def run(
    *,
    protocol: Protocol,
    header: entries.Header,
    devices: Devices,
    rig_file: Path,
    dataset: Path,
    identity: entries.Visited | None = None,
    noise: str = "",
    panel: str = "",
    last: bool = False,
    keeps_voices: bool = False,
) -> entries.Footer:
    """Run a session, or the rest of one, and return the footer that ended it.

    `identity`, which was asked before it, and what was found of the `panel` go on record; so does `noise`, which the
    rig cannot play, once the experimenter confirms that it masks the trials. The `last` session of a visit ends with
    its debriefing.
    Where a microphone listens, `keeps_voices` has the sound of answers kept. The header of an existing journal rules
    and must be of the same session; a complete session is not touched. The rig's file is kept beside the journal.

    Raises `SessionLocked` if another runner holds the participant; `JournalError` if the journal is broken or another
    session's, or the participant withdrew; `PalpateError` if a part failed (the footer says so, and the session can be
    resumed); and `KeyboardInterrupt` on Ctrl-C as the footer was written. A closed terminal pauses as Ctrl-C does.
    """
    path = journal_path(dataset, header.participant, header.task)
    with interrupts.all_alike(), journal.locked(path.parent, header.participant):
        contents = journal.read_if_begun(path)
        if contents.lines:
            _check_same_session(path, contents.header, header)
            header = contents.header
        # Anybody may have withdrawn up to the moment at which this runner held them.
        said, who = any(isinstance(entry, entries.Withdrawal) for entry in contents.entries), header.participant
        if said or who in Roster.load(roster_path(dataset)).withdrawn:
            raise JournalError(path, f"participant {who} withdrew and cannot continue", "enroll another participant")
        done = progress(contents.entries or (header,))
        if done.footer is not None and done.footer.reason == "complete":
            journal.settle(path, contents)
            return done.footer
        opening.copy_rig(rig_file, rig_path(path))
        task = protocol.task(header.task)
        frames = session_kind(task).frames(task)
        with closing(SessionLog(path, devices.clock, contents, done, frames)) as log:
            log.signals = devices.signals
            session = _Session(
                protocol=protocol,
                devices=devices,
                log=log,
                spent_ns=spent_ns(contents),
                identity=identity,
                noise=noise,
                panel=panel,
                last=last,
                voices=voices_folder(dataset, header.participant) if keeps_voices else None,
                dataset=dataset,
            )
            with closing(session):
                return session.run(contents)


def _answered(devices: Devices) -> Callable[[], None] | None:
    """Return what has the participant's buttons answer; None without any."""
    if devices.buttons is None:
        return None
    answering = import_module("palpate.experiment.session.answering")
    follow: Callable[[], None] = answering.followed(devices.buttons, devices.console, devices.clock)
    return follow


def _check_same_session(path: Path, found: entries.Header, asked: entries.Header) -> None:
    identity = ("study", "protocol_sha256", "participant", "task", "seed", "rig_sha256", "recordings_sha256")
    for name in (*identity, "purpose", "order"):
        was, now = getattr(found, name), getattr(asked, name)
        if was != now:
            shown = "" if name == "order" else f" ({was} then, {now} now)"
            remedy = "continue with the original file, or choose another dataset folder"
            if name == "rig_sha256":
                remedy = f"continue with {rig_path(path)}; a rig calibrated since then is a different apparatus"
            raise JournalError(path, f"the session was started with a different {name}{shown}", remedy)


def _times(names: Mapping[str, str], handled: Counter[str], how: str) -> str:
    """Return how often each of these was felt or handled, for the record; nothing if none was."""
    told = ", ".join(f"{names[key]} {times}" for key, times in handled.items())
    return f"; {how}: {told}" if told else ""


def _onward(done: Progress, stopped_on: date) -> str:
    """Return in a sentence where a session goes on, and which trials come again."""
    again = [str(planned.trial) for planned in done.remaining if planned.trial in done.put_off]
    *others, last = again or [""]
    named = f"trials {', '.join(others)} and {last} will be" if others else f"trial {last} will be"
    told = f"This session continues from {stopped_on}: {len(done.answered)} of {done.trials} trials have been answered"
    return f"{told}; {named} repeated at the end of {'their' if others else 'its'} block." if again else f"{told}."


class SessionLog:
    """Implements `Log`: the journal, for several threads, and a file of raw data, opened before anything is felt."""

    def __init__(
        self, path: Path, clock: Clock, contents: journal.Contents, done: Progress, frames: type[entries.Trace] | None
    ) -> None:
        self.done = done
        """Where the session stands by what is on disk, as it would after a kill."""
        self._lock = threading.Lock()
        self._folder = path.parent
        self._under_way: dict[int, int] = {}
        self._journal = journal.Journal(path, clock, contents)
        self.signals: Signals | None = None
        raw = None if frames is None else raw_path(path, frames.file)
        self._frames = None if frames is None or raw is None else (frames, raw, raw.open("ab", buffering=0))

    @property
    def accepts(self) -> bool:
        """Whether an entry may follow what is on disk."""
        return self._journal.accepts

    def write(self, entry: Entry) -> None:
        self.follow(lambda _: (entry,))

    def follow(self, entries_after: Callable[[Progress], Iterable[Entry]]) -> None:
        """Put into the journal what follows from where the session stands; nothing else is written in between."""
        # An interrupt waits until the entry is on disk, so that a footer may follow it.
        with interrupts.deferred(), self._waiting(), self._lock:
            for entry in self._signalled(entries_after(self.done)):
                self._journal.append(entry)
                self.done = self.done.after(entry)

    def _signalled(self, wanted: Iterable[Entry]) -> Iterator[Entry]:
        """Yield entries with what was sent before them, and have each sent once it is on disk."""
        for entry in wanted:
            if self.signals is None:
                yield entry
            else:
                yield from (*self.signals.before(entry), entry)
                self.signals.after(entry)

    @contextmanager
    def _waiting(self) -> Iterator[None]:
        """Count the calling thread as one that waits for the disk."""
        self._under_way[threading.get_ident()] = monotonic_ns()
        try:
            yield
        finally:
            del self._under_way[threading.get_ident()]

    @property
    def waiting_s(self) -> float:
        now_ns = monotonic_ns()
        return (now_ns - min((now_ns, *self._under_way.copy().values()))) / 1e9

    def free_bytes(self) -> int:
        with self._waiting():
            return shutil.disk_usage(self._folder).free

    def keep(self, raw: bytes) -> entries.Trace:
        if self._frames is None:
            raise RuntimeError("no raw data are stored for this session")
        made, path, file = self._frames
        offset = file.tell()
        try:
            with self._waiting():
                chain.write_through(file, raw, wait=self._journal.waits)
        except OSError as error:
            raise journal.unwritable(path, error) from error
        journal.check_place(file.fileno(), path)
        return made(offset=offset, length=len(raw), sha256=hashlib.sha256(raw).hexdigest())

    def close(self) -> None:
        try:
            if self._frames is not None:
                chain.write_through(self._frames[2], b"")
                self._frames[2].close()
        finally:
            self._journal.close()


@dataclass(kw_only=True, eq=False)
class _Session:
    protocol: Protocol
    devices: Devices
    log: SessionLog
    spent_ns: int
    identity: entries.Visited | None
    noise: str
    panel: str
    last: bool
    voices: Path | None
    dataset: Path

    def __post_init__(self) -> None:
        protocol, devices, log = self.protocol, self.devices, self.log
        self._task = protocol.task(log.done.header.task)
        masker = devices.masker
        self._masking = Masking(masker, devices.console, log.write, devices.clock) if masker is not None else None
        session_min = protocol.exposure.session_min
        self._exposed = Exposed(
            ends_ns=devices.clock.now_ns() + int(session_min * 60e9) - self.spent_ns,
            ended=f"the session has reached the protocol's limit of {session_min:g} min",
            masking=self._masking,
            console=devices.console,
            clock=devices.clock,
            log=log,
            stream=devices.stream,
            pressed=devices.pedal.pressed if devices.pedal is not None else None,
            answered=_answered(devices),
        )
        if devices.stream is not None:
            devices.stream.end(self._exposed.ends_ns)
        self._ear = None
        if devices.listening is not None:
            self._ear = devices.listening.begin(
                devices.console, devices.clock, write=log.write, task=self._task.id, voices=self.voices
            )
        self._attempts = Attempts(
            protocol=protocol,
            devices=devices,
            log=log,
            masking=self._masking,
            limits=self._exposed,
            ear=self._ear,
            dataset=self.dataset,
        )
        self._attendance = Attendance(remarks=self._attempts.remarks, exposed=self._exposed, ear=self._ear)
        self._state = State.READY
        self._noisy = False

    def run(self, contents: journal.Contents) -> entries.Footer:
        try:
            return self._run(contents)
        except KeyboardInterrupt:
            if self.log.done.footer is not None:
                raise
            # It came as the session was ending: a terminal that is closed takes no line, and interrupts as well.
            return self._end("paused", INTERRUPTED)

    def _run(self, contents: journal.Contents) -> entries.Footer:
        try:
            self._begin(contents)
            self._begin_noise()
            if self.log.done.remaining and any(task.control for task in self.protocol.tasks):
                control = import_module("palpate.experiment.session.answering.control")
                control.confirm(self.protocol, self._task, self.devices.console, self.log)
            self._attempts.remarks.note_ignored()
            self._enrol()
            if self.log.done.remaining:
                asks, names = self.protocol.question(self._task), self._task.picture_files
                self.devices.console.tell(Instructed(self._task.instruction, asks, names))
            pause = self._train(contents) or self._trials(self._next)
        except (ScreenGone, PauseAsked) as why:
            pause, felt = why.sentence(), self.log.done.unanswered
            if isinstance(why, PauseAsked) and felt is not None:
                self.devices.console.tell(Notice(FELT.format(trial=felt[0])))
        except PalpateError as error:
            self._follow(Event.FAIL)
            # It has ended as it is; whoever presses the key meanwhile wants no more, and a full disk takes no footer.
            with suppress(KeyboardInterrupt, JournalError):
                self._end("error", error.sentence())
            raise
        except KeyboardInterrupt:
            pause = INTERRUPTED
        self._follow(Event.PAUSE if pause else Event.EXHAUSTED)
        return self._end("paused" if pause else "complete", pause)

    def close(self) -> None:
        """Leave nothing that watches it."""
        self._exposed.close()
        if self._ear is not None:
            self._ear.close()

    def _begin_noise(self) -> None:
        """Have what masks begin, unless it has: before the first stimulus that is felt."""
        if self._noisy:
            return
        self._noisy = True
        self._mask()
        if self._masking is None and self.noise and self.log.done.remaining:
            # That the noise plays is confirmed, and put on record.
            text = f"{self.noise} Is it playing?"
            question = Agree(text, "yes, it is playing and meets the criterion", "no, pause")
            if self.devices.console.ask(question).key != YES:
                raise PauseAsked("no masking noise is playing")
            self.log.write(entries.Note(trial=None, text=f"The experimenter confirmed: {self.noise}"))

    def _mask(self) -> None:
        """Have the masker begin where trials remain, and its level chosen."""
        if self._masking is not None and self.log.done.remaining and not self._exposed.end_reason():
            probe = self._attempts.kind.probe
            self._masking.choose(self.protocol.masker, self.log.done.masker_db_a, probe)

    def _enrol(self) -> None:
        """Have the participant say the answers, to compare with, where a microphone listens and trials remain."""
        listening, ear = self.devices.listening, self._ear
        if listening is None or ear is None or not self.log.done.remaining or self._exposed.end_reason():
            return
        answers = {material.id: material.spoken[0] for material in self.protocol.materials}
        told = listening.enrol(ear, answers, self.dataset, self.log.done.header.participant)
        self.log.write(entries.Phase(state="enrolled", detail=told))
        self.devices.console.tell(Notice(f"{told[:1].upper()}{told[1:]}."))

    def _train(self, contents: journal.Contents) -> str:
        """Run what is left of the task's training, if it has one; return why the session pauses, or nothing."""
        if self._task.training is None or not self.log.done.remaining:
            return ""
        answering = import_module("palpate.experiment.session.answering.training")
        training = answering.Training(self.protocol, self._task.training, self.log, self.devices.console)
        with training.led(self._attempts, contents.entries):
            return self._trials(training.next_trial)

    def _trials(self, next_trial: Callable[[], entries.PlannedTrial | None]) -> str:
        """Run attempt after attempt until no trial comes next; return why the session pauses, or nothing."""
        begun: Counter[int] = Counter()
        while planned := next_trial():
            if pause := self._why_not(planned.trial, begun):
                return pause
            begun[planned.trial] += 1
            event = self._attempts.run(planned, self._attempts.log.done.attempts.get(planned.trial, 0) + 1)
            if event not in (Event.BROKEN_OFF, Event.LOST):
                self._follow(Event.STEPPED)
            if event is Event.PAUSE:
                return questions.BY_EXPERIMENTER
            self._follow(event)
            if event is Event.LOST and (pause := self._wait_for_device()):
                return pause
        return ""

    def _next(self) -> entries.PlannedTrial | None:
        """Return the next trial, or None after a debriefing, which is silent; the masker is then chosen anew."""
        if self._task.levels is not None:
            tracks = import_module("palpate.experiment.study.levels").Tracks(self.protocol, self._task)
            self.log.follow(tracks.upcoming)
        if not self.log.done.remaining:
            if self._masking is not None:
                self._masking.end()
                self._masking.record()
            self._question("after")
            if self.last:
                self._attempts.remarks.ask_report()
            self._attempts.debrief()
            self._mask()
        return next(iter(self.log.done.remaining), None)

    def _why_not(self, trial: int, begun: Counter[int]) -> str:
        """Return why no further attempt is begun, or nothing."""
        if over := self._exposed.end_reason():
            return over
        if self._attempts.undelivered >= MOST_UNDELIVERED:
            what = f"the stimulus was not delivered in {self._attempts.undelivered} attempts in a row"
        elif begun[trial] == MOST_ATTEMPTS:
            what = f"trial {trial} was started {MOST_ATTEMPTS} times"
        else:
            return ""
        return Finding(what, remedy=Remedy("run {}, then resume", DOCTOR)).sentence()

    def _wait_for_device(self) -> str:
        """Wait for the device that fell silent; return why the session pauses instead, or nothing."""
        console, lost = self.devices.console, self._attempts.outage
        wait_s = min(self.devices.reconnect_s, math.ceil(self._exposed.left_s))
        self.log.write(entries.Phase(state=self._state, detail=lost))
        console.tell(
            Notice(
                f"{lost}. The session continues automatically if the device returns within {wait_s:g} s. Nothing is "
                "lost."
            )
        )
        console.tell(Silent())
        if pause := self._missing(wait_s):
            return pause
        self._follow(Event.FOUND)
        self.log.write(entries.Phase(state=self._state, detail="the device is back"))
        console.tell(Notice("The device is back. The trial starts again."))
        return ""

    def _missing(self, wait_s: float) -> str:
        """Wait so long for the device, and see between whether to go on; return why the session pauses, or nothing."""
        slices = max(math.ceil(wait_s / SLICE_S), 1)
        for _ in range(slices):
            try:
                self._attempts.reconnect(wait_s / slices)
            except TrackerStopped as stopped:
                why = stopped.sentence()
            else:
                return ""
            if over := self._exposed.end_reason():
                return over
        return why if slices == 1 else f"waited for {wait_s:g} s: {why}"

    def _follow(self, event: Event) -> None:
        self._state = follow(self._state, event)

    def _end(self, reason: Literal["complete", "paused", "error"], detail: str = "") -> entries.Footer:
        with interrupts.deferred():
            # Whatever the disk does, from now on nothing is felt or heard.
            self._exposed.pause(detail or reason)
            silent = self._attempts.kind.is_silent()
            footer = entries.Footer(reason=reason, detail=detail, answered=len(self.log.done.answered), silent=silent)
            self.devices.console.attend(None)
            # Whoever writes beside this thread has written when these return.
            self._attempts.remarks.close()
            self._exposed.settle()
            if self._ear is not None:
                self._ear.close()
            # After an interrupt in the middle of a write only a new reading of the journal may add to it.
            accepts = self.log.accepts
            if accepts:
                if self._masking is not None:
                    self._masking.record()
                self._attempts.remarks.note_ignored()
                self.log.write(footer)
        return footer

    def _begin(self, contents: journal.Contents) -> None:
        done = self.log.done
        if contents.lines:
            remaining = tuple(planned.trial for planned in done.remaining)
            torn = contents.torn.decode("utf-8", "backslashreplace")
            self.log.write(entries.Resumed(torn=torn, remaining=remaining))
            self._exposed.begin(self._attempts.kind)
            back_ns = contents.lines[-1].t_ns - self.devices.clock.now_ns()
            if back_ns > 0 and not self.devices.clock.simulated:
                text = f"The clock of this computer was set back by at least {minutes(back_ns / 1e9)} since the pause."
                self.log.write(entries.Note(trial=None, text=text))
                self.devices.console.tell(
                    Notice(f"{text} The tables take this into account. Set the clock before the next session.")
                )
            if torn:
                self.devices.console.tell(
                    Notice(f"The last line of the journal was incomplete and was dropped: {torn[:60]!r}")
                )
            for cut, when in (
                (done.unanswered, "before the answer"),
                (done.armed, "while the trial was armed; its stimulus may have been felt"),
            ):
                if cut is not None:
                    reason = f"the session was interrupted {when}"
                    self.log.write(entries.Redo(trial=cut[0], attempt=cut[1], reason=reason, put_off=True))
            self.devices.console.tell(Notice(_onward(self.log.done, day(contents.lines[-1].t_ns))))
        else:
            self.log.write(done.header)
            self._exposed.begin(self._attempts.kind)
        if self.identity is not None:
            self.log.write(self.identity)
        if self.panel:
            self.log.write(entries.Note(trial=None, text=self.panel))
        self.devices.console.attend(self._attendance)
        if priority := self.devices.priority:
            self.log.write(entries.Phase(state=self._state, detail=f"priority: {priority}"))
        if done.attempts or FAMILIARISED in (
            entry.state for entry in contents.entries if isinstance(entry, entries.Phase)
        ):
            self._follow(Event.RESUME)
        else:
            self._question("before")
            self._follow(Event.BEGIN)
            if self._attempts.kind.samples:
                self._begin_noise()
            self._familiarise()
            self._follow(Event.FAMILIARISED)

    def _question(self, when: Literal["before", "after"]) -> None:
        """Have the questionnaires before or after the task answered, where there are any."""
        if getattr(self.protocol, "asked", None) is not None:
            asking = import_module("palpate.experiment.session.answering.questionnaires")
            asking.ask(self.protocol, self._task.id, when, self.devices.console, self.log)

    def _familiarise(self) -> None:
        wanted = self._task.familiarisation
        clock = self.devices.clock
        self.log.write(entries.Phase(state=self._state))
        begun_ns = clock.now_ns()
        lasted_s, handled = 0.0, Counter[str]()
        shown = self.protocol.materials_of(self._task)
        kind = self._attempts.kind
        names = kind.samples or {one.key: one.id for one in self.protocol.materials if one.key and one.id in shown}
        while not (kind.samples and self._exposed.end_reason()):
            is_open = not kind.samples or lasted_s < wanted.max_s
            counts = {key: f"{name} ({handled[key]})" for key, name in names.items() if is_open}
            unfelt = [key for key in kind.samples if is_open and not handled[key]]
            left_s = wanted.min_s - lasted_s, wanted.max_s - lasted_s
            question = Familiarise(wanted.instruction, *left_s, counts, plays=bool(kind.samples), unfelt=bool(unfelt))
            key = self.devices.console.ask(question).key
            chosen = [key] if key in counts else unfelt
            handled.update(one for one in chosen if one not in kind.samples or kind.present(one))
            lasted_s = (clock.now_ns() - begun_ns) / 1e9
            if chosen:
                continue
            if lasted_s >= wanted.min_s:
                break
            asked = f"{wanted.min_s:.0f} s of familiarization; {lasted_s:.0f} s have passed"
            self.devices.console.tell(Notice(f"It is too early to continue; the protocol requires {asked}."))
        told = _times(names, handled, "felt" if kind.samples else "handled")
        self.log.write(entries.Phase(state=FAMILIARISED, detail=f"{lasted_s:.1f} s{told}"))
