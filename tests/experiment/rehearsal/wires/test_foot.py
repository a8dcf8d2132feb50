"""The simulated foot: what is true of a step, and what it sends. A scripted line takes the frames."""

from __future__ import annotations

import threading
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from palpate.experiment.apparatus import rig
from palpate.experiment.apparatus.rig import tracker_of
from palpate.experiment.apparatus.tracker.frames import Decoder, Frames, LinkCounts, Samples
from palpate.experiment.apparatus.tracker.gate import Contact, Gate, GateDetector
from palpate.experiment.apparatus.tracker.settings import CalibrationPoint, TrackerRig
from palpate.experiment.protocol.models import Step
from palpate.experiment.rehearsal.clock import ManualClock
from palpate.experiment.rehearsal.wires.foot import Foot, Hesitation, Trajectory, trajectory
from palpate.experiment.rehearsal.wires.serial_line import SerialLine, UnpluggedError
from tests.approved import Refuses
from tests.rig.faults import Faults

STEP = Step(gate_top_mm=20.0, gate_bottom_mm=10.0, contact_mm=0.0)


class Recorder(SerialLine):
    """Takes everything, or nothing while it is full."""

    def __init__(self) -> None:
        self.data = b""
        self.room = 10**9
        self.emptied = threading.Event()
        self.unplugged = False
        self.url = "nowhere"

    def offer(self, data: bytes | memoryview) -> int:
        if self.unplugged:
            raise UnpluggedError("the line is unplugged")
        taken = bytes(data[: self.room])
        self.data += taken
        self.room -= len(taken)
        return len(taken)

    def wait(self) -> None:
        self.emptied.wait()
        self.room = 10**9

    def unplug(self) -> None:
        self.unplugged = True


@pytest.fixture(scope="session")
def tracker(repository_root: Path) -> TrackerRig:
    return tracker_of(rig.load(repository_root / "protocols" / "rigs" / "rehearsal.toml"))


def sent(
    tracker: TrackerRig, steps: list[tuple[Trajectory, int, Faults | None]], noise_mm: float = 0.1
) -> tuple[Frames, Foot, Recorder]:
    """What an accelerated foot sends in these steps."""
    line = Recorder()
    foot = Foot(line, tracker, noise_mm=noise_mm)
    for step in steps:
        foot.step(*step)
    foot.finish()
    foot.close()
    return Decoder().feed(line.data)[1], foot, line


def test_a_planar_sensor_sees_where_it_is_along_the_face_and_the_same_heights(tracker: TrackerRig) -> None:
    points = CalibrationPoint(counts=100, mm=40.0), CalibrationPoint(counts=60_100, mm=-20.0)
    planar = tracker.model_copy(update={"along_calibration": points})
    height_mm = np.concatenate([np.linspace(70.0, 0.0, 500), np.zeros(100)])
    along_mm = np.linspace(-3.0, 5.0, 600)
    step = Trajectory(1000.0 * np.arange(600.0), height_mm, 0.0, 0.0, 0.0, 599_000.0, 100.0, "none", 3, along_mm)
    one, *_ = sent(tracker, [(step, 0, None)])
    _, _, line = sent(planar, [(step, 0, None)])
    _, both = Decoder(readings=2).feed(line.data)
    assert both.link == one.link == LinkCounts(received=600)
    assert len(line.data) == 600 * 14
    assert np.array_equal(one.counts, both.counts)
    # 1000 counts a millimetre, falling: the noise is that of the height, 0.1 mm.
    strays_mm = (100 - both.along.astype(float)) / 1000 + 40.0 - along_mm
    assert np.std(strays_mm) == pytest.approx(0.1, rel=0.15)
    assert abs(np.mean(strays_mm)) < 0.02


def plain(seed: int = 0, speed_mm_s: float = 180.0, hesitation: Hesitation = "none") -> Trajectory:
    return trajectory(np.random.default_rng(seed), speed_mm_s, hesitation=hesitation)


