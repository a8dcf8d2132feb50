"""The driver that the guide to devices shows: short, named by a rig file, and good for a step over a real port."""

from __future__ import annotations

import re
import shutil
import sys
import threading
from pathlib import Path

import numpy as np
import pytest

from palpate.experiment.apparatus import opening
from palpate.experiment.apparatus import rig as rigs
from palpate.experiment.apparatus.rig import Rig, tracker_of
from palpate.experiment.apparatus.tracker.frames import Decoder, Samples
from palpate.experiment.apparatus.tracker.gate import Contact, Gate, GateDetector
from palpate.experiment.clock import MonotonicClock
from palpate.experiment.errors import RigError, TrackerStopped
from palpate.experiment.protocol.files import shipped
from palpate.experiment.protocol.models import Step
from palpate.experiment.rehearsal.wires import foot
from palpate.experiment.rehearsal.wires.serial_line import SerialLine
from tests.approved import Refuses

pytestmark = pytest.mark.clocked

SPEED_MM_S = 180.0


@pytest.fixture
def code(repository_root: Path) -> str:
    text = (repository_root / "palpate" / "guide" / "devices.md").read_text("utf-8")
    found = re.search(r"<!-- tracker driver -->\n```python\n(.*?)```", text, re.DOTALL)
    assert found
    return found[1]


def rig_file(folder: Path, driver: str) -> Path:
    """A rig file that names a driver, with the response table beside it."""
    shutil.copy(shipped("rigs/rehearsal-response.csv"), folder)
    text = shipped("rigs/rehearsal.toml").read_text("utf-8").replace("[tracker]", f'[tracker]\ndriver = "{driver}"')
    (folder / "rig.toml").write_text(text, "utf-8")
    return folder / "rig.toml"


def test_it_is_short(code: str) -> None:
    assert len(code.splitlines()) < 40


def test_it_follows_a_foot(code: str, tmp_path: Path, refuses: Refuses) -> None:
    (tmp_path / "textline.py").write_text(code, "utf-8")
    rig = rigs.load(rig_file(tmp_path, "textline:TextTracker"))
    trajectory = foot.trajectory(np.random.default_rng(1), SPEED_MM_S, hesitation="none")
    times_us = np.arange(0, int(trajectory.lift_us), 1000)
    readings = tracker_of(rigs.load(shipped("rigs/rehearsal.toml"))).counts(trajectory.at(times_us.astype(float)))
    lines = [f"{us},{reading}\n".encode() for us, reading in zip(times_us.tolist(), readings.tolist(), strict=True)]
    with SerialLine() as line:
        tracker = opening.open_tracker(rig, clock=MonotonicClock(), port=line.url)
        assert tracker.clock_map is None
        writer = threading.Thread(target=line.write, args=(b"".join(lines),))
        writer.start()
        detector = GateDetector(Step(gate_top_mm=20.0, gate_bottom_mm=10.0, contact_mm=0.0))
        state, read, seen = detector.init(), list[Samples](), list[Gate | Contact]()
        while not seen or not isinstance(seen[-1], Contact):
            read.append(tracker.read())
            state, events = detector.step(state, read[-1])
            seen += events
        writer.join()
        gate, contact = seen[-2:]
        assert isinstance(gate, Gate)
        assert isinstance(contact, Contact)
        assert gate.speed_mm_s == pytest.approx(SPEED_MM_S, rel=0.02)
        assert contact.us == pytest.approx(trajectory.contact_us, abs=1000)
        assert tracker.clock_map is not None
        assert tracker.clock_map.session_ns(int(read[-1].device_us[-1])) <= read[-1].arrived_ns
        _, again = Decoder().feed(b"".join(samples.raw for samples in read))
        assert again.device_us.tolist() == [int(samples.device_us[0]) for samples in read]
        assert tracker.counts.received == len(read)
        tracker.drain()
        with refuses(TrackerStopped):
            tracker.read()
        tracker.close()


@pytest.mark.parametrize(
    "driver", ["no_such_module:Tracker", "palpate.experiment.apparatus.ports:NoSuchTracker", "json:dumps", "io:BytesIO"]
)
def test_a_driver_that_there_is_not_is_refused(driver: str, tmp_path: Path, refuses: Refuses) -> None:
    rig = rigs.load(rig_file(tmp_path, driver))
    with refuses(RigError):
        opening.open_tracker(rig, clock=MonotonicClock(), port="none")


