"""The priority of a session: what the system allows, said in words, and given back."""

from __future__ import annotations

import gc
import os
import sys
import threading
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from syrupy.assertion import SnapshotAssertion
from threadpoolctl import threadpool_info, threadpool_limits

from palpate.experiment.apparatus import host
from palpate.experiment.apparatus.host import beside

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="palpate raises its priority on Linux alone")


ORDINARY_NICE = 0
"""Of a process that nobody changed; whoever runs the tests may stand above or below it."""


def refuse(*_: object) -> None:
    raise PermissionError(1, "Operation not permitted")


def standing() -> tuple[int, int]:
    return os.sched_getscheduler(0), os.getpriority(os.PRIO_PROCESS, 0)


def test_what_it_says_is_what_the_kernel_holds_and_it_is_given_back() -> None:
    before = standing()
    inherited: list[tuple[int, int]] = []
    with host.raised() as got:
        within = standing()
        thread = threading.Thread(target=lambda: inherited.append(standing()))
        thread.start()
        thread.join()
    assert standing() == before
    assert inherited == [within]
    if got.startswith("real time"):
        assert within[0] == os.SCHED_RR
    elif got.startswith("nice "):
        assert within[1] == int(got.partition(":")[0].removeprefix("nice "))
        assert within[1] < before[1]
    else:
        assert got.startswith("ordinary: ")
        assert within == before


def test_without_the_right_to_real_time_it_is_made_less_nice(
    monkeypatch: pytest.MonkeyPatch, approved: SnapshotAssertion
) -> None:
    asked: list[int] = []
    monkeypatch.setattr(os, "getpriority", lambda *_: ORDINARY_NICE)
    monkeypatch.setattr(os, "sched_setscheduler", refuse)
    monkeypatch.setattr(os, "setpriority", lambda _which, _who, nice: asked.append(nice))
    with host.raised() as got:
        pass
    assert asked == [host.LEAST_NICE]
    assert got == approved


def test_without_any_right_it_stays_as_it_is_and_says_how_to_get_more(
    monkeypatch: pytest.MonkeyPatch, approved: SnapshotAssertion
) -> None:
    before = standing()
    monkeypatch.setattr(os, "sched_setscheduler", refuse)
    monkeypatch.setattr(os, "setpriority", refuse)
    with host.raised() as got:
        assert standing() == before
    assert got == approved


