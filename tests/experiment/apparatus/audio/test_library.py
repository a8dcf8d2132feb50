"""An audio library that begins, or is there and cannot."""

from __future__ import annotations

import os
import sys
import tempfile
from pathlib import Path

import pytest
from filelock import FileLock

from experiment.apparatus.audio import stream
from experiment.errors import AudioError

MODULE = """
class {name}(Exception):
    pass
raise {name}("Error initializing PortAudio: Unanticipated host error")
"""


@pytest.mark.parametrize(("name", "raised"), [("PortAudioError", AudioError), ("KeyMissing", Exception)])
def test_what_it_says_as_it_is_imported_is_told_in_words(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, raised: type[Exception]
) -> None:
    (tmp_path / "sounddevice.py").write_text(MODULE.format(name=name), "utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "sounddevice", raising=False)
    with pytest.raises(raised, match="Error initializing PortAudio") as told:
        stream.library()
    assert isinstance(told.value, AudioError) == (name == "PortAudioError")


@pytest.mark.parametrize("held", [False, True], ids=["free", "held by one that stands still"])
def test_it_begins_in_its_turn_and_waits_for_that_no_longer_than_it_may(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, held: bool
) -> None:
    turn = tmp_path / f"palpate-sound-{os.getuid()}.lock"
    asks = f"from filelock import FileLock, Timeout\nlock = FileLock({str(turn)!r}, timeout=0)\n"
    asks += "try:\n    lock.acquire()\n    lock.release()\n    free = True\nexcept Timeout:\n    free = False\n"
    (tmp_path / "sounddevice.py").write_text(asks, "utf-8")
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    monkeypatch.setattr(stream, "TURN_S", 0.01)
    monkeypatch.syspath_prepend(tmp_path)
    # First as None, so that what is imported here is gone afterwards even where nothing was there before.
    monkeypatch.setitem(sys.modules, "sounddevice", None)
    monkeypatch.delitem(sys.modules, "sounddevice")
    other = FileLock(turn)
    if held:
        other.acquire()
    assert not stream.library().free
    other.release()
    assert stream.library()
    with other.acquire(timeout=0):
        pass
