"""Virtual surfaces in a session: what lies there, what sounds at a touch, what goes on record, and what ends it."""

from __future__ import annotations

import gzip
import os
import signal
import threading
from collections import deque
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, TypeVar
from unittest import mock

import numpy as np
import pytest
from syrupy.assertion import SnapshotAssertion

from palpate.experiment import storage
from palpate.experiment.apparatus import rig
from palpate.experiment.apparatus.servo.record import CYCLE, ForceRecord
from palpate.experiment.apparatus.servo.rendering import Felt, Touch
from palpate.experiment.apparatus.tracker.clock_map import ClockMap
from palpate.experiment.apparatus.tracker.landing import LandingPredictor
from palpate.experiment.dataset import build, tables
from palpate.experiment.dataset.kinds import tapping
from palpate.experiment.dataset.outside import losses
from palpate.experiment.errors import PalpateError, ServoError
from palpate.experiment.protocol.files import ProtocolFile, shipped
from palpate.experiment.protocol.kinds.tapping import Tapping
from palpate.experiment.protocol.models import Protocol, Step
from palpate.experiment.records import chain, transcript
from palpate.experiment.records.entries import Answer, Note, PlannedTrial, Redo
from palpate.experiment.records.kinds.tapping import Changed, ForceTrace, Place, Pushed, Tapped
from palpate.experiment.rehearsal.clock import ManualClock
from palpate.experiment.rehearsal.kinds.tapping import hand
from palpate.experiment.session import attempt, exposure, runner
from palpate.experiment.session.kind import Lent
from palpate.experiment.session.kinds.tapping import taps, virtual
from palpate.experiment.session.kinds.tapping.taps import Taps
from palpate.experiment.session.kinds.tapping.virtual import PLACES
from palpate.experiment.synthesis.contact.block import Block
from tests.experiment.protocol.tapping import CROSSED, delayed, rendering
from tests.experiment.session.bench import HEADER
from tests.experiment.session.kinds.tapping.bench import contents
from tests.experiment.session.scripted import START_NS, ScriptedActuator, ScriptedConsole

PROTOCOL = ProtocolFile.model_validate(rendering())
PAIRS = (("felt", "tin"), ("cork", "cork"))
ORDER = tuple(PlannedTrial(trial=n, presented=pair) for n, pair in enumerate(PAIRS, start=1))
OWN = {"task": "live", "task_kind": "tapping", "design": "comparison"}
ASKED = HEADER.model_copy(update={**OWN, "order": ORDER, "block_trials": len(ORDER)})
CLOCK = ClockMap(0, START_NS)
RATE_HZ = 5000

One = TypeVar("One")


Script = list[tuple[list[Felt | PalpateError], str]]


class ScriptedServo:
    """Implements `Servo`: the hand does what it is told while a question is open."""

    def __init__(self) -> None:
        self._told: deque[Felt | PalpateError] = deque()
        self._some = threading.Condition()
        self.rendered: list[Block | None] = []
        self.ends_ns: set[int | None] = set()
        self.reconnected = self.beats = 0
        self.sent = b""

    def is_live(self) -> bool:
        return True

    def render(self, block: Block | None, ends_ns: int = 0) -> None:
        self.rendered.append(block)
        self.ends_ns.add(ends_ns if block else None)

    def beat(self) -> None:
        self.beats += 1

    def forces(self) -> bytes:
        force, self.sent = self.sent, b""
        return force

    def tell(self, what: Felt | PalpateError) -> None:
        """Have the hand do something, and return once the session has dealt with it."""
        with self._some:
            self._told.append(what)
            self._some.notify_all()
            # The session reads again only once it has followed what came before.
            self._some.wait_for(lambda: not self._told and self._asked, 5.0)

    _asked = False

    def read(self) -> Felt | None:
        with self._some:
            self._asked = True
            self._some.notify_all()
            self._some.wait_for(lambda: self._told, 0.05)
            if not self._told:
                return None
            told, self._asked = self._told.popleft(), False
            if isinstance(told, PalpateError):
                self._asked = True
                self._some.notify_all()
                raise told
            return told

    def reconnect(self) -> None:
        self.reconnected += 1

    def stop(self) -> None:
        pass

    def close(self) -> None:
        pass


