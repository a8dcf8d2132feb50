"""Layouts of loggers, oscilloscopes and spreadsheets: each holds the same 60 samples at 1 kHz."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from palpate.experiment.errors import PalpateError, RecordingError
from palpate.experiment.recordings.readers import read
from palpate.experiment.settings.delimited import Stated

SAMPLES = [round((i % 7) * 0.5 - 1.5, 4) for i in range(60)]

Row = Callable[[int, float], str]


def _file(folder: Path, heading: str, row: Row) -> Path:
    path = folder / "a.csv"
    path.write_text(heading + "".join(f"{row(i, a)}\n" for i, a in enumerate(SAMPLES)), "utf-8")
    return path


def _german(number: float, digits: int) -> str:
    return f"{number:.{digits}f}".replace(".", ",")


LAYOUTS: dict[str, tuple[str, Row, Stated]] = {
    "a note in the first row": (
        "time_s,acc_g,note\n", lambda i, a: f"{i / 1000:.3f},{a:.4f},{'start' if i == 0 else ''}", Stated(),
    ),
    "a note in a middle row": (
        "time_s,acc_g,note\n", lambda i, a: f"{i / 1000:.3f},{a:.4f},{['tap', ' hard'][0] if i == 30 else ''}",
        Stated(),
    ),
    "a note in a German spreadsheet": (
        "Zeit in ms;Beschleunigung in g;Bemerkung\n",
        lambda i, a: f"{_german(i, 1)};{_german(a, 4)};{'Start' if i == 0 else ''}", Stated(decimal=","),
    ),
    "date and time of day in two cells": (
        "Date,Time,Acc (g)\n", lambda i, a: f"2024-03-05,10:00:00.{i:03d},{a:.4f}", Stated(),
    ),
    "the same in German": (
        "Datum;Uhrzeit;Acc (g)\n", lambda i, a: f"05.03.2024;10:00:00,{i:03d};{_german(a, 4)}", Stated(),
    ),
    "numbers behind three empty cells": (
        "", lambda i, a: f",,,{i / 1000 - 0.03:.4f},{a:.5f}", Stated(time_unit="s"),
    ),
    "what a scope writes before its first numbers": (
        "", lambda i, a: f"{'Record Length,2500,Points' if i == 0 else ',,'},{i / 1000:.4f},{a:.5f}",
        Stated(time_unit="s"),
    ),
    "decimal commas between commas": (
        "time (ms),acc (g)\n", lambda i, a: f"{_german(i, 1)},{_german(a, 4)}", Stated(),
    ),
    "decimal commas between commas, as stated": (
        "", lambda i, a: f"{_german(i / 1000, 3)},{_german(a, 4)}", Stated(decimal=",", time_unit="s"),
    ),
    "start and increment of a scope": (
        "X,CH1,Start,Increment,\nSequence,Volt,-3.0e-02,1.0e-03\n", lambda i, a: f"{i},{a:.4e},,",
        Stated(time_unit="s"),
    ),
    "start and increment in lines of their own": (
        "Start (s),Increment (s)\n-0.03,0.001\nCH1 (g),CH2 (g)\n", lambda i, a: f"{a:.4f},{2 * a:.4f}", Stated(),
    ),
    "no times": ("x (g),y (g)\n", lambda i, a: f"{a:.4f},{2 * a:.4f}", Stated(rate_hz=1000)),
    "one column": ("acc (g)\n", lambda i, a: f"{a:.4f}", Stated(rate_hz=1000)),
    "one column with decimal commas": ("acc (g)\n", lambda i, a: _german(a, 4), Stated(rate_hz=1000, decimal=",")),
    "times of a whole second each, at a stated rate": (
        "Time,acc (g)\n", lambda i, a: f"10:00:{i // 50:02d},{a:.4f}", Stated(rate_hz=1000),
    ),
    "rows numbered by pandas, with a note": (
        ";time_s;acc_g;note\n", lambda i, a: f"{i};{i / 1000:.3f};{a:.4f};{'tap' if i == 30 else ''}", Stated(),
    ),
    "days of a spreadsheet": (
        "Time,acc_g\n", lambda i, a: f"{45356.25 + i / 86_400_000:.12f},{a:.4f}", Stated(time_unit="d"),
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", LAYOUTS)
def test_a_layout_is_read_whole(tmp_path: Path, name: str) -> None:
    heading, row, stated = LAYOUTS[name]
    made = read(_file(tmp_path, heading, row), stated=stated)
    assert made.samples.tolist() == SAMPLES
    assert made.rate_hz == pytest.approx(1000, rel=1e-3)
    assert made.unit in ("g", "Volt", "")


NO_TIMES: dict[str, tuple[str, Row, str]] = {
    "whole numbers below half as many names": ("a,b\n", lambda i, a: f"{_german(i, 1)},{_german(a, 4)}", "--decimal ,"),
    "zeros before digits": ("", lambda i, a: f"{_german(i / 1000, 3)},{_german(a, 4)}", "--decimal ,"),
    "whole times": ("time (ms),acc (g)\n", lambda i, a: f"{i},{_german(a, 4)}", "--decimal ."),
    "a scope's increment": ("CH1,Start,Increment\nVolt,0,1e-5\n", lambda i, a: f"{a:.4f},{i},,", "--time-unit s"),
    "a rate above the rows": ("# at 3.2 kHz\nx (g),y (g)\n", lambda i, a: f"{a:.4f},{i}", "--rate 3200"),
    "no rate": ("x (g),y (g)\n", lambda i, a: f"{a:.4f},{i}", "--rate HZ"),
    "one column": ("acc (g)\n", lambda i, a: f"{a:.4f}", "--rate HZ"),
}  # fmt: skip


@pytest.mark.parametrize("name", NO_TIMES)
def test_what_does_not_show_in_the_numbers_is_asked(tmp_path: Path, name: str) -> None:
    heading, row, remedy = NO_TIMES[name]
    with pytest.raises(RecordingError) as refused:
        read(_file(tmp_path, heading, row))
    assert str(refused.value.finding.remedy).endswith(f": {remedy}")


@pytest.mark.parametrize("heading", ["", "x,y\n"])
@pytest.mark.parametrize(("unit", "digits"), [("s", 3), ("ms", 1)])
def test_times_that_nothing_names_are_no_samples_at_a_stated_rate(
    tmp_path: Path, heading: str, unit: str, digits: int
) -> None:
    """Steps of 1 ms agree with 1 kHz in either unit, and with 300 Hz in none."""
    step = {"s": 0.001, "ms": 1.0}[unit]
    path = _file(tmp_path, heading, lambda i, a: f"{i * step:.{digits}f},{a:.4f}")
    made = {rate: read(path, stated=Stated(rate_hz=rate)) for rate in (1000.0, 300.0)}
    assert [one.samples.tolist() for one in made.values()] == [SAMPLES, SAMPLES]
    assert {rate: [doubt.check for doubt in one.doubts] for rate, one in made.items()} == {1000.0: [], 300.0: ["rate"]}
    assert read(path, stated=Stated(time_column="1", time_unit=unit)).samples.tolist() == SAMPLES


def test_one_column_of_decimal_commas_is_not_taken_for_two(tmp_path: Path) -> None:
    path = _file(tmp_path, "", lambda i, a: _german(9.71 + a / 10, 2))
    with pytest.raises(RecordingError) as refused:
        read(path, stated=Stated(rate_hz=1000))
    assert str(refused.value.finding.remedy).endswith(": --decimal ,")
    made = {sign: read(path, channel="1", stated=Stated(rate_hz=1000, decimal=sign)).samples.tolist() for sign in ",."}
    assert made[","] == [round(9.71 + a / 10, 2) for a in SAMPLES]
    assert made["."] == [9.0] * len(SAMPLES)


def test_rows_below_a_column_named_increment_are_all_read(tmp_path: Path) -> None:
    path = _file(tmp_path, "time (s),increment,x (g)\n", lambda i, a: f"{i / 1000:.3f},1,{a:.4f}")
    made = read(path, channel="x")
    assert (made.samples.tolist(), made.unit, round(made.rate_hz, 3)) == (SAMPLES, "g", 1000)


@pytest.mark.parametrize("heading", ["Trigger,Increment\n0,5e-6\n", "Increment\n5e-6\n"])
def test_numbers_below_an_increment_that_may_be_a_row_are_asked_about(tmp_path: Path, heading: str) -> None:
    path = _file(tmp_path, heading, lambda i, a: f"{a:.4f},{i}" if "," in heading else f"{a:.4f}")
    with pytest.raises(RecordingError) as refused:
        read(path, stated=Stated(rate_hz=1000))
    assert refused.value.finding.line == 2


@pytest.mark.parametrize(
    ("names", "units", "asked", "unit"),
    [("time,2,3", "s,g,V", "2", "g"), ("time,2,3", "s,g,V", "3", "V"), ("time,V,x", "s,V,g", "x", "g")],
)
def test_names_that_are_numbers_or_units_stay_names(
    tmp_path: Path, names: str, units: str, asked: str, unit: str
) -> None:
    path = _file(tmp_path, f"{names}\n{units}\n", lambda i, a: f"{i / 1000:.3f},{a:.4f},{2 * a:.4f}")
    made, times = read(path, channel=asked), names.split(",").index(asked)
    assert (made.channels, made.unit) == (tuple(names.split(",")[1:]), unit)
    assert made.samples.tolist() == [times * a for a in SAMPLES]


def test_a_setting_above_units_is_no_name(tmp_path: Path) -> None:
    made = read(_file(tmp_path, "Rate,1000\ns,g\n", lambda i, a: f"{i / 1000:.3f},{a:.4f}"))
    assert (made.samples.tolist(), made.channels, made.unit) == (SAMPLES, ("column 2",), "g")


@pytest.mark.parametrize(
    "remark", ["# sensor (PCB 352C33), range (50 g)", "# Start time: noon, subject AB", "# t (s), a (g)"]
)
def test_a_remark_between_headings_and_rows_is_no_heading(tmp_path: Path, remark: str) -> None:
    heading = f"time (s),a (g),b (g)\n{remark}\n"
    made = read(_file(tmp_path, heading, lambda i, a: f"{i / 1000:.3f},{a:.4f},{2 * a:.4f}"), channel="b")
    assert (made.channels, made.samples.tolist(), made.unit) == (("a", "b"), [2 * a for a in SAMPLES], "g")


def test_a_rate_is_above_zero() -> None:
    for rate in (0.0, -1.0, float("nan"), float("inf")):
        with pytest.raises(PalpateError, match="--rate"):
            Stated(rate_hz=rate)


def test_a_stated_rate_is_held_against_times(tmp_path: Path) -> None:
    path = _file(tmp_path, "time_s,acc_g\n", lambda i, a: f"{i / 1000:.3f},{a:.4f}")
    made = {rate: read(path, stated=Stated(rate_hz=rate)) for rate in (1000.0, 500.0)}
    assert {rate: (one.rate_hz, [doubt.check for doubt in one.doubts]) for rate, one in made.items()} == {
        1000.0: (1000.0, []), 500.0: (500.0, ["rate"]),
    }  # fmt: skip


@pytest.mark.parametrize("cell", ["nan", "n/a", "OVF"])
def test_a_first_row_with_a_cell_that_is_no_number_is_not_taken_for_a_heading(tmp_path: Path, cell: str) -> None:
    path = _file(tmp_path, "time_s,acc_g,temp\n", lambda i, a: f"{i / 1000:.3f},{a:.4f},{cell if i == 0 else 21.5}")
    assert read(path).channels == ("acc_g", "temp")
    with pytest.raises(RecordingError) as refused:
        read(path, channel="temp")
    assert refused.value.finding.line == 2


def test_times_in_days_of_a_spreadsheet_are_asked_about_as_such(tmp_path: Path) -> None:
    path = _file(tmp_path, "Time,acc_g\n", lambda i, a: f"{45356.25 + i / 86_400_000:.12f},{a:.4f}")
    with pytest.raises(RecordingError) as refused:
        read(path)
    assert "--time-unit d" in str(refused.value.finding.remedy)


@pytest.mark.parametrize("text", [",9,71\n\n\n\t1e308", "time (s)xgtime (s)0.5,increment \n9,71\n\n"])
def test_rows_that_hold_nothing_end_in_a_refusal(tmp_path: Path, text: str) -> None:
    (tmp_path / "odd.csv").write_text(text, "utf-8")
    with pytest.raises(RecordingError):
        read(tmp_path / "odd.csv", stated=Stated(rate_hz=1000.0))
