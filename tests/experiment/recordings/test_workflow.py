"""The walk through takes: order, keeping and repeating, going on after an interruption, and nothing half written."""

from __future__ import annotations

import contextlib
import io
import os
import tomllib
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from experiment.apparatus import opening, serial_tracker
from experiment.apparatus.gate import GateDetector
from experiment.apparatus.ports import Heard, Tracker, Window
from experiment.apparatus.samples import LinkCounts, Samples
from experiment.apparatus.zeroing import ZeroedTracker
from experiment.clock import ManualClock
from experiment.console.takes import TerminalTakes
from experiment.errors import PalpateError, RecordingError, RigError, TrackerStopped
from experiment.protocol.load import load as load_protocol
from experiment.protocol.models import Protocol, Step
from experiment.recordings import manifest, partial, workflow
from experiment.recordings.plan import Condition, Plan, plan
from tests.experiment.session.scripted import ScriptedTracker, rest_samples

STEP = Step(gate_top_mm=20.0, gate_bottom_mm=10.0, contact_mm=0.0)
HELD_UP_NS = 7_000_000
"""How long after a frame the host reads it."""

PLAN = Plan("rig bench", "a" * 64, "b" * 64, False, ("copy paper",), (100.0, 200.0), 2, 1000, 8)


class World:
    """Tracker, accelerometer and experimenter in one: every step goes at `speeds`' next speed, mm/s."""

    rate_hz = 1000
    counts = LinkCounts()
    clock_map = None

    def __init__(self, speeds: Iterator[float], *, windows: Iterator[Window | None] | None = None) -> None:
        self.clock = ManualClock(0)
        self.asked: list[tuple[int, int]] = []
        self.knock_ns: Callable[[int], int | None] = lambda _: None
        self.speeds = speeds
        self.windows = windows
        self.log: list[str] = []
        self.kept: list[workflow.Step] = []
        self._next = 0.0
        self._us = 0

    def drain(self) -> None:
        self.log.append("drain")

    def read(self) -> Samples:
        t_us = np.arange(0, int(40e6 / self._next), 1000)
        height_mm = 30.0 - self._next * t_us / 1e6
        begin_us, self._us = self._us, self._us + int(t_us[-1]) + 1000
        self.clock.sleep_ns((begin_us + int(t_us[-1])) * 1000 + HELD_UP_NS - self.clock.now_ns())
        return Samples(t_us + begin_us, height_mm, b"", np.zeros(t_us.size, np.int64), self.clock.now_ns())

    def reconnect(self, timeout_s: float) -> None: ...

    def close(self) -> None: ...

    def arm(self, wanted: object, *, attempt: int = 0) -> None:
        if isinstance(wanted, Condition):
            self.log.append(f"arm {attempt}")
            self._next = next(self.speeds)
        else:
            assert wanted == PLAN.samples
            self.log.append("listen")

    def heard(self, *, earliest_ns: int, latest_ns: int) -> Heard:
        self.asked.append((earliest_ns, latest_ns))
        window = Window(np.full(8, self._next), clipped=0) if self.windows is None else next(self.windows)
        return Heard(window, earliest_ns + 100, self.knock_ns(earliest_ns))

    def place(self, condition: Condition, *, done: int, total: int) -> None:
        self.log.append(f"{done + 1}/{total} {condition.material} {condition.speed_mm_s:g} {condition.number}")

    def keeps(self, step: workflow.Step) -> bool:
        if step.problems:
            return False
        self.kept.append(step)
        return True


def good() -> Iterator[float]:
    """Steps that all hit their targets, in the plan's order."""
    yield from (c.speed_mm_s for c in PLAN.conditions())


