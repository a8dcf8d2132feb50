"""Runs of frames against the library `cobs` and `binascii`, frame by frame, and against a stream that is cut small."""

from __future__ import annotations

import struct
from binascii import crc_hqx

import numpy as np
import pytest
from cobs import cobs
from hypothesis import given
from hypothesis import strategies as st

from palpate.experiment.apparatus.tracker import frame_runs
from palpate.experiment.apparatus.tracker.frame_runs import FEWEST, FRAME_BYTES, Run
from palpate.experiment.apparatus.tracker.frames import Decoder, Frames, LinkCounts

SEEDS = st.integers(0, 2**32 - 1)
READINGS = st.sampled_from([1, 2])


def frame(number: int, clock_us: int, *readings: int) -> bytes:
    sample = struct.pack("<HI" + "H" * len(readings), number % 2**16, clock_us % 2**32, *readings)
    return bytes(cobs.encode(sample + struct.pack("<H", crc_hqx(sample, 0xFFFF)))) + b"\0"


def drawn(rng: np.random.Generator, count: int, readings: int) -> Run:
    """Return frames with many zeros, and some numbers and clocks that wrap."""
    number, clock_us, *raw = (
        rng.integers(0, 2**bits, count) * rng.integers(0, 2, count) for bits in (17, 33, *[16] * readings)
    )
    return Run(number, clock_us, np.column_stack(raw))


@given(SEEDS, READINGS)
def test_a_run_is_sent_as_its_frames_and_read_back(seed: int, readings: int) -> None:
    run = drawn(np.random.default_rng(seed), 50, readings)
    sent = frame_runs.encode(run)
    assert sent == b"".join(map(frame, run.number.tolist(), run.clock_us.tolist(), *run.readings.T.tolist()))
    read = frame_runs.decode(sent, readings)
    wraps = (2**16, 2**32, 2**16)
    assert all((got == field % wrap).all() for got, field, wrap in zip(read, run, wraps, strict=True))


@given(SEEDS, READINGS, st.integers(0, 19), st.integers(0, 14 * 8 - 1))
def test_a_run_ends_before_a_frame_with_a_wrong_bit(seed: int, readings: int, place: int, bit: int) -> None:
    length = FRAME_BYTES[readings]
    sent = bytearray(frame_runs.encode(drawn(np.random.default_rng(seed), 20, readings)))
    sent[place * length + bit // 8 % length] ^= 1 << bit % 8
    assert frame_runs.decode(bytes(sent), readings).number.size == place


@given(SEEDS, READINGS)
def test_frames_of_the_other_kind_are_no_run(seed: int, readings: int) -> None:
    sent = frame_runs.encode(drawn(np.random.default_rng(seed), 84, readings))
    assert frame_runs.decode(sent, 3 - readings).number.size == 0


@pytest.mark.parametrize("readings", [1, 2])
def test_nothing_and_bytes_that_are_no_frame_are_no_run(readings: int) -> None:
    for data in (b"", b"\0" * 84, b"\1" * 84, frame(1, 2, *[3] * readings)[:-1]):
        assert frame_runs.decode(data, readings).number.size == 0


def fed(decoder: Decoder, data: bytes, most: int) -> tuple[Decoder, list[Frames]]:
    frames = []
    for begin in range(0, len(data), most):
        decoder, found = decoder.feed(data[begin : begin + most])
        frames.append(found)
    return decoder, frames


@given(SEEDS, st.sampled_from([None, 1000.0]), st.integers(0, 4), READINGS)
def test_a_long_piece_is_read_as_many_short_ones(
    seed: int, period_us: float | None, faults: int, readings: int
) -> None:
    rng = np.random.default_rng(seed)
    count = 6 * FEWEST
    numbers = int(rng.integers(0, 2**16)) + np.arange(count)
    clocks_us = int(rng.integers(0, 2**32)) + 1000 * np.arange(count) + rng.integers(-100, 100, count)
    for at in rng.integers(1, count, int(rng.integers(0, 3))):
        # A pause, or a device that restarts.
        clocks_us[at:] += int(rng.choice([500_000, -700_000]))
    raw = rng.integers(0, 2**16, (readings, count)).tolist()
    sent = [frame(*one) for one in zip(numbers.tolist(), clocks_us.tolist(), *raw, strict=True)]
    for at in rng.integers(0, count, faults):
        sent[at] = [b"", sent[at] * 2, sent[at][:5], sent[at] + b"\0", bytes([1]) + sent[at][1:]][rng.integers(0, 5)]
    data = b"".join(sent)
    begun, short = Decoder(period_us=period_us, readings=readings), 5 * FRAME_BYTES[readings]
    whole, (at_once,) = fed(begun, data, len(data))
    cut, pieces = fed(begun, data, short)
    assert (whole.sequence, whole.device_us, whole.damaged) == (cut.sequence, cut.device_us, cut.damaged)
    assert at_once.device_us.tolist() == [us for piece in pieces for us in piece.device_us.tolist()]
    for one in ("counts", "along"):
        assert getattr(at_once, one).tolist() == [read for piece in pieces for read in getattr(piece, one).tolist()]
    assert at_once.along.size == (readings - 1) * at_once.counts.size
    begins = np.cumsum([0] + [short] * (len(pieces) - 1)).tolist()
    ends = [begin + end for begin, piece in zip(begins, pieces, strict=True) for end in piece.ends.tolist()]
    assert at_once.ends.tolist() == ends
    link = LinkCounts()
    for piece in pieces:
        link = link.plus(piece.link)
    assert at_once.link == link
    assert at_once.restarted == pieces[-1].restarted
