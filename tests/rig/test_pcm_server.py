"""When samples reach a real server, how soon one that fails is given up, and how soon a stimulus is silent."""

from __future__ import annotations

import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator

import numpy as np
import pytest

from palpate.experiment.apparatus.doctor import checks
from palpate.experiment.apparatus.panel import pcm as pcm_ports
from palpate.experiment.apparatus.panel.conditioning import Conditioner
from palpate.experiment.apparatus.panel.pcm import PcmActuator
from palpate.experiment.apparatus.ports import Actuator
from palpate.experiment.errors import ActuatorError
from tests.experiment.synthesis import stimuli as made
from tests.rig.test_pcm_actuator import RIG, actuator, play

pytestmark = pytest.mark.alone


class Server:
    """Takes one connection after the other, a piece at a time, and notes when and how many samples came."""

    def __init__(self, *, receive: int = 65536, close_at_once: bool = False) -> None:
        self._server = socket.create_server(("127.0.0.1", 0))
        self.address = f"127.0.0.1:{self._server.getsockname()[1]}"
        self.went_on = threading.Event()
        self.went_on.set()
        self.pieces: list[list[tuple[float, int]]] = []
        self.reset: list[bool] = []
        self._receive, self._close_at_once = receive, close_at_once
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _run(self) -> None:
        while True:
            try:
                connection, _ = self._server.accept()
            except OSError:
                return
            with connection:
                self._take(connection)

    def _take(self, connection: socket.socket) -> None:
        pieces: list[tuple[float, int]] = []
        self.pieces.append(pieces)
        self.reset.append(False)
        try:
            while self.went_on.wait() and (data := connection.recv(self._receive)):
                pieces.append((time.monotonic(), len(data) // 4))
        except OSError:
            self.reset[-1] = True
        if pieces and not self._close_at_once:
            time.sleep(max(pieces[0][0] + sum(n for _, n in pieces) / RIG.rate_hz - time.monotonic(), 0.0))

    def taken(self, connection: int) -> int:
        return sum(samples for _, samples in self.pieces[connection])

    def close(self) -> None:
        self.went_on.set()
        self._server.shutdown(socket.SHUT_RDWR)
        self._thread.join()
        self._server.close()


@pytest.fixture
def server() -> Iterator[Server]:
    opened = Server()
    yield opened
    opened.close()


def silence(opened: Actuator, within_s: float = 2.0) -> float:
    """How long it takes until nothing can sound any more, s."""
    begun_s = time.monotonic()
    while not opened.is_silent() and time.monotonic() < begun_s + within_s:
        time.sleep(0.001)
    return time.monotonic() - begun_s


def test_no_sample_goes_out_more_than_50_ms_before_its_time(server: Server) -> None:
    opened = actuator(server.address)
    begun_s = time.monotonic()
    play(opened, np.ones(2500))
    lasted_s = time.monotonic() - begun_s
    came = np.array(server.pieces[0])
    before = np.cumsum(came[:, 1]) / RIG.rate_hz
    assert server.taken(0) == 2500
    # The clock of the server begins no earlier than that of the samples.
    assert np.max(before - (came[:, 0] - begun_s)) <= pcm_ports.AHEAD_S
    assert len(came) > 20
    assert 0.5 <= lasted_s < 0.5 + pcm_ports.CLOSE_S
    assert -5.0 <= opened.play_silence(0.1) <= 250.0


def test_nothing_plays_after_a_server_that_paused_until_it_is_done(
    server: Server, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(pcm_ports, "CLOSE_S", 0.05)
    opened = actuator(server.address)
    opened.prepare(made.given(np.ones(1000)))
    server.went_on.clear()
    begun_s = time.monotonic()
    with pytest.raises(ActuatorError, match="did not close"):
        opened.landed(0)
    assert time.monotonic() - begun_s < 0.2 + 0.05 + 0.25
    for _ in range(3):
        assert not opened.is_silent()
        with pytest.raises(ActuatorError, match="still be playing"):
            opened.prepare(made.given(np.ones(1000)))
    assert silence(opened, within_s=0.3) >= 0.3
    server.went_on.set()
    assert silence(opened) < 1.0
    # What it had not read may come late: it is over before anything else is played, and nobody asked for more.
    assert server.taken(0) <= 1000
    assert server.taken(1) == 0
    assert play(opened, np.ones(10)).samples.size == server.taken(2) == 10


def test_a_server_that_takes_nothing_has_failed_before_its_buffer_has_room() -> None:
    server = Server(close_at_once=True)
    server.went_on.clear()
    opened = PcmActuator(server.address, Conditioner(full_scale=64.0, limit_m_s2=20.0), rate_hz=96_000_000)
    # 20 MB, of which the buffers of both ends hold some 4 MB while nobody reads.
    opened.prepare(made.given(np.ones(5_000_000)))
    with pytest.raises(ActuatorError, match="stopped accepting"):
        opened.landed(0)
    assert opened.delivered(0) is None
    opened.close()
    server.close()


def test_a_stimulus_that_is_withdrawn_ends_within_50_ms_and_was_not_delivered(server: Server) -> None:
    opened = actuator(server.address)
    opened.prepare(made.given(np.ones(5000)))
    told: list[tuple[float, bool]] = []
    timer = threading.Timer(0.3, lambda: told.append((time.monotonic(), opened.withdraw())))
    begun_s = time.monotonic()
    timer.start()
    opened.landed(0)
    returned_s = time.monotonic()
    timer.join()
    assert not told[0][1]
    assert returned_s - told[0][0] < 0.05
    assert silence(opened) < 0.2
    assert 1000 <= server.taken(0) <= 5000 * (returned_s - begun_s + 0.05)
    assert server.reset == [True, False]
    heard = opened.delivered(0)
    assert heard is not None
    assert (heard.delivered, heard.onset_ns) == (False, None)


def test_a_server_whose_process_ended_is_silent() -> None:
    script = (
        "import socket, sys; s = socket.create_server(('127.0.0.1', 0)); print(s.getsockname()[1], flush=True); "
        "c, _ = s.accept(); c.recv(100)"
    )
    with subprocess.Popen([sys.executable, "-c", script], stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        opened = actuator(f"127.0.0.1:{int(process.stdout.readline())}")
        with pytest.raises(ActuatorError, match="the connection broke"):
            play(opened, np.ones(2500))
    assert opened.is_silent()
    assert opened.delivered(0) is None


def test_a_server_that_stands_still_is_not_reached(server: Server, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pcm_ports, "CONNECT_S", 0.1)
    opened = actuator(server.address)
    opened.reach()
    server.went_on.clear()
    with pytest.raises(ActuatorError, match="did not close"):
        opened.reach()


def test_the_doctor_sees_what_a_server_does(server: Server) -> None:
    good = list(checks.server(server.address, RIG))
    assert [(one.check, one.verdict) for one in good] == [
        ("actuator", "passes"),
        ("actuator samples", "passes"),
        ("actuator turns", "passes"),
        ("actuator stop", "passes"),
    ]
    eager = Server(close_at_once=True)
    found = {one.check: one for one in checks.server(eager.address, RIG)}
    eager.close()
    # Its last 50 ms cannot have been played.
    assert found["actuator samples"].verdict == "refuses"
    assert found["actuator stop"].verdict == "passes"
