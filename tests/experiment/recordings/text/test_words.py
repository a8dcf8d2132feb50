"""Words among numbers: labels of a recording are no samples of it."""

from __future__ import annotations

from pathlib import Path

import pytest

from palpate.experiment.errors import RecordingError
from palpate.experiment.recordings.readers import read
from palpate.experiment.settings.delimited import Stated
from tests.approved import Refuses

SECONDS = Stated(time_unit="s")


@pytest.mark.parametrize("decimal", [".", ","], ids=["points", "commas"])
def test_labels_as_audacity_exports_them_are_refused(tmp_path: Path, decimal: str, refuses: Refuses) -> None:
    """The second label has frequencies in a line of its own, the third one is a moment."""
    rows = "0.5\t1.25\ttap\n2\t2.5\tslide\n\\\t20\t400\n3\t3\tclick\n" + "".join(
        f"{i}\t{i}.9\ttap\n" for i in range(4, 30)
    )
    file = tmp_path / "labels.txt"
    file.write_text(rows.replace(".", decimal))
    with refuses(RecordingError):
        read(file, stated=SECONDS)


def test_a_signal_with_a_phase_behind_it_is_no_label(tmp_path: Path) -> None:
    """It is larger than its times, but not always smaller than the next one."""
    file = tmp_path / "phases.txt"
    file.write_text("".join(f"{i / 1000:.3f}\t{1 + i % 7}\tslide\n" for i in range(100)))
    assert list(read(file, stated=SECONDS).samples) == [1 + i % 7 for i in range(100)]


@pytest.mark.parametrize(
    "cells", [("1.234,5", "2.345,5"), ("1D3", "2D3"), ("+1", "2e3")], ids=["thousands", "D", "signs"]
)
def test_labels_are_known_however_their_numbers_are_written(tmp_path: Path, cells: tuple[str, str]) -> None:
    file = tmp_path / "labels.txt"
    file.write_text("\t".join((*cells, "tap\n")) + "3.456,5\t4.567,5\ttap\n" * (cells[0] == "1.234,5"))
    with pytest.raises(RecordingError):
        read(file, stated=SECONDS)