def touch(speed_mm_s: float, us: int = 1_000_000, *, mean_mm_s: float = 0.0) -> Felt:
    """A hand that falls straight to the face, touches it in the last of its samples, and is slow by then."""
    times = tuple(range(us - 60_000, us, 1000))
    heights = tuple((us - t) * 1e-6 * speed_mm_s for t in times)
    return Felt(times, heights, (Touch(us - 1.0, speed_mm_s, mean_mm_s),), CLOCK, False)


def samples(path: list[tuple[int, float]]) -> Felt:
    """A read of times and heights, without a touch."""
    return Felt(tuple(us for us, _ in path), tuple(mm for _, mm in path), (), CLOCK, False)


begun: list[virtual.VirtualSurfaces] = []


class Devices(virtual.SurfaceDevices):
    def begin(self, lent: Lent) -> virtual.VirtualSurfaces:
        begun[:] = [super().begin(lent)]
        return begun[0]


class Session:
    """One session of virtual surfaces: at each question, what the hand does, and the key that follows."""

    def __init__(
        self,
        script: Script,
        dataset: Path,
        *,
        lead_ns: int = 0,
        felt: tuple[Place, ...] = PLACES,
        servo: ScriptedServo | None = None,
        protocol: Protocol = PROTOCOL,
        sounds_anyway: bool = False,
    ) -> None:
        """Begin; the hand has been at the places `felt` before it does what the script says."""
        clock = ManualClock(START_NS)
        self.servo, self.actuator, self.dataset = servo or ScriptedServo(), ScriptedActuator(), dataset
        self.actuator.lead_ns, self.actuator.sounds_anyway = lead_ns, sounds_anyway
        hands = deque(hand for hand, _ in script)
        self.left: list[bool] = []
        """Whether a block is there when each key is pressed."""

        def tapping() -> None:
            begun[0].taps.touched.update(felt)
            for what in hands.popleft():
                if isinstance(what, Felt):
                    clock.sleep_ns(CLOCK.session_ns(what.device_us[-1]) - clock.now_ns())
                self.servo.tell(what)
            self.left.append(self.servo.rendered[-1] is not None)

        self.desk = ScriptedConsole(clock, [key for _, key in script], before_ask=tapping)
        devices = Devices(
            servo=self.servo,
            actuator=self.actuator,
            rings=virtual.vibrations(protocol.table(Tapping), RATE_HZ),
            blocks=virtual.blocks(protocol.table(Tapping), tracker_hz=1000),
            noise_mm=0.01,
            opened=ExitStack(),
        )
        with devices.opened:
            self.footer = runner.run(
                protocol=protocol.model_copy(update={"tasks": (protocol.tasks[0].model_copy(update={"id": "live"}),)}),
                header=ASKED,
                devices=attempt.Devices(kind=devices, console=self.desk, clock=clock, masker=None, reconnect_s=1.0),
                rig_file=shipped("rigs/rehearsal.toml"),
                dataset=dataset,
            )

    def entries(self, kind: type[One]) -> list[One]:
        return [one for one in contents(self.dataset).entries if isinstance(one, kind)]


