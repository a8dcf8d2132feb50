"""The tracker's driver against a scripted port. Real ports are in tests/rig."""

from __future__ import annotations

import errno
import sys
import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from queue import Empty, SimpleQueue

import numpy as np
import pytest
import serial

from palpate.experiment.apparatus.tracker import serial_tracker
from palpate.experiment.apparatus.tracker.clock_map import ClockMap
from palpate.experiment.apparatus.tracker.frames import Decoder, LinkCounts, encode
from palpate.experiment.apparatus.tracker.serial_tracker import SerialTracker
from palpate.experiment.apparatus.tracker.settings import CalibrationPoint, TrackerRig
from palpate.experiment.errors import PalpateError, TrackerError, TrackerStopped
from palpate.experiment.rehearsal.clock import ManualClock
from tests.approved import Refuses
from tests.machine_clock import MachineClock

SETTINGS = TrackerRig(
    port="scripted",
    baud=1_000_000,
    rate_hz=1000,
    stall_ms=50,
    calibration=(CalibrationPoint(counts=0, mm=-5.0), CalibrationPoint(counts=4200, mm=100.0)),
)
PLANAR = SETTINGS.model_copy(
    update={"along_calibration": (CalibrationPoint(counts=0, mm=30.0), CalibrationPoint(counts=60_000, mm=-30.0))}
)
Arrival = bytes | Exception


class ScriptedPort:
    """What arrives, one entry a read: bytes, or an exception. Where the script is over there is silence."""

    def __init__(self, script: Iterable[Arrival]) -> None:
        self._script = deque(script)
        self._changed = threading.Condition()
        self._woken = False
        self.closed = False

    def wait(self, timeout_s: float) -> bool:
        with self._changed:
            return self._changed.wait_for(lambda: bool(self._script) or self._woken, timeout_s) and not self._woken

    def take(self, refill_s: float = 0.0) -> bytes:
        with self._changed:
            arrival = self._script.popleft() if self._script else b""
            self._changed.notify_all()
        if isinstance(arrival, Exception):
            raise arrival
        return arrival

    def arrive(self, *arrivals: Arrival) -> None:
        """Returns when all of it has been taken."""
        with self._changed:
            self._script.extend(arrivals)
            self._changed.notify_all()
            assert self._changed.wait_for(lambda: not self._script, 10)

    def check(self) -> None:
        """There it is."""

    def discard(self) -> None:
        with self._changed:
            self._script.clear()
            self._changed.notify_all()

    def wake(self) -> None:
        with self._changed:
            self._woken = True
            self._changed.notify_all()

    def close(self) -> None:
        self.closed = True


Open = Callable[..., tuple[SerialTracker, ScriptedPort]]


@pytest.fixture
def clock() -> ManualClock:
    return MachineClock(10**18)


@pytest.fixture
def scripted(monkeypatch: pytest.MonkeyPatch, clock: ManualClock) -> Iterator[Open]:
    trackers: list[SerialTracker] = []

    def opened(
        *scripts: Iterable[Arrival] | PalpateError, settings: TrackerRig | None = None
    ) -> tuple[SerialTracker, ScriptedPort]:
        """A tracker on the last of the ports; where there are several, each opening takes the next."""
        ports = [ScriptedPort(script) if not isinstance(script, PalpateError) else script for script in scripts]
        waiting = deque(ports)

        def next_port(asked: str, baud: int) -> ScriptedPort:
            assert (asked, baud) == ("scripted", 1_000_000)
            port = waiting.popleft()
            if isinstance(port, PalpateError):
                raise port
            return port

        monkeypatch.setattr(serial_tracker, "SerialPort", next_port)
        trackers.append(SerialTracker("scripted", settings or SETTINGS, clock=clock))
        last = ports[-1]
        assert isinstance(last, ScriptedPort)
        return trackers[-1], last

    yield opened
    for tracker in trackers:
        tracker.close()


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


def test_a_torn_frame_is_waited_for_and_no_byte_of_it_is_missing_from_raw(scripted: Open) -> None:
    data = frames(0, 6)
    tracker, _ = scripted([data[:5], data[5:20], data[20:50], data[50:]])
    read = [tracker.read() for _ in range(3)]
    assert b"".join(samples.raw for samples in read) == data
    assert [samples.device_us.size for samples in read] == [1, 3, 2]


