"""What a tap keeps of a stream without end, and what it makes of a listener that fails."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from experiment.errors import AudioError
from experiment.rehearsal.wires import neighbour
from experiment.rehearsal.wires.listener import Kept, Tap

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
    ("does", "patience_s", "told"),
    [
        ("exit 1", 30.0, ""),
        ("echo no such port", 30.0, r" \(no such port\)"),
        ("exec sleep 60", 0.1, r" \(timed out\)"),
        (BEGINS + "printf '0 25\\n'; head -c 48 /dev/zero", 30.0, r" \(its answer was cut off\)"),
        (BEGINS + "printf '0 25\\n'; head -c 50 /dev/zero", 30.0, r" \(its answer was cut off\)"),
        (BEGINS + "exit 1", 30.0, r" \(its answer was cut off\)"),
        (BEGINS + "exec sleep 60", 3.0, r" \(timed out\)"),
    ],
)
def test_a_listener_that_does_not_begin_or_answer_is_told_of(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, does: str, patience_s: float, told: str
) -> None:
    monkeypatch.setattr(neighbour, "PATIENCE_S", patience_s)
    with pytest.raises(AudioError, match=rf"its listener has ended{told}; start again"):
        scripted(monkeypatch, tmp_path, does).since(0)