def test_each_surface_rings_as_its_own_and_every_change_and_tap_is_on_record(
    tmp_path: Path, approved: SnapshotAssertion
) -> None:
    script: Script = [
        ([touch(100.0)], "s"),
        ([touch(150.0, 2_000_000)], "s"),
        ([touch(120.0, 3_000_000)], "1"),
        ([touch(110.0, 4_000_000, mean_mm_s=176.0)], "2"),
    ]
    session = Session(script, tmp_path)
    changed = [(one.trial, one.place, one.material) for one in session.entries(Changed)]
    assert changed == [(1, "second", "tin"), (1, "first", "felt")]
    tapped = session.entries(Tapped)
    assert [(one.trial, one.place, one.material) for one in tapped] == [
        (1, "first", "felt"),
        (1, "second", "tin"),
        (1, "first", "felt"),
        (2, "first", "cork"),
    ]
    assert [one.speed_mm_s for one in tapped] == pytest.approx([100.0, 150.0, 120.0, 110.0], rel=0.01)
    assert [one.fast for one in tapped] == [False, False, False, True]
    assert [one.onset.contact_ns - START_NS for one in tapped] == [n * 10**9 - 1000 for n in range(1, 5)]
    # Equations (1) and (2), written out: L times the full amplitude at 0.2 m/s, and B = 100 /s.
    t = np.arange(session.actuator.played[0].size) / RATE_HZ
    for played, one, (hz, part) in zip(
        session.actuator.played, tapped, [(60.0, 0.1), (900.0, 0.5), (60.0, 0.1), (200.0, 0.2)], strict=True
    ):
        wanted = 40.0 * part * one.speed_mm_s / 200.0 * np.exp(-100.0 * t) * np.sin(2 * np.pi * hz * t)
        assert np.allclose(played, wanted, rtol=1e-9, atol=1e-12)
    assert [one.answered for one in session.entries(Answer)] == ["first", "second"]
    told = transcript.text(contents(tmp_path))
    lines = [line.partition("trial ")[2] for line in told.splitlines()]
    assert [line for line in lines if "changed" in line or "tapped" in line] == approved


def test_the_force_that_was_sent_is_on_record_with_what_is_lost(tmp_path: Path) -> None:
    begun, record = [], ForceRecord()
    cycles = [record.add(n, START_NS + n * 400_000, 1, (-0.1, 0.0), (1.0, 0.0), (0.9, 0.0)) for n in range(3 * 64)]
    first, lost, third = [one for one in cycles if one]

    class Sending(ScriptedServo):
        def render(self, block: Block | None, ends_ns: int = 0) -> None:
            super().render(block, ends_ns)
            begun.append(self)
            self.sent = first if len(begun) == 1 else third if len(begun) == 2 else b""

    Session([([touch(100.0)], "1"), ([touch(100.0, 2_000_000)], "2")], tmp_path, servo=Sending())
    pushed = [one for one in contents(tmp_path).entries if isinstance(one, Pushed)]
    assert [(one.cycles, one.lost) for one in pushed] == [(64, 0), (64, 64)]
    path = storage.raw_path(storage.journal_path(tmp_path, "01", "live"), "force.bin")
    assert path.read_bytes() == first + third
    assert [*build.raw_frames(storage.journal_path(tmp_path, "01", "live"), pushed)] == [first, third]
    assert len(lost) == len(first)


def test_a_kill_while_a_force_is_written_costs_that_part_alone(tmp_path: Path) -> None:
    """The second part stops in the middle of a cycle; the session goes on behind it, with a servo that counts anew."""

    def forces(begin: int) -> list[bytes]:
        record, at_ns = ForceRecord(), START_NS + begin * 400_000
        each = [record.add(n, at_ns + n * 400_000, 1, (-0.1, 0.0), (1.0, 0.0), (0.9, 0.0)) for n in range(2 * 64)]
        return [one for one in each if one]

    parts = [*forces(0), *forces(1000)]
    torn = CYCLE.itemsize * 20 + 7

    class Sending(ScriptedServo):
        def forces(self) -> bytes:
            return left.popleft() if left else b""

    def killed(file: Any, raw: bytes, **how: Any) -> None:
        if raw == parts[1]:
            written(file, raw[:torn], **how)
            os.kill(os.getpid(), signal.SIGKILL)
        written(file, raw, **how)

    written, left = chain.write_through, deque(parts[:2])
    child = os.fork()
    if not child:
        with mock.patch.object(chain, "write_through", killed):
            Session([([touch(100.0)], "1"), ([touch(100.0, 2_000_000)], "2")], tmp_path, servo=Sending())
        os._exit(0)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == -signal.SIGKILL
    path = storage.journal_path(tmp_path, "01", "live")
    raw = storage.raw_path(path, "force.bin")
    assert raw.read_bytes() == parts[0] + parts[1][:torn]
    (named,) = [one for one in contents(tmp_path).entries if isinstance(one, Pushed)]
    assert [*build.raw_frames(path, [named])] == parts[:1]

    left = deque(parts[2:])
    Session([([touch(100.0)], "1"), ([touch(100.0, 2_000_000)], "2")], tmp_path, servo=Sending())
    pushed = [one for one in contents(tmp_path).entries if isinstance(one, Pushed)]
    assert [*build.raw_frames(path, pushed)] == [parts[0], *parts[2:]]
    assert raw.read_bytes() == parts[0] + parts[1][:torn] + b"".join(parts[2:])
    dataset: Any = SimpleNamespace(
        root=tmp_path,
        purpose="REHEARSAL",
        version=lambda _: PROTOCOL,
        sessions=((path, contents(tmp_path).header),),
        under_way=(),
    )
    assert [one.where for one in tables.lost_traces(dataset)] != []
    with mock.patch.object(rig, "session_rig", return_value=rig.load(shipped("rigs/tapping.toml"))):
        tapping.DATASET.write(dataset, path, contents(tmp_path))
    assert [*tables.lost_traces(dataset)] == []
    (trace,) = tmp_path.rglob("*_physio.tsv.gz")
    rows = gzip.decompress(trace.read_bytes()).decode().splitlines()
    known = np.flatnonzero([not row.startswith("n/a") for row in rows])
    assert known[:64].tolist() == [*range(64)]
    assert np.flatnonzero(np.diff(known) != 1).tolist() == [63]
    assert known.size == 64 + 2 * 64


