"""A session that only has a servo push the hand, in a process of its own: it says when the hand presses, or why not.

It may run on every core, whatever core its parent keeps to: a servo beside it there would leave it no time.
"""

from __future__ import annotations

import json
import os
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from math import inf
from typing import Any

import numpy as np

from palpate.experiment.apparatus import host
from palpate.experiment.apparatus.servo.link import ServoProcess
from palpate.experiment.apparatus.servo.process import HEARTBEAT_NS, Orders
from palpate.experiment.clock import MonotonicClock, monotonic_ns
from palpate.experiment.errors import ServoError
from palpate.experiment.synthesis.contact.block import Block

PRESSED_FRAMES = 25
"""So many frames after the touch the hand surely presses."""

BEAT_S, LASTS_NS = 0.1, 600 * 10**9

HELD_UP = "held up\n"
"""What it says where the machine, and no fault, kept a heartbeat back for so long that the servo gave up."""


@contextmanager
def rendered(servo: ServoProcess, block: Block) -> Iterator[Callable[[], bool]]:
    """Have a block there for a session of ten minutes that is alive. Yields what says whether a heartbeat was late."""
    ended = threading.Event()
    beaten_ns = [monotonic_ns()]

    def beat() -> None:
        while not ended.wait(BEAT_S):
            beaten_ns.append(monotonic_ns())
            servo.beat()

    def was_late() -> bool:
        # A heartbeat that failed ended its thread, and is no fault of the machine.
        gaps_ns = np.diff([*beaten_ns, monotonic_ns()] if beats.is_alive() else beaten_ns)
        return bool(gaps_ns.max(initial=0) > HEARTBEAT_NS)

    servo.render(block, MonotonicClock().now_ns() + LASTS_NS)
    servo.beat()
    beats = threading.Thread(target=beat)
    beats.start()
    try:
        yield was_late
    finally:
        ended.set()
        beats.join()


def main() -> None:
    """Open the servo of the orders in the argument, say its process number, and when the hand presses."""
    given: dict[str, Any] = json.loads(sys.argv[1])
    told: dict[str, Any] = {key: tuple(value) if isinstance(value, list) else value for key, value in given.items()}
    os.sched_setaffinity(0, range(os.cpu_count() or 1))
    servo = ServoProcess(Orders(**told), MonotonicClock())
    block = Block((800.0, 800.0), (5.0, 5.0), (inf, inf), into=(-1.0, 0.0))
    with host.raised(), rendered(servo, block) as was_late:
        sys.stdout.write(f"{servo._process.pid}\n")
        sys.stdout.flush()
        since = None
        while True:
            try:
                felt = servo.read()
            except ServoError as error:
                sys.stdout.write(HELD_UP if was_late() else f"{error}\n")
                break
            if felt is None:
                continue
            if felt.touches:
                since = 0
            if since is not None:
                since += len(felt.device_us)
                if since > PRESSED_FRAMES:
                    sys.stdout.write("pressing\n")
                    sys.stdout.flush()
                    since = None


if __name__ == "__main__":
    main()
