"""What a tracker gives, samples of the foot's position and counts of the link, and the wire format that brings them.

For the author of firmware; some is in `firmware/` beside this file. The device samples the sensor at a steady rate and
sends one frame a sample, 12 bytes, or 14 if it is planar:

    field      type    meaning
    sequence   uint16  rises by one with every sample, sent or not; 65535 is followed by 0
    device_us  uint32  the device's clock when the sample was taken, microseconds, wraps every 71.6 min
    counts     uint16  the sensor's reading of the height, raw
    along      uint16  of a planar tracker: the reading along the face; or that of a force sensor under the panel, raw
    crc        uint16  CRC-16/IBM-3740 (polynomial 0x1021, initial value 0xFFFF, neither reflected nor inverted;
                       "123456789" gives 0x29B1) of the bytes before it

Fields are little-endian and without padding. The ten bytes, or twelve, are stuffed by COBS (Cheshire and Baker 1999,
"Consistent overhead byte stuffing", IEEE/ACM Trans. Networking 7(2)), which makes one more without a zero, and 0x00
ends the frame. It takes 120 bits at 8N1, or 140, so a rate of 5 kHz needs 600 kbaud, or 700. Frames of the other kind
count as damaged.

How the stream is counted:

- received: good frames, repeated ones not among them.
- repeated: frames with the sequence number and the time of the one before. They are dropped.
- damaged: stretches between two 0x00 that are no frame (length, COBS or CRC). Where reading begins, the rest of a frame
  already under way is not counted.
- lost: sequence numbers that are missing and left no damaged stretch behind, modulo 65536.

A device that restarts has another clock, so its times must not be joined to those from before. The reader knows a
restart by a clock that stands still, or that goes back by anything but a wrap: read as a wrap it would have jumped
over `LONGEST_PAUSE_US`. From there on no frame is given out and `Frames.restarted` stays true.

One of 2^15 frames with an even number of wrong bits passes the CRC. So where the rate is known, a frame whose time does
not fit its number waits for the next, and counts as damaged unless that one follows it: two that agree are believed.
"""

from __future__ import annotations

import struct
from binascii import crc_hqx
from dataclasses import dataclass
from operator import add, sub
from typing import NamedTuple

import numpy as np
from cobs import cobs
from numpy.typing import NDArray

from palpate.experiment.apparatus.tracker import frame_runs
from palpate.experiment.apparatus.tracker.frame_runs import Run


@dataclass(frozen=True)
class Samples:
    """A run of foot positions, in the order the device sent them.

    Attributes:
        device_us: device time of each sample, microseconds, int64, shape (n,), strictly rising.
        height_mm: height of the sole above the panel, mm, float64, shape (n,).
        raw: the bytes taken from the line since the samples before, damaged frames included. Joined in order
            they decode to the same samples; a frame may be torn between two of them. A device that sends anything but
            the frames of frames.py has its driver encode them, for a session keeps its traces so.
        ends: where in `raw` each sample's frame ends, int64, shape (n,).
        arrived_ns: session time at which the last of them came, ns.
        along_mm: place along the face, mm, float64, shape (n,); None where the tracker is not planar.
    """

    device_us: NDArray[np.int64]
    height_mm: NDArray[np.float64]
    raw: bytes
    ends: NDArray[np.int64]
    arrived_ns: int
    along_mm: NDArray[np.float64] | None = None

    def cut(self, count: int) -> tuple[Samples, Samples]:
        """Return the first `count` of them, and the others."""
        end = int(self.ends[count - 1]) if count else 0
        us, mm, ends, along = self.device_us, self.height_mm, self.ends, self.along_mm
        first, others = (None, None) if along is None else (along[:count], along[count:])
        return (
            Samples(us[:count], mm[:count], self.raw[:end], ends[:count], self.arrived_ns, first),
            Samples(us[count:], mm[count:], self.raw[end:], ends[count:] - end, self.arrived_ns, others),
        )


class LinkCounts(NamedTuple):
    """What a serial link did since it was opened, in frames; the head of this module says what is counted as which."""

    received: int = 0
    lost: int = 0
    damaged: int = 0
    repeated: int = 0

    def plus(self, more: LinkCounts) -> LinkCounts:
        """Return the counts of both."""
        return LinkCounts(*map(add, self, more))

    def since(self, earlier: LinkCounts) -> LinkCounts:
        """Return the counts from `earlier` until now."""
        return LinkCounts(*map(sub, self, earlier))


FRAME_BYTES = frame_runs.FRAME_BYTES
"""Length of a frame of so many readings, the closing 0x00 included."""

LONGEST_PAUSE_US = 60_000_000
"""Longest jump across a wrap of the device's clock that is still taken for a wrap, microseconds."""

