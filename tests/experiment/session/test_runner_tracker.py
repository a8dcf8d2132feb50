"""The runner while its tracker drifts, stops, comes back or stays away, with scripted devices."""

from __future__ import annotations

import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from syrupy.assertion import SnapshotAssertion

from palpate.experiment import storage
from palpate.experiment.apparatus.tracker.clock_map import ClockMap
from palpate.experiment.apparatus.tracker.frames import LinkCounts, Samples
from palpate.experiment.apparatus.tracker.guarded import GuardedTracker
from palpate.experiment.apparatus.tracker.zeroing import ZeroedTracker
from palpate.experiment.desk.questions import Arm, Event, Question, Reply, Silent, TrialAnswer
from palpate.experiment.errors import PalpateError, TrackerError, TrackerStopped
from palpate.experiment.protocol.models import Protocol
from palpate.experiment.records.entries import Armed, Footer, Phase, TrackerOpened
from palpate.experiment.records.kinds.footstep import BrokenOff, FootStep, Zeroed
from palpate.experiment.rehearsal.clock import ManualClock
from palpate.experiment.session.runner import SLICE_S
from tests.approved import Refuses
from tests.experiment.session.bench import ORDER, Bench, bench, entries, header, in_pieces
from tests.experiment.session.scripted import ScriptedConsole, ScriptedTracker, rest_samples, step_samples


def test_a_device_that_restarted_between_two_steps_is_noticed(
    protocol: Protocol, tmp_path: Path, refuses: Refuses
) -> None:
    one = bench("cp", [step_samples(2_000_000, 150.0), step_samples(40_000_000, 150.0)])
    with refuses(TrackerError):
        one.run(protocol, header("real"), tmp_path)
    assert one.console.confirmations == [(1, "copy paper")]
    # The step is on file all the same, at the session time it was at.
    *_, step, footer = entries(tmp_path, "real")
    assert isinstance(step, FootStep)
    assert (step.trial, step.trace.length > 0) == (2, True)
    assert step.clock.anchor_us == pytest.approx(step.contact_us, abs=1)
    assert step.clock.anchor_ns == one.clock.now_ns()
    assert isinstance(footer, Footer)
    second = bench("pt")
    assert second.run(protocol, header("real"), tmp_path).reason == "complete"
    assert second.console.armed == [(3, 1), (2, 2)]


def test_where_clocks_part_a_step_and_its_onset_go_by_one_clock(protocol: Protocol, tmp_path: Path) -> None:
    one = bench("cp", [step_samples(2_000_000, 150.0), step_samples(40_000_000, 150.0)])
    with pytest.raises(TrackerError, match="the device restarted"):
        one.run(protocol, header("virtual"), tmp_path)
    for step in (e for e in entries(tmp_path, "virtual") if isinstance(e, FootStep)):
        by = ClockMap(step.clock.anchor_us, step.clock.anchor_ns, step.clock.drift_ppm)
        assert step.onset is not None
        assert step.onset.contact_ns == by.session_ns(step.contact_us)
    assert step.trial == 2


def risen(step: Samples) -> Samples:
    """From 15 mm on, inside the gate, a sensor reads 3 mm too much; the foot seems to stop."""
    return replace(step, height_mm=step.height_mm + 3.0 * (step.height_mm < 15.0))


def stuck(step: Samples) -> Samples:
    """From 15 mm on a sensor gives one height for 0.6 s."""
    us = int(step.device_us[0]) + 1000 * np.arange(700)
    height_mm = np.maximum(np.interp(us, step.device_us, step.height_mm), 15.0)
    return Samples(us, height_mm, bytes(700), np.arange(700) + 1, step.arrived_ns)


@pytest.mark.parametrize(
    ("lie", "told"),
    [
        (
            risen,
            "the tracker's heights jump from 15.0 to 17.9 mm inside the gate, which no foot can do; fasten the sensor",
        ),
        (stuck, "the tracker's height stays at 15.00 mm inside the gate, which no foot can do; restart the sensor"),
    ],
)
def test_a_foot_that_only_seems_to_stop_is_told_as_its_trackers_fault(
    protocol: Protocol, tmp_path: Path, lie: Callable[[Samples], Samples], told: str
) -> None:
    good = [step_samples(2_000_000 * n, 170.0) for n in (1, 2, 3)]
    one = bench("cpt", [*in_pieces(lie(step_samples(0, 170.0))), *good])
    assert one.run(protocol, header("virtual"), tmp_path) == Footer(reason="complete", answered=3, silent=True)
    assert one.console.rearmed == [(1, 2, told)]
    (broken,) = [e for e in entries(tmp_path, "virtual") if isinstance(e, BrokenOff)]
    assert not broken.felt


