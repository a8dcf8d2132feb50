"""The process that analyses a rehearsal: whatever becomes of it, the dataset is analysed, and no process stays."""

from __future__ import annotations

import multiprocessing
import os
import signal
import sys
import threading
from collections.abc import Callable
from pathlib import Path

import pytest

from experiment.cli import analyst as analysts

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="on Linux alone a fork analyses")

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
    assert not multiprocessing.active_children()


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
    assert not multiprocessing.active_children()


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
    assert not multiprocessing.active_children()