class Worn:
    """Implements `Tracker`: gives `reads` first, and then a world's steps, all `sole_mm` too high."""

    def __init__(self, world: World, reads: Iterator[Samples], sole_mm: float) -> None:
        self.world = world
        self.reads = reads
        self.sole_mm = sole_mm
        self.counts, self.clock_map = world.counts, world.clock_map
        self.drain, self.reconnect, self.close = world.drain, world.reconnect, world.close

    def read(self) -> Samples:
        for rested in self.reads:
            return rested
        samples = self.world.read()
        return replace(samples, height_mm=samples.height_mm + self.sole_mm)


def record(world: World, out: Path, planned: Plan = PLAN, *, tracker: Tracker | None = None) -> Path:
    return workflow.record(
        planned,
        out,
        tracker=tracker or world,
        accelerometer=world,
        detector=GateDetector(STEP),
        console=world,
        clock=world.clock,
    )


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def test_the_bare_panel_first_then_materials_slow_to_fast(tmp_path: Path) -> None:
    world = World(good())
    made = record(world, tmp_path / "set")
    assert made == tmp_path / "set" / "manifest.toml"
    assert [line for line in world.log if "/" in line] == [
        "1/8 None 100 1", "2/8 None 100 2", "3/8 None 200 1", "4/8 None 200 2",
        "5/8 copy paper 100 1", "6/8 copy paper 100 2", "7/8 copy paper 200 1", "8/8 copy paper 200 2",
    ]  # fmt: skip
    assert world.log[1:4] == ["drain", "listen", "arm 1"]


def test_what_was_recorded_loads_with_the_achieved_speeds(tmp_path: Path) -> None:
    aimed = [105.0, 95.0, 201.0, 199.0, 100.0, 100.0, 190.0, 210.0]
    record(World(iter(aimed)), tmp_path / "set")
    loaded = manifest.load_all(tmp_path / "set")
    assert not loaded.simulated
    assert loaded.speeds_mm_s.tolist() == [100.0, 200.0]
    np.testing.assert_array_equal(loaded.panel[:, :, 0], [[105, 95], [201, 199]])
    np.testing.assert_array_equal(loaded.objects["copy paper"][:, :, 0], [[100, 100], [190, 210]])
    text = tomllib.loads((tmp_path / "set" / "manifest.toml").read_text("utf-8"))
    assert [take["achieved_mm_s"] for take in text["takes"]] == [pytest.approx(v, rel=1e-9) for v in aimed]
    assert names(tmp_path) == ["set"]


@pytest.mark.parametrize(("off", "problem"), [(111.0, "off by +11%"), (89.0, "off by -11%")])
def test_a_step_off_target_is_repeated(tmp_path: Path, off: float, problem: str) -> None:
    world = World(iter([off, *good()]))
    record(world, tmp_path / "set")
    assert world.log[:7] == ["1/8 None 100 1", "drain", "listen", "arm 1", "drain", "listen", "arm 2"]
    assert problem in workflow.Step(PLAN.conditions()[0], off, None).problems[0]


@pytest.mark.parametrize("first", [None, Window(np.ones(8), clipped=3)])
def test_silence_and_clipping_speak_against_a_take(tmp_path: Path, first: Window | None) -> None:
    rest = Window(np.ones(8), clipped=0)
    world = World(iter([100.0, *good()]), windows=iter([first, *[rest] * 8]))
    record(world, tmp_path / "set")
    assert len(world.kept) == 8


def test_a_take_is_looked_for_from_the_gates_top_with_an_object_and_from_contact_without(tmp_path: Path) -> None:
    """A foot at v mm/s that starts at 30 mm: 20 mm after 10/v s, the panel after 30/v s, on the device's counter."""
    world = World(good())
    record(world, tmp_path / "set")
    begun_ns = 0
    for condition, (earliest_ns, latest_ns) in zip(PLAN.conditions(), world.asked, strict=True):
        mm = 30 if condition.material is None else 10
        ns = 1e9 / condition.speed_mm_s
        assert earliest_ns == pytest.approx(begun_ns + mm * ns + HELD_UP_NS - workflow.SOONER_NS, abs=10)
        assert latest_ns == pytest.approx(begun_ns + 30 * ns + HELD_UP_NS + workflow.LATER_NS, abs=10)
        begun_ns += round(40 * ns)


