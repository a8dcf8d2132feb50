"""How a task went: windows and bins against counting by hand, and statements where something is missing."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from syrupy.assertion import SnapshotAssertion

from palpate.analysis.identification import time_course
from palpate.analysis.identification.time_course import (
    BIN_WIDTHS_MM_S,
    LEARNING,
    MASKER,
    MOST_BINS,
    ONSET,
    SPEED,
    TIMING,
    WINDOW,
    TimeCourse,
    course_of,
)
from palpate.analysis.reading.dataset import read
from palpate.analysis.report.identification_sections import course_section
from palpate.analysis.statistics.shares import share_limits
from tests.analysis.datasets import MATERIALS, trial, write_dataset


def _session(rights: str, speeds: list[float] | None = None) -> list[dict[str, object]]:
    """`1` is a right answer, `0` a wrong one, `-` none at all."""
    said = {"1": MATERIALS[0], "0": MATERIALS[1], "-": "(none)"}
    more = [{}] * len(rights) if speeds is None else [{"foot_speed": speed} for speed in speeds]
    return [trial(n, MATERIALS[0], said[mark], **more[n - 1]) for n, mark in enumerate(rights, start=1)]


def _course(root: Path, sessions: dict[str, list[dict[str, object]]]) -> TimeCourse:
    return course_of(read(write_dataset(root, {who: {"real": rows} for who, rows in sessions.items()})))


def test_windows_count_every_run_of_trials(tmp_path: Path) -> None:
    marks = {"1": "110010110-11", "2": "011111100000", "3": "10-010101111"}
    found = _course(tmp_path, {who: _session(rights) for who, rights in marks.items()}).learning["real"]
    runs = [sum(rights[start : start + WINDOW].count("1") for rights in marks.values()) for start in range(3)]
    assert [(one.first, one.last, one.right, one.trials) for one in found] == [
        (start + 1, start + WINDOW, runs[start], 3 * WINDOW) for start in range(3)
    ]
    for one in found:
        assert one.interval is not None
        assert (one.interval.low or 0) <= one.right / one.trials <= (one.interval.high or 1)


def test_an_interval_is_that_of_the_share_over_participants(tmp_path: Path) -> None:
    rng = np.random.default_rng(8)
    marks = ["".join(map(str, (rng.random(WINDOW) < rng.uniform(0.2, 0.9)).astype(int))) for _ in range(20)]
    found = _course(tmp_path, {f"{k}": _session(rights) for k, rights in enumerate(marks)}).learning["real"]
    right = np.array([rights.count("1") for rights in marks])
    assert [one.interval for one in found] == [share_limits(right, np.full(20, WINDOW))]


def test_a_short_task_is_one_window(tmp_path: Path) -> None:
    (only,) = _course(tmp_path, {"1": _session("101"), "2": _session("11")}).learning["real"]
    assert (only.first, only.last, only.right, only.trials) == (1, 3, 4, 5)
    assert only.interval == share_limits(np.array([2, 2]), np.array([3, 2]))


def test_everyone_always_right_has_the_lower_end_alone(tmp_path: Path) -> None:
    found = _course(tmp_path, {str(k): _session("1" * 12) for k in range(4)}).learning["real"]
    tens = np.full(4, WINDOW)
    assert {one.interval for one in found} == {share_limits(tens, tens)}


def test_trials_that_one_participant_alone_did(tmp_path: Path, approved: SnapshotAssertion) -> None:
    sessions = {"1": _session("10" * 15), "2": _session("0110"), "3": _session("1011"), "4": _session("0100")}
    found = _course(tmp_path, sessions).learning["real"]
    assert found[0].interval is not None
    assert (found[-1].trials, found[-1].interval) == (WINDOW, None)
    assert found[-1].statement == approved


@given(speeds=st.lists(st.floats(1, 2000), min_size=1, max_size=60))
def test_bins_hold_every_step_once(speeds: list[float]) -> None:
    import pandas as pd

    names = ["right", "wrong"]
    answered = [names[k % 2] for k in range(len(speeds))]
    table = pd.DataFrame({"foot_speed_mm_s": speeds, "presented": "right", "answered": answered})
    bins = time_course._speed(table)
    assert sum(one.trials for one in bins) == len(speeds)
    assert sum(one.right for one in bins) == answered.count("right")
    width = bins[0].high_mm_s - bins[0].low_mm_s
    assert width in BIN_WIDTHS_MM_S
    assert len(bins) <= MOST_BINS
    for one in bins:
        inside = [speed for speed in speeds if one.low_mm_s <= speed < one.high_mm_s]
        assert one.trials == len(inside)
        assert one.mean_mm_s == pytest.approx(sum(inside) / len(inside))
        assert (one.interval.low or 0) <= one.right / one.trials <= (one.interval.high or 1)


def test_onset_errors_and_masker_levels_are_read_where_they_are(tmp_path: Path, approved: SnapshotAssertion) -> None:
    cells = zip((0.001, None, -0.0005, 0.0025), (60.0, 60.0, 63.0, 66.0), strict=True)
    rows = [
        {**row, "onset_error": error, "masker_level": level}
        for row, (error, level) in zip(_session("1011"), cells, strict=True)
    ]
    found = _course(tmp_path, {"7": rows})
    onsets = found.onsets["real"]
    assert onsets.errors_ms == pytest.approx((1.0, -0.5, 2.5))
    assert (onsets.mean_ms, onsets.largest_ms) == pytest.approx((1.0, 2.5))
    assert onsets.sd_ms == pytest.approx(1.5)
    (level,) = found.masker["real"]
    assert (level.participant, level.median_db_a, level.low_db_a, level.high_db_a) == ("7", 61.5, 60.0, 66.0)
    titles = [table.title for table in course_section(found).tables]
    assert len(titles) == 3
    assert titles[-2:] == approved
    early = course_section(replace(found, ahead_ms={"real": 20.0}))
    assert [len(table.notes) for table in (course_section(found).tables[-2], early.tables[-2])] == [0, 1]


def test_what_a_dataset_lacks_is_said(tmp_path: Path, approved: SnapshotAssertion) -> None:
    found = _course(tmp_path, {"1": _session("101")})
    assert (found.speed, found.onsets, found.masker) == ({}, {}, {})
    assert list(found.statements) == [("real", one) for one in (SPEED, ONSET, MASKER, TIMING)]
    assert list(found.statements.values()) == approved
    assert course_section(found).paragraphs == approved


def test_a_reconstruction_has_no_order(repository_root: Path, approved: SnapshotAssertion) -> None:
    found = course_of(read(repository_root / "participants" / "okamoto2012"))
    assert found.learning == {}
    assert found.statements["virtual", LEARNING] == approved