def test_frames_are_counted_until_contact_however_reads_are_cut(protocol: Protocol, tmp_path: Path) -> None:
    slow = step_samples(2_000_000, 60.0)
    for place, steps in enumerate(([slow], in_pieces(slow))):
        one = bench("c", [*steps, TrackerStopped("tracker at scripted: no frame for 200 ms")])
        one.run(protocol, header("real"), tmp_path / str(place))
        (step,) = [entry for entry in entries(tmp_path / str(place), "real") if isinstance(entry, FootStep)]
        assert step.link.received == 501


class Drifting(ScriptedTracker):
    """Before each step but the first 1500 s pass on its clock, and more or less on the session's."""

    def __init__(self, drift_ppm: float, *, clock: ManualClock) -> None:
        super().__init__([step_samples(n * 1_500_000_000, 150.0) for n in range(3)], clock=clock)
        self._drift_ppm = drift_ppm

    def read(self) -> Samples:
        self.clock_map = self.clock_map or ClockMap(0, self._clock.now_ns(), self._drift_ppm)
        due_ns = self.clock_map.session_ns(1_500_000_000 * (3 - len(self._steps)) + 1_000_000)
        self._clock.sleep_ns(max(due_ns - self._clock.now_ns(), 0))
        return super().read()


@pytest.mark.parametrize("drift_ppm", [5000.0, -5000.0, 30_000.0, -30_000.0])
def test_a_resonators_drift_over_a_session_is_no_restart(
    protocol: Protocol, tmp_path: Path, drift_ppm: float, refuses: Refuses
) -> None:
    one = bench("cpt")
    one.tracker = Drifting(drift_ppm, clock=one.clock)
    if abs(drift_ppm) < 10_000:
        assert one.run(protocol, header("real"), tmp_path) == Footer(reason="complete", answered=3)
    else:
        with refuses(TrackerError):
            one.run(protocol, header("real"), tmp_path)


def test_a_stopped_tracker_ends_the_session_with_a_footer_and_loses_nothing(
    protocol: Protocol, tmp_path: Path, approved: SnapshotAssertion
) -> None:
    stopped = TrackerStopped("tracker at scripted: no frame for 200 ms")
    steps: list[Samples | PalpateError] = [step_samples(0, 150.0), stopped]
    footer = bench("c", steps).run(protocol, header("real"), tmp_path)
    assert (footer.reason, footer.answered) == ("paused", 1)
    assert footer.detail == approved
    assert entries(tmp_path, "real")[-1] == footer
    second = bench("pt")
    assert second.run(protocol, header("real"), tmp_path) == Footer(reason="complete", answered=3)
    assert second.console.armed == [(2, 2), (3, 1)]


def test_a_tracker_that_comes_back_goes_on_with_the_same_trial(
    protocol: Protocol, tmp_path: Path, approved: SnapshotAssertion
) -> None:
    first, _ = step_samples(2_000_000, 150.0).cut(100)
    said = "tracker at scripted: the port has gone; plug the device in again"
    # It restarts: its clock begins anew.
    one = bench("cpt")
    one.tracker = ScriptedTracker(
        [step_samples(0, 150.0), first, TrackerStopped(said), step_samples(0, 150.0), step_samples(2_000_000, 150.0)],
        clock=one.clock,
        comes_back=True,
    )
    assert one.run(protocol, header("real"), tmp_path) == Footer(reason="complete", answered=3)
    assert one.console.armed == [(1, 1), (2, 1), (2, 2), (3, 1)]
    assert one.console.shown[1] == approved
    (broken,) = [e for e in entries(tmp_path, "real") if isinstance(e, BrokenOff)]
    assert (broken.trial, broken.felt, broken.speed_mm_s, broken.at_us) == (2, False, None, 2_099_000)
    assert broken.trace.length == broken.link.received == 100
    kinds = [type(e) for e in entries(tmp_path, "real")]
    lost = kinds.index(BrokenOff)
    assert kinds[lost : lost + 5] == [BrokenOff, Phase, Phase, Armed, TrackerOpened]


