"""What listens to the simulated sound card, in a process of its own."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from filelock import FileLock

from palpate.experiment.apparatus.audio.mixer import AT_ONCE
from palpate.experiment.errors import AudioError
from palpate.experiment.rehearsal.wires import mouth, sound_card
from palpate.experiment.rehearsal.wires.listener import Tap
from palpate.experiment.rehearsal.wires.sound_card import SoundCard
from tests.rig import sound

pytestmark = pytest.mark.clocked

SERVES = """
from palpate.experiment.rehearsal.wires.sound_card import SoundCard
from palpate.experiment.rehearsal.wires.listener import Tap
card = SoundCard(rate_hz=48_000, block=256, inputs=1, outputs=1)
tap = Tap(card.name, "system:capture_1", seconds=1.0)
print(card.folder.name, card.name, tap.listener.pid, flush=True)
input()
"""


@contextmanager
def killed() -> Iterator[tuple[str, int]]:
    """The name of another process's server, and the number of that one's listener; in the end the process is killed."""
    with subprocess.Popen([sys.executable, "-c", SERVES], stdin=subprocess.PIPE, stdout=subprocess.PIPE) as serves:
        assert serves.stdout is not None
        folder, name, listener = serves.stdout.readline().decode().split()
        try:
            yield name, int(listener)
        finally:
            serves.kill()
            shutil.rmtree(folder)


def asked_until(seconds: float, tap: Tap) -> None:
    ends = time.monotonic() + seconds
    while time.monotonic() < ends:
        tap.since(0)
        time.sleep(0.01)


def lives(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except FileNotFoundError:
        return False


@pytest.fixture
def card() -> Iterator[SoundCard]:
    with sound.sound_card() as opened:
        yield opened


def test_it_hears_every_sample_of_its_output_and_of_no_other(card: SoundCard) -> None:
    wave = np.random.default_rng(0).uniform(-1, 1, 5000).astype(np.float32)
    with sound.stream() as stream:
        taps = card.tap(2, seconds=30.0), card.tap(3, seconds=30.0)
        cue = stream.schedule(wave, channel=1, frame=AT_ONCE)
        while not cue.done:
            stream.wait(stream.next_frame + 1)
        stream.wait(stream.next_frame + 2 * sound.BLOCK)
        (first, heard), (_, other) = (tap.since(0) for tap in taps)
        for tap in taps:
            tap.close()
    begin = int(np.flatnonzero(heard)[0])
    assert first == 0
    assert np.array_equal(heard[begin : begin + wave.size], wave)
    assert np.count_nonzero(heard) == np.count_nonzero(wave)
    assert other.size
    assert not other.any()


def test_what_begins_at_a_server_and_starts_and_stops_one_has_its_turn(monkeypatch: pytest.MonkeyPatch) -> None:
    lock = FileLock(f"/dev/shm/palpate-sound-{os.getuid()}.lock", blocking=False)
    seen = []

    def noting(name: str, then: Callable[..., Any] = lambda *_, **__: None) -> Callable[..., Any]:
        def noted(*given: Any, **named: Any) -> Any:
            with pytest.raises(TimeoutError):
                lock.acquire()
            seen.append(name)
            return then(*given, **named)

        return noted

    for name in ("_started", "_stop"):
        monkeypatch.setattr(SoundCard, name, noting(name, getattr(SoundCard, name)))
    for module, name in ((sound_card, "Tap"), (mouth, "Mouth")):
        monkeypatch.setattr(module, name, noting(name))
    with sound.sound_card() as card:
        with sound.stream():
            card.tap(1, seconds=1.0)
            card.mouth(1, 1, np.ones(1, np.float32))
        card.close()
        monkeypatch.undo()
    # A server that does not start in time is stopped within `_started`, and the next name is tried.
    assert list(dict.fromkeys(reversed(seen))) == ["_stop", "Mouth", "Tap", "_started"]


def test_a_card_that_is_interrupted_while_it_waits_to_close_leaves_no_setting_behind(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    @contextmanager
    def interrupted() -> Iterator[None]:
        raise KeyboardInterrupt
        yield

    before = dict(os.environ)
    with sound.sound_card() as card:
        monkeypatch.setattr(sound_card, "looking_anew", interrupted)
        with pytest.raises(KeyboardInterrupt):
            card.close()
        monkeypatch.undo()
        assert dict(os.environ) == before
    assert card.server.poll() is not None


def test_one_that_has_ended_is_told_of_and_can_be_closed(card: SoundCard) -> None:
    tap = Tap(card.name, "system:capture_1", seconds=1.0)
    os.kill(tap.listener.pid, signal.SIGKILL)
    with pytest.raises(AudioError, match="its listener has stopped"):
        tap.since(0)
    tap.close()


@pytest.mark.usefixtures("card")
def test_one_whose_server_has_ended_does_not_go_on_answering() -> None:
    with killed() as (server, _):
        tap = Tap(server, "system:capture_1", seconds=1.0)
        tap.since(0)
    with pytest.raises(AudioError, match="its listener has stopped"):
        asked_until(10.0, tap)
    tap.close()


def test_nothing_listens_to_a_server_that_is_not_there() -> None:
    with pytest.raises(AudioError, match=r"its listener has stopped .*panel.*; start again"):
        Tap("palpate-none", "PortAudio:out_1", seconds=1.0)


def test_nothing_listens_to_an_output_that_is_not_there(card: SoundCard) -> None:
    with pytest.raises(AudioError, match=r"its listener has stopped .*PortAudio:out_9.*; start again"):
        Tap(card.name, "PortAudio:out_9", seconds=1.0)


@pytest.mark.usefixtures("card")
def test_it_ends_with_the_session_that_listens_however_that_ends() -> None:
    with killed() as (_, listener):
        assert lives(listener)
    ends = time.monotonic() + 10
    while lives(listener) and time.monotonic() < ends:
        time.sleep(0.01)
    assert not lives(listener)