def test_a_session_goes_on_behind_an_end_that_its_file_of_force_lost(tmp_path: Path) -> None:
    """As after a power cut: the journal names a part of which the disk has the beginning."""
    record = ForceRecord()
    each = [record.add(n, START_NS + n * 400_000, 1, (-0.1, 0.0), (1.0, 0.0), (0.9, 0.0)) for n in range(3 * 64)]
    parts = [one for one in each if one]

    class Sending(ScriptedServo):
        def forces(self) -> bytes:
            return left.popleft() if left else b""

    left = deque(parts[:2])
    Session([([touch(100.0)], "1"), ([], "=")], tmp_path, servo=Sending())
    path = storage.journal_path(tmp_path, "01", "live")
    raw = storage.raw_path(path, "force.bin")
    raw.write_bytes(raw.read_bytes()[: -CYCLE.itemsize - 7])
    left = deque(parts[2:])
    Session([([touch(100.0, 2_000_000)], "2")], tmp_path, servo=Sending())
    recorded = contents(tmp_path).entries
    pushed = [one for one in recorded if isinstance(one, Pushed)]
    assert pushed[1].trace.offset + pushed[1].trace.length == 2 * len(parts[0])
    assert raw.stat().st_size == 3 * len(parts[0]) - CYCLE.itemsize - 7
    cut, unnamed = losses.cut_off(path, recorded)
    assert ([recorded[place] for place in cut], unnamed) == ([pushed[1]], 0)
    assert [*build.raw_frames(path, losses.without_lost(path, recorded))] == [parts[0], parts[2]]
    (lost,) = losses.losses([(path, contents(tmp_path).header)])
    assert (lost.where, lost.refuses) == (raw, False)
    assert "64" in lost.what.split()
    assert ForceTrace.lossy == ("cycle", CYCLE.itemsize)


def test_no_answer_is_taken_before_both_surfaces_were_tapped(tmp_path: Path, approved: SnapshotAssertion) -> None:
    script: Script = [
        ([touch(100.0)], "1"),
        ([], "s"),
        ([touch(100.0, 2_000_000)], "1"),
        ([], "2"),
        ([ServoError("force device: gone")], "2"),
        ([], "="),
    ]
    session = Session(script, tmp_path, felt=())
    assert [said for said in session.desk.shown if "must tap" in said] == approved
    assert [(one.trial, one.answered) for one in session.entries(Answer)] == [(1, "first")]
    # Where nothing can be felt any more, any answer is taken, and the trial comes again.
    assert [one.reason for one in session.entries(Redo)] == approved(name="redone")


