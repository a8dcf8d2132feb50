"""Datasets that released versions wrote, SIMULATED, each in the folder of its version: this palpate reads them all."""

from __future__ import annotations

from datetime import date
from pathlib import Path

FOLDER = Path(__file__).parent

RELEASES = ("0.2.0",)

TRIALS = "trials.csv"
"""Beside each dataset: its trials, as the version that wrote it read them."""

RIGS = {"okamoto2012": "rigs/rehearsal.toml", "wellman1995": "rigs/tapping.toml", "levels": "rigs/tapping.toml"}
"""The small studies that are rehearsed for a release, and the rig of each."""

FORMATS = "formats.txt"
"""Beside the studies: the newest number of each format that the version wrote, a line each."""


def formats() -> frozenset[str]:
    """Return the names of the formats that a release wrote, with their numbers, such as `journal-9`."""
    return frozenset(line for one in RELEASES for line in (FOLDER / one / FORMATS).read_text("utf-8").split())


APPROVED_ON, EXPIRES_ON = date(2026, 11, 28), date(2027, 11, 28)
"""No board approved anything: the seals are there to be read."""
