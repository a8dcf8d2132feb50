"""`palpate` that sends itself a signal when a number of answers is on disk, and whose workers halt soon after it.

`python -m tests.faults.signalled SIGNAL ANSWERS rehearse ...`: the signal comes with the ANSWERS-th step of the
progress bar, and no worker gives more than `HALT` answers. So what is on disk then lies between two counts, however
fast the machine. Workers are spawned, and import this module as `__mp_main__`.
"""

from __future__ import annotations

import os
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from itertools import count

from experiment import cli_progress
from experiment.console.port import Console
from experiment.rehearsal import study
from experiment.rehearsal.session import Job

HALT = 30

rehearse_participant, progress = study.rehearse_participant, cli_progress.progress
given = count(1)


def halting(job: Job, tick: Callable[[], None], screen: Console | None) -> None:
    def ticked() -> None:
        tick()
        if next(given) >= HALT:
            threading.Event().wait()

    rehearse_participant(job, ticked, screen)


def signalling(number: int, answers: int) -> Callable[..., object]:
    @contextmanager
    def watched(label: str, *, quiet: bool) -> Iterator[tuple[Callable[[int], None], Callable[[], None]]]:
        seen = count(1)

        with progress(label, quiet=quiet) as (total, tick):

            def ticked() -> None:
                tick()
                if next(seen) == answers:
                    os.kill(os.getpid(), number)

            yield total, ticked

    return watched


if __name__ in ("__main__", "__mp_main__"):
    study.rehearse_participant = halting

if __name__ == "__main__":
    from experiment import cli

    cli_progress.progress = signalling(int(sys.argv[1]), int(sys.argv[2]))  # type: ignore[assignment]
    sys.argv[1:] = sys.argv[3:]
    cli.main()