def test_a_vibration_is_aimed_at_the_touch_that_is_predicted_and_at_none_that_does_not_come(tmp_path: Path) -> None:
    """110 mm/s, straight, from 10 mm above the face; then the same until 1.5 mm above it, and back."""
    begin_us, speed = 200_000_000, 110.0
    touch_us = begin_us + 10.0 / speed * 1e6
    down = [(us, 10.0 - (us - begin_us) * 1e-6 * speed) for us in range(begin_us, int(touch_us) + 3000, 1000)]
    reads = [samples(down[n : n + 4]) for n in range(0, len(down), 4)]
    last = reads[-1]
    reads[-1] = Felt(last.device_us, last.height_mm, (Touch(touch_us, speed, speed),), CLOCK, False)
    turned = [(us + 10**6, mm) for us, mm in down if mm > 1.5]
    turned += [(turned[-1][0] + n * 1000, turned[-1][1] + n * 0.1) for n in range(1, 60)]
    back = [samples(turned[n : n + 4]) for n in range(0, len(turned), 4)]
    session = Session([([*reads], "s"), ([*back], "1"), ([], "2")], tmp_path, lead_ns=5_000_000)
    (tapped,) = session.entries(Tapped)
    assert tapped.onset.prediction_error_ms == pytest.approx(0.0, abs=0.1)
    assert tapped.onset.scheduled_ns == pytest.approx(CLOCK.session_ns(touch_us), abs=100_000)
    assert len(session.actuator.played) == 1
    assert session.actuator.withdrawn >= 1


def falling(speed: float, *, turns_mm: float | None = None) -> list[Felt | PalpateError]:
    """A hand that falls straight from 10 mm above the face, read every 2 ms, and touches, or turns back before it."""
    begin_us = 200_000_000
    touch_us = begin_us + 10.0 / speed * 1e6
    down = [(us, 10.0 - (us - begin_us) * 1e-6 * speed) for us in range(begin_us, int(touch_us) + 3000, 400)]
    if turns_mm is not None:
        down = [one for one in down if one[1] > turns_mm]
        down += [(down[-1][0] + n * 400, down[-1][1] + n * 0.04) for n in range(1, 60)]
    reads = [samples(down[n : n + 5]) for n in range(0, len(down), 5)]
    return [*reads] if turns_mm else [*reads[:-1], replace(reads[-1], touches=(Touch(touch_us, speed, speed),))]


EARLY = ProtocolFile.model_validate(delayed(-20.0, 0.0, 50.0))


def test_a_vibration_before_the_touch_is_aimed_ahead_of_the_touch_that_is_predicted(tmp_path: Path) -> None:
    session = Session([(falling(110.0), "1"), ([], "2")], tmp_path, lead_ns=5_000_000, protocol=EARLY)
    (tapped,) = session.entries(Tapped)
    assert tapped.onset.scheduled_ns is not None
    assert tapped.onset.prediction_error_ms is not None
    # `felt` comes first, 20 ms before the touch; 25 ms ahead a straight fall is known to a millisecond.
    ahead_ms = (tapped.onset.scheduled_ns - tapped.onset.contact_ns) / 1e6
    assert ahead_ms == pytest.approx(-20.0 + tapped.onset.prediction_error_ms, abs=0.01)
    assert abs(tapped.onset.prediction_error_ms) < 1


def test_a_later_vibration_begins_with_silence_of_its_delay(tmp_path: Path) -> None:
    session = Session([([touch(100.0)], "s"), ([touch(100.0, 2_000_000)], "1"), ([], "2")], tmp_path, protocol=EARLY)
    at_once, late = session.actuator.played
    # `tin` comes second, 50 ms after the touch.
    assert np.flatnonzero(late)[0] - np.flatnonzero(at_once)[0] == round(0.05 * RATE_HZ)


