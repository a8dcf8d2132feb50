"""A hand above its tracker, in a process of its own: it says where its line is, and presses once it is asked to."""

from __future__ import annotations

import sys

import numpy as np

from palpate.experiment.apparatus import host
from palpate.experiment.apparatus import rig as rigs
from palpate.experiment.apparatus.rig import tracker_of
from palpate.experiment.protocol.files import shipped
from palpate.experiment.rehearsal.wires.foot import Foot, Trajectory
from palpate.experiment.rehearsal.wires.serial_line import SerialLine

HAND = tracker_of(rigs.load(shipped("rigs/tapping.toml")))

PRESSES = 50


def press(lasts_s: float = 0.5, above_mm: float = 5.0) -> Trajectory:
    """A hand that comes down at 100 mm/s, and presses 1.5 mm into the block for so long; again and again.

    A machine that stalls may have a press felt by nobody.
    """
    touch_s = above_mm / 100.0
    turns_s = touch_s + np.array([-touch_s, 0.0, 0.015, 0.015 + lasts_s, 0.05 + lasts_s])
    time_s = np.concatenate([n * (touch_s + lasts_s + 0.15) + turns_s for n in range(PRESSES)])
    height_mm = np.tile([above_mm, 0.0, -1.5, -1.5, above_mm], PRESSES)
    return Trajectory(time_s * 1e6, height_mm, 0.0, 0.0, 5e4, float(time_s[-1]) * 1e6, 100.0, "none", 1)


def main() -> None:
    """Press for the seconds of the first argument, again and again, from the first line of the input to its end."""
    with host.raised(), SerialLine() as line:
        foot = Foot(line, HAND, real_time=True, rest_mm=5.0, noise_mm=0.0, tick_s=1 / HAND.rate_hz)
        sys.stdout.write(f"{line.url}\n")
        sys.stdout.flush()
        sys.stdin.readline()
        foot.step(press(float(sys.argv[1])), 0)
        sys.stdin.read()
        foot.close()


if __name__ == "__main__":
    main()
