"""SIMULATED devices of a live laboratory, in a process of their own: `python -m tests.faults.world FOLDER [SERVER]`.

A foot stands above a tracker on a pseudo-terminal, FOLDER/tracker. A panel listens on a socket, and its list of what it
was given is the tests' own: nothing of palpate writes or reads it. Devices do not wait for the machine, so the process
runs in real time where it may. With SERVER the process also runs a sound card, and
names its server in that file. It takes one command a line: `step SPEED SEED`, `unplug`, `replug`, `deaf` and `hears`
(of the panel), and `ping`; it says in JSON what it heard and that it has done a command.
"""

from __future__ import annotations

import hashlib
import json
import os
import socket
import sys
import threading
import time
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from palpate.experiment.apparatus import rig
from palpate.experiment.apparatus.rig import tracker_of
from palpate.experiment.protocol.files import shipped
from palpate.experiment.rehearsal.wires.foot import Foot, trajectory
from palpate.experiment.rehearsal.wires.sound_card import SoundCard
from tests.plugged import PluggedLine

REST_MM = 46.0
"""The foot waits just above where it may, so that steps take little time."""


RATE_HZ, BLOCK = 48_000, 1024


def say(**what: Any) -> None:
    os.write(1, (json.dumps(what) + "\n").encode())


class Panel:
    """Reads each connection to its end, and says what came, also of one that broke off."""

    def __init__(self) -> None:
        self._address: tuple[str, int] = ("127.0.0.1", 0)
        self._quiet = threading.Condition()
        self._open = 0
        self.hears()

    def hears(self) -> None:
        self._server = socket.create_server(self._address)
        self._address = self._server.getsockname()
        self.address = f"127.0.0.1:{self._address[1]}"
        threading.Thread(target=self._listen, args=(self._server,), daemon=True).start()

    def deaf(self) -> None:
        self._server.shutdown(socket.SHUT_RDWR)
        self._server.close()

    def settle(self) -> None:
        """Wait until no connection is open."""
        with self._quiet:
            self._quiet.wait_for(lambda: self._open == 0, 10)

    def _listen(self, server: socket.socket) -> None:
        while True:
            try:
                connection, _ = server.accept()
            except OSError:
                return
            with self._quiet:
                self._open += 1
            with connection:
                data, t_ns = b"", 0
                try:
                    while piece := connection.recv(65536):
                        if not data:
                            t_ns = time.time_ns()
                        data += piece
                except OSError:
                    pass
                if data:
                    say(heard=hashlib.sha256(data).hexdigest(), t_ns=t_ns, bytes=len(data))
            with self._quiet:
                self._open -= 1
                self._quiet.notify_all()


def main() -> None:
    with suppress(PermissionError):
        os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(1))
    folder = Path(sys.argv[1])
    card = SoundCard(rate_hz=RATE_HZ, block=BLOCK, inputs=2, outputs=3, exact=False) if sys.argv[2:] else None
    settings = tracker_of(rig.load(shipped("rigs/rehearsal.toml")))
    panel = Panel()
    line = PluggedLine(link=folder / "tracker")
    foot = Foot(line, settings, real_time=True, rest_mm=REST_MM)
    say(address=panel.address, port=line.url, server=card.name if card else None)
    for command in sys.stdin:
        word, *rest = command.split()
        if word == "step":
            rng = np.random.default_rng(int(rest[1]))
            foot.step(trajectory(rng, float(rest[0]), rest_mm=REST_MM, hesitation="none"), 0)
        elif word == "unplug":
            line.unplug()
        elif word == "replug":
            foot.close()
            line.replug()
            foot = Foot(line, settings, real_time=True, rest_mm=REST_MM)
        elif word == "deaf":
            panel.deaf()
        elif word == "hears":
            panel.hears()
        elif word == "ping":
            panel.settle()
        say(done=word)
    foot.close()
    if card is not None:
        card.close()


if __name__ == "__main__":
    main()