def test_raw_decodes_to_the_same_samples(scripted: Open) -> None:
    rng = np.random.default_rng(1)
    damaged = bytearray(frames(0, 400))
    damaged[1000:1013] = b"no frame here"
    edges = np.sort(rng.integers(0, len(damaged), 30)).tolist()
    tracker, _ = scripted(
        [bytes(damaged[a:b]) for a, b in zip([0, *edges], [*edges, len(damaged)], strict=True) if a < b]
    )
    read = [tracker.read()]
    while read[-1].device_us[-1] < 399_000:
        read.append(tracker.read())
    _, again = Decoder().feed(b"".join(samples.raw for samples in read))
    assert np.array_equal(again.device_us, np.concatenate([samples.device_us for samples in read]))
    assert np.array_equal(SETTINGS.height_mm(again.counts), np.concatenate([samples.height_mm for samples in read]))
    assert again.link == tracker.counts


def test_arrivals_are_stamped_and_mapped(scripted: Open, clock: ManualClock) -> None:
    tracker, port = scripted([])
    assert tracker.clock_map is None
    read = []
    for i in range(5):
        clock.sleep_ns(1_000_000)
        port.arrive(frames(i, 1))
        read.append(tracker.read())
    assert [samples.arrived_ns for samples in read] == [10**18 + 1_000_000 * i for i in range(1, 6)]
    assert tracker.clock_map is not None
    assert tracker.clock_map.session_ns(2500) == 10**18 + 3_500_000


def test_a_known_clock_is_not_estimated(monkeypatch: pytest.MonkeyPatch, scripted: Open) -> None:
    known = ClockMap(anchor_us=0, anchor_ns=7)
    port = ScriptedPort([])
    monkeypatch.setattr(serial_tracker, "SerialPort", lambda *_: port)
    tracker = SerialTracker("scripted", SETTINGS, clock_map=known)
    assert tracker.clock_map is None
    port.arrive(frames(0, 1))
    tracker.read()
    assert tracker.clock_map is known
    tracker.close()


def test_silence_is_an_error_with_a_remedy(scripted: Open, refuses: Refuses) -> None:
    tracker, _ = scripted([frames(0, 1)])
    tracker.read()
    with refuses(TrackerStopped):
        tracker.read()


def test_a_pause_of_the_whole_machine_is_not_a_silent_device(scripted: Open, monkeypatch: pytest.MonkeyPatch) -> None:
    pauses: list[Callable[[], None]] = []

    class Paused(SimpleQueue[object]):
        def get(self, block: bool = True, timeout: float | None = None) -> object:
            if pauses:
                pauses.pop()()
            if timeout:
                # No slice of the wait sees what came; it is found by looking once more.
                raise Empty
            return super().get(block, timeout)

    monkeypatch.setattr(serial_tracker, "SimpleQueue", Paused)
    tracker, port = scripted([])
    pauses.append(lambda: port.arrive(frames(0, 1)))
    assert tracker.read().device_us.tolist() == [0]


def planar_frames(first: int, count: int) -> bytes:
    return b"".join(encode(i, 1000 * i, i % 4096, 30_000 + i) for i in range(first, first + count))


def test_a_planar_tracker_gives_places_along_the_face_too_and_keeps_its_bytes(scripted: Open) -> None:
    data = planar_frames(0, 3)
    tracker, port = scripted([data], settings=PLANAR)
    samples = tracker.read()
    assert samples.raw == data
    assert samples.along_mm is not None
    assert samples.along_mm.tolist() == pytest.approx([0.0, -0.001, -0.002])
    assert samples.height_mm.tolist() == pytest.approx([-5.0, -4.975, -4.95])
    first, others = samples.cut(1)
    assert first.along_mm is not None
    assert others.along_mm is not None
    assert [len(first.raw), len(others.raw)] == [14, 28]
    assert [*first.along_mm, *others.along_mm] == samples.along_mm.tolist()
    # What a drained line brings is read as before.
    tracker.drain()
    port.arrive(planar_frames(9, 2))
    assert tracker.read().device_us.tolist() == [9000, 10_000]