@pytest.mark.parametrize("content", ["-1\n", "1000000\n", "", None])
def test_no_real_time_where_the_kernel_would_let_it_lock_the_machine(
    content: str | None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    throttle = tmp_path / "sched_rt_runtime_us"
    if content is not None:
        throttle.write_text(content)
    (tmp_path / "sched_rt_period_us").write_text("1000000\n")
    monkeypatch.setattr(host, "THROTTLE", throttle)
    monkeypatch.setattr(host, "PERIOD", tmp_path / "sched_rt_period_us")
    with host.raised() as got:
        assert os.sched_getscheduler(0) == os.SCHED_OTHER
    assert not got.startswith("real time")


def test_it_is_given_back_when_a_session_fails() -> None:
    before, frozen = standing(), gc.get_freeze_count()
    with pytest.raises(KeyboardInterrupt), host.raised():
        raise KeyboardInterrupt
    assert standing() == before
    assert gc.get_freeze_count() == frozen == 0


def test_linear_algebra_stays_in_the_thread_that_asks() -> None:
    def threads() -> list[int]:
        return [library["num_threads"] for library in threadpool_info() if library["user_api"] == "blas"]

    np.dot(np.ones(2), np.ones(2))
    with threadpool_limits(2, user_api="blas"):
        before = threads()
        with host.raised():
            within = threads()
        after = threads()
    assert before
    assert set(within) == {1}
    assert after == before


def test_nothing_is_collected_while_undisturbed() -> None:
    seen: list[str] = []

    def watch(phase: str, _info: dict[str, int]) -> None:
        seen.append(phase)

    gc.callbacks.append(watch)
    try:
        with host.undisturbed():
            kept: list[list[int]] = [[] for _ in range(100_000)]
            assert not seen
        assert len(kept) == 100_000
        more: list[list[int]] = [[] for _ in range(100_000)]
    finally:
        gc.callbacks.remove(watch)
    assert seen
    assert len(more) == 100_000


def test_collection_that_was_off_stays_off() -> None:
    gc.disable()
    try:
        with host.undisturbed():
            pass
        assert not gc.isenabled()
    finally:
        gc.enable()


Rank = tuple[int, int]
"""Policy and real-time priority."""

RESET = os.SCHED_RESET_ON_FORK if sys.platform == "linux" else 0
JUST_ABOVE = (os.SCHED_RR, host.REAL_TIME + 1) if sys.platform == "linux" else (0, 0)


def test_in_real_time_alone_the_session_keeps_to_a_core_and_says_which(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(host, "HELD", f"\0palpate-test-{os.getpid()}-{{}}")
    before = os.sched_getaffinity(0)
    with host.raised() as got:
        within = os.sched_getaffinity(0)
    assert os.sched_getaffinity(0) == before
    if got.startswith("real time") and len(before) > 1:
        assert got == f"real time, on core {max(within)} only"
        assert len(within) == 1
    else:
        assert within == before


def in_a_thread(join: Callable[[], None], before: Rank | None = None) -> Rank:
    """The rank of a thread that joined; it inherits that of the caller, or begins with `before`."""
    seen: list[Rank] = []

    def called() -> None:
        if before is not None:
            os.sched_setscheduler(0, before[0], os.sched_param(before[1]))
        join()
        seen.append((os.sched_getscheduler(0), os.sched_getparam(0).sched_priority))

    thread = threading.Thread(target=called)
    thread.start()
    thread.join()
    return seen[0]


@pytest.fixture
def joining() -> Callable[[], None]:
    with host.raised() as got:
        if not got.startswith("real time"):
            pytest.skip("the system allows no real time")
        return host.joining()


def test_a_thread_that_is_ordinary_joins_just_above_the_session(joining: Callable[[], None]) -> None:
    assert in_a_thread(joining) == JUST_ABOVE


def test_a_thread_that_inherits_the_priority_of_the_session_goes_above_it() -> None:
    with host.raised() as got:
        if not got.startswith("real time"):
            pytest.skip("the system allows no real time")
        assert in_a_thread(host.joining()) == JUST_ABOVE


@pytest.mark.parametrize("policy", ["SCHED_FIFO", "SCHED_RR"])
@pytest.mark.parametrize("reset", [0, RESET])
def test_a_thread_that_stands_higher_stays_there(joining: Callable[[], None], policy: str, reset: int) -> None:
    rank = getattr(os, policy) | reset, 20
    assert in_a_thread(joining, before=rank) == rank


def test_where_no_step_above_is_allowed_it_runs_beside_the_session(
    joining: Callable[[], None], monkeypatch: pytest.MonkeyPatch
) -> None:
    set_before = os.sched_setscheduler

    def at_most_the_lowest(who: int, policy: int, parameters: os.sched_param) -> None:
        if parameters.sched_priority > host.REAL_TIME:
            refuse()
        set_before(who, policy, parameters)

    monkeypatch.setattr(os, "sched_setscheduler", at_most_the_lowest)
    assert in_a_thread(joining) == (os.SCHED_RR, host.REAL_TIME)


def test_beside_an_ordinary_session_a_thread_stays_ordinary() -> None:
    before = os.sched_getscheduler(0), 0
    assert in_a_thread(host.joining()) == before


def test_what_a_person_waits_for_is_less_nice_where_that_is_allowed(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[int] = []
    monkeypatch.setattr(os, "getpriority", lambda *_: ORDINARY_NICE)
    monkeypatch.setattr(os, "setpriority", lambda _which, _who, nice: asked.append(nice))
    host.favour()
    assert asked == [host.FAVOURED_NICE]
    monkeypatch.setattr(os, "getpriority", lambda *_: host.LEAST_NICE)
    host.favour()
    assert asked == [host.FAVOURED_NICE], "what is less nice already stays so"


def test_without_the_right_a_console_works_as_it_is(monkeypatch: pytest.MonkeyPatch) -> None:
    before = standing()
    monkeypatch.setattr(os, "setpriority", refuse)
    host.favour()
    assert standing() == before


@pytest.mark.parametrize(("real_time", "levels"), [(True, [host.REAL_TIME + 2]), (False, [])])
def test_a_simulated_device_waits_for_no_session(
    monkeypatch: pytest.MonkeyPatch, *, real_time: bool, levels: list[int]
) -> None:
    asked: list[int] = []
    monkeypatch.setattr(beside, "is_real_time", lambda: real_time)
    monkeypatch.setattr(os, "sched_setscheduler", lambda _who, _how, given: asked.append(given.sched_priority))
    beside.raise_above_sessions()
    assert asked == levels
