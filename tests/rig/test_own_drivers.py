"""The drivers that the guide to devices shows, on real lines, and drivers that fail, each in its own process."""

from __future__ import annotations

import os
import re
import select
import signal
import socket
import struct
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager, suppress
from dataclasses import replace
from multiprocessing import Pipe
from pathlib import Path

import numpy as np
import pytest

from palpate.experiment.apparatus import rig as rigs
from palpate.experiment.apparatus.doctor import own as doctor
from palpate.experiment.apparatus.opening import open_actuator
from palpate.experiment.apparatus.panel import calibration
from palpate.experiment.apparatus.panel.accelerometer import listener
from palpate.experiment.apparatus.servo.device import ForceDevice
from palpate.experiment.apparatus.wires.own import force, hosting, process
from palpate.experiment.apparatus.wires.own.actuator import DriverActuator
from palpate.experiment.clock import MonotonicClock
from palpate.experiment.errors import ActuatorError, PalpateError, RecordingError, ServoError
from palpate.experiment.protocol.files import shipped
from palpate.experiment.rehearsal.wires.foot import Foot
from palpate.experiment.rehearsal.wires.serial_line import PseudoTerminal, SerialLine
from tests.experiment.synthesis import stimuli as made
from tests.rig.falling import HAND
from tests.rig.sound import sound_card
from tests.rig.test_servo import ordered

pytestmark = pytest.mark.clocked

ACTUATOR = """
[actuator]
driver = "{driver}"
address = "{address}"
rate_hz = 5000
full_scale_m_s2 = 50.0
output_v = 5.0
"""
PCM = ACTUATOR.format(driver="pcm-tcp", address="127.0.0.1:1").replace("output_v = 5.0\n", "")
SENSOR = """
[accelerometer]
driver = "{driver}"
address = "{address}"
rate_hz = {rate_hz}
full_scale_m_s2 = 100.0
full_scale_v = 2.0
trigger_m_s2 = 0.02
"""
FAULTY = """
import os, sys, time
import numpy as np

class Faulty:
    def __init__(self, settings):
        self.how, self.rate_hz = settings.address, settings.rate_hz
        if self.how == "open slowly":
            time.sleep(30)
        if self.how == "open":
            raise OSError("no such device: Dev1/ao0")
        if self.how == "rate":
            self.rate_hz = 44100
        self.count, self.begun_ns = 0, time.monotonic_ns()

    def prepare(self, samples):
        self.samples = samples
        if self.how == "prepare":
            raise ValueError("too long")

    def play(self, start_ns, stopped):
        if self.how == "raises":
            raise RuntimeError("DAQmx error -200621")
        if self.how == "exits":
            sys.exit("done")
        if self.how == "crashes":
            os.abort()
        if self.how == "hangs":
            time.sleep(30)
        dropped = self.how == "drops"
        return start_ns + 60_000_000 * (self.how == "late"), self.samples.size - dropped, dropped, self.how == "clips"

    def read(self):
        if self.how == "raises":
            raise RuntimeError("DAQmx error -200279")
        if self.how == "hangs":
            time.sleep(30)
        time.sleep(0.02)
        first_ns = self.begun_ns + round(self.count * 1e9 / (self.rate_hz * (0.5 if self.how == "slow" else 1.0)))
        self.count += 100
        return first_ns, np.full(100, 0.5)

    def push(self, out_n, along_n, fast):
        if out_n and self.how == "raises":
            raise RuntimeError("the arm is off")

    def close(self):
        if self.how == "close":
            raise OSError("already closed")
"""


@pytest.fixture
def guide(repository_root: Path) -> Callable[[str], str]:
    text = (repository_root / "palpate" / "guide" / "devices.md").read_text("utf-8")

    def code(name: str) -> str:
        found = re.search(rf"<!-- {name} driver -->\n```python\n(.*?)```", text, re.DOTALL)
        assert found
        return found[1]

    return code


def rig_of(folder: Path, code: str, actuator: str = PCM, sensor: str = "") -> rigs.Rig:
    (folder / "driven.py").write_text(code, "utf-8")
    file = folder / "rig.toml"
    file.write_text(f'format = 6\n\n[rig]\nname = "driven"\nsimulated = false\n{actuator}{sensor}', "utf-8")
    return rigs.load(file)


