"""What a simulated force device pushed, as it kept it in its file."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

from palpate.experiment.rehearsal.wires.force_device import PUSH


class Push(NamedTuple):
    """The force from a time of the machine's monotonic clock on, ns: N out of the block and along it."""

    at_ns: int
    out_n: float
    along_n: float
    why: int
    fast: bool


def pushed(record: Path) -> list[Push]:
    """Return what a device kept, in order."""
    return [
        Push(at, out, along, why, bool(fast)) for at, out, along, why, fast in PUSH.iter_unpack(record.read_bytes())
    ]