def test_each_surface_pushes_below_its_crossover_and_vibrates_above(tmp_path: Path) -> None:
    script: Script = [([touch(100.0)], "s"), ([touch(100.0, 2_000_000)], "1"), ([], "2")]
    session = Session(script, tmp_path, protocol=CROSSED)
    # The first pair is `felt` and `tin`; before it there is a block for practice.
    rendered = [one.crossover_hz for one in session.servo.rendered[:3] if one is not None]
    assert rendered == [120.0, 30.0, 120.0]
    # The bilinear filter of first order, written out: y[n] = (x[n] - x[n - 1] + (1 - g) y[n - 1]) / (1 + g).
    t = np.arange(session.actuator.played[0].size) / RATE_HZ
    for played, hz, part, crossover_hz in zip(
        session.actuator.played, (60.0, 900.0), (0.1, 0.5), (30.0, 120.0), strict=True
    ):
        whole = 40.0 * part * 0.5 * np.exp(-100.0 * t) * np.sin(2 * np.pi * hz * t)
        g, wanted, before = np.tan(np.pi * crossover_hz / RATE_HZ), [0.0], 0.0
        for now in whole[1:]:
            wanted.append((now - before + (1 - g) * wanted[-1]) / (1 + g))
            before = now
        assert np.allclose(played, wanted, rtol=1e-4, atol=1e-9)


def test_a_device_whose_band_ends_below_a_crossover_is_refused() -> None:
    rig_file = shipped("rigs/tapping.toml")
    loaded = rig.load(rig_file)
    for band_hz, refused in ((119.0, True), (120.0, False), (None, False)):
        servo = loaded.servo and loaded.servo.model_copy(update={"band_hz": band_hz})
        narrow = virtual.unable(CROSSED.table(Tapping), loaded.model_copy(update={"servo": servo}), rig_file)
        assert (narrow is not None) == refused


def test_a_vibration_that_began_before_a_touch_that_did_not_come_is_on_record(tmp_path: Path) -> None:
    script: Script = [(falling(110.0, turns_mm=1.0), "1"), ([], "2")]
    for sounds, folder in ((True, tmp_path / "sounded"), (False, tmp_path / "withdrawn")):
        session = Session(script, folder, lead_ns=5_000_000, protocol=EARLY, sounds_anyway=sounds)
        assert session.entries(Tapped) == []
        assert len(session.entries(Note)) == sounds


def test_a_rig_that_plays_at_no_set_time_is_refused_for_a_vibration_before_the_touch() -> None:
    rig_file = shipped("rigs/tapping.toml")
    loaded = rig.load(rig_file)
    late = ProtocolFile.model_validate(delayed(0.0, 10.0, 50.0))
    assert virtual.unable(EARLY.table(Tapping), loaded, rig_file) is not None
    assert virtual.unable(late.table(Tapping), loaded, rig_file) is None


def sped_up(before_us: int) -> list[Felt | PalpateError]:
    """A hand that falls straight at 110 mm/s, and so long before its touch at 140; read every 2 ms."""
    begin_us, turn_us = 200_000_000, 200_000_000 + 10_000_000 // 110 - before_us
    turn_mm = before_us * 0.110e-3
    touch_us = turn_us + turn_mm / 0.140e-3
    down = [
        (us, turn_mm - (us - turn_us) * (0.110e-3 if us < turn_us else 0.140e-3))
        for us in range(begin_us, int(touch_us) + 3000, 400)
    ]
    reads = [samples(down[n : n + 5]) for n in range(0, len(down), 5)]
    return [*reads[:-1], replace(reads[-1], touches=(Touch(touch_us, 140.0, 140.0),))]


def test_a_vibration_is_made_anew_for_another_speed_while_there_is_time(tmp_path: Path) -> None:
    session = Session([(sped_up(20_000), "1"), ([], "2")], tmp_path, lead_ns=5_000_000)
    made = [onsets for onsets in session.actuator.aimed if onsets]
    assert len(made) > 1
    (tapped,) = session.entries(Tapped)
    assert tapped.onset.scheduled_ns == made[-1][-1]


def test_a_vibration_that_is_aimed_is_not_made_anew_where_the_new_one_would_come_late(tmp_path: Path) -> None:
    session = Session([(sped_up(6_000), "1"), ([], "2")], tmp_path, lead_ns=5_000_000)
    (onsets,) = session.actuator.aimed
    (tapped,) = session.entries(Tapped)
    assert tapped.onset.scheduled_ns == onsets[-1]


