"""The driver that the README shows: short, named by a rig file, and good for a step over a real port."""

from __future__ import annotations

import re
import threading
from pathlib import Path

import numpy as np
import pytest

from experiment.apparatus import opening
from experiment.apparatus import rig as rigs
from experiment.apparatus.rig import Rig
from experiment.apparatus.tracker.frames import Decoder, Samples
from experiment.apparatus.tracker.gate import Contact, Gate, GateDetector
from experiment.clock import MonotonicClock
from experiment.errors import RigError, TrackerStopped
from experiment.protocol.files import shipped
from experiment.protocol.models import Step
from experiment.rehearsal.footstep import movement
from experiment.rehearsal.wires.serial_line import SerialLine

SPEED_MM_S = 180.0


@pytest.fixture
def code(repository_root: Path) -> str:
    text = (repository_root / "README.md").read_text("utf-8")
    found = re.search(r"<!-- tracker driver -->\n```python\n(.*?)```", text, re.DOTALL)
    assert found
    return found[1]


def rig(driver: str) -> Rig:
    before = rigs.load(shipped("rigs/rehearsal.toml"))
    return before.model_copy(update={"tracker": before.tracker.model_copy(update={"driver": driver})})


def test_it_is_short(code: str) -> None:
    assert len(code.splitlines()) < 40


def test_it_follows_a_foot(code: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "textline.py").write_text(code, "utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    trajectory = movement.trajectory(np.random.default_rng(1), SPEED_MM_S, hesitation="none")
    times_us = np.arange(0, int(trajectory.lift_us), 1000)
    readings = rigs.load(shipped("rigs/rehearsal.toml")).tracker.counts(trajectory.at(times_us.astype(float)))
    lines = [f"{us},{reading}\n".encode() for us, reading in zip(times_us.tolist(), readings.tolist(), strict=True)]
    with SerialLine() as line:
        tracker = opening.open_tracker(rig("textline:TextTracker"), clock=MonotonicClock(), port=line.url)
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
        with pytest.raises(TrackerStopped, match=r": nothing came within \d+ ms; see to it, then resume"):
            tracker.read()
        tracker.close()


@pytest.mark.parametrize(
    "driver", ["no_such_module:Tracker", "experiment.apparatus.ports:NoSuchTracker", "json:dumps", "io:BytesIO"]
)
def test_a_driver_that_there_is_not_is_refused(driver: str) -> None:
    with pytest.raises(RigError, match=f"tracker.driver: got '{driver}' .*; allowed: palpate-frames, or a class that"):
        opening.open_tracker(rig(driver), clock=MonotonicClock(), port="none")


def test_a_driver_without_a_class_is_refused(tmp_path: Path) -> None:
    text = shipped("rigs/rehearsal.toml").read_text("utf-8").replace("[tracker]", '[tracker]\ndriver = "textline"')
    (tmp_path / "rig.toml").write_text(text, "utf-8")
    with pytest.raises(
        RigError, match=r"tracker.driver: got 'textline'; allowed: palpate-frames, or package.module:Cl"
    ):
        rigs.load(tmp_path / "rig.toml")
