"""The runner from familiarisation to the footer, with scripted devices."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from pydantic import ValidationError

from experiment.apparatus.clock_map import ClockMap
from experiment.apparatus.foreign import ForeignTracker
from experiment.apparatus.ports import Masker
from experiment.apparatus.samples import Samples
from experiment.apparatus.zeroing import ZeroedTracker
from experiment.clock import ManualClock
from experiment.errors import ActuatorError, AudioError, JournalError, PalpateError, TrackerError, TrackerStopped
from experiment.protocol import load
from experiment.protocol.models import Protocol
from experiment.protocol.shipped import shipped
from experiment.records import (
    Answer,
    BrokenOff,
    Footer,
    FootStep,
    Header,
    Phase,
    PlannedTrial,
    Redo,
    Resumed,
    TrackerOpened,
    Zeroed,
)
from experiment.scene import Rendered
from experiment.session import attempt, journal, places, runner, story
from experiment.stimulus_record import Computed, Delivered, Stimulus
from experiment.synthesis.crinkle import Synthesised
from experiment.synthesis.spectra import Bins
from tests.experiment.session.scripted import (
    START_NS,
    ScriptedActuator,
    ScriptedConsole,
    ScriptedTracker,
    rest_samples,
    step_samples,
)
from tests.experiment.session.test_journal import HEADER

ORDER = ("copy paper", "polypropylene", "copy paper")
COMPUTED = Computed(method="constant", relative_error=0.0)
DELIVERED = Delivered(
    requested_ns=0, onset_ns=0, onset_error_ms=0.0, gain=1.0, residual_db=-60.0, xruns=0, delivered=True
)


@pytest.fixture(scope="module")
def protocol(repository_root: Path) -> Protocol:
    return load.load(repository_root / "protocols" / "okamoto2012.toml")


def header(task: str) -> Header:
    order = tuple(PlannedTrial(trial=n, presented=material) for n, material in enumerate(ORDER, start=1))
    return HEADER.model_copy(update={"order": order, "task": task, "block_trials": len(order)})


@dataclass
class Bench:
    """One set of scripted devices; `rendered` is what synthesis was asked for."""

    tracker: ScriptedTracker
    console: ScriptedConsole
    actuator: ScriptedActuator
    clock: ManualClock
    rendered: list[tuple[str, float]]
    masker: Masker | None = None
    priority: str = ""
    zeroed: ZeroedTracker | None = None
    foreign: ForeignTracker | None = None

    def run(self, protocol: Protocol, asked: Header, dataset: Path) -> Footer:
        def render(material: str, speed_mm_s: float, rate_hz: int) -> Rendered:
            self.rendered.append((material, speed_mm_s))
            made = Synthesised(
                np.full(rate_hz // 2, 1.5),
                floored_bins=3,
                extrapolated=False,
                dropped_bins=0,
                bins=lambda: Bins(np.zeros(1), samples=1, rate_hz=rate_hz),
            )
            return Rendered(made, COMPUTED)

        virtual = asked.task == "virtual"
        devices = attempt.Devices(
            tracker=self.zeroed or self.foreign or self.tracker,
            tracker_port="scripted",
            noise_mm=0.1,
            actuator=self.actuator if virtual else None,
            render=render if virtual else None,
            console=self.console,
            clock=self.clock,
            masker=self.masker,
            reconnect_s=300.0,
            priority=self.priority,
        )
        rig_file = shipped("rigs/rehearsal.toml")
        return runner.run(protocol=protocol, header=asked, devices=devices, rig_file=rig_file, dataset=dataset)


def in_pieces(step: Samples) -> list[Samples]:
    """As a port gives it: 4 ms a read."""
    pieces = []
    while step.device_us.size:
        piece, step = step.cut(min(4, step.device_us.size))
        pieces.append(piece)
    return pieces


def bench(keys: str, steps: list[Samples | PalpateError] | None = None, lost: tuple[int, ...] = ()) -> Bench:
    clock = ManualClock(START_NS)
    if steps is None:
        steps = [step_samples(2_000_000 * n, 100.0 * n) for n in range(1, len(keys) + 1)]
    return Bench(ScriptedTracker(steps, lost, clock=clock), ScriptedConsole(clock, keys), ScriptedActuator(), clock, [])


def entries(dataset: Path, task: str) -> tuple[object, ...]:
    return journal.read(places.journal_path(dataset, "01", task)).entries


def test_a_virtual_session_renders_at_the_foots_speed_and_journals_every_step(
    protocol: Protocol, tmp_path: Path
) -> None:
    one = bench("cpn")
    footer = one.run(protocol, header("virtual"), tmp_path)
    assert footer == Footer(reason="complete", answered=3)
    assert [material for material, _ in one.rendered] == list(ORDER)
    assert [speed for _, speed in one.rendered] == pytest.approx([100.0, 200.0, 300.0], rel=1e-9)
    assert len(one.actuator.played) == 3
    assert one.console.armed == [(1, 1), (2, 1), (3, 1)]
    assert one.console.placed == []
    assert one.console.confirmations == [(1, "copy paper"), (2, "polypropylene"), (3, None)]
    kinds = [type(entry) for entry in entries(tmp_path, "virtual")]
    assert kinds == [Header, Phase, Phase, TrackerOpened, FootStep, Answer, FootStep, Answer, FootStep, Answer, Footer]
    step = entries(tmp_path, "virtual")[4]
    assert isinstance(step, FootStep)
    assert step.contact_us == pytest.approx(2_000_000 + 300_000, abs=1)
    assert step.stimulus is not None
    assert (step.stimulus.samples, step.stimulus.floored_bins, step.stimulus.peak_m_s2) == (2500, 3, 1.5)
    assert step.stimulus.computed == COMPUTED


def test_every_stimulus_on_record_says_how_it_was_computed(protocol: Protocol, tmp_path: Path) -> None:
    bench("cpn").run(protocol, header("virtual"), tmp_path)
    step = next(e for e in entries(tmp_path, "virtual") if isinstance(e, FootStep))
    assert step.stimulus is not None
    told = step.stimulus.model_dump()
    for wrong in (told | {"computed": None}, {name: told[name] for name in told if name != "computed"}):
        with pytest.raises(ValidationError, match="computed"):
            Stimulus.model_validate(wrong)


def test_the_priority_of_a_session_is_journaled_each_time_it_runs(protocol: Protocol, tmp_path: Path) -> None:
    one, two = bench("cq"), bench("pn")
    one.priority, two.priority = "real time", "ordinary: the system allows no more"
    one.run(protocol, header("virtual"), tmp_path)
    two.run(protocol, header("virtual"), tmp_path)
    said = [e.detail for e in entries(tmp_path, "virtual") if isinstance(e, Phase) and e.state == "ready"]
    assert said == ["priority: real time", "priority: ordinary: the system allows no more"]


def test_a_real_session_names_the_object_to_lay_out_and_plays_nothing(protocol: Protocol, tmp_path: Path) -> None:
    one = bench("cpt")
    one.run(protocol, header("real"), tmp_path)
    assert one.console.placed == list(enumerate(ORDER, start=1))
    assert one.actuator.played == []
    assert all(e.stimulus is None for e in entries(tmp_path, "real") if isinstance(e, FootStep))


def test_familiarisation_lasts_as_long_as_the_protocol_asks(protocol: Protocol, tmp_path: Path) -> None:
    one = bench("cpt")
    one.run(protocol, header("real"), tmp_path)
    assert one.console.familiarised == 2, "100 s a time, 180 s wanted"


def test_response_time_runs_from_contact_in_device_time(protocol: Protocol, tmp_path: Path) -> None:
    one = bench("cpt")
    one.run(protocol, header("real"), tmp_path)
    first = next(e for e in entries(tmp_path, "real") if isinstance(e, Answer))
    assert first.response_time_s == pytest.approx(1.0 - 0.3, abs=1e-6)


def test_the_raw_frames_of_every_step_are_kept_up_to_the_end_of_the_tail(protocol: Protocol, tmp_path: Path) -> None:
    bench("cpt").run(protocol, header("real"), tmp_path)
    path = places.foot_path(places.journal_path(tmp_path, "01", "real"))
    steps = [e for e in entries(tmp_path, "real") if isinstance(e, FootStep)]
    # One byte a sample at 1 kHz: 30 mm at 100, 200, 300 mm/s, then 100 ms of tail; the scripted foot rests for 200.
    assert [step.trace.length for step in steps] == [401, 251, 201]
    assert [step.link.received for step in steps] == [301, 151, 101]
    assert [step.trace.offset for step in steps] == [0, 401, 652]
    assert path.stat().st_size == 853


def test_a_device_that_restarted_between_two_steps_is_noticed(protocol: Protocol, tmp_path: Path) -> None:
    one = bench("cp", [step_samples(2_000_000, 150.0), step_samples(40_000_000, 150.0)])
    with pytest.raises(TrackerError, match=r"part by 3[67].* s; the device restarted"):
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
    assert second.console.armed == [(2, 2), (3, 1)]


def test_where_clocks_part_a_step_and_its_onset_go_by_one_clock(protocol: Protocol, tmp_path: Path) -> None:
    one = bench("cp", [step_samples(2_000_000, 150.0), step_samples(40_000_000, 150.0)])
    with pytest.raises(TrackerError, match="the device restarted"):
        one.run(protocol, header("virtual"), tmp_path)
    for step in (e for e in entries(tmp_path, "virtual") if isinstance(e, FootStep)):
        by = ClockMap(step.clock.anchor_us, step.clock.anchor_ns, step.clock.drift_ppm)
        assert step.onset is not None
        assert step.onset.contact_ns == by.session_ns(step.contact_us)
    assert step.trial == 2


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
def test_a_resonators_drift_over_a_session_is_no_restart(protocol: Protocol, tmp_path: Path, drift_ppm: float) -> None:
    one = bench("cpt")
    one.tracker = Drifting(drift_ppm, clock=one.clock)
    if abs(drift_ppm) < 10_000:
        assert one.run(protocol, header("real"), tmp_path) == Footer(reason="complete", answered=3)
    else:
        with pytest.raises(TrackerError, match=r"part by -?4[3-6]\..* s; the device restarted"):
            one.run(protocol, header("real"), tmp_path)


class Going(ManualClock):
    """Passes for a clock of the machine."""

    simulated = False


class SlowConsole(ScriptedConsole):
    """Takes a second to lay out an object, 3 ms to show an answer, and 2 ms to show a trial."""

    def place(self, *, trial: int, material: str) -> None:
        super().place(trial=trial, material=material)
        self._clock.sleep_ns(1_000_000_000)

    def confirmed(self, *, trial: int, answer: str | None) -> None:
        super().confirmed(trial=trial, answer=answer)
        self._clock.sleep_ns(3_000_000)

    def arm(self, *, trial: int, attempt: int, trials: int) -> None:
        super().arm(trial=trial, attempt=attempt, trials=trials)
        self._clock.sleep_ns(2_000_000)


@pytest.mark.parametrize("task", ["real", "virtual"])
def test_the_dead_time_after_an_answer_is_journaled_without_the_laying_out(
    protocol: Protocol, tmp_path: Path, task: str
) -> None:
    clock = Going(START_NS)
    one = bench("crpt")
    one.clock, one.console = clock, SlowConsole(clock, "crpt")
    one.tracker = ScriptedTracker([step_samples(2_000_000 * n, 150.0) for n in range(1, 5)], clock=clock)
    one.run(protocol, header(task), tmp_path)
    steps = [e for e in entries(tmp_path, task) if isinstance(e, FootStep)]
    assert [(step.trial, step.attempt) for step in steps] == [(1, 1), (2, 1), (2, 2), (3, 1)]
    # None came before the first, and what came before the third was no answer.
    assert [step.dead_time_ms for step in steps] == [None, 5.0, None, 5.0]
    said = story.text(journal.read(places.journal_path(tmp_path, "01", task)))
    assert said.count("; armed 5.0 ms after the answer before") == 2


def test_simulated_time_knows_no_dead_time(protocol: Protocol, tmp_path: Path) -> None:
    one = bench("cpt")
    one.console = SlowConsole(one.clock, "cpt")
    one.run(protocol, header("real"), tmp_path)
    assert [e.dead_time_ms for e in entries(tmp_path, "real") if isinstance(e, FootStep)] == [None, None, None]


def test_redo_is_a_new_entry_and_a_new_attempt(protocol: Protocol, tmp_path: Path) -> None:
    one = bench("crpt")
    one.run(protocol, header("real"), tmp_path)
    assert one.console.armed == [(1, 1), (2, 1), (2, 2), (3, 1)]
    redone = [e for e in entries(tmp_path, "real") if isinstance(e, Redo)]
    assert redone == [Redo(trial=2, attempt=1, reason="asked for by the experimenter", put_off=False)]


def test_the_protocols_rule_repeats_a_step_that_lost_frames(protocol: Protocol, tmp_path: Path) -> None:
    steps = [step_samples(2_000_000 * n, 150.0) for n in range(1, 5)]
    one = bench("cpt", steps, lost=(21, 20, 0, 0))
    one.run(protocol, header("real"), tmp_path)
    assert one.console.armed == [(1, 1), (2, 1), (3, 1), (1, 2)]
    reason = "lost frames: too much of the foot's movement is missing for its speed to be trusted"
    redone = [e for e in entries(tmp_path, "real") if isinstance(e, Redo)]
    assert redone == [Redo(trial=1, attempt=1, reason=reason, put_off=True)]


def test_pause_ends_the_runner_and_the_next_one_goes_on_with_the_same_trial(protocol: Protocol, tmp_path: Path) -> None:
    assert bench("cq").run(protocol, header("real"), tmp_path).reason == "paused"
    second = bench("pt")
    assert second.run(protocol, header("real"), tmp_path).reason == "complete"
    assert second.console.armed == [(2, 2), (3, 1)]
    assert second.console.familiarised == 0
    assert [e.remaining for e in entries(tmp_path, "real") if isinstance(e, Resumed)] == [(2, 3)]


def test_a_stopped_tracker_ends_the_session_with_a_footer_and_loses_nothing(protocol: Protocol, tmp_path: Path) -> None:
    steps = [step_samples(0, 150.0), TrackerStopped("tracker at scripted: no frame for 200 ms")]
    footer = bench("c", steps).run(protocol, header("real"), tmp_path)
    assert footer == Footer(reason="paused", detail="tracker at scripted: not back within 300 s", answered=1)
    assert entries(tmp_path, "real")[-1] == footer
    second = bench("pt")
    assert second.run(protocol, header("real"), tmp_path) == Footer(reason="complete", answered=3)
    assert second.console.armed == [(2, 2), (3, 1)]


def test_a_tracker_that_comes_back_goes_on_with_the_same_trial(protocol: Protocol, tmp_path: Path) -> None:
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
    assert one.console.shown[0] == f"{said}. The session waits for 300 s; nothing is lost."
    (broken,) = [e for e in entries(tmp_path, "real") if isinstance(e, BrokenOff)]
    assert (broken.trial, broken.felt, broken.speed_mm_s, broken.at_us) == (2, False, None, 2_099_000)
    assert broken.trace.length == broken.link.received == 100
    kinds = [type(e) for e in entries(tmp_path, "real")]
    lost = kinds.index(BrokenOff)
    assert kinds[lost : lost + 4] == [BrokenOff, Phase, Phase, TrackerOpened]


def test_a_tracker_that_goes_between_two_steps_is_waited_for_and_the_same_attempt_is_armed_again(
    protocol: Protocol, tmp_path: Path
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
    assert one.console.shown[0] == f"{said}. The session waits for 300 s; nothing is lost."
    done = entries(tmp_path, "real")
    assert [e.detail for e in done if isinstance(e, Phase) and e.state == "waiting"] == [said]
    kinds = [type(e) for e in done]
    assert BrokenOff not in kinds
    assert kinds.count(TrackerOpened) == 2


def test_heights_count_from_where_the_foot_rested_and_again_once_the_tracker_has_come_back(
    protocol: Protocol, tmp_path: Path
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
    assert [why[:35] for why in one.console.rested] == ["", "zeroing: got an offset of 9.00 mm; ", ""]
    assert "Zeroed: the foot rests at -1.50 mm from contact." in one.console.shown
    done = entries(tmp_path, "real")
    zeros = [e for e in done if isinstance(e, Zeroed)]
    assert zeros == [Zeroed(offset_mm=mm, spread_mm=0.0, samples=200) for mm in (2.5, -1.5)]
    # 30 mm at 150 mm/s: 0.2 s after each step began.
    steps = [e for e in done if isinstance(e, FootStep)]
    assert [step.contact_us for step in steps] == pytest.approx([1_200_000, 700_000, 2_700_000], abs=1)


def test_a_tracker_that_goes_between_two_steps_and_stays_away_pauses(protocol: Protocol, tmp_path: Path) -> None:
    one = bench("c")
    one.tracker.drains.extend([None, TrackerStopped("tracker at scripted: the port has gone")])
    footer = one.run(protocol, header("real"), tmp_path)
    assert footer == Footer(reason="paused", detail="tracker at scripted: not back within 300 s", answered=1)
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
    assert one.run(protocol, header("virtual"), tmp_path) == Footer(reason="complete", answered=3)
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
    protocol: Protocol, tmp_path: Path, failing: tuple[str, ...]
) -> None:
    landed, _ = step_samples(2_000_000, 100.0).cut(310)
    one = bench("c")
    driver = Foreign([landed], clock=one.clock)
    driver.failing = frozenset(failing)
    one.foreign = ForeignTracker(driver, "lab.tracker:Tracker")
    with pytest.raises(TrackerError, match=r"its driver 'lab.tracker:Tracker' failed at `read`"):
        one.run(protocol, header("virtual"), tmp_path)
    broken, _ = (e for e in entries(tmp_path, "virtual") if isinstance(e, BrokenOff | Footer))
    assert isinstance(broken, BrokenOff)
    assert broken.felt
    assert broken.clock is not None
    assert broken.clock.anchor_us == 2_000_000
    assert broken.trace.length == broken.link.received == 310
    assert places.foot_path(places.journal_path(tmp_path, "01", "virtual")).stat().st_size == 310


def test_an_interrupt_at_the_keyboard_pauses(protocol: Protocol, tmp_path: Path) -> None:
    one = bench("c")

    def interrupt() -> None:
        raise KeyboardInterrupt

    one.console = ScriptedConsole(one.clock, "c", before_ask=interrupt)
    assert one.run(protocol, header("real"), tmp_path).detail == "interrupted at the keyboard"
    assert bench("cpt").run(protocol, header("real"), tmp_path).reason == "complete"
    assert [e.reason for e in entries(tmp_path, "real") if isinstance(e, Redo)] == [
        "the session was interrupted before the answer"
    ]


def test_an_interrupt_before_the_header_leaves_nothing_behind(
    protocol: Protocol, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupt(*_: object) -> int:
        raise KeyboardInterrupt

    with monkeypatch.context() as patched:
        patched.setattr(journal.Journal, "append", interrupt)
        assert bench("c").run(protocol, header("real"), tmp_path).reason == "paused"
    assert bench("cpt").run(protocol, header("real"), tmp_path).reason == "complete"


def test_the_protocols_longest_session_counts_over_pauses(protocol: Protocol, tmp_path: Path) -> None:
    limit = protocol.exposure.model_copy(update={"session_min": 3.375})
    short = protocol.model_copy(update={"exposure": limit})
    # 202.5 s in all: 200 s of familiarisation and 1 s an answer; the pause between the two runners does not count.
    assert bench("cq").run(short, header("real"), tmp_path).detail == "by the experimenter"
    second = bench("pt")
    second.clock.sleep_ns(3600 * 10**9)
    footer = second.run(short, header("real"), tmp_path)
    assert footer == Footer(reason="paused", detail="the protocol's 3.375 min of a session are over", answered=2)


def test_a_trial_that_no_step_satisfies_does_not_go_on_for_ever(protocol: Protocol, tmp_path: Path) -> None:
    one = bench("", [step_samples(300_000 * n, 700.0) for n in range(1, 40)])
    footer = one.run(protocol, header("real"), tmp_path)
    assert footer.detail == "trial 1 was begun 10 times; see to the rig, then go on"
    assert len(one.console.armed) == 30


def joined(*parts: Samples) -> Samples:
    """One read of several."""
    raw = b"".join(part.raw for part in parts)
    begins = np.cumsum([0, *(len(part.raw) for part in parts[:-1])])
    return Samples(
        np.concatenate([part.device_us for part in parts]),
        np.concatenate([part.height_mm for part in parts]),
        raw,
        np.concatenate([begin + part.ends for begin, part in zip(begins, parts, strict=True)]),
        parts[-1].arrived_ns,
    )


def in_vain(start_us: int, speed_mm_s: float) -> Samples:
    """A foot that comes down from 30 mm, stops 5 mm above the panel for 0.2 s, and goes back up."""
    fall_s = 25 / speed_mm_s
    seconds = np.arange(0, fall_s + 0.5, 1e-3)
    height = np.interp(seconds, [0, fall_s, fall_s + 0.2, fall_s + 0.4], [30, 5, 5, 30])
    device_us = np.rint(start_us + seconds * 1e6).astype(np.int64)
    return Samples(device_us, height, bytes(len(seconds)), np.arange(len(seconds)) + 1, START_NS)


@pytest.mark.parametrize("pieces", [1, 7, 100])
def test_a_foot_that_stops_plays_nothing_and_the_trial_is_armed_again_while_it_is_watched(
    protocol: Protocol, tmp_path: Path, pieces: int
) -> None:
    # Nothing between the two is thrown away, however the reads were cut.
    rest = joined(in_vain(2_000_000, 150.0), step_samples(3_000_000, 100.0))
    steps = []
    for n in np.array_split(np.arange(rest.device_us.size), pieces):
        piece, rest = rest.cut(n.size)
        steps.append(piece)
    one = bench("cpt", [*steps, step_samples(5_000_000, 150.0), step_samples(7_000_000, 150.0)])
    assert one.run(protocol, header("virtual"), tmp_path) == Footer(reason="complete", answered=3)
    assert one.console.armed == [(1, 1), (2, 1), (3, 1)]
    assert one.console.rearmed == [(1, 2, "the foot stopped or hesitated above the panel")]
    assert [speed for _, speed in one.rendered] == pytest.approx([150.0, 100.0, 150.0, 150.0], rel=1e-6)
    assert len(one.actuator.played) == 3
    assert one.actuator.withdrawn == 1
    done = entries(tmp_path, "virtual")
    (broken,) = [e for e in done if isinstance(e, BrokenOff)]
    assert (broken.trial, broken.attempt, broken.felt) == (1, 1, False)
    assert broken.speed_mm_s == pytest.approx(150.0, rel=1e-6)
    stopped_us = 2_000_000 + 25e6 / 150
    assert broken.at_us is not None
    assert stopped_us < broken.at_us < stopped_us + 60_000
    first = next(e for e in done if isinstance(e, FootStep))
    assert (first.attempt, first.trace.offset) == (2, broken.trace.length)
    assert broken.at_us == 2_000_000 + 1000 * (broken.trace.length - 1)


def test_what_can_no_longer_be_withdrawn_has_its_trial_put_off(protocol: Protocol, tmp_path: Path) -> None:
    one = bench("cpt", [in_vain(2_000_000, 150.0), *(step_samples(2_000_000 * n, 150.0) for n in range(2, 6))])
    one.actuator.sounds_anyway = True
    assert one.run(protocol, header("virtual"), tmp_path) == Footer(reason="complete", answered=3)
    assert one.console.armed == [(1, 1), (2, 1), (3, 1), (1, 2)]
    assert one.console.rearmed == []


@pytest.mark.parametrize("lead_ms", [5, 12])
def test_the_onset_is_aimed_at_the_predicted_contact_until_it_cannot_be_moved(
    protocol: Protocol, tmp_path: Path, lead_ms: int
) -> None:
    steps = [step_samples(2_000_000 * n, 150.0) for n in range(1, 4)]
    one = bench("cpt", [piece for step in steps for piece in (*in_pieces(step),)])
    one.actuator.lead_ns = lead_ms * 1_000_000
    one.run(protocol, header("virtual"), tmp_path)
    for step, aimed in zip(
        (e for e in entries(tmp_path, "virtual") if isinstance(e, FootStep)), one.actuator.aimed, strict=True
    ):
        onset = step.onset
        assert onset is not None
        assert onset.predicted_us is not None
        assert onset.predicted_from_us is not None
        assert onset.prediction_error_ms is not None
        # The steady foot of 150 mm/s; the filter supposes noise of 0.1 mm, so it believes its prior a little.
        assert abs(onset.prediction_error_ms) < 0.5
        assert lead_ms <= (onset.predicted_us - onset.predicted_from_us) / 1e3 < lead_ms + 1.1
        assert onset.scheduled_ns == aimed[-1]
        assert onset.scheduled_ns - onset.contact_ns == pytest.approx(onset.prediction_error_ms * 1e6, abs=2)
        assert len(aimed) > 10


def test_where_nothing_can_be_scheduled_the_prediction_is_journaled_alone(protocol: Protocol, tmp_path: Path) -> None:
    bench("cpt").run(protocol, header("virtual"), tmp_path)
    for step in (e for e in entries(tmp_path, "virtual") if isinstance(e, FootStep)):
        assert step.onset is not None
        assert (step.onset.scheduled_ns, step.onset.delivered) == (None, None)
        assert step.onset.predicted_us == pytest.approx(step.contact_us, abs=200)


@pytest.mark.parametrize("block", [3, 1])
def test_an_undelivered_trial_is_repeated_at_the_end_of_its_block(
    protocol: Protocol, tmp_path: Path, block: int
) -> None:
    one = bench("cpt", [step_samples(2_000_000 * n, 150.0) for n in range(1, 5)])
    one.actuator.heard.extend([DELIVERED.model_copy(update={"delivered": False, "reason": "nothing was heard"})])
    asked = header("virtual").model_copy(update={"block_trials": block})
    assert one.run(protocol, asked, tmp_path) == Footer(reason="complete", answered=3)
    assert one.console.armed == ([(1, 1), (2, 1), (3, 1), (1, 2)] if block == 3 else [(1, 1), (1, 2), (2, 1), (3, 1)])
    (redone,) = [e for e in entries(tmp_path, "virtual") if isinstance(e, Redo)]
    assert redone.reason.startswith("undelivered: the participant did not feel")


def test_a_rig_that_delivers_nothing_pauses_the_session(protocol: Protocol, tmp_path: Path) -> None:
    failed = DELIVERED.model_copy(update={"delivered": False, "reason": "nothing was heard"})
    one = bench("ccppp", [step_samples(600_000 * n, 100.0) for n in range(1, 4 + runner.MOST_UNDELIVERED)])
    one.actuator.heard.extend([failed] * 2 + [DELIVERED] + [failed] * runner.MOST_UNDELIVERED)
    footer = one.run(protocol, header("virtual"), tmp_path)
    detail = f"{runner.MOST_UNDELIVERED} attempts in a row were undelivered; run palpate doctor, then go on"
    assert footer == Footer(reason="paused", detail=detail, answered=1)
    assert len(one.console.armed) == 3 + runner.MOST_UNDELIVERED
    assert entries(tmp_path, "virtual")[-1] == footer
    second = bench("cpn")
    assert second.run(protocol, header("virtual"), tmp_path).reason == "complete"


def test_without_a_rule_an_undelivered_trial_is_marked_and_counts(protocol: Protocol, tmp_path: Path) -> None:
    one = bench("cpt")
    one.actuator.heard.append(DELIVERED.model_copy(update={"delivered": False, "reason": "nothing was heard"}))
    kept = tuple(rule for rule in protocol.exclusion if rule.when != "undelivered")
    one.run(protocol.model_copy(update={"exclusion": kept}), header("virtual"), tmp_path)
    first = next(e for e in entries(tmp_path, "virtual") if isinstance(e, FootStep))
    assert first.onset is not None
    assert first.onset.delivered is not None
    assert first.onset.delivered.reason == "nothing was heard"


@pytest.mark.parametrize("failed", [AudioError("audio: the stream has stopped"), ActuatorError("actuator: gone")])
def test_a_step_that_was_felt_is_on_file_when_the_sound_fails_after_contact(
    protocol: Protocol, tmp_path: Path, failed: PalpateError
) -> None:
    one = bench("c")
    one.actuator.heard.append(failed)
    with pytest.raises(type(failed), match=str(failed)):
        one.run(protocol, header("virtual"), tmp_path)
    *_, broken, footer = entries(tmp_path, "virtual")
    assert footer == Footer(reason="error", detail=str(failed), answered=0)
    _felt_and_on_file(broken, str(failed), tmp_path)
    second = bench("pnc")
    assert second.run(protocol, header("virtual"), tmp_path).reason == "complete"
    assert second.console.armed == [(2, 1), (3, 1), (1, 2)]


def test_a_step_that_was_felt_is_on_file_when_it_is_interrupted(protocol: Protocol, tmp_path: Path) -> None:
    one = bench("c")
    one.actuator.heard.append(KeyboardInterrupt())
    footer = one.run(protocol, header("virtual"), tmp_path)
    assert footer == Footer(reason="paused", detail="interrupted at the keyboard", answered=0)
    *_, broken, last = entries(tmp_path, "virtual")
    assert last == footer
    _felt_and_on_file(broken, "interrupted at the keyboard", tmp_path)
    second = bench("pnc")
    assert second.run(protocol, header("virtual"), tmp_path).reason == "complete"
    assert second.console.armed == [(2, 1), (3, 1), (1, 2)]


def _felt_and_on_file(broken: object, reason: str, dataset: Path) -> None:
    """The first trial's step of 100 mm/s, with every frame up to the end of its tail."""
    assert isinstance(broken, BrokenOff)
    assert (broken.trial, broken.attempt, broken.felt, broken.reason) == (1, 1, True, reason)
    assert broken.speed_mm_s == pytest.approx(100.0, rel=1e-9)
    assert broken.trace.length == broken.link.received == 401
    assert places.foot_path(places.journal_path(dataset, "01", "virtual")).stat().st_size == 401


