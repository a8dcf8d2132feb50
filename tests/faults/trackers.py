"""Trackers that lie: SIMULATED feet of known speed, read through the real driver, with what a bad device makes of them.

A tracker's frames go through the real driver into `watch` (wire.py); some also through a pseudo-terminal. A lie is
survived if the step counts with a speed within 2 % of the true one, or does not count and the reason names the tracker.
"""

from __future__ import annotations

import re
import threading
from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import dataclass, replace
from typing import cast

import numpy as np

from palpate.experiment.apparatus.ports import Tracker
from palpate.experiment.apparatus.tracker.clock_map import ClockMap
from palpate.experiment.apparatus.tracker.frames import FRAME_BYTES, Decoder, LinkCounts, Samples, encode
from palpate.experiment.apparatus.tracker.gate import GateDetector, Scrutiny, Sifted
from palpate.experiment.apparatus.tracker.guarded import GuardedTracker
from palpate.experiment.apparatus.tracker.landing import STOPPED, TURNED_BACK, LandingPredictor
from palpate.experiment.apparatus.tracker.serial_tracker import SerialTracker
from palpate.experiment.apparatus.tracker.settings import TrackerRig
from palpate.experiment.clock import Clock, MonotonicClock
from palpate.experiment.errors import TrackerError
from palpate.experiment.protocol.models import Step
from palpate.experiment.rehearsal.clock import ManualClock
from palpate.experiment.rehearsal.wires.foot import Hesitation
from palpate.experiment.rehearsal.wires.serial_line import SerialLine
from palpate.experiment.session.kinds.footstep.watch import Feed, Watch, WatchedStep, watch
from tests.experiment.session.scripted import Endless
from tests.faults.campaign import Count, Size
from tests.faults.wire import BASE, Fed, Floats, Wire, encoded, honest
from tests.machine_clock import MachineClock

STEP = Step(gate_top_mm=20.0, gate_bottom_mm=10.0, contact_mm=0.0)
OFF = 0.02
"""No speed that counts may be further off, as a part of the true one."""

OFF_MS = 3.0
"""No contact of a good device may be further off, ms; gate.py says by how much a foot that slows down is early."""

COUNT_MM = BASE.resolution_mm

SPEEDS_MM_S = (50.0, 100.0, 170.0, 250.0, 400.0)


Lie = Callable[[Wire, np.random.Generator], Wire]


def outcome(tracker: Tracker, settings: TrackerRig, clock: Clock, hesitation: Hesitation = "none") -> WatchedStep | str:
    """Return the step that counts, or the first reason why none does; a foot that did hesitate is watched on."""
    noise_mm = settings.noise_mm or 0.1
    parts = Watch(
        feed=Feed(tracker, simulated_time=False),
        scrutiny=Scrutiny(rate_hz=settings.rate_hz, noise_mm=noise_mm, resolution_mm=settings.resolution_mm),
        detector=GateDetector(STEP),
        predictor=LandingPredictor(STEP, noise_mm=noise_mm),
        clock=clock,
        limits=Endless(),
        sounder=None,
    )
    try:
        while True:
            step = watch(parts, "paper")
            if isinstance(step, WatchedStep):
                return step
            if hesitation == "none" or step.reason not in (TURNED_BACK, STOPPED):
                return step.reason
    except TrackerError as error:
        return str(error)


def fed(wire: Wire, rng: np.random.Generator, hesitation: Hesitation = "none") -> WatchedStep | str:
    clock = MachineClock(10**18)
    return outcome(Fed(wire, clock, rng), wire.settings, clock, hesitation)


NAMED = re.compile(
    r"the tracker's (clock (ran ahead of|fell behind) the session's|times (are|have gaps for)|heights? (jump|stays)) .*"
    r"|no reading for \d+ ms while the foot crossed the gate; use a shorter cable"
    r"|tracker at fed: the device's clock no longer continues .*"
)
"""How a reason names what is wrong with the tracker."""

SILENT = re.compile(r"tracker at fed: no frame for 200 ms; .*")
"""How it names a tracker that sends nothing more."""


