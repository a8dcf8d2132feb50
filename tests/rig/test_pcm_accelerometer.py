"""A real TCP stream of takes: from the simulated sensor, cut into any pieces, and from servers that fail."""

from __future__ import annotations

import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import suppress

import numpy as np
import pytest

from experiment.apparatus import pcm_accelerometer
from experiment.apparatus.pcm_accelerometer import PcmAccelerometer
from experiment.apparatus.rig import AccelerometerRig
from experiment.errors import RecordingError
from experiment.rehearsal.recorder import Sensor

RIG = AccelerometerRig(driver="pcm-tcp", address="rehearsal", rate_hz=1000, full_scale_m_s2=64.0, trigger_m_s2=0.5)
BEFORE = round(pcm_accelerometer.BEFORE_S * RIG.rate_hz)


@pytest.fixture
def sensor() -> Iterator[Sensor]:
    opened = Sensor(RIG)
    yield opened
    opened.close()


def accelerometer(address: str) -> PcmAccelerometer:
    return PcmAccelerometer(address, rate_hz=RIG.rate_hz, full_scale_m_s2=64.0, trigger_m_s2=0.5)


Serve = Callable[[list[bytes]], str]


@pytest.fixture
def serve() -> Iterator[Serve]:
    """A server that sends pieces to its first connection, then hangs up; gives its address."""
    servers: list[socket.socket] = []
    threads: list[threading.Thread] = []

    def started(pieces: list[bytes]) -> str:
        server = socket.create_server(("127.0.0.1", 0))
        servers.append(server)

        def run() -> None:
            connection, _ = server.accept()
            with connection:
                connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                # The reader goes as soon as it has its window, whatever is still to come.
                with suppress(ConnectionError):
                    for piece in pieces:
                        connection.sendall(piece)

        threads.append(threading.Thread(target=run, daemon=True))
        threads[-1].start()
        return f"127.0.0.1:{server.getsockname()[1]}"

    yield started
    for thread in threads:
        thread.join(5)
    for server in servers:
        server.close()


def pcm(samples: np.ndarray) -> bytes:
    return (samples / 64.0).astype("<f4").tobytes()


def take() -> np.ndarray:
    samples = np.random.default_rng(1).normal(0, 4, 500)
    samples[0] = 1.0
    return samples


def test_a_take_begins_just_before_the_vibration(sensor: Sensor) -> None:
    device = accelerometer(sensor.address)
    device.arm(400)
    sensor.shake(take(), np.random.default_rng(2))
    heard = device.window()
    assert heard is not None
    assert (heard.samples_m_s2.shape, heard.clipped) == ((400,), 0)
    np.testing.assert_allclose(heard.samples_m_s2[BEFORE:], take()[: 400 - BEFORE], rtol=2**-23)
    assert np.abs(heard.samples_m_s2[:BEFORE]).max() < 0.5


def test_takes_follow_one_another_and_an_abandoned_one_is_not_heard(sensor: Sensor) -> None:
    device = accelerometer(sensor.address)
    for factor in (1.0, 2.0, 3.0):
        device.arm(100)
        sensor.shake(factor * take(), np.random.default_rng(2))
        heard = device.window()
        assert heard is not None
        assert heard.samples_m_s2[BEFORE] == pytest.approx(factor)


@pytest.mark.parametrize("size", [1, 3, 7, 4096])
def test_however_the_stream_is_cut_the_take_is_the_same(serve: Serve, size: int) -> None:
    data = pcm(np.concatenate([np.full(37, 0.1), take()]))
    device = accelerometer(serve([data[i : i + size] for i in range(0, len(data), size)]))
    device.arm(300)
    heard = device.window()
    assert heard is not None
    np.testing.assert_allclose(heard.samples_m_s2, [0.1, 0.1, *take()[:298]], rtol=2**-23)


def test_a_server_with_a_trigger_of_its_own_loses_nothing(serve: Serve) -> None:
    device = accelerometer(serve([pcm(take())]))
    device.arm(300)
    heard = device.window()
    assert heard is not None
    np.testing.assert_allclose(heard.samples_m_s2, take()[:300], rtol=2**-23)


def test_clipped_samples_are_counted(serve: Serve) -> None:
    loud = take()
    loud[[10, 20]] = 64.0, -70.0
    device = accelerometer(serve([pcm(loud)]))
    device.arm(300)
    heard = device.window()
    assert heard is not None
    assert heard.clipped == 2


def test_a_panel_at_rest_gives_no_take(sensor: Sensor, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pcm_accelerometer, "LATE_S", 0.0)
    device = accelerometer(sensor.address)
    device.arm(1)
    sensor.shake(np.zeros(100), np.random.default_rng(2))
    assert device.window() is None


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_samples_that_are_no_numbers_are_refused(serve: Serve, bad: float) -> None:
    spoilt = take()
    spoilt[[0, 5]] = bad
    device = accelerometer(serve([pcm(spoilt)]))
    device.arm(300)
    with pytest.raises(RecordingError, match=r"accelerometer at 127.0.0.1:\d+: sent NaN or infinite samples; see that"):
        device.window()


@pytest.mark.parametrize("pieces", [[], [pcm(np.zeros(50))], [pcm(take()[:200])], [pcm(take()[:200]) + b"\x00\x00"]])
def test_a_stream_that_ends_too_soon_is_an_error(serve: Serve, pieces: list[bytes]) -> None:
    device = accelerometer(serve(pieces))
    device.arm(300)
    with pytest.raises(RecordingError, match="the stream ended before the take was whole"):
        device.window()


def test_a_stream_that_stalls_is_an_error(sensor: Sensor, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pcm_accelerometer, "LATE_S", -0.9)
    device = accelerometer(sensor.address)
    device.arm(1001)
    sensor.shake(take()[:300], np.random.default_rng(2))
    with pytest.raises(RecordingError, match=r"less than 1001 samples came within 0\.1 s"):
        device.window()


def test_no_server_is_an_error() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        address = f"127.0.0.1:{server.getsockname()[1]}"
    with pytest.raises(
        RecordingError, match=r"nothing answers there .*; start its server, or correct accelerometer.addr"
    ):
        accelerometer(address).arm(10)


def test_a_window_needs_arming(sensor: Sensor) -> None:
    with pytest.raises(RecordingError, match="arm it first"):
        accelerometer(sensor.address).window()


def test_closing_ends_listening(sensor: Sensor) -> None:
    device = accelerometer(sensor.address)
    device.arm(10)
    device.close()
    device.close()
    assert not [thread for thread in threading.enumerate() if thread.name == "accelerometer"]
