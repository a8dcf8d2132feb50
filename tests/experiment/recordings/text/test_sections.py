"""Texts of several tables: the one asked for is read, and none is chosen in silence.

Layouts after Vicon Nexus (Devices, Trajectories), LabChart (blocks) and Spike2 (channels below one another).
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from palpate.experiment.errors import RecordingError, Remedy
from palpate.experiment.recordings.readers import Recording, read
from palpate.experiment.recordings.text.sections import sections
from palpate.experiment.settings.delimited import Stated

FORCE = [round(1.5 * np.sin(k / 5) + 0.01, 5) for k in range(600)]
TOE = [round(40 * np.cos(k / 9) - 3, 4) for k in range(60)]


def _devices(rows: int) -> str:
    body = "".join(f"{k // 10 + 1},{k % 10},{a},{a / 2:.6f}\n" for k, a in enumerate(FORCE[:rows]))
    return f"Devices\n1000\n,,FP1 - Force,\nFrame,Sub Frame,Fx,Fy\n,,N,N\n{body}"


def _trajectories(width: int) -> str:
    heads = ",".join("XYZ"[:width]), ",".join(["mm"] * width)
    body = "".join(f"{k + 1},0,{','.join([str(a)] * width)}\n" for k, a in enumerate(TOE))
    return f"Trajectories\n100\n,,toe{',' * (width - 1)}\nFrame,Sub Frame,{heads[0]}\n,,{heads[1]}\n{body}"


def _read(path: Path, text: str, **stated: str | float) -> Recording:
    path.write_text(text, "utf-8")
    return read(path, stated=Stated(command=("palpate",), **stated))  # type: ignore[arg-type]


@pytest.mark.parametrize("rows", [20, 600], ids=["short first", "long first"])
@pytest.mark.parametrize("width", [2, 3], ids=["as wide", "wider"])
@pytest.mark.parametrize("gap", ["", "\n"], ids=["at once", "behind an empty line"])
def test_the_section_that_is_asked_for_is_read(tmp_path: Path, rows: int, width: int, gap: str) -> None:
    text, path = f"{_devices(rows)}{gap}{_trajectories(width)}", tmp_path / "walk.csv"
    with pytest.raises(RecordingError) as refused:
        _read(path, text)
    assert isinstance(refused.value.finding.remedy, Remedy)
    assert refused.value.finding.remedy.command == ("palpate", "--section", "Devices")
    for name, number, hz, unit, samples in (
        ("Devices", "1", 1000.0, "N", FORCE[:rows]),
        ("Trajectories", "2", 100.0, "mm", TOE),
    ):
        for asked in (name, number):
            with pytest.raises(RecordingError) as unrated:
                _read(path, text, section=asked)
            assert isinstance(unrated.value.finding.remedy, Remedy)
            assert unrated.value.finding.remedy.command == ("palpate", "--rate", f"{hz:g}")
            made = _read(path, text, section=asked, rate_hz=hz)
            assert made.read_as is not None
            assert (made.read_as.section, made.unit) == (name, unit)
            np.testing.assert_array_equal(made.samples, samples)


def test_an_error_names_the_line_of_the_whole_file(tmp_path: Path) -> None:
    text = f"{_devices(20)}\n{_trajectories(2).replace('7,0,', '7,0,x', 1)}"
    with pytest.raises(RecordingError) as refused:
        _read(tmp_path / "walk.csv", text, section="Trajectories", rate_hz=100.0)
    assert refused.value.finding.line == text[: text.index("7,0,x")].count("\n") + 1


def test_a_section_that_is_not_there_is_refused(tmp_path: Path) -> None:
    for text in (f"{_devices(20)}\n{_trajectories(2)}", _devices(20)):
        for asked in ("Joints", "0", "3"):
            with pytest.raises(RecordingError) as refused:
                _read(tmp_path / "walk.csv", text, section=asked)
            assert refused.value.finding.remedy.command[-1] == "Devices"  # type: ignore[union-attr]


def test_blocks_of_one_name_are_chosen_by_their_number(tmp_path: Path) -> None:
    head = "Interval=\t0.001 s\nChannelTitle=\tAcc\nUnitName=\tg\n"
    blocks = [head + "".join(f"{k / 1000:g}\t{sign * a}\n" for k, a in enumerate(FORCE)) for sign in (1, -1)]
    with pytest.raises(RecordingError) as refused:
        _read(tmp_path / "chart.txt", "".join(blocks))
    assert isinstance(refused.value.finding.remedy, Remedy)
    assert refused.value.finding.remedy.command == ("palpate", "--section", "1")
    made = _read(tmp_path / "chart.txt", "".join(blocks), section="2", time_unit="s")
    np.testing.assert_array_equal(made.samples, [-a for a in FORCE])


@pytest.mark.parametrize(
    "between",
    ["# the tap\n", "lost contact\n", "t (ms),acc\n", "\n", "12,ERR\n"],
    ids=["comment", "remark", "heading once more", "empty line", "broken row"],
)
def test_what_stands_between_rows_is_no_head(between: str) -> None:
    rows = "".join(f"{k},{a}\n" for k, a in enumerate(FORCE[:20]))
    text = f"t (ms),acc\n{rows}{between}{rows}"
    assert len(sections(text, ",")) == 1
