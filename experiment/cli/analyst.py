"""Who analyses a rehearsal: a process that imports what this takes while the participants are simulated."""

from __future__ import annotations

import gc
import multiprocessing
import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import partial
from importlib import import_module
from multiprocessing.connection import Connection
from pathlib import Path

MEANWHILE = (
    "analysis.analyse",
    "analysis.report.figures",
    "matplotlib.backends.backend_svg",
    "rich.console",
    "statsmodels.genmod.generalized_estimating_equations",
)


@contextmanager
def analyst(*, elsewhere: bool, as_json: bool) -> Iterator[Callable[[Path], object]]:
    """Give what analyses a dataset, with figures for the report, and returns what is to be printed.

    On Linux, with `elsewhere`, a fork of this process does so, which is begun here, before this process holds much or
    has a thread. Where the fork fails it is done here, so that what it raises is raised here.
    """
    here_too = partial(_analyse, as_json=as_json)
    if not elsewhere or sys.platform != "linux":
        yield here_too
        return
    forking = multiprocessing.get_context("fork")
    here, there = forking.Pipe()
    other = forking.Process(target=_asked, args=(here, there, here_too))
    # Ctrl-C reaches every process of a terminal, and this one alone answers it until the other is asked.
    before = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])
    try:
        other.start()
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
    there.close()
    asked = False

    def analyse(dataset: Path) -> object:
        nonlocal asked
        asked = True
        try:
            here.send(dataset)
            return here.recv()
        except (EOFError, OSError):
            return here_too(dataset)

    try:
        yield analyse
    finally:
        here.close()
        if not asked:
            other.kill()
        other.join()


def _asked(asker: Connection, asked: Connection, analyse: Callable[[Path], object]) -> None:
    """Analyse the dataset that is asked for, and send what was found; send nothing of what fails."""
    asker.close()
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, [signal.SIGINT])
    with suppress(Exception, KeyboardInterrupt):
        for module in MEANWHILE:
            import_module(module)
        # Little of what modules hold ever becomes garbage.
        gc.freeze()
        dataset = asked.recv()
        signal.signal(signal.SIGINT, before)
        asked.send(analyse(dataset))


def _analyse(dataset: Path, *, as_json: bool) -> object:
    from experiment.cli.analysis import analysed

    # Its tables were made of its journals just now, so that nothing is left to be verified.
    return analysed([dataset], None, as_json=as_json, figures=True, pictures=False)