def detected(us: np.ndarray, mm: np.ndarray) -> tuple[Gate, Contact]:
    detector = GateDetector(STEP)
    _, events = detector.step(detector.init(), Samples(us.astype(np.int64), mm, b"", np.zeros(us.size, np.int64), 0))
    gates = [event for event in events if isinstance(event, Gate)]
    (contact,) = (event for event in events if isinstance(event, Contact))
    return gates[-1], contact


@settings(max_examples=60)
@given(st.integers(0, 2**31), st.floats(50.0, 400.0), st.sampled_from(["none", "pause", "dip"]))
def test_what_a_trajectory_says_of_itself_is_true(seed: int, speed_mm_s: float, hesitation: Hesitation) -> None:
    step = trajectory(np.random.default_rng(seed), speed_mm_s, hesitation=hesitation)
    assert step.speed_mm_s == pytest.approx(speed_mm_s, rel=1e-9)
    assert np.all(np.diff(step.us) > 0)
    assert step.at(np.array([step.gate_top_us, step.gate_bottom_us, step.contact_us])) == pytest.approx(
        [20, 10, 0], abs=1e-6
    )
    assert 10e6 / (step.gate_bottom_us - step.gate_top_us) == pytest.approx(speed_mm_s, rel=1e-9)
    before, after = step.us < step.contact_us - 1e-6, step.us > step.contact_us + 1e-6
    assert np.all(step.height_mm[before] > 0)
    assert step.height_mm[0] == step.height_mm[-1] == 70.0
    # Once it has landed it stays on the panel for 0.22 s or more, and only then is lifted.
    assert step.lift_us >= step.contact_us + 220_000
    assert np.all(step.at(np.arange(step.contact_us + 1000, step.lift_us, 500.0)) < 0.01)
    assert np.all(step.height_mm[after] > -3)
    assert step.duration_us < 8e6


def test_feet_move_smoothly() -> None:
    for seed in range(20):
        step = plain(seed)
        approach = step.at(np.arange(0.0, step.contact_us, 1000.0))
        assert np.max(np.abs(np.diff(approach))) < 1.0
        assert np.max(np.abs(np.diff(approach, 2))) < 0.05


def test_the_same_seed_gives_the_same_foot() -> None:
    first, again = plain(7), plain(7)
    assert np.array_equal(first.height_mm, again.height_mm)
    assert first.noise_seed == again.noise_seed
    assert plain(8).noise_seed != first.noise_seed


def test_some_feet_hesitate() -> None:
    rng = np.random.default_rng(1)
    drawn = [trajectory(rng, 200.0).hesitation for _ in range(1000)]
    assert 70 <= 1000 - drawn.count("none") <= 130
    assert min(drawn.count("pause"), drawn.count("dip")) > 25


@settings(max_examples=60)
@given(st.integers(0, 2**31), st.floats(50.0, 400.0), st.sampled_from(["stop", "turn"]))
def test_a_step_in_vain_passes_the_gate_and_never_lands(seed: int, speed_mm_s: float, hesitation: Hesitation) -> None:
    step = trajectory(np.random.default_rng(seed), speed_mm_s, hesitation=hesitation)
    assert np.all(np.diff(step.us) > 0)
    assert step.at(np.array([step.gate_top_us, step.gate_bottom_us])) == pytest.approx([20, 10], abs=1e-6)
    assert 10e6 / (step.gate_bottom_us - step.gate_top_us) == pytest.approx(speed_mm_s, rel=1e-9)
    lowest_mm = np.min(step.height_mm)
    assert 0.5 < lowest_mm < 5
    assert step.height_mm[0] == step.height_mm[-1] == 70.0
    assert step.contact_us == np.inf
    assert step.lift_us == step.us[-1]
    waits_us = np.ptp(step.us[step.height_mm < lowest_mm + 0.01])
    assert (waits_us >= 200_000) == (hesitation == "stop")


