"""Triggers on real lines: of a session, of lines that hang or are pulled, of the doctor, and of a driver of one's own.

Lab Streaming Layer is heard by another process, on this machine alone.
"""

from __future__ import annotations

import os
import re
import select
import shutil
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, closing
from pathlib import Path
from typing import Self

import pytest
import serial

from palpate.experiment import storage
from palpate.experiment.apparatus import host, opening
from palpate.experiment.apparatus import rig as rigs
from palpate.experiment.apparatus.doctor import triggers as doctor
from palpate.experiment.apparatus.wires import lsl, triggers
from palpate.experiment.apparatus.wires.settings import TriggerEvents, TriggerRig
from palpate.experiment.apparatus.wires.triggers import SessionTriggers, TriggerLine
from palpate.experiment.clock import Clock, MonotonicClock
from palpate.experiment.dataset.verify import verify
from palpate.experiment.desk.link.wire import Stop
from palpate.experiment.errors import RigError
from palpate.experiment.protocol.files import shipped
from palpate.experiment.records import journal
from palpate.experiment.records.entries import Armed, Footer, Redo, Resumed, Triggers
from palpate.experiment.rehearsal.clock import ManualClock
from palpate.experiment.rehearsal.wires.serial_line import PseudoTerminal
from tests.rig.visited import Desk

pytestmark = pytest.mark.clocked

TTL = """
[[triggers]]
driver = "{driver}"
port = "{port}"
baud = 115200
events = {{ start = 1, trial = 2, stimulus = 3, answer = 4, pause = 5, end = 6 }}
"""
LSL = '\n[[triggers]]\ndriver = "lsl"\nstream = "{name}"\nevents = {{ trial = 20, stimulus = 30 }}\n'


GUIDE = "experiment/apparatus/README.md"


class Wire(PseudoTerminal):
    """A serial line whose other end reads."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def read(self, size: int) -> bytes:
        """What comes, until it has so many bytes."""
        came = b""
        while len(came) < size and select.select([self._device], [], [], 5)[0]:
            came += os.read(self._device, 4096)
        return came


@pytest.fixture
def wire() -> Iterator[Wire]:
    with Wire() as laid:
        yield laid


def rig_file(folder: Path, *tables: str, name: str = "presented") -> Path:
    shutil.copy(shipped("rigs/rehearsal-response.csv"), folder)
    text = re.sub(r"(?m)^format = \d+", "format = 6", shipped(f"rigs/{name}.toml").read_text("utf-8"), count=1)
    (folder / "rig.toml").write_text("".join((text, *tables)), "utf-8")
    return folder / "rig.toml"


LISTEN = """
import sys, pylsl
from palpate.experiment.apparatus.wires.lsl import scope
pylsl.set_config_content(scope(None))
found = pylsl.resolve_byprop("name", sys.argv[1], 1, 30)
inlet = pylsl.StreamInlet(found[0])
inlet.open_stream(10)
print("there", flush=True)
while (sample := inlet.pull_sample(20))[0]:
    print(sample[0][0], sample[1] + inlet.time_correction(10), flush=True)
