"""What goes wrong between a simulated foot's sensor and its line."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

from palpate.experiment.apparatus.tracker.frames import FRAME_BYTES
from palpate.experiment.rehearsal.wires.serial_line import SerialLine


@dataclass(frozen=True)
class Faults:
    """What goes wrong in one step; frames are numbered from 0, the first of the step.

    Frames are never sent (`drop`), have a flipped bit (`corrupt`) or are sent twice (`repeat`). From `silent_from` on
    the device sends nothing, ever, and instead of `unplug_at` the line is unplugged.
    """

    drop: frozenset[int] = frozenset()
    corrupt: frozenset[int] = frozenset()
    repeat: frozenset[int] = frozenset()
    silent_from: int | None = None
    unplug_at: int | None = None

    def __call__(self, sent: bytes, number: int) -> tuple[bytes, Callable[[SerialLine], object] | None]:
        """Return the frames from `number` on as they are sent, and what then happens to the line; see `foot.Fails`."""
        frames = [sent[at : at + FRAME_BYTES[1]] for at in range(0, len(sent), FRAME_BYTES[1])]
        fails = self.end < number + len(frames)
        left = b"".join(_spoilt(frames[: max(int(self.end) - number, 0)] if fails else frames, number, self))
        if not fails:
            return left, None
        return left, (lambda line: line.unplug()) if self.end == self.unplug_at else (lambda _line: None)

    @property
    def end(self) -> float:
        """Return the first frame that is not sent; infinity if all are."""
        return min(frame if frame is not None else math.inf for frame in (self.silent_from, self.unplug_at))


def _spoilt(frames: list[bytes], number: int, faults: Faults) -> list[bytes]:
    """Return the frames from `number` on, as the faults leave them."""
    sent = []
    for i, frame in enumerate(frames, start=number):
        if i in faults.drop:
            continue
        sent.append(_flipped(frame) if i in faults.corrupt else frame)
        if i in faults.repeat:
            sent.append(frame)
    return sent


def _flipped(frame: bytes) -> bytes:
    """Return the frame with one bit of its second byte flipped; no byte becomes 0x00, which would tear it in two."""
    bit = 0x01 if frame[1] != 0x01 else 0x02
    return bytes([frame[0], frame[1] ^ bit, *frame[2:]])