def test_a_driver_without_a_class_is_refused(tmp_path: Path, refuses: Refuses) -> None:
    with refuses(RigError):
        rigs.load(rig_file(tmp_path, "textline"))


def named(rig: Rig) -> object:
    """What the driver beside a rig file calls itself."""
    tracker = opening.open_tracker(rig, clock=MonotonicClock(), port="none")
    return tracker.counts.received


NUMBERED = """
from dataclasses import dataclass
from palpate.experiment.apparatus import LinkCounts

@dataclass
class Parts:
    name: "str" = ""

class Tracker:
    clock_map = None
    def __init__(self, port, settings, *, clock, clock_map): self.counts = LinkCounts(received=NUMBER)
    def drain(self): pass
    def read(self): pass
    def reconnect(self, timeout_s): pass
    def close(self): pass
"""


@pytest.mark.parametrize("module", ["lab_tracker", "json", "numpy"])
def test_the_driver_beside_the_rig_file_wins_and_no_other_module_is_hidden(
    module: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each rig has the driver beside it, whatever else has that name, on the path or imported before."""
    monkeypatch.syspath_prepend(tmp_path)
    folders = [tmp_path, tmp_path / "one", tmp_path / "two"]
    loaded = []
    for number, folder in enumerate(folders):
        folder.mkdir(exist_ok=True)
        (folder / f"{module}.py").write_text(
            "from __future__ import annotations\n" + NUMBERED.replace("NUMBER", f"{number}")
        )
        loaded.append(rigs.load(rig_file(folder, f"{module}:Tracker")))
    before = sys.modules.get(module)
    assert [named(rig) for rig in (*loaded, *loaded)] == [0, 1, 2, 0, 1, 2]
    assert sys.modules.get(module) is before
    # A driver that was mended is read anew.
    (tmp_path / "one" / f"{module}.py").write_text(NUMBERED.replace("NUMBER", "7"))
    assert [named(rig) for rig in loaded] == [0, 7, 2]


def test_the_driver_is_copied_with_its_rig_and_never_over_another(tmp_path: Path, refuses: Refuses) -> None:
    (tmp_path / "lab_tracker.py").write_text(NUMBERED.replace("NUMBER", "1"))
    file = rig_file(tmp_path, "lab_tracker:Tracker")
    copy = tmp_path / "dataset" / "sourcedata" / "rig.toml"
    opening.copy_rig(file, copy)
    (tmp_path / "lab_tracker.py").write_text(NUMBERED.replace("NUMBER", "2"))
    assert (named(rigs.load(file)), named(rigs.load(copy))) == (2, 1)
    with refuses(RigError):
        opening.copy_rig(file, copy)
    assert named(rigs.load(copy)) == 1


def test_another_content_of_the_driver_is_another_rig(tmp_path: Path) -> None:
    driver = tmp_path / "lab_tracker.py"
    driver.write_text(NUMBERED.replace("NUMBER", "1"))
    file = rig_file(tmp_path, "lab_tracker:Tracker")
    digest = rigs.sha256(rigs.load(file))
    opening.copy_rig(file, copy := tmp_path / "dataset" / "rig.toml")
    assert rigs.session_rig(copy, digest).driver_files == (copy.with_name("lab_tracker.py"),)
    for spoil in (lambda: driver.write_text(NUMBERED.replace("NUMBER", "2")), driver.unlink):
        spoil()
        with pytest.raises(RigError, match=r"is not the rig file"):
            rigs.session_rig(file, digest)


def test_what_fails_while_it_is_imported_is_told_and_tried_again(tmp_path: Path) -> None:
    (tmp_path / "lab_tracker.py").write_text("1 / 0\n")
    rig = rigs.load(rig_file(tmp_path, "lab_tracker:Tracker"))
    for _ in range(2):
        with pytest.raises(
            RigError, match=r"got 'lab_tracker:Tracker' \(ZeroDivisionError: division by zero\); allowed"
        ):
            opening.open_tracker(rig, clock=MonotonicClock(), port="none")
