"""A real TCP stream of takes: knocks before contact, any pieces, stalls, and servers that fail."""

from __future__ import annotations

import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import suppress

import numpy as np
import pytest

from palpate.experiment.apparatus.panel import accelerometer as ports
from palpate.experiment.apparatus.panel.accelerometer import Heard, PcmAccelerometer
from palpate.experiment.apparatus.rig import AccelerometerRig
from palpate.experiment.clock import Clock
from palpate.experiment.errors import RecordingError
from palpate.experiment.rehearsal.clock import ManualClock
from palpate.experiment.rehearsal.wires.sensor import Sensor
from tests.approved import Refuses

pytestmark = pytest.mark.clocked

RIG = AccelerometerRig(driver="pcm-tcp", address="rehearsal", rate_hz=1000, full_scale_m_s2=64.0, trigger_m_s2=0.5)
BEFORE = round(ports.BEFORE_S * RIG.rate_hz)
MS = 1_000_000


def accelerometer(address: str, clock: Clock) -> PcmAccelerometer:
    return PcmAccelerometer(RIG.model_copy(update={"address": address}), clock=clock)


def pcm(samples: np.ndarray) -> bytes:
    return (samples / 64.0).astype("<f4").tobytes()


def take() -> np.ndarray:
    samples = np.random.default_rng(1).normal(0, 4, 500)
    samples[0] = 1.0
    return samples


class Stopped(ManualClock):
    """Stands still, so that the whole stream arrives at once: its last sample is the present one."""


def wait_until_heard(device: PcmAccelerometer, samples: int) -> None:
    """Wait until the device has taken this many samples from its stream since it was armed."""
    listening = device._listening
    assert listening is not None
    with listening._changed:
        assert listening._changed.wait_for(lambda: listening._count == samples, 5)


def heard_of(serve: Serve, samples: np.ndarray, *, earliest: int, latest: int, length: int, size: int = 4096) -> Heard:
    """What is heard of samples, in samples of the stream."""
    clock = Stopped(10_000 * MS)
    begun_ms = 10_000 - samples.size
    data = pcm(samples)
    device = accelerometer(serve([data[i : i + size] for i in range(0, len(data), size)]), clock)
    device.arm(length)
    # The clock stands, so everything has to be there before the stream can be timed.
    wait_until_heard(device, samples.size)
    return device.heard(earliest_ns=(begun_ms + earliest) * MS, latest_ns=(begun_ms + latest) * MS)


Serve = Callable[[list[bytes]], str]


@pytest.fixture
def serve() -> Iterator[Serve]:
    """A server that sends pieces to its first connection, and stays until it hangs up; gives its address."""
    yield from served(stays=True)


@pytest.fixture
def leave() -> Iterator[Serve]:
    """The same, but the server hangs up."""
    yield from served(stays=False)


def served(*, stays: bool) -> Iterator[Serve]:
    servers: list[socket.socket] = []
    threads: list[threading.Thread] = []

    def started(pieces: list[bytes]) -> str:
        server = socket.create_server(("127.0.0.1", 0))
        servers.append(server)

        def run() -> None:
            connection, _ = server.accept()
            with connection:
                connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                # The reader goes as soon as it has its take, whatever is still to come.
                with suppress(OSError):
                    for piece in pieces:
                        connection.sendall(piece)
                    while stays and connection.recv(4096):
                        pass

        threads.append(threading.Thread(target=run, daemon=True))
        threads[-1].start()
        return f"127.0.0.1:{server.getsockname()[1]}"

    yield started
    for thread in threads:
        thread.join(5)
    for server in servers:
        server.close()


def rest(samples: int) -> np.ndarray:
    return np.full(samples, 0.1)


def test_a_take_begins_just_before_the_vibration(serve: Serve) -> None:
    stream = np.concatenate([rest(300), take()])
    heard = heard_of(serve, stream, earliest=250, latest=450, length=400)
    assert heard.window is not None
    assert (heard.window.samples_m_s2.shape, heard.window.clipped, heard.knock_ns) == ((400,), 0, None)
    np.testing.assert_allclose(heard.window.samples_m_s2, [0.1, 0.1, *take()[:398]], rtol=2**-23)


@pytest.mark.parametrize("loud", [1.0, np.nan])
def test_a_knock_before_contact_is_left_out_and_told_of(serve: Serve, loud: float) -> None:
    """The foot that brushes the panel 200 ms before it comes down, too, however loud."""
    stream = np.concatenate([rest(300), take()])
    stream[[100, 101]] = 30.0, loud
    heard = heard_of(serve, stream, earliest=250, latest=450, length=400)
    assert heard.window is not None
    np.testing.assert_allclose(heard.window.samples_m_s2[BEFORE:], take()[:398], rtol=2**-23)
    assert heard.begun_ns is not None
    assert heard.knock_ns is not None
    assert (heard.begun_ns - heard.knock_ns) / MS == 300 - 101


def test_a_knock_alone_is_no_take(serve: Serve) -> None:
    stream = rest(1000)
    stream[100] = 30.0
    heard = heard_of(serve, stream, earliest=250, latest=450, length=400)
    assert heard.window is None
    assert heard.knock_ns == (10_000 - 1000 + 100) * MS


@pytest.mark.parametrize(("at", "found"), [(249, False), (250, True), (450, True), (451, False)])
def test_the_stretch_holds_both_its_ends_and_no_more(serve: Serve, at: int, found: bool) -> None:
    stream = rest(1000)
    stream[at] = 5.0
    assert (heard_of(serve, stream, earliest=250, latest=450, length=100).window is not None) == found


