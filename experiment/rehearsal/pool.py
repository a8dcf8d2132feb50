"""REHEARSAL of several participants at a time, each in a process of a pool."""

from __future__ import annotations

import multiprocessing
import os
import signal
import sys
import threading
from collections.abc import Iterator, Sequence
from concurrent.futures import FIRST_EXCEPTION, Future, ProcessPoolExecutor, wait
from contextlib import contextmanager
from multiprocessing import connection

from experiment.errors import Interrupted
from experiment.rehearsal.footstep.participant import Tick
from experiment.rehearsal.session import Job, rehearse_participant

_queue: multiprocessing.SimpleQueue[None] | None = None


def rehearse(todo: Sequence[Job], jobs: int, tick: Tick) -> None:
    """Rehearse every participant of `todo`, `jobs` at a time; `tick` is called here after each confirmed answer.

    Raises:
        Interrupted: at the keyboard; what is confirmed is on disk.
        PalpateError: a part failed.
    """
    context = multiprocessing.get_context("spawn")
    queue: multiprocessing.SimpleQueue[None] = context.SimpleQueue()
    with _noted() as interrupts:
        with ProcessPoolExecutor(jobs, mp_context=context, initializer=_share, initargs=(queue,)) as pool:
            try:
                with _held_back():
                    futures: set[Future[None]] = {pool.submit(_rehearse_shared, job) for job in todo}
                while futures:
                    done, futures = wait(futures, timeout=0.1, return_when=FIRST_EXCEPTION)
                    for _ in _drained(queue):
                        tick()
                    _end_at(interrupts)
                    for future in done:
                        future.result()
            except BaseException:
                for worker in multiprocessing.active_children():
                    worker.terminate()
                raise
        _end_at(interrupts)


def _end_at(interrupts: Sequence[int]) -> None:
    if interrupts:
        raise Interrupted("the rehearsal was interrupted; the same command goes on with it")


@contextmanager
def _held_back() -> Iterator[None]:
    """Ctrl-C reaches every process of a terminal: those that begin here do not hear it before they can ignore it."""
    if sys.platform == "win32":
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextmanager
def _noted() -> Iterator[Sequence[int]]:
    """Every Ctrl-C that was pressed since; they do nothing else.

    As an exception it might come while the pool's locks are being taken, which then nobody gives back, and the process
    would never end.
    """
    pressed: list[int] = []
    before = signal.getsignal(signal.SIGINT)
    # Who ignores it, as a job in the background does, goes on ignoring it; only the main thread may say.
    if before is not signal.default_int_handler or threading.current_thread() is not threading.main_thread():
        yield pressed
        return
    signal.signal(signal.SIGINT, lambda number, _: pressed.append(number))
    try:
        yield pressed
    finally:
        signal.signal(signal.SIGINT, before)


def _drained(queue: multiprocessing.SimpleQueue[None]) -> Iterator[None]:
    while not queue.empty():
        yield queue.get()


def _share(queue: multiprocessing.SimpleQueue[None]) -> None:
    global _queue
    _queue = queue
    # The keyboard interrupts the parent alone, and a worker never outlives it, however it ends.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = multiprocessing.parent_process()
    if parent is not None:
        threading.Thread(target=_end_with, args=(parent.sentinel,), daemon=True).start()


def _end_with(sentinel: int) -> None:
    connection.wait([sentinel])
    os._exit(1)


def _rehearse_shared(job: Job) -> None:
    queue = _queue
    rehearse_participant(job, (lambda: queue.put(None)) if queue is not None else (lambda: None), None)
