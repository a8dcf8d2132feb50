"""SIMULATED: what a tracker's device sends of a step of known speed, and the real driver that reads it.

The driver has no port and no thread here. Its clock is moved by hand from read to read, so that a step takes no time.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from palpate.experiment.apparatus import rig as rigs
from palpate.experiment.apparatus.rig import tracker_of
from palpate.experiment.apparatus.tracker.frames import Decoder, Samples, encode
from palpate.experiment.apparatus.tracker.serial_tracker import SerialTracker
from palpate.experiment.apparatus.tracker.settings import TrackerRig
from palpate.experiment.protocol.files import shipped
from palpate.experiment.rehearsal.clock import ManualClock
from palpate.experiment.rehearsal.wires.foot import Hesitation, Trajectory, trajectory

BASE = tracker_of(rigs.load(shipped("rigs/rehearsal.toml")))
BEFORE_S = 1.5
"""How long the foot rests before its step, s."""

CALM_S = 0.012
"""The driver's pause between reads of a foot that does not fall, s."""

Floats = NDArray[np.float64]
Whole = NDArray[np.int64]


@dataclass(frozen=True)
class Wire:
    """What a device sends: when, s of true time, and in each frame sequence number, device time and height.

    `top_s`, `bottom_s` and `contact_s` are the truth, `settings` the rig's. Frames come `late_s` after they were sent.
    """

    at_s: Floats
    sequence: Whole
    us: Whole
    mm: Floats
    top_s: float
    bottom_s: float
    contact_s: float
    speed_mm_s: float
    settings: TrackerRig
    stalls: tuple[tuple[float, float], ...] = ()
    pause_s: float = 0.0016
    damage: float = 0.0

    @property
    def inside(self) -> NDArray[np.bool_]:
        """Which frames were sampled inside the gate."""
        return (self.at_s > self.top_s) & (self.at_s < self.bottom_s)

    def middle(self, rng: np.random.Generator) -> int:
        """Return a frame inside the gate."""
        inside = np.nonzero(self.inside)[0]
        return int(inside[inside.size // 4 + rng.integers(max(inside.size // 2, 1))])

    def only(self, kept: NDArray[np.bool_] | Whole) -> Wire:
        """Return the wire with these frames alone, in this order."""
        return replace(self, at_s=self.at_s[kept], sequence=self.sequence[kept], us=self.us[kept], mm=self.mm[kept])


def honest(
    rng: np.random.Generator,
    speed_mm_s: float,
    *,
    rate_hz: int = 1000,
    drift: float = 0.0,
    noise_mm: float = 0.01,
    hesitation: Hesitation = "none",
    start_us: int | None = None,
) -> Wire:
    """Return a step as a good device sends it; its clock counts `1 + drift` microseconds a microsecond."""
    settings = BASE.model_copy(update={"rate_hz": rate_hz, "noise_mm": noise_mm, "stall_ms": 200})
    step: Trajectory = trajectory(rng, speed_mm_s, hesitation=hesitation)
    seconds = BEFORE_S + step.duration_us / 1e6 + 1.0
    device_s = np.arange(0, seconds, 1 / rate_hz)
    at_s = device_s / (1 + drift)
    mm = step.at((at_s - BEFORE_S) * 1e6) + rng.normal(0, noise_mm, at_s.size)
    first_us = int(rng.integers(2**31)) if start_us is None else start_us
    return Wire(
        at_s=at_s,
        sequence=np.arange(at_s.size) + int(rng.integers(65536)),
        us=first_us + np.rint(device_s * 1e6).astype(np.int64),
        mm=mm,
        top_s=BEFORE_S + step.gate_top_us / 1e6,
        bottom_s=BEFORE_S + step.gate_bottom_us / 1e6,
        contact_s=BEFORE_S + step.contact_us / 1e6,
        speed_mm_s=step.speed_mm_s,
        settings=settings,
    )


class Fed(SerialTracker):
    """The driver without its port and thread: what it reads comes from a wire, when the clock is moved there."""

    def __init__(self, wire: Wire, clock: ManualClock, rng: np.random.Generator) -> None:
        self._reads = _reads(wire, rng)
        self._began_ns = clock.now_ns()
        self._manual = clock
        super().__init__("fed", wire.settings, clock=clock)

    def _open(self, port: str) -> None:
        self._decoder, self._clock_state, self._failure = Decoder(period_us=1e6 / self._settings.rate_hz), None, None
        self._reference_us, self._reference_mm, self._falls_until_us = 0, np.inf, 0
        self._falls = True
        self._forget()

    def drain(self) -> None:
        pass

    def close(self) -> None:
        pass

    def read(self) -> Samples:
        while self._arrivals.empty() and self._failure is None:
            at_s, data = next(self._reads, (None, b""))
            if at_s is None:
                raise self._silent()
            self._manual.sleep_ns(self._began_ns + round(at_s * 1e9) - self._manual.now_ns())
            self._arrive(data, self._manual.now_ns())
        return super().read()


def encoded(wire: Wire, rng: np.random.Generator) -> list[bytes]:
    counts = wire.settings.counts(wire.mm)
    rows = zip(wire.sequence.tolist(), wire.us.tolist(), counts.tolist(), strict=True)
    frames = [bytearray(encode(sequence, us, count)) for sequence, us, count in rows]
    for frame in frames:
        if wire.damage and rng.random() < wire.damage:
            frame[int(rng.integers(len(frame)))] ^= 1 << int(rng.integers(8))
    return [bytes(frame) for frame in frames]


def _reads(wire: Wire, rng: np.random.Generator) -> Iterator[tuple[float, bytes]]:
    frames = encoded(wire, rng)
    now_s, done = 0.0, 0
    while done < len(frames):
        calm = now_s < wire.top_s - 0.1
        now_s += (max(CALM_S, wire.pause_s) if calm else wire.pause_s) + float(rng.exponential(1e-4))
        for begin_s, lasts_s in wire.stalls:
            if begin_s <= now_s < begin_s + lasts_s:
                now_s = begin_s + lasts_s
        until = done
        while until < len(frames) and wire.at_s[until] + 2e-4 <= now_s:
            until += 1
        if until > done:
            yield now_s, b"".join(frames[done:until])
            done = until
