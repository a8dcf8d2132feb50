"""The console in a real terminal (tmux), at a session in a process of its own that is practiced with it."""

from __future__ import annotations

import os
import re
import shutil
import signal
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from palpate.experiment import storage
from palpate.experiment.records import journal
from palpate.experiment.records.entries import Answer, Commanded, Note
from tests.experiment.protocol.small import SMALL
from tests.rig.terminal import PATIENCE_S, Terminal
from tests.working_folder import WorkingFolder

TRIALS = 4

SECOND = "--participant", "02", "--task", "one"
"""Whose first task is the other one, so that the debriefing follows this."""


@pytest.fixture
def terminal(tmp_path: Path, working_folder: WorkingFolder) -> Iterator[Terminal]:
    if shutil.which("tmux") is None:
        pytest.skip("needs tmux")
    (tmp_path / "small.toml").write_text(SMALL.replace("repetitions = 3", "repetitions = 2"), "utf-8")
    there = Terminal(tmp_path)
    try:
        yield there
    finally:
        there.close()
        for process in there.processes("--session-at"):
            os.kill(process, signal.SIGKILL)


def is_python(process: int) -> bool:
    """Return whether a process is palpate itself, and not the terminal's server or shell, whose commands name it."""
    return Path(f"/proc/{process}/exe").readlink().name.startswith("python")


def test_a_session_outlives_its_consoles_and_a_console_its_session(terminal: Terminal) -> None:
    terminal.begin(*SECOND)
    terminal.until(lambda text: "FAMILIARIZE" in text and "Enter" in text)
    terminal.press("Enter", times=25)
    terminal.until(lambda text: "ARMED" in text)
    terminal.answer()
    terminal.press("F2")
    terminal.press("q")
    terminal.press("Enter")
    terminal.until(lambda text: "The note is saved." in text)

    # Left: the session goes on, and the same command comes back to it.
    terminal.press("F9")
    terminal.until(lambda text: "Leave the console?" in text)
    terminal.press("Enter")
    terminal.until(lambda text: "left with 0" in text and "To return to it, run the same command." in text)
    terminal.close()
    (session,) = terminal.processes("--session-at")
    terminal.begin(*SECOND)
    terminal.answer()

    # Killed: it comes back to the step.
    (console,) = (one for one in terminal.processes("run") if one != session and is_python(one))
    os.kill(console, signal.SIGKILL)
    terminal.until(lambda text: "left with 137" in text)
    terminal.again(*SECOND)
    terminal.until(lambda text: "ARMED" in text or "What did the participant say?" in text)

    # Its terminal closed: nothing of the console stays, and the session does.
    terminal.close()
    begun_s = time.monotonic()
    while terminal.processes("run") != [session]:
        assert time.monotonic() - begun_s < PATIENCE_S
        time.sleep(0.05)
    terminal.begin(*SECOND)
    terminal.answer()

    # Its session killed: it is told, nothing that was confirmed is lost, and a key starts it again.
    os.kill(session, signal.SIGKILL)
    terminal.until(lambda text: "GONE" in text and "Every confirmed" in text)
    terminal.press("Enter")
    terminal.answer()
    for asked_for in ("report", "What was paid"):
        terminal.until(re.compile(f"{asked_for}(.|\\n)*type the answer").search)
        terminal.press("Enter")
        terminal.until(lambda text: "Leave it blank" in text)
        terminal.press("Enter")
    terminal.until(lambda text: "DEBRIEF" in text and "Add any remaining" in text)
    terminal.press("Enter")
    terminal.until(lambda text: "ENDED" in text and f"The session is complete: {TRIALS} answers." in text)
    terminal.press("Enter")
    terminal.until(lambda text: "left with 0" in text)

    root = terminal.folder / "participants" / "practice-small"
    entries = journal.read(storage.journal_path(root, "02", "one")).entries
    assert len([entry for entry in entries if isinstance(entry, Answer)]) == TRIALS
    assert [entry.text for entry in entries if isinstance(entry, Note)] == ["q"]
    asked = [entry.command for entry in entries if isinstance(entry, Commanded) and entry.taken]
    assert TRIALS <= sum(command.endswith("enter") for command in asked) <= TRIALS + 4