def faulty(folder: Path, how: str) -> DriverActuator:
    rig = rig_of(folder, FAULTY, ACTUATOR.format(driver="driven:Faulty", address=how))
    opened = open_actuator(rig, limit_m_s2=20.0, clock=MonotonicClock())
    assert isinstance(opened, DriverActuator)
    return opened


class Board(PseudoTerminal):
    """What is at the other end of the README's converter: it keeps a waveform, and plays it in its time."""

    def __init__(self) -> None:
        super().__init__()
        self.played: list[np.ndarray] = []
        self.closing = False
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def _run(self) -> None:
        heard, wave, rate_hz, ends_s = b"", np.zeros(0, "<i2"), 1, None
        while not self.closing:
            left_s = 0.01 if ends_s is None else max(ends_s - time.monotonic(), 0.0)
            if select.select([self._device], [], [], min(left_s, 0.01))[0]:
                heard += os.read(self._device, 1 << 16)
            if ends_s is not None and time.monotonic() >= ends_s:
                self.played.append(wave)
                os.write(self._device, f"{wave.size} 0\n".encode())
                ends_s = None
            line, newline, rest = heard.partition(b"\n")
            if not newline:
                continue
            words = line.split()
            if words[0] == b"wave":
                if len(rest) < 2 * int(words[1]):
                    continue
                wave, rate_hz = np.frombuffer(rest[: 2 * int(words[1])], "<i2"), int(words[2])
                rest = rest[2 * int(words[1]) :]
            elif words[0] == b"go":
                ends_s = time.monotonic() + wave.size / rate_hz
            elif ends_s is not None:
                left = round((ends_s - time.monotonic()) * rate_hz)
                os.write(self._device, f"{max(wave.size - left, 0)} 0\n".encode())
                ends_s = None
            heard = rest

    def close(self) -> None:
        self.closing = True
        self._thread.join()
        super().close()


@pytest.fixture
def board() -> Iterator[Board]:
    with closing(Board()) as opened:
        yield opened


@pytest.mark.parametrize("name", ["actuator", "accelerometer", "force"])
def test_an_example_of_the_guide_is_short_and_needs_nothing_of_palpate(guide: Callable[[str], str], name: str) -> None:
    assert len(guide(name).splitlines()) <= 42
    assert "palpate" not in guide(name)


def test_a_converter_plays_what_was_asked_for_when_it_was(
    guide: Callable[[str], str], tmp_path: Path, board: Board
) -> None:
    rig = rig_of(tmp_path, guide("actuator"), ACTUATOR.format(driver="driven:Converter", address=board.url))
    clock = MonotonicClock()
    wanted = np.sin(np.arange(500) / 10) * 10
    with closing(open_actuator(rig, limit_m_s2=20.0, clock=clock)) as actuator:
        actuator.prepare(made.given(wanted))
        onset_ns = clock.now_ns() + 150_000_000
        assert actuator.aim(onset_ns - 50_000_000)
        assert actuator.aim(onset_ns)
        actuator.landed(0)
        heard = actuator.delivered(0)
        assert heard is not None
        assert heard.requested_ns == onset_ns
        assert heard.onset_error_ms is not None
        assert heard.xruns == 0
        assert actuator.is_silent()
        # 50 m/s^2 are 5 V, and 10 V are 32767.
        assert np.abs(board.played[0] - wanted / 50.0 * 5.0 / 10.0 * 32767).max() <= 0.51
        # One that is withdrawn before it is due plays nothing; one in its middle ends.
        actuator.prepare(made.given(wanted))
        assert actuator.aim(clock.now_ns() + 500_000_000)
        assert actuator.withdraw()
        withdrawn = actuator.delivered(0)
        actuator.prepare(made.given(np.ones(5000)))
        actuator.landed(0)
        time.sleep(0.1)
        assert not actuator.withdraw()
        cut = actuator.delivered(0)
        assert withdrawn is not None
        assert cut is not None
        assert not withdrawn.delivered
        assert not cut.delivered
        assert actuator.is_silent()
    assert len(board.played) == 1


def test_the_limit_and_the_loudest_volt_hold(guide: Callable[[str], str], tmp_path: Path, board: Board) -> None:
    rig = rig_of(tmp_path, guide("actuator"), ACTUATOR.format(driver="driven:Converter", address=board.url))
    with closing(open_actuator(rig, limit_m_s2=20.0, clock=MonotonicClock())) as actuator:
        played = actuator.prepare(made.given(np.full(50, 45.0)))
        actuator.landed(0)
        actuator.delivered(0)
    assert played.limited == 50
    assert np.abs(board.played[0]).max() <= 20.0 / 50.0 * 5.0 / 10.0 * 32767 + 0.51