"""


def test_a_session_is_followed_on_two_lines_and_the_journal_has_what_was_sent(tmp_path: Path, wire: Wire) -> None:
    name = f"palpate test {os.getpid()}"
    text = shipped("presented.toml").read_text("utf-8").replace("repetitions = 10", "repetitions = 1")
    (tmp_path / "study.toml").write_text(text.replace('set_off = "experimenter"', 'set_off = "clock"'), "utf-8")
    rig_file(tmp_path, TTL.format(driver="ttl", port=wire.url), LSL.format(name=name))
    with ExitStack() as opened:
        listening = subprocess.Popen([sys.executable, "-c", LISTEN, name], stdout=subprocess.PIPE, text=True)
        listener = opened.enter_context(listening)
        opened.callback(listener.kill)
        desk = opened.enter_context(closing(Desk(tmp_path, ("run", "study.toml", "--practice", "--rig", "rig.toml"))))
        desk.connect()
        assert listener.stdout is not None
        listener.stdout.readline()
        desk.visit(lambda view: view.trial == 2)
        assert desk.there is not None
        desk.there.send(Stop())
        assert desk.visit().ended is not None
        entries = journal.read(storage.journal_path(desk.root, "01", "name")).entries
        sent = [one for entry in entries if isinstance(entry, Triggers) for one in entry.sent]
        bytes_sent = [one.number for one in sent if one.line == 1]
        assert bytes(bytes_sent) == wire.read(len(bytes_sent))
        assert bytes_sent[:5] == [1, 2, 3, 4, 2]
        assert bytes_sent[-1] == 5
        markers = [one for one in sent if one.line == 2]
        heard = [listener.stdout.readline().split() for _ in markers]
    assert [int(number) for number, _ in heard] == [one.number for one in markers]
    # Both clocks are this machine's, and a marker is dated at its event, however late it left.
    began_ns = time.time_ns() - time.monotonic_ns()
    off_s = [began_ns / 1e9 + float(at_s) - one.due_ns / 1e9 for (_, at_s), one in zip(heard, markers, strict=True)]
    assert max(off_s) - min(off_s) < 0.5
    assert all(one.late_ms is not None and one.late_ms >= 0 for one in sent)
    assert verify(desk.root).refused == 0


class Fake:
    """A line that does what a test has it do."""

    def __init__(self, settings: TriggerRig) -> None:
        self.goes, self.begins = threading.Event(), threading.Event()
        self.sent: list[int] = []
        self.cores: set[int] = set()
        self.fault: OSError | None = None
        self.closes: OSError | None = None

    def send(self, number: int, late_s: float) -> None:
        self.cores = os.sched_getaffinity(0)
        self.begins.set()
        self.goes.wait()
        if self.fault is not None:
            raise self.fault
        self.sent.append(number)

    def close(self) -> None:
        self.goes.set()
        if self.closes is not None:
            raise self.closes


@pytest.fixture
def fake(monkeypatch: pytest.MonkeyPatch) -> Fake:
    made = Fake(TriggerRig(driver="fake:Fake", events=TriggerEvents(trial=1)))
    for opens in (triggers, doctor):
        monkeypatch.setattr(opens, "open_line", lambda *_: made)
    return made


def followed(folder: Path, told: list[str], opened: ExitStack, clock: Clock) -> SessionTriggers:
    rig = rigs.load(rig_file(folder, TTL.format(driver="fake:Fake", port="none")))
    return triggers.open_triggers(rig, clock, told.append, opened)


@pytest.fixture
def clock() -> ManualClock:
    """A session's time, which the test moves; a line that waits for it looks again after so long in real time."""
    return ManualClock(1_000_000_000_000)


@pytest.fixture
def patient(monkeypatch: pytest.MonkeyPatch) -> None:
    """The end of a session waits for its lines as long as a busy machine takes."""
    monkeypatch.setattr(triggers, "ENDS_S", 30.0)


ARMED = Armed(trial=1, attempt=1, presented=("foil",))