@pytest.mark.parametrize(("settings", "data"), [(SETTINGS, planar_frames(0, 2)), (PLANAR, frames(0, 3))])
def test_frames_of_the_other_kind_are_none_and_which_are_read_is_told(
    scripted: Open, settings: TrackerRig, data: bytes, refuses: Refuses
) -> None:
    tracker, _ = scripted([data], settings=settings)
    with refuses(TrackerStopped):
        tracker.read()


def test_bytes_that_are_no_frames_do_not_hide_silence(scripted: Open, refuses: Refuses) -> None:
    tracker, _ = scripted([b"noise\0", b"more noise\0"])
    with refuses(TrackerStopped):
        tracker.read()


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
    for act in (tracker.read, tracker.drain):
        with pytest.raises(TrackerStopped, match=r"the port has disappeared \(.*\); plug in the device again$"):
            act()
    assert tracker.gone


def test_what_came_before_the_port_vanished_is_read_first(scripted: Open, refuses: Refuses) -> None:
    tracker, port = scripted([])
    port.arrive(frames(0, 3), OSError(errno.EIO, "Input/output error"))
    assert tracker.read().device_us.size == 3
    with refuses(TrackerStopped):
        tracker.read()


def test_a_mistake_in_the_thread_reaches_the_reader(scripted: Open) -> None:
    tracker, _ = scripted([ZeroDivisionError("in the thread")])
    with pytest.raises(ZeroDivisionError, match="in the thread"):
        tracker.read()


def test_a_restart_is_an_error_and_stays_one(scripted: Open) -> None:
    tracker, _ = scripted([frames(90_000, 10) + frames(0, 10), frames(10, 10)])
    for _ in range(2):
        with pytest.raises(TrackerError, match=r"no longer continues from 90009000 us; it restarted"):
            tracker.read()


def test_what_is_drained_is_neither_read_nor_lost(scripted: Open) -> None:
    tracker, port = scripted([frames(0, 1)])
    tracker.read()
    port.arrive(frames(1, 2400) + frames(2401, 1)[:7])
    tracker.drain()
    port.arrive(frames(2500, 2))
    samples = tracker.read()
    assert samples.device_us.tolist() == [2_500_000, 2_501_000]
    assert samples.raw == frames(2500, 2)
    assert tracker.counts == LinkCounts(received=3)


def test_what_nobody_reads_is_left_on_the_line(scripted: Open) -> None:
    data = frames(0, 50_000)
    tracker, _ = scripted([data[i : i + 12_000] for i in range(0, len(data), 12_000)])
    read = [tracker.read()]
    while read[-1].device_us[-1] < 49_999_000:
        read.append(tracker.read())
    assert b"".join(samples.raw for samples in read) == data
    assert tracker.counts == LinkCounts(received=50_000)


