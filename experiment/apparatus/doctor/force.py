"""Checks of the force device, with nobody's hand in it, without force: its answers, the limit, the protocol's block."""

from collections.abc import Iterator
from contextlib import ExitStack, closing
from importlib import import_module

import numpy as np
from numpy.typing import NDArray

from palpate.experiment.apparatus.doctor.checks import judged, passed, refused, unchecked
from palpate.experiment.apparatus.rig import Rig, tracker_of
from palpate.experiment.apparatus.servo import budget, passivity
from palpate.experiment.apparatus.servo.device import ForceDevice
from palpate.experiment.apparatus.servo.opening import servo_of
from palpate.experiment.apparatus.servo.rendering import NO_FORCE
from palpate.experiment.apparatus.servo.settings import ServoRig
from palpate.experiment.clock import Clock
from palpate.experiment.errors import Finding, PalpateError, RigError
from palpate.experiment.protocol.kinds.tapping import rendered
from palpate.experiment.protocol.models import Protocol

ASKS_S = 1.0
"""How long the device is asked, s."""

MISSED_PART = 0.01
"""Part of the cycles that may be missed; each of them holds the force before for one more. Ours."""


def checks(rig: Rig, address: str | None, *, protocol: Protocol | None, clock: Clock) -> Iterator[Finding]:
    """Yield everything that a rig's device shows, at an `address` of its own or the rig's; the clock goes by itself.

    A rig without one is red for a virtual task. Without such a protocol the device is asked at the tracker's rate.
    """
    virtual = rendered(protocol) if protocol is not None else None
    try:
        device = rig.servo if virtual is None else servo_of(rig)
    except RigError as error:
        yield refused("virtual surfaces", error)
        return
    if device is None:
        return
    rate_hz = tracker_of(rig).rate_hz if virtual is None else virtual.rate_hz
    where = address or device.address
    try:
        with ExitStack() as opened:
            served = where, ""
            if address is None and ":" in device.driver:
                own = import_module("palpate.experiment.apparatus.wires.own.force")
                served = opened.enter_context(own.served(rig))
            line = opened.enter_context(closing(ForceDevice(served[0], limit_n=0.0, secret=served[1])))
            yield passed("force device", f"{where} accepts a connection; no force was sent")
            yield from answers(_measure_waits(line, device, rate_hz, clock), device, rate_hz=rate_hz)
    except PalpateError as error:
        yield refused("force device", error)
    if protocol is None or virtual is None:
        yield unchecked("force limit", "no protocol with a virtual task was given", "add --protocol")
        return
    limit_n = min(protocol.exposure.force_peak_n or 0.0, device.full_scale_n)
    yield passed(
        "force limit", f"palpate sends at most {limit_n:g} N; the device can produce {device.full_scale_n:g} N"
    )
    fits, why = passivity.judged(virtual, device, tracker_of(rig))
    right, felt = budget.judged(virtual, device, tracker_of(rig), limit_n=limit_n)
    most = virtual.force_error_max
    allowed = "any error, because the protocol does not set a limit" if most is None else f"up to {100 * most:.6g} %"
    remedy = "use a sensor with less noise, or a block with less damping"
    yield judged("force felt", right, felt, allowed=allowed, remedy=remedy)
    yield judged("block", fits, why, allowed="passive", remedy="use a softer block, or a device with more damping")


def answers(waited_ms: NDArray[np.float64], device: ServoRig, *, rate_hz: int) -> tuple[Finding, ...]:
    """Return whether a device answers in time and often enough: `waited_ms`, shape (n,), of the cycles of `ASKS_S`."""
    due, made = round(rate_hz * ASKS_S), waited_ms.size
    median, worst = (float(np.median(waited_ms)), float(waited_ms.max())) if made else (np.inf, np.inf)
    return (
        judged(
            "force answers",
            worst <= device.answer_ms,
            f"{median:.3f} ms (median), {worst:.3f} ms (latest of {made})",
            allowed=f"up to servo.answer_ms, {device.answer_ms:g} ms",
            remedy="close other programs, use a faster connection to the device, or ask its maker for faster firmware",
        ),
        judged(
            "force rate",
            made >= due * (1 - MISSED_PART),
            f"the device answered {made / ASKS_S:.0f} messages per second",
            allowed=f"{rate_hz} per second, minus {100 * MISSED_PART:g} %",
            remedy="if the answers are in time, close other programs; otherwise use a faster connection to the device "
            "or a lower tapping.rate_hz",
        ),
    )


def _measure_waits(line: ForceDevice, device: ServoRig, rate_hz: int, clock: Clock) -> NDArray[np.float64]:
    """Send no force in each cycle, and wait for its answer; return how long each took, ms, until one comes too late."""
    begun_ns, period_ns = clock.now_ns(), round(1e9 / rate_hz)
    waited_ms: list[float] = []
    while (now_ns := clock.now_ns()) - begun_ns < ASKS_S * 1e9:
        line.push(NO_FORCE, fast=False, now_ns=now_ns)
        while line.late_ns(clock.now_ns()) and clock.now_ns() - now_ns <= device.answer_ms * 1e6:
            pass
        waited_ms.append((clock.now_ns() - now_ns) / 1e6)
        if waited_ms[-1] > device.answer_ms:
            break
        # To the next cycle that is due; those that passed meanwhile are missed.
        passed_ns = clock.now_ns() - begun_ns
        clock.sleep_ns(period_ns - passed_ns % period_ns)
    return np.array(waited_ms)
