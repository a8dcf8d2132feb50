"""macOS: what is different there, beside the names that `systems.py` hides.

Sources: the documentation of `multiprocessing` ("the spawn start method should be considered the default" on macOS),
and `man 4 unix` of macOS, whose addresses are paths of at most 104 bytes with their end, and never abstract.
"""

from __future__ import annotations

import errno
import os
from collections.abc import Mapping
from typing import Any

from tests.portable.masks.hiding import Call, Mask
from tests.portable.masks.systems import MACOS

_LONGEST = 103
"""Bytes of the path of a socket."""


def _multiprocessing(_mask: Mask, real: Any) -> Mapping[str, object]:
    real.set_start_method("spawn", force=True)
    return {}


def _socket(mask: Mask, real: Any) -> Mapping[str, object]:
    def make(call: Call) -> Call:
        def at_a_path(end: Any, address: Any) -> None:
            if end.family == real.AF_UNIX:
                path = os.fsencode(address)
                if path.startswith(b"\0"):
                    raise OSError(errno.ENOENT, os.strerror(errno.ENOENT))
                if len(path) > _LONGEST:
                    raise OSError("AF_UNIX path too long")
            call(end, address)

        return at_a_path

    for name in ("bind", "connect"):
        mask.substitute(real.socket, name, make)
    return {}


MASK = Mask(
    MACOS,
    functions={},
    modules={
        "multiprocessing": _multiprocessing,
        "socket": _socket,
        "sys": lambda _mask, _real: {"platform": MACOS.platform},
    },
)
