"""The process that analyses a rehearsal: whatever becomes of it, the dataset is analysed, and no process stays."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from palpate.experiment.cli.analysis import analyst as analysts

pytestmark = [
    pytest.mark.skipif(sys.platform != "linux", reason="on Linux alone a fork analyses"),
    pytest.mark.usefixtures("no_process_stays"),
]

Doing = Callable[[Callable[[], object]], Callable[[], list[bool]]]


@pytest.fixture
def doing(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Doing:
    """Have an analysis elsewhere begin with something, and return what tells of each that was done if it was here."""

    def begun(first: Callable[[], object]) -> Callable[[], list[bool]]:
        here, noted = os.getpid(), tmp_path / "noted"

        def analyse(dataset: Path, *, as_json: bool) -> str:
            assert (dataset, as_json) == (tmp_path, True)
            if os.getpid() != here:
                first()
            with noted.open("a", encoding="utf-8") as file:
                file.write(f"{os.getpid()}\n")
            return "found"

        monkeypatch.setattr(analysts, "_analyse", analyse)
        return lambda: [int(line) == here for line in noted.read_text("utf-8").split()]

    return begun


def refuse() -> None:
    raise OSError("what this process may not do")


@pytest.mark.parametrize(
    ("first", "here"),
    [(lambda: None, False), (refuse, True), (lambda: os.kill(os.getpid(), signal.SIGKILL), True)],
    ids=["done", "raises", "killed"],
)
def test_what_a_fork_cannot_analyse_is_analysed_here(
    tmp_path: Path, doing: Doing, first: Callable[[], object], here: bool
) -> None:
    done = doing(first)
    with analysts.analyst(elsewhere=True, as_json=True) as analyse:
        assert analyse(tmp_path) == "found"
    assert done() == [here]


def test_a_fork_that_cannot_import_what_it_needs_is_done_without(
    tmp_path: Path, doing: Doing, monkeypatch: pytest.MonkeyPatch
) -> None:
    done = doing(lambda: None)
    monkeypatch.setattr(analysts, "MEANWHILE", ("no_such_module_of_palpate",))
    with analysts.analyst(elsewhere=True, as_json=True) as analyse:
        assert analyse(tmp_path) == "found"
    assert done() == [True]


def test_a_fork_that_nobody_asks_ends() -> None:
    with pytest.raises(LookupError), analysts.analyst(elsewhere=True, as_json=True):
        raise LookupError


def test_ctrl_c_of_a_terminal_ends_an_analysis(tmp_path: Path, doing: Doing) -> None:
    """It reaches both processes: the fork from when it is asked on."""
    here = os.getpid()

    def interrupted() -> None:
        os.kill(here, signal.SIGINT)
        os.kill(os.getpid(), signal.SIGINT)
        threading.Event().wait(60)

    done = doing(interrupted)
    (tmp_path / "noted").touch()
    with pytest.raises(KeyboardInterrupt), analysts.analyst(elsewhere=True, as_json=True) as analyse:
        analyse(tmp_path)
    assert done() == []


def test_ctrl_c_while_the_fork_still_imports_ends_it_before_it_analyses(
    tmp_path: Path, doing: Doing, monkeypatch: pytest.MonkeyPatch
) -> None:
    here = os.getpid()
    # It is imported where it is asked for, and presses the key of a terminal: both processes hear of it.
    (tmp_path / "presses.py").write_text(
        f"import os, signal\nos.kill(os.getpid(), signal.SIGINT)\nos.kill({here}, signal.SIGINT)\n", "utf-8"
    )
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.setattr(analysts, "MEANWHILE", ("presses",))
    done = doing(lambda: None)
    (tmp_path / "noted").touch()
    with pytest.raises(KeyboardInterrupt), analysts.analyst(elsewhere=True, as_json=True) as analyse:
        analyse(tmp_path)
        threading.Event().wait(60)
    assert done() == []


def test_a_system_that_lets_no_process_begin_has_it_analysed_here(
    tmp_path: Path, doing: Doing, monkeypatch: pytest.MonkeyPatch
) -> None:
    done = doing(lambda: None)

    def refused() -> int:
        raise BlockingIOError

    monkeypatch.setattr("os.fork", refused)
    with analysts.analyst(elsewhere=True, as_json=True) as analyse:
        assert analyse(tmp_path) == "found"
    assert done() == [True]


ORPHAN = """
import os, signal, time
from pathlib import Path
from palpate.experiment.cli.analysis import analyst

def analyse(dataset, *, as_json):
    Path(dataset, "fork").write_text(str(os.getpid()))
    time.sleep(600)

analyst._analyse = analyse
with analyst.analyst(elsewhere=True, as_json=True) as ask:
    ask(Path({folder!r}))
"""


def test_no_fork_outlives_its_parent(tmp_path: Path, repository_root: Path) -> None:
    script, noted = ORPHAN.format(folder=str(tmp_path)), tmp_path / "fork"
    with subprocess.Popen([sys.executable, "-c", script], cwd=repository_root) as begun:
        until(lambda: noted.exists() and noted.read_text() != "")
        begun.kill()
    fork = Path("/proc") / noted.read_text()
    until(lambda: not fork.exists() or fork.joinpath("stat").read_text().rpartition(")")[2].split()[0] == "Z")


def until(holds: Callable[[], bool]) -> None:
    deadline = time.monotonic() + 60
    while not holds():
        assert time.monotonic() < deadline
        time.sleep(0.01)