@pytest.fixture
def paused_ms(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """Every pause of the thread, which takes none."""
    paused: list[float] = []

    class Machine:
        def sleep_ns(self, duration_ns: int) -> None:
            paused.append(duration_ns / 1e6)

    monkeypatch.setattr(serial_tracker, "_MACHINE", Machine())
    return paused


def test_a_backlog_is_read_without_a_pause(scripted: Open, paused_ms: list[float]) -> None:
    """The longest pause, 3 ms of the 50 ms of silence allowed, brings three frames: eight are no backlog, nine are."""
    _, port = scripted([])
    # A foot counts as falling for 50 ms from its first reading on.
    port.arrive(frames(0, 1))
    port.arrive(frames(100, 8))
    port.arrive(frames(108, 9), b"")
    assert len(paused_ms) == 1


@pytest.mark.parametrize(("rate_hz", "falling_ms"), [(500, ()), (1000, ()), (5000, (0.8,))])
def test_while_the_foot_falls_the_thread_blocks_on_the_line(
    scripted: Open, paused_ms: list[float], monkeypatch: pytest.MonkeyPatch, rate_hz: int, falling_ms: tuple[float, ...]
) -> None:
    """A foot rests, rises, falls by less than a millimetre, falls by more, and rests."""
    monkeypatch.setattr(sys.modules[__name__], "SETTINGS", SETTINGS.model_copy(update={"rate_hz": rate_hz}))
    heights_mm = (50.0, 50.2, 60.0, 59.2, 58.8, 30.0, 30.0, 30.0)
    _, port = scripted([])
    paused: list[tuple[float, ...]] = []
    for turn, counts in enumerate(SETTINGS.counts(np.array(heights_mm)).tolist()):
        before = len(paused_ms)
        port.arrive(encode(rate_hz // 25 * turn, 40_000 * turn, counts), b"")
        paused.append(tuple(paused_ms[before:]))
    # Until the first reading, and for 50 ms since it was last seen to, the foot counts as falling. Where frames come
    # faster than one a millisecond, what comes in one is waited for.
    falls, calm = falling_ms, (3.0,)
    assert paused == [falls, falls, calm, calm, falls, falls, falls, calm]


@pytest.mark.parametrize("speed_mm_s", [50.0, 120.0, 250.0, 400.0])
@pytest.mark.parametrize("seed", range(4))
def test_a_noisy_foot_that_falls_is_read_often_from_2_mm_and_a_pause_below_its_rest(
    scripted: Open, paused_ms: list[float], speed_mm_s: float, seed: int
) -> None:
    """And one that rests never is, once 50 ms have passed: noise alone is no fall."""
    rng = np.random.default_rng(seed)
    _, port = scripted([])
    us, fallen_mm = 0, 0.0
    seen: list[tuple[int, float, float]] = []
    while fallen_mm < 60.0:
        (counts,) = SETTINGS.counts(np.array([60.0 - fallen_mm + rng.normal(0, 0.1)])).tolist()
        before = len(paused_ms)
        port.arrive(encode(len(seen) % 256, us, counts), b"")
        # Where the thread does not pause, it has the next frame.
        apart_ms = paused_ms[-1] if len(paused_ms) > before else 1.0
        seen.append((us, fallen_mm, apart_ms))
        us += round(apart_ms * 1000)
        fallen_mm = max(0.0, speed_mm_s * (us - 300_000) / 1e6)
    assert {pause for at_us, fallen, pause in seen if at_us > 60_000 and fallen == 0.0} == {3.0}
    # The reference may have been taken anew a millimetre below its rest, and the next millimetre is seen a pause later.
    assert {pause for _, fallen, pause in seen if fallen >= 2.0 + speed_mm_s * 3e-3} == {1.0}


def test_reconnecting_goes_on_with_the_counts_and_begins_another_clock(scripted: Open) -> None:
    gone = TrackerError("tracker at scripted: no such port")
    tracker, _ = scripted([frames(60_000, 5), OSError(errno.EIO, "Input/output error")], gone, [frames(0, 2)])
    tracker.read()
    before = tracker.clock_map
    with pytest.raises(TrackerStopped):
        tracker.read()
    tracker.reconnect(5.0)
    assert tracker.read().device_us.tolist() == [0, 1000]
    assert tracker.counts == LinkCounts(received=7)
    assert before is not None
    assert tracker.clock_map is not None
    assert (before.anchor_us, tracker.clock_map.anchor_us) == (60_004_000, 1000)


def test_a_device_that_does_not_come_back_is_named_with_the_reason(scripted: Open, refuses: Refuses) -> None:
    gone = [TrackerError("tracker at scripted: no such port; no serial port is connected") for _ in range(2)]
    tracker, _ = scripted([OSError(errno.EIO, "Input/output error")], *gone, [])
    with refuses(TrackerStopped):
        tracker.reconnect(0.1)
    with refuses(TrackerStopped):
        tracker.reconnect(0.05)


@pytest.mark.parametrize(
    ("error", "words"),
    [
        (serial.SerialException(errno.ENOENT, "could not open port"), "no such port; .*(connected)"),
        (serial.SerialException(errno.EACCES, "could not open port"), "not permitted; let this user"),
        (serial.SerialException(errno.EBUSY, "could not open port"), "another program is using it; close"),
        (serial.SerialException(errno.EAGAIN, "Could not exclusively lock port"), "another program is using it; close"),
        (
            serial.SerialException("Could not configure port"),
            "Could not configure port; check that it is a",
        ),
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