def wrong(found: WatchedStep | str, true_mm_s: float, named: re.Pattern[str] = NAMED) -> str:
    """Return what is wrong with how a lie ended; empty if it was survived."""
    if isinstance(found, WatchedStep):
        off = found.gate.speed_mm_s / true_mm_s - 1
        return f"{found.gate.speed_mm_s:.1f} mm/s counted for {true_mm_s:.1f}" if abs(off) > OFF else ""
    return "" if named.fullmatch(found) else f"does not name the tracker's fault: {found}"


def unmoved(found: WatchedStep | str, wire: Wire) -> str:
    """Return what is wrong with how a step of a good device, or with one false reading, ended; empty for nothing."""
    if not isinstance(found, WatchedStep):
        return found
    contact_us = np.interp(wire.contact_s, wire.at_s, wire.us - wire.us[0]) + wire.us[0]
    off_ms = (found.contact.us - contact_us) / 1e3
    return wrong(found, wire.speed_mm_s) or (f"contact is {off_ms:.1f} ms off" if abs(off_ms) > OFF_MS else "")


def clock(factor: float) -> Lie:
    """A whole device that runs too fast or slow: its clock and its sampling."""

    def lie(wire: Wire, rng: np.random.Generator) -> Wire:
        at_s = np.arange(0, wire.at_s[-1], 1 / (wire.settings.rate_hz * factor))
        mm = np.interp(at_s, wire.at_s, wire.mm)
        us = wire.us[0] + np.rint(at_s * factor * 1e6).astype(np.int64)
        return replace(wire, at_s=at_s, sequence=np.arange(at_s.size), us=us, mm=mm)

    return lie


def stamps(factor: float) -> Lie:
    """Sampled in time, with a clock that runs too fast or slow."""
    return lambda wire, rng: replace(wire, us=wire.us[0] + np.rint((wire.us - wire.us[0]) * factor).astype(np.int64))


def jump(ms: float, place: str, *, numbered: bool = False) -> Lie:
    """Device time jumps; `numbered` has sequence numbers jump too, as if frames were lost."""

    def lie(wire: Wire, rng: np.random.Generator) -> Wire:
        at = wire.middle(rng)
        if place != "in":
            at_s = wire.top_s - 0.15 if place == "before" else (wire.bottom_s + wire.contact_s) / 2
            at = int(np.searchsorted(wire.at_s, at_s))
        later = np.arange(wire.us.size) >= at
        sequence = wire.sequence + later * round(ms * wire.settings.rate_hz / 1e3) * numbered
        return replace(wire, us=wire.us + later * round(ms * 1e3), sequence=sequence)

    return lie


def height(change: Callable[[Wire, int, np.random.Generator], Floats], at_s: str = "gate") -> Lie:
    """Heights from a frame inside the gate on, or from one 0.1 s before it, are others."""

    def lie(wire: Wire, rng: np.random.Generator) -> Wire:
        at = wire.middle(rng) if at_s == "gate" else int(np.searchsorted(wire.at_s, wire.top_s - 0.1))
        return replace(wire, mm=change(wire, at, rng))

    return lie


def spike(mm: float, samples: int = 1) -> Callable[[Wire, int, np.random.Generator], Floats]:
    def change(wire: Wire, at: int, rng: np.random.Generator) -> Floats:
        return wire.mm + mm * ((np.arange(wire.mm.size) >= at) & (np.arange(wire.mm.size) < at + samples))

    return change


def to(mm: float, samples: int) -> Callable[[Wire, int, np.random.Generator], Floats]:
    """Readings of one height, as of a loose contact."""

    def change(wire: Wire, at: int, rng: np.random.Generator) -> Floats:
        there = (np.arange(wire.mm.size) >= at) & (np.arange(wire.mm.size) < at + samples)
        return np.where(there, mm, wire.mm)

    return change


def ramp(mm: float, samples: int) -> Callable[[Wire, int, np.random.Generator], Floats]:
    def change(wire: Wire, at: int, rng: np.random.Generator) -> Floats:
        rise = np.clip((np.arange(wire.mm.size) - at) / samples, 0, 1)
        fall = np.clip((np.arange(wire.mm.size) - at - samples) / samples, 0, 1)
        return wire.mm + mm * (rise - fall)

    return change


def offset(mm: float) -> Callable[[Wire, int, np.random.Generator], Floats]:
    return lambda wire, at, rng: wire.mm + mm * (np.arange(wire.mm.size) >= at)