def test_a_line_that_hangs_delays_nothing_and_is_on_record_and_shown(
    tmp_path: Path, fake: Fake, clock: ManualClock
) -> None:
    told: list[str] = []
    with ExitStack() as opened:
        opened.callback(fake.goes.set)
        line = followed(tmp_path, told, opened, clock)
        # Who waited for the line would wait for ever.
        line.after(Resumed(torn="", remaining=()))
        assert fake.begins.wait(30)
        line.after(ARMED)
        assert line.before(ARMED) == ()
        clock.sleep_ns(triggers.HANGS_NS)
        (lost,) = line.before(ARMED)
        assert [(one.event, one.late_ms) for one in lost.sent] == [("start", None), ("trial", None)]
        # What comes while it still hangs is on record each time.
        for _ in range(2):
            line.after(ARMED)
            clock.sleep_ns(triggers.HANGS_NS // 2)
            (lost,) = line.before(ARMED)
            assert [(one.event, one.late_ms) for one in lost.sent] == [("trial", None)]
        (lost,) = line.before(Footer(reason="paused", answered=0))
        assert [one.event for one in lost.sent] == ["pause"]


@pytest.mark.usefixtures("patient")
def test_a_line_that_comes_back_sends_nothing_that_is_long_past(tmp_path: Path, fake: Fake, clock: ManualClock) -> None:
    told: list[str] = []
    with ExitStack() as opened:
        opened.callback(fake.goes.set)
        line = followed(tmp_path, told, opened, clock)
        line.after(Resumed(torn="", remaining=()))
        assert fake.begins.wait(30)
        clock.sleep_ns(triggers.HANGS_NS)
        line.before(ARMED)
        line.after(ARMED)
        clock.sleep_ns(triggers.HANGS_NS)
        fake.goes.set()
        (ended,) = line.before(Footer(reason="complete", answered=0))
        assert [(one.event, one.late_ms is None) for one in ended.sent] == [("trial", True), ("end", False)]
    assert (fake.sent, len(told)) == ([1, 6], 1)


@pytest.mark.usefixtures("patient")
def test_a_driver_that_fails_to_close_is_told_of(tmp_path: Path, fake: Fake, clock: ManualClock) -> None:
    told: list[str] = []
    fake.closes = OSError("pulled out")
    with ExitStack() as opened:
        followed(tmp_path, told, opened, clock)
    assert len(told) == 1


@pytest.mark.usefixtures("patient")
def test_a_line_keeps_off_the_core_of_its_session(tmp_path: Path, fake: Fake, clock: ManualClock) -> None:
    others = frozenset(sorted(os.sched_getaffinity(0))[:1])
    left = host._left.set(others)
    fake.goes.set()
    with ExitStack() as opened:
        opened.callback(host._left.reset, left)
        line = followed(tmp_path, [], opened, clock)
        line.after(ARMED)
        assert fake.begins.wait(30)
    assert fake.cores == others


@pytest.mark.usefixtures("patient")
def test_a_line_that_fails_is_told_of_once_and_sends_again_when_it_can(
    tmp_path: Path, fake: Fake, clock: ManualClock
) -> None:
    told: list[str] = []
    fake.goes.set()
    fake.fault = OSError("pulled out")
    with ExitStack() as opened:
        line = followed(tmp_path, told, opened, clock)
        for _ in range(2):
            line.after(ARMED)
        (ended,) = line.before(Footer(reason="error", answered=0))
        assert [(one.event, one.late_ms) for one in ended.sent] == [("trial", None), ("trial", None), ("end", None)]
        assert {one.problem for one in ended.sent} == {"OSError: pulled out"}
        fake.fault = None
        line.after(ARMED)
        (again,) = line.before(Footer(reason="paused", answered=0))
    assert [one.late_ms is None for one in again.sent] == [False, False]
    assert (fake.sent, len(told)) == ([2, 5], 1)


AHEAD_NS = 30_000_000


class Scheduling:
    """An actuator that schedules, and takes its stimulus back until its lead before the onset."""

    lead_ns = 1_000_000

    def prepare(self, stimulus: object) -> object:
        return stimulus

    def aim(self, onset_ns: int) -> bool:
        return onset_ns > 0

    def landed(self, contact_ns: int) -> None:
        pass

    def __init__(self) -> None:
        self.withdraws = True

    def withdraw(self) -> bool:
        return self.withdraws


@pytest.mark.usefixtures("patient")
def test_a_stimulus_is_sent_at_the_onset_that_was_aimed_at_last_and_not_if_it_is_withdrawn(
    tmp_path: Path, fake: Fake, clock: ManualClock
) -> None:
    fake.goes.set()

    def past(line: SessionTriggers) -> None:
        """Let what was aimed at pass, and its trigger be sent."""
        clock.sleep_ns(AHEAD_NS)
        line._lines[0].settle(30)

    with ExitStack() as opened:
        line = followed(tmp_path, [], opened, clock)
        playing = Scheduling()
        actuator = line.following(playing)  # type: ignore[arg-type]
        # The probe of the masker is of no trial.
        actuator.landed(0)
        line.after(ARMED)
        actuator.prepare(None)  # type: ignore[arg-type]
        actuator.aim(clock.now_ns() + 100 * AHEAD_NS)
        onset_ns = clock.now_ns() + AHEAD_NS
        assert actuator.aim(onset_ns)
        actuator.landed(onset_ns)
        past(line)
        actuator.prepare(None)  # type: ignore[arg-type]
        actuator.aim(clock.now_ns() + AHEAD_NS)
        actuator.withdraw()
        past(line)
        actuator.prepare(None)  # type: ignore[arg-type]
        late_ns = clock.now_ns() + AHEAD_NS
        actuator.aim(late_ns)
        # What can no longer be moved or withdrawn is sent.
        playing.withdraws = False
        assert not actuator.aim(-1)
        assert not actuator.withdraw()
        past(line)
        actuator.prepare(None)  # type: ignore[arg-type]
        at_once_ns = clock.now_ns() + playing.lead_ns
        actuator.landed(clock.now_ns())
        assert not actuator.withdraw()
        past(line)
        line.after(Redo(trial=1, attempt=1, reason="a test", put_off=True))
        actuator.prepare(None)  # type: ignore[arg-type]
        actuator.landed(clock.now_ns())
        (sent,) = line.before(Footer(reason="complete", answered=0))
    assert [one.event for one in sent.sent] == ["trial", "stimulus", "stimulus", "stimulus", "end"]
    assert [one.due_ns for one in sent.sent[1:4]] == [onset_ns, late_ns, at_once_ns]
    assert sent.sent[1].late_ms is not None
    assert sent.sent[1].late_ms >= 0


def test_the_doctor_sends_its_test_and_says_what_each_line_is_for(
    tmp_path: Path, wire: Wire, monkeypatch: pytest.MonkeyPatch
) -> None:
    tables = TTL.format(driver="ttl", port=wire.url), TTL.format(driver="ttl", port="/dev/no-such-port")
    rig = rigs.load(rig_file(tmp_path, *tables, LSL.format(name="palpate doctor")))
    there, gone, stream = doctor.checks(rig, clock=MonotonicClock())
    assert [one.verdict for one in (there, gone, stream)] == ["passes", "refuses", "passes"]
    assert wire.read(1) == bytes([triggers.TEST])
    monkeypatch.setitem(sys.modules, "palpate.experiment.apparatus.wires.lsl", None)
    monkeypatch.setitem(sys.modules, "pylsl", None)
    assert [one.verdict for one in doctor.checks(rig, clock=MonotonicClock())] == ["passes", "refuses", "refuses"]


def test_the_doctor_refuses_a_driver_that_fails_to_close(tmp_path: Path, fake: Fake) -> None:
    table = TTL.format(driver="fake:Fake", port="none")
    rig = rigs.load(rig_file(tmp_path, table, table))
    fake.goes.set()
    fake.closes = OSError("pulled out")
    assert [one.verdict for one in doctor.checks(rig, clock=MonotonicClock())] == ["refuses", "refuses"]


def guided(folder: Path, guide: Path, wire: Wire) -> TriggerLine:
    found = re.search(r"<!-- trigger driver -->\n```python\n(.*?)```", guide.read_text("utf-8"), re.DOTALL)
    assert found
    assert len(found[1].splitlines()) <= 40
    (folder / "pulsebox.py").write_text(found[1], "utf-8")
    return triggers.open_line(rigs.load(rig_file(folder, TTL.format(driver="pulsebox:PulseBox", port=wire.url))), 1)


def test_another_content_of_a_driver_is_another_rig_and_each_session_has_its_copy(tmp_path: Path) -> None:
    driver = tmp_path / "fake.py"
    driver.write_text("class Fake: ...\n")
    file = rig_file(tmp_path, TTL.format(driver="fake:Fake", port="none"))
    digest = rigs.sha256(rigs.load(file))
    opening.copy_rig(file, copy := tmp_path / "dataset" / "rig.toml")
    assert rigs.session_rig(copy, digest).driver_files == (copy.with_name("fake.py"),)
    driver.write_text("class Fake:\n    number = 2\n")
    assert rigs.sha256(rigs.load(file)) != digest
    with pytest.raises(RigError):
        opening.copy_rig(file, copy)
    # What a line is sent is not measured: other numbers and ports are the same rig.
    rig_file(tmp_path, TTL.format(driver="fake:Fake", port="another"))
    assert rigs.sha256(rigs.load(file)) != digest
    driver.write_text("class Fake: ...\n")
    assert rigs.sha256(rigs.load(file)) == digest


def test_the_driver_of_the_guide_clears_what_it_sends(tmp_path: Path, wire: Wire, repository_root: Path) -> None:
    with closing(guided(tmp_path, repository_root / GUIDE, wire)) as line:
        line.send(3, 0.0)
        line.send(4, 0.0)
    assert wire.read(4) == b"\x03\0\x04\0"


def test_the_driver_of_the_guide_says_at_the_next_trigger_that_the_last_was_not_cleared(
    tmp_path: Path, wire: Wire, repository_root: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    gone = threading.Event()

    def pulled(_: object, sent: bytes) -> None:
        if sent == b"\0":
            gone.set()
            raise OSError("pulled out")

    line = guided(tmp_path, repository_root / GUIDE, wire)
    monkeypatch.setattr(serial.Serial, "write", pulled)
    line.send(3, 0.0)
    assert gone.wait(30)
    with pytest.raises(OSError, match="pulled"):
        line.send(4, 0.0)
    line.close()


def test_without_an_interface_nothing_but_this_machine_is_told() -> None:
    assert "ResolveScope = machine\nListenAddress = 127.0.0.1\n" in lsl.scope(None)
    assert "ResolveScope = link\nListenAddress = 192.0.2.1\n" in lsl.scope("192.0.2.1")


@pytest.mark.parametrize(
    ("table", "field"),
    [
        ('driver = "ttl"\nport = "/dev/x"\nevents = { end = 1 }', "triggers[0].baud"),
        ('driver = "lsl"\nstream = "x"\nport = "/dev/x"\nevents = { end = 1 }', "triggers[0].port"),
        ('driver = "lsl"\nstream = "x"\nevents = {}', "triggers[0].events"),
        ('driver = "lsl"\nstream = "x"\nevents = { end = 1, start = 1 }', "triggers[0].events"),
        ('driver = "lsl"\nstream = "x"\nevents = { end = 255 }', "triggers[0].events.end"),
        ('driver = "lsl"\nstream = "x"\nevents = { answered = 1 }', "triggers[0].events.answered"),
        ('driver = "serial"\nevents = { end = 1 }', "triggers[0].driver"),
    ],
)
def test_a_table_that_would_not_send_is_refused(tmp_path: Path, table: str, field: str) -> None:
    with pytest.raises(RigError) as refused:
        rigs.load(rig_file(tmp_path, f"\n[[triggers]]\n{table}\n"))
    assert [one.field for one in refused.value.findings] == [field]


def test_one_stream_at_most(tmp_path: Path) -> None:
    with pytest.raises(RigError) as refused:
        rigs.load(rig_file(tmp_path, LSL.format(name="a"), LSL.format(name="b")))
    assert [one.field for one in refused.value.findings] == ["triggers"]


def test_triggers_are_of_no_account_to_what_is_measured(tmp_path: Path) -> None:
    without = rigs.sha256(rigs.load(rig_file(tmp_path)))
    assert rigs.sha256(rigs.load(rig_file(tmp_path, LSL.format(name="a")))) == without
