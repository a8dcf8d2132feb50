"""Thresholds by frequency: where they lie, means by hand, and the floor for a footstep protocol."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from palpate.analysis.designs.detection import frequencies, results
from palpate.analysis.designs.detection.results import Detections, Estimate, TaskDetections
from palpate.analysis.reading.dataset import read
from tests.analysis.designs.detection.sample import dataset


@pytest.fixture(scope="module")
def found(tmp_path_factory: pytest.TempPathFactory) -> Detections:
    """Two participants and two frequencies, by the posterior of the levels: dB below a peak of 3 m/s^2, and SD 1 dB."""
    whole = results.compute(read(dataset(tmp_path_factory.mktemp("frequencies") / "study")))
    one = whole.tasks[0].tracks[0]
    tracks = tuple(
        replace(one, participant=who, frequency_hz=hz, estimate=Estimate("posterior", db, 1.0, 0.75))
        for hz, who, db in ((250.0, "1", -20.0), (250.0, "2", -24.0), (10.0, "1", -6.0), (10.0, "2", -2.0))
    )
    return replace(whole, tasks=(replace(whole.tasks[0], tracks=tracks),))


@pytest.fixture
def task(found: Detections) -> TaskDetections:
    return found.tasks[0]


def test_thresholds_are_means_of_decibels_and_rms(task: TaskDetections) -> None:
    low, high = frequencies.by_frequency(task)
    assert (low.frequency_hz, high.frequency_hz) == (10.0, 250.0)
    # 3 m/s^2 at its peak, 4 dB below that, and over the square root of 2.
    assert 10 ** (low.mean_db.value / 20) == pytest.approx(3 * 10 ** (-4 / 20) / np.sqrt(2))
    assert low.mean_db.sd == pytest.approx(np.std([-6, -2], ddof=1))
    # The most sensitive of the two, and 1.959964 SD less.
    assert high.floor_m_s2 == pytest.approx(3 * 10 ** ((-24 - 1.959964) / 20) / np.sqrt(2))


def test_a_participant_is_a_unit_though_two_signals_have_one_frequency(task: TaskDetections) -> None:
    twice = tuple(replace(one, signal="other", estimate=Estimate("posterior", -8.0, 1.0, 0.75)) for one in task.tracks)
    low, _ = frequencies.by_frequency(replace(task, tracks=(*task.tracks, *twice)))
    assert (low.mean_db.n, low.participants) == (2, ("1", "2"))
    # Each has the mean of their two: -6 and -8 dB, and -2 and -8 dB.
    assert low.mean_db.value == pytest.approx(20 * np.log10(3 / np.sqrt(2)) - (7 + 5) / 2)


def test_who_is_beyond_the_levels_is_counted_beside_the_mean(found: Detections) -> None:
    tracks = [*found.tasks[0].tracks]
    tracks[2] = replace(tracks[2], beyond="below the lowest level")
    task = replace(found.tasks[0], tracks=tuple(tracks))
    low, high = frequencies.by_frequency(task)
    assert (low.participants, low.below, low.above, high.below) == (("2",), ("1",), (), ())
    section = frequencies.section(replace(found, tasks=(task,)))
    assert section is not None
    rows = [dict(zip([c.heading for c in frequencies.COLUMNS], line, strict=True)) for line in section.tables[0].rows]
    assert [row["lowest limit"].startswith("<") for row in rows] == [True, False]


def test_one_frequency_is_no_function_of_it(task: TaskDetections) -> None:
    assert frequencies.by_frequency(replace(task, tracks=task.tracks[:2])) == ()
    assert (
        frequencies.by_frequency(replace(task, tracks=tuple(replace(one, frequency_hz=None) for one in task.tracks)))
        == ()
    )


def test_without_a_posterior_it_is_the_fit(task: TaskDetections) -> None:
    fitted = replace(task.tracks[0], estimate=Estimate("reversals", -20.0, 1.0, 0.79))
    assert fitted.fit is not None
    assert fitted.known_db == fitted.fit.threshold
    assert replace(fitted, fit=None).known_db is None


def test_table_and_figure_have_every_frequency(found: Detections) -> None:
    section = frequencies.section(found)
    assert section is not None
    (table,) = section.tables
    assert [one["frequency_hz"] for one in table.records] == [10.0, 250.0]
    (sheet,) = frequencies.sheets(found, "SIMULATED", titles=True)
    (axes,) = sheet.figure.axes
    assert [tick.get_text() for tick in axes.get_xticklabels()] == ["10", "250"]
    thresholds = [tick.get_text() for tick in (*axes.get_yticklabels(), *axes.get_yticklabels(minor=True))]
    assert len([float(one) for one in thresholds]) >= 3
