"""The transition table as a whole."""

from __future__ import annotations

import itertools

import pytest

from palpate.experiment.errors import SessionError
from palpate.experiment.session.attempt import TRANSITIONS, Event, State, follow

ENDS = {State.COMPLETE, State.PAUSED, State.FAILED}


def test_nothing_follows_an_end() -> None:
    assert not {state for state, _ in TRANSITIONS} & ENDS


def test_every_state_is_reached_and_every_running_state_can_fail_or_pause() -> None:
    assert set(TRANSITIONS.values()) | {State.READY} == set(State)
    for state in set(State) - ENDS:
        assert TRANSITIONS[state, Event.FAIL] is State.FAILED
        assert TRANSITIONS[state, Event.PAUSE] is State.PAUSED


def test_an_answer_needs_a_step_first() -> None:
    assert [s for (s, e) in TRANSITIONS if e is Event.ANSWERED] == [State.ANSWERING]
    assert [s for (s, e), after in TRANSITIONS.items() if after is State.ANSWERING] == [State.ARMED]


@pytest.mark.parametrize(
    ("state", "event"), [pair for pair in itertools.product(State, Event) if pair not in TRANSITIONS]
)
def test_what_the_table_does_not_hold_is_refused(state: State, event: Event) -> None:
    with pytest.raises(SessionError, match=f"a session that is {state} got {event}; allowed: "):
        follow(state, event)
