"""Event times of sessions whose tracker's clock drifts, against the times at which things truly happened."""

from __future__ import annotations

import gzip
import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from palpate.experiment import storage
from palpate.experiment.apparatus import rig
from palpate.experiment.apparatus.tracker import clock_map as clock_maps
from palpate.experiment.apparatus.tracker.clock_map import ClockMap, ClockState
from palpate.experiment.apparatus.tracker.frames import FRAME_BYTES, Decoder, LinkCounts, Samples, encode
from palpate.experiment.apparatus.tracker.gate import Scrutiny
from palpate.experiment.apparatus.tracker.serial_tracker import KEPT_S
from palpate.experiment.dataset import build
from palpate.experiment.dataset.kinds.footstep import placed_steps, write_foot
from palpate.experiment.errors import TrackerStopped
from palpate.experiment.protocol import files
from palpate.experiment.protocol.files import shipped
from palpate.experiment.records import bridging, journal
from palpate.experiment.records.entries import Exposure, Footer, PlannedTrial, Resumed, TrackerOpened
from palpate.experiment.records.kinds.footstep import FootStep
from palpate.experiment.rehearsal.clock import ManualClock
from palpate.experiment.session import attempt, runner
from palpate.experiment.session.kinds.footstep.trials import FootstepDevices
from tests.experiment.session.bench import HEADER
from tests.experiment.session.scripted import START_NS, ScriptedConsole

RIG = shipped("rigs/rehearsal.toml")
TRIALS = 8
LOST = 5
"""The step, from 0, in which the tracker is unplugged."""

ORIGINS_US = (5_000_000, 1_000_000_000)
"""Device time when the tracker is first powered, and when it is back."""

BATCH = 4
"""Samples a read, at 1 kHz of the device's own clock."""


