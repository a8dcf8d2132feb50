"""A small dataset of comparisons."""

from __future__ import annotations

from pathlib import Path

from tests.analysis.datasets import compared, write_dataset


def sample(folder: Path) -> Path:
    """Two participants, who heard of no tie."""
    said = [("felt", "cork", "second"), ("cork", "felt", "first"), ("felt", "felt", "first"), ("cork", "cork", "first")]
    sessions = {who: {"live": compared(said)} for who in ("1", "2")}
    return write_dataset(
        folder / "study",
        sessions,
        materials=("felt", "cork"),
        tasks=("live",),
        answers=("first", "second"),
        origin="REHEARSAL",
    )
