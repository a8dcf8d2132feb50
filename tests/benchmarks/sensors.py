"""Whether swapped and dead sensors are found: run `python -m tests.benchmarks.sensors [times of each, 20]`.

Servers on the loopback interface stand at the addresses of a rig's accelerometer and actuator, and `palpate doctor`'s
checks look at them through the drivers of a session. What moves no panel cannot tell on which one a sensor lies: that
the comparison before a session finds, in memory. Everything is SIMULATED.
"""

from __future__ import annotations

import socket
import sys
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from palpate.experiment.apparatus import rig as rigs
from palpate.experiment.apparatus.doctor import checks, sensor
from palpate.experiment.apparatus.panel import drift, multisine
from palpate.experiment.apparatus.panel.accelerometer import Window
from palpate.experiment.apparatus.panel.calibration import Devices
from palpate.experiment.apparatus.rig import AccelerometerRig
from palpate.experiment.apparatus.tracker.frames import encode
from palpate.experiment.clock import MonotonicClock
from palpate.experiment.errors import Finding, PalpateError
from palpate.experiment.protocol.files import shipped
from palpate.experiment.rehearsal.wires.modes import Modes, read
from palpate.experiment.rehearsal.wires.sensor import REST_NOISE_M_S2
from tests.benchmarks.drift import RATE_HZ, Memory, reference

PIECE_S = 0.02
SETTINGS = AccelerometerRig(
    driver="pcm-tcp", address="127.0.0.1:9", rate_hz=RATE_HZ, full_scale_m_s2=100.0, trigger_m_s2=0.05
)
RIG = rigs.load(shipped("rigs/rehearsal.toml"))

Sends = Callable[[np.random.Generator, int], bytes]
"""From a number of samples that are due to the bytes of a piece."""


def noise(rng: np.random.Generator, due: int) -> bytes:
    """What a sensor at rest sends."""
    return bytes((rng.normal(0.0, REST_NOISE_M_S2, due) / SETTINGS.full_scale_m_s2).astype("<f4").tobytes())


def one_value(rng: np.random.Generator, due: int) -> bytes:
    return np.full(due, 0.005, "<f4").tobytes()


def zeros(rng: np.random.Generator, due: int) -> bytes:
    return bytes(4 * due)


def nan(rng: np.random.Generator, due: int) -> bytes:
    return np.where(rng.random(due) < 0.01, np.nan, 0.0).astype("<f4").tobytes()


