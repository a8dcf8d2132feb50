"""What begins at a sound server has its turn: no other process of palpate's begins meanwhile."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import pytest
from filelock import FileLock

from palpate.experiment.apparatus import host
from palpate.experiment.apparatus.audio import stream
from palpate.experiment.errors import AudioError
from tests.approved import Refuses

LIBRARY = """
from filelock import FileLock
with FileLock({lock!r}, blocking=False):
    pass
"""
"""A library that can begin only while nobody has a turn."""


@pytest.fixture
def lock(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> FileLock:
    """The lock of another process, which waits for nobody."""
    monkeypatch.setattr(host, "IN_MEMORY", str(tmp_path))
    monkeypatch.setattr(host, "_waits_for_others", True)
    return FileLock(tmp_path / f"palpate-sound-{os.getuid()}.lock", blocking=False)


def is_free(lock: FileLock) -> bool:
    try:
        with lock:
            return True
    except TimeoutError:
        return False


def test_a_turn_lasts_until_the_outermost_has_ended(lock: FileLock) -> None:
    with host.taking_turns():
        assert not is_free(lock)
        with host.taking_turns():
            assert not is_free(lock)
        assert not is_free(lock)
    assert is_free(lock)


def test_one_that_stands_still_is_waited_for_once(lock: FileLock, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(host, "TURN_S", 0.01)
    with lock, host.taking_turns():
        monkeypatch.setattr(host, "FileLock", None)
        with host.taking_turns():
            pass
    with host.taking_turns():
        assert is_free(lock)


def test_the_library_begins_in_its_turn_and_then_takes_none(
    lock: FileLock, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, refuses: Refuses
) -> None:
    (tmp_path / "sounddevice.py").write_text(LIBRARY.format(lock=lock.lock_file), "utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    # First as None, so that what is imported here is gone afterwards even where nothing was there before.
    monkeypatch.setitem(sys.modules, "sounddevice", None)
    monkeypatch.delitem(sys.modules, "sounddevice")
    with refuses(AudioError):
        stream.library()
    (tmp_path / "sounddevice.py").write_text("", "utf-8")
    assert stream.library() is sys.modules["sounddevice"]
    with lock:
        monkeypatch.setattr(host, "FileLock", None)
        assert stream.library() is sys.modules["sounddevice"]
