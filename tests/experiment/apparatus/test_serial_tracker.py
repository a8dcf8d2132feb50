"""The tracker's driver against a scripted port, in simulated time. Real ports are in tests/rig."""

from __future__ import annotations

import errno
from collections.abc import Callable, Iterable

import numpy as np
import pytest
import serial

from experiment.apparatus.frames import Decoder, encode
from experiment.apparatus.ports import LinkCounts, Samples
from experiment.apparatus.rig import CalibrationPoint, TrackerRig
from experiment.apparatus.serial_tracker import SerialTracker
from experiment.clock import ManualClock
from experiment.errors import TrackerError, TrackerStopped

SETTINGS = TrackerRig(
    port="scripted",
    baud=1_000_000,
    rate_hz=1000,
    stall_ms=200,
    calibration=(CalibrationPoint(counts=0, mm=-5.0), CalibrationPoint(counts=4200, mm=100.0)),
)
SILENCE = None

Arrival = bytes | Exception | None


class ScriptedPort:
    """What arrives, one entry at a time: bytes, an exception, or a whole time-out of silence."""

    def __init__(self, clock: ManualClock) -> None:
        self.script: list[Arrival] = []
        self.timeout = 0.0
        self.closed = False
        self._clock = clock
        self._held = b""

    @property
    def in_waiting(self) -> int:
        return len(self._held)

    def read(self, size: int) -> bytes:
        if not self._held and size:
            arrival = self.script.pop(0)
            if isinstance(arrival, Exception):
                raise arrival
            if arrival is None:
                self._clock.sleep_ns(int(self.timeout * 1e9))
                return b""
            self._held = arrival
        taken, self._held = self._held[:size], self._held[size:]
        return taken

    def arrive_unread(self, data: bytes) -> None:
        self._held += data

    def reset_input_buffer(self) -> None:
        self._held = b""

    def close(self) -> None:
        self.closed = True


Open = Callable[..., tuple[SerialTracker, ScriptedPort]]


@pytest.fixture
def clock() -> ManualClock:
    return ManualClock(0)


@pytest.fixture
def scripted(monkeypatch: pytest.MonkeyPatch, clock: ManualClock) -> Open:
    def opened(script: Iterable[Arrival], url: str = "scripted") -> tuple[SerialTracker, ScriptedPort]:
        port = ScriptedPort(clock)
        port.script = list(script)

        def for_url(asked: str, *, baudrate: int, timeout: float, exclusive: bool) -> ScriptedPort:
            assert (asked, baudrate, exclusive) == (url, 1_000_000, True)
            port.timeout = timeout
            return port

        monkeypatch.setattr(serial, "serial_for_url", for_url)
        return SerialTracker(url, SETTINGS, clock=clock), port

    return opened


def frames(first: int, count: int) -> bytes:
    return b"".join(encode(i, 1000 * i, i % 4096) for i in range(first, first + count))


def test_samples_are_those_of_the_frames_in_mm(scripted: Open) -> None:
    tracker, port = scripted([frames(0, 3), frames(3, 1)])
    samples = tracker.read()
    assert samples.device_us.tolist() == [0, 1000, 2000]
    assert samples.height_mm.tolist() == pytest.approx([-5.0, -4.975, -4.95])
    assert tracker.read().device_us.tolist() == [3000]
    assert tracker.counts == LinkCounts(received=4)
    tracker.close()
    assert port.closed
    assert port.script == []


def test_a_torn_frame_is_waited_for_and_no_byte_of_it_is_missing_from_raw(scripted: Open) -> None:
    data = frames(0, 6)
    tracker, _ = scripted([data[:5], SILENCE, data[5:20], data[20:50], data[50:]])
    read = [tracker.read() for _ in range(3)]
    assert b"".join(samples.raw for samples in read) == data
    assert [samples.device_us.size for samples in read] == [1, 3, 2]


def test_raw_decodes_to_the_same_samples(scripted: Open) -> None:
    rng = np.random.default_rng(1)
    damaged = bytearray(frames(0, 400))
    damaged[1000:1013] = b"no frame here"
    edges = np.sort(rng.integers(0, len(damaged), 30)).tolist()
    pieces = [bytes(damaged[a:b]) for a, b in zip([0, *edges], [*edges, len(damaged)], strict=True) if a < b]
    tracker, port = scripted(pieces)
    read: list[Samples] = []
    while port.script:
        read.append(tracker.read())
    _, again = Decoder().feed(b"".join(samples.raw for samples in read))
    assert np.array_equal(again.device_us, np.concatenate([samples.device_us for samples in read]))
    assert np.array_equal(SETTINGS.height_mm(again.counts), np.concatenate([samples.height_mm for samples in read]))
    assert again.link == tracker.counts


