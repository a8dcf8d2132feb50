"""One attempt at one trial of any kind: make it ready, watch it, put it on disk, ask, and put the answer on disk.

The states of a session and the one table of their transitions stand here too.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING

from palpate.experiment.apparatus.ports import Buttons, Masker, Pedal
from palpate.experiment.clock import Clock
from palpate.experiment.desk import interrupts, questions
from palpate.experiment.desk.messages import ENTER, Repeat
from palpate.experiment.desk.questions import Answered, Confirm, Console, Debrief, Notice, Remark, Reply, TrialAnswer
from palpate.experiment.errors import JournalError, SessionError, TrackerStopped, cause
from palpate.experiment.protocol.models import Protocol
from palpate.experiment.records.entries import ASKED_FOR, PAUSED, Answer, Armed, PlannedTrial, Redo, TrainingTrial
from palpate.experiment.session.kind import KindDevices, Lent, Limits, Log, Signals
from palpate.experiment.session.masker import Masking
from palpate.experiment.session.remarks import Remarks

if TYPE_CHECKING:
    from palpate.experiment.apparatus.audio.stream import AudioStream
    from palpate.experiment.desk.voice.ear import Ear
    from palpate.experiment.desk.voice.listening import Listening

FELT = "Trial {trial} was felt, so it will be repeated at the end of its block."
"""What is said where a session pauses before an answer."""


class State(StrEnum):
    """Where a session stands; `WAITING` is for a tracker that stopped."""

    READY = "ready"
    FAMILIARISING = "familiarising"
    ARMED = "armed"
    WAITING = "waiting"
    ANSWERING = "answering"
    COMPLETE = "complete"
    PAUSED = "paused"
    FAILED = "failed"


class Event(StrEnum):
    """What happens to a session."""

    BEGIN = "begin"
    RESUME = "resume"
    FAMILIARISED = "familiarised"
    STEPPED = "stepped"
    BROKEN_OFF = "broken-off"
    LOST = "lost"
    FOUND = "found"
    ANSWERED = "answered"
    REDONE = "redone"
    EXHAUSTED = "exhausted"
    PAUSE = "pause"
    FAIL = "fail"


UNDER_WAY = (State.READY, State.FAMILIARISING, State.ARMED, State.WAITING, State.ANSWERING)

TRANSITIONS: dict[tuple[State, Event], State] = {
    (State.READY, Event.BEGIN): State.FAMILIARISING,
    (State.READY, Event.RESUME): State.ARMED,
    (State.FAMILIARISING, Event.FAMILIARISED): State.ARMED,
    (State.ARMED, Event.STEPPED): State.ANSWERING,
    (State.ARMED, Event.BROKEN_OFF): State.ARMED,
    (State.ARMED, Event.LOST): State.WAITING,
    (State.ARMED, Event.EXHAUSTED): State.COMPLETE,
    (State.WAITING, Event.FOUND): State.ARMED,
    (State.ANSWERING, Event.ANSWERED): State.ARMED,
    (State.ANSWERING, Event.REDONE): State.ARMED,
    **{(state, Event.PAUSE): State.PAUSED for state in UNDER_WAY},
    **{(state, Event.FAIL): State.FAILED for state in UNDER_WAY},
}
"""Every transition there is; `COMPLETE`, `PAUSED` and `FAILED` end a runner."""


def follow(state: State, event: Event) -> State:
    """Return the state after `event`. Raises `SessionError` for a transition that the table does not hold."""
    try:
        return TRANSITIONS[state, event]
    except KeyError:
        allowed = ", ".join(e for s, e in TRANSITIONS if s is state) or "no event: the session has ended"
        raise SessionError(f"a session that is {state} got {event}", allowed=allowed) from None


@dataclass(frozen=True)
class Devices:
    """The opened parts of a session; `masker`, and the `stream` that it plays on, are None if the rig has no sound.

    `kind` are the devices of the task's kind of trial. A session waits `reconnect_s` for a device that fell silent,
    then pauses. `priority` is that of its threads in words, and is empty in simulated time. `listening` hears answers;
    None where nobody listens. `pedal` is the participant's, if any, and so are `buttons`. `signals` are triggers.
    """

    kind: KindDevices
    console: Console
    clock: Clock
    masker: Masker | None
    reconnect_s: float
    stream: AudioStream | None = None
    priority: str = ""
    listening: Listening | None = None
    pedal: Pedal | None = None
    buttons: Buttons | None = None
    signals: Signals | None = None


@dataclass(kw_only=True, eq=False)
class Attempts:
    """The attempts of one session, one after the other; without a masker or a microphone `masking` or `ear` is None."""

    protocol: Protocol
    devices: Devices
    log: Log
    masking: Masking | None
    limits: Limits
    ear: Ear | None
    dataset: Path

    def __post_init__(self) -> None:
        header, console, clock = self.log.done.header, self.devices.console, self.devices.clock
        lent = Lent(self.protocol, header, console, clock, self.log, self.limits)
        self.kind = self.devices.kind.begin(lent)
        """The trials of this session."""
        self.remarks = Remarks(lent, self.kind, self.dataset)
        """What the experimenter says beside answers."""
        self._answered_ns: int | None = None
        self.outage = ""
        """Why the last attempt was lost."""
        self.undelivered = 0
        """How many attempts in a row, up to the last, had a stimulus that was not delivered."""

    def run(self, planned: PlannedTrial, attempt: int) -> Event:
        """Run one attempt at a trial; `attempt` is its number, from 1.

        Return `ANSWERED`, `REDONE`, `BROKEN_OFF`, `LOST` (a device fell silent; see `outage`) or `PAUSE`. Raises
        `PalpateError` if a part failed.
        """
        answered_ns, self._answered_ns = self._answered_ns, None
        self.remarks.trial = planned.trial
        try:
            self.kind.ready(planned, attempt, answered_ns)
        except TrackerStopped as stopped:
            # Nothing had begun: nothing is on file of it, and the same attempt is armed again.
            self.outage = stopped.sentence()
            return Event.LOST
        self.remarks.note_ignored()
        if self.limits.end_reason():
            # While something was laid out, or the tracker zeroed.
            return Event.BROKEN_OFF
        self.log.write(Armed(trial=planned.trial, attempt=attempt, presented=planned.presented))
        # Whatever goes wrong, the attempt is put on disk first: it may have been felt.
        with interrupts.deferred() as interrupt:
            try:
                seen = self.kind.watch(interrupt.let_through)
            except JournalError:
                # What was felt is not on disk; the next runner finds the attempt armed, and puts it off.
                raise
            except BaseException as ended:
                why = questions.INTERRUPTED if isinstance(ended, KeyboardInterrupt) else cause(ended)
                felt = f"nothing was felt: {why}"
                self.log.write(Redo(trial=planned.trial, attempt=attempt, reason=felt, put_off=False))
                raise
            self.log.write(seen.entry)
            if seen.failed is not None:
                raise seen.failed
        if seen.answerable_ns is None:
            self.outage = seen.reason if seen.lost else ""
            if reason := self.limits.skipped():
                return self._put_off(planned, attempt, reason)
            return Event.LOST if seen.lost else Event.BROKEN_OFF
        # None says that nothing measured the stimulus and no fault is known, so it ends a row as well.
        self.undelivered = self.undelivered + 1 if seen.delivered is False else 0
        if seen.repeat:
            reason = "; ".join(filter(None, (seen.repeat, self.limits.skipped())))
            self.devices.console.tell(
                Notice(f"Trial {planned.trial} will be repeated at the end of its block: {reason}.")
            )
            return self._put_off(planned, attempt, reason)
        if self.ear is not None:
            self.ear.listen(planned.trial, attempt, seen.answerable_ns)
        try:
            return self._ask(planned, attempt, seen.answerable_ns)
        finally:
            if self.ear is not None:
                self.ear.stop()
            self.kind.rest()

    def reconnect(self, timeout_s: float) -> None:
        """Wait until the device that fell silent is back. Raises `TrackerStopped`."""
        self.kind.reconnect(timeout_s)
        self.outage = ""

    def debrief(self) -> None:
        """Have the experimenter note and correct, once every trial is answered; a trial may come to be done again."""
        self.remarks.trial = None
        while not self.log.done.remaining and (remark := self.devices.console.ask(Debrief()).remark) is not None:
            self._take(remark)

    def _ask(self, planned: PlannedTrial, attempt: int, answerable_ns: int) -> Event:
        console, spoken, answers = self.devices.console, self.protocol.answers, self.remarks.lent.answers(planned)
        if reason := self.limits.skipped():
            return self._put_off(planned, attempt, reason)
        others = {
            spoken.redo_key: "repeat this trial",
            spoken.pause_key: "pause",
            **(questions.MASKER if self.masking is not None else {}),
        }
        words = {key: one.words for key, one in answers.items()}
        by = questions.ANSWERED_BY[spoken.mode]
        reply, chosen_ns = self._chosen(TrialAnswer(planned.trial, words, spoken.no_answer_key, others, by))
        key = reply.remark if isinstance(reply.remark, Repeat) else reply.key
        if reason := self.kind.rest():
            return self._put_off(planned, attempt, reason)
        if isinstance(key, Repeat):
            return self._put_off(planned, attempt, key.reason)
        if key == spoken.redo_key:
            return self._put_off(planned, attempt, ASKED_FOR)
        if key == spoken.pause_key:
            self._put_off(planned, attempt, PAUSED)
            console.tell(Notice(FELT.format(trial=planned.trial)))
            return Event.PAUSE
        self._answered_ns = self.devices.clock.now_ns()
        answered = None if key == spoken.no_answer_key else answers[key].answer
        theirs = reply.by != "experimenter"
        self.log.write(
            Answer(
                trial=planned.trial,
                attempt=attempt,
                presented=planned.presented,
                answered=answered,
                key=key,
                response_time_s=(chosen_ns - answerable_ns) / 1e9,
                confirmed_s=None if theirs else (self._answered_ns - answerable_ns) / 1e9,
                by="participant" if theirs else "experimenter",
                pressed_ns=chosen_ns if theirs else None,
                device_us=reply.device_us,
                error_s=reply.error_s,
            )
        )
        if self.ear is not None:
            self.ear.answered(chosen_ns)
        console.tell(Answered(planned.trial, answered, training=isinstance(planned, TrainingTrial)))
        return Event.ANSWERED

    def _put_off(self, planned: PlannedTrial, attempt: int, reason: str) -> Event:
        self.log.write(Redo(trial=planned.trial, attempt=attempt, reason=reason, put_off=True))
        return Event.REDONE

    def _take(self, remark: Remark) -> None:
        _, words = self.remarks.take(remark)
        self.devices.console.tell(Notice(words))

    def _chosen(self, question: TrialAnswer) -> tuple[Reply, int]:
        """Return the reply whose key was chosen and, unless by the participant, confirmed, or that has the trial
        repeated; and the session time of the choice, ns.
        """
        meanings = {one.key: one.words for one in question.choices}
        while True:
            further = dict(self.kind.keys)
            reply = self.devices.console.ask(replace(question, others={**question.others, **further}))
            chosen_ns = self.devices.clock.now_ns() - (0 if self.devices.clock.simulated else reply.ago_ns)
            self.remarks.note_ignored()
            if isinstance(reply.remark, Repeat) and reply.remark.trial == question.trial:
                return reply, chosen_ns
            if reply.remark is not None:
                self._take(reply.remark)
            elif reply.key in further:
                self.kind.press(reply.key)
            elif reply.key in question.answers and (lacking := self.kind.lacking()):
                redo_key = self.protocol.answers.redo_key
                self.devices.console.tell(Notice(f"{lacking} [{redo_key}] repeats this trial."))
            elif reply.by != "experimenter":
                return reply, chosen_ns
            elif self.masking is None or not self.masking.change(reply.key):
                confirmed = self.devices.console.ask(Confirm(reply.key, meanings[reply.key])).key == ENTER
                self.remarks.note_ignored()
                if confirmed:
                    return reply, chosen_ns