class Wandering:
    """Implements `Tracker`: its clock is off by `drift_ppm`; reads come late, one in a hundred by up to 31 ms."""

    def __init__(self, clock: ManualClock, drift_ppm: float, *along: int) -> None:
        """Begin; `along` is what a planar one reads along the face in every frame."""
        self._clock, self._along = clock, along
        self._ns_per_us = 1000 * (1 + drift_ppm * 1e-6)
        self._rng = np.random.default_rng(5)
        self.counts = LinkCounts()
        self.contacts_ns: list[float] = []
        """When the foot truly landed, step by step."""
        self._boots_ns: list[int] = []
        self._read_ns = 0
        self._power()

    def true_ns(self, device_us: float) -> float:
        """When it truly was that time of the device."""
        boot = int(device_us >= ORIGINS_US[1])
        return self._boots_ns[boot] + (device_us - ORIGINS_US[boot]) * self._ns_per_us

    @property
    def clock_map(self) -> ClockMap | None:
        return self._state.map() if self._state else None

    def drain(self) -> None:
        # The thread that stamps arrivals goes on until its store is full.
        full_ns = self._read_ns + KEPT_S * 1e9
        while self.true_ns(self._next_us + 1000 * BATCH) < self._clock.now_ns():
            if self.true_ns(self._next_us) < full_ns:
                self._take()
            else:
                self._next_us += 1000 * BATCH
        self._read_ns = self._clock.now_ns()
        self._falls_ns = self._clock.now_ns() + int(self._rng.uniform(0.1, 3.0) * 1e9)
        self._mm_s = float(self._rng.uniform(60, 390))
        self.contacts_ns.append(self._falls_ns + 30 / self._mm_s * 1e9)

    def read(self) -> Samples:
        us, arrived_ns = self._take()
        self._clock.sleep_ns(arrived_ns - self._clock.now_ns())
        self._read_ns = self._clock.now_ns()
        fallen_s = (np.array([self.true_ns(one) for one in us.tolist()]) - self._falls_ns) / 1e9
        height_mm = np.clip(30 - self._mm_s * fallen_s, 0, 30)
        if len(self._boots_ns) == 1 and len(self.contacts_ns) > LOST and height_mm[-1] < 5:
            self.contacts_ns.pop()
            raise TrackerStopped("tracker: the port has gone")
        raw = [encode(int(one) // 1000, int(one), 30_000, *self._along) for one in us]
        return Samples(us, height_mm, b"".join(raw), np.cumsum([len(frame) for frame in raw]), arrived_ns)

    def reconnect(self, timeout_s: float) -> None:
        self._clock.sleep_ns(1_500_000_000)
        self._power()

    def close(self) -> None: ...

    def _power(self) -> None:
        self._boots_ns.append(self._clock.now_ns())
        self._next_us = ORIGINS_US[len(self._boots_ns) - 1]
        self._read_ns = self._arrived_ns = self._clock.now_ns()
        self._state: ClockState | None = None

    def _take(self) -> tuple[NDArray[np.int64], int]:
        us = self._next_us + 1000 * np.arange(1, BATCH + 1)
        self._next_us = int(us[-1])
        late_ns = self._rng.exponential(2e5) + (self._rng.uniform(0, 31e6) if self._rng.random() < 0.01 else 0)
        self._arrived_ns = max(self._arrived_ns, int(self.true_ns(us[-1]) + late_ns))
        at = self._next_us, self._arrived_ns
        self._state = clock_maps.step(self._state, *at) if self._state else clock_maps.init(*at)
        self.counts = self.counts.plus(LinkCounts(received=BATCH))
        return us, self._arrived_ns


def run(
    dataset_root: Path,
    clock: ManualClock,
    tracker: Wandering,
    keys: str,
    trials: int,
    rig_file: Path = RIG,
) -> Footer:
    """A session of the real task, or what remains of it."""
    order = tuple(PlannedTrial(trial=n, presented=("copy paper",)) for n in range(1, trials + 1))
    changed = {"order": order, "task": "real", "block_trials": trials, "rig_sha256": rig.sha256(rig.load(rig_file))}
    devices = attempt.Devices(
        kind=FootstepDevices(
            tracker,
            tracker_port="wandering",
            noise_mm=0.1,
            scrutiny=Scrutiny(rate_hz=1000, noise_mm=0.1),
            actuator=None,
            materials=None,
        ),
        console=ScriptedConsole(clock, keys, before_ask=lambda: clock.sleep_ns(4_000_000_000)),
        clock=clock,
        masker=None,
        reconnect_s=300.0,
    )
    return runner.run(
        protocol=files.load(shipped("okamoto2012.toml")),
        header=HEADER.model_copy(update=changed),
        devices=devices,
        rig_file=rig_file,
        dataset=dataset_root,
    )


def heights(root: Path) -> dict[float, int]:
    """Of each recording of the foot, in their order: when it starts, s, and its rows, n/a left out."""
    found = {}
    for path in sorted(root.glob("sub-01/beh/*_physio.tsv.gz"), key=lambda path: (len(path.name), path.name)):
        sidecar = json.loads(path.with_name(path.name.removesuffix(".tsv.gz") + ".json").read_text())
        with gzip.open(path, "rt") as file:
            found[sidecar["StartTime"]] = sum(row.strip() != "n/a" for row in file)
    return found


@pytest.mark.parametrize("drift_ppm", [50.0, 5000.0, -5000.0])
def test_events_stand_where_they_happened_whatever_the_trackers_clock_does(tmp_path: Path, drift_ppm: float) -> None:
    clock = ManualClock(START_NS)
    tracker = Wandering(clock, drift_ppm)
    footer = run(tmp_path, clock, tracker, "c" * TRIALS, TRIALS)
    assert footer == Footer(reason="complete", answered=TRIALS)
    path = storage.journal_path(tmp_path, "01", "real")
    contents = journal.read(path)
    steps = placed_steps(path, contents)
    zero_ns = next(entry.t_ns for entry in contents.entries if isinstance(entry, TrackerOpened))
    landed = [placed for placed in steps if isinstance(placed.step, FootStep)]
    contacts_ns = np.array([placed.at_s for placed in landed]) * 1e9 + zero_ns
    assert np.abs(contacts_ns - tracker.contacts_ns).max() < 0.1e6
    # The frames of a step, those of the broken one included, from arming on.
    raw, frames = storage.foot_path(path).read_bytes(), 0
    for placed in steps:
        trace = placed.step.trace
        _, decoded = Decoder(near_us=int(placed.at_us)).feed(raw[trace.offset : trace.offset + trace.length])
        true_ns = np.array([tracker.true_ns(us) for us in decoded.device_us.tolist()])
        assert np.abs(placed.seconds(decoded.device_us) * 1e9 + zero_ns - true_ns).max() < 0.2e6
        frames += decoded.device_us.size
    assert len(steps) == TRIALS + 1
    # The device's millisecond is not the session's: some places of the grid stay empty, or take two frames.
    write_foot(tmp_path, path, contents, build.raw_frames(path, [one.step for one in steps]), "REHEARSAL")
    (kept,) = heights(tmp_path).values()
    assert frames * (1 - 1.1e-6 * abs(drift_ppm)) - 2 * len(steps) <= kept <= frames


@pytest.mark.parametrize("before_s", [0.0, 86_400.0])
def test_a_wall_clock_that_was_set_back_before_a_session_went_on_overwrites_no_frame(
    tmp_path: Path, before_s: float
) -> None:
    first = ManualClock(START_NS)
    assert run(tmp_path, first, Wandering(first, 0.0), "cccq", 5).reason == "paused"
    path = storage.journal_path(tmp_path, "01", "real")
    opened_ns = next(entry.t_ns for entry in journal.read(path).entries if isinstance(entry, TrackerOpened))
    # To just where the first step was, or a day before.
    second = ManualClock(opened_ns - int(before_s * 1e9))
    assert run(tmp_path, second, Wandering(second, 0.0), "cc", 5).reason == "complete"
    contents = journal.read(path)
    steps = placed_steps(path, contents)
    write_foot(tmp_path, path, contents, build.raw_frames(path, [one.step for one in steps]), "REHEARSAL")
    frames = [placed.step.trace.length // FRAME_BYTES[1] for placed in steps]
    # Four steps were before the pause, two after. Each has a place of its own, and later ones come later.
    assert len(frames) == 6
    assert list(heights(tmp_path).values()) == [sum(frames)]
    at_s = [placed.at_s for placed in steps]
    assert at_s == sorted(at_s)
    (ended_ns,) = (line.t_ns for line in contents.lines if getattr(line.entry, "reason", "") == "paused")
    assert bridging.set_back_ns(contents) == pytest.approx(ended_ns - opened_ns + before_s * 1e9, abs=1e9)


def test_a_pause_is_as_long_as_the_machine_was_on_where_it_can_tell() -> None:
    def ran(up_s: int) -> Exposure:
        return Exposure(dose=None, stimuli=0, vibration_s=0.0, boot="same", up_ns=up_s * 10**9)

    told = [(0, HEADER), (5, ran(100)), (9, Footer(reason="paused", answered=0)), (2, Resumed(torn="", remaining=()))]
    lines = [journal.Line(at_s * 10**9, entry) for at_s, entry in [*told, (3, ran(130))]]
    # The last line is 30 s after the uptime of 100 s, which was at 5 s: at 35 s, and the clock says 3 s.
    shifts = [shift_ns // 10**9 for _, shift_ns in bridging.shifted(journal.Contents(tuple(lines)))]
    assert shifts == [0, 0, 0, 32, 32]
    again = [(36 + 3 - 32, Footer(reason="paused", answered=0)), (8, Resumed(torn="", remaining=()))]
    lines += [journal.Line(at_s * 10**9, entry) for at_s, entry in again]
    assert bridging.set_back_ns(journal.Contents(tuple(lines))) == 32 * 10**9


def test_times_count_from_the_tracker_where_the_clock_was_set_back_before_it_opened(tmp_path: Path) -> None:
    clock = ManualClock(START_NS)
    assert run(tmp_path, clock, Wandering(clock, 0.0), "cc", 2).reason == "complete"
    path = storage.journal_path(tmp_path, "01", "real")
    contents = journal.read(path)
    early = [(0, contents.header), (3600, Footer(reason="paused", answered=0))]
    lines = [journal.Line(START_NS + at_s * 10**9, entry) for at_s, entry in early]
    lines += [journal.Line(contents.lines[0].t_ns, Resumed(torn="", remaining=())), *contents.lines[1:]]
    later = [placed.at_s for placed in placed_steps(path, journal.Contents(tuple(lines)))]
    assert later == pytest.approx([placed.at_s for placed in placed_steps(path, contents)])


def test_a_trace_that_an_earlier_version_cut_in_two_is_one_again(tmp_path: Path) -> None:
    clock = ManualClock(START_NS)
    assert run(tmp_path, clock, Wandering(clock, 0.0), "cc", 2).reason == "complete"
    path = storage.journal_path(tmp_path, "01", "real")
    contents = journal.read(path)
    beh = tmp_path / "sub-01" / "beh"
    beh.mkdir(parents=True, exist_ok=True)
    names = [f"sub-01_task-real_recording-{one}_physio.tsv.gz" for one in ("foot", "foot2", "footpad", "ecg")]
    for name in names[1:]:
        (beh / name).write_bytes(b"")
    parts = build.raw_frames(path, [one.step for one in placed_steps(path, contents)])
    write_foot(tmp_path, path, contents, parts, "REHEARSAL")
    assert {one.name for one in beh.glob("*.gz")} == {names[0], *names[2:]}


def test_a_planar_trace_keeps_the_place_along_the_face_as_a_column(tmp_path: Path) -> None:
    clock, rig_file = ManualClock(START_NS), tmp_path / "planar.toml"
    points = [
        f"[[tracker.along_calibration]]\ncounts = {counts}\nmm = {mm}\n" for counts, mm in ((1000, -5), (2000, 5))
    ]
    rig_file.write_text("\n".join([RIG.read_text("utf-8"), *points]), "utf-8")
    shutil.copy(RIG.with_name("rehearsal-response.csv"), tmp_path)
    root = tmp_path / "dataset"
    assert run(root, clock, Wandering(clock, 0.0, 1725), "cc", 2, rig_file).reason == "complete"
    path = storage.journal_path(root, "01", "real")
    contents = journal.read(path)
    steps = placed_steps(path, contents)
    write_foot(root, path, contents, build.raw_frames(path, [one.step for one in steps]), "REHEARSAL")
    (table,) = root.glob("sub-01/beh/*_physio.tsv.gz")
    sidecar = json.loads(table.with_name(table.name.removesuffix(".tsv.gz") + ".json").read_text())
    assert sidecar["Columns"] == ["foot_height", "foot_along"]
    assert sidecar["foot_along"] == {
        "Description": "Position of the sole along the face, from the calibrated planar tracker.",
        "Units": "mm",
    }
    with gzip.open(table, "rt") as file:
        rows = [row.split() for row in file]
    known = [row for row in rows if row != ["n/a", "n/a"]]
    # 1725 counts are 2.25 mm, and every frame has its row.
    assert {along for _, along in known} == {"2.250"}
    assert len(known) == sum(placed.step.trace.length // FRAME_BYTES[2] for placed in steps)