def test_a_tracker_that_goes_between_two_steps_is_waited_for_and_the_same_attempt_is_armed_again(
    protocol: Protocol, tmp_path: Path, approved: SnapshotAssertion
) -> None:
    said = "tracker at scripted: the port has gone; plug the device in again"
    one = bench("cpt")
    one.tracker = ScriptedTracker(
        [step_samples(0, 150.0), step_samples(0, 150.0), step_samples(2_000_000, 150.0)],
        clock=one.clock,
        comes_back=True,
    )
    one.tracker.drains.extend([None, TrackerStopped(said)])
    assert one.run(protocol, header("real"), tmp_path) == Footer(reason="complete", answered=3)
    assert one.console.armed == [(1, 1), (2, 1), (3, 1)]
    assert one.console.placed == [(n, ORDER[n - 1]) for n in (1, 2, 2, 3)]
    assert one.console.shown[1] == approved
    done = entries(tmp_path, "real")
    assert [e.detail for e in done if isinstance(e, Phase) and e.state == "waiting"] == [said]
    kinds = [type(e) for e in done]
    assert BrokenOff not in kinds
    assert kinds.count(TrackerOpened) == 2


def test_heights_count_from_where_the_foot_rested_and_again_once_the_tracker_has_come_back(
    protocol: Protocol, tmp_path: Path, approved: SnapshotAssertion
) -> None:
    def worn(start_us: int, sole_mm: float) -> Samples:
        step = step_samples(start_us, 150.0)
        return replace(step, height_mm=step.height_mm + sole_mm)

    one = bench("cpt")
    stopped = TrackerStopped("tracker at scripted: the port has gone; plug the device in again")
    one.tracker = ScriptedTracker(
        [
            rest_samples(0, 9.0),
            rest_samples(500_000, 2.5),
            worn(1_000_000, 2.5),
            stopped,
            rest_samples(0, -1.5),
            worn(500_000, -1.5),
            worn(2_500_000, -1.5),
        ],
        clock=one.clock,
        comes_back=True,
    )
    one.zeroed = ZeroedTracker(one.tracker, contact_mm=0.0, farthest_mm=3.0, samples=200)
    assert one.run(protocol, header("real"), tmp_path) == Footer(reason="complete", answered=3)
    assert [why.partition("; ")[0] for why in one.console.rested] == approved
    assert any(" -1.50 mm" in line for line in one.console.shown)
    done = entries(tmp_path, "real")
    zeros = [e for e in done if isinstance(e, Zeroed)]
    assert zeros == [Zeroed(offset_mm=mm, spread_mm=0.0, samples=200) for mm in (2.5, -1.5)]
    # 30 mm at 150 mm/s: 0.2 s after each step began.
    steps = [e for e in done if isinstance(e, FootStep)]
    assert [step.contact_us for step in steps] == pytest.approx([1_200_000, 700_000, 2_700_000], abs=1)


def test_a_tracker_that_goes_between_two_steps_and_stays_away_pauses(
    protocol: Protocol, tmp_path: Path, approved: SnapshotAssertion
) -> None:
    one = bench("c")
    one.tracker.drains.extend([None, TrackerStopped("tracker at scripted: the port has gone")])
    footer = one.run(protocol, header("real"), tmp_path)
    assert (footer.reason, footer.answered) == ("paused", 1)
    assert footer.detail == approved
    second = bench("pt")
    assert second.run(protocol, header("real"), tmp_path) == Footer(reason="complete", answered=3)
    assert second.console.armed == [(2, 1), (3, 1)]


def test_a_tracker_that_stops_after_contact_has_its_trial_put_off(protocol: Protocol, tmp_path: Path) -> None:
    landed, _ = step_samples(0, 150.0).cut(220)
    one = bench("cpt")
    one.tracker = ScriptedTracker(
        [landed, TrackerStopped("gone"), *(step_samples(2_000_000 * n, 150.0) for n in range(1, 4))],
        clock=one.clock,
        comes_back=True,
    )
    assert one.run(protocol, header("virtual"), tmp_path) == Footer(reason="complete", answered=3, silent=True)
    assert len(one.actuator.played) == 4
    assert one.console.armed == [(1, 1), (2, 1), (3, 1), (1, 2)]


class Foreign(ScriptedTracker):
    """A driver of somebody else's: once its device is gone, the parts named fail as `read` does."""

    failing: frozenset[str] = frozenset()
    gone = False

    def read(self) -> Samples:
        if not self._steps:
            self.gone = True
            raise OSError("no such device")
        return super().read()

    def __getattribute__(self, name: str) -> object:
        held = super().__getattribute__
        if held("gone") and name in held("failing"):
            raise OSError("no such device")
        return held(name)


