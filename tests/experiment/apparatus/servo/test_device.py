"""The force device's messages, and what a device that answers late, wrongly or no more is told as."""

from __future__ import annotations

import socket
import struct
import time
from collections.abc import Iterator
from contextlib import contextmanager
from math import nan
from zlib import crc32

import pytest

from palpate.experiment.apparatus.servo.device import ANSWER, MESSAGE_BYTES, ForceDevice, decode, encode
from palpate.experiment.errors import ServoError
from tests.approved import Refuses


@contextmanager
def connected(limit_n: float = 2.0) -> Iterator[tuple[ForceDevice, socket.socket]]:
    with socket.create_server(("127.0.0.1", 0)) as server:
        ours = ForceDevice(f"127.0.0.1:{server.getsockname()[1]}", limit_n=limit_n)
        theirs, _ = server.accept()
        with theirs:
            yield ours, theirs
        ours.close()


def received(line: socket.socket) -> bytes:
    return line.recv(MESSAGE_BYTES, socket.MSG_WAITALL)


def test_a_message_is_as_the_module_says() -> None:
    body = struct.pack("<IIff", 7, 1, 0.5, -0.25)
    assert encode(7, (0.5, -0.25), fast=True) == body + struct.pack("<I", crc32(body))
    assert decode(encode(2**32 + 7, (0.5, -0.25), fast=False)) == (7, (0.5, -0.25), False)


def test_a_damaged_message_is_none() -> None:
    good = encode(7, (0.5, -0.25), fast=True)
    assert all(decode(good[:i] + bytes([good[i] ^ 4]) + good[i + 1 :]) is None for i in range(len(good)))


def test_what_is_pushed_is_bounded_and_nothing_at_the_end() -> None:
    with connected() as (ours, theirs):
        for force in ((30.0, 40.0), (nan, 1.0)):
            # In simulated time, in which a busy machine makes no force old.
            ours.push(force, fast=False, now_ns=None)
        sent = [decode(received(theirs)), decode(received(theirs))]
        ours.close()
        sent.append(decode(received(theirs)))
    assert [one[0] for one in sent if one] == [0, 1, 2]
    assert [one[1] for one in sent if one] == [pytest.approx((2.0, 0.0)), (0.0, 0.0), (0.0, 0.0)]


def test_a_force_that_waited_for_longer_than_the_device_holds_one_is_none() -> None:
    """Its process was stopped between the law and the line: the hand may be anywhere by now."""
    with connected() as (ours, theirs):
        assert ours.push((1.0, 0.5), fast=True, now_ns=time.monotonic_ns() - 2_000_000) == (0.0, 0.0)
        assert ours.push((1.0, 0.5), fast=True, now_ns=time.monotonic_ns()) == (1.0, 0.5)
        sent = [decode(received(theirs)), decode(received(theirs))]
    assert sent == [(0, (0.0, 0.0), True), (1, (1.0, 0.5), True)]


def test_an_answer_that_is_awaited_is_late_from_when_its_message_was_sent() -> None:
    with connected() as (ours, theirs):
        ours.push((1.0, 0.0), fast=False, now_ns=1000)
        ours.push((1.0, 0.0), fast=False, now_ns=3000)
        assert ours.late_ns(5000) == 4000
        theirs.sendall(ANSWER.pack(0, 1))
        ours.catch_up(1)
        assert (ours.late_ns(5000), ours.dropped) == (2000, 1)
        theirs.sendall(ANSWER.pack(1, 0))
        ours.catch_up(0)
        assert (ours.late_ns(5000), ours.dropped) == (0, 1)


def test_an_answer_to_another_message_is_an_error(refuses: Refuses) -> None:
    with connected() as (ours, theirs):
        ours.push((1.0, 0.0), fast=False, now_ns=0)
        theirs.sendall(ANSWER.pack(5, 0))
        with refuses(ServoError):
            ours.catch_up(0)


def test_a_device_that_hangs_up_is_gone() -> None:
    with connected() as (ours, theirs):
        theirs.close()
        with pytest.raises(ServoError, match="the connection broke"):
            for _ in range(1000):
                ours.push((0.0, 0.0), fast=False, now_ns=0)
                ours.late_ns(0)


def test_nobody_at_the_address_is_told(refuses: Refuses) -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
    with refuses(ServoError):
        ForceDevice(f"127.0.0.1:{port}", limit_n=1.0)
