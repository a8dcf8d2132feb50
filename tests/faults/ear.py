"""What leaves a session's sound card, heard from outside: `python -m tests.faults.ear SERVER`, a client of that server.

It imports nothing of palpate, so that it listens within a moment.
"""

import sys
import time
from collections import deque
from typing import Any

import jack
import numpy as np

LOUD = 1e-6
"""A sample from here on is heard or felt."""


def main() -> None:
    """Say channel and time of each loud block, -1 once it can hear, and -2 for each output."""
    jack.set_error_function(lambda _text: None)
    jack.set_info_function(lambda _text: None)
    client = jack.Client("ear", servername=sys.argv[1], no_start_server=True)
    entries: list[Any] = []
    loud: deque[tuple[int, float]] = deque()

    def heard(_frames: int) -> None:
        now_s = time.monotonic()
        for place, entry in enumerate(entries):
            if np.max(np.abs(entry.get_array())) > LOUD:
                loud.append((place, now_s))

    client.set_process_callback(heard)
    client.activate()
    loud.append((-1, time.monotonic()))
    while True:
        try:
            outputs = sorted(client.get_ports("^PortAudio:out_[0-9]+$"), key=lambda port: port.name)
        except jack.JackError:
            # A session that ends closes them as they are listed.
            outputs = []
        for place, output in enumerate(outputs[len(entries) :], len(entries)):
            entry = client.inports.register(f"in_{place}")
            client.connect(output, entry)
            entries.append(entry)
            loud.append((-2, time.monotonic()))
        while loud:
            sys.stdout.write("{} {}\n".format(*loud.popleft()))
        sys.stdout.flush()
        time.sleep(0.02)


if __name__ == "__main__":
    main()