def burst(sigma_mm: float, samples: int) -> Callable[[Wire, int, np.random.Generator], Floats]:
    def change(wire: Wire, at: int, rng: np.random.Generator) -> Floats:
        there = (np.arange(wire.mm.size) >= at) & (np.arange(wire.mm.size) < at + samples)
        return wire.mm + np.where(there, rng.normal(0, sigma_mm, wire.mm.size), 0.0)

    return change


def stuck(samples: int) -> Callable[[Wire, int, np.random.Generator], Floats]:
    return lambda wire, at, rng: to(float(wire.mm[at]), samples)(wire, at, rng)


def frozen(samples: int) -> Lie:
    def lie(wire: Wire, rng: np.random.Generator) -> Wire:
        at, us = wire.middle(rng), wire.us.copy()
        us[at : at + samples] = us[at]
        return replace(wire, us=us)

    return lie


def lost(samples: int, *, numbered: bool) -> Lie:
    """Frames inside the gate are lost; not `numbered`: the device does not count them."""

    def lie(wire: Wire, rng: np.random.Generator) -> Wire:
        at = wire.middle(rng)
        kept = np.ones(wire.us.size, bool)
        kept[at : at + samples] = False
        less = replace(wire, sequence=wire.sequence - samples * (np.arange(wire.us.size) > at) * (not numbered))
        return less.only(kept)

    return lie


def silent(wire: Wire, rng: np.random.Generator) -> Wire:
    """No frame comes from the middle of the gate on."""
    return wire.only(np.arange(wire.middle(rng)))


def swapped(wire: Wire, rng: np.random.Generator) -> Wire:
    order = np.arange(wire.us.size)
    at = wire.middle(rng)
    order[[at, at + 1]] = order[[at + 1, at]]
    return wire.only(order)


def again(wire: Wire, rng: np.random.Generator) -> Wire:
    """Ten frames of before are sent once more."""
    at = wire.middle(rng)
    return wire.only(np.concatenate([np.arange(at), np.arange(max(at - 10, 0), wire.us.size)]))


def restart(wire: Wire, rng: np.random.Generator) -> Wire:
    at = wire.middle(rng)
    later = np.arange(wire.us.size) >= at
    us = np.where(later, wire.us - wire.us[at], wire.us)
    return replace(wire, us=us, sequence=np.where(later, wire.sequence - wire.sequence[at], wire.sequence))