@pytest.mark.parametrize("failing", [(), ("counts",), ("clock_map",), ("counts", "clock_map")])
def test_a_step_that_was_felt_is_on_file_when_a_foreign_tracker_fails_in_every_part(
    protocol: Protocol, tmp_path: Path, failing: tuple[str, ...], refuses: Refuses
) -> None:
    landed, _ = step_samples(2_000_000, 100.0).cut(310)
    one = bench("c")
    driver = Foreign([landed], clock=one.clock)
    driver.failing = frozenset(failing)
    one.foreign = GuardedTracker(driver, "lab.tracker:Tracker")
    with refuses(TrackerError):
        one.run(protocol, header("virtual"), tmp_path)
    broken, _ = (e for e in entries(tmp_path, "virtual") if isinstance(e, BrokenOff | Footer))
    assert isinstance(broken, BrokenOff)
    assert broken.felt
    assert broken.clock is not None
    assert broken.clock.anchor_us == 2_000_000
    assert broken.trace.length == broken.link.received == 310
    assert storage.foot_path(storage.journal_path(tmp_path, "01", "virtual")).stat().st_size == 310


def test_a_step_whose_times_jump_inside_the_gate_was_felt_and_does_not_count(
    protocol: Protocol, tmp_path: Path
) -> None:
    good = [step_samples(2_000_000 * n, 100.0) for n in range(1, 5)]
    later = 20_000 * (np.arange(good[0].device_us.size) > 150)
    one = bench("ccc", [replace(good[0], device_us=good[0].device_us + later), *good[1:]])
    assert one.run(protocol, header("virtual"), tmp_path) == Footer(reason="complete", answered=3, silent=True)
    (broken,) = (entry for entry in entries(tmp_path, "virtual") if isinstance(entry, BrokenOff))
    told = "the tracker's times have gaps for 20 frames, but only 0 are missing; restart it, or have its clock repaired"
    assert (broken.trial, broken.attempt, broken.felt, broken.reason) == (1, 1, True, told)
    assert sum(f": {told}." in line for line in one.console.shown) == 1
    assert one.console.armed == [(1, 1), (2, 1), (3, 1), (1, 2)]
    steps = [entry for entry in entries(tmp_path, "virtual") if isinstance(entry, FootStep)]
    assert [step.speed_mm_s for step in steps] == pytest.approx([100.0] * 3)


def test_one_false_reading_sets_nothing_off(protocol: Protocol, tmp_path: Path) -> None:
    steps = [step_samples(2_000_000 * n, 100.0) for n in range(1, 4)]
    false = steps[0].height_mm.copy()
    false[50] = 0.0
    one = bench("ccc", [replace(steps[0], height_mm=false), *steps[1:]])
    assert one.run(protocol, header("virtual"), tmp_path) == Footer(reason="complete", answered=3, silent=True)
    assert one.console.armed == [(1, 1), (2, 1), (3, 1)]
    assert [speed for _, speed in one.rendered] == pytest.approx([100.0] * 3)


class Watched(ScriptedConsole):
    """Looks at the session's gauges, from another thread, whenever a trial is armed, as a desk does at any moment."""

    def ask(self, question: Question | Arm) -> Reply:
        if isinstance(question, Arm):
            session = self.attended[-1]
            assert session is not None
            with ThreadPoolExecutor(1) as desk:
                gauges = desk.submit(session.gauges).result(10)
            assert gauges is not None
            self.lamps = gauges.lamps
        return super().ask(question)


class ForOneThread(ScriptedTracker):
    """A driver that one thread alone may ask for its counts."""

    _counts = LinkCounts()

    @property
    def counts(self) -> LinkCounts:
        if threading.current_thread() is not threading.main_thread():
            raise TrackerError("tracker: its counts were read by another thread")
        return self._counts

    @counts.setter
    def counts(self, counts: LinkCounts) -> None:
        self._counts = counts


def test_a_desk_that_looks_asks_no_driver_for_anything(protocol: Protocol, tmp_path: Path) -> None:
    one = bench("cpt")
    one.console = console = Watched(one.clock, "cpt")
    one.tracker = ForOneThread(
        [step_samples(2_000_000 * n, 150.0) for n in (1, 2, 3)], lost=(0, 15, 0), clock=one.clock
    )
    assert one.run(protocol, header("real"), tmp_path).reason == "complete"
    (lamp,) = [lamp for lamp in console.lamps if lamp.name == "tracker"]
    # Before the third trial: two steps of 0.4 s at 1 kHz, and 15 / 815 = 0.0184.
    assert lamp.good is False
    assert "(1.84%)" in lamp.words
    assert lamp.words.startswith("15 ")


@pytest.mark.parametrize(("nobody", "drained"), [([], 3), ([True], 4), ([False, True], 4)])
def test_what_the_foot_did_while_nobody_was_at_the_console_is_no_trial(
    protocol: Protocol, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, nobody: list[bool], drained: int
) -> None:
    one = bench("cpt")
    one.console.nobody_there.extend(nobody)
    drains = []
    monkeypatch.setattr(one.tracker, "drain", lambda: drains.append(len(one.console.armed)))
    assert one.run(protocol, header("real"), tmp_path).reason == "complete"
    assert len(drains) == drained
    # What is read after the experimenter came is of the trial.
    assert not nobody or drains.count(len(nobody)) == 2


