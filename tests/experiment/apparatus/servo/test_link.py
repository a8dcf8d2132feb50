"""The servo in simulated time, in the session's own process: it pushes what it renders, and stops under a reader."""

from __future__ import annotations

import threading
from typing import cast

from experiment.apparatus.ports import Tracker
from experiment.apparatus.servo.link import ServoHere
from experiment.apparatus.servo.process import Orders
from experiment.errors import TrackerStopped
from experiment.rehearsal.wires.force_device import ForceDeviceProcess


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
