"""Many frames of frames.py at once, by numpy, in rehearsals and datasets; fewer than `FEWEST` are faster one by one."""

from binascii import crc_hqx
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

FEWEST = 32
"""From so many frames on a run takes less time."""

FRAME_BYTES = {1: 12, 2: 14}
"""Length of a frame of so many readings, the closing 0x00 included."""

_CRC_START = 0xFFFF
_CRC = np.array([crc_hqx(bytes([byte]), 0) for byte in range(256)], np.uint16)
"""The CRC of each byte; `crc_hqx` has the polynomial of frames.py."""


class Run(NamedTuple):
    """Sequence numbers and clock, microseconds, of n frames, shape (n,), and raw readings, (n, 1), planar (n, 2)."""

    number: NDArray[np.int64]
    clock_us: NDArray[np.int64]
    readings: NDArray[np.int64]


def encode(run: Run) -> bytes:
    """Return the frames one after the other; numbers are taken modulo 2^16, clocks modulo 2^32."""
    fields = ((run.number, "<u2"), (run.clock_us, "<u4"), *((reading, "<u2") for reading in run.readings.T))
    sample = np.hstack([field.astype(kind)[:, None].view(np.uint8) for field, kind in fields])
    body = np.hstack([sample, _crc(sample.T).astype("<u2")[:, None].view(np.uint8)])
    length = body.shape[1]
    sent = np.zeros((run.number.size, length + 2), np.uint8)
    # COBS: each zero becomes the way to the next one, or to the end; so does a byte put before them all.
    following = np.full(run.number.size, length + 1, np.uint8)
    for place in range(length, 0, -1):
        zero = body[:, place - 1] == 0
        sent[:, place] = np.where(zero, following - place, body[:, place - 1])
        following[zero] = place
    sent[:, 0] = following
    return sent.tobytes()


def decode(data: bytes, readings: int) -> Run:
    """Return the good frames of so many readings with which `data` begins."""
    each = FRAME_BYTES[readings]
    count = len(data) // each
    sent = np.frombuffer(data, np.uint8, count * each).reshape(count, each).T.copy()
    good = (sent[-1] == 0) & sent[:-1].all(axis=0)
    # COBS: the first byte says where the next zero was, and what stands there where the one after it was.
    zero = sent[0].copy()
    for place in range(1, each - 1):
        here = zero == place
        zero[here] += sent[place, here]
        sent[place, here] = 0
    body = sent[1:-1]
    good &= (zero == each - 1) & (_crc(body[:-2]) == body[-2].astype(np.uint16) + (body[-1].astype(np.uint16) << 8))
    wide = body[:, : count if good.all() else int(np.argmin(good))].astype(np.int64)
    return Run(
        wide[0] + (wide[1] << 8),
        wide[2] + (wide[3] << 8) + (wide[4] << 16) + (wide[5] << 24),
        (wide[6:-2:2] + (wide[7:-2:2] << 8)).T,
    )


def _crc(fields: NDArray[np.uint8]) -> NDArray[np.uint16]:
    """Return the CRC of each column."""
    crc = np.full(fields.shape[1], _CRC_START, np.uint16)
    for bytes_ in fields:
        crc = (crc << 8) ^ _CRC[(crc >> 8) ^ bytes_]
    return crc
