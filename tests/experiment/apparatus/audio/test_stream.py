"""Opening and closing a stream on a library that fails: the device is let go, and the interpreter is as it was."""

from __future__ import annotations

import atexit
import sys
import threading
import tracemalloc
from collections.abc import Callable, Iterator
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from palpate.experiment.apparatus.audio import stream as streams
from palpate.experiment.apparatus.audio.mixer import AT_ONCE
from palpate.experiment.apparatus.audio.stream import FADE_S, SILENT_S, SWITCH_S, AudioStream, StreamSettings
from palpate.experiment.clock import MonotonicClock
from palpate.experiment.errors import AudioError
from tests.approved import Refuses

BLOCK = 64
SETTINGS = StreamSettings("an API", "a card", 48_000, BLOCK, 1, (1.0,))


class PortAudioError(Exception):
    """As sounddevice has it."""


class Library:
    """The stream of sounddevice, whose callback comes whenever the session's thread sleeps."""

    def __init__(self) -> None:
        self.refused: BaseException | None = None
        self.unstarted: BaseException | None = None
        self.unclosed: BaseException | None = None
        self.asleep: BaseException | None = None
        self.open = 0
        self.active = False

    def player(self, *, callback: Callable[..., None], **_others: Any) -> Library:
        return self.stream(callback=lambda _inputs, *rest: callback(*rest))

    def stream(self, *, callback: Callable[..., None], **_others: Any) -> Library:
        if self.refused is not None:
            raise self.refused
        self.open += 1
        self.callback = callback
        return self

    def start(self) -> None:
        if self.unstarted is not None:
            raise self.unstarted
        self.active = True

    def close(self) -> None:
        self.open -= 1
        self.active = False
        if self.unclosed is not None:
            raise self.unclosed

    def slept(self, _ns: int) -> None:
        if self.asleep is not None:
            raise self.asleep
        self.callback(np.zeros((BLOCK, 1), np.float32), np.zeros((BLOCK, 1), np.float32), BLOCK, None, 0)


@pytest.fixture
def library(monkeypatch: pytest.MonkeyPatch) -> Iterator[Library]:
    made = Library()
    offered = SimpleNamespace(
        Stream=made.stream, OutputStream=made.player, PortAudioError=PortAudioError, CallbackAbort=RuntimeError
    )
    monkeypatch.setattr(streams, "library", lambda: offered)
    monkeypatch.setattr(streams, "find", lambda **_: 0)
    monkeypatch.setattr(MonotonicClock, "sleep_ns", lambda _, ns: made.slept(ns))
    before = sys.getswitchinterval()
    sys.setswitchinterval(0.005)
    yield made
    sys.setswitchinterval(before)


def let_go(library: Library) -> bool:
    return library.open == 0 and sys.getswitchinterval() == pytest.approx(0.005)


def test_threads_take_turns_sooner_for_as_long_as_a_stream_is_open(library: Library) -> None:
    stream = AudioStream(SETTINGS, MonotonicClock())
    assert sys.getswitchinterval() == pytest.approx(SWITCH_S)
    stream.close()
    assert let_go(library)


@pytest.mark.parametrize("where", ["refused", "unstarted"])
@pytest.mark.parametrize(("error", "told"), [(PortAudioError("no"), AudioError), (KeyboardInterrupt(), None)])
def test_a_stream_that_does_not_open_or_start_leaves_nothing_behind(
    library: Library, where: str, error: BaseException, told: type[BaseException] | None
) -> None:
    setattr(library, where, error)
    with pytest.raises(told or type(error)):
        AudioStream(SETTINGS, MonotonicClock())
    assert let_go(library)


def test_an_interrupt_while_it_is_waited_for_is_told_and_the_device_let_go(library: Library) -> None:
    library.asleep, library.unclosed = KeyboardInterrupt(), PortAudioError("cannot close")
    with pytest.raises(KeyboardInterrupt):
        AudioStream(SETTINGS, MonotonicClock())
    assert let_go(library)


@pytest.mark.parametrize("error", [AudioError("it stopped"), KeyboardInterrupt()])
def test_a_stream_that_cannot_fade_is_closed_nevertheless(library: Library, error: BaseException) -> None:
    stream = AudioStream(SETTINGS, MonotonicClock())
    stream.play_loop(np.ones(100, np.float32), (0,)).wanted = 1.0
    stream.wait(stream.next_frame + BLOCK)
    library.asleep = error
    with pytest.raises(type(error)):
        stream.close()
    assert let_go(library)


def test_a_device_that_has_stopped_and_does_not_close_is_left_alone(
    library: Library, monkeypatch: pytest.MonkeyPatch
) -> None:
    ends, called = threading.Event(), []
    offered = streams.library()
    offered._exit_handler, offered._terminate = (lambda: called.append("exit")), (lambda: called.append("terminate"))
    monkeypatch.setattr(streams, "CLOSE_S", 0.05)
    monkeypatch.setattr(streams, "_left_alone", False)
    monkeypatch.setattr(library, "close", ends.wait)
    unregistered: list[object] = []
    monkeypatch.setattr(atexit, "unregister", unregistered.append)
    stream = AudioStream(SETTINGS, MonotonicClock())
    library.active = False
    stream.close()
    with streams.looking_anew():
        ends.set()
    assert (unregistered, called) == ([offered._exit_handler], [])