def test_the_doctor_plays_zeros_and_stops(guide: Callable[[str], str], tmp_path: Path, board: Board) -> None:
    rig = rig_of(tmp_path, guide("actuator"), ACTUATOR.format(driver="driven:Converter", address=board.url))
    found = {one.check: one.verdict for one in doctor.checks(rig, MonotonicClock())}
    assert found == dict.fromkeys(("actuator", "actuator samples", "actuator stop"), "passes")


@pytest.mark.parametrize(
    ("how", "words"),
    [
        ("open", "OSError: no such device: Dev1/ao0"),
        ("rate", "44100"),
    ],
    ids=["raises", "rate"],
)
def test_a_device_that_cannot_be_opened_is_told_of(tmp_path: Path, how: str, words: str) -> None:
    with pytest.raises(ActuatorError) as refused:
        faulty(tmp_path, how)
    assert words in refused.value.finding.what
    assert refused.value.finding.remedy


def test_a_device_that_opens_for_too_long_is_told_of(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(hosting, "OPENS_S", 0.2)
    monkeypatch.setattr(process, "ENDS_S", 0.2)
    with pytest.raises(ActuatorError) as refused:
        faulty(tmp_path, "open slowly")
    assert "0.2 s" in refused.value.finding.what


@pytest.mark.parametrize("how", ["prepare", "raises", "exits", "crashes", "hangs"])
def test_a_driver_that_fails_costs_its_stimulus_and_is_opened_anew(
    tmp_path: Path, how: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("palpate.experiment.apparatus.wires.own.actuator.CLOSE_S", 0.3 if how == "hangs" else 5.0)
    with closing(faulty(tmp_path, how)) as actuator:
        actuator.prepare(made.given(np.ones(5)))
        with pytest.raises(ActuatorError) as refused:
            actuator.landed(0)
            actuator.delivered(0)
        assert "driven:Faulty" in refused.value.finding.what
        assert how == "prepare" or not actuator.is_silent()
        # The device was silenced as it was opened anew.
        actuator.prepare(made.given(np.ones(5)))
        assert actuator.is_silent()


@pytest.mark.parametrize(("how", "xruns"), [("drops", 1), ("clips", 0), ("late", 0)])
def test_what_was_not_played_whole_and_in_time_was_not_delivered(tmp_path: Path, how: str, xruns: int) -> None:
    with closing(faulty(tmp_path, how)) as actuator:
        actuator.prepare(made.given(np.ones(5)))
        actuator.landed(0)
        heard = actuator.delivered(0)
    assert heard is not None
    assert (heard.delivered, heard.xruns) == (False, xruns)
    assert heard.reason


def test_an_audio_input_is_an_accelerometer(guide: Callable[[str], str], tmp_path: Path) -> None:
    table = SENSOR.format(driver="driven:AudioInput", address="system", rate_hz=48_000)
    with sound_card():
        sensor = listener(rig_of(tmp_path, guide("accelerometer"), PCM, table), clock=MonotonicClock())
        with closing(sensor):
            sensor.arm(9_600)
            window = sensor.heard_since_armed()
    assert window.samples_m_s2.size == 9_600
    assert window.clipped == 0


def sensed(folder: Path, how: str, rate_hz: int = 5000) -> np.ndarray:
    rig = rig_of(folder, FAULTY, PCM, SENSOR.format(driver="driven:Faulty", address=how, rate_hz=rate_hz))
    with closing(listener(rig, clock=MonotonicClock())) as sensor:
        sensor.arm(1000 if how != "slow" else 5000)
        return sensor.heard_since_armed().samples_m_s2


def test_volts_are_accelerations(tmp_path: Path) -> None:
    # 0.5 V of 2 V at 100 m/s^2.
    assert set(sensed(tmp_path, "well").tolist()) == {25.0}


@pytest.mark.parametrize("how", ["open", "raises", "hangs", "slow", "rate"])
def test_a_sensor_whose_driver_fails_is_told_of(tmp_path: Path, how: str, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("ALIVE_S", "LATE_S"):
        monkeypatch.setattr(f"palpate.experiment.apparatus.panel.accelerometer.{name}", 0.4)
    monkeypatch.setattr(process, "ENDS_S", 0.3)
    with pytest.raises(RecordingError) as refused:
        sensed(tmp_path, how)
    assert refused.value.finding.remedy


class Far:
    """What is at the other end of the README's arm: it keeps when each force came."""

    def __init__(self) -> None:
        self._server = socket.create_server(("127.0.0.1", 0))
        self.address = f"127.0.0.1:{self._server.getsockname()[1]}"
        self.pushed: list[tuple[float, float]] = []
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def _run(self) -> None:
        with self._server.accept()[0] as line, line.makefile("rb") as heard:
            while message := heard.read(9):
                self.pushed.append((time.monotonic(), struct.unpack("<ff?", message)[0]))

    def close(self) -> None:
        self._thread.join()
        self._server.close()


def pushing(folder: Path, code: str, name: str, address: str) -> rigs.Rig:
    text = shipped("rigs/tapping.toml").read_text("utf-8")
    head, _, servo = text.partition("[servo]")
    servo = re.sub(
        r'driver = "force-tcp"\s*\naddress = "rehearsal"', f'driver = "{name}"\naddress = "{address}"', servo
    )
    (folder / "driven.py").write_text(code, "utf-8")
    file = folder / "rig.toml"
    file.write_text(re.sub(r"(?m)^format = \d", "format = 6", f"{head}[servo]{servo}"), "utf-8")
    return rigs.load(file)


def push(place: tuple[str, str], cycles: int, force_n: float = 0.5) -> float:
    """Push at 1 kHz for so many cycles, then say nothing more; returns when the last message left."""
    last_s = 0.0
    with closing(ForceDevice(place[0], limit_n=2.0, secret=place[1])) as device:
        for _ in range(cycles):
            device.push((force_n, 0.0), fast=False, now_ns=time.monotonic_ns())
            last_s = time.monotonic()
            time.sleep(0.001)
            device.late_ns(time.monotonic_ns())
        time.sleep(0.05)
    return last_s


def test_an_arm_is_let_go_when_the_servo_is_silent(guide: Callable[[str], str], tmp_path: Path) -> None:
    def late_s() -> float:
        far = Far()
        with closing(far), force.served(pushing(tmp_path, guide("force"), "driven:Arm", far.address)) as place:
            last_s = push(place, 50)
        zeros = [at_s for at_s, n in far.pushed if at_s > last_s and n == 0.0]
        assert max(n for _, n in far.pushed) == 0.5
        return zeros[0] - last_s

    # 2 ms by the device's own promise; a busy machine wakes whoever waits later, now and then by more than this.
    assert any(late_s() < 0.05 for _ in range(3))


def test_a_force_beyond_the_device_is_bounded(guide: Callable[[str], str], tmp_path: Path) -> None:
    far = Far()
    rig = pushing(tmp_path, guide("force"), "driven:Arm", far.address)
    small = rig.model_copy(update={"servo": rig.servo and rig.servo.model_copy(update={"full_scale_n": 0.25})})
    small._folder = rig.folder
    with closing(far), force.served(small) as place:
        push(place, 3)
    assert max(n for _, n in far.pushed) == pytest.approx(0.25)


def test_programs_without_the_secret_push_nothing_and_keep_nobody_out(
    guide: Callable[[str], str], tmp_path: Path
) -> None:
    far = Far()
    with closing(far), force.served(pushing(tmp_path, guide("force"), "driven:Arm", far.address)) as (address, secret):
        host, _, port = address.rpartition(":")
        with socket.create_connection((host, int(port))) as silent:
            for shown in ("", "00" * process.SECRET_BYTES):
                with pytest.raises(ServoError):
                    push((address, shown), 20_000, 1.5)
            push((address, secret), 3)
            assert silent.fileno() > 0
    assert max(n for _, n in far.pushed) == 0.5


@pytest.mark.parametrize("returned", [None, (np.nan, 1, 0, 0), (0, 1, 0, 0), (time.monotonic_ns(), 6, 0, 0)])
def test_what_play_returns_has_to_be_possible(returned: object) -> None:
    with pytest.raises(process.DriverFault):
        process._sent(returned, 5, time.monotonic_ns())


@pytest.mark.parametrize("samples", [None, np.zeros((2, 3)), np.array([0.0, np.nan]), np.zeros(0)])
def test_what_read_returns_has_to_be_possible(samples: object) -> None:
    with pytest.raises(process.DriverFault):
        process._block((time.monotonic_ns(), samples))


@pytest.mark.parametrize("how", ["open", "raises"])
def test_an_arm_whose_driver_fails_is_told_of(tmp_path: Path, how: str) -> None:
    code = FAULTY.replace("self.rate_hz = settings.address, settings.rate_hz", "self.rate_hz = settings.address, 1000")
    with pytest.raises(ServoError) as refused, force.served(pushing(tmp_path, code, "driven:Faulty", how)) as place:
        push(place, 100)
    assert refused.value.finding.remedy


LOGGING = """
import os, time

class Arm:
    def __init__(self, settings):
        self.path = settings.address
        self.file = open(self.path, "a", buffering=1)

    def push(self, out_n, along_n, fast):
        print("push", out_n, file=self.file)
        if os.path.exists(self.path + ".hang"):
            time.sleep(60)

    def close(self):
        print("close", file=self.file)
"""


@contextmanager
def arm(folder: Path) -> Iterator[tuple[hosting.DriverProcess, Path]]:
    """Yield a driver at work that a servo makes push with 0.5 N, and the file of what it did."""
    log, over = folder / "log", threading.Event()
    driver = force._started(pushing(folder, LOGGING, "driven:Arm", str(log)))

    def go_on() -> None:
        address, secret = force._place(driver)
        with closing(ForceDevice(address, limit_n=2.0, secret=secret)) as device, suppress(ServoError):
            while not over.wait(0.0005):
                device.push((0.5, 0.0), fast=False, now_ns=time.monotonic_ns())
                device.late_ns(time.monotonic_ns())

    servo = threading.Thread(target=go_on)
    servo.start()
    try:
        while "push 0.5" not in log.read_text("utf-8"):
            time.sleep(0.001)
        yield driver, log
    finally:
        over.set()
        servo.join()
        driver.close()


LET_GO = ["push 0.0", "close"]


@pytest.mark.parametrize("which", ["SIGTERM", "SIGHUP"])
def test_a_signal_to_its_process_leaves_no_force_on(tmp_path: Path, which: str) -> None:
    with arm(tmp_path) as (driver, log):
        driver._process.send_signal(getattr(signal, which))
        if which == "SIGTERM":
            driver._process.wait(5)
            assert log.read_text("utf-8").splitlines()[-2:] == LET_GO
    assert log.read_text("utf-8").splitlines()[-2:] == LET_GO


def test_a_driver_that_goes_before_its_servo_leaves_no_force_on(tmp_path: Path) -> None:
    with arm(tmp_path) as (driver, log):
        driver.close()
        assert driver._process.returncode == 0
        assert log.read_text("utf-8").splitlines()[-2:] == LET_GO


def test_a_push_that_hangs_ends_its_process(tmp_path: Path) -> None:
    with arm(tmp_path) as (driver, log):
        log.with_suffix(".hang").touch()
        driver._process.wait(5)
    assert "`push`" in driver.fault


def test_a_servo_blames_the_driver_that_hung_and_opens_it_anew(tmp_path: Path) -> None:
    log = tmp_path / "log"
    code = LOGGING.replace("class Arm:", "class Arm:\n    rate_hz = 1000")
    hangs, rig = log.with_suffix(".hang"), pushing(tmp_path, code, "driven:Arm", str(log))
    with SerialLine() as line, closing(Foot(line, HAND, real_time=True, tick_s=1 / HAND.rate_hz)):
        orders = replace(ordered(line, "127.0.0.1:1"), answer_ms=500.0)
        with closing(force.DriverServo(rig, orders, MonotonicClock())) as servo:
            hangs.touch()
            with pytest.raises(ServoError) as refused:
                while True:
                    servo.read()
            hangs.unlink()
            assert "driven:Arm" in refused.value.finding.what
            assert servo._driver._process.returncode is not None
            servo.reconnect()
            while servo.read() is None:
                pass
    assert log.read_text("utf-8").splitlines()[-2:] == LET_GO


def test_a_stimulus_that_has_begun_is_not_played_again() -> None:
    ours, theirs = Pipe()
    played: list[int] = []
    begun, ends = threading.Event(), threading.Event()

    class Held:
        def prepare(self, samples: np.ndarray) -> None: ...

        def play(self, start_ns: int, stopped: Callable[[], bool]) -> tuple[int, int, int, int]:
            played.append(start_ns)
            begun.set()
            ends.wait(5)
            return time.monotonic_ns(), 5, 0, 0

    output = process.Output(theirs, Held(), {})
    working = threading.Thread(target=output._work)
    working.start()
    output._hear(process.PREPARE, 1, np.zeros(5))
    output._hear(process.START, 1, time.monotonic_ns())
    assert begun.wait(5)
    output._hear(process.START, 1, time.monotonic_ns())
    ends.set()
    assert ours.recv()[0] == process.SENT
    time.sleep(0.02)
    output._end()
    working.join()
    assert len(played) == 1


OPENS = """
import socket, time

class Slow:
    def __init__(self, settings):
        host, _, port = settings.address.rpartition(":")
        self.line = socket.create_connection((host, int(port)))
        if {in_open}:
            time.sleep(60)

    def read(self):
        time.sleep(60)

    def close(self): ...
"""
SESSION = """
import sys
from pathlib import Path
from palpate.experiment.apparatus import rig
from palpate.experiment.apparatus.panel.accelerometer import listener
listener(rig.load(Path(sys.argv[1])), clock=None).arm(1000)
"""


@pytest.fixture
def outside() -> Iterator[socket.socket]:
    """What a driver connects to: the connection ends with its process."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        server.settimeout(60)
        yield server


def slow(folder: Path, outside: socket.socket, *, in_open: bool) -> rigs.Rig:
    address = f"127.0.0.1:{outside.getsockname()[1]}"
    sensor = SENSOR.format(driver="driven:Slow", address=address, rate_hz=5000)
    return rig_of(folder, OPENS.format(in_open=in_open), PCM, sensor)


@pytest.mark.parametrize("in_open", [True, False], ids=["open", "read"])
def test_a_driver_ends_with_a_session_that_is_killed(tmp_path: Path, outside: socket.socket, in_open: bool) -> None:
    slow(tmp_path, outside, in_open=in_open)
    told = [sys.executable, "-c", SESSION, str(tmp_path / "rig.toml")]
    with subprocess.Popen(told) as session, outside.accept()[0] as driver:
        session.kill()
        driver.settimeout(10)
        assert driver.recv(1) == b""


def test_a_driver_ends_where_its_opening_is_interrupted(
    tmp_path: Path, outside: socket.socket, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(process, "ENDS_S", 0.2)
    lines: list[socket.socket] = []

    def interrupt() -> None:
        lines.append(outside.accept()[0])
        signal.pthread_kill(threading.main_thread().ident or 0, signal.SIGINT)

    waiting = threading.Thread(target=interrupt)
    with closing(listener(slow(tmp_path, outside, in_open=True), clock=MonotonicClock())) as sensor:
        waiting.start()
        with pytest.raises(KeyboardInterrupt):
            sensor.arm(1000)
    waiting.join()
    with lines[0] as driver:
        driver.settimeout(10)
        assert driver.recv(1) == b""


def test_other_programs_that_connect_hold_nothing_up(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    create, others = socket.create_server, list[socket.socket]()

    def besieged(address: tuple[str, int]) -> socket.socket:
        server = create(address)
        others.extend(socket.create_connection(server.getsockname()) for _ in range(2))
        others[1].sendall(bytes(32))
        return server

    monkeypatch.setattr("palpate.experiment.apparatus.wires.own.hosting.socket.create_server", besieged)
    assert sensed(tmp_path, "well").size == 1000
    for other in others:
        other.close()


def test_a_driver_is_in_the_hash_of_its_rig(tmp_path: Path) -> None:
    table = SENSOR.format(driver="driven:Faulty", address="well", rate_hz=5000)
    before = rigs.sha256(rig_of(tmp_path, FAULTY, PCM, table))
    assert rigs.sha256(rig_of(tmp_path, FAULTY, PCM, table.replace("well", "another place"))) == before
    assert rigs.sha256(rig_of(tmp_path, f"{FAULTY}\n", PCM, table)) != before


def test_a_calibration_plays_by_the_driver_and_hears_by_one(tmp_path: Path) -> None:
    tables = (
        ACTUATOR.format(driver="driven:Faulty", address="well"),
        SENSOR.format(driver="driven:Faulty", address="well", rate_hz=5000),
    )
    with calibration.devices(rig_of(tmp_path, FAULTY, *tables), loudest=0.1) as on:
        on.listener.arm(500)
        on.player.play(np.zeros(500, np.float32))
        assert on.listener.heard_since_armed().samples_m_s2.size == 500
    dropping = rig_of(tmp_path, FAULTY, tables[0].replace("well", "drops"), tables[1])
    with calibration.devices(dropping, loudest=0.1) as on, pytest.raises(PalpateError):
        on.player.play(np.zeros(500, np.float32))
