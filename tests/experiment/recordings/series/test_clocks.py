"""Which column a channel's times are from, and in which unit, where a text says more than one thing."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from palpate.experiment.errors import RecordingError, Remedy
from palpate.experiment.recordings.grid import LONGEST_GAP
from palpate.experiment.recordings.readers import Axes, read
from palpate.experiment.settings.delimited import Stated

ROWS = 200
SIGNAL = [round(1.5 * np.sin(k / 5), 6) for k in range(ROWS)]


def _file(tmp_path: Path, head: str, row: str) -> Path:
    """A text whose rows have t, ms, at 2 kHz, and samples `a`."""
    lines = [row.format(k=k, ms=k / 2, s=k / 2000, a=a, b=k * 0.3) for k, a in enumerate(SIGNAL)]
    path = tmp_path / "recording.csv"
    path.write_text(head + "".join(f"{line}\n" for line in lines), encoding="utf-8")
    return path


ASKED = {
    "a unit below that is not the heading's": ("Time (ms),acc\ns,g\n", "{s:.4f},{a}"),
    "a name that has another unit": ("time_ms,acc\ns,g\n", "{s:.4f},{a}"),
    "a clock of something else": ("Time (s),acc (g),Exposure time (ms),force (N)\n", "{s:.4f},{a},{b:.2f},{a}"),
    "a clock with a unit, of something else": ("Time,acc (g),Exposure time (ms)\n", "{s:.4f},{a},{b:.2f}"),
    "a name too many": ("# notes by AB, 3 of them\nTime (ms),acc (g),Remark\n", "{ms},{a}"),
    "a name too few": ("Time (ms),acc (g)\n", "{ms},{a},{a}"),
    "a name too few behind a sign": ("# t [ms],acc [g]\n", "{ms},{a},{a}"),
}


@pytest.mark.parametrize(("head", "row"), ASKED.values(), ids=ASKED)
def test_what_two_things_are_said_of_is_asked_and_the_answer_is_taken(tmp_path: Path, head: str, row: str) -> None:
    path = _file(tmp_path, head, row)
    with pytest.raises(RecordingError) as refused:
        read(path, stated=Stated(command=("palpate", "spectrum")))
    remedy = refused.value.finding.remedy
    assert isinstance(remedy, Remedy)
    words = list(remedy.command[2:])
    options = dict(zip(words[::2], words[1::2], strict=True))
    unit = options.get("--time-unit", "s" if "Time," in head else None)
    made = read(path, stated=Stated(time_column=options.get("--time-column"), time_unit=unit))
    assert made.rate_hz == pytest.approx(2000.0)
    np.testing.assert_array_equal(made.samples, SIGNAL)


READ = {
    "a constant of time beside it": ("Exposure time (ms),acc (g),Time (s)\n", "12.5,{a},{s:.4f}", "g"),
    "units that nobody lists": ("TIME,ACC\nSEC,counts\n", "{s:.4f},{a}", "counts"),
    "milliseconds beside a time of day": ("Date,Time,Millisecond,acc (g)\n", "2024-03-12,14:05:10,{k},{a}", "g"),
    "an abscissa in seconds": ("X[s],ACC.X 1 [g],X[s],EMG 1 [V]\n", "{s:.4f},{a},{ms},{a}", "g"),
    "one time in two units": ("Time (s),Time (ms),acc (g)\n", "{s:.4f},{ms},{a}", "g"),
}


@pytest.mark.parametrize(("head", "row", "unit"), READ.values(), ids=READ)
def test_what_is_clear_is_read(tmp_path: Path, head: str, row: str, unit: str) -> None:
    made = read(_file(tmp_path, head, row))
    assert (round(made.rate_hz, 6), made.unit) == (1000.0 if "Date" in head else 2000.0, unit)
    np.testing.assert_array_equal(made.samples, SIGNAL)


def test_a_column_of_times_is_named_by_its_whole_heading(tmp_path: Path) -> None:
    path = _file(tmp_path, "Time (s),Time (ms),acc (g)\n", "{s:.4f},{k},{a}")
    assert {
        named: round(read(path, stated=Stated(time_column=named)).rate_hz) for named in ("Time (s)", "Time (ms)")
    } == {"Time (s)": 2000, "Time (ms)": 1000}
    with pytest.raises(RecordingError):
        read(path, stated=Stated(time_column="Time (us)"))


@pytest.mark.parametrize(
    ("head", "checks"),
    [
        ("# fs = 1000 Hz\n", ["header"]),
        ("Sampling rate (Hz),1000\n", ["header"]),
        ("Sample Interval:,1,ms\n", ["header"]),
        ("# fs: 2 kHz\n", []),
        ("# Abtastrate 2.000 Hz\n", []),
        ("# low-pass filter: 500 Hz\n", []),
    ],
)
def test_a_rate_above_the_rows_is_held_against_their_times(tmp_path: Path, head: str, checks: list[str]) -> None:
    made = read(_file(tmp_path, f"{head}\nTime (ms),acc (g)\n", "{ms},{a}"))
    assert (round(made.rate_hz, 6), [doubt.check for doubt in made.doubts]) == (2000.0, checks)


@pytest.mark.parametrize(("fast", "slow"), [("{s:.4f},{a}", ","), (",", "{s:.4f},{a}")])
def test_channels_that_end_with_clocks_of_their_own_are_read_as_far_as_they_go(
    tmp_path: Path, fast: str, slow: str
) -> None:
    path = _file(tmp_path, "t_acc (s),acc (g),t_force (s),force (N)\n", "{s:.4f},{a},{s:.4f},{a}")
    more = "".join(f"{fast},{slow}\n".format(s=k / 2000, a=0.5) for k in range(ROWS, 3 * ROWS))
    path.write_text(path.read_text("utf-8") + more, "utf-8")
    made = [read(path, channel=name) for name in ("acc", "force")]
    assert [one.rate_hz for one in made] == [pytest.approx(2000.0)] * 2
    assert [one.samples.size for one in made] == ([600, 200] if slow == "," else [200, 600])


def test_times_with_too_few_digits_ask_for_the_rate(tmp_path: Path) -> None:
    path = tmp_path / "recording.csv"
    path.write_text("t (s),a\n" + "".join(f"{(k + k // 9 % 2) // 2 * 0.001:.3f},{a}\n" for k, a in enumerate(SIGNAL)))
    with pytest.raises(RecordingError, match="--rate"):
        read(path)


@pytest.mark.parametrize("cell", ["NaN", "", "∞", "n/a", "overload"])
def test_samples_that_are_missing_are_bridged_on_request(tmp_path: Path, cell: str) -> None:
    path = _file(tmp_path, "time_s,acc_g,force_n\n", "{s:.4f},{a},{a}")
    lines = path.read_text("utf-8").splitlines()
    lines[50:53] = [f"{line.split(',')[0]},{cell},0.5" for line in lines[50:53]]
    path.write_text("\n".join([*lines, ""]), "utf-8")
    with pytest.raises(RecordingError, match="--resample") as refused:
        read(path)
    assert refused.value.finding.line == 51
    made = read(path, stated=Stated(resample=True))
    np.testing.assert_allclose(made.samples, SIGNAL, atol=0.01)
    assert read(path, channel="force_n").samples.size == ROWS
    over = [doubt.check for doubt in made.doubts if doubt.check != "resampled"]
    assert over == (["clipping"] if cell in {"∞", "overload"} else [])


def _with_missing_ends(tmp_path: Path, missing: int) -> Path:
    """A text of three axes: the first of them begins later, the others end earlier."""
    path = tmp_path / "axes.csv"
    late = {"x": range(missing), "y": range(ROWS - missing, ROWS), "z": range(ROWS - missing, ROWS)}
    rows = [[("NaN" if k in late[axis] else f"{a}") for axis in late] for k, a in enumerate(SIGNAL)]
    path.write_text("t (s),x (g),y (g),z (g)\n" + "".join(f"{k / 1000},{','.join(r)}\n" for k, r in enumerate(rows)))
    return path


@pytest.mark.parametrize("rate_hz", [None, 1000.0])
def test_samples_missing_at_the_ends_are_cut_from_all_axes_alike_and_counted(
    tmp_path: Path, rate_hz: float | None
) -> None:
    path, stated = _with_missing_ends(tmp_path, 5), Stated(resample=True, rate_hz=rate_hz)
    made = read(path, axes=Axes(("x", "y", "z"), "norm"), stated=stated)
    common = np.array(SIGNAL[5:-5])
    np.testing.assert_allclose(made.samples, np.sqrt(3) * np.abs(common - common.mean()))
    assert [doubt.check for doubt in made.doubts] == ["ends"] * 3
    alone = read(path, channel="y", stated=stated)
    assert (alone.samples.tolist(), [doubt.check for doubt in alone.doubts]) == (SIGNAL[:-5], ["ends"])


def test_more_samples_missing_at_an_end_than_a_curve_would_bridge_are_refused(tmp_path: Path) -> None:
    path = _with_missing_ends(tmp_path, LONGEST_GAP + 1)
    for axis in "xy":
        with pytest.raises(RecordingError):
            read(path, channel=axis, stated=Stated(resample=True))