STRAY_PART = 0.25
"""A frame's time fits its number within this part of a period, for a stamp that jitters..."""

STRETCH_PART = 0.02
"""...and this part of the time since the frame before, for a resonator and a rate that is not quite that of the rig."""

_MOST_AT_ONCE = 8192
_SAMPLE = {readings: struct.Struct("<HI" + "H" * readings) for readings in (1, 2)}
_BODY = {readings: struct.Struct(sample.format + "H") for readings, sample in _SAMPLE.items()}
_CRC_START = 0xFFFF
_SEQUENCES = 1 << 16
_CLOCK = 1 << 32


class Frames(NamedTuple):
    """What one piece of the stream held.

    Attributes:
        device_us: unwrapped device time of each frame, microseconds, int64, shape (n,), strictly rising.
        counts: raw readings of the height, uint16, shape (n,).
        along: second raw readings, along the face or of a force, uint16, shape (n,); of frames with one, shape (0,).
        ends: where in the piece each frame ended (offset of the byte after its 0x00), int64, shape (n,); 0 or less
            for one that had waited since the piece before.
        link: frames counted in this piece.
        restarted: the device restarted, in this piece or before.
    """

    device_us: NDArray[np.int64]
    counts: NDArray[np.uint16]
    along: NDArray[np.uint16]
    ends: NDArray[np.int64]
    link: LinkCounts
    restarted: bool


def encode(sequence: int, device_us: int, *readings: int) -> bytes:
    """Return the frame of one reading or two; numbers are taken modulo 2^16, device time (microseconds) modulo 2^32."""
    sample = _SAMPLE[len(readings)].pack(sequence % _SEQUENCES, device_us % _CLOCK, *readings)
    stuffed: bytes = cobs.encode(sample + crc_hqx(sample, _CRC_START).to_bytes(2, "little"))
    return stuffed + b"\0"


class Decoder(NamedTuple):
    """Where reading stands. It never changes: `feed` gives the next one, a tuple, because that is made quickly.

    Attributes:
        near_us: the first time read is unwrapped to the one nearest to this, microseconds; the default leaves it as
            it was sent.
        sequence: of the last good frame; None before the first.
        device_us: unwrapped time of the last good frame.
        tail: bytes after the last 0x00.
        aligned: a 0x00 has been seen since reading began.
        gap_expected: bytes were thrown away since the last good frame.
        damaged: damaged stretches since the last good frame.
        restarted: the device restarted; nothing more is read.
        period_us: time from frame to frame, microseconds, if it is known.
        held: number, clock, readings and end of a frame that waits for the next to follow it.
        readings: of a frame: 1, or 2 of a tracker that is planar or reads a force.
    """

    near_us: int = _CLOCK // 2
    sequence: int | None = None
    device_us: int = 0
    tail: bytes = b""
    aligned: bool = False
    gap_expected: bool = False
    damaged: int = 0
    restarted: bool = False
    period_us: float | None = None
    held: tuple[int, int, tuple[int, ...], int] | None = None
    readings: int = 1

    @property
    def kind(self) -> str:
        """Return in words which frames are read, and by which key of the rig file."""
        has, size = "a" if self.readings == 2 else "no", FRAME_BYTES[self.readings]
        return f"{size} bytes per frame: the rig file has {has} tracker.along_calibration or tracker.force"

    def skipped(self) -> Decoder:
        """Return the decoder after bytes were thrown away: the gap they leave is not counted as lost."""
        return self._replace(tail=b"", aligned=False, gap_expected=self.sequence is not None, damaged=0, held=None)

    def feed(self, data: bytes) -> tuple[Decoder, Frames]:
        """Return the decoder for the next piece of the stream, and what this one held; it never raises."""
        stream, body, each = self.tail + data, _BODY[self.readings], FRAME_BYTES[self.readings]
        pieces = stream.split(b"\0")
        tail = pieces.pop()[:each]
        sequence, us, aligned, gap_expected = self.sequence, self.device_us, self.aligned, self.gap_expected
        damaged, restarted, held = self.damaged, self.restarted, self.held
        device_us: list[int] = []
        readings: list[int] = []
        ends: list[int] = []
        lost = damaged_here = repeated = 0
        end = -len(self.tail)
        # A few frames come at a time: a loop of few calls takes less time over them than numpy does. Many that nothing
        # is wrong with are read at once; where that finds few, it is tried again later and later. The first one after a
        # gap follows none, and is read alone.
        at, try_at, wait = 0, 0, frame_runs.FEWEST
        while at < len(pieces):
            tried = at >= try_at and len(pieces) - at >= frame_runs.FEWEST
            if tried and sequence is not None and held is None and not (restarted or gap_expected):
                begin = end + len(self.tail)
                run = frame_runs.decode(stream[begin : begin + _MOST_AT_ONCE * each], self.readings)
                run_us = _run_us(run, sequence, us, self.period_us)
                wait = frame_runs.FEWEST if run_us.size >= frame_runs.FEWEST else 2 * wait
                try_at = at + run_us.size + wait
                if run_us.size:
                    at += run_us.size
                    device_us += run_us.tolist()
                    readings += run.readings[: run_us.size].ravel().tolist()
                    ends += range(end + each, end + each * run_us.size + 1, each)
                    sequence, us, end = int(run.number[run_us.size - 1]), device_us[-1], ends[-1]
                    aligned, damaged = True, 0
                    continue
            piece = pieces[at]
            at += 1
            end += len(piece) + 1
            sample = _sample(piece, body)
            if sample is None:
                if piece and aligned:
                    damaged += 1
                    damaged_here += 1
                aligned = True
                continue
            number, clock_us, reading = sample
            aligned = True
            if sequence is None:
                sequence = number - 1
                us = clock_us - 1 + _CLOCK * round((self.near_us - clock_us) / _CLOCK)
            elif self.period_us is not None and not _fits(sequence, us, number, clock_us, self.period_us):
                if held is None or not _follows(held, number, clock_us):
                    if held is not None:
                        damaged += 1
                        damaged_here += 1
                    held = number, clock_us, reading, end
                    continue
            elif held is not None:
                held = None
                damaged += 1
                damaged_here += 1
            read = ((number, clock_us, reading, end),) if held is None else (held, (number, clock_us, reading, end))
            held = None
            for number, clock_us, reading, ended in read:
                forward_us, skipped = (clock_us - us) % _CLOCK, (number - sequence - 1) % _SEQUENCES
                if forward_us > LONGEST_PAUSE_US:
                    restarted = restarted or clock_us < us % _CLOCK
                elif forward_us == 0:
                    restarted = restarted or skipped != _SEQUENCES - 1
                if not restarted:
                    sequence = number
                    us += forward_us
                    if forward_us == 0:
                        repeated += 1
                    else:
                        if skipped > damaged and not gap_expected:
                            lost += skipped - damaged
                        gap_expected = False
                        device_us.append(us)
                        readings += reading
                        ends.append(ended)
                damaged = 0
        raw = np.array(readings, dtype=np.uint16).reshape(-1, self.readings)
        frames = Frames(
            np.array(device_us, dtype=np.int64),
            raw[:, 0],
            raw[:, 1:].ravel(),
            np.array(ends, dtype=np.int64),
            LinkCounts(len(device_us), lost, damaged_here, repeated),
            restarted,
        )
        if held is not None:
            held = (*held[:3], held[3] - end - len(tail))
        rest = aligned, gap_expected, damaged, restarted, self.period_us, held, self.readings
        return Decoder(self.near_us, sequence, us, tail, *rest), frames


