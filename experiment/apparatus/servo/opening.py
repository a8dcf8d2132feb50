"""Opens the force device of a rig, and its tracker with it."""

import os
from importlib import import_module
from typing import cast

from palpate.experiment.apparatus.opening import open_tracker, simulated_only
from palpate.experiment.apparatus.rig import REHEARSAL, Rig, needed, tracker_of
from palpate.experiment.apparatus.servo.link import Servo, ServoHere, ServoProcess
from palpate.experiment.apparatus.servo.passivity import follower
from palpate.experiment.apparatus.servo.process import Orders
from palpate.experiment.apparatus.servo.settings import ServoRig
from palpate.experiment.apparatus.tracker.clock_map import ClockMap
from palpate.experiment.apparatus.tracker.settings import FRAMES
from palpate.experiment.clock import Clock
from palpate.experiment.errors import RigError, ServoError
from palpate.experiment.protocol.kinds.tapping import Tapping


def servo_of(rig: Rig) -> ServoRig:
    """Return the force device of a rig for virtual surfaces; `RigError` if it has none."""
    remedy = "add driver, address, full_scale_n, damping_n_s_m, delay_ms and answer_ms to the rig file"
    return needed(rig, "servo", rig.servo, remedy, "because virtual surfaces need it")


def refuse_system() -> None:
    """Raise `ServoError` where no process can be given a socket and memory that are open, as on Windows."""
    if os.name != "posix":
        raise ServoError(
            "palpate renders virtual surfaces to a hand only on Linux and macOS; no device was opened",
            remedy="run the session on Linux or macOS; rehearsals also work here",
        )


def open_servo(
    rig: Rig,
    virtual: Tapping,
    *,
    limit_n: float,
    clock: Clock,
    port: str | None = None,
    address: str | None = None,
    clock_map: ClockMap | None = None,
) -> Servo:
    """Open the rig's tracker and force device together: in a process of their own, unless time is simulated.

    Forces go out at the rate of `virtual`, up to `limit_n`; a lamp is lit above its fastest speed. Other arguments are
    as in `opening.open_tracker`. Raises `RigError` without a force device, or for a simulated one, and `ServoError`.
    """
    device, tracker = servo_of(rig), tracker_of(rig)
    where, hand = address or device.address, port or tracker.port
    if REHEARSAL in (where, hand):
        raise RigError.at(simulated_only(rig, "tracker.port" if hand == REHEARSAL else "servo.address"))
    if not clock.simulated and tracker.driver != FRAMES:
        remedy = "make the device send palpate's frames: palpate docs rigs"
        raise RigError(
            f"rig '{rig.rig.name}'", f"got '{tracker.driver}'", remedy, allowed=FRAMES, field="tracker.driver"
        )
    along, observer = tracker.along_calibration or (), follower(virtual, device, tracker)
    orders = Orders(
        port=hand,
        baud=tracker.baud,
        tracker_hz=tracker.rate_hz,
        stall_ms=tracker.stall_ms,
        counts=tuple(float(point.counts) for point in tracker.calibration),
        mm=tuple(point.mm for point in tracker.calibration),
        along_counts=tuple(float(point.counts) for point in along),
        along_mm=tuple(point.mm for point in along),
        address=where,
        answer_ms=device.answer_ms,
        limit_n=limit_n,
        rate_hz=virtual.rate_hz,
        fastest_mm_s=virtual.fastest_mm_s,
        noise_m=observer.noise_m if observer is not None else 0.0,
        told_kg=observer.mass_kg if observer is not None else 0.0,
    )
    if address is None and ":" in device.driver:
        own = import_module("palpate.experiment.apparatus.wires.own.force")
        return cast("Servo", own.DriverServo(rig, orders, clock))
    if not clock.simulated:
        return ServoProcess(orders, clock)
    return ServoHere(orders, open_tracker(rig, clock=clock, port=port, clock_map=clock_map))
