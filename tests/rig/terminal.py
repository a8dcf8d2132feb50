"""A terminal of 80 x 24 (tmux) in which a session is practiced, with the keys that a hand presses there."""

from __future__ import annotations

import os
import re
import shlex
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

KEYS = {"felt": "f", "cork": "k"}
SAID = re.compile(r"says: (\w+)\.")
PATIENCE_S = 60.0
APART_S = 2.0
"""Between two presses of one key that both count, on a machine that is busy."""
REACTS_S = 0.5
"""From what is seen to a press."""


class Terminal:
    """A terminal of 80 x 24 that a session is practiced in."""

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

    def begin(self, *options: str) -> None:
        """Give the command, in a window of its own."""
        self._run("new-session", "-d", "-x", "80", "-y", "24", self._shell(*options))

    def again(self, *options: str) -> None:
        """Give the command once more in the same window, whatever ran there."""
        self._run("respawn-pane", "-k", self._shell(*options))

    def _shell(self, *options: str) -> str:
        command = [sys.executable, "-P", "-m", "palpate.experiment", "run", "small.toml", "--practice", *options]
        return f"{shlex.join(command)}; echo left with $?; sleep 600"

    def _run(self, *words: str) -> None:
        subprocess.run([*self._tmux, *words], cwd=self.folder, env=self._environment, check=True)

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
            if b"palpate.experiment" in command and part.encode() in command and where == self.folder:
                found.append(int(process.name))
        return found