def _sample(piece: bytes, fields: struct.Struct) -> tuple[int, int, tuple[int, ...]] | None:
    """Return sequence number, clock and readings; None where the stretch between two 0x00 is no such frame."""
    if len(piece) != fields.size + 1:
        return None
    try:
        body = cobs.decode(piece)
    except cobs.DecodeError:
        return None
    number, clock_us, *reading, crc = fields.unpack(body)
    return (number, clock_us, tuple(reading)) if crc_hqx(body[:-2], _CRC_START) == crc else None


def _run_us(run: Run, sequence: int, us: int, period_us: float | None) -> NDArray[np.int64]:
    """Return the unwrapped times of those frames of a run that follow the last good one, with nothing wrong."""
    forward_us = np.diff(run.clock_us, prepend=us % _CLOCK) % _CLOCK
    follows = run.number == (sequence + 1 + np.arange(run.number.size)) % _SEQUENCES
    follows &= (forward_us > 0) & (forward_us <= LONGEST_PAUSE_US)
    if period_us is not None:
        follows &= np.abs(forward_us - period_us) <= (STRAY_PART + STRETCH_PART) * period_us
    count = follows.size if follows.all() else int(np.argmin(follows))
    return np.asarray(us + np.cumsum(forward_us[:count]), np.int64)


def _fits(sequence: int, us: int, number: int, clock_us: int, period_us: float) -> bool:
    """Return whether a frame's time fits its number, after the last good one; that one once more does."""
    steps, forward_us = (number - sequence) % _SEQUENCES, (clock_us - us) % _CLOCK
    stray_us = (STRAY_PART + STRETCH_PART * steps) * period_us if steps else 0.0
    return abs(forward_us - steps * period_us) <= stray_us


def _follows(held: tuple[int, int, tuple[int, ...], int], number: int, clock_us: int) -> bool:
    return number == (held[0] + 1) % _SEQUENCES and (clock_us - held[1]) % _CLOCK <= LONGEST_PAUSE_US