def half_rate(rng: np.random.Generator, due: int) -> bytes:
    return noise(rng, due // 2)


def double_rate(rng: np.random.Generator, due: int) -> bytes:
    return noise(rng, 2 * due)


def counts(rng: np.random.Generator, due: int) -> bytes:
    """A sensor that sends 16-bit counts."""
    return rng.integers(-300, 300, 2 * due).astype("<i2").tobytes()


def tracker(rng: np.random.Generator, due: int) -> bytes:
    """The frames of a tracker."""
    first = int(rng.integers(1 << 20))
    return b"".join(encode(first + n, (first + n) * 200, int(rng.integers(500, 520))) for n in range(due))


def nothing(rng: np.random.Generator, due: int) -> bytes:
    """What an actuator's server sends, and a sensor whose program hangs."""
    return b""


@contextmanager
def serving(sends: Sends, seed: int, *, lasts_s: float = 60.0) -> Iterator[str]:
    """Yield the address of a server that sends to whoever connects, and closes after so long."""
    server, over = socket.create_server(("127.0.0.1", 0)), threading.Event()

    def serve() -> None:
        rng = np.random.default_rng(seed)
        with suppress(OSError):
            while not over.is_set():
                connection, _ = server.accept()
                began_s, sent = time.monotonic(), 0
                with connection, suppress(OSError):
                    while not over.is_set() and time.monotonic() - began_s < lasts_s:
                        due = round((time.monotonic() - began_s) * RATE_HZ) - sent
                        sent += due
                        connection.sendall(sends(rng, due))
                        over.wait(PIECE_S)

    thread = threading.Thread(target=serve, daemon=True)
    thread.start()
    try:
        yield f"127.0.0.1:{server.getsockname()[1]}"
    finally:
        over.set()
        with suppress(OSError), socket.create_connection(server.getsockname(), timeout=1.0):
            pass
        thread.join()
        server.close()


def listened(sends: Sends, seed: int, *, lasts_s: float = 60.0) -> list[Finding]:
    """What the doctor finds of an accelerometer."""
    with serving(sends, seed, lasts_s=lasts_s) as address:
        return list(sensor.checks(RIG, SETTINGS, address, clock=MonotonicClock()))


def played_to(seed: int, sends: Sends) -> list[Finding]:
    """What the doctor finds of an actuator at whose address such a server stands."""
    with serving(sends, seed) as address:
        return list(checks.server(address, RIG.actuator))


def shared(seed: int) -> list[Finding]:
    """The accelerometer's address is the actuator's."""
    address = f"127.0.0.1:{1024 + seed}"
    same = RIG.model_copy(update={"actuator": RIG.actuator.model_copy(update={"address": address})})
    settings = SETTINGS.model_copy(update={"address": address})
    return list(sensor.checks(same, settings, None, clock=MonotonicClock()))


DOCTOR: dict[str, Callable[[int], list[Finding]]] = {
    "no fault": lambda seed: listened(noise, seed),
    "accelerometer.address is the actuator's server": lambda seed: listened(nothing, seed),
    "actuator.address is the accelerometer's server": lambda seed: played_to(seed, noise),
    "accelerometer.address is the tracker's": lambda seed: listened(tracker, seed),
    "one address twice": shared,
    "an actuator's server that never closes": lambda seed: played_to(seed, nothing),
    "dead: one value": lambda seed: listened(one_value, seed),
    "dead: zeros": lambda seed: listened(zeros, seed),
    "NaN": lambda seed: listened(nan, seed),
    "ends after 0.5 s": lambda seed: listened(noise, seed, lasts_s=0.5),
    "half the rate": lambda seed: listened(half_rate, seed),
    "twice the rate": lambda seed: listened(double_rate, seed),
    "counts, not float32": lambda seed: listened(counts, seed),
}


class Beside(Memory):
    """The sensor lies beside the panel."""

    def play(self, samples: NDArray[np.float32]) -> None:
        super().play(np.zeros_like(samples))


class Elsewhere(Memory):
    """The sensor lies on another panel, which is compared at the same moment."""

    def play(self, samples: NDArray[np.float32]) -> None:
        lines = multisine.lines(RATE_HZ)
        other = multisine.period(multisine.drawn(lines, rate_hz=RATE_HZ, rng=self._rng), lines, rate_hz=RATE_HZ)
        super().play(np.resize(0.05 * other, samples.size).astype(np.float32))


class Dead(Memory):
    """The sensor sends one value."""

    def heard_since_armed(self) -> Window:
        return Window(np.full_like(super().heard_since_armed().samples_m_s2, 0.5), 0)


class UpsideDown(Memory):
    """The sensor was turned over since the panel was measured."""

    def heard_since_armed(self) -> Window:
        return Window(-super().heard_since_armed().samples_m_s2, 0)


def refused_before_a_session(modes: Modes, kind: type[Memory], times: int) -> int:
    """How often a session with such a sensor is refused or warned of."""
    rng, found = np.random.default_rng(7), 0
    stated, known = reference(modes, rng)
    for _ in range(times):
        made = kind(modes, rng)
        try:
            drifts = drift.compare(
                Devices(made, made, RATE_HZ, RATE_HZ), stated, known, peak=stated.check_peak, rng=rng
            )
            found += drift.judged(drifts, Path("rig.toml")).verdict != "passes"
        except PalpateError:
            found += 1
    return found


def main() -> None:
    times = int(sys.argv[1]) if len(sys.argv) > 1 else 20
    print("| what is planted | found by | found |")
    print("|:--|:--|--:|")
    for name, plant in DOCTOR.items():
        with ThreadPoolExecutor(10) as pool:
            found = list(pool.map(plant, range(times)))
        red = [[one.check for one in each if one.verdict == "refuses"] for each in found]
        by = ", ".join(sorted({str(each[0]) for each in red if each}))
        print(f"| {name} | doctor{f': {by}' if by else ''} | {sum(map(bool, red))} of {times} |", flush=True)
    modes = read(shipped("rigs/rehearsal-panel.toml"))
    kinds = {"no fault": Memory, "beside": Beside, "on another panel": Elsewhere, "dead": Dead}
    for label, kind in {**kinds, "upside down": UpsideDown}.items():
        found_before = refused_before_a_session(modes, kind, times)
        print(f"| sensor: {label} | comparison before a session | {found_before} of {times} |", flush=True)


if __name__ == "__main__":
    main()
