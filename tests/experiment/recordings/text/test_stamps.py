"""Dates and times of day in recordings."""

from __future__ import annotations

from datetime import datetime, timedelta
from pathlib import Path

import pytest

from palpate.experiment.errors import RecordingError
from palpate.experiment.recordings.readers import read
from palpate.experiment.recordings.text.stamps import ORIGIN_NS, without_stamps


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
    assert told - ORIGIN_NS == round(since_1970 * 1e6) * 1000


def test_a_time_of_day_goes_on_past_midnight_and_a_day_of_no_month_is_left_alone() -> None:
    text = without_stamps("23:59:59.5,1\n0:00:00.5,2\n").text
    assert text == f"{ORIGIN_NS + 86_399_500_000_000},1\n{ORIGIN_NS + 86_400_500_000_000},2\n"
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


@pytest.mark.parametrize("form", ["%m/%d/%Y %I:%M:%S.%f %p", "%d/%m/%Y %H:%M:%S.%f", "%Y/%m/%d %H:%M:%S.%f"])
def test_dates_with_slashes_go_on_past_midnight_and_noon(tmp_path: Path, form: str) -> None:
    path = tmp_path / "logger.csv"
    for begins in (datetime(2026, 11, 30, 23, 59, 59, 900_000), datetime(2026, 11, 30, 11, 59, 59, 900_000)):
        stamps = ((begins + timedelta(milliseconds=i)).strftime(form) for i in range(300))
        path.write_text("\n".join(["Date,a", *(f"{one},{i % 9}.5" for i, one in enumerate(stamps))]))
        assert read(path).rate_hz == pytest.approx(1000.0)


def test_a_channel_that_begins_and_ends_at_zero_is_no_clock(tmp_path: Path) -> None:
    """Midnight and the beginning of 1970 are nothing since then, as a trigger at rest is."""
    path = tmp_path / "logger.csv"
    for day in ("", "1970-01-01 "):
        rows = (f"{day}00:00:00.{i:03d},{int(100 < i < 200)},{i % 9}" for i in range(300))
        path.write_text("\n".join(["clock,trigger,a", *rows, ""]))
        assert read(path).channels == ("trigger", "a")
        assert read(path).rate_hz == pytest.approx(1000.0)


def test_a_row_that_was_cut_is_doubted_where_decimals_show_it(tmp_path: Path) -> None:
    text = "\n".join(["time (s),a", *(f"{i / 1000:.3f},{i * 0.125:.4f}" for i in range(50))])
    path = tmp_path / "cut.csv"
    for content, checks in ((text, []), (text + "\n", []), (text[:-2], ["unfinished"])):
        path.write_text(content)
        assert [doubt.check for doubt in read(path).doubts] == checks