def test_silence_is_an_error_within_200_ms(scripted: Open, clock: ManualClock) -> None:
    tracker, port = scripted([frames(0, 1), *[SILENCE] * 4])
    tracker.read()
    before_ns = clock.now_ns()
    with pytest.raises(
        TrackerStopped, match=r"tracker at scripted: no frame for 200 ms; see that the device is powered"
    ):
        tracker.read()
    assert 150e6 <= clock.now_ns() - before_ns <= 200e6
    assert port.script == []


def test_short_silences_are_none(scripted: Open) -> None:
    tracker, port = scripted([SILENCE, SILENCE, SILENCE, frames(0, 1), SILENCE, SILENCE, SILENCE, frames(1, 1)])
    assert [tracker.read().device_us.tolist() for _ in range(2)] == [[0], [1000]]
    assert port.script == []


def test_a_pause_of_the_whole_machine_is_not_a_silent_device(scripted: Open) -> None:
    tracker, port = scripted([SILENCE, frames(0, 1)])
    port.timeout = 3600.0
    assert tracker.read().device_us.tolist() == [0]


def test_bytes_that_are_no_frames_do_not_hide_silence(scripted: Open) -> None:
    tracker, port = scripted([b"noise\0", SILENCE, b"more noise\0", SILENCE, SILENCE, SILENCE])
    with pytest.raises(TrackerStopped, match=r"17 bytes within 200 ms, but no good frame; .* at 1000000 baud"):
        tracker.read()
    assert port.script == []


@pytest.mark.parametrize(
    "error",
    [
        serial.SerialException("device reports readiness to read but returned no data"),
        OSError(errno.EIO, "Input/output error"),
        serial.PortNotOpenError(),
    ],
)
def test_a_port_that_vanishes_is_an_error_with_a_remedy(scripted: Open, error: Exception) -> None:
    tracker, _ = scripted([frames(0, 1), error])
    tracker.read()
    with pytest.raises(TrackerStopped, match=r"the port has gone \(.*\); plug the device in again, then resume"):
        tracker.read()


def test_a_restart_is_an_error_and_stays_one(scripted: Open) -> None:
    tracker, _ = scripted([frames(90_000, 10) + frames(0, 10), frames(10, 10)])
    for _ in range(2):
        with pytest.raises(TrackerError, match=r"no longer runs on from 90009000 us; it restarted"):
            tracker.read()


def test_what_is_drained_is_neither_read_nor_lost(scripted: Open) -> None:
    tracker, port = scripted([frames(0, 1), frames(2500, 2)])
    tracker.read()
    port.arrive_unread(frames(1, 2400) + frames(2401, 1)[:7])
    tracker.drain()
    samples = tracker.read()
    assert samples.device_us.tolist() == [2_500_000, 2_501_000]
    assert samples.raw == frames(2500, 2)
    assert tracker.counts == LinkCounts(received=3)


def test_draining_forgets_a_torn_frame(scripted: Open) -> None:
    data = frames(0, 2)
    tracker, port = scripted([data[:15], data[15:]])
    assert tracker.read().raw == data[:15]
    tracker.drain()
    assert port.read(100) == data[15:]


def test_a_line_that_never_empties_cannot_hold_up_draining(scripted: Open, monkeypatch: pytest.MonkeyPatch) -> None:
    tracker, port = scripted([], "socket://scripted:1")
    monkeypatch.setattr(port, "read", lambda size: b"x" * size)
    tracker.drain()
    assert tracker.counts == LinkCounts()


@pytest.mark.parametrize(
    ("error", "words"),
    [
        (serial.SerialException(errno.ENOENT, "could not open port"), "no such port; .*(connected)"),
        (serial.SerialException(errno.EACCES, "could not open port"), "not permitted; let this user"),
        (serial.SerialException(errno.EBUSY, "could not open port"), "another program holds it; close"),
        (serial.SerialException(errno.EAGAIN, "Could not exclusively lock port"), "another program holds it; close"),
        (serial.SerialException("Could not configure port"), "Could not configure port; see that it is a serial port"),
        (
            ValueError("invalid URL, protocol 'x' not known"),
            "protocol 'x' not known; correct .tracker. in the rig file",
        ),
    ],
)
def test_a_port_that_cannot_be_opened_is_one_line_with_a_remedy(
    monkeypatch: pytest.MonkeyPatch, error: Exception, words: str
) -> None:
    def fails(*_args: object, **_kwargs: object) -> None:
        raise error

    monkeypatch.setattr(serial, "serial_for_url", fails)
    with pytest.raises(TrackerError, match=f"tracker at scripted: .*{words}") as caught:
        SerialTracker("scripted", SETTINGS)
    assert "\n" not in str(caught.value)
