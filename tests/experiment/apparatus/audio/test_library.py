"""An audio library that is there and cannot begin."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from palpate.experiment.apparatus.audio import stream
from palpate.experiment.errors import AudioError

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
