"""MAT 5, as MATLAB and Octave write it: each numeric variable, or field of a structure, is channels.

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
    SCALES,
    Channel,
    Format,
    channels_of,
    nearest,
    refuse_large,
    stated_step,
    unit_beside,
)
from palpate.experiment.settings.delimited import LARGEST
from palpate.experiment.settings.units import Heading, is_clock, time_unit

NAME = "MAT"
MATRIX, COMPRESSED = 14, 15
STRUCTURE, TEXT = 2, 4
CLOSED = {
    1: "a cell array",
    2: "an array of structures",
    3: "an object",
    4: "text",
    5: "a sparse matrix",
    16: "a function",
    17: "an object",
}
COMPLEX = 0x0800
DEEPEST = 8
"""Structures within structures are opened so far."""

TYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
"""How the numbers of an element are stored, by its type; a matrix of doubles may be stored as bytes."""


class _Variable(NamedTuple):
    name: str
    values: NDArray[np.generic] | None
    closed: str
    text: str = ""


def read(content: bytes) -> tuple[list[Channel], str]:
    """Return the channels of a file. Raises `RecordingError` for one that is damaged or too large."""
    order = {b"IM": "<", b"MI": ">"}.get(content[126:128], "")
    try:
        if not order:
            raise ValueError("its header is incomplete")
        held = [one for data in _matrices(content, order) for one in _variables(data, order)]
    except (ValueError, KeyError, struct.error, zlib.error) as error:
        raise RecordingError(
            f"the {NAME} file is damaged ({error})", remedy="save it again", allowed="an undamaged file"
        ) from error
    numbers = [(one.name, one.values) for one in held if one.values is not None]
    if not numbers:
        closed = ", ".join(f"{one.name} ({one.closed})" for one in held) or "nothing"
        raise RecordingError(
            f"got a {NAME} file that contains {closed}",
            remedy="save times and samples as separate variables",
            allowed="numeric variables",
        )
    return _channels(held, numbers), ""


def _channels(held: list[_Variable], numbers: list[tuple[str, NDArray[np.generic]]]) -> list[Channel]:
    """Return the channels in numeric variables, each with what stands in its structure beside it."""
    texts = {one.name.lower(): one.text.strip() for one in held if one.text}
    units = {_split(one.name)[0]: one.text.strip() for one in held if _split(one.name)[1].lower() in ("unit", "units")}
    steps = {group: step for name, values in numbers for group, own in (_split(name),)
             if (step := stated_step(own, values, unit_beside(name.lower(), texts))) is not None}  # fmt: skip
    scales = {
        _split(name)[0]: name for name, values in numbers if values.size == 1 and _split(name)[1].lower() in SCALES
    }
    found: list[Channel] = []
    for name, values in numbers:
        group, own = _split(name)
        if values.dtype.kind in "iu" and values.size > 1 and group in scales:
            raise RecordingError(
                f"got {name} as whole numbers with {scales[group]!r}, which may be a scale factor",
                remedy="save physical values",
                allowed="samples in physical units",
            )
        unit = units.get(group, "")
        unit = unit if is_clock(own) == bool(unit and time_unit(Heading("", unit))) else ""
        found += channels_of(name, values, unit, nearest(group, steps))
    return found


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


def _split(name: str) -> tuple[str, str]:
    """Return the structure that a variable stands in, empty for none, and its own name."""
    group, _, own = name.rpartition("/")
    return group, own


def _variables(data: bytes, order: str, within: str = "", depth: int = 0) -> Iterator[_Variable]:
    """Yield a variable, or each field of a structure by its path, such as `trial/acceleration`."""
    parts = _elements(data, order)
    (_, flags), (_, sizes), (_, name) = (next(parts, (0, b"")) for _ in range(3))
    (about,) = struct.unpack_from(f"{order}I", flags)
    kind, bare = about & 0xFF, within or name.decode("utf-8", "replace")
    shape = struct.unpack(f"{order}{len(sizes) // 4}i", sizes)
    if kind == STRUCTURE and prod(shape) == 1 and depth < DEEPEST:
        for field, inner in _fields(parts, order):
            yield from _variables(inner, order, f"{bare}/{field}", depth + 1)
    elif kind == TEXT:
        yield _Variable(bare, None, CLOSED[kind], _text(next(parts, (0, b"")), order))
    elif kind in CLOSED or about & COMPLEX:
        yield _Variable(bare, None, CLOSED.get(kind, "complex numbers"))
    else:
        yield _numbers(bare, shape, next(parts, (0, b"")), order)


def _text(stored: tuple[int, bytes], order: str) -> str:
    """Return text as it is stored: in UTF-8, or in numbers of two bytes."""
    kind, raw = stored
    wide = "utf-16-le" if order == "<" else "utf-16-be"
    return raw.decode(wide if kind in (4, 17) else "utf-8", "replace")


def _fields(parts: Iterator[tuple[int, bytes]], order: str) -> Iterator[tuple[str, bytes]]:
    """Yield the name of each field of one structure, and its matrix; an empty one has no bytes, and is left out."""
    (_, size), (_, names) = (next(parts, (0, b"")) for _ in range(2))
    (length,) = struct.unpack(f"{order}i", size)
    if length < 1:
        raise ValueError("its structure has no field names")
    for at in range(0, len(names), length):
        kind, inner = next(parts, (0, b""))
        if kind == MATRIX and inner:
            yield names[at : at + length].split(b"\0")[0].decode("utf-8", "replace"), inner


def _numbers(name: str, shape: tuple[int, ...], stored: tuple[int, bytes], order: str) -> _Variable:
    kind, numbers = stored
    refuse_large([max(prod(shape), 0)], NAME)
    if not prod(shape):
        return _Variable(name, None, "nothing")
    values = np.frombuffer(numbers, dtype=np.dtype(order + TYPES[kind]))
    return _Variable(name, values.astype(values.dtype.newbyteorder("=")).reshape(shape, order="F"), "")


FORMAT = Format(NAME, (b"MATLAB 5.0 MAT-file",), read)