def test_a_stimulus_is_withdrawn_when_the_session_breaks_off(protocol: Protocol, tmp_path: Path) -> None:
    falling, _ = step_samples(2_000_000, 150.0).cut(180)
    one = bench("c", [falling, TrackerError("the device restarted")])
    with pytest.raises(TrackerError, match="the device restarted"):
        one.run(protocol, header("virtual"), tmp_path)
    assert (one.actuator.played, one.actuator.withdrawn) == ([], 1)


def test_what_follows_contact_in_the_same_read_is_another_step(protocol: Protocol, tmp_path: Path) -> None:
    first, second = step_samples(2_000_000, 150.0), step_samples(2_600_000, 300.0)
    one = bench("cpt", [joined(first, second), step_samples(4_000_000, 150.0), step_samples(6_000_000, 150.0)])
    one.run(protocol, header("virtual"), tmp_path)
    assert [speed for _, speed in one.rendered] == pytest.approx([150.0] * 3, rel=1e-6)


def test_a_complete_session_is_left_as_it_is(protocol: Protocol, tmp_path: Path) -> None:
    bench("cpt").run(protocol, header("real"), tmp_path)
    path = places.journal_path(tmp_path, "01", "real")
    before = path.read_bytes()
    again = bench("")
    assert again.run(protocol, header("real"), tmp_path).reason == "complete"
    assert path.read_bytes() == before
    assert again.console.armed == []


@pytest.mark.parametrize(
    ("change", "named"),
    [({"protocol_sha256": "f" * 64}, "protocol_sha256"), ({"seed": 2}, "seed"), ({"order": ()}, "order")],
)
def test_a_session_goes_on_only_as_it_was_begun(
    protocol: Protocol, tmp_path: Path, change: dict[str, object], named: str
) -> None:
    bench("cq").run(protocol, header("real"), tmp_path)
    with pytest.raises(JournalError, match=f"begun with another {named}"):
        bench("pt").run(protocol, header("real").model_copy(update=change), tmp_path)


def test_a_torn_line_is_reported_on_screen_and_in_the_journal(protocol: Protocol, tmp_path: Path) -> None:
    bench("cq").run(protocol, header("real"), tmp_path)
    path = places.journal_path(tmp_path, "01", "real")
    path.write_bytes(path.read_bytes() + b'{"n":9,"t_')
    second = bench("pt")
    second.run(protocol, header("real"), tmp_path)
    assert second.console.shown == ['A torn last line of the journal was dropped: \'{"n":9,"t_\'']
    assert [e.torn for e in entries(tmp_path, "real") if isinstance(e, Resumed)] == ['{"n":9,"t_']
