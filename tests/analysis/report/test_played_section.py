"""What was played, by task and material: figures by hand, and what is said where the rig left something out."""

from __future__ import annotations

from pathlib import Path

import pytest
from syrupy.assertion import SnapshotAssertion

from palpate.analysis.reading.dataset import read
from palpate.analysis.report.heard import UNLISTENED
from palpate.analysis.report.played_section import left_out, played_sections
from tests.analysis.datasets import trial, write_dataset


def played(
    number: int, presented: str, error: float, left_out: float, off: float, **cells: object
) -> dict[str, object]:
    cells = {"stimulus_method": "prepared voltages", "foot_speed": 100.0 + number, **cells}
    return trial(number, presented, "sand", stimulus_error=error, left_out=left_out, dissimilarity=off, **cells)


def test_figures_by_task_and_material(tmp_path: Path, approved: SnapshotAssertion) -> None:
    virtual = [
        played(1, "sand", 0.30, 0.25, 1.0),
        played(2, "sand", 0.10, 0.05, 4.0, counted=False, redo_reason="felt twice"),
        played(2, "sand", 0.12, 0.06, 3.0, attempt=2, stimulus_method="voltages shaped for the step"),
        played(3, "snow", 0.2, 0.2, 0.5),
        trial(4, "glass", "sand"),
    ]
    gone = [played(1, "sand", 0.9, 0.9, 9.0)]
    root = write_dataset(
        tmp_path,
        {"1": {"virtual": virtual, "real": [trial(1, "sand", "sand")]}, "2": {"virtual": gone}},
        withdrawn=["2"],
    )
    (section,) = played_sections(read(root))
    assert (section.slug, section.title) == ("played", "What was played")
    _, told, unheard, unlistened = section.paragraphs
    assert unlistened == UNLISTENED
    assert left_out(read(root)) == (told,)
    assert unheard == approved
    assert told == approved
    (table,) = section.tables
    assert table.rows == (
        ("virtual", "sand", "3", "12.00", "30.00", "6.00", "25.00", "3.000", "4.000"),
        ("virtual", "snow", "1", "20.00", "20.00", "20.00", "20.00", "0.500", "0.500"),
    )
    assert table.notes[0] == approved
    assert section.records[0]["error_median"] == pytest.approx(0.12)
    assert section.records[0]["left_out_max"] == pytest.approx(0.25)


def test_what_limits_took_off_is_told_beside_what_was_left_out(tmp_path: Path) -> None:
    def told(name: str, *stimuli: tuple[float, float]) -> tuple[str, ...]:
        rows = [played(trial, "sand", off, out, 1.0) for trial, (off, out) in enumerate(stimuli, start=1)]
        return left_out(read(write_dataset(tmp_path / name, {"1": {"virtual": rows}})))

    changed = (
        "The limits of panel and amplifier, and the response table, changed up to {} % of a vibration; the total "
        "error was up to {} %."
    )
    assert changed.format("94.76", "98.00") in told("both", (0.98, 0.25), (0.25, 0.25))[0]
    # Of a stimulus of its own.
    assert changed.format("25.00", "34.64") in told("another", (0.3464, 0.3464), (0.32015, 0.2))[0]
    (limits,) = told("limits", (0.98, 0.0))
    assert limits.startswith(changed.format("98.00", "98.00"))
    assert "changed" not in told("band", (0.2501, 0.25))[0]
    assert told("table", (0.002, 0.0)) == ()
    rows = {"1": {"virtual": [played(1, "sand", 0.3, 0.0, 1.0)]}}
    (practiced,) = left_out(read(write_dataset(tmp_path / "practice", rows, origin="PRACTICE")))
    # Which is not about limits.
    assert "left_out_max" not in practiced


def test_practice_is_said_not_to_be_refused_for_what_its_rig_leaves_out(
    tmp_path: Path, approved: SnapshotAssertion
) -> None:
    rows = {"1": {"virtual": [played(1, "sand", 0.3, 0.2961, 1.0)]}}
    (practiced,) = left_out(read(write_dataset(tmp_path / "practice", rows, origin="PRACTICE")))
    assert practiced == approved
    (measured,) = left_out(read(write_dataset(tmp_path / "study", rows)))
    assert "practice" not in measured


def test_a_rig_that_carried_everything_is_said_to_have(tmp_path: Path, approved: SnapshotAssertion) -> None:
    root = write_dataset(tmp_path, {"1": {"virtual": [played(1, "sand", 2.5e-8, 0.0, 0.0)]}})
    (section,) = played_sections(read(root))
    assert section.paragraphs[1] == approved
    assert left_out(read(root)) == ()
    assert section.tables[0].rows[0][3:7] == ("< 0.001", "< 0.001", "0.00", "0.00")


def test_where_nothing_is_on_record_nothing_is_said(tmp_path: Path) -> None:
    root = write_dataset(tmp_path, {"1": {"real": [trial(1, "sand", "sand")]}})
    assert played_sections(read(root)) == ()
    assert left_out(read(root)) == ()