def test_a_step_that_broke_off_is_watched_on_unless_nobody_was_there(protocol: Protocol, tmp_path: Path) -> None:
    good = [step_samples(2_000_000 * n, 170.0) for n in (1, 2, 3)]
    for place, nobody in enumerate((False, True)):
        one = bench("cpt", [*in_pieces(risen(step_samples(0, 170.0))), *good])
        one.console.nobody_there.extend([False, nobody])
        drains: list[tuple[int, int]] = []

        def drain(one: Bench = one, drains: list[tuple[int, int]] = drains) -> None:
            drains.append((len(one.console.armed), len(one.console.rearmed)))

        one.tracker.drain = drain  # type: ignore[method-assign]
        assert one.run(protocol, header("virtual"), tmp_path / str(place)).reason == "complete"
        # Before the second trial is armed, in any case.
        assert drains.count((1, 1)) == 1 + nobody


def test_a_pause_is_met_while_the_tracker_is_away(protocol: Protocol, tmp_path: Path) -> None:
    one = bench("c")
    stays_away = one.tracker.reconnect

    def reconnect(timeout_s: float) -> None:
        session = one.console.attended[-1]
        assert session is not None
        assert one.console.waited == 1
        session.pause("by the experimenter")
        stays_away(timeout_s)

    one.tracker.reconnect = reconnect  # type: ignore[method-assign]
    one.tracker.drains.extend([None, TrackerStopped("tracker at scripted: the port has gone")])
    begun_ns = one.clock.now_ns()
    footer = one.run(protocol, header("real"), tmp_path)
    assert footer == Footer(reason="paused", detail="by the experimenter", answered=1)
    (lost,) = [e for e in entries(tmp_path, "real") if isinstance(e, Phase) and e.state == "waiting"]
    assert lost.detail.startswith("tracker at scripted: ")
    # Twice 100 s of familiarisation, and one answer.
    assert one.clock.now_ns() - begun_ns <= (200 + 1 + SLICE_S) * 1e9


def test_a_step_that_counts_is_told_until_the_next_trial_is_armed(protocol: Protocol, tmp_path: Path) -> None:
    class Looking(ScriptedConsole):
        def ask(self, question: Question | Arm) -> Reply:
            if isinstance(question, Arm | TrialAnswer):
                told.append(stepped())
            return super().ask(question)

    def stepped() -> bool:
        session = one.console.attended[-1]
        gauges = session.gauges() if session is not None else None
        assert gauges is not None
        return gauges.stepped

    told: list[bool] = []
    one = bench("cpt")
    one.console = Looking(one.clock, "cpt")
    assert one.run(protocol, header("real"), tmp_path) == Footer(reason="complete", answered=3)
    assert told == [False, True] * 3


@pytest.mark.parametrize("between", [False, True])
def test_the_lamp_is_red_and_no_trace_stands_still_while_the_tracker_is_silent(
    protocol: Protocol, tmp_path: Path, *, between: bool
) -> None:
    class Waiting(ScriptedConsole):
        def tell(self, event: Event) -> None:
            if isinstance(event, Silent):
                told.append(measured())

        def ask(self, question: Question | Arm) -> Reply:
            if isinstance(question, TrialAnswer):
                told.append(measured())
                one.tracker.gone = question.trial == 3
                told.append(measured())
            return super().ask(question)

    def measured() -> tuple[bool | None, bool]:
        session = one.console.attended[-1]
        gauges = session.gauges() if session is not None else None
        assert gauges is not None
        return next(lamp.good for lamp in gauges.lamps if lamp.name == "tracker"), bool(gauges.trace)

    told: list[tuple[bool | None, bool]] = []
    one = bench("cpt")
    stopped = TrackerStopped("tracker at scripted: the port has gone; plug the device in again")
    steps: list[Samples | PalpateError] = [step_samples(n * 2_000_000, 150.0) for n in range(3)]
    script = [*steps[:1], *([] if between else [stopped]), *steps[1:]]
    one.tracker = ScriptedTracker(script, clock=one.clock, comes_back=True)
    if between:
        one.tracker.drains.extend([None, stopped])
    one.console = Waiting(one.clock, "cpt")
    assert one.run(protocol, header("real"), tmp_path) == Footer(reason="complete", answered=3)
    well, silent = (True, True), (False, False)
    assert told == [well, well, silent, well, well, well, silent]