@pytest.mark.parametrize("size", [1, 3, 7, 4096])
def test_however_the_stream_is_cut_the_take_is_the_same(serve: Serve, size: int) -> None:
    stream = np.concatenate([rest(37), take()])
    heard = heard_of(serve, stream, earliest=30, latest=60, length=300, size=size)
    assert heard.window is not None
    np.testing.assert_allclose(heard.window.samples_m_s2, [0.1, 0.1, *take()[:298]], rtol=2**-23)


def test_clipped_samples_are_counted(serve: Serve) -> None:
    loud = take()
    loud[[10, 20]] = 64.0, -70.0
    heard = heard_of(serve, loud, earliest=0, latest=9, length=300)
    assert heard.window is not None
    assert heard.window.clipped == 2


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_samples_that_are_no_numbers_are_refused(serve: Serve, bad: float, refuses: Refuses) -> None:
    spoilt = take()
    spoilt[[0, 5]] = bad
    with refuses(RecordingError):
        heard_of(serve, spoilt, earliest=0, latest=9, length=300)


def test_a_stall_does_not_move_the_take(monkeypatch: pytest.MonkeyPatch) -> None:
    """Pieces of 10 ms, every third held up by 31 ms: those in time tell when the stream began."""
    clock = ManualClock(0)
    settings = RIG
    sensor = Sensor(settings, clock)
    try:
        device = accelerometer(sensor.address, clock)
        device.arm(400)
        sensor.shake(take(), 300 * MS, np.random.default_rng(2))
        for piece in range(1, 150):
            due_ns = 10 * MS * piece
            clock.sleep_ns(due_ns - clock.now_ns())
            if piece % 3 == 0:
                continue
            sensor.send()
            wait_until_heard(device, sensor.sent)
        heard = device.heard(earliest_ns=250 * MS, latest_ns=450 * MS)
    finally:
        sensor.close()
    assert heard.begun_ns == pytest.approx(300 * MS, abs=1.01 * MS)


def test_what_is_held_is_bounded_and_times_stay_true(monkeypatch: pytest.MonkeyPatch) -> None:
    """A foot that hesitates for minutes: the stream's beginning is gone, the take's time is not."""
    monkeypatch.setattr(ports, "RING_S", 0.5)
    clock = ManualClock(0)
    sensor = Sensor(RIG, clock)
    try:
        device = accelerometer(sensor.address, clock)
        device.arm(100)
        sensor.shake(take(), 60_000 * MS, np.random.default_rng(2))
        listening = device._listening
        assert listening is not None
        for _ in range(602):
            clock.sleep_ns(100 * MS)
            sensor.send()
            wait_until_heard(device, sensor.sent)
        assert sum(piece.size for piece, _ in listening._pieces) <= 500 + 100 + 100
        heard = device.heard(earliest_ns=59_950 * MS, latest_ns=60_100 * MS)
    finally:
        sensor.close()
    assert heard.begun_ns is None or heard.begun_ns == pytest.approx(60_000 * MS, abs=1.01 * MS)


@pytest.mark.parametrize("pieces", [[pcm(rest(50))], [pcm(take()[:200])], [pcm(take()[:200]) + b"\x00\x00"]])
def test_a_stream_that_ends_too_soon_is_an_error(leave: Serve, pieces: list[bytes], refuses: Refuses) -> None:
    clock = Stopped(1000 * MS)
    device = accelerometer(leave(pieces), clock)
    device.arm(300)
    with refuses(RecordingError):
        device.heard(earliest_ns=700 * MS, latest_ns=1010 * MS)


def test_a_server_that_says_nothing_is_found_before_the_step(
    serve: Serve, monkeypatch: pytest.MonkeyPatch, refuses: Refuses
) -> None:
    monkeypatch.setattr(ports, "ALIVE_S", 0.05)
    with refuses(RecordingError):
        accelerometer(serve([]), ManualClock(0)).arm(300)
    assert not [thread for thread in threading.enumerate() if thread.name == "accelerometer"]


def test_a_server_that_hangs_up_is_found_before_the_step(leave: Serve, refuses: Refuses) -> None:
    with refuses(RecordingError):
        accelerometer(leave([]), ManualClock(0)).arm(300)


def test_a_stream_that_stalls_is_an_error(serve: Serve, monkeypatch: pytest.MonkeyPatch, refuses: Refuses) -> None:
    monkeypatch.setattr(ports, "LATE_S", -0.9)
    clock = Stopped(1000 * MS)
    device = accelerometer(serve([pcm(take()[:300])]), clock)
    device.arm(1001)
    with refuses(RecordingError):
        device.heard(earliest_ns=700 * MS, latest_ns=1000 * MS)


def test_no_server_is_an_error(refuses: Refuses) -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        address = f"127.0.0.1:{server.getsockname()[1]}"
    with refuses(RecordingError):
        accelerometer(address, ManualClock(0)).arm(10)


def test_a_take_needs_arming() -> None:
    with pytest.raises(RecordingError, match="arm the sensor"):
        accelerometer("127.0.0.1:1", ManualClock(0)).heard(earliest_ns=0, latest_ns=0)


def test_closing_ends_listening(serve: Serve) -> None:
    device = accelerometer(serve([pcm(rest(5))]), ManualClock(0))
    device.arm(10)
    device.close()
    device.close()
    assert not [thread for thread in threading.enumerate() if thread.name == "accelerometer"]