def slowed(part: float) -> Lie:
    """A device that samples less often than its rig file says, in true time."""
    return lambda wire, rng: replace(
        wire.only(np.arange(0, wire.us.size, round(1 / part))), sequence=np.arange(-(-wire.us.size // round(1 / part)))
    )


def halted(ms: float) -> Lie:
    """Clock and sampling stand still for a while inside the gate, and go on as if no time had passed."""

    def lie(wire: Wire, rng: np.random.Generator) -> Wire:
        at, width = wire.middle(rng), round(ms * wire.settings.rate_hz / 1e3)
        moved = wire.only(np.concatenate([np.arange(at), np.arange(at + width, wire.us.size)]))
        return replace(moved, sequence=wire.sequence[: moved.us.size], us=wire.us[: moved.us.size])

    return lie


def stalled(lie: Lie, lasts_s: float) -> Lie:
    """The same, with reads held up from the middle of the gate."""

    def both(wire: Wire, rng: np.random.Generator) -> Wire:
        return replace(lie(wire, rng), stalls=(((wire.top_s + wire.bottom_s) / 2, lasts_s),))

    return both


def two_feet(wire: Wire, rng: np.random.Generator) -> Wire:
    """Every other sample inside the gate sees another foot, which rests high."""
    other = wire.inside & (np.arange(wire.us.size) % 2 == 1)
    return replace(wire, mm=np.where(other, 60.0, wire.mm))


NO_FRAMES = "no frames from the gate on"

LIES: dict[str, Lie] = {
    "clock twice as fast": clock(2.0),
    "clock half as fast": clock(0.5),
    "clock 10 % fast": clock(1.1),
    "clock 10 % slow": clock(0.9),
    "clock 3 % fast": clock(1.03),
    "clock 3 % slow": clock(0.97),
    "times twice as far apart": stamps(2.0),
    "times half as far apart": stamps(0.5),
    "times 3 % too far apart": stamps(1.03),
    "times 10 % too close": stamps(0.9),
    **{f"time jumps by {ms:+} ms in the gate": jump(ms, "in") for ms in (5, 20, 50, 1000, -5, -20, -1000)},
    **{f"time jumps by {ms:+} ms before the gate": jump(ms, "before") for ms in (20, 1000, -20)},
    **{f"time jumps by {ms:+} ms after the gate": jump(ms, "after") for ms in (20, 1000, -20)},
    **{f"time and numbers jump by {ms} ms in the gate": jump(ms, "in", numbered=True) for ms in (20, 50)},
    "the device stands still for 20 ms in the gate": halted(20),
    "time jumps by +20 ms in a stall of 100 ms": stalled(jump(20, "in"), 0.1),
    "time frozen for 5 frames": frozen(5),
    "one spike up in the gate": height(spike(30)),
    "one spike down in the gate": height(spike(-14)),
    "one small spike in the gate": height(spike(2)),
    "one spike to the panel, from rest": height(to(0.0, 1), "before"),
    "one spike to the panel, in the gate": height(to(0.0, 1)),
    "two false readings up in the gate": height(spike(30, 2)),
    "two false readings at the panel, from rest": height(to(0.0, 2), "before"),
    "two false readings at the panel, in the gate": height(to(0.0, 2)),
    "a ramp up by 20 mm in the gate": height(ramp(20, 5)),
    "a ramp down by 12 mm in the gate": height(ramp(-12, 5)),
    "the height stuck for 15 frames": height(stuck(15)),
    "the height stuck for good": height(stuck(10**6)),
    "the height saturated in the gate": height(to(50.0, 20)),
    "heights shifted by +3 mm in the gate": height(offset(3)),
    "heights shifted by -3 mm in the gate": height(offset(-3)),
    "a burst of noise of 5 mm in the gate": height(burst(5, 20)),
    "a burst of noise of 20 mm at rest": height(burst(20, 60), "before"),
    "20 frames lost in the gate": lost(20, numbered=True),
    "5 frames lost in the gate, and not counted": lost(5, numbered=False),
    NO_FRAMES: silent,
    "two frames swapped": swapped,
    "ten frames sent again": again,
    "the device restarts in the gate": restart,
    "500 Hz where 1000 are stated": slowed(0.5),
    "two feet at once": two_feet,
}


def _lies(size: Size) -> Iterator[Count]:
    seeds = size.of(1, 2)
    for place, (name, lie) in enumerate(LIES.items()):
        tried, failures = 0, []
        for at, speed_mm_s in enumerate(SPEEDS_MM_S if size is Size.WHOLE else SPEEDS_MM_S[place % 5 :: 5]):
            for seed in range(seeds):
                rng = np.random.default_rng([place, at, seed])
                wire = honest(rng, speed_mm_s, rate_hz=(1000, 5000)[(at + seed) % 4 == 3])
                tried += 1
                found = fed(lie(wire, rng), rng)
                # One false reading sets nothing off: the step counts, and its contact is the true one.
                named = SILENT if name == NO_FRAMES else NAMED
                failure = unmoved(found, wire) if name.startswith("one ") else wrong(found, wire.speed_mm_s, named)
                if failure:
                    failures.append(f"{speed_mm_s:g} mm/s, seed {seed}: {failure}")
        yield Count(f"lying tracker: {name}", tried, tried - len(failures), 0, tuple(failures))


def held_up(lasts_s: float, every_s: float) -> Lie:
    """Reads are held up again and again, as on a busy machine."""

    def late(wire: Wire, rng: np.random.Generator) -> Wire:
        begins = np.arange(rng.uniform(0, every_s), wire.at_s[-1], every_s).tolist()
        return replace(wire, stalls=tuple((float(begin), float(rng.uniform(lasts_s / 2, lasts_s))) for begin in begins))

    return late


def missing(part: float, at_once: int = 1) -> Lie:
    def less(wire: Wire, rng: np.random.Generator) -> Wire:
        begins = rng.random(wire.us.size) < part / at_once
        return wire.only(~np.convolve(begins, np.ones(at_once, bool))[: wire.us.size].astype(bool))

    return less


def jittered(us: float) -> Lie:
    """Samples taken, and stamped, a little off their time."""

    def off(wire: Wire, rng: np.random.Generator) -> Wire:
        by_us = rng.uniform(-us, us, wire.us.size)
        mm = np.interp(wire.at_s + by_us / 1e6, wire.at_s, wire.mm)
        return replace(wire, us=wire.us + np.rint(by_us).astype(np.int64), mm=mm)

    return off


@dataclass(frozen=True)
class Good:
    """A good device in a bad place."""

    drift: float = 0.0
    noise_mm: float = 0.01
    rate_hz: int = 1000
    hesitation: Hesitation = "none"
    start_us: int | None = None
    place: Lie = lambda wire, rng: wire


GOOD: dict[str, Good] = {
    "clock 1 % fast": Good(drift=0.01),
    "clock 1 % slow": Good(drift=-0.01),
    "clock 0.5 % fast, stalls of 31 ms": Good(drift=0.005, place=held_up(0.031, 0.1)),
    "stalls of 100 ms": Good(place=held_up(0.1, 0.25)),
    "a stall of 300 ms from the gate on": Good(place=stalled(lambda wire, rng: wire, 0.3)),
    "reads every 40 ms": Good(place=lambda wire, rng: replace(wire, pause_s=0.04)),
    "clock 1 % slow, reads every 16 ms, stalls": Good(
        drift=-0.01, place=lambda wire, rng: replace(held_up(0.05, 0.2)(wire, rng), pause_s=0.016)
    ),
    "2 % of frames lost": Good(place=missing(0.02)),
    "5 % lost, 5 at once": Good(place=missing(0.05, 5)),
    "2 % of frames damaged": Good(place=lambda wire, rng: replace(wire, damage=0.02)),
    "times 0.1 ms off": Good(place=jittered(100.0)),
    "counters that wrap": Good(start_us=2**32 - 1_800_000),
    "5 kHz": Good(rate_hz=5000),
    "a foot that pauses": Good(hesitation="pause"),
    "a foot that turns back first": Good(hesitation="dip"),
    "noise of 0.1 mm": Good(noise_mm=0.1),
    "noise of 0.1 mm, 5 kHz, stalls": Good(noise_mm=0.1, rate_hz=5000, place=held_up(0.031, 0.1)),
}


def _honest(size: Size) -> Iterator[Count]:
    for place, (name, good) in enumerate(GOOD.items()):
        failures = []
        tries = size.of(1, 15)
        for seed in range(tries):
            rng = np.random.default_rng([100 + place, seed])
            wire = good.place(
                honest(
                    rng,
                    float(rng.uniform(50, 400)),
                    rate_hz=good.rate_hz,
                    drift=good.drift,
                    noise_mm=good.noise_mm,
                    hesitation=good.hesitation,
                    start_us=good.start_us,
                ),
                rng,
            )
            found = fed(wire, rng, good.hesitation)
            # Noise of 0.1 mm alone moves a speed by 1.4 % rms: there only a refusal is a false alarm.
            noisy = good.noise_mm > 0.05 and isinstance(found, WatchedStep)
            if failure := "" if noisy else unmoved(found, wire):
                failures.append(f"seed {seed}: {failure}")
        yield Count(f"good tracker: {name}", tries, tries - len(failures), 0, tuple(failures))


class Driver:
    """A driver of a laboratory's own, whose fifth read is spoilt."""

    def __init__(self, spoil: Callable[[Driver, Samples], object], clock: ManualClock) -> None:
        self._spoil, self._clock, self._read = spoil, clock, 0
        self.counts = LinkCounts()
        self.clock_map = ClockMap(0, clock.now_ns())

    def read(self) -> Samples:
        self._read += 1
        if self._read > 20:
            raise RuntimeError("nothing more was scripted")
        self._clock.sleep_ns(4_000_000)
        us = np.arange(4, dtype=np.int64) * 1000 + 4000 * self._read
        samples = Samples(us, np.full(4, 50.0), bytes(48), np.arange(1, 5) * 12, self._clock.now_ns())
        return cast("Samples", self._spoil(self, samples)) if self._read == 5 else samples

    def drain(self) -> None:
        pass

    def reconnect(self, timeout_s: float) -> None:
        pass

    def close(self) -> None:
        pass


def _with(name: str, at: int, value: object) -> Callable[[Driver, Samples], object]:
    def spoilt(driver: Driver, samples: Samples) -> object:
        array = getattr(samples, name).astype(float if isinstance(value, float) else np.int64)
        array[at] = value
        return replace(samples, **{name: array})

    return spoilt


def _counted(*counts: object) -> Callable[[Driver, Samples], object]:
    def spoilt(driver: Driver, samples: Samples) -> object:
        driver.counts = LinkCounts(*counts)  # type: ignore[arg-type]
        return samples

    return spoilt


SPOILT: dict[str, Callable[[Driver, Samples], object]] = {
    **{f"a height of {value}": _with("height_mm", 2, value) for value in (np.nan, np.inf, -np.inf)},
    **{f"a device time of {value}": _with("device_us", 2, value) for value in (np.nan, np.inf, 21_500.5)},
    "equal device times": _with("device_us", 2, 21_000),
    "a device time that falls": _with("device_us", 2, 5),
    "a device time before the last read's": _with("device_us", 0, 19_000),
    "a time that falls by the largest number": _with("device_us", 3, -(2**63)),
    "an end beyond the bytes": _with("ends", 3, 49),
    "ends that fall": _with("ends", 3, 2),
    "an end below nothing": _with("ends", 0, -1),
    "arrays of two dimensions": lambda driver, samples: replace(
        samples, device_us=samples.device_us[:, None], height_mm=samples.height_mm[:, None], ends=samples.ends[:, None]
    ),
    "arrays of two lengths": lambda driver, samples: replace(samples, height_mm=samples.height_mm[:3]),
    "nothing": lambda driver, samples: samples.cut(0)[0],
    "no samples": lambda driver, samples: None,
    "an arrival that goes back": lambda driver, samples: replace(samples, arrived_ns=5),
    "an arrival at no time": lambda driver, samples: replace(samples, arrived_ns=cast("int", np.nan)),
    "counts below nothing": _counted(-1, 0, 0, 0),
    "counts that are no whole numbers": _counted(0, np.nan, 0, 0),
    "counts of text": _counted("0", 0, 0, 0),
}


def _drivers() -> Iterator[Count]:
    failures = []
    for name, spoil in SPOILT.items():
        clock = ManualClock(10**18)
        found = outcome(GuardedTracker(Driver(spoil, clock), "lab:Tracker"), BASE, clock)
        if not isinstance(found, str) or "its driver 'lab:Tracker' failed at" not in found or "scripted" in found:
            failures.append(f"{name}: {found}")
    yield Count("driver that gives what cannot be", len(SPOILT), len(SPOILT) - len(failures), 0, tuple(failures))


Spoiler = Callable[[list[bytes], np.random.Generator], list[bytes]]


def flipped(frames: list[bytes], rng: np.random.Generator) -> list[bytes]:
    """One to eight bits of each frame are flipped."""
    times = rng.integers(1, 9, len(frames)).tolist()
    places = iter(rng.integers(0, FRAME_BYTES[1] * 8, sum(times)).tolist())
    spoilt = []
    for frame, flips in zip(frames, times, strict=True):
        bits = bytearray(frame)
        for _ in range(flips):
            at = next(places)
            bits[at // 8] ^= 1 << at % 8
        spoilt.append(bytes(bits))
    return spoilt


def cut(frames: list[bytes], rng: np.random.Generator) -> list[bytes]:
    """Each frame loses its beginning, or its end."""
    places = rng.integers(1, FRAME_BYTES[1], len(frames)).tolist()
    return [frame[at:] if at % 2 else frame[:at] for frame, at in zip(frames, places, strict=True)]


def spliced(frames: list[bytes], rng: np.random.Generator) -> list[bytes]:
    """Each frame has the end of another."""
    places = rng.integers(1, FRAME_BYTES[1], len(frames)).tolist()
    others = rng.integers(0, len(frames), len(frames)).tolist()
    return [frame[:at] + frames[other][at:] for frame, at, other in zip(frames, places, others, strict=True)]


def replaced(frames: list[bytes], rng: np.random.Generator) -> list[bytes]:
    """Bytes at random, as of another device or baud rate, in place of frames; a 0x00 ends them as it ends a frame."""
    data = rng.bytes(FRAME_BYTES[1] * len(frames))
    return [data[at : at + FRAME_BYTES[1] - 1] + b"\0" for at in range(0, len(data), FRAME_BYTES[1])]


SPOILERS: dict[str, Spoiler] = {
    "bits flipped": flipped,
    "cut": cut,
    "spliced": spliced,
    "bytes at random": replaced,
}


def _frames(size: Size) -> Iterator[Count]:
    """Three of four frames of a moving foot are spoilt; no reading may be believed that no frame held."""
    for place, (name, spoiler) in enumerate(SPOILERS.items()):
        tried = size.of(3_000, 250_000)
        rng = np.random.default_rng([200, place])
        seconds = np.arange(tried * 4 // 3) / 1e3
        counts = BASE.counts(25 + 20 * np.sin(2 * np.pi * seconds) + rng.normal(0, 0.1, seconds.size)).tolist()
        good = [encode(at, 1000 * at, reading) for at, reading in enumerate(counts)]
        spoilt = spoiler(good, rng)
        wire = [frame if at % 4 == 0 else spoilt[at] for at, frame in enumerate(good)]
        scrutiny = Scrutiny(rate_hz=1000, noise_mm=0.1)
        decoder, sifted, held, invented = Decoder(period_us=1000.0), Sifted(), 0, []
        for at in range(0, len(wire), 100):
            decoder, found = decoder.feed(b"".join(wire[at : at + 100]))
            samples = Samples(found.device_us, found.counts.astype(float) * COUNT_MM, b"", found.ends, 0)
            sifted, believed = scrutiny.sift(sifted, samples)
            held += believed.device_us.size
            for us, mm in zip(believed.device_us.tolist(), believed.height_mm.tolist(), strict=True):
                sent = us // 1000
                if us % 1000 or not 0 <= sent < len(counts) or counts[sent] != round(mm / COUNT_MM):
                    invented.append(f"{us} us, {mm:.1f} mm")
            if found.restarted:
                # The rest of another good frame may be whole: told as a restart, which ends a session in words.
                decoder, sifted = Decoder(period_us=1000.0), Sifted()
        failures = invented if held else ["no reading was believed, so that nothing was tried"]
        yield Count(f"spoilt frames: {name}", tried, tried - len(failures), len(invented), tuple(failures))


def _real_time(size: Size) -> Iterator[Count]:
    """The same lies through a pseudo-terminal, by the wall clock."""
    names = ("clock twice as fast", "time jumps by +20 ms in the gate", "two false readings up in the gate")
    tried, failures = 0, []
    for name in names[: size.of(1, 3)]:
        rng = np.random.default_rng([300, tried])
        wire = honest(rng, 250.0)
        tried += 1
        if failure := wrong(_live(LIES[name](wire, rng), rng), wire.speed_mm_s):
            failures.append(f"{name}: {failure}")
    rng = np.random.default_rng([300, tried])
    wire = honest(rng, 250.0)
    tried += 1
    if failure := unmoved(_live(wire, rng), wire):
        failures.append(f"a good tracker: {failure}")
    yield Count("trackers on a pseudo-terminal, in real time", tried, tried - len(failures), 0, tuple(failures))


def _live(wire: Wire, rng: np.random.Generator) -> WatchedStep | str:
    clock = MonotonicClock()
    frames = encoded(wire, rng)

    def send() -> None:
        begun_ns, done = clock.now_ns(), 0
        while done < len(frames):
            clock.sleep_ns(2_000_000)
            until = int(np.searchsorted(wire.at_s, (clock.now_ns() - begun_ns) / 1e9))
            line.write(b"".join(frames[done:until]))
            done = until

    with SerialLine() as line, closing(SerialTracker(line.url, wire.settings, clock=clock)) as tracker:
        device = threading.Thread(target=send)
        device.start()
        try:
            return outcome(tracker, wire.settings, clock)
        finally:
            device.join()


def attacks(size: Size) -> Iterator[Count]:
    """Yield a row for each lie, for what drivers give, for spoilt frames, and for good trackers in bad places."""
    yield from _lies(size)
    yield from _real_time(size)
    yield from _drivers()
    yield from _frames(size)
    yield from _honest(size)
