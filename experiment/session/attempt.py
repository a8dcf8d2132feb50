"""One attempt at one trial of any kind: make it ready, watch it, put it on disk, ask, and put the answer on disk.

The states of a session and the one table of their transitions stand here too.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING

from palpate.experiment.apparatus.ports import Masker, Microphone, Pedal
from palpate.experiment.clock import Clock
from palpate.experiment.desk import interrupts
from palpate.experiment.desk.messages import Repeat
from palpate.experiment.desk.port import INTERRUPTED, NO_ANSWER, Console, Remark
from palpate.experiment.errors import JournalError, SessionError, TrackerStopped
from palpate.experiment.protocol.models import Protocol
from palpate.experiment.records.entries import Answer, Armed, Header, PlannedTrial, Redo
from palpate.experiment.session.kind import KindDevices, Lent, Limits, Log
from palpate.experiment.session.masker import KEYS, Masking
from palpate.experiment.session.remarks import Remarks

if TYPE_CHECKING:
    from concurrent.futures import Executor

    from palpate.experiment.apparatus.audio.stream import AudioStream
    from palpate.experiment.desk.voice.ear import Ear


FELT = "Trial {trial} was felt, and comes again at the end of its block."
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
        allowed = ", ".join(e for s, e in TRANSITIONS if s is state) or "nothing: the session has ended"
        raise SessionError(f"a session that is {state} got {event}", allowed=allowed) from None


@dataclass(frozen=True)
class Devices:
    """The opened parts of a session; `masker`, and the `stream` that it plays on, are None if the rig has no sound.

    `kind` are the devices of the task's kind of trial. A session waits `reconnect_s` for a device that fell silent,
    then pauses. `priority` is that of its threads in words, and is empty in simulated time. `microphone` hears answers,
    and `computing` computes what it heard; both are None where nobody listens. `pedal` is the participant's, if any.
    """

    kind: KindDevices
    console: Console
    clock: Clock
    masker: Masker | None
    reconnect_s: float
    stream: AudioStream | None = None
    priority: str = ""
    microphone: Microphone | None = None
    computing: Executor | None = None
    pedal: Pedal | None = None


class Attempts:
    """The attempts of one session, one after the other."""

    def __init__(
        self,
        *,
        protocol: Protocol,
        header: Header,
        devices: Devices,
        log: Log,
        masking: Masking | None,
        limits: Limits,
        ear: Ear | None = None,
    ) -> None:
        """Set up before the first attempt; `masking` and `ear` are None for a session without masker or microphone."""
        self._ear = ear
        self._spoken = protocol.answers
        self._console, self._clock = devices.console, devices.clock
        self._log = log
        self._masking = masking
        self._limits = limits
        lent = Lent(
            protocol=protocol, header=header, console=devices.console, clock=devices.clock, log=log, limits=limits
        )
        self.kind = devices.kind.begin(lent)
        """The trials of this session."""
        self.remarks = Remarks(spoken=protocol.answers, kind=self.kind, console=devices.console, log=log, limits=limits)
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
            self.outage = str(stopped)
            return Event.LOST
        self.remarks.note_ignored()
        if self._limits.over():
            # While something was laid out, or the tracker zeroed.
            return Event.BROKEN_OFF
        self._log.write(Armed(trial=planned.trial, attempt=attempt, presented=planned.presented))
        # Whatever goes wrong, the attempt is put on disk first: it may have been felt.
        with interrupts.held() as interrupt:
            try:
                seen = self.kind.watch(interrupt.let_through)
            except JournalError:
                # What was felt is not on disk; the next runner finds the attempt armed, and puts it off.
                raise
            except BaseException as ended:
                why = INTERRUPTED if isinstance(ended, KeyboardInterrupt) else str(ended)
                reason = f"nothing was felt: {why}"
                self._log.write(Redo(trial=planned.trial, attempt=attempt, reason=reason, put_off=False))
                raise
            self._log.write(seen.entry)
            if seen.failed is not None:
                raise seen.failed
        if seen.answerable_ns is None:
            self.outage = seen.reason if seen.lost else ""
            if reason := self._limits.skipped():
                return self._put_off(planned, attempt, reason)
            return Event.LOST if seen.lost else Event.BROKEN_OFF
        # None says that nothing measured the stimulus and no fault is known, so it ends a row as well.
        self.undelivered = self.undelivered + 1 if seen.delivered is False else 0
        if seen.repeat:
            reason = "; ".join(filter(None, (seen.repeat, self._limits.skipped())))
            self._console.show(f"Trial {planned.trial} is repeated at the end of its block: {reason}.")
            return self._put_off(planned, attempt, reason)
        if self._ear is not None:
            self._ear.listen(planned.trial, attempt, seen.answerable_ns)
        try:
            return self._ask(planned, attempt, seen.answerable_ns)
        finally:
            if self._ear is not None:
                self._ear.stop()
            self.kind.rest()

    def reconnect(self, timeout_s: float) -> None:
        """Wait until the device that fell silent is back. Raises `TrackerStopped`."""
        self.kind.reconnect(timeout_s)
        self.outage = ""

    def debrief(self) -> None:
        """Have the experimenter note and correct, once every trial is answered; a trial may come to be done again."""
        self.remarks.trial = None
        while not self._log.done.remaining and (remark := self._console.debrief()) is not None:
            self._take(remark)

    def _ask(self, planned: PlannedTrial, attempt: int, answerable_ns: int) -> Event:
        console, spoken, answers = self._console, self._spoken, self.kind.answers(planned)
        if reason := self._limits.skipped():
            return self._put_off(planned, attempt, reason)
        others = {
            spoken.no_answer_key: NO_ANSWER,
            spoken.redo_key: "do this trial again",
            spoken.pause_key: "pause",
            **(KEYS if self._masking is not None else {}),
        }
        key, chosen_ns = self._chosen(planned.trial, {key: one.words for key, one in answers.items()}, others)
        if reason := self.kind.rest():
            return self._put_off(planned, attempt, reason)
        if isinstance(key, Repeat):
            return self._put_off(planned, attempt, key.reason)
        if key == spoken.redo_key:
            return self._put_off(planned, attempt, "asked for by the experimenter")
        if key == spoken.pause_key:
            self._put_off(planned, attempt, "paused before the answer")
            console.show(FELT.format(trial=planned.trial))
            return Event.PAUSE
        self._answered_ns = self._clock.now_ns()
        answered = None if key == spoken.no_answer_key else answers[key].answer
        self._log.write(
            Answer(
                trial=planned.trial,
                attempt=attempt,
                presented=planned.presented,
                answered=answered,
                key=key,
                response_time_s=(chosen_ns - answerable_ns) / 1e9,
                confirmed_s=(self._answered_ns - answerable_ns) / 1e9,
            )
        )
        if self._ear is not None:
            self._ear.answered(chosen_ns)
        console.confirmed(trial=planned.trial, answer=answered)
        return Event.ANSWERED

    def _put_off(self, planned: PlannedTrial, attempt: int, reason: str) -> Event:
        self._log.write(Redo(trial=planned.trial, attempt=attempt, reason=reason, put_off=True))
        return Event.REDONE

    def _take(self, remark: Remark) -> None:
        _, words = self.remarks.take(remark)
        self._console.show(words)

    def _chosen(self, trial: int, answers: dict[str, str], others: dict[str, str]) -> tuple[str | Repeat, int]:
        """Return the key that was chosen and confirmed, and the session time of the choice, ns.

        Without one, return that the trial is repeated.
        """
        while True:
            further = dict(self.kind.keys)
            said = self._console.ask(trial=trial, answers=answers, others=others | further)
            chosen_ns = self._clock.now_ns()
            if not self._clock.simulated:
                chosen_ns -= self._console.chosen_ago_ns()
            self.remarks.note_ignored()
            if isinstance(said, Repeat) and said.trial == trial:
                return said, chosen_ns
            if not isinstance(said, str):
                self._take(said)
            elif said in further:
                self.kind.press(said)
            elif said in answers and (lacking := self.kind.lacking()):
                self._console.show(f"{lacking} No answer is taken before.")
            elif self._masking is None or not self._masking.change(said):
                confirmed = self._console.confirm(key=said, meaning=(answers | others)[said])
                self.remarks.note_ignored()
                if confirmed:
                    return said, chosen_ns
