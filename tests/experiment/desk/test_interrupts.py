"""Ctrl-C that waits until what was felt is on file."""

from __future__ import annotations

import signal
import sys
import threading
from collections.abc import Iterator
from io import FileIO
from pathlib import Path

import pytest

from palpate.experiment import storage
from palpate.experiment.apparatus.tracker.frames import Samples
from palpate.experiment.desk import interrupts
from palpate.experiment.errors import AudioError, ScreenGone
from palpate.experiment.protocol.models import Protocol
from palpate.experiment.records import chain, journal
from palpate.experiment.records.entries import Footer, Trace
from palpate.experiment.records.kinds.footstep import FootStep
from palpate.experiment.session import runner
from palpate.experiment.session.attempt import Event, State, follow
from palpate.experiment.session.runner import SessionLog
from tests.approved import Refuses
from tests.experiment.session.bench import bench, entries, felt_and_on_file, header
from tests.experiment.session.scripted import ScriptedConsole

INTERRUPTED = Footer(reason="paused", detail="interrupted at the keyboard", answered=0, silent=True)


@pytest.fixture(autouse=True)
def keyboard() -> Iterator[None]:
    """As a program has it that was started at a terminal."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    assert signal.signal(signal.SIGINT, before) is signal.default_int_handler


def press() -> None:
    signal.raise_signal(signal.SIGINT)


def test_it_waits_until_the_end() -> None:
    done = []
    with pytest.raises(KeyboardInterrupt), interrupts.deferred():
        press()
        press()
        done.append("the rest")
    assert done


def test_it_is_let_through_at_once_and_a_second_one_waits() -> None:
    done = []
    with pytest.raises(KeyboardInterrupt), interrupts.deferred() as held:
        with pytest.raises(KeyboardInterrupt), held.let_through():
            press()
        press()
        done.append("the rest")
    assert done


def test_one_that_waits_is_let_through() -> None:
    with interrupts.deferred() as held:
        press()
        with pytest.raises(KeyboardInterrupt), held.let_through():
            pytest.fail("the interrupt still waits")


def test_one_that_is_pressed_again_much_later_no_longer_waits(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(interrupts, "PATIENCE_S", -1.0)
    with interrupts.deferred(), pytest.raises(KeyboardInterrupt):
        press()
        pytest.fail("the interrupt still waits")


def test_what_went_wrong_meanwhile_is_told_first() -> None:
    with pytest.raises(ValueError, match="wrong"), interrupts.deferred():
        press()
        raise ValueError("wrong")


@pytest.mark.skipif(sys.platform == "win32", reason="the system sends no such signals")
@pytest.mark.parametrize("number", interrupts.SIGNALS[1:])
def test_a_closed_terminal_and_a_shutdown_pause_a_session(
    protocol: Protocol, tmp_path: Path, number: signal.Signals
) -> None:
    def end() -> None:
        signal.raise_signal(number)

    one = bench("c")
    one.console = ScriptedConsole(one.clock, "c", before_ask=end)
    assert one.run(protocol, header("virtual"), tmp_path) == INTERRUPTED
    assert signal.getsignal(number) is signal.SIG_DFL
    signal.signal(number, signal.SIG_IGN)
    try:
        second = bench("cpt")
        second.console = ScriptedConsole(second.clock, "cpt", before_ask=end)
        # As nohup has it.
        assert second.run(protocol, header("virtual"), tmp_path).reason == "complete"
    finally:
        signal.signal(number, signal.SIG_DFL)


def test_somebody_elses_handler_and_other_threads_are_left_alone() -> None:
    pressed: list[int] = []

    def somebody(number: int, _: object) -> None:
        pressed.append(number)

    signal.signal(signal.SIGINT, somebody)
    with interrupts.deferred():
        press()
    assert signal.signal(signal.SIGINT, signal.default_int_handler) is somebody
    assert pressed == [signal.SIGINT]

    def hold() -> None:
        with interrupts.deferred():
            pressed.append(0)

    thread = threading.Thread(target=hold)
    thread.start()
    thread.join()
    assert pressed == [signal.SIGINT, 0]


def test_a_foot_that_is_waited_for_is_interrupted_at_once(protocol: Protocol, tmp_path: Path) -> None:
    one = bench("c")
    read = one.tracker.read

    def pressing() -> Samples:
        press()
        return read()

    one.tracker.read = pressing  # type: ignore[method-assign]
    assert one.run(protocol, header("virtual"), tmp_path) == INTERRUPTED
    assert not any(isinstance(entry, FootStep) for entry in entries(tmp_path, "virtual"))


@pytest.mark.parametrize("where", ["stimulus", "frames", "entry"])
def test_a_step_that_was_felt_is_on_file_before_the_session_pauses(
    protocol: Protocol, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, where: str
) -> None:
    one, keep, append = bench("c"), SessionLog.keep, journal.Journal.append

    def delivering(_: int) -> None:
        press()

    def keeping(self: SessionLog, raw: bytes) -> Trace:
        press()
        return keep(self, raw)

    def appending(self: journal.Journal, entry: object) -> int:
        if isinstance(entry, FootStep):
            press()
        return append(self, entry)  # type: ignore[arg-type]

    with monkeypatch.context() as patched:
        if where == "stimulus":
            patched.setattr(one.actuator, "delivered", delivering)
        elif where == "frames":
            patched.setattr(SessionLog, "keep", keeping)
        else:
            patched.setattr(journal.Journal, "append", appending)
        assert one.run(protocol, header("virtual"), tmp_path) == INTERRUPTED
    *_, step, footer = entries(tmp_path, "virtual")
    assert footer == INTERRUPTED
    assert isinstance(step, FootStep)
    assert (step.trial, step.attempt) == (1, 1)
    second = bench("cpt")
    assert second.run(protocol, header("virtual"), tmp_path).reason == "complete"
    assert second.console.armed == [(2, 1), (3, 1), (1, 2)]


def test_what_failed_after_contact_is_told_and_not_the_key(
    protocol: Protocol, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, refuses: Refuses
) -> None:
    one = bench("c")

    def failing(_: int) -> None:
        press()
        raise AudioError("the stream has stopped")

    monkeypatch.setattr(one.actuator, "delivered", failing)
    with refuses(AudioError) as failed:
        one.run(protocol, header("virtual"), tmp_path)
    *_, broken, footer = entries(tmp_path, "virtual")
    assert isinstance(footer, Footer)
    assert (footer.reason, footer.answered, footer.silent) == ("error", 0, True)
    assert footer.detail == str(failed.value)
    felt_and_on_file(broken, "the stream has stopped", tmp_path)


@pytest.mark.parametrize("kind", ["header", "familiarised", "armed", "answer"])
def test_an_entry_that_is_being_written_is_on_file_before_the_session_pauses(
    protocol: Protocol, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: str
) -> None:
    written = chain.write_through
    pressed: list[bytes] = []

    def writing(file: FileIO, content: bytes, *, wait: bool = True) -> None:
        if kind.encode() in content and not pressed:
            pressed.append(content)
            press()
        written(file, content, wait=wait)

    monkeypatch.setattr(chain, "write_through", writing)
    footer = bench("cpt").run(protocol, header("virtual"), tmp_path)
    assert isinstance(footer, Footer)
    assert (footer.reason, footer.detail) == ("paused", INTERRUPTED.detail)
    path = storage.journal_path(tmp_path, "01", "virtual")
    assert pressed[0] in path.read_bytes()
    assert entries(tmp_path, "virtual")[-1] == footer
    assert bench("cpt").run(protocol, header("virtual"), tmp_path).reason == "complete"


def test_an_interrupt_as_the_session_is_ending_leaves_its_footer(
    protocol: Protocol, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:

    def following(state: State, event: Event) -> State:
        if event is Event.PAUSE:
            press()
        return follow(state, event)

    def gone() -> None:
        raise ScreenGone("the terminal was closed")

    monkeypatch.setattr(runner, "follow", following)
    one = bench("c")
    one.console = ScriptedConsole(one.clock, "c", before_ask=gone)
    assert one.run(protocol, header("virtual"), tmp_path) == INTERRUPTED
    assert entries(tmp_path, "virtual")[-1] == INTERRUPTED


def test_the_last_line_is_on_file_before_a_session_that_is_complete_is_interrupted(
    protocol: Protocol, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    append = journal.Journal.append

    def appending(self: journal.Journal, entry: object) -> int:
        if isinstance(entry, Footer):
            press()
        return append(self, entry)  # type: ignore[arg-type]

    monkeypatch.setattr(journal.Journal, "append", appending)
    with pytest.raises(KeyboardInterrupt):
        bench("cpt").run(protocol, header("virtual"), tmp_path)
    assert entries(tmp_path, "virtual")[-1] == Footer(reason="complete", answered=3, silent=True)