@pytest.mark.parametrize(("before_ms", "kept"), [(300, True), (25, True), (15, False)])
def test_a_knock_is_told_of_and_speaks_against_a_take_that_follows_at_once(
    tmp_path: Path, before_ms: int, kept: bool
) -> None:
    world = World(iter([100.0, *good()]))
    knocks = iter([before_ms * 1_000_000])
    world.knock_ns = lambda earliest_ns: next((earliest_ns - ns for ns in knocks), None)
    if not kept:
        record(world, tmp_path / "set")
        assert [step.knock_ms for step in world.kept] == [None] * 8
        return
    world.speeds = good()
    record(world, tmp_path / "set")
    assert world.kept[0].knock_ms == pytest.approx(before_ms + workflow.SOONER_NS / 1e6, abs=0.01)
    assert world.kept[0].notes == (f"a knock {before_ms + 50} ms before contact was left out",)


def test_silence_is_never_kept_even_if_the_experimenter_says_so(tmp_path: Path) -> None:
    rest = Window(np.ones(8), clipped=0)
    world = World(iter([100.0, *good()]), windows=iter([None, *[rest] * 8]))
    world.keeps = lambda step: True  # type: ignore[method-assign]
    record(world, tmp_path / "set")
    assert manifest.load_all(tmp_path / "set").panel.shape == (2, 2, 8)


def interrupted(out: Path, after: int, error: type[BaseException] = KeyboardInterrupt) -> None:
    def speeds() -> Iterator[float]:
        for place, v in enumerate(good()):
            if place == after:
                raise error("stopped")
            yield v

    with pytest.raises(error):
        record(World(speeds()), out)


@pytest.mark.parametrize("after", range(8))
@pytest.mark.parametrize("error", [KeyboardInterrupt, TrackerStopped])
def test_an_interrupted_recording_has_no_manifest_and_goes_on(
    tmp_path: Path, after: int, error: type[BaseException]
) -> None:
    interrupted(tmp_path / "set", after, error)
    assert not (tmp_path / "set").exists()
    world = World(iter(list(good())[after:]))
    record(world, tmp_path / "set")
    assert len(world.kept) == 8 - after
    assert names(tmp_path) == ["set"]
    record(World(good()), tmp_path / "other")
    assert names(tmp_path / "set") == names(tmp_path / "other")
    for path in (tmp_path / "set").iterdir():
        assert path.read_bytes() == (tmp_path / "other" / path.name).read_bytes()


