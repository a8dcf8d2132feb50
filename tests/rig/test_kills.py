"""A whole visit in a terminal whose console, and whose session, is killed at every step: it goes on there."""

from __future__ import annotations

import os
import re
import shutil
import signal
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from experiment import storage
from experiment.dataset.verify import verify
from experiment.records import journal
from experiment.records.entries import Visited
from experiment.records.progress import progress
from tests.experiment.protocol.small import SMALL
from tests.rig.terminal import KEYS, SAID, Terminal

NOW = re.compile(r"\b(FAMILIARISE|LAY OUT|ARMED|STEPPING|ANSWER|CONFIRM|WRITE|DEBRIEF|ENDED|GONE)\b")
"""The place of the strip that is lit says it in capitals."""

STEPS = {
    "one": ("FAMILIARISE", "ARMED", "ANSWER", "CONFIRM", "DEBRIEF"),
    "two": ("FAMILIARISE", "LAY OUT", "ARMED", "ANSWER", "CONFIRM", "WRITE", "DEBRIEF"),
}
"""Every step of a practised visit, by its tasks."""

AGAIN = {"ARMED": {"ARMED", "LAY OUT"}, "ANSWER": {"ARMED", "LAY OUT"}, "CONFIRM": {"ARMED", "LAY OUT"}}
"""Where a visit goes on whose session was killed, if not at the same step: a trial without a confirmed answer is done
again."""


@pytest.fixture
def terminal(tmp_path: Path) -> Iterator[Terminal]:
    if shutil.which("tmux") is None:
        pytest.skip("needs tmux")
    (tmp_path / "small.toml").write_text(re.sub("repetitions = [0-9]", "repetitions = 1", SMALL), "utf-8")
    there = Terminal(tmp_path)
    try:
        yield there
    finally:
        there.close()
        for process in there.processes("--session-at"):
            os.kill(process, signal.SIGKILL)


def step(text: str) -> str:
    """Return the step that a console shows; nothing while it prepares what comes."""
    now = NOW.search(text)
    if now is None:
        return ""
    asks = {"ANSWER": "What did the participant say?", "FAMILIARISE": "is familiar"}.get(now[0], "")
    return now[0].replace("STEPPING", "ARMED") if asks in text else ""


def remain(text: str) -> int:
    """Return how many trials are still to be answered."""
    found = re.search(r"(\d+) to do", text)
    return int(found[1]) if found else 0


def do(terminal: Terminal, at: str) -> None:
    """Do what an experimenter does at a step, and wait until it is over."""
    if at == "ANSWER":
        said = SAID.findall(terminal.until(lambda text: SAID.search(text) or step(text) != at))
        terminal.press(KEYS[said[-1]] if said else "0")
    elif at == "WRITE":
        terminal.press("Enter")
        terminal.until(lambda text: "It may stay empty" in text)
        terminal.press("w")
        terminal.press("Enter")
        terminal.until(lambda text: "It may stay empty" not in text)
        return
    elif at != "ARMED":
        terminal.press("Enter")
    terminal.until(lambda text: step(text) != at)


def on_record(terminal: Terminal, task: str) -> tuple[tuple[int, str | None], ...]:
    """Return the answers that count."""
    root = terminal.folder / "participants" / "practice-small"
    entries = journal.read_if_begun(storage.journal_path(root, "01", task)).entries
    return progress(entries).said if entries else ()


def is_python(process: int) -> bool:
    return Path(f"/proc/{process}/exe").readlink().name.startswith("python")


def console_killed(terminal: Terminal, task: str) -> None:
    (session,) = terminal.processes("--session-at")
    # Beside them are the terminal's server and its shell, which have the same words.
    (console,) = (one for one in terminal.processes("run") if one != session and is_python(one))
    os.kill(console, signal.SIGKILL)
    terminal.until(lambda text: "left with 137" in text)
    terminal.again("--task", task)
    assert terminal.processes("--session-at") == [session]


def session_killed(terminal: Terminal, task: str) -> None:
    (session,) = terminal.processes("--session-at")
    os.kill(session, signal.SIGKILL)
    terminal.until(lambda text: "GONE" in text and "Nothing that was" in text)
    terminal.press("Enter")
    terminal.until(lambda text: "GONE" not in text)


@pytest.mark.parametrize("task", STEPS)
@pytest.mark.parametrize("kill", [console_killed, session_killed])
def test_a_visit_whose_part_is_killed_at_every_step_goes_on_there(
    terminal: Terminal, kill: Callable[[Terminal, str], None], task: str
) -> None:
    terminal.begin("--task", task)
    left = list(STEPS[task])
    while (at := step(text := terminal.until(step))) != "ENDED":
        if at not in left:
            do(terminal, at)
            continue
        left.remove(at)
        before, to_do = on_record(terminal, task), remain(text)
        kill(terminal, task)
        again = step(text := terminal.until(step))
        # Where only the console was killed, a foot may have stepped meanwhile.
        same = {at, "ANSWER"} if at == "ARMED" else {at}
        assert again in same | (AGAIN.get(at, set()) if kill is session_killed else set()), text
        assert remain(text) == to_do, text
        assert on_record(terminal, task)[: len(before)] == before
    assert not left
    assert "The session is complete: 2 answers." in text
    assert len(on_record(terminal, task)) == 2
    root = terminal.folder / "participants" / "practice-small"
    entries = journal.read(storage.journal_path(root, "01", task)).entries
    told = [(entry.step, entry.text) for entry in entries if isinstance(entry, Visited)]
    assert told == ([("report", "w"), ("payment", "w")] if "WRITE" in STEPS[task] else [])
    assert verify(root).refused == 0
