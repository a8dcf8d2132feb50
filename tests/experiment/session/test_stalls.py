"""A disk that does not answer holds up what waits for it, and neither a limit nor a pause; nothing of it is lost."""

from __future__ import annotations

import ctypes
import os
import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import closing
from itertools import pairwise
from pathlib import Path

import pytest

from palpate.experiment.apparatus.audio.masker import left_s
from palpate.experiment.apparatus.ports import MaskerExposure
from palpate.experiment.clock import MonotonicClock
from palpate.experiment.desk import interrupts
from palpate.experiment.desk.questions import BY_EXPERIMENTER, BY_PARTICIPANT, INTERRUPTED, STOPPED
from palpate.experiment.errors import PalpateError, PedalError
from palpate.experiment.protocol.models import Masker
from palpate.experiment.records import journal
from palpate.experiment.records.entries import Commanded, Exposure, MaskerSet, Note
from palpate.experiment.records.journal import Contents
from palpate.experiment.records.progress import progress
from palpate.experiment.rehearsal.clock import ManualClock
from palpate.experiment.session import exposure
from palpate.experiment.session.exposure import Exposed
from palpate.experiment.session.kinds.tapping.trials import Comparisons
from palpate.experiment.session.masker import Masking
from palpate.experiment.session.runner import SessionLog
from tests.experiment.session.bench import HEADER
from tests.experiment.session.scripted import START_NS, ScriptedConsole

SILENT_S = 0.2
"""Everything is silent so soon after a limit, a pause or a signal, s."""

SLOW_S = 0.3

pytestmark = pytest.mark.fsync

MASKER = Masker(noise="pink", level_set_by="participant", criterion="x")


class Disk:
    """What `os.fsync` waits for."""

    def __init__(self) -> None:
        self.answers = threading.Event()
        self.answers.set()
        self.asked = threading.Event()

    def fsync(self, _: int) -> None:
        self.asked.set()
        assert self.answers.wait(30)

    def stop(self) -> None:
        self.asked.clear()
        self.answers.clear()


class Noise:
    """Implements `Masker`, and keeps when it fell silent, in seconds of the monotonic clock."""

    limit_db_a = 80.0

    def __init__(self) -> None:
        self.level_db_a: float | None = None
        self.silent_s: float | None = None

    def start(self, level_db_a: float) -> float:
        self.level_db_a = level_db_a
        return level_db_a

    def set_level(self, level_db_a: float) -> float:
        return level_db_a

    def stop(self) -> None:
        if self.level_db_a is not None:
            self.level_db_a, self.silent_s = None, time.monotonic()

    def exposure(self) -> MaskerExposure:
        level_db_a = self.level_db_a
        return MaskerExposure(
            level_db_a, 0.0, None, None if level_db_a is None else left_s(dose=0.0, level_db_a=level_db_a)
        )


class Felt(Comparisons):
    """A kind of trial that keeps what the limits ask of it, and when."""

    def __init__(self) -> None:
        self.beats_s: list[float] = []
        self.quieted: list[tuple[float, str]] = []

    def beat(self, ends_ns: int) -> None:
        self.beats_s.append(time.monotonic())

    def quiet(self, why: str) -> None:
        self.quieted.append((time.monotonic(), why))


class Watched:
    """A session's limits in real time, its journal and its masker, which plays."""

    def __init__(self, path: Path, *, lasts_s: float = 600.0) -> None:
        self.path, self.clock = path, MonotonicClock()
        self.steps: bool | PalpateError = False
        header = HEADER.model_copy(update={"purpose": "STUDY"})
        self.log = SessionLog(path, self.clock, Contents(()), progress((header,)), None)
        self.log.write(header)
        self.noise, self.felt = Noise(), Felt()
        self.console = ScriptedConsole(ManualClock(START_NS), "")
        self.console.levels.append(".")
        self.masking = Masking(self.noise, self.console, self.log.write, self.clock)
        self.began_s = time.monotonic()
        self.exposed = Exposed(
            ends_ns=self.clock.now_ns() + int(lasts_s * 1e9),
            ended="it is over",
            masking=self.masking,
            console=self.console,
            clock=self.clock,
            log=self.log,
            pressed=self.press,
        )
        self.exposed.begin(self.felt)
        self.masking.choose(MASKER, 60.0, None)

    def press(self) -> bool:
        """Be a pedal, which is pressed once `steps` is set, or fails."""
        time.sleep(0.01)
        if isinstance(steps := self.steps, PalpateError):
            raise steps
        return steps

    def silent_s(self) -> float:
        """Wait until nothing is felt or heard, and return when that was."""
        wait_until(lambda: self.noise.silent_s is not None and bool(self.felt.quieted))
        return max(self.noise.silent_s or 0.0, self.felt.quieted[0][0])

    def close(self) -> None:
        self.exposed.close()
        self.log.close()


