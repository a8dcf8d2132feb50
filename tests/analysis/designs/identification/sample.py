"""A small dataset of identifications."""

from __future__ import annotations

from pathlib import Path

REPOSITORY = Path(__file__).parents[4]


def sample(_: Path) -> Path:
    """The published dataset, which comes with palpate."""
    return REPOSITORY / "participants" / "okamoto2012"
