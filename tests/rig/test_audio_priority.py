"""The priority of the threads that a real audio server starts."""

from __future__ import annotations

import os
import sys
from contextlib import ExitStack

import pytest

from palpate.experiment.apparatus import host
from palpate.experiment.apparatus.audio.mixer import Block, Mixer
from tests.rig import sound

pytestmark = pytest.mark.clocked


@pytest.mark.skipif(sys.platform != "linux", reason="palpate raises its priority on Linux alone")
@pytest.mark.parametrize("server_too", [True, False])
def test_the_callback_never_waits_for_ordinary_work_where_the_session_does_not(
    server_too: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where the server was started in ordinary time, so are its clients' threads, and ours joins by itself."""
    ranks: list[tuple[int, int]] = []
    stands: list[set[int]] = []
    fill, before = Mixer.fill, os.sched_getaffinity(0)

    def noted(self: Mixer, outputs: Block, inputs: Block) -> None:
        ranks.append((os.sched_getscheduler(0), os.sched_getparam(0).sched_priority))
        stands.append(os.sched_getaffinity(0))
        fill(self, outputs, inputs)

    monkeypatch.setattr(Mixer, "fill", noted)
    with ExitStack() as opened:
        if not server_too:
            opened.enter_context(sound.sound_card())
        got = opened.enter_context(host.raised())
        if server_too:
            opened.enter_context(sound.sound_card())
        stream = opened.enter_context(sound.stream())
        stream.wait(8 * sound.BLOCK)
        session, core = os.sched_getparam(0).sched_priority, os.sched_getaffinity(0)
    if got.startswith("real time"):
        assert all(policy in (os.SCHED_RR, os.SCHED_FIFO) and rank > session for policy, rank in ranks)
    else:
        assert {policy for policy, _ in ranks} == {os.SCHED_OTHER}
    if core != before:
        assert all(core.isdisjoint(where) for where in stands)
