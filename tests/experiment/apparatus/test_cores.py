"""Which cores a session and what works beside it run on; on a machine of any cores that this test makes up."""

from __future__ import annotations

import os
import sys
import tempfile
import threading
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path

import pytest

from experiment.apparatus import cores

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="palpate keeps to a core on Linux alone")


class Machine:
    """Where each thread may run; one begins where the thread that made the machine is."""

    def __init__(self, count: int) -> None:
        self.all = frozenset(range(count))
        self.threads: dict[int, frozenset[int]] = {}

    def get(self, _who: int) -> frozenset[int]:
        return self.threads.get(threading.get_ident(), self.all)

    def set(self, _who: int, wanted: frozenset[int]) -> None:
        assert wanted, "the kernel refuses none"
        assert wanted <= self.all
        self.threads[threading.get_ident()] = frozenset(wanted)

    @property
    def here(self) -> frozenset[int]:
        return self.get(0)


Made = Callable[[int], Machine]


@pytest.fixture
def machine(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Made:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    monkeypatch.setattr(cores, "FREQUENCY", str(tmp_path / "khz-{}"))

    def made(count: int) -> Machine:
        simulated = Machine(count)
        monkeypatch.setattr(os, "sched_getaffinity", simulated.get)
        monkeypatch.setattr(os, "sched_setaffinity", simulated.set)
        return simulated

    return made


def in_a_thread(machine: Machine, call: Callable[[], None]) -> frozenset[int]:
    """Where a thread is after a call."""
    seen: list[frozenset[int]] = []

    def called() -> None:
        call()
        seen.append(machine.here)

    thread = threading.Thread(target=called)
    thread.start()
    thread.join()
    return seen[0]


def test_the_kernel_holds_it_and_what_is_started_inherits_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    before = os.sched_getaffinity(0)
    inherited: list[set[int]] = []
    with cores.kept():
        within = os.sched_getaffinity(0)
        thread = threading.Thread(target=lambda: inherited.append(os.sched_getaffinity(0)))
        thread.start()
        thread.join()
        with cores.elsewhere():
            beside = os.sched_getaffinity(0)
        assert os.sched_getaffinity(0) == within
    assert os.sched_getaffinity(0) == before
    assert inherited == [within]
    if len(before) > 1:
        assert len(within) == 1
        assert beside == before - within
    else:
        assert within == beside == before


def test_of_equal_cores_it_is_the_last_and_the_others_are_left(machine: Made) -> None:
    here = machine(4)
    with cores.kept():
        assert here.here == {3}
        assert in_a_thread(here, cores.leaving()) == {0, 1, 2}
        with cores.elsewhere():
            assert here.here == {0, 1, 2}
        assert here.here == {3}
    assert here.here == here.all


def test_of_unequal_cores_it_is_the_fastest(machine: Made, tmp_path: Path) -> None:
    here = machine(4)
    for core, khz in enumerate((4_000_000, 5_000_000, 5_000_000, 3_000_000)):
        (tmp_path / f"khz-{core}").write_text(f"{khz}\n")
    with cores.kept():
        assert here.here == {2}


def test_only_cores_that_the_user_left_it_are_taken(machine: Made) -> None:
    here = machine(8)
    here.set(0, frozenset({1, 4, 5}))
    with cores.kept():
        assert here.here == {5}
        assert in_a_thread(here, cores.leaving()) == {1, 4}
    assert here.here == {1, 4, 5}


def test_sessions_side_by_side_keep_to_different_cores_and_the_last_goes_anywhere(machine: Made) -> None:
    here = machine(3)
    with ExitStack() as opened:

        def begin() -> frozenset[int]:
            here.set(0, here.all)
            opened.enter_context(cores.kept())
            return here.here

        assert [begin() for _ in range(3)] == [{2}, {1}, {0, 1, 2}]
    with cores.kept():
        assert here.here == {2}


def test_a_session_on_the_only_core_leaves_none_and_stays(machine: Made) -> None:
    here = machine(1)
    with cores.kept(), cores.elsewhere():
        assert here.here == {0}
        assert in_a_thread(here, cores.leaving()) == {0}


def test_outside_a_session_nothing_moves(machine: Made) -> None:
    here = machine(4)
    with cores.elsewhere():
        assert here.here == here.all
    assert in_a_thread(here, cores.leaving()) == here.all


def test_it_is_given_back_when_a_session_fails(machine: Made) -> None:
    here = machine(4)
    with pytest.raises(KeyboardInterrupt), cores.kept():
        raise KeyboardInterrupt
    assert here.here == here.all
    with cores.kept():
        assert here.here == {3}


def test_where_nobody_can_tell_who_keeps_to_it_no_core_is_taken(
    machine: Made, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    here = machine(4)
    (tmp_path / "file").touch()
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "file" / "folder"))
    with cores.kept():
        assert here.here == here.all
