"""Random choices that are a pure function of what they are for: the same on every machine, for ever.

The bits are SHA-256 in counter mode. Library generators are free to change their streams between versions, and a
schedule must come out the same years later.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from typing import TypeVar

Item = TypeVar("Item")


class Draws:
    """A stream of random choices, named by its purpose."""

    def __init__(self, *purpose: str | int) -> None:
        """Begin the stream that `purpose` names; two streams are independent unless every part is equal."""
        self._key = hashlib.sha256(json.dumps(purpose, ensure_ascii=True).encode()).digest()
        self._counter = 0
        self._left = b""

    def below(self, bound: int) -> int:
        """A whole number from 0 to `bound` - 1, each equally likely, however large `bound` is.

        Raises:
            ValueError: `bound` is below 1.
        """
        if bound < 1:
            raise ValueError(f"got bound {bound}; allowed: at least 1")
        bits = (bound - 1).bit_length()
        # Every draw of so many bits is equally likely, so those that fit are too; more than half fit.
        while (drawn := self._bits(bits)) >= bound:
            pass
        return drawn

    def shuffled(self, items: Sequence[Item]) -> list[Item]:
        """`items` in a random order, every order of their places equally likely (Fisher and Yates)."""
        order = list(items)
        for last in range(len(order) - 1, 0, -1):
            other = self.below(last + 1)
            order[last], order[other] = order[other], order[last]
        return order

    def _bits(self, count: int) -> int:
        whole_bytes = (count + 7) // 8
        while len(self._left) < whole_bytes:
            self._left += hashlib.sha256(self._key + self._counter.to_bytes(16, "big")).digest()
            self._counter += 1
        taken, self._left = self._left[:whole_bytes], self._left[whole_bytes:]
        return int.from_bytes(taken, "big") >> (8 * whole_bytes - count)