def test_a_device_that_has_stopped_and_fails_to_close_is_told_of(library: Library) -> None:
    stream = AudioStream(SETTINGS, MonotonicClock())
    library.active, library.unclosed = False, PortAudioError("cannot close")
    with pytest.raises(AudioError, match="cannot close"):
        stream.close()
    assert let_go(library)


class Ticking:
    """A session's clock that stands still between the blocks of a device: implements `Clock`."""

    simulated = False

    def __init__(self, library: Library) -> None:
        self._library = library
        self.t_ns = 10**18
        self.made: list[np.ndarray] = []

    def now_ns(self) -> int:
        return self.t_ns

    def sleep_ns(self, duration_ns: int) -> None:
        self.play(1)

    def uptime(self) -> None:
        return None

    def play(self, blocks: int) -> np.ndarray:
        """Return what leaves the output in so many blocks, each of which comes in time."""
        for _ in range(blocks):
            self.t_ns += BLOCK * 10**9 // 48_000
            block = np.zeros((BLOCK, 1), np.float32)
            self._library.callback(np.zeros((BLOCK, 1), np.float32), block, BLOCK, None, 0)
            self.made.append(block)
        return np.concatenate(self.made[-blocks:])[:, 0]


def ticking(library: Library, **settings: float) -> tuple[AudioStream, Ticking]:
    """A stream whose loop plays full scale."""
    clock = Ticking(library)
    stream = AudioStream(replace(SETTINGS, **settings), clock)  # type: ignore[arg-type]
    stream.play_loop(np.ones(100, np.float32), (0,)).wanted = 1.0
    assert np.all(clock.play(100)[-BLOCK:] == 1.0)
    return stream, clock


def last_after_s(begun_ns: int, played: np.ndarray) -> float:
    """How long after a session time at which a block is taken the last sample of what followed is taken, s."""
    return (int(np.flatnonzero(played)[-1]) + BLOCK) / 48_000 if played.any() else 0.0


@pytest.mark.parametrize("ends_after_ms", [-1000.0, 0.0, 0.1, 17.3, 100.0])
@pytest.mark.parametrize("output_ms", [0.0, 12.5])
def test_at_the_sessions_end_the_callback_fades_by_itself(
    library: Library, ends_after_ms: float, output_ms: float
) -> None:
    stream, clock = ticking(library, output_ms=output_ms)
    begun_ns = clock.t_ns
    stream.end(begun_ns + round(ends_after_ms * 1e6))
    stream.end(begun_ns + 10**12)
    played = clock.play(400)
    lasted_ms = last_after_s(begun_ns, played) * 1e3 + output_ms - max(ends_after_ms, output_ms)
    assert -BLOCK / 48 <= lasted_ms <= 20 + BLOCK / 48
    assert np.max(np.abs(np.diff(played))) <= 1.01 / (FADE_S * 48_000)
    stream.close()


def test_silence_is_for_good_and_takes_no_thread(library: Library) -> None:
    stream, clock = ticking(library)
    cue = stream.schedule(np.ones(20_000), channel=0, frame=stream.next_frame)
    clock.play(2)
    stream.silence()
    assert stream.ends_ns == clock.t_ns
    assert last_after_s(clock.t_ns, clock.play(200)) <= 0.02 + BLOCK / 48_000
    assert (cue.cut, cue.done) == (True, True)
    late = stream.schedule(np.ones(64), channel=0, frame=AT_ONCE)
    assert not clock.play(10).any()
    assert (late.cut, late.done, late.started) == (True, True, None)
    stream.close()


def test_a_device_that_stands_still_is_noticed_and_plays_nothing_afterwards_that_is_past(library: Library) -> None:
    stream, clock = ticking(library)
    stream.end(clock.t_ns + 5 * 10**9)
    cue = stream.schedule(np.ones(64), channel=0, frame=stream.next_frame + 10 * BLOCK)
    clock.t_ns += round((SILENT_S - 0.01) * 1e9)
    stream.check()
    clock.t_ns += 10**8
    with pytest.raises(AudioError):
        stream.check()
    assert np.all(clock.play(40)[20 * BLOCK :] == 1.0)
    assert (cue.late, cue.done, cue.started) == (True, True, None)
    stream.check()
    clock.t_ns += 6 * 10**9
    assert not clock.play(200).any()
    stream.close()


def test_a_stream_without_inputs_and_stimuli_plays_and_holds_nothing(library: Library, refuses: Refuses) -> None:
    tracemalloc.start()
    stream = AudioStream(replace(SETTINGS, inputs=0, stimuli=False), MonotonicClock())
    held = tracemalloc.get_traced_memory()[0]
    tracemalloc.stop()
    # With one input, 30 s at 48 kHz and eight stimuli of 4 s would be 12 MB.
    assert held < 500_000
    loop = stream.play_loop(np.ones(8, np.float32), (0,))
    loop.wanted = 1.0
    before = stream.next_frame
    stream.wait(before + BLOCK)
    assert stream.next_frame > before
    with refuses(AudioError):
        stream.schedule(np.ones(1), channel=0, frame=0)
    stream.close()
    assert let_go(library)
