"""`palpate` that sends itself a signal when a number of answers is on disk, and whose workers halt soon after it.

`python -m tests.faults.signalled SIGNAL ANSWERS rehearse ...`: the signal comes after the ANSWERS-th step of the
progress bar, when the pool holds a lock, and no worker gives more than `HALT` answers. So what is on disk then lies
between two counts, however fast the machine. Each worker imports this module as `__mp_main__`.
"""

from __future__ import annotations

import os
import sys
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Future, wait
from contextlib import contextmanager
from itertools import count
from typing import Any
from unittest import mock

from palpate.experiment.cli import options
from palpate.experiment.desk.questions import Console
from palpate.experiment.rehearsal import session
from palpate.experiment.rehearsal.session import Job, rehearse_participant

HALT = 30

progress = options.progress
given, enough = count(1), threading.Event()


def halting(job: Job, tick: Callable[[], None], screen: Console | None) -> None:
    def ticked() -> None:
        tick()
        if next(given) >= HALT:
            threading.Event().wait()

    rehearse_participant(job, ticked, screen)


def counting(answers: int) -> Callable[..., object]:
    @contextmanager
    def watched(label: str, *, quiet: bool) -> Iterator[tuple[Callable[..., None], Callable[[], None]]]:
        seen = count(1)

        with progress(label, quiet=quiet) as (total, tick):

            def ticked() -> None:
                tick()
                if next(seen) == answers:
                    enough.set()

            yield total, ticked

    return watched


def signalling(number: int) -> Callable[..., object]:
    def waiting(futures: set[Future[None]], **how: Any) -> object:
        if enough.is_set():
            # As the library takes these locks: an exception just then leaves them taken.
            held = next(iter(futures))._condition
            held.acquire()
            os.kill(os.getpid(), number)
            held.release()
        return wait(futures, **how)

    return waiting


if __name__ in ("__main__", "__mp_main__"):
    mock.patch.object(session, "rehearse_participant", halting).start()

if __name__ == "__main__":
    from palpate.experiment.cli import app

    mock.patch.object(session, "wait", signalling(int(sys.argv[1]))).start()
    mock.patch.object(options, "progress", counting(int(sys.argv[2]))).start()
    sys.argv[1:] = sys.argv[3:]
    app.main()
