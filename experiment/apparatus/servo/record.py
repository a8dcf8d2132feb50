"""The force that a servo sent, cycle by cycle, in bytes for a file.

A cycle is on record while a block is rendered and the hand is near it or pushed; elsewhere the block's law asks for
nothing. `CYCLE` says what the bytes are.
"""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from palpate.experiment.synthesis.contact.block import Pair

NEAR_MM = 2.0
"""So near to the face a hand is on record, mm: whoever smooths its path needs it from before the touch. Ours."""

CYCLE = np.dtype(
    [
        ("number", "<u4"),
        ("samples", "<u4"),
        ("cycle", "<i8"),
        ("t_ns", "<i8"),
        ("place_mm", "<f4", 2),
        ("asked_n", "<f4", 2),
        ("sent_n", "<f4", 2),
    ]
)
"""`number` counts cycles on record from 0 since the servo began, so that a gap shows; `samples` are those of the
tracker since the cycle before; `cycle` is which of the servo's deadlines it met, `t_ns` when it began. Place and forces
are along the normal, then along the face: the newest sample, what the law asked of the observer's place and speed
before any limit, and what was sent."""

_PACKED = struct.Struct("<IIqqffffff")

AT_ONCE = 64 * _PACKED.size
"""So much is handed over at once, bytes."""


class ForceRecord:
    """What one servo has sent, until somebody takes it."""

    def __init__(self) -> None:
        self._number = 0
        self._kept = bytearray()
        self.near = False
        """Whether the newest cycle is on record."""

    def add(self, cycle: int, t_ns: int, samples: int, place_mm: Pair, asked_n: Pair, sent_n: Pair) -> bytes:
        """Put a cycle of a block that is rendered on record; return what is to be handed over now, mostly nothing."""
        self.near = place_mm[0] <= NEAR_MM or any(asked_n) or any(sent_n)
        if not self.near:
            return self.take() if self._kept else b""
        self._kept += _PACKED.pack(self._number % 2**32, samples, cycle, t_ns, *place_mm, *asked_n, *sent_n)
        self._number += 1
        return self.take() if len(self._kept) >= AT_ONCE else b""

    def take(self) -> bytes:
        """Return what was not handed over yet."""
        kept = bytes(self._kept)
        self._kept.clear()
        return kept


def cycles_of(raw: bytes, *, later_ns: int = 0) -> NDArray[np.void]:
    """Return the cycles in some bytes, shape (n,), their times moved by so much."""
    cycles = np.frombuffer(bytearray(raw), CYCLE)
    cycles["t_ns"] += later_ns
    return cycles


def lost_cycles(numbers: NDArray[np.int64], first: int) -> int:
    """Return how many cycles are missing from some that should begin with the number `first`, shape (n,).

    A servo that was opened anew counts from 0.
    """
    steps = np.diff(numbers, prepend=first - 1)
    return int(np.where(steps > 0, steps - 1, numbers).sum())
