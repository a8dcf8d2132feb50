"""Which cores a session and what works beside it run on; on a machine of any cores that this test makes up."""

from __future__ import annotations

import errno
import os
import sys
import threading
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path

import pytest

from palpate.experiment.apparatus import host

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="palpate keeps to a core on Linux alone")


class Machine:
    """Where the thread may run: at first anywhere."""

    def __init__(self, count: int) -> None:
        self.all = self.here = frozenset(range(count))
        self.closed: set[int] = set()
        """Cores that the system lets nobody go to."""

    def get(self, _who: int) -> frozenset[int]:
        return self.here

    def set(self, _who: int, wanted: frozenset[int]) -> None:
        if not wanted or wanted & self.closed:
            raise OSError(errno.EINVAL, "Invalid argument")
        self.here = frozenset(wanted)

    @property
    def beside(self) -> frozenset[int]:
        """Where what is started elsewhere runs."""
        with host.elsewhere():
            return self.here


Made = Callable[[int], Machine]


@pytest.fixture(autouse=True)
def alone(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Other sessions on this machine hold no core of these tests."""
    monkeypatch.setattr(host, "HELD", f"\0palpate-test-{os.getpid()}-{tmp_path.name}-{{}}")
    monkeypatch.setattr(host, "FREQUENCY", str(tmp_path / "khz-{}"))


@pytest.fixture
def machine(monkeypatch: pytest.MonkeyPatch) -> Made:
    def made(count: int) -> Machine:
        simulated = Machine(count)
        monkeypatch.setattr(os, "sched_getaffinity", simulated.get)
        monkeypatch.setattr(os, "sched_setaffinity", simulated.set)
        return simulated

    return made


def started(first: Callable[[], object] = lambda: None) -> set[int]:
    """Where a thread runs that is started here, once it has made a call."""
    seen: list[set[int]] = []

    def run() -> None:
        first()
        seen.append(os.sched_getaffinity(0))

    thread = threading.Thread(target=run)
    thread.start()
    thread.join()
    return seen[0]


def test_the_kernel_holds_it_and_what_is_started_inherits_it() -> None:
    before = os.sched_getaffinity(0)
    with host.pinned() as core:
        within, inherited = os.sched_getaffinity(0), started()
        with host.elsewhere():
            beside = started()
        assert os.sched_getaffinity(0) == within
    assert os.sched_getaffinity(0) == before
    assert inherited == within
    if len(before) > 1:
        assert within == {core}
        assert beside == before - within
    else:
        assert core is None
        assert within == beside == before


def test_of_equal_cores_it_is_the_last_and_the_others_are_left(machine: Made) -> None:
    here = machine(4)
    with host.pinned() as core:
        assert here.here == {core} == {3}
        assert here.beside == {0, 1, 2}
        assert here.here == {3}
    assert here.here == here.beside == here.all


def test_of_unequal_cores_it_is_the_fastest(machine: Made, tmp_path: Path) -> None:
    here = machine(4)
    for core, khz in enumerate((4_000_000, 5_000_000, 5_000_000, 3_000_000)):
        (tmp_path / f"khz-{core}").write_text(f"{khz}\n")
    with host.pinned():
        assert here.here == {2}


def test_only_cores_that_the_user_left_it_are_taken(machine: Made) -> None:
    here = machine(8)
    here.set(0, frozenset({1, 4, 5}))
    with host.pinned():
        assert here.here == {5}
        assert here.beside == {1, 4}
    assert here.here == {1, 4, 5}


def test_sessions_side_by_side_keep_to_different_cores_and_the_last_goes_anywhere(machine: Made) -> None:
    here = machine(3)
    with ExitStack() as opened:

        def begin() -> tuple[int | None, frozenset[int]]:
            here.here = here.all
            return opened.enter_context(host.pinned()), here.here

        assert [begin() for _ in range(3)] == [(2, {2}), (1, {1}), (None, here.all)]
    with host.pinned() as core:
        assert core == 2


def test_a_session_within_a_session_keeps_to_its_core_and_leaves_the_same(machine: Made) -> None:
    here = machine(4)
    with host.pinned(), host.pinned() as inner:
        assert inner is None
        assert here.here == {3}
        assert here.beside == {0, 1, 2}


def test_a_core_that_the_system_closes_is_not_taken(machine: Made) -> None:
    here = machine(4)
    here.closed = {3}
    with host.pinned() as core:
        assert core == 2
    here.closed = {1, 2, 3}
    with host.pinned() as core:
        assert core is None


def test_on_the_only_core_nothing_moves(machine: Made) -> None:
    here = machine(1)
    with host.pinned() as core:
        assert core is None
        assert here.here == here.beside == {0}


def test_outside_a_session_nothing_moves(machine: Made) -> None:
    here = machine(4)
    host.leaving()()
    assert here.here == here.beside == here.all


def test_a_thread_that_was_there_before_leaves_the_core() -> None:
    before = os.sched_getaffinity(0)
    with host.pinned():
        within, leave = os.sched_getaffinity(0), host.leaving()
    assert started(leave) == (before if within == before else before - within)


def test_it_is_given_back_when_a_session_fails(machine: Made) -> None:
    here = machine(4)
    with pytest.raises(KeyboardInterrupt), host.pinned():
        with pytest.raises(ValueError, match="a start"), host.elsewhere():
            raise ValueError("a start")
        assert here.here == {3}
        raise KeyboardInterrupt
    assert here.here == here.beside == here.all
    with host.pinned() as core:
        assert core == 3