def test_a_vibration_that_has_begun_is_not_made_a_second_time(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its touch was predicted too soon, so that it sounds while the hand still falls."""

    def aim(actuator: ScriptedActuator, onset_ns: int) -> bool:
        actuator.aimed[-1].append(onset_ns)
        return len(actuator.aimed[-1]) == 1

    monkeypatch.setattr(ScriptedActuator, "aim", aim)
    session = Session([(sped_up(20_000), "1"), ([], "2")], tmp_path, lead_ns=5_000_000)
    (onsets,) = session.actuator.aimed
    (tapped,) = session.entries(Tapped)
    assert tapped.onset.scheduled_ns == onsets[0]


@pytest.mark.parametrize("speed_mm_s", [60.0, 110.0, 150.0, 200.0])
def test_a_tap_from_rest_is_predicted_before_it_is_too_late_to_aim(speed_mm_s: float) -> None:
    """By a smooth reach, 9 ms before its touch, to half a millisecond: a step's slower filter was 4 ms late."""
    path = hand.tap(np.random.default_rng(1), speed_mm_s)
    times = np.arange(0.0, 400_000 + path.contact_us - 9_000, 400.0)
    heights = path.at(times - 400_000) + np.random.default_rng(2).normal(0.0, 0.005, times.size)
    step = Step(gate_top_mm=taps.FROM_MM, gate_bottom_mm=1.0, contact_mm=0.0)
    predictor = LandingPredictor(step, noise_mm=0.005, wander_mm=taps.WANDER_MM)
    state = predictor.init()
    for us, mm in zip(times, heights, strict=True):
        state = predictor.step(state, int(us), float(mm))
    assert state is not None
    landing = predictor.landing(state)
    assert landing is not None
    assert landing.us - 400_000 == pytest.approx(path.contact_us, abs=500)


def test_a_block_is_there_for_practice_and_then_only_while_a_question_is_open(tmp_path: Path) -> None:
    session = Session([([], "1"), ([], "2")], tmp_path)
    # At its end the session takes away what may be there.
    assert [one is not None for one in session.servo.rendered] == [True, True, False, True, False, False]
    assert session.footer.reason == "complete"


def test_no_block_is_left_once_the_session_is_over(tmp_path: Path) -> None:
    """The question stays open; what pushes does not."""
    over_us = round(PROTOCOL.exposure.session_min * 60e6) + 1_000_000
    session = Session([([touch(100.0, over_us)], "1")], tmp_path)
    assert session.left == [False]
    assert all(one is None for one in session.servo.rendered[2:])
    assert (session.footer.reason, session.footer.answered) == ("paused", 1)
    assert not session.actuator.played


def test_an_answer_to_a_surface_that_could_not_be_tapped_any_more_does_not_count(tmp_path: Path) -> None:
    over_us = round(PROTOCOL.exposure.session_min * 60e6) + 1_000_000
    session = Session([([touch(100.0, over_us)], "1")], tmp_path, felt=("first",))
    assert (session.footer.reason, session.footer.answered) == ("paused", 0)
    (redo,) = session.entries(Redo)
    assert (redo.trial, redo.put_off) == (1, True)


def test_each_block_carries_the_end_of_the_session(tmp_path: Path) -> None:
    session = Session([([], "1"), ([], "2")], tmp_path)
    assert session.servo.ends_ns == {START_NS + round(PROTOCOL.exposure.session_min * 60e9), None}


def test_quiet_takes_block_and_vibration_away_whatever_the_disk_does(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The tap's entry is being written, under the taps' lock, when the session has to be silent."""
    writes, freed = threading.Event(), threading.Event()
    write, rendered, withdrawn = runner.SessionLog.write, [], list[bool]()

    def hangs(log: runner.SessionLog, entry: Any) -> None:
        if isinstance(entry, Tapped):
            writes.set()
            assert freed.wait(60.0)
        write(log, entry)

    def withdraw() -> bool:
        withdrawn.append(True)
        return True

    def silenced() -> None:
        assert writes.wait(60.0)
        mock.patch.object(begun[0].taps.actuator, "withdraw", withdraw).start()
        begun[0].quiet("by the experimenter")
        begun[0].beat(0)
        rendered.append(begun[0].taps.servo.rendered[-1])  # type: ignore[attr-defined]
        freed.set()

    monkeypatch.setattr(runner.SessionLog, "write", hangs)
    silencing = threading.Thread(target=silenced)
    silencing.start()
    session = Session([([touch(100.0)], "1"), ([], "2")], tmp_path)
    silencing.join()
    assert rendered == [None]
    assert withdrawn
    assert session.servo.beats == 1


def test_a_failure_leaves_no_block(tmp_path: Path) -> None:
    stood = ServoError("the session was frozen for 5.2 s")
    session = Session([([stood], "1"), ([], "2"), ([], "1")], tmp_path)
    # For practice, laid and taken away as it failed and after the answer; for two trials more; and at the end.
    there = [one is not None for one in session.servo.rendered]
    assert there == [True, True, False, False, True, False, True, False, False]
    (redo,) = session.entries(Redo)
    assert (redo.trial, redo.reason, redo.put_off) == (1, str(stood), True)


def test_a_touch_that_is_read_late_sounds_nothing_and_its_trial_comes_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In real time alone: simulated time does not pass by itself."""
    late = replace(touch(100.0), clock=ClockMap(0, START_NS - taps.LATE_NS - 10_000_000))
    assert not Session([([late], "1"), ([], "2")], tmp_path / "simulated").entries(Redo)
    monkeypatch.setattr(exposure.Exposed, "begin", lambda _self, _kind: None)
    monkeypatch.setattr(ManualClock, "simulated", False)
    session = Session([([late], "1"), ([], "2"), ([], "1")], tmp_path / "real")
    assert not session.actuator.played
    (redo,) = session.entries(Redo)
    assert (redo.trial, redo.put_off) == (1, True)


def test_a_touch_while_no_question_is_open_sounds_nothing(tmp_path: Path) -> None:
    session = Session([([], "1"), ([touch(100.0)], "2")], tmp_path)
    assert len(session.actuator.played) == len(session.entries(Tapped)) == 1


def test_a_servo_that_fails_puts_the_trial_off_whatever_was_answered(
    tmp_path: Path, approved: SnapshotAssertion
) -> None:
    script: Script = [
        ([touch(100.0), ServoError("force device at x: no answer for 30 ms")], "1"),
        ([touch(100.0, 2_000_000)], "2"),
        ([touch(100.0, 3_000_000)], "1"),
    ]
    session = Session(script, tmp_path)
    (redo,) = session.entries(Redo)
    assert (redo.trial, redo.put_off) == (1, True)
    # What follows the servo tells of it as the session goes on: either may be shown first.
    assert [redo.reason, *sorted(session.desk.shown)] == approved
    assert session.servo.reconnected == 1
    assert [(one.trial, one.answered) for one in session.entries(Answer)] == [(2, "second"), (1, "first")]


def test_a_session_ends_while_the_hand_rests(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A read of a hand that rests may wait as long as it likes: the session's end stops it."""
    freed = threading.Event()

    def rests(servo: ScriptedServo) -> None:
        assert freed.wait(60.0), "not stopped"

    monkeypatch.setattr(ScriptedServo, "read", rests)
    monkeypatch.setattr(ScriptedServo, "stop", lambda _servo: freed.set())
    assert Session([([], "1"), ([], "2")], tmp_path).footer.reason == "complete"
    assert freed.is_set()


def test_the_lamp_stays_lit_for_half_a_second() -> None:
    clock, servo = ManualClock(START_NS), ScriptedServo()
    unused: Any = None
    limits: Any = SimpleNamespace(ends_ns=START_NS, end_reason=lambda: "")
    following = Taps(
        servo=servo,
        actuator=ScriptedActuator(),
        block=next(iter(virtual.blocks(PROTOCOL.table(Tapping), tracker_hz=1000).values())),
        noise_mm=0.01,
        lent=Lent(protocol=PROTOCOL, header=ASKED, console=unused, clock=clock, log=unused, limits=limits),
    )
    lit = [following.too_fast]
    for fast, passes_ns in ((False, 0), (True, 0), (False, 499_000_000), (False, 1_000_000)):
        clock.sleep_ns(passes_ns)
        servo.tell(replace(samples([(0, 50.0)]), fast=fast))
        lit.append(following.too_fast)
    following.close()
    assert lit == [False, False, True, True, False]
