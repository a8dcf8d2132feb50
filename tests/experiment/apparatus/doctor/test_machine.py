"""Clocks that are set, coarse or wrong, and a machine that wakes late."""

from __future__ import annotations

from datetime import UTC, datetime

import pytest
from syrupy.assertion import SnapshotAssertion

from palpate.experiment.apparatus.doctor import checks
from palpate.experiment.apparatus.doctor.checks import Mark
from palpate.experiment.clock import MonotonicClock
from palpate.experiment.rehearsal.clock import ManualClock

TODAY_NS = int(datetime(2026, 11, 21, 12, tzinfo=UTC).timestamp()) * 10**9


class Late(ManualClock):
    """Every fiftieth sleep ends later than it should."""

    def __init__(self, late_ns: int) -> None:
        super().__init__(0)
        self._late_ns = late_ns
        self._sleeps = 0

    def sleep_ns(self, duration_ns: int) -> None:
        self._sleeps += 1
        super().sleep_ns(duration_ns + (self._late_ns if self._sleeps % 50 == 0 else 0))


class Coarse(ManualClock):
    """Moves by a step whenever it is read."""

    def __init__(self, step_ns: int) -> None:
        super().__init__(0)
        self._step_ns = step_ns

    def now_ns(self) -> int:
        self.sleep_ns(self._step_ns)
        return super().now_ns()


@pytest.mark.parametrize(
    ("wall_s", "verdict"),
    [(5.0, "passes"), (5.009, "passes"), (5.011, "refuses"), (4.989, "refuses"), (3605.0, "refuses")],
)
def test_a_wall_clock_that_is_set_meanwhile_is_red(wall_s: float, verdict: str) -> None:
    begun, ended = Mark(10**18, TODAY_NS), Mark(10**18 + 5 * 10**9, TODAY_NS + round(wall_s * 1e9))
    assert checks.wall(begun, ended).verdict == verdict


def test_a_wall_clock_that_was_never_set_is_red(approved: SnapshotAssertion) -> None:
    found = checks.wall(Mark(0, 0), Mark(10**9, 10**9))
    assert found.verdict == "refuses"
    assert found.remedy == approved
    assert found.what.startswith("1970-01-01")


@pytest.mark.parametrize(("late_ms", "verdict"), [(9, "passes"), (11, "refuses")])
def test_a_machine_that_wakes_late_is_red(late_ms: int, verdict: str) -> None:
    found = checks.waking(Late(late_ms * 1_000_000))
    assert (found.verdict, f"0.00 ms late (median), {late_ms}.00 ms (p99)" in found.what) == (verdict, True)


@pytest.mark.parametrize(("step_us", "verdict"), [(1, "passes"), (10, "passes"), (15_625, "refuses")])
def test_a_coarse_clock_is_red(step_us: int, verdict: str) -> None:
    assert checks.resolution(Coarse(step_us * 1000)).verdict == verdict


def test_this_machines_clock_is_fine() -> None:
    clock = MonotonicClock()
    assert checks.resolution(clock).verdict == "passes"
    assert checks.wall(checks.mark(clock), checks.mark(clock)).verdict == "passes"