def wait_until(holds: Callable[[], bool]) -> None:
    ends_s = time.monotonic() + 10
    while not holds():
        assert time.monotonic() < ends_s
        time.sleep(0.001)


@pytest.fixture
def disk(monkeypatch: pytest.MonkeyPatch) -> Iterator[Disk]:
    made = Disk()
    monkeypatch.setattr(os, "fsync", made.fsync)
    monkeypatch.setattr(exposure, "SLOW_S", SLOW_S)
    yield made
    made.answers.set()


@pytest.fixture
def aside(disk: Disk) -> Iterator[list[threading.Thread]]:
    """Threads that wait for the disk."""
    made: list[threading.Thread] = []
    yield made
    disk.answers.set()
    for one in made:
        one.join(10)


def test_the_sessions_end_is_met_while_the_disk_hangs_and_both_are_told(
    disk: Disk, aside: list[threading.Thread], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(exposure, "EVERY_NS", 50_000_000)
    with closing(Watched(tmp_path / "a.jsonl", lasts_s=0.5)) as watched:
        disk.stop()
        notes = [Note(trial=None, text=str(n)) for n in range(3)]
        for note in notes:
            aside.append(threading.Thread(target=watched.log.write, args=(note,)))
            aside[-1].start()
        assert disk.asked.wait(10)
        assert 0 <= watched.silent_s() - watched.began_s - 0.5 < SILENT_S
        wait_until(lambda: exposure.SLOW in watched.console.shown)
        assert watched.log.waiting_s >= SLOW_S
        # The heart beats on: that nothing may be felt is no fault.
        beats = len(watched.felt.beats_s)
        wait_until(lambda: len(watched.felt.beats_s) > beats + 1)
        disk.answers.set()
        wait_until(lambda: watched.log.waiting_s == 0 and "The disk is responding again." in watched.console.shown)
        assert {why for _, why in watched.felt.quieted} == {"it is over"}
        for one in aside:
            one.join(10)
        watched.exposed.settle()
        watched.masking.record()
    entries = journal.read(watched.path).entries
    assert sorted(one.text for one in entries if isinstance(one, Note)) == ["0", "1", "2"]
    assert [one.level_db_a for one in entries if isinstance(one, MaskerSet)] == [60.0, None]
    assert any(isinstance(one, Exposure) for one in entries)
    assert max(after - before for before, after in pairwise(watched.felt.beats_s)) < 0.4


def test_a_pause_is_felt_and_heard_at_once_while_the_disk_hangs(
    disk: Disk, aside: list[threading.Thread], tmp_path: Path
) -> None:
    with closing(Watched(tmp_path / "a.jsonl")) as watched:
        disk.stop()
        aside.append(threading.Thread(target=watched.log.write, args=(Note(trial=None, text="hangs"),)))
        aside[0].start()
        assert disk.asked.wait(10)
        begun_s = time.monotonic()
        watched.exposed.pause(BY_EXPERIMENTER)
        assert watched.silent_s() - begun_s < SILENT_S
        assert watched.felt.quieted[0][1] == watched.exposed.end_reason() == BY_EXPERIMENTER
        disk.answers.set()


def test_what_is_not_on_record_is_bounded_by_what_a_resume_counts(
    disk: Disk, aside: list[threading.Thread], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(exposure, "GONE_S", 0.5)
    with closing(Watched(tmp_path / "a.jsonl")) as watched:
        disk.stop()
        begun_s = time.monotonic()
        aside.append(threading.Thread(target=watched.log.write, args=(Note(trial=None, text="hangs"),)))
        aside[0].start()
        assert 0.5 <= watched.silent_s() - begun_s < 0.5 + SILENT_S
        assert watched.felt.quieted[0][1] == watched.exposed.end_reason() == exposure.GONE
        disk.answers.set()
        aside[0].join(10)
        # It stays over, also once the disk answers.
        assert watched.exposed.end_reason() == exposure.GONE
    assert exposure.KILLED_NS > exposure.EVERY_NS + 5.0e9 + 2 * exposure.LOOK_S * 1e9


@pytest.mark.parametrize("number", interrupts.SIGNALS)
def test_a_signal_silences_everything_while_the_main_thread_is_in_a_call_that_does_not_return(
    number: int, disk: Disk, tmp_path: Path
) -> None:
    library = ctypes.CDLL(None)
    mutex = ctypes.create_string_buffer(64)
    signalled_s: list[float] = []

    def strike() -> None:
        time.sleep(0.1)
        signalled_s.append(time.monotonic())
        os.kill(os.getpid(), number)
        time.sleep(0.5)
        library.pthread_mutex_unlock(mutex)

    with interrupts.all_alike(), closing(Watched(tmp_path / "a.jsonl")) as watched:
        library.pthread_mutex_lock(mutex)
        striking = threading.Thread(target=strike)
        with pytest.raises(KeyboardInterrupt):
            striking.start()
            # Taken a second time it waits, and no signal ends that: a call into a disk that hangs is like it.
            library.pthread_mutex_lock(mutex)
            time.sleep(10)
        returned_s = time.monotonic()
        striking.join(10)
        assert returned_s - signalled_s[0] > 0.4
        assert watched.silent_s() - signalled_s[0] < SILENT_S
        assert watched.exposed.end_reason() == INTERRUPTED
    assert signal.set_wakeup_fd(-1) == -1


def test_the_participants_pedal_silences_everything_while_the_disk_hangs_and_goes_on_record(
    disk: Disk, aside: list[threading.Thread], tmp_path: Path
) -> None:
    with closing(Watched(tmp_path / "a.jsonl")) as watched:
        disk.stop()
        aside.append(threading.Thread(target=watched.log.write, args=(Note(trial=None, text="a note"),)))
        aside[-1].start()
        assert disk.asked.wait(10)
        begun_s, watched.steps = time.monotonic(), True
        assert watched.silent_s() - begun_s < 0.2
        wait_until(lambda: STOPPED in watched.console.shown)
        assert watched.exposed.end_reason() == BY_PARTICIPANT
        disk.answers.set()
        aside[-1].join(10)
    written = [line.entry for line in journal.read(tmp_path / "a.jsonl").lines]
    assert [(one.by, one.taken) for one in written if isinstance(one, Commanded)] == [("pedal", True)]


def test_a_pedal_that_fails_ends_what_is_felt(disk: Disk, tmp_path: Path) -> None:
    with closing(Watched(tmp_path / "a.jsonl")) as watched:
        begun_s, watched.steps = time.monotonic(), PedalError("pedal", "was silent")
        assert watched.silent_s() - begun_s < 0.2
        wait_until(lambda: any("was silent" in line for line in watched.console.shown))
        with pytest.raises(PedalError):
            watched.exposed.end_reason()


@pytest.mark.parametrize("begins", [True, False])
def test_no_level_is_heard_before_it_is_on_record_and_none_after_silence(
    disk: Disk, aside: list[threading.Thread], tmp_path: Path, begins: bool
) -> None:
    with closing(Watched(tmp_path / "a.jsonl")) as watched:
        watched.noise.level_db_a = None if begins else 60.0
        wait_until(lambda: not watched.log.waiting_s)
        disk.stop()
        louder = (watched.masking.choose, (MASKER, 60.0, None)) if begins else (watched.masking.change, ("+",))
        watched.console.levels.append(".")
        aside.append(threading.Thread(target=louder[0], args=louder[1]))
        aside[-1].start()
        assert disk.asked.wait(10)
        time.sleep(0.05)
        assert watched.noise.level_db_a == (None if begins else 60.0)
        watched.exposed.pause("it is asked for")
        disk.answers.set()
        aside[-1].join(10)
        assert watched.noise.level_db_a is None
