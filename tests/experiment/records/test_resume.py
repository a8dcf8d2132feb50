"""Replaying a journal's entries."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from palpate.experiment.records.entries import Answer, Armed, Entry, Footer, Header, PlannedTrial, Redo, Trace
from palpate.experiment.records.kinds.footstep import BrokenOff, FootStep
from palpate.experiment.records.progress import progress
from palpate.experiment.records.tracker import Link, TrackerClock
from tests.experiment.session.bench import HEADER

ORDER = tuple(PlannedTrial(trial=n, presented=("foil",)) for n in range(1, 7))


def header() -> Header:
    return HEADER.model_copy(update={"order": ORDER, "block_trials": 6})


def armed(trial: int, attempt: int) -> Armed:
    return Armed(trial=trial, attempt=attempt, presented=("foil",))


def step(trial: int, attempt: int) -> FootStep:
    return FootStep(
        trial=trial,
        attempt=attempt,
        presented=("foil",),
        gate_top_us=0.0,
        gate_bottom_us=50_000.0,
        contact_us=100_000.0,
        speed_mm_s=200.0,
        clock=TrackerClock(anchor_us=0, anchor_ns=0, drift_ppm=0.0),
        dead_time_ms=None,
        link=Link(received=1, lost=0, damaged=0, repeated=0),
        trace=Trace(offset=0, length=0, sha256="0" * 64),
        stimulus=None,
        onset=None,
    )


def broken_off(trial: int, attempt: int, *, felt: bool) -> BrokenOff:
    return BrokenOff(
        trial=trial,
        attempt=attempt,
        presented=("foil",),
        reason="the foot turned back",
        felt=felt,
        clock=None,
        dead_time_ms=None,
        at_us=90_000,
        gate_top_us=0.0,
        gate_bottom_us=50_000.0,
        speed_mm_s=200.0,
        link=Link(received=1, lost=0, damaged=0, repeated=0),
        trace=Trace(offset=0, length=0, sha256="0" * 64),
    )


def answer(trial: int, attempt: int) -> Answer:
    return Answer(
        trial=trial,
        attempt=attempt,
        presented=("foil",),
        answered="foil",
        key="f",
        response_time_s=1.0,
        confirmed_s=1.0,
    )


def test_a_fresh_session_has_everything_left() -> None:
    done = progress([header()])
    assert done.remaining == ORDER
    assert (done.answered, done.attempts, done.unanswered, done.footer) == ((), {}, None, None)


def test_entries_without_header_are_a_programming_error() -> None:
    with pytest.raises(TypeError, match="header"):
        progress([answer(1, 1)])


@given(outcomes=st.lists(st.sampled_from(["answer", "redo", "kill"]), max_size=12))
def test_remaining_and_answered_always_make_up_the_order(outcomes: list[str]) -> None:
    entries: list[Entry] = [header()]
    trial, attempt = 1, 0
    for outcome in outcomes:
        if trial > len(ORDER):
            break
        attempt += 1
        entries += [armed(trial, attempt), step(trial, attempt)]
        if outcome == "answer":
            entries.append(answer(trial, attempt))
            trial, attempt = trial + 1, 0
        elif outcome == "redo":
            entries.append(Redo(trial=trial, attempt=attempt, reason="asked for", put_off=False))
    done = progress(entries)
    assert done.answered == tuple(range(1, trial))
    assert tuple(p.trial for p in done.remaining) == tuple(range(trial, 7))
    stepped = isinstance(entries[-1], FootStep)
    assert done.unanswered == ((trial, attempt) if stepped else None)


def test_an_answer_redone_later_no_longer_counts() -> None:
    done = progress(
        [header(), armed(1, 1), step(1, 1), answer(1, 1), Redo(trial=1, attempt=1, reason="misheard", put_off=False)]
    )
    assert done.answered == ()
    assert done.attempts == {1: 1}


@given(
    block=st.sampled_from([1, 2, 3, 6]),
    outcomes=st.lists(st.sampled_from(["answer", "redo", "put off", "broken off", "felt"]), max_size=40),
)
def test_what_is_put_off_comes_at_the_end_of_its_block(block: int, outcomes: list[str]) -> None:
    entries: list[Entry] = [header().model_copy(update={"block_trials": block})]
    # Oracle: a queue for each block, of which the first is served until it is empty.
    queues = [list(range(begin, begin + block)) for begin in range(1, 7, block)]
    attempts = dict.fromkeys(range(1, 7), 0)
    for outcome in outcomes:
        done = progress(entries)
        assert [planned.trial for planned in done.remaining] == [trial for queue in queues for trial in queue]
        queue = next((queue for queue in queues if queue), None)
        if queue is None:
            break
        trial = queue[0]
        attempts[trial] += 1
        entries.append(armed(trial, attempts[trial]))
        if outcome in ("broken off", "felt"):
            entries.append(broken_off(trial, attempts[trial], felt=outcome == "felt"))
        else:
            entries.append(step(trial, attempts[trial]))
        if outcome == "answer":
            entries.append(answer(trial, attempts[trial]))
            queue.pop(0)
        elif outcome in ("redo", "put off"):
            off = outcome == "put off"
            entries.append(Redo(trial=trial, attempt=attempts[trial], reason="a reason", put_off=off))
        if outcome in ("put off", "felt"):
            queue.append(queue.pop(0))
        done = progress(entries)
        assert done.unanswered is None
        assert done.attempts == {trial: count for trial, count in attempts.items() if count}


def test_an_attempt_is_armed_until_its_end_is_on_disk() -> None:
    begun: list[Entry] = [header(), armed(1, 1)]
    assert (progress(begun).armed, progress(begun).attempts) == ((1, 1), {1: 1})
    ends: list[Entry] = [
        step(1, 1),
        broken_off(1, 1, felt=False),
        Redo(trial=1, attempt=1, reason="a reason", put_off=True),
    ]
    assert [progress([*begun, end]).armed for end in ends] == [None, None, None]


def test_only_a_footer_at_the_end_ends_the_session() -> None:
    paused = Footer(reason="paused", answered=0)
    assert progress([header(), paused]).footer == paused
    assert progress([header(), paused, step(1, 1)]).footer is None
