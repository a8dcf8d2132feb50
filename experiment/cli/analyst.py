"""Who analyses a rehearsal: a process that imports what this takes while the participants are simulated."""

from __future__ import annotations

import gc
import multiprocessing
import signal
import sys
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import partial
from importlib import import_module
from multiprocessing.connection import Connection
from pathlib import Path

from experiment.errors import PalpateError

MEANWHILE = (
    "analysis.analyse",
    "analysis.report.figures",
    "matplotlib.backends.backend_svg",
    "rich.console",
    "statsmodels.genmod.generalized_estimating_equations",
)
"""What an analysis imports."""


@contextmanager
def analyst(*, elsewhere: bool, as_json: bool) -> Iterator[Callable[[Path], None]]:
    """Give what analyses a dataset and prints what was found, with figures for the report.

    On Linux, with `elsewhere`, it does so in a fork of this process, which is begun here, before this process holds
    much or has a thread. What it raises is raised here.
    """
    if not elsewhere or sys.platform != "linux":
        yield partial(_analyse, as_json=as_json)
        return
    forking = multiprocessing.get_context("fork")
    here, there = forking.Pipe()
    other = forking.Process(target=_asked, args=(here, there, as_json))
    # Ctrl-C reaches every process of a terminal, and this one answers it until the other is asked.
    before = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])
    try:
        other.start()
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
    there.close()

    def analyse(dataset: Path) -> None:
        with suppress(BrokenPipeError):
            here.send(dataset)
        if (failure := here.recv()) is not None:
            raise failure

    try:
        yield analyse
    finally:
        here.close()
        other.join()


def _asked(asker: Connection, asked: Connection, as_json: bool) -> None:
    asker.close()
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, [signal.SIGINT])
    failure: BaseException | None = None
    try:
        for module in MEANWHILE:
            import_module(module)
        gc.freeze()
        try:
            dataset = asked.recv()
        except EOFError:
            return
        signal.signal(signal.SIGINT, before)
        _analyse(dataset, as_json=as_json)
    except BaseException as error:
        failure = error
        if not isinstance(error, PalpateError):
            error.add_note(traceback.format_exc())
    with suppress(BrokenPipeError):
        asked.send(failure)


def _analyse(dataset: Path, *, as_json: bool) -> None:
    from experiment.cli.analysis import tell_analysis

    # Its tables were made of its journals just now, so that nothing is left to be verified.
    tell_analysis([dataset], None, as_json=as_json, figures=True, pictures=False)
    sys.stdout.flush()
