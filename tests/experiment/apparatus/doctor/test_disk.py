"""Room for a session, and entries that are on disk in time; full, slow and forbidden disks are injected."""

from __future__ import annotations

import errno
import os
import re
import shutil
import tempfile
from collections import namedtuple
from pathlib import Path

import pytest
from syrupy.assertion import SnapshotAssertion

from palpate.experiment.apparatus.doctor import checks
from palpate.experiment.clock import MonotonicClock
from palpate.experiment.rehearsal.clock import ManualClock

pytestmark = pytest.mark.fsync

Usage = namedtuple("Usage", "total used free")


def test_this_disk_takes_a_session_and_nothing_is_left_behind(tmp_path: Path) -> None:
    folder = tmp_path / "participants" / "study"
    room = checks.space(folder, trials=40, rate_hz=1000)
    assert (room.verdict, f"free at {tmp_path}" in room.what) == ("passes", True)
    assert checks.writing(folder, ManualClock(0)).verdict == "passes"
    measured = checks.writing(folder, MonotonicClock()).what
    assert re.fullmatch(rf"writing an entry takes \S+ ms \(median\), \S+ ms \(worst of 20\) at {tmp_path}", measured)
    assert list(tmp_path.iterdir()) == []


def test_a_session_takes_its_frames_twice_and_its_journal() -> None:
    # 40 trials of 60 s, 1000 frames a second of 12 bytes (frames.py), twice; and 2 kB a trial.
    assert checks.session_bytes(trials=40, rate_hz=1000) == 2 * 40 * 60 * 1000 * 12 + 40 * 2000


@pytest.mark.parametrize(("short", "verdict"), [(0, "passes"), (1, "refuses")])
def test_a_disk_without_room_is_red(short: int, verdict: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    free = checks.session_bytes(trials=40, rate_hz=1000) - short
    monkeypatch.setattr(shutil, "disk_usage", lambda _: Usage(free, 0, free))
    found = checks.space(tmp_path, trials=40, rate_hz=1000)
    assert (found.verdict, "free some space" in str(found.remedy)) == (verdict, verdict == "refuses")


@pytest.mark.parametrize(("late_ms", "verdict"), [(49, "passes"), (51, "refuses")])
def test_one_slow_entry_is_red(late_ms: int, verdict: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    clock = ManualClock(0)
    took_ms = iter([1] * 7 + [late_ms] + [1] * 12)
    monkeypatch.setattr(os, "fsync", lambda _: clock.sleep_ns(next(took_ms) * 1_000_000))
    found = checks.writing(tmp_path, clock)
    assert (found.verdict, found.what.startswith(f"writing an entry takes 1.00 ms (median), {late_ms}.00 ms")) == (
        verdict,
        True,
    )
    assert next(took_ms, None) is None


def test_a_folder_that_this_user_may_not_write_is_red(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, approved: SnapshotAssertion
) -> None:
    def forbidden(**_: object) -> None:
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))

    monkeypatch.setattr(tempfile, "TemporaryFile", forbidden)
    found = checks.writing(tmp_path, ManualClock(0))
    assert (found.verdict, found.where) == ("refuses", tmp_path)
    assert found.clause() == approved


def test_a_disk_that_fills_up_meanwhile_is_red(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, approved: SnapshotAssertion
) -> None:
    def full(_: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "fsync", full)
    assert checks.writing(tmp_path, ManualClock(0)).what == approved
    assert list(tmp_path.iterdir()) == []


def test_what_others_can_read_is_red(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert list(checks.privacy(tmp_path)) == []
    monkeypatch.setattr(checks, "readable_by_others", lambda folder: (folder / "sourcedata",))
    (found,) = checks.privacy(tmp_path)
    assert (found.verdict, str(tmp_path / "sourcedata") in found.what) == ("refuses", True)
