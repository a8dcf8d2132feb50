"""What reading a tracker costs: run `python -m tests.benchmarks.tracker`; every figure is a median of `RUNS` runs.

Another process sends frames through a pseudo-terminal at a steady rate, each with the machine's monotonic time in its
device clock, so that a sample's age when `read` returns is known. Its foot rests; or steps as in a rehearsal, a step
every `EVERY_S` and rest between; or goes up and down at `SPEED_MM_S` without a stop. Its sensor has noise.

For 1 and 5 kHz and each foot: the part of a core, which is the processor time of this whole process while it reads,
reader and thread, as a session does, at its priority and on its core; reads a second, and what one costs; how old the
newest and the oldest sample of a read are; the error of the clock map at the end; frames lost.

Beside each stands what a bare loop took just before, which sleeps 4 ms and does nothing else: it says how slow the
machine was then, for other work and the processor's own pace change every figure here.

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
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from palpate.experiment.apparatus import host
from palpate.experiment.apparatus import rig as rigs
from palpate.experiment.apparatus.rig import tracker_of
from palpate.experiment.apparatus.tracker.frames import Samples, encode
from palpate.experiment.apparatus.tracker.serial_tracker import SerialTracker
from palpate.experiment.apparatus.tracker.settings import TrackerRig
from palpate.experiment.rehearsal.kinds.footstep.participant import SPEED_MEDIAN_MM_S
from palpate.experiment.rehearsal.wires.foot import trajectory

RATES_HZ = (1000, 5000)
FEET = ("rests", "steps", "moves")
RUNS = 5
SECONDS = 6.0
BARE_TURNS = 250
CLOCK_US = 2**32

LOWEST_MM, HIGHEST_MM = 10.0, 60.0
SPEED_MM_S = 100.0
EVERY_S = 3.0
"""From step to step: with an answer after 1.3 s a rehearsed participant, who never tires, takes about as long."""
NOISE_MM = 0.1


class Bare:
    """Implements `Clock`: the clock that the sender stamps with."""

    simulated = False

    def now_ns(self) -> int:
        return time.monotonic_ns()

    def sleep_ns(self, duration_ns: int) -> None:
        time.sleep(duration_ns / 1e9)

    def uptime(self) -> None:
        return None


@dataclass(frozen=True)
class Run:
    """One reading.

    Attributes:
        bare_us: processor time of a turn of the bare loop before it, microseconds.
        core: part of a core that the process took.
        reads: a second.
        newest_ms: age of the newest sample of each read as `read` returned it, shape (n,).
        oldest_ms: of the oldest, shape (n,).
        lost: frames that did not come.
        map_us: error of the clock map at the end, microseconds.
    """

    bare_us: float
    core: float
    reads: float
    newest_ms: np.ndarray
    oldest_ms: np.ndarray
    lost: int
    map_us: float


def settings(rate_hz: int) -> TrackerRig:
    """Those of the shipped rig, at another rate."""
    rig = tracker_of(rigs.load(Path(__file__).parents[2] / "protocols" / "rigs" / "rehearsal.toml"))
    return rig.model_copy(update={"rate_hz": rate_hz})


def readings(rate_hz: int, foot: str) -> list[int]:
    """What the sensor gives, over and over: a step and the rest after it, a way down and one up, or rest."""
    rng = np.random.default_rng(0)
    if foot == "steps":
        step = trajectory(rng, SPEED_MEDIAN_MM_S, hesitation="none")
        height_mm = step.at(np.arange(0.0, EVERY_S * 1e6, 1e6 / rate_hz))
    else:
        way_mm = HIGHEST_MM - LOWEST_MM
        gone_mm = np.arange(0.0, 2 * way_mm, SPEED_MM_S / rate_hz) if foot == "moves" else np.zeros(rate_hz)
        height_mm = LOWEST_MM + np.abs(way_mm - gone_mm)
    counts: list[int] = settings(rate_hz).counts(height_mm + rng.normal(0.0, NOISE_MM, height_mm.size)).tolist()
    return counts


def send(line: int, rate_hz: int, foot: str) -> None:
    """In a process of its own: a frame a sample to a file descriptor, stamped as it goes."""
    counts = readings(rate_hz, foot)
    begun_ns = time.monotonic_ns()
    for i in range(int(rate_hz * (SECONDS + 1))):
        left_ns = begun_ns + i * 1_000_000_000 // rate_hz - time.monotonic_ns()
        if left_ns > 0:
            time.sleep(left_ns / 1e9)
        os.write(line, encode(i, time.monotonic_ns() // 1000, counts[i % len(counts)]))


def signed_us(us: float) -> float:
    """A difference to a stamp of the sender, whose clock wraps, microseconds."""
    return (us + CLOCK_US / 2) % CLOCK_US - CLOCK_US / 2


def read(rate_hz: int, foot: str) -> Run:
    """Read for `SECONDS`, at the priority of a session and on its core."""
    with host.raised():
        return read_raised(rate_hz, foot)


def read_raised(rate_hz: int, foot: str) -> Run:
    bare_us = bare()
    device, port = pty.openpty()
    tty.setraw(port)
    tracker = SerialTracker(os.ttyname(port), settings(rate_hz), clock=Bare())
    code = f"from tests.benchmarks.tracker import send; send({device}, {rate_hz}, {foot!r})"
    with host.elsewhere():
        sender = subprocess.Popen([sys.executable, "-c", code], pass_fds=[device])
    while tracker.clock_map is None:
        time.sleep(0.01)
    tracker.drain()
    read: list[Samples] = []
    at_ns: list[int] = []
    begun_s, used_s = time.monotonic(), time.process_time()
    while (passed_s := time.monotonic() - begun_s) < SECONDS:
        read.append(tracker.read())
        at_ns.append(time.monotonic_ns())
    core = (time.process_time() - used_s) / passed_s
    newest_us = int(read[-1].device_us[-1])
    map_us = signed_us(tracker.clock_map.session_ns(newest_us) / 1e3 - newest_us)
    tracker.close()
    sender.terminate()
    sender.wait()
    for end in (device, port):
        os.close(end)
    newest_ms, oldest_ms = (
        np.array([signed_us(ns / 1e3 - int(one.device_us[i])) / 1e3 for ns, one in zip(at_ns, read, strict=True)])
        for i in (-1, 0)
    )
    return Run(bare_us, core, len(read) / passed_s, newest_ms, oldest_ms, tracker.counts.lost, map_us)


def bare() -> float:
    """Processor time of a turn of a loop that only sleeps, microseconds."""
    used_s = time.process_time()
    for _ in range(BARE_TURNS):
        time.sleep(0.004)
    return (time.process_time() - used_s) / BARE_TURNS * 1e6


def shown(runs: Sequence[Run], of: Callable[[Run], float], form: str) -> str:
    """Median of the runs, and the least and the most of them."""
    values = [of(run) for run in runs]
    return f"{statistics.median(values):{form}} ({min(values):{form}} to {max(values):{form}})"


def main() -> None:
    print(
        f"medians of {RUNS} runs of {SECONDS:g} s (least to most); load average {os.getloadavg()[0]:.1f} on "
        f"{os.cpu_count()} cores"
    )
    for rate_hz in RATES_HZ:
        for foot in FEET:
            runs = [read(rate_hz, foot) for _ in range(RUNS)]
            print(f"{rate_hz} Hz, a foot that {foot}: {shown(runs, lambda run: 100 * run.core, '.1f')} % of a core")
            print(
                f"   {shown(runs, lambda run: run.reads, '.0f')} reads/s of "
                f"{shown(runs, lambda run: run.core / run.reads * 1e6, '.0f')} microseconds; a bare loop took "
                f"{shown(runs, lambda run: run.bare_us, '.0f')} a turn"
            )
            print(
                f"   newest sample's age: median {shown(runs, lambda run: float(np.median(run.newest_ms)), '.2f')} ms, "
                f"p99 {shown(runs, lambda run: float(np.quantile(run.newest_ms, 0.99)), '.2f')} ms"
            )
            print(
                f"   oldest sample's age: median {shown(runs, lambda run: float(np.median(run.oldest_ms)), '.2f')} ms, "
                f"p99 {shown(runs, lambda run: float(np.quantile(run.oldest_ms, 0.99)), '.2f')} ms"
            )
            print(
                f"   clock map off by {shown(runs, lambda run: run.map_us, '.0f')} microseconds; "
                f"frames lost: {sum(run.lost for run in runs)}"
            )


if __name__ == "__main__":
    main()
