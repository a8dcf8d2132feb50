"""The states of a session and the one table of what may follow what."""

from __future__ import annotations

from enum import StrEnum

from experiment.errors import SessionError


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


TRANSITIONS: dict[tuple[State, Event], State] = {
    (State.READY, Event.BEGIN): State.FAMILIARISING,
    (State.READY, Event.RESUME): State.ARMED,
    (State.READY, Event.PAUSE): State.PAUSED,
    (State.READY, Event.FAIL): State.FAILED,
    (State.FAMILIARISING, Event.FAMILIARISED): State.ARMED,
    (State.FAMILIARISING, Event.PAUSE): State.PAUSED,
    (State.FAMILIARISING, Event.FAIL): State.FAILED,
    (State.ARMED, Event.STEPPED): State.ANSWERING,
    (State.ARMED, Event.BROKEN_OFF): State.ARMED,
    (State.ARMED, Event.LOST): State.WAITING,
    (State.ARMED, Event.EXHAUSTED): State.COMPLETE,
    (State.ARMED, Event.PAUSE): State.PAUSED,
    (State.ARMED, Event.FAIL): State.FAILED,
    (State.WAITING, Event.FOUND): State.ARMED,
    (State.WAITING, Event.PAUSE): State.PAUSED,
    (State.WAITING, Event.FAIL): State.FAILED,
    (State.ANSWERING, Event.ANSWERED): State.ARMED,
    (State.ANSWERING, Event.REDONE): State.ARMED,
    (State.ANSWERING, Event.PAUSE): State.PAUSED,
    (State.ANSWERING, Event.FAIL): State.FAILED,
}
"""Every transition there is; `COMPLETE`, `PAUSED` and `FAILED` end a runner."""


def follow(state: State, event: Event) -> State:
    """The state after `event`. Raises `SessionError` for a transition that the table does not hold."""
    try:
        return TRANSITIONS[state, event]
    except KeyError:
        allowed = ", ".join(e for s, e in TRANSITIONS if s is state) or "nothing: the session has ended"
        raise SessionError(f"a session that is {state} got {event}; allowed: {allowed}") from None
