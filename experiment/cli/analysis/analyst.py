"""Who analyses a rehearsal: a process that imports what this takes while the participants are simulated."""

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
    "palpate.analysis.analyse",
    "palpate.analysis.report.figures",
    "matplotlib.backends.backend_svg",
    "rich.console",
    "statsmodels.genmod.generalized_estimating_equations",
)

ENDS_S = 2.0
"""How long an interrupted analysis may take to leave nothing half written, s."""


@contextmanager
def analyst(*, elsewhere: bool, as_json: bool) -> Iterator[Callable[[Path], object]]:
    """Give what analyses a dataset, with figures for the report, and returns what is to be printed.

    On Linux, with `elsewhere`, a fork of this process does so, which is begun here, before this process holds much or
    has a thread. Where the fork fails, this process does so, and whatever is raised is raised here.
    """
    analysed = partial(_analyse, as_json=as_json)
    if not elsewhere or sys.platform != "linux":
        yield analysed
        return
    forking = multiprocessing.get_context("fork")
    ours, theirs = forking.Pipe()
    fork = forking.Process(target=_wait, args=(ours, theirs, analysed))
    asked = False

    def analyse(dataset: Path) -> object:
        nonlocal asked
        asked = True
        try:
            ours.send(dataset)
            return ours.recv()
        except (EOFError, OSError):
            return analysed(dataset)

    # Ctrl-C reaches every process of a terminal: in the fork it waits until that one is asked.
    before = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])
    try:
        fork.start()
    except OSError:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
        yield analysed
        return
    try:
        theirs.close()
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
        yield analyse
    finally:
        ours.close()
        if asked:
            fork.join(ENDS_S)
        fork.kill()
        fork.join()


def _wait(ours: Connection, theirs: Connection, analysed: Callable[[Path], object]) -> None:
    """Analyse the dataset that is asked for, and send what was found; send nothing of what fails."""
    ours.close()
    with suppress(Exception, KeyboardInterrupt):
        from palpate.experiment.apparatus.host import beside

        beside.end_with_parent()
        for module in MEANWHILE:
            import_module(module)
        # Little of what modules hold ever becomes garbage.
        gc.freeze()
        dataset = theirs.recv()
        signal.pthread_sigmask(signal.SIG_UNBLOCK, [signal.SIGINT])
        theirs.send(analysed(dataset))


def _analyse(dataset: Path, *, as_json: bool) -> object:
    from palpate.experiment.cli.analysis import analysed

    # Its tables were made of its journals just now, so that nothing is left to be verified.
    return analysed([dataset], None, as_json=as_json, figures=True, pictures=False)
