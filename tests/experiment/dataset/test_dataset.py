"""Rows of the events table, from a journal's entries."""

from __future__ import annotations

from pathlib import Path

import pytest

from palpate.experiment.dataset import build
from palpate.experiment.dataset.kinds.footstep import DATASET
from palpate.experiment.records.entries import Entry, MaskerSet, Trace, TrackerOpened
from palpate.experiment.records.journal import Contents, Line
from palpate.experiment.records.kinds.footstep import BrokenOff
from palpate.experiment.records.tracker import Link, TrackerClock


def _step(trial: int, attempt: int = 1) -> BrokenOff:
    return BrokenOff(
        trial=trial,
        attempt=attempt,
        presented=("glass",),
        reason="the foot turned back",
        felt=False,
        clock=TrackerClock(anchor_us=0, anchor_ns=0, drift_ppm=0.0),
        dead_time_ms=None,
        at_us=1000 * trial,
        gate_top_us=None,
        gate_bottom_us=None,
        speed_mm_s=None,
        link=Link(received=1, lost=0, damaged=0, repeated=0),
        trace=Trace(offset=0, length=0, sha256=""),
    )


def _masker(level_db_a: float | None) -> MaskerSet:
    return MaskerSet(level_db_a=level_db_a, dose=0.0, daily_level_db_a=None)


def _levels(entries: list[Entry]) -> list[object]:
    opened = TrackerOpened(port="", device_us=0, t_ns=0)
    lines = tuple(Line(number, entry) for number, entry in enumerate([opened, *entries]))
    rows = build.event_rows(DATASET, Path(), Contents(lines), "PARTICIPANT")
    return [row.get("masker_level", "no column") for row in rows]


@pytest.mark.parametrize(
    ("entries", "levels"),
    [
        ([_step(1), _step(2)], ["no column", "no column"]),
        ([_masker(60.0), _step(1), _step(1, 2), _masker(63.0), _step(2)], [60.0, 60.0, 63.0]),
        ([_masker(60.0), _step(1), _masker(None), _step(2)], [60.0, None]),
    ],
)
def test_an_attempt_has_the_level_that_was_set_last(entries: list[Entry], levels: list[object]) -> None:
    assert _levels(entries) == levels
