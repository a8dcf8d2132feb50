"""A hand that presses and slides, on a pseudo-terminal, and the force along the face that the SIMULATED device got.

A machine that others use stalls a servo now and then, and the hand is pushed again from its next touch on: so it
presses again and again, until the device has seen what a press in peace looks like.
"""

from __future__ import annotations

import time
from dataclasses import replace
from math import hypot, inf, sqrt
from pathlib import Path

import numpy as np
import pytest

from palpate.experiment.apparatus import host
from palpate.experiment.apparatus.servo.link import ServoProcess
from palpate.experiment.apparatus.servo.serving import PUSHED
from palpate.experiment.clock import MonotonicClock
from palpate.experiment.rehearsal.wires.foot import Foot, Trajectory
from palpate.experiment.rehearsal.wires.force_device import ForceDeviceProcess
from palpate.experiment.rehearsal.wires.serial_line import SerialLine
from palpate.experiment.synthesis.contact.block import Block
from tests.rig.falling import HAND
from tests.rig.pressing import rendered
from tests.rig.pushes import Push, pushed
from tests.rig.test_servo import ordered

pytestmark = pytest.mark.alone

K_N_M, C_N_S_M = (800.0, 400.0), (5.0, 20.0)
DEEP_MM, SLIDES_MM, SLIDES_S = 1.5, 1.2, 0.06
LASTS_S, PRESSES, LOOKS_S = 0.25, 120, 0.3

ALONG_N = -K_N_M[1] * SLIDES_MM * 1e-3
"""What the spring along the face does at the end of the slide, -K y."""

OUT_N = K_N_M[0] * DEEP_MM * 1e-3


def pressing_and_sliding() -> Trajectory:
    """It comes down at 100 mm/s, slides 1.2 mm at 20 mm/s, stays for 40 ms, and goes back where it came from."""
    turns_s = np.array([0.0, 0.05, 0.065, 0.065 + SLIDES_S, 0.165, 0.2])
    time_s = np.concatenate([n * LASTS_S + turns_s for n in range(PRESSES)])
    height_mm = np.tile([5.0, 0.0, -DEEP_MM, -DEEP_MM, -DEEP_MM, 5.0], PRESSES)
    along_mm = np.tile([0.0, 0.0, 0.0, SLIDES_MM, SLIDES_MM, 0.0], PRESSES)
    return Trajectory(time_s * 1e6, height_mm, 0.0, 0.0, 5e4, float(time_s[-1]) * 1e6, 100.0, "none", 1, along_mm)


def rests(push: Push, out_n: float, along_n: float) -> bool:
    """Whether it is what a hand at rest at the end of the slide feels; a count is 1 um, 0.8 mN."""
    return abs(push.out_n - out_n) < 2e-3 and abs(push.along_n - along_n) < 2e-3


def pushed_by(limit_n: float, wanted: tuple[float, float], record: Path) -> list[Push]:
    """Return what the device was given, until a hand at rest at the end of the slide felt what is wanted."""
    with host.raised(), ForceDeviceProcess(record) as device, SerialLine() as line:
        foot = Foot(line, HAND, real_time=True, rest_mm=5.0, noise_mm=0.0, tick_s=1 / HAND.rate_hz)
        servo = ServoProcess(replace(ordered(line, device), limit_n=limit_n), MonotonicClock())
        with rendered(servo, Block(K_N_M, C_N_S_M, (inf, inf), into=(-1.0, 0.0))):
            foot.step(pressing_and_sliding(), 0)
            looked_s, found = time.monotonic(), False
            ends_s = looked_s + PRESSES * LASTS_S
            while looked_s < ends_s and not found:
                servo.read()
                if time.monotonic() > looked_s + LOOKS_S:
                    looked_s = time.monotonic()
                    # 20 ms, in cycles.
                    found = sum(rests(push, *wanted) for push in pushed(record)) >= 50
        servo.close()
        foot.close()
    assert found, "never in peace"
    return [push for push in pushed(record) if push.why == PUSHED]


def test_the_block_pushes_back_along_its_face(tmp_path: Path) -> None:
    assert HAND.readings == 2
    pushes = pushed_by(3.0, (OUT_N, ALONG_N), tmp_path / "pushed.bin")
    # The damper adds -C dy/dt, at 20 mm/s, while it slides; the spring is nearly at its end then.
    most_n = -ALONG_N + C_N_S_M[1] * SLIDES_MM * 1e-3 / SLIDES_S
    assert max(-push.along_n for push in pushes) <= most_n + 0.1
    sliding = [push for push in pushes if abs(-push.along_n - most_n) < 0.02]
    assert sliding, "no damper along"
    assert not any(push.along_n for push in pushes if not push.out_n)


def test_the_limit_holds_for_both_directions_together(tmp_path: Path) -> None:
    """What pushes out comes first, and the face gets what is left of it."""
    limit_n = 1.25
    assert OUT_N < limit_n < hypot(OUT_N, ALONG_N)
    pushes = pushed_by(limit_n, (OUT_N, -sqrt(limit_n**2 - OUT_N**2)), tmp_path / "pushed.bin")
    assert max(hypot(push.out_n, push.along_n) for push in pushes) <= limit_n