@pytest.mark.parametrize("hesitation", ["none", "pause", "dip"])
@pytest.mark.parametrize("speed_mm_s", [50.0, 180.0, 400.0])
def test_what_is_sent_is_the_step_with_noise_and_quantised(
    tracker: TrackerRig, speed_mm_s: float, hesitation: Hesitation
) -> None:
    step = plain(3, speed_mm_s, hesitation)
    frames, foot, _ = sent(tracker, [(step, 1_000_000, None)])
    assert frames.link == LinkCounts(received=int(step.lift_us / 1000) + 1)
    assert np.array_equal(frames.device_us, 1_000_000 + 1000 * np.arange(frames.device_us.size))
    error_mm = tracker.height_mm(frames.counts) - step.at(frames.device_us - 1e6)
    assert abs(np.mean(error_mm)) < 0.02
    assert np.std(error_mm) == pytest.approx(0.1, rel=0.1)
    gate, contact = detected(frames.device_us, tracker.height_mm(frames.counts))
    assert gate.speed_mm_s == pytest.approx(foot.true_speed_mm_s, rel=0.05)
    assert contact.us == pytest.approx(foot.true_contact_us, abs=4000)
    assert foot.true_contact_us == 1e6 + step.contact_us


def test_without_noise_only_counts_are_left(tracker: TrackerRig) -> None:
    step = plain(3)
    frames, _, _ = sent(tracker, [(step, 0, None)], noise_mm=0.0)
    error_mm = tracker.height_mm(frames.counts) - step.at(frames.device_us.astype(np.float64))
    assert np.max(np.abs(error_mm)) <= 0.5 * np.max(np.diff(tracker.height_mm(np.arange(64, 4096)))) + 1e-9


def test_steps_follow_each_other_without_a_gap_in_sequence(tracker: TrackerRig) -> None:
    steps: list[tuple[Trajectory, int, Faults | None]] = [(plain(i), 5_000_000 * i, None) for i in range(3)]
    frames, foot, _ = sent(tracker, steps)
    begins = frames.device_us[1:][np.diff(frames.device_us) > 1000]
    assert begins.tolist() == [5_000_000, 10_000_000]
    assert (frames.link.lost, frames.restarted) == (0, False)
    assert foot.true_contact_us == 10_000_000 + plain(2).contact_us


def test_a_step_waits_for_the_one_before(tracker: TrackerRig) -> None:
    frames, foot, _ = sent(tracker, [(plain(1), 0, None), (plain(2), 1000, None)])
    begin_us = 1000 * (int(plain(1).duration_us / 1000) + 1)
    assert begin_us in frames.device_us
    assert foot.true_contact_us == begin_us + plain(2).contact_us
    assert frames.link.lost == 0


def test_a_step_across_the_wrap_of_the_devices_clock(tracker: TrackerRig) -> None:
    start_us = 4_294_668_000
    frames, foot, _ = sent(tracker, [(plain(1), start_us, None)])
    assert frames.device_us[0] == start_us
    assert np.all(np.diff(frames.device_us) == 1000)
    _, contact = detected(frames.device_us, tracker.height_mm(frames.counts))
    assert contact.us == pytest.approx(foot.true_contact_us, abs=4000)


def test_a_start_between_samples_waits_for_the_next_one(tracker: TrackerRig) -> None:
    for start_us in (1_000_001, 1_000_999, 1_001_000):
        frames, _, _ = sent(tracker, [(plain(1), start_us, None)])
        assert frames.device_us[0] == 1_001_000


@pytest.mark.parametrize(
    ("faults", "lost", "damaged", "repeated"),
    [
        (Faults(drop=frozenset({5, 6, 200})), 3, 0, 0),
        (Faults(corrupt=frozenset(range(1, 100))), 0, 99, 0),
        (Faults(repeat=frozenset({0, 3})), 0, 0, 2),
        (Faults(drop=frozenset({5}), corrupt=frozenset({5, 7}), repeat=frozenset({9})), 1, 1, 1),
    ],
)
def test_faults_spoil_what_they_say(
    tracker: TrackerRig, faults: Faults, lost: int, damaged: int, repeated: int
) -> None:
    frames, _, _ = sent(tracker, [(plain(), 0, faults)])
    total = int(plain().lift_us / 1000) + 1
    assert frames.link == LinkCounts(total - lost - damaged, lost, damaged, repeated)


