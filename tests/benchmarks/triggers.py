"""How far triggers are from their stimuli: run `python -m tests.benchmarks.triggers [EVENTS, 500] [--out FILE]`.

A session's lines follow an actuator that schedules; another process is the recorder, of a stream of Lab Streaming
Layer on this machine and of a pseudo-terminal. A marker is compared, after LSL's own correction of clocks and without
any, with the onset that the stimulus was scheduled for by its last aim; a byte, which has no time, when it was read.
Idle, and with a busy process on every core; at ordinary priority and, but for the recorder, at that of a session. What
an adapter or a network adds is in none of these figures. Nothing is asserted: they belong to the machine that printed
them. The actuator is SIMULATED.
"""

from __future__ import annotations

import csv
import multiprocessing
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import cast

import numpy as np

from palpate.experiment.apparatus import host
from palpate.experiment.apparatus import rig as rigs
from palpate.experiment.apparatus.host import beside
from palpate.experiment.apparatus.ports import Actuator
from palpate.experiment.apparatus.wires.triggers import open_triggers
from palpate.experiment.clock import MonotonicClock
from palpate.experiment.protocol.files import shipped
from palpate.experiment.records.entries import Armed
from palpate.experiment.rehearsal.wires.serial_line import PseudoTerminal
from palpate.experiment.synthesis.waveforms import Waveform

LINES = """
[[triggers]]
driver = "ttl"
port = "{port}"
baud = 115200
events = {{ stimulus = 1 }}

[[triggers]]
driver = "lsl"
stream = "{name}"
events = {{ stimulus = 1 }}
"""

RECORDER = """
import os, select, sys, time, pylsl
from palpate.experiment.apparatus.host import beside
from palpate.experiment.apparatus.wires.lsl import scope
beside.be_ordinary()
device, name, events = int(sys.argv[1]), sys.argv[2], int(sys.argv[3])
pylsl.set_config_content(scope(None))
inlet = pylsl.StreamInlet(pylsl.resolve_byprop("name", name, 1, 30)[0])
inlet.open_stream(10)
inlet.time_correction(60)
off_ns = time.monotonic_ns() - pylsl.local_clock() * 1e9
print("there", flush=True)
rows = {"ttl": [], "lsl": []}
while min(map(len, rows.values())) < events:
    if select.select([device], [], [], 0)[0]:
        rows["ttl"] += [time.monotonic_ns()] * len(os.read(device, 4096))
    sample, at_s = inlet.pull_sample(0.0)
    if sample:
        rows["lsl"].append((at_s + inlet.time_correction()) * 1e9 + off_ns)
        rows.setdefault("lsl-sent", []).append(at_s * 1e9 + off_ns)
        rows.setdefault("lsl-read", []).append(time.monotonic_ns())
    time.sleep(50e-6)
for name, times in rows.items():
    print(name, *map(int, times))
"""


class Scheduling:
    """An actuator that plays nothing, and takes an aim until its lead before the onset that it has."""

    lead_ns = 2_000_000

    def __init__(self, clock: MonotonicClock) -> None:
        self._clock = clock
        self.onset_ns = 0

    def prepare(self, stimulus: Waveform) -> Waveform:
        self.onset_ns = 0
        return stimulus

    def aim(self, onset_ns: int) -> bool:
        last_ns = min(onset_ns, self.onset_ns or onset_ns)
        if self._clock.now_ns() > last_ns - self.lead_ns:
            return False
        self.onset_ns = onset_ns
        return True

    def landed(self, contact_ns: int) -> None:
        """Play nothing."""


@contextmanager
def busy() -> Iterator[None]:
    """Load every core."""
    others = [multiprocessing.Process(target=_turn, daemon=True) for _ in range(os.cpu_count() or 1)]
    for other in others:
        other.start()
    try:
        yield
    finally:
        for other in others:
            other.terminate()
            other.join()


def _turn() -> None:
    beside.be_ordinary()
    while True:
        pass


def measure(events: int) -> dict[str, list[float]]:
    """Return for each line how long after its onset each trigger came, ms."""
    wire, clock, name = PseudoTerminal(), MonotonicClock(), f"palpate benchmark {os.getpid()}"
    device = wire._device
    with tempfile.TemporaryDirectory() as folder, ExitStack() as opened:
        rig_file = Path(folder) / "rig.toml"
        lines = LINES.format(port=wire.url, name=name)
        rig_file.write_text(shipped("rigs/presented.toml").read_text("utf-8") + lines, "utf-8")
        triggers = open_triggers(rigs.load(rig_file), clock, print, opened)
        words = [sys.executable, "-c", RECORDER, str(device), name, str(events)]
        recorder = subprocess.Popen(words, pass_fds=[device], stdout=subprocess.PIPE, text=True)
        assert recorder.stdout is not None
        recorder.stdout.readline()
        actuator = triggers.following(cast("Actuator", playing := Scheduling(clock)))
        onsets = []
        for trial in range(events):
            triggers.after(Armed(trial=trial, attempt=1, presented=("a",)))
            actuator.prepare(cast("Waveform", None))
            # A foot that falls is aimed at anew with each read.
            for ahead_ms in (25, 21):
                actuator.aim(clock.now_ns() + ahead_ms * 1_000_000)
                time.sleep(0.004)
            actuator.landed(clock.now_ns())
            onsets.append(playing.onset_ns)
            time.sleep(0.03)
        anchor_ns = clock.now_ns() - time.monotonic_ns()
        rows = dict(line.split(" ", 1) for line in recorder.stdout.read().splitlines())
        recorder.wait()
    wire.close()
    return {
        line: [(int(at) + anchor_ns - due) / 1e6 for at, due in zip(times.split(), onsets, strict=True)]
        for line, times in rows.items()
    }


NAMES = {
    "ttl": "TTL, byte read",
    "lsl": "LSL, marker's time",
    "lsl-sent": "LSL, its time without correction",
    "lsl-read": "LSL, marker read",
}


def main() -> None:
    words = sys.argv[1:]
    out = Path(words[words.index("--out") + 1]) if "--out" in words else None
    events = int(words[0]) if words and words[0].isdecimal() else 500
    rows: list[tuple[object, ...]] = [("what", "priority", "machine", "events", "median_ms", "p95_ms", "worst_ms")]
    for priority in ("ordinary", "session"):
        for machine in ("idle", "loaded"):
            with ExitStack() as opened:
                if priority == "session":
                    opened.enter_context(host.raised())
                if machine == "loaded":
                    opened.enter_context(busy())
                measured = measure(events)
            for line, off_ms in measured.items():
                size = np.abs(off_ms)
                figures = (np.median(size), np.quantile(size, 0.95), size.max())
                rows.append((NAMES[line], priority, machine, events, *(f"{one:.3f}" for one in figures)))
                print(*rows[-1], sep=", ", flush=True)
    if out is not None:
        with out.open("w", encoding="utf-8", newline="") as file:
            csv.writer(file, lineterminator="\n").writerows(rows)


if __name__ == "__main__":
    main()