def test_a_stop_while_the_whole_is_written_leaves_every_take(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(directory: Path, **_: object) -> Path:
        directory.mkdir()
        (directory / "000_panel_100_1.wav").write_bytes(b"half")
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(partial, "write", fails)
    with pytest.raises(OSError, match="No space"):
        record(World(good()), tmp_path / "set")
    assert not (tmp_path / "set").exists()
    monkeypatch.undo()
    world = World(iter(()))
    record(world, tmp_path / "set")
    assert world.log == []
    assert names(tmp_path) == ["set"]
    assert manifest.load_all(tmp_path / "set").panel.shape == (2, 2, 8)


def test_another_plan_never_goes_on_with_an_interrupted_one(tmp_path: Path) -> None:
    interrupted(tmp_path / "set", 3)
    other = replace(PLAN, takes=3)
    with pytest.raises(RecordingError, match=r"another plan \(takes 2 there, 3 asked for\); go on with that plan"):
        record(World(good()), tmp_path / "set", other)


@pytest.mark.parametrize(
    ("key", "message"),
    [
        ("protocol_sha256", r"the protocol aaaaaaaaaaaa\.\.\. there, cccccccccccc\.\.\. asked for \(SHA-256\)"),
        ("rig_sha256", r"the rig bbbbbbbbbbbb\.\.\. there, cccccccccccc\.\.\. asked for \(SHA-256\)"),
    ],
)
def test_another_protocol_or_rig_never_goes_on_with_it(tmp_path: Path, key: str, message: str) -> None:
    interrupted(tmp_path / "set", 3)
    with pytest.raises(RecordingError, match=f"another plan \\({message}\\); go on with that plan"):
        record(World(good()), tmp_path / "set", replace(PLAN, **{key: "c" * 64}))  # type: ignore[arg-type]


def test_takes_without_their_plan_are_refused_and_left_alone(tmp_path: Path) -> None:
    interrupted(tmp_path / "set", 3)
    (tmp_path / ".set.partial" / "plan.json").unlink()
    before = names(tmp_path / ".set.partial")
    with pytest.raises(RecordingError, match=r"got 3 takes without their plan\.json, .*; restore it, choose another"):
        record(World(good()), tmp_path / "set")
    assert names(tmp_path / ".set.partial") == before


def test_two_at_once_are_refused_and_the_first_goes_on(tmp_path: Path) -> None:
    with (
        partial.begun(PLAN, tmp_path / "set"),
        pytest.raises(RecordingError, match=r"another palpate record is under way for .*set; allowed: one; end it"),
    ):
        record(World(good()), tmp_path / "set")
    record(World(good()), tmp_path / "set")
    assert names(tmp_path) == ["set"]


def test_takes_are_removed_only_when_the_recordings_are_on_disk(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Every file of the whole, and the folder that it is moved into, is synced while every take is still there."""
    synced: set[str] = set()
    fsync = os.fsync

    def spy(descriptor: int) -> None:
        path = Path(f"/proc/self/fd/{descriptor}").readlink()
        takes = list((tmp_path / ".set.partial").glob("*.npz"))
        if len(takes) == len(PLAN.conditions()):
            synced.add(str(path.relative_to(tmp_path)) if path.is_relative_to(tmp_path) else "")
        fsync(descriptor)

    monkeypatch.setattr(os, "fsync", spy)
    record(World(good()), tmp_path / "set")
    wavs = {name.split(".wav")[0] for name in map(os.path.basename, synced) if ".wav" in name}
    assert len(wavs) == len(PLAN.conditions())
    assert any("manifest.toml" in name for name in synced)
    assert {".", ".set.whole"} <= synced


def test_a_damaged_take_is_named_before_the_next_is_recorded(tmp_path: Path) -> None:
    interrupted(tmp_path / "set", 3)
    damaged = tmp_path / ".set.partial" / "0001.npz"
    damaged.write_bytes(damaged.read_bytes()[:50])
    with pytest.raises(RecordingError, match=r"0001.npz: got a damaged take .*; remove it, then record it again"):
        record(World(iter(list(good())[3:])), tmp_path / "set")
    assert not (tmp_path / "set").exists()
    assert names(tmp_path / ".set.partial") == ["0000.npz", "0001.npz", "0002.npz", "lock", "plan.json"]


def test_a_file_is_no_folder(tmp_path: Path) -> None:
    (tmp_path / "set").write_text("x")
    with pytest.raises(RecordingError, match="set: is a file; allowed: a new or empty folder; choose another with"):
        record(World(good()), tmp_path / "set")


def test_a_folder_in_use_is_refused_before_anything_is_written(tmp_path: Path) -> None:
    (tmp_path / "set").mkdir()
    (tmp_path / "set" / "mine.txt").write_text("x")
    world = World(good())
    with pytest.raises(RecordingError, match="holds files already"):
        record(world, tmp_path / "set")
    assert (world.log, names(tmp_path)) == ([], ["set"])


@pytest.fixture(scope="module")
def protocol(repository_root: Path) -> Protocol:
    return load_protocol(repository_root / "protocols" / "okamoto2012.toml")


def test_a_plan_takes_the_protocols_speeds_and_takes_or_others(protocol: Protocol) -> None:
    own = plan(protocol, source="s", simulated=False)
    assert (own.speeds_mm_s, own.takes, len(own.conditions())) == ((50.0, 100.0, 200.0, 300.0), 3, 5 * 4 * 3)
    fresh = plan(protocol, source="s", simulated=False, speeds_mm_s=(150.0, 250.0, 400.0), takes=10)
    assert len(fresh.conditions()) == 5 * 3 * 10


@pytest.mark.parametrize(
    "speeds", [(400.0, 150.0), (100.0, 100.0), (9.5, 50.0), (-1.0,), (np.nan,), (100.0, np.inf), (1e4 + 1,)]
)
def test_speeds_that_do_not_rise_or_that_no_foot_has_are_refused(protocol: Protocol, speeds: tuple[float, ...]) -> None:
    with pytest.raises(
        RecordingError, match=r"speeds: got .*; allowed: 10 to 10000, each above the one before; give such"
    ):
        plan(protocol, source="s", simulated=False, speeds_mm_s=speeds)


@pytest.mark.parametrize("takes", [0, -1, 101])
def test_no_take_is_refused(protocol: Protocol, takes: int) -> None:
    with pytest.raises(RecordingError, match=f"takes: got {takes}; allowed: 1 to 100"):
        plan(protocol, source="s", simulated=False, takes=takes)


RIG = """\
format = 1
[rig]
name = "bench"
simulated = false
[tracker]
port = "/dev/no-such-port"
baud = 600_000
rate_hz = 5000
stall_ms = 150
calibrated_on = 2026-01-01
calibration_days = 3650
calibration = [{ counts = 100, mm = 60.0 }, { counts = 900, mm = -2.0 }]
[actuator]
driver = "pcm-tcp"
address = "127.0.0.1:4711"
rate_hz = 48000
full_scale_m_s2 = 60.0
"""
ACCELEROMETER = """\
[accelerometer]
driver = "pcm-tcp"
address = "127.0.0.1:4712"
rate_hz = 5000
full_scale_m_s2 = 30.0
trigger_m_s2 = 0.3
"""


@pytest.mark.parametrize(
    ("rig", "error", "message"),
    [
        (RIG, RigError, r"rig 'bench': got no table \[accelerometer\]"),
        (
            RIG + ACCELEROMETER.replace("5000", "4000"),
            RigError,
            "accelerometer.rate_hz: got 4000; allowed: 5000, the pr",
        ),
        (RIG.replace("simulated = false", "simulated = true"), RecordingError, "a simulated rig; allowed: a real one"),
        (RIG + ACCELEROMETER.replace("= 0.3", "= 30.0"), RigError, r"trigger_m_s2: got .* less than full_scale_m_s2"),
        (RIG + ACCELEROMETER.replace("127.0.0.1:4712", "rehearsal"), RigError, "accelerometer.address: got"),
        (
            (RIG + ACCELEROMETER).replace("= 3650", "= 1").replace("2026-01", "2025-01"),
            RigError,
            "tracker.calibrated_on: got 2025-01-01; allowed: at most 1 days before today",
        ),
        (RIG + ACCELEROMETER, PalpateError, "tracker at /dev/no-such-port: no such port"),
    ],
)
def test_a_rig_that_cannot_record_is_refused_and_nothing_is_written(
    tmp_path: Path, repository_root: Path, rig: str, error: type[PalpateError], message: str
) -> None:
    (tmp_path / "rig.toml").write_text(rig, "utf-8")
    with pytest.raises(error, match=message):
        workflow.record_on_rig(
            protocol_file=repository_root / "protocols" / "okamoto2012.toml",
            rig_file=tmp_path / "rig.toml",
            out=tmp_path / "set",
            console=TerminalTakes(write=io.StringIO(), ask=input),
        )
    assert names(tmp_path) == ["rig.toml"]


def test_where_the_rig_asks_for_it_the_tracker_is_zeroed_before_the_first_take(
    tmp_path: Path, repository_root: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "rig.toml").write_text(RIG.replace("[tracker]", "[tracker]\nzeroing_mm = 1.0") + ACCELEROMETER, "utf-8")
    # One look at the sensor; half a second at 5 kHz in the air, and half a second at rest; then a height of 20 mm.
    heights_mm = [0.5, *[9.0] * 13, *[0.5] * 13, 20.5]
    tracker = ScriptedTracker([rest_samples(0, mm) for mm in heights_mm], clock=ManualClock(0))
    monkeypatch.setattr(serial_tracker, "SerialTracker", lambda *_, **__: tracker)
    world = World(good())
    monkeypatch.setattr(opening, "open_accelerometer", lambda *_, **__: world)
    reads: list[Samples] = []

    def record(_: Plan, out: Path, *, tracker: Tracker, **__: object) -> Path:
        reads.append(tracker.read())
        return out

    monkeypatch.setattr(workflow, "record", record)
    screen = io.StringIO()
    prompts: list[str] = []

    def ask(prompt: str) -> str:
        prompts.append(prompt)
        return ""

    workflow.record_on_rig(
        protocol_file=repository_root / "protocols" / "okamoto2012.toml",
        rig_file=tmp_path / "rig.toml",
        out=tmp_path / "set",
        console=TerminalTakes(write=screen, ask=ask),
    )
    assert len(prompts) == 2
    for prompt in prompts:
        assert prompt.startswith(
            "Zeroing: the foot rests on the bare panel, still. Press Enter when it does, or Ctrl-C"
        )
    assert screen.getvalue().startswith("zeroing: got an offset of 9.00 mm; allowed: at most 1 mm either way")
    assert reads[0].height_mm[0] == 20.0


def test_each_take_says_from_where_its_heights_count_also_those_from_before_an_interruption(tmp_path: Path) -> None:
    """Recorded in two goes, each zeroed by itself: the foot rests at 0.5 mm, then at -0.75 mm."""
    for takes, rested_mm in ((3, 0.5), (5, -0.75)):
        kept = 3 if takes == 5 else 0
        world = World(iter([c.speed_mm_s for c in PLAN.conditions()][kept : kept + takes]))
        reads = iter([rest_samples(0, rested_mm)])
        worn = Worn(world, reads, rested_mm)
        tracker = ZeroedTracker(worn, contact_mm=0.0, farthest_mm=1.0, samples=200)
        tracker.settle(TerminalTakes(write=io.StringIO(), ask=lambda _: ""))
        with contextlib.suppress(StopIteration):
            record(world, tmp_path / "set", tracker=tracker)
    text = tomllib.loads((tmp_path / "set" / "manifest.toml").read_text("utf-8"))
    told = [take["zero"] for take in text["takes"]]
    assert [zero["offset_mm"] for zero in told] == [0.5] * 3 + [-0.75] * 5
    assert {(zero["spread_mm"], zero["samples"]) for zero in told} == {(0.0, 200)}
    assert manifest.load_all(tmp_path / "set").panel.shape == (2, 2, 8)


def test_a_recording_without_zeroing_states_no_zero(tmp_path: Path) -> None:
    made = record(World(good()), tmp_path / "set")
    assert "zero" not in made.read_text("utf-8")


@pytest.mark.parametrize(("text", "message"), [("{", "got no JSON"), ("[]", "got no plan")])
def test_a_damaged_plan_is_named(tmp_path: Path, text: str, message: str) -> None:
    interrupted(tmp_path / "set", 3)
    (tmp_path / ".set.partial" / "plan.json").write_text(text)
    with pytest.raises(RecordingError, match=f"plan.json: {message}.*remove .* to start clean"):
        record(World(good()), tmp_path / "set")


def test_the_folder_may_be_the_present_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    interrupted(Path(), 3)
    assert names(tmp_path) == [".here.partial", "here"]