@pytest.mark.parametrize(
    ("faults", "unplugged"),
    [(Faults(silent_from=50), False), (Faults(unplug_at=50), True), (Faults(unplug_at=0), True)],
)
def test_a_device_that_fails_sends_nothing_more(tracker: TrackerRig, faults: Faults, unplugged: bool) -> None:
    frames, _, line = sent(tracker, [(plain(), 0, faults), (plain(), 9_000_000, None)])
    assert frames.link.received == faults.end
    assert line.unplugged == unplugged


def test_finishing_does_not_wait_for_a_reader_that_has_gone(tracker: TrackerRig) -> None:
    line = Recorder()
    line.room = 1200
    foot = Foot(line, tracker)
    foot.step(plain(), 0)
    assert not foot.finish()
    assert len(line.data) == 1200
    line.emptied.set()
    foot.step(plain(), 9_000_000)
    while not foot.finish():
        pass
    foot.close()
    assert Decoder().feed(line.data)[1].link == LinkCounts(received=2 * (int(plain().lift_us / 1000) + 1))


def test_a_foot_whose_line_was_pulled_ends_quietly(tracker: TrackerRig) -> None:
    line = Recorder()
    foot = Foot(line, tracker)
    line.unplug()
    foot.step(plain(), 0)
    assert not foot.finish()
    foot.close()
    assert line.data == b""


def test_a_foot_that_has_not_stepped_has_no_contact(tracker: TrackerRig, refuses: Refuses) -> None:
    foot = Foot(Recorder(), tracker)
    with refuses(RuntimeError):
        _ = foot.true_contact_us
    foot.close()


@pytest.mark.parametrize("rate_hz", [1000, 3000, 5000])
def test_in_real_time_the_clock_paces_steps_and_rest(tracker: TrackerRig, rate_hz: int) -> None:
    tracker = tracker.model_copy(update={"rate_hz": rate_hz})
    clock = ManualClock(123)
    line = Recorder()
    foot = Foot(line, tracker, real_time=True, clock=clock, noise_mm=0.0, rest_mm=65.0)
    step = foot.trajectory(np.random.default_rng(4), 250.0)
    foot.step(step, 200_000)
    foot.step(step, 1)
    clock.sleep_ns(9 * 10**9)
    assert foot.finish()
    foot.close()
    frames = Decoder().feed(line.data)[1]
    assert (frames.link.lost, frames.link.damaged) == (0, 0)
    assert np.array_equal(frames.device_us, np.rint(np.arange(frames.device_us.size) * 1e6 / rate_hz))
    mm = tracker.height_mm(frames.counts)
    assert np.all(np.abs(mm[frames.device_us < 200_000] - 65) < 0.02)
    begin_us = foot.true_contact_us - step.contact_us
    assert begin_us >= 200_000 + step.duration_us
    during = (frames.device_us >= begin_us) & (frames.device_us < begin_us + step.duration_us)
    assert np.max(np.abs(mm[during] - step.at(frames.device_us[during] - begin_us))) < 0.05


def test_in_real_time_a_step_asked_for_too_late_begins_at_once(tracker: TrackerRig) -> None:
    clock = ManualClock(0)
    line = Recorder()
    foot = Foot(line, tracker, real_time=True, clock=clock)
    foot.step(plain(), 0)
    clock.sleep_ns(5 * 10**9)
    assert foot.finish()
    foot.step(plain(), 1_000_000)
    clock.sleep_ns(5 * 10**9)
    assert foot.finish()
    foot.close()
    late_us = foot.true_contact_us - plain().contact_us
    assert 4_000_000 < late_us <= 5_001_000
    assert not Decoder().feed(line.data)[1].restarted
