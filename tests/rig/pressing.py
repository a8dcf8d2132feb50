"""A session that only has a servo push the hand, in a process of its own: it says when the hand presses, and sleeps."""

from __future__ import annotations

import json
import sys
from math import inf
from typing import Any

from palpate.experiment.apparatus import host
from palpate.experiment.apparatus.servo.link import ServoProcess
from palpate.experiment.apparatus.servo.process import Orders
from palpate.experiment.clock import MonotonicClock
from palpate.experiment.synthesis.contact.block import Block

PRESSED_FRAMES = 25
"""So many frames after the touch the hand surely presses."""


def main() -> None:
    """Open the servo of the orders in the argument, say its process number, and when the hand presses."""
    given: dict[str, Any] = json.loads(sys.argv[1])
    told: dict[str, Any] = {key: tuple(value) if isinstance(value, list) else value for key, value in given.items()}
    with host.raised():
        servo = ServoProcess(Orders(**told), MonotonicClock())
        servo.render(Block((800.0, 800.0), (5.0, 5.0), (inf, inf), into=(-1.0, 0.0)))
        sys.stdout.write(f"{servo._process.pid}\n")
        sys.stdout.flush()
        since = None
        while True:
            felt = servo.read()
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
