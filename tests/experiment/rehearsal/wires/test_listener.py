"""What a tap keeps of a stream without end, and what it makes of a listener that fails."""

from __future__ import annotations

import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from palpate.experiment.errors import AudioError
from palpate.experiment.rehearsal.wires import neighbour
from palpate.experiment.rehearsal.wires.listener import Kept, Tap
from tests.approved import Refuses

KEPT = 20


@given(
    blocks=st.lists(st.integers(0, KEPT), max_size=30),
    first=st.integers(0, 400),
    spare=st.integers(KEPT, 2 * KEPT),
)
def test_the_last_samples_are_kept_and_told_with_their_number(blocks: list[int], first: int, spare: int) -> None:
    kept, whole = Kept(KEPT, spare=spare), np.arange(sum(blocks), dtype=np.float32)
    for block in np.split(whole, np.cumsum(blocks)[:-1]) if blocks else []:
        kept.add(block)
    begin, samples = kept.since(first)
    assert begin == max(first, whole.size - KEPT)
    assert np.array_equal(samples, whole[begin:])


def scripted(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, does: str) -> Tap:
    """A tap whose listener is a shell script."""
    script = tmp_path / "listener"
    script.write_text(f"#!/bin/sh\n{does}\n")
    script.chmod(0o755)
    monkeypatch.setattr(sys, "executable", str(script))
    return Tap("server", "port", seconds=1.0)


BEGINS = "echo listening; read asked; "


@pytest.mark.skipif(sys.platform == "win32", reason="the listener is a shell script")
@pytest.mark.parametrize(
    ("does", "patience_s"),
    [
        ("exit 1", 30.0),
        ("echo no such port", 30.0),
        ("exec sleep 60", 0.1),
        (BEGINS + "printf '0 25\\n'; head -c 48 /dev/zero", 30.0),
        (BEGINS + "printf '0 25\\n'; head -c 50 /dev/zero", 30.0),
        (BEGINS + "exit 1", 30.0),
        (BEGINS + "exec sleep 60", 3.0),
    ],
)
def test_a_listener_that_does_not_begin_or_answer_is_told_of(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, does: str, patience_s: float, refuses: Refuses
) -> None:
    monkeypatch.setattr(neighbour, "PATIENCE_S", patience_s)
    with refuses(AudioError):
        scripted(monkeypatch, tmp_path, does).since(0)


HANGS = """
import io, sys, time
from types import SimpleNamespace
from unittest.mock import MagicMock
from palpate.experiment.rehearsal.wires import neighbour
client = MagicMock(samplerate=8)
client.__exit__.side_effect = lambda *_: time.sleep(60)
sys.modules["jack"] = SimpleNamespace(Client=lambda *_, **__: client)
neighbour.ENDS_S = 1
"""
"""The client of a server that was killed, which never closes."""

LISTENS = (
    "from palpate.experiment.rehearsal.wires.listener import listen\nlisten('', '', 1.0, io.BytesIO(), io.BytesIO())"
)
SPEAKS = (
    "from palpate.experiment.rehearsal.wires.mouth import speak\n"
    "speak('', '', '', io.BytesIO(b'1\\n0000'), io.BytesIO())"
)


@pytest.mark.skipif(sys.platform == "win32", reason="no alarm rings there")
@pytest.mark.parametrize("does", [LISTENS, SPEAKS], ids=["listener", "mouth"])
def test_one_whose_client_cannot_be_closed_ends_all_the_same(repository_root: Path, does: str) -> None:
    done = subprocess.run([sys.executable, "-c", HANGS + does], cwd=repository_root, check=False, timeout=30)
    assert done.returncode == -signal.SIGALRM
