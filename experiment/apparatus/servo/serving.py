"""The device's side of palpate's force messages: what `device.py` promises, for whatever then pushes."""

import select
import socket
from collections.abc import Callable

from palpate.experiment.apparatus.servo.device import ANSWER, DROPPED, DROPS_AFTER_S, MESSAGE_BYTES, decode
from palpate.experiment.synthesis.contact.block import Pair

PUSHED, SILENT, HUNG_UP = range(3)
"""Why a force is pushed: it was asked for, nothing came any more, the connection ended."""

WAKES_S = 0.0002
"""A machine wakes whoever waits up to so much later, s; ours."""

Push = Callable[[Pair, int, bool], None]
"""Pushes with a force, N, out of the block and along its face, with why, and the lamp."""


def hold(line: socket.socket, push: Push) -> None:
    """Push as a connection asks, and with nothing once no good message has come for 2 ms; return when it ends."""
    line.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    heard, pushes, dropped = b"", False, False
    line.settimeout(DROPS_AFTER_S)
    while True:
        # A timeout of `recv` would be rounded up to whole milliseconds.
        if not select.select([line], [], [], DROPS_AFTER_S - WAKES_S)[0]:
            if pushes:
                push((0.0, 0.0), SILENT, False)
            pushes, dropped = False, dropped or pushes
            continue
        try:
            more = line.recv(4096)
        except OSError:
            more = b""
        if not more:
            push((0.0, 0.0), HUNG_UP, False)
            return
        heard += more
        answers = b""
        while len(heard) >= MESSAGE_BYTES:
            message, heard = decode(heard[:MESSAGE_BYTES]), heard[MESSAGE_BYTES:]
            if message is None:
                # A message that is not good holds no force.
                continue
            sequence, force, fast = message
            push(force, PUSHED, fast)
            pushes = any(force)
            answers += ANSWER.pack(sequence, DROPPED if dropped else 0)
            dropped = False
        try:
            line.sendall(answers)
        except OSError:
            push((0.0, 0.0), HUNG_UP, False)
            return
