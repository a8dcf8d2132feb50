"""The walk through takes on a rig: order, keeping and repeating, zeroing, and what is refused before the first."""

from __future__ import annotations

import io
import tomllib
from pathlib import Path

import numpy as np
import pytest
from syrupy.assertion import SnapshotAssertion

from palpate.experiment.apparatus.panel import accelerometer as accelerometers
from palpate.experiment.apparatus.panel.accelerometer import Gap, Window
from palpate.experiment.apparatus.ports import Tracker
from palpate.experiment.apparatus.tracker import serial_tracker
from palpate.experiment.apparatus.tracker.frames import Samples
from palpate.experiment.desk.terminal import TerminalTakes
from palpate.experiment.errors import PalpateError, RecordingError, RigError
from palpate.experiment.recordings import manifest, workflow
from palpate.experiment.recordings.store import Plan
from palpate.experiment.rehearsal.clock import ManualClock
from tests.experiment.recordings.bench import HELD_UP_NS, PLAN, World, good, names, record
from tests.experiment.session.scripted import ScriptedTracker, rest_samples


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


@pytest.mark.parametrize(
    "first", [None, Window(np.ones(8), clipped=3), Window(np.ones(8), clipped=0, gaps=(Gap(0.1, 0.008),))]
)
def test_silence_clipping_and_lost_samples_speak_against_a_take(tmp_path: Path, first: Window | None) -> None:
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
    tmp_path: Path, before_ms: int, kept: bool, approved: SnapshotAssertion
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
    assert world.kept[0].verdict == approved


def test_silence_is_never_kept_even_if_the_experimenter_says_so(tmp_path: Path) -> None:
    rest = Window(np.ones(8), clipped=0)
    world = World(iter([100.0, *good()]), windows=iter([None, *[rest] * 8]))
    world.keeps = lambda step: True  # type: ignore[method-assign]
    record(world, tmp_path / "set")
    assert manifest.load_all(tmp_path / "set").panel.shape == (2, 2, 8)


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
        (RIG, RigError, r"rig 'bench': got no \[accelerometer\] table"),
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
    tmp_path: Path, repository_root: Path, monkeypatch: pytest.MonkeyPatch, approved: SnapshotAssertion
) -> None:
    (tmp_path / "rig.toml").write_text(RIG.replace("[tracker]", "[tracker]\nzeroing_mm = 1.0") + ACCELEROMETER, "utf-8")
    # One look at the sensor; half a second at 5 kHz in the air, and half a second at rest; then a height of 20 mm.
    heights_mm = [0.5, *[9.0] * 13, *[0.5] * 13, 20.5]
    tracker = ScriptedTracker([rest_samples(0, mm) for mm in heights_mm], clock=ManualClock(0))
    monkeypatch.setattr(serial_tracker, "SerialTracker", lambda *_, **__: tracker)
    world = World(good())
    monkeypatch.setattr(accelerometers, "open_accelerometer", lambda *_, **__: world)
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
        assert prompt == approved
    assert screen.getvalue() == approved
    assert reads[0].height_mm[0] == 20.0


def test_a_recording_without_zeroing_states_no_zero(tmp_path: Path) -> None:
    made = record(World(good()), tmp_path / "set")
    assert "zero" not in made.read_text("utf-8")
