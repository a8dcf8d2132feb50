"""The servo in simulated time, in the session's own process: it pushes what it renders, and stops under a reader."""

from __future__ import annotations

import os
import socket
import threading
from math import inf
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest

from palpate.experiment.apparatus.ports import Tracker
from palpate.experiment.apparatus.servo import link
from palpate.experiment.apparatus.servo.link import ServoHere, ServoProcess
from palpate.experiment.apparatus.servo.process import SAMPLES, TOUCH, TOUCHED, Line, Orders
from palpate.experiment.apparatus.servo.rendering import FALLS_NS, Touch
from palpate.experiment.apparatus.servo.serving import PUSHED
from palpate.experiment.apparatus.tracker.clock_map import ClockMap
from palpate.experiment.apparatus.tracker.frames import Samples, encode
from palpate.experiment.clock import MonotonicClock
from palpate.experiment.errors import TrackerStopped
from palpate.experiment.rehearsal.wires.force_device import ForceDeviceProcess
from palpate.experiment.synthesis.contact.block import Block
from tests.rig.pushes import pushed


class RestingHand:
    """What of `Tracker` the servo uses: a hand that rests, so that a read waits until the tracker is closed."""

    def __init__(self) -> None:
        self.waits, self.closed = threading.Event(), threading.Event()

    def read(self) -> None:
        self.waits.set()
        assert self.closed.wait(60.0), "nobody closed the tracker"
        raise TrackerStopped("it was closed")

    def close(self) -> None:
        self.closed.set()


class SlidingHand:
    """What of `Tracker` the servo uses: a hand that came down to 1 mm inside, and then slid by 2 mm, in one read."""

    clock_map = ClockMap(anchor_us=0, anchor_ns=0)

    def __init__(self, *, planar: bool) -> None:
        height_mm = np.concatenate([np.linspace(2.0, -1.0, 76), np.full(100, -1.0)])
        along_mm = np.concatenate([np.zeros(76), np.linspace(0.02, 2.0, 100)])
        us = 400 * np.arange(height_mm.size)
        self._read = Samples(us, height_mm, b"", us, 0, along_mm if planar else None)

    def read(self) -> Samples:
        return self._read

    def close(self) -> None:
        """There is nothing to close."""


@pytest.mark.parametrize("planar", [True, False])
def test_a_planar_hand_is_pushed_along_the_face_too(tmp_path: Path, planar: bool) -> None:
    record = tmp_path / "pushed.bin"
    with ForceDeviceProcess(record) as device:
        orders = Orders("", 1, 2500, 2000, (0.0, 1.0), (0.0, 1.0), device.address, 100.0, 3.0, 2500, 175.0)
        servo = ServoHere(orders, cast("Tracker", SlidingHand(planar=planar)))
        servo.render(Block((800.0, 500.0), (5.0, 3.0), (inf, inf), into=(-1.0, 0.0)), 10**9)
        assert servo.read() is not None
        servo.close()
    last = [push for push in pushed(record) if push.why == PUSHED and push.out_n > 0][-1]
    # -K y - C dy/dt, with 2 mm at 50 mm/s; out of the block K r alone, for the hand goes no deeper.
    along_n = -500.0 * 2e-3 - 3.0 * 0.05 if planar else 0.0
    assert (last.out_n, last.along_n) == pytest.approx((0.8, along_n), rel=1e-5)


def test_the_force_falls_at_the_end_of_a_simulated_session(tmp_path: Path) -> None:
    """The hand is inside from 50 ms on, and the session ends at 50 ms of its time; 20 ms later the hand is read."""
    record = tmp_path / "pushed.bin"
    with ForceDeviceProcess(record) as device:
        orders = Orders("", 1, 2500, 2000, (0.0, 1.0), (0.0, 1.0), device.address, 100.0, 3.0, 2500, 175.0)
        servo = ServoHere(orders, cast("Tracker", SlidingHand(planar=False)))
        servo.render(Block((800.0, 500.0), (0.0, 0.0), (inf, inf), into=(-1.0, 0.0)), 35_000_000)
        assert servo.read() is not None
        servo.close()
    forces = [push.out_n for push in pushed(record) if push.why == PUSHED]
    # 1 mm inside, 5 ms before the force is gone; it stood at 0.8 N.
    assert forces[-1] == 0.0
    assert forces[-3] == pytest.approx(0.8 * (1 - (69_600_000 - 35_000_000) / FALLS_NS), abs=1e-6)


def test_a_servo_that_is_stopped_ends_the_read_that_waits_for_the_hand() -> None:
    hand, felt = RestingHand(), []
    with ForceDeviceProcess() as device:
        orders = Orders("", 1, 2500, 2000, (0.0, 1.0), (0.0, 1.0), device.address, 100.0, 3.0, 2500, 175.0)
        servo = ServoHere(orders, cast("Tracker", hand))
        reader = threading.Thread(target=lambda: felt.append(servo.read()))
        reader.start()
        hand.waits.wait()
        servo.stop()
        reader.join()
        servo.close()
    assert felt == [None]


class SpeakingProcess:
    """What of `Popen` the servo uses, and the far end of its line."""

    returncode = None

    def __init__(self, _command: list[str], *, pass_fds: tuple[int, ...], **_how: Any) -> None:
        self.line, self.sent = Line(socket.socket(fileno=os.dup(pass_fds[0]))), 0
        self.sample()

    def sample(self) -> None:
        self.line.tell(SAMPLES, b"\0" + encode(self.sent, self.sent * 400, 1), 0)
        self.sent += 1

    def wait(self, _timeout_s: float) -> None:
        """It has ended."""


def test_a_touch_that_comes_without_a_sample_is_given_with_the_next(monkeypatch: pytest.MonkeyPatch) -> None:
    """The session reads between a sample and its touch, and again before the tracker sends more."""
    monkeypatch.setattr("subprocess.Popen", SpeakingProcess)
    monkeypatch.setattr(link, "ANSWERS_MS", 0.0)
    orders = Orders("", 1, 2500, 2000, (0.0, 1.0), (0.0, 1.0), "", 100.0, 3.0, 2500, 175.0)
    servo, touch = ServoProcess(orders, MonotonicClock()), Touch(300.0, 110.0, 110.0)
    speaks = cast("SpeakingProcess", servo._process)
    first = servo.read()
    speaks.line.tell(TOUCH, TOUCHED.pack(*touch), 0)
    alone = servo.read()
    felt = []
    for _ in range(2):
        speaks.sample()
        felt.append(servo.read())
    speaks.line.close()
    servo.close()
    assert (first and first.touches, alone) == ((), None)
    assert [one and one.touches for one in felt] == [(touch,), ()]
