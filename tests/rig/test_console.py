"""The console in a real terminal (tmux), at a session in a process of its own that is practised with it."""

from __future__ import annotations

import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from experiment import storage
from experiment.records import journal
from experiment.records.entries import Answer, Commanded, Note
from tests.experiment.protocol.small import SMALL

KEYS = {"felt": "f", "cork": "k"}
SAID = re.compile(r"says: (\w+)\.")
TRIALS = 4
PATIENCE_S = 60.0
APART_S = 2.0
"""Between two presses of one key that both count, on a machine that is busy."""
REACTS_S = 0.5
"""From what is seen to a press."""


class Terminal:
    """A terminal of 80 x 24 that a session is practised in."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._tmux = ["tmux", "-S", str(folder / "tmux"), "-f", "/dev/null"]
        self._latest_s = 0.0
        self._environment = {
            **os.environ,
            "XDG_RUNTIME_DIR": str(folder),
            "PYTHONPATH": str(Path(__file__).parents[2]),
            "LANG": "C.UTF-8",
        }

    def begin(self) -> None:
        """Give the command, in a window of its own."""
        command = [sys.executable, "-m", "experiment", "run", "small.toml", "--task", "one", "--practice"]
        shell = f"{shlex.join(command)}; echo left with $?; sleep 600"
        size = ["-x", "80", "-y", "24"]
        subprocess.run(
            [*self._tmux, "new-session", "-d", *size, shell], cwd=self.folder, env=self._environment, check=True
        )

    def close(self) -> None:
        """Close the terminal's window with all that runs in it."""
        subprocess.run([*self._tmux, "kill-server"], check=False, capture_output=True)

    @property
    def text(self) -> str:
        """What stands on the screen."""
        shown = subprocess.run([*self._tmux, "capture-pane", "-p"], check=True, capture_output=True, text=True)
        return shown.stdout

    def press(self, key: str, *, times: int = 1) -> None:
        """Press a key, as a hand does; more than once if it is held."""
        time.sleep(max(REACTS_S, self._latest_s + APART_S - time.monotonic()))
        subprocess.run([*self._tmux, "send-keys", *["-N", str(times)], key], check=True)
        self._latest_s = time.monotonic()

    def until(self, shown: Callable[[str], object]) -> str:
        """Return the screen once it shows what is wanted."""
        begun_s = time.monotonic()
        while not shown(text := self.text):
            assert time.monotonic() - begun_s < PATIENCE_S, text
            time.sleep(0.05)
        return text

    def answer(self) -> None:
        """Key what the participant says next, and confirm it by a key that is held down."""
        text = self.until(lambda text: "What did the participant say?" in text and SAID.search(text))
        self.press(KEYS[SAID.findall(text)[-1]])
        self.until(lambda text: "CONFIRM" in text)
        self.press("Enter", times=25)
        self.until(lambda text: "CONFIRM" not in text)

    def processes(self, part: str) -> list[int]:
        """Return the processes of this terminal's folder whose command holds a word."""
        found = []
        for process in Path("/proc").glob("[0-9]*"):
            try:
                command, where = (process / "cmdline").read_bytes(), (process / "cwd").readlink()
            except OSError:
                continue
            if b"experiment" in command and part.encode() in command and where == self.folder:
                found.append(int(process.name))
        return found


@pytest.fixture
def terminal(tmp_path: Path) -> Iterator[Terminal]:
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


def test_a_session_outlives_its_consoles_and_a_console_its_session(terminal: Terminal) -> None:
    terminal.begin()
    terminal.until(lambda text: "FAMILIARISE" in text and "Enter" in text)
    terminal.press("Enter", times=25)
    terminal.until(lambda text: "ARMED" in text)
    terminal.answer()
    terminal.press("F2")
    terminal.press("q")
    terminal.press("Enter")
    terminal.until(lambda text: "The note is on disk." in text)

    # Left: the session goes on, and the same command comes back to it.
    terminal.press("F9")
    terminal.until(lambda text: "Leave the console?" in text)
    terminal.press("Enter")
    terminal.until(lambda text: "left with 0" in text and "The same command comes back to it." in text)
    terminal.close()
    (session,) = terminal.processes("--session-at")
    terminal.begin()
    terminal.answer()

    # Its terminal closed: nothing of the console stays, and the session does.
    terminal.close()
    begun_s = time.monotonic()
    while terminal.processes("run") != [session]:
        assert time.monotonic() - begun_s < PATIENCE_S
        time.sleep(0.05)
    terminal.begin()
    terminal.answer()

    # Its session killed: it is told, nothing that was confirmed is lost, and a key starts it again.
    os.kill(session, signal.SIGKILL)
    terminal.until(lambda text: "GONE" in text and "Nothing that was" in text)
    terminal.press("Enter")
    terminal.answer()
    for asked_for in ("report", "handed"):
        terminal.until(re.compile(f"{asked_for}(.|\\n)*write down the answer").search)
        terminal.press("Enter")
        terminal.until(lambda text: "writes it down, or nothing" in text)
        terminal.press("Enter")
    terminal.until(lambda text: "DEBRIEF" in text and "Note what is left" in text)
    terminal.press("Enter")
    terminal.until(lambda text: "ENDED" in text and f"The session is complete: {TRIALS} answers." in text)
    terminal.press("Enter")
    terminal.until(lambda text: "left with 0" in text)

    root = terminal.folder / "participants" / "practice-small"
    entries = journal.read(storage.journal_path(root, "01", "one")).entries
    assert len([entry for entry in entries if isinstance(entry, Answer)]) == TRIALS
    assert [entry.text for entry in entries if isinstance(entry, Note)] == ["q"]
    asked = [entry.command for entry in entries if isinstance(entry, Commanded) and entry.taken]
    assert TRIALS <= sum(command.endswith("enter") for command in asked) <= TRIALS + 4
