"""A force device behind a lab's own driver, in a process that speaks palpate's force messages to the servo.

So the driver need not watch for a servo that is silent, stops or dies: 2 ms later its process pushes with nothing. That
process itself may die, or be ended because a push hangs: only a device that drops its force by itself, and the
emergency stop, help then.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import Protocol

from palpate.experiment.apparatus.rig import Rig
from palpate.experiment.apparatus.servo.link import ServoProcess
from palpate.experiment.apparatus.servo.opening import servo_of
from palpate.experiment.apparatus.servo.process import Orders
from palpate.experiment.apparatus.servo.rendering import Felt
from palpate.experiment.apparatus.wires.own.hosting import DriverProcess
from palpate.experiment.clock import Clock
from palpate.experiment.errors import ServoError


class Force(Protocol):
    """What a lab's driver does, which is made with its table of the rig, and pushes with nothing at first."""

    def push(self, out_n: float, along_n: float, fast: bool) -> None:
        """Push with a force from now on, N, out of the block and along its face; light the lamp if `fast`.

        Called at the servo's rate: return within a part of its period.
        """

    def close(self) -> None:
        """Push with nothing, and let go of the device."""


@contextmanager
def served(rig: Rig) -> Iterator[tuple[str, str]]:
    """Yield where the force device of a rig is served meanwhile: address, and secret to show. Raises `ServoError`."""
    driver = _started(rig)
    try:
        yield _place(driver)
    finally:
        driver.close()


def _started(rig: Rig) -> DriverProcess:
    return DriverProcess(rig, "servo", servo_of(rig), refused=ServoError, hear=lambda *_: None)


def _place(driver: DriverProcess) -> tuple[str, str]:
    told = driver.opened or {}
    return f"127.0.0.1:{told['port']}", told["secret"]


def _placed(orders: Orders, driver: DriverProcess) -> Orders:
    address, secret = _place(driver)
    return replace(orders, address=address, secret=secret)


class DriverServo(ServoProcess):
    """Implements `Servo` with a device behind a driver of one's own."""

    def __init__(self, rig: Rig, orders: Orders, clock: Clock) -> None:
        """Open the device, then as `ServoProcess`. Raises `ServoError`."""
        self._rig, self._driver, self._blames = rig, _started(rig), True
        try:
            super().__init__(_placed(orders, self._driver), clock)
        except BaseException:
            self._driver.close()
            raise

    def read(self) -> Felt | None:
        """Return what the hand did; see `ServoProcess.read`, but an error is the driver's where it failed.

        After any error the driver is ended, so that none that hangs goes on pushing until somebody resumes.
        """
        try:
            return super().read()
        except ServoError as error:
            if not self._blames:
                raise
            self._blames = False
            with self._driver.changed:
                # It is heard of soon after the servo that it left.
                self._driver.changed.wait_for(lambda: self._driver.fault, SOON_S)
            failed = self._driver.error() if self._driver.fault else None
            self._driver.close()
            raise failed or error from error

    def reconnect(self) -> None:
        self.close()
        self._driver, self._blames = _started(self._rig), True
        self._orders = _placed(self._orders, self._driver)
        self._begin()

    def close(self) -> None:
        """End the servo, which takes the force away, then the driver."""
        self._blames = False
        try:
            super().close()
        finally:
            self._driver.close()


SOON_S = 0.2
"""A driver that failed says so within this time after its servo, s; ours."""
