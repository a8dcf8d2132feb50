"""Dates and times of day in recordings."""

from __future__ import annotations

from datetime import datetime
from pathlib import Path

import pytest

from palpate.experiment.errors import RecordingError
from palpate.experiment.recordings.readers import read
from palpate.experiment.recordings.stamps import without_stamps


@pytest.mark.parametrize(
    "stamp",
    [
        "2026-11-28T12:00:00.001+00:00",
        "2026-11-28 12:00:00.250001+05:30",
        "1969-12-31T23:59:59-08:00",
        "2026-11-28T12:00:00Z",
    ],
)
def test_a_stamp_is_the_moment_that_datetime_reads(stamp: str) -> None:
    since_1970 = datetime.fromisoformat(stamp).timestamp()
    (told,) = without_stamps(f"{stamp}, 1.5").stamps_ns
    assert told == round(since_1970 * 1e6) * 1000


def test_a_time_of_day_goes_on_past_midnight_and_a_day_of_no_month_is_left_alone() -> None:
    assert without_stamps("23:59:59.5,1\n0:00:00.5,2\n").text == "86399500000000,1\n86400500000000,2\n"
    for other in ("31.02.2026 12:00:00,1", "12:61:00,1", "1.5,2.5", "11/28/2026x12:00:00,3", "a12:00:00,3"):
        assert without_stamps(other) == (other, frozenset())


def test_times_of_a_whole_second_each_lose_to_a_column_of_seconds(tmp_path: Path) -> None:
    path = tmp_path / "logger.csv"
    rows = (f"12:00:{i // 1000:02d},{i / 1000:.3f},{i % 7}" for i in range(3000))
    path.write_text("\n".join(["clock,elapsed (s),a", *rows, ""]))
    found = read(path)
    assert (found.channels, round(found.rate_hz, 6)) == (("a",), 1000.0)
    path.write_text("\n".join(f"12:00:{i // 1000:02d},{i % 7}" for i in range(3000)))
    with pytest.raises(RecordingError):
        read(path)


def test_a_row_that_was_cut_is_doubted_where_decimals_show_it(tmp_path: Path) -> None:
    text = "\n".join(["time (s),a", *(f"{i / 1000:.3f},{i * 0.125:.4f}" for i in range(50))])
    path = tmp_path / "cut.csv"
    for content, checks in ((text, []), (text + "\n", []), (text[:-2], ["unfinished"])):
        path.write_text(content)
        assert [doubt.check for doubt in read(path).doubts] == checks
