"""The process that computes what was heard, and a session's end that waits for it no longer than it must."""

from __future__ import annotations

import multiprocessing
import os
import signal
import time

import pytest

from palpate.experiment.desk.voice import ear


@pytest.mark.parametrize("stands", [False, True])
def test_a_session_ends_whether_the_process_stands_still_or_not(stands: bool) -> None:
    with ear.computing() as pool:
        pid = pool.submit(os.getpid).result(60)
        if stands:
            os.kill(pid, signal.SIGSTOP)
        begun_s = time.monotonic()
    assert time.monotonic() - begun_s < 3 * ear.ENDS_S
    ends_s = time.monotonic() + 10
    while pid in {one.pid for one in multiprocessing.active_children()}:
        assert time.monotonic() < ends_s
