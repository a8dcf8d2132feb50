"""Where the threads of a session, and of the laboratory that is simulated for it, run."""

from __future__ import annotations

import os
import sys
import threading
from contextlib import ExitStack

import pytest

from palpate.experiment.apparatus import host
from palpate.experiment.apparatus import rig as rigs
from palpate.experiment.apparatus.rig import tracker_of
from palpate.experiment.apparatus.tracker.serial_tracker import SerialTracker
from palpate.experiment.protocol.files import shipped
from palpate.experiment.rehearsal.wires.foot import Foot
from palpate.experiment.rehearsal.wires.panel import Panel
from palpate.experiment.rehearsal.wires.serial_line import SerialLine
from tests.rig import sound

pytestmark = pytest.mark.clocked


@pytest.mark.skipif(sys.platform != "linux", reason="palpate keeps to a core on Linux alone")
def test_the_far_ends_run_on_the_cores_that_the_session_leaves(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(host, "HELD", f"\0palpate-test-{os.getpid()}-{{}}")
    rig = rigs.load(shipped("rigs/rehearsal.toml"))
    before = os.sched_getaffinity(0)
    with ExitStack() as opened:
        opened.enter_context(host.pinned())
        card = opened.enter_context(sound.sound_card())
        opened.enter_context(sound.stream())
        tap = card.tap(1, seconds=1.0)
        opened.callback(tap.close)
        foot = Foot(opened.enter_context(SerialLine()), tracker_of(rig), real_time=True)
        opened.callback(foot.close)
        panel = Panel(rig.actuator)
        opened.callback(panel.close)
        within = os.sched_getaffinity(0)
        ends = [thread.native_id for thread in threading.enumerate() if thread.name in ("foot", "panel")]
        stand = [os.sched_getaffinity(end) for end in (*ends, card.server.pid, tap.listener.pid) if end is not None]
    assert len(stand) == 4
    assert stand == [before - within or before] * 4


@pytest.mark.skipif(sys.platform != "linux", reason="palpate raises its priority on Linux alone")
def test_the_thread_that_reads_the_tracker_runs_just_above_the_session_and_on_its_core() -> None:
    rig = rigs.load(shipped("rigs/rehearsal.toml"))
    with ExitStack() as opened:
        opened.enter_context(host.raised())
        line = opened.enter_context(SerialLine())
        foot = Foot(line, tracker_of(rig), real_time=True)
        opened.callback(foot.close)
        tracker = SerialTracker(line.url, tracker_of(rig))
        opened.callback(tracker.close)
        tracker.read()
        [reader] = [thread.native_id for thread in threading.enumerate() if thread.name == "tracker"]
        assert reader is not None
        assert os.sched_getaffinity(reader) == os.sched_getaffinity(0)
        above = host.is_real_time()
        assert os.sched_getparam(reader).sched_priority == os.sched_getparam(0).sched_priority + above
