"""MAT 5, as MATLAB and Octave write it: each numeric variable is channels; cells and structures stay closed.

The format is MathWorks' "MAT-File Format", level 5. scipy reads it, too, and may end the process at a damaged one.
"""

import struct
import zlib
from collections.abc import Iterator
from math import prod
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from palpate.experiment.errors import RecordingError
from palpate.experiment.recordings.formats.interface import (
    Channel,
    Format,
    channels_of,
    refuse_large,
    stated_step_s,
)
from palpate.experiment.settings.delimited import LARGEST

NAME = "MAT"
MATRIX, COMPRESSED = 14, 15
CLOSED = {
    1: "a cell array",
    2: "a structure",
    3: "an object",
    4: "text",
    5: "a sparse matrix",
    16: "a function",
    17: "an object",
}
COMPLEX = 0x0800
TYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
"""How the numbers of an element are stored, by its type; a matrix of doubles may be stored as bytes."""


class _Variable(NamedTuple):
    name: str
    values: NDArray[np.generic] | None
    closed: str


def read(content: bytes) -> tuple[list[Channel], str]:
    """Return the channels of a file. Raises `RecordingError` for one that is damaged or too large."""
    order = {b"IM": "<", b"MI": ">"}.get(content[126:128], "")
    try:
        if not order:
            raise ValueError("its header is not whole")
        held = [_variable(data, order) for data in _matrices(content, order)]
    except (ValueError, KeyError, struct.error, zlib.error) as error:
        raise RecordingError(
            f"got a damaged file of {NAME} ({error})", remedy="save it again", allowed="a whole one"
        ) from error
    numbers = [(one.name, one.values) for one in held if one.values is not None]
    if not numbers:
        closed = ", ".join(f"{one.name} ({one.closed})" for one in held) or "nothing"
        raise RecordingError(
            f"got a file of {NAME} that holds {closed}",
            remedy="save times and samples as variables of their own",
            allowed="variables that are numbers",
        )
    step_s = next((step for name, values in numbers if (step := stated_step_s(name, values)) > 0), np.nan)
    return [one for name, values in numbers for one in channels_of(name, values, step_s=step_s)], ""


def _elements(data: bytes, order: str) -> Iterator[tuple[int, bytes]]:
    """Yield the type and the bytes of each element; a small one has its bytes in its own tag."""
    place = 0
    while place < len(data):
        kind, size = struct.unpack_from(f"{order}II", data, place)
        if kind >> 16:
            yield kind & 0xFFFF, data[place + 4 : place + 4 + min(kind >> 16, 4)]
            place += 8
            continue
        found = data[place + 8 : place + 8 + size]
        if len(found) < size:
            raise ValueError("it is cut off")
        yield kind, found
        place += 8 + size + (0 if kind == COMPRESSED else -size % 8)


def _matrices(content: bytes, order: str) -> Iterator[bytes]:
    """Yield the bytes of each variable."""
    left = LARGEST
    for kind, data in _elements(content[128:], order):
        if kind == COMPRESSED:
            unpacked = zlib.decompressobj().decompress(data, left + 1)
            left -= len(unpacked)
            if left < 0:
                refuse_large([LARGEST // 8 + 1], NAME)
            ((kind, data),) = _elements(unpacked, order)
        if kind == MATRIX:
            yield data


def _variable(data: bytes, order: str) -> _Variable:
    parts = _elements(data, order)
    (_, flags), (_, sizes), (_, name) = (next(parts, (0, b"")) for _ in range(3))
    (about,) = struct.unpack_from(f"{order}I", flags)
    kind, bare = about & 0xFF, name.decode("utf-8", "replace")
    if kind in CLOSED or about & COMPLEX:
        return _Variable(bare, None, CLOSED.get(kind, "complex numbers"))
    shape = struct.unpack(f"{order}{len(sizes) // 4}i", sizes)
    stored, numbers = next(parts, (0, b""))
    refuse_large([max(prod(shape), 0)], NAME)
    if not prod(shape):
        return _Variable(bare, None, "nothing")
    values = np.frombuffer(numbers, dtype=np.dtype(order + TYPES[stored]))
    return _Variable(bare, values.astype(values.dtype.newbyteorder("=")).reshape(shape, order="F"), "")


FORMAT = Format(NAME, (b"MATLAB 5.0 MAT-file",), read)
