"""How often the tracker's line is read: as a falling foot needs it, and less often while the foot rests or rises.

Waking up costs more than the frames that a read finds. After a read that found no backlog the thread pauses, 1.6 ms at
1 kHz and 6 ms from 5 kHz on, and a sample is older by no more than that when it is read. Predictions bear it: at 5 kHz
with 0.1 mm of noise their SD is 0.39 ms at a lead of 8 ms, against 0.30 ms where every sample is read at once.

Most of a session the foot rests, above the panel or on it, or is lifted, and nothing waits for its samples: then the
pause is 12 ms. The newest height of each read tells. A foot that lies `MOVED_MM` or more from a reference replaces it:
below it falls, above it rises; a falling one must lie `RISEN_MM` above it. A reference older than `REFERENCE_US` of
device time is replaced too, and if the foot had not moved, it rests. Until the first reading it counts as falling. What
follows:

- A foot that falls faster than 20 mm/s, the least scale of the prediction, is read as if there were no rest once it is
  seen to, however its stream is cut into reads. A slower one may count as resting: in 12 ms it moves less than 0.24 mm.
- One that turns back above the panel counts as rising 3 mm or more above its lowest reading, and by then the prediction
  knows.
- One that turns to fall, and then falls faster than 20 mm/s, is seen at most one pause after it has fallen 3 mm below
  its highest reading. That may be late for a passage that begins within the gate, never for one that begins above it.
- A foot that falls from rest, faster than 20 mm/s, is seen at most one pause after it has fallen 2.5 mm: its reference
  may be half of one below it, and be replaced within the first 1.5. One that reaches 400 mm/s at the gate's top, 30 mm
  below, has fallen 2.5 mm after 43 ms: it is seen after 55 ms, 4.1 mm down, and reaches the gate after 150 ms.
- Above the highest calibrated point a foot seems to rest, however it moves. That point lies 5 mm or more above the
  gate: a foot of 400 mm/s that comes from there is seen 1.8 mm into the gate at the latest, and a gate is not given
  until 1 mm below its bottom.
- A foot of 100 mm/s that stops on its way down counts as falling for 34 ms more or longer: its reference is 10 ms old
  at most, and the read that finds it a millimetre lower comes up to 6 ms later. If its stop is not plain by then, it is
  noticed 12 ms later at most.
- Samples of a foot that rests or rises wait for up to 12 ms, and for the system's own delay, until they are read: the
  first after arming, and the last of the 100 ms that are recorded after a contact, may come so much later.
- The clock map gets eight reads in each of its shortest stretches, of which it keeps the one with the least delay.
- A line has to hold what comes in a pause: 720 bytes at 5 kHz, where systems hold 4096 or more.
- Silence is noticed as before: the reader waits as long, and the last frames before it are read within `SILENCE_PART`
  of it, which with the part that is spent waiting (serial_tracker.py) makes less than the whole; or, where that is
  longer, within a falling foot's pause: at 5 kHz and 50 ms of silence allowed, 51 ms after the last frame.
"""

from __future__ import annotations

from typing import NamedTuple

from experiment.apparatus.frames import FRAME_BYTES

PAUSE_S = 0.5e-3
PAUSE_PER_HZ_S = 1.1e-6
"""Pause after a read of a falling foot, s, and how much longer it is for each Hz of the device's rate."""

LONGEST_PAUSE_S = 6e-3
"""It is never longer, s."""

CALM_PAUSE_S = 12e-3
"""Pause after any other read, s: half as many reads as with 6 ms, and the fastest foot is seen in time."""

SILENCE_PART = 0.06
"""That pause is at most this part of the silence allowed, but never shorter than a falling foot's."""

MOVED_MM = 1.0
"""A height so far from the reference is a movement, mm: seven standard deviations of the difference between two
readings of a noisy sensor (0.1 mm)."""

RISEN_MM = 3.0
"""A foot that fell has to be so far above the reference to rise, mm: a noisier sensor does not make it rise, and one
that turned back is read often until the prediction knows."""

REFERENCE_US = 50_000
"""How long a reference lasts, device time, microseconds."""


class Pause(NamedTuple):
    """How long to pause after a read.

    Attributes:
        ns: its length, ns.
        calm_bytes: a read after it that brings no more than this found no backlog: what the pause brings, and as much
            again.
    """

    ns: int
    calm_bytes: int


class Pauses(NamedTuple):
    """The pauses for one device: after a read of a falling foot, and of one that rests or rises."""

    falling: Pause
    calm: Pause


def pauses(*, rate_hz: int, stall_ms: int) -> Pauses:
    """The pauses for a device.

    Args:
        rate_hz: frames a second.
        stall_ms: the silence allowed, ms.
    """
    falling_s = min(PAUSE_S + rate_hz * PAUSE_PER_HZ_S, LONGEST_PAUSE_S)
    calm_s = max(falling_s, min(CALM_PAUSE_S, SILENCE_PART * stall_ms * 1e-3))
    return Pauses(_pause(falling_s, rate_hz), _pause(calm_s, rate_hz))


class Pace(NamedTuple):
    """How the foot moves, as far as reading it goes.

    Attributes:
        device_us: when the reference was read, device time, microseconds.
        height_mm: height of the reference, mm.
        falls: whether the foot falls.
    """

    device_us: int
    height_mm: float
    falls: bool


def init(device_us: int, height_mm: float) -> Pace:
    """After the first read: the foot counts as falling.

    Args:
        device_us: device time of its newest sample, microseconds.
        height_mm: height of that sample, mm.
    """
    return Pace(device_us, height_mm, falls=True)


def step(pace: Pace, device_us: int, height_mm: float) -> Pace:
    """Take the next read.

    Args:
        pace: from `init` or the step before.
        device_us: device time of its newest sample, microseconds; later than any before.
        height_mm: height of that sample, mm.
    """
    moved_mm = height_mm - pace.height_mm
    if moved_mm <= -MOVED_MM or moved_mm >= (RISEN_MM if pace.falls else MOVED_MM):
        return Pace(device_us, height_mm, falls=moved_mm < 0)
    if device_us - pace.device_us > REFERENCE_US:
        return Pace(device_us, height_mm, falls=False)
    return pace


def _pause(pause_s: float, rate_hz: int) -> Pause:
    ns = round(pause_s * 1e9)
    return Pause(ns, FRAME_BYTES * (2 + 2 * ns * rate_hz // 1_000_000_000))
