"""What reading a tracker costs: run `python -m tests.benchmarks.tracker`; every figure is a median of `RUNS` runs.

Another process sends frames through a pseudo-terminal at a steady rate, each with the machine's monotonic time in its
device clock, so that a sample's age when `read` returns is known. Processor time is that of this whole process while it
reads. What a bare loop takes, which sleeps 4 ms and does nothing else, says how busy the machine is.

Not a test: it asserts nothing, because these figures belong to the machine that printed them.
"""

from __future__ import annotations

import os
import pty
import statistics
import subprocess
import sys
import time
import tty
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from experiment.apparatus import rig as rigs
from experiment.apparatus.frames import encode
from experiment.apparatus.serial_tracker import SerialTracker

RATES_HZ = (1000, 5000)
RUNS = 5
SECONDS = 6.0
BARE_TURNS = 500
CLOCK_US = 2**32


class Bare:
    """Implements `Clock`: the clock that the sender stamps with."""

    def now_ns(self) -> int:
        return time.monotonic_ns()

    def sleep_ns(self, duration_ns: int) -> None:
        time.sleep(duration_ns / 1e9)


@dataclass(frozen=True)
class Run:
    """One reading.

    Attributes:
        core: part of a core that the process took.
        reads: a second.
        age_ms: of the newest sample of each read as `read` returned it, shape (n,).
        lost: frames that did not come.
        map_us: error of the clock map at the end, microseconds.
    """

    core: float
    reads: float
    age_ms: np.ndarray
    lost: int
    map_us: float


def send(line: int, rate_hz: int) -> None:
    """In a process of its own: a frame a sample to a file descriptor, stamped as it goes."""
    begun_ns = time.monotonic_ns()
    for i in range(int(rate_hz * (SECONDS + 1))):
        left_ns = begun_ns + i * 1_000_000_000 // rate_hz - time.monotonic_ns()
        if left_ns > 0:
            time.sleep(left_ns / 1e9)
        os.write(line, encode(i, time.monotonic_ns() // 1000, 3000))


def lag_us(device_us: int) -> float:
    """Time since a stamp of the sender, microseconds."""
    return (time.monotonic_ns() / 1e3 - device_us) % CLOCK_US


def read(rate_hz: int) -> Run:
    """Read for `SECONDS`."""
    device, port = pty.openpty()
    tty.setraw(port)
    rig = rigs.load(Path(__file__).parents[2] / "protocols" / "rigs" / "rehearsal.toml").tracker
    tracker = SerialTracker(os.ttyname(port), rig.model_copy(update={"rate_hz": rate_hz}), clock=Bare())
    code = f"from tests.benchmarks.tracker import send; send({device}, {rate_hz})"
    sender = subprocess.Popen([sys.executable, "-c", code], pass_fds=[device])
    while tracker.clock_map is None:
        time.sleep(0.01)
    tracker.drain()
    begun_s, used_s = time.monotonic(), time.process_time()
    ages_us: list[float] = []
    while (passed_s := time.monotonic() - begun_s) < SECONDS:
        samples = tracker.read()
        newest_us = int(samples.device_us[-1])
        ages_us.append(lag_us(newest_us))
    core = (time.process_time() - used_s) / passed_s
    late_us = (tracker.clock_map.session_ns(newest_us) / 1e3 - newest_us) % CLOCK_US
    tracker.close()
    sender.terminate()
    sender.wait()
    for end in (device, port):
        os.close(end)
    map_us = (late_us + CLOCK_US / 2) % CLOCK_US - CLOCK_US / 2
    return Run(core, len(ages_us) / passed_s, np.array(ages_us) / 1e3, tracker.counts.lost, map_us)


def bare() -> float:
    """Processor time of a turn of a loop that only sleeps, microseconds."""
    used_s = time.process_time()
    for _ in range(BARE_TURNS):
        time.sleep(0.004)
    return (time.process_time() - used_s) / BARE_TURNS * 1e6


def main() -> None:
    print(
        f"medians of {RUNS} runs of {SECONDS:g} s, (least to most); load average {os.getloadavg()[0]:.1f} on "
        f"{os.cpu_count()} cores; a bare loop takes {bare():.0f} microseconds a turn"
    )
    for rate_hz in RATES_HZ:
        runs = [read(rate_hz) for _ in range(RUNS)]
        core = [100 * run.core for run in runs]
        print(
            f"{rate_hz} Hz: {statistics.median(core):.1f} % of a core ({min(core):.1f} to {max(core):.1f}), "
            f"{statistics.median(run.reads for run in runs):.0f} reads/s, "
            f"{statistics.median(run.core / run.reads for run in runs) * 1e6:.0f} microseconds a read"
        )
        for name, part in (("median", 0.5), ("p99", 0.99)):
            ages_ms = [float(np.quantile(run.age_ms, part)) for run in runs]
            print(
                f"   newest sample's age, {name:6}: {statistics.median(ages_ms):.2f} ms "
                f"({min(ages_ms):.2f} to {max(ages_ms):.2f})"
            )
        errors_us = [run.map_us for run in runs]
        lost = sum(run.lost for run in runs)
        print(f"   clock map off by {min(errors_us):.0f} to {max(errors_us):.0f} microseconds; frames lost: {lost}")


if __name__ == "__main__":
    main()
