"""How the servo keeps its deadlines: run `python -m tests.benchmarks.servo [SECONDS] [BURNERS]`.

A simulated hand taps, by a tracker of 2,500 frames a second on a serial line, a block of 2,500 N/m and 100 N s/m; the
servo runs in its own process, and the simulated device, in another one, keeps what it pushed. As many processes as
`BURNERS` use the processor meanwhile. Told are the cycles that the servo made, missed and began more than 2 ms late;
how often the device dropped its force; the largest force; the time between two messages, at the device; and what one
cycle's arithmetic costs: a step of the observer, of rendering that touches, and of the record.

Not a test: it asserts nothing, because these figures belong to the machine that printed them.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from math import inf
from pathlib import Path

import numpy as np

from palpate.experiment.apparatus import host
from palpate.experiment.apparatus import rig as rigs
from palpate.experiment.apparatus.rig import tracker_of
from palpate.experiment.apparatus.servo import rendering
from palpate.experiment.apparatus.servo.link import ServoProcess
from palpate.experiment.apparatus.servo.observer import TOLD_KG
from palpate.experiment.apparatus.servo.process import Orders
from palpate.experiment.apparatus.servo.record import ForceRecord
from palpate.experiment.apparatus.servo.rendering import Rendered
from palpate.experiment.apparatus.servo.serving import PUSHED
from palpate.experiment.clock import MonotonicClock
from palpate.experiment.protocol.files import shipped
from palpate.experiment.rehearsal.kinds.tapping import hand
from palpate.experiment.rehearsal.wires.foot import Foot
from palpate.experiment.rehearsal.wires.force_device import ForceDeviceProcess
from palpate.experiment.rehearsal.wires.serial_line import SerialLine
from palpate.experiment.synthesis.contact.block import Block, Pair
from palpate.experiment.synthesis.contact.observer import Observer, Seen
from tests.rig.pressing import rendered
from tests.rig.pushes import pushed

SECONDS = 30.0
RATE_HZ, LIMIT_N = 2500, 3.0
BLOCK = Block((2500.0, 2500.0), (100.0, 100.0), (inf, inf), into=(-1.0, 0.0), nominal_s=1 / RATE_HZ)


def measured(seconds: float) -> None:
    """Tap for so long, and print what came of it."""
    tracker = tracker_of(rigs.load(shipped("rigs/tapping.toml")))
    rng = np.random.default_rng(1)
    with tempfile.TemporaryDirectory() as folder, host.raised() as priority:
        record = Path(folder) / "pushed.bin"
        with ForceDeviceProcess(record) as device, SerialLine() as line:
            foot = Foot(line, tracker, real_time=True, rest_mm=hand.REST_MM, noise_mm=0.001, tick_s=1 / tracker.rate_hz)
            orders = Orders(
                port=line.url,
                baud=tracker.baud,
                tracker_hz=tracker.rate_hz,
                stall_ms=2000,
                counts=tuple(float(point.counts) for point in tracker.calibration),
                mm=tuple(point.mm for point in tracker.calibration),
                address=device.address,
                answer_ms=5000.0,
                limit_n=LIMIT_N,
                rate_hz=RATE_HZ,
                fastest_mm_s=175.0,
                along_counts=tuple(float(point.counts) for point in tracker.along_calibration or ()),
                along_mm=tuple(point.mm for point in tracker.along_calibration or ()),
            )
            servo = ServoProcess(orders, MonotonicClock())
            with rendered(servo, BLOCK):
                ends, touches, next_tap = time.monotonic() + seconds, 0, 0.0
                while time.monotonic() < ends:
                    if time.monotonic() > next_tap:
                        foot.step(hand.tap(rng), 0)
                        next_tap = time.monotonic() + 0.5
                    felt = servo.read()
                    touches += len(felt.touches) if felt is not None else 0
            servo.close()
            foot.close()
        kept = [push for push in pushed(record) if push.why == PUSHED]
    apart_ms = np.diff([push.at_ns for push in kept]) / 1e6
    print(f"priority: {priority}")
    print(f"{seconds:g} s at {RATE_HZ} Hz, {touches} touches: {servo.counts}")
    print(
        f"largest force {max(push.out_n for push in kept):.6f} N of {LIMIT_N} N; above it: "
        f"{sum(np.hypot(push.out_n, push.along_n) > LIMIT_N for push in kept)}"
    )
    print("between messages, ms: " + ", ".join(f"p{p:g} {np.percentile(apart_ms, p):.3f}" for p in (50, 99, 99.9, 100)))


def cost() -> None:
    """Print what the arithmetic of a cycle costs while the hand presses, us: the observer alone, and what is around."""
    observer, record = Observer(1 / RATE_HZ, 5e-6, TOLD_KG), ForceRecord()
    places = [(1.0 - n * 0.04 if n < 50 else -1.0 - 0.1 * float(np.sin(n / 30)), 0.0) for n in range(20_000)]
    at, seen = Rendered(), Seen(0.0, 0.0)
    steps: dict[str, Callable[[int, Pair], object]] = {
        "observer": lambda _, place: observer.step(seen, place, 4e-4, (1.0, 0.0)),
        "rendering, with it": lambda n, place: rendering.step(BLOCK, at, n * 400, place, observer, at.force_n, LIMIT_N),
        "record": lambda n, place: record.add(n, n * 400_000, 1, place, at.force_n, at.force_n),
    }
    took: dict[str, list[int]] = {name: [] for name in steps}
    for n, place in enumerate(places):
        for name, step in steps.items():
            begun = time.perf_counter_ns()
            made = step(n, place)
            took[name].append(time.perf_counter_ns() - begun)
            if isinstance(made, Seen):
                seen = made
            elif isinstance(made, tuple):
                at = made[0]
    for name, each in took.items():
        told = ", ".join(f"p{p:g} {np.percentile(each, p) / 1e3:.2f}" for p in (50, 99, 99.9))
        print(f"a step of a hand that presses, us: {name} {told}")


def main() -> None:
    """Measure."""
    seconds = float(sys.argv[1]) if len(sys.argv) > 1 else SECONDS
    burners = int(sys.argv[2]) if len(sys.argv) > 2 else 0
    burning = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(burners)]
    try:
        cost()
        measured(seconds)
    finally:
        for one in burning:
            one.kill()
            one.wait()


if __name__ == "__main__":
    main()
