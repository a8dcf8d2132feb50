"""The force device behind a socket, and palpate's messages to it, for the author of its firmware or server.

One TCP connection; the device holds a force from one message to the next. Each message has 20 bytes, little-endian:

    field      type     meaning
    sequence   uint32   rises by one with every message, from 0
    flags      uint32   1: the hand is too fast, so light the lamp
    out_n      float32  force that pushes the hand out of the block, N
    along_n    float32  force along the face, N
    crc        uint32   CRC-32 (that of zlib) of the sixteen bytes before it

It answers each at once with eight bytes: the sequence number, and 1 where it has dropped its force since its last
answer, or 0. **It drops its force, in any case, when no good message has come for 2 ms, and when the connection ends**:
that holds where the servo itself has died. The connection is neither encrypted nor authenticated: keep it on the
loopback interface or a line of its own.
"""

import select
import socket
import struct
import time
from collections import deque
from contextlib import suppress
from zlib import crc32

from palpate.experiment.apparatus.servo.rendering import NO_FORCE, bounded
from palpate.experiment.errors import ServoError
from palpate.experiment.synthesis.contact.block import Pair

MESSAGE = struct.Struct("<IIff")
MESSAGE_BYTES = MESSAGE.size + 4
ANSWER = struct.Struct("<II")

FAST, DROPPED = 1, 1
"""Flags of a message, and of an answer."""

DROPS_AFTER_S = 0.002
"""A device that hears nothing for so long drops its force, s."""

CONNECT_S, CATCHES_UP_S = 1.0, 5.0
"""How long a device may take to accept, s, and how long it may be silent in simulated time."""

MOST_OPEN = 4096
"""Messages without an answer beyond which the device counts as gone, however late answers may be."""

_SEQUENCES = 1 << 32


def encode(sequence: int, force_n: Pair, *, fast: bool) -> bytes:
    """Return one message, 20 bytes."""
    body = MESSAGE.pack(sequence % _SEQUENCES, FAST if fast else 0, *force_n)
    return body + crc32(body).to_bytes(4, "little")


def decode(message: bytes) -> tuple[int, Pair, bool] | None:
    """Return sequence number, force and lamp of a message of 20 bytes; None where its CRC is wrong."""
    body = message[: MESSAGE.size]
    if crc32(body) != int.from_bytes(message[MESSAGE.size :], "little"):
        return None
    sequence, flags, out_n, along_n = MESSAGE.unpack(body)
    return sequence, (out_n, along_n), bool(flags & FAST)


RUNS = "check that it is running, then continue"
"""What to do with a device that no longer answers."""


class ForceDevice:
    """What pushes the hand; it holds a force until the next one, but no longer than 2 ms."""

    def __init__(self, address: str, *, limit_n: float, secret: str = "") -> None:
        """Connect to the device at `host:port`, with a limit of force, N, and first show it a secret, hexadecimal.

        Raises `ServoError` for no answer.
        """
        host, _, port = address.rpartition(":")
        self._address = address
        self._limit_n = limit_n
        try:
            self._line = socket.create_connection((host.strip("[]"), int(port)), timeout=CONNECT_S)
            self._line.sendall(bytes.fromhex(secret))
        except OSError as error:
            why = f"no server answers ({error.strerror or error})"
            raise self._trouble(why, "start its server, or correct servo.address in the rig file") from error
        self._line.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._line.setblocking(False)
        self._sequence = 0
        self._unanswered: deque[tuple[int, int]] = deque()
        self._heard = b""
        self.dropped = 0
        """How often the device said that it had dropped its force."""

    def push(self, force_n: Pair, *, fast: bool, now_ns: int | None) -> Pair:
        """Push with a force, N, out of the block and along its face, up to the limit; light the lamp if `fast`.

        `now_ns` is the machine's monotonic clock when the force was asked for: one that is older than the device would
        hold it is none, as after a stop of this process; None in simulated time, in which nothing is old. Returns the
        force that was sent, within the limit. Raises `ServoError` if the device takes nothing more.
        """
        sent_n = bounded(force_n, self._limit_n)
        message = encode(self._sequence, sent_n, fast=fast)
        if now_ns is not None and time.monotonic_ns() - now_ns >= DROPS_AFTER_S * 1e9:
            sent_n = NO_FORCE
            message = encode(self._sequence, sent_n, fast=fast)
        try:
            sent = self._line.send(message)
        except OSError as error:
            raise self._disconnected(error) from error
        if sent != len(message) or len(self._unanswered) >= MOST_OPEN:
            raise self._trouble("it stopped reading", RUNS)
        self._unanswered.append((self._sequence % _SEQUENCES, now_ns or 0))
        self._sequence += 1
        return sent_n

    def late_ns(self, now_ns: int) -> int:
        """Return for how long the oldest message has waited for its answer, ns. Raises `ServoError` if it is gone."""
        try:
            while heard := self._line.recv(4096):
                self._heard += heard
        except BlockingIOError:
            heard = b"-"
        except OSError as error:
            raise self._disconnected(error) from error
        whole = len(self._heard) // ANSWER.size * ANSWER.size
        for sequence, dropped in ANSWER.iter_unpack(self._heard[:whole]):
            if not self._unanswered or self._unanswered.popleft()[0] != sequence:
                got = f"got an answer to message {sequence} out of order"
                allowed = "one answer to each message, in order"
                raise self._trouble(got, "restart it; if it happens again, update its firmware", allowed=allowed)
            self.dropped += dropped == DROPPED
        self._heard = self._heard[whole:]
        if not heard:
            raise self._disconnected(ConnectionResetError("it closed the connection"))
        return now_ns - self._unanswered[0][1] if self._unanswered else 0

    def catch_up(self, behind: int) -> None:
        """Wait, in simulated time, until the device is at most `behind` messages behind.

        Raises `ServoError` after `CATCHES_UP_S`.
        """
        while len(self._unanswered) > behind:
            if not select.select([self._line], [], [], CATCHES_UP_S)[0]:
                raise self._trouble(f"no answer for {CATCHES_UP_S:g} s", RUNS)
            self.late_ns(0)

    def close(self) -> None:
        """Take the force away, as far as the device still listens, and hang up."""
        # Whatever it hears of this, it drops its force when the connection ends.
        with suppress(OSError):
            self._line.send(encode(self._sequence, NO_FORCE, fast=False))
        self._line.close()

    def _disconnected(self, error: OSError) -> ServoError:
        return self._trouble(f"the connection broke ({error.strerror or error})", RUNS)

    def _trouble(self, what: str, remedy: str, *, allowed: str = "") -> ServoError:
        return ServoError(f"force device at {self._address}", what, remedy, allowed=allowed)
