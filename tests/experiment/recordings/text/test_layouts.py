"""Texts as other programs write them: read, or refused with a remedy after which they are read right.

Layouts after the programs' own exports: Audacity 3 (Sample Data Export), OpenSignals, LabVIEW (a graph's data),
Dewesoft X, phyphox, Keysight InfiniiVision, Saleae Logic 2, Delsys EMGworks, Vicon Nexus, Brüel & Kjær Pulse,
the Arduino IDE.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from palpate.experiment.errors import RecordingError, Remedy
from palpate.experiment.recordings.readers import read
from palpate.experiment.settings.delimited import Stated

ROWS = 400
SIGNAL = [round(1.5 * np.sin(k / 5) + 0.01, 5) for k in range(ROWS)]


def _rows(row: str, hz: float = 1000.0) -> str:
    return "".join(
        f"{row.format(k=k, n=k + 1, s=k / hz, ms=1e3 * k / hz, f=k // 10 + 1, sub=k % 10, w=k % 16, a=a, b=a / 2)}\n"
        for k, a in enumerate(SIGNAL)
    )


DELSYS = "X[s],EMG 1 [V],X[s],ACC.X 1 [g]\n" + "".join(
    f"{k / 2000:.7f},{a},{f'{k / 750:.7f},{a}' if k < 150 else ','}\n" for k, a in enumerate(SIGNAL)
)
AUDACITY = (
    "tap.wav   1 channel (mono)\nSample Rate: 44100 Hz. Sample values on linear scale.\nDC offset: 0.1 linear\n\n"
)
OPEN = (
    "# OpenSignals Text File Format. Version 1\n"
    '# {"00:07": {"sensor": ["ACC"], "column": ["nSeq", "DI", "CH1"], "sampling rate": 1000, "resolution": [16]}}\n'
    "# EndOfHeader\n"
)
BK = "Title: tap\nSample frequency:\t1600\nX-axis unit:\ts\nY-axis unit:\tm/s2\n\n"
VICON = "Devices\n1000\n,,FP1 - Force,\nFrame,Sub Frame,Fx,Fy\n,,N,N\n"

LAYOUTS = {
    "Audacity": (AUDACITY + _rows("{a}"), 44_100, "column 1", ("--rate", "44100")),
    "Audacity, with times": (_rows("{s:.5f}\t{a}", 2e4), 20_000, "column 2", ("--time-unit", "s")),
    "OpenSignals": (OPEN + _rows("{w}\t0\t{a}\t"), 1000, "column 3", ("--rate", "1000")),
    "LabVIEW": (
        "Time - Plot 0\tAmplitude - Plot 0\n" + _rows("{s:.6f}\t{a}"), 1000, "Amplitude - Plot 0", ("--time-unit", "s"),
    ),
    "Dewesoft": ("Sample rate: 5000 S/s\n\nTime\tACC/X\n s\t g\n" + _rows("{s:.6f}\t{a}", 5e3), 5000, "ACC/X", ()),
    "phyphox": ('"Time (s)","Acceleration x (m/s^2)"\n' + _rows("{s:.9E},{a:.9E}", 400), 400, "Acceleration x", ()),
    "Keysight": ("x-axis,1,2\nsecond,Volt,Volt\n" + _rows("{s:+.8E},{a:+.5E},{b:+.5E}", 1e5), 100_000, "1", ()),
    "Saleae": ("Time [s],Channel 0\n" + _rows("{s:.9f},{a}", 5e4), 50_000, "Channel 0", ()),
    "Delsys": (DELSYS, 2000, "EMG 1", ()),
    "Vicon": (VICON + _rows("{f},{sub},{a},{b:.6f}"), 1000, "Fx", ("--rate", "1000")),
    "Pulse": (BK + _rows("{n}\t{a:.6E}"), 1600, "column 2", ("--rate", "1600")),
    "Pulse, with times": (_rows("{n}\t{s:.6E}\t{a}", 1600), 1600, "column 3", ("--time-unit", "s")),
    "a counter called time": ("# fs = 1600 Hz\nTime,acc\n" + _rows("{k},{a}"), 1600, "acc", ("--rate", "1600")),
    "times by their rate": ("# fs = 16 Hz\nTime,acc\n" + _rows("{ms},{a}", 16), 16, "acc", ("--time-unit", "ms")),
    "a heading once more": (
        "t (ms),acc\n" + _rows("{ms},{a}").replace("\n200.0", "\nt (ms),acc\n200.0"), 1000, "acc", (),
    ),
    "Arduino": (_rows("14:05:10.{k:03d} -> {a}"), 1000, "column 2", ()),
    "minutes and seconds": ("Time,acc\n" + _rows("05:{s:07.4f},{a}"), 1000, "acc", ()),
    "units behind numbers": ("Zeit;acc\n" + _rows("{ms:.1f} ms;{a} g").replace(".", ","), 1000, "acc", ()),
}  # fmt: skip


@pytest.mark.parametrize(("text", "rate_hz", "channel", "remedy"), LAYOUTS.values(), ids=LAYOUTS)
def test_a_layout_is_read_right_if_need_be_by_its_remedy(
    tmp_path: Path, text: str, rate_hz: float, channel: str, remedy: tuple[str, ...]
) -> None:
    path = tmp_path / "export.txt"
    path.write_text(text, "utf-8")
    told: tuple[str, ...] = ()
    stated = Stated(command=("palpate",))
    try:
        made = read(path, stated=stated)
    except RecordingError as error:
        told = error.finding.remedy.command[1:] if isinstance(error.finding.remedy, Remedy) else ()
        given = dict(zip(told[::2], told[1::2], strict=True))
        rate = float(given["--rate"]) if "--rate" in given else None
        made = read(path, stated=Stated(rate_hz=rate, time_unit=given.get("--time-unit")))
    assert (told, made.channel) == (remedy, channel)
    assert made.rate_hz == pytest.approx(rate_hz, rel=2e-3)
    np.testing.assert_array_equal(made.samples, SIGNAL)


def test_units_behind_numbers_are_those_of_their_columns(tmp_path: Path) -> None:
    path = tmp_path / "export.txt"
    path.write_text("Zeit;acc\n" + _rows("{ms:.1f} ms;{a} g"), "utf-8")
    assert read(path).unit == "g"
    path.write_text("Zeit;acc\n" + _rows("{ms:.1f} ms;{a} g").replace("3.0 ms", "0.003 s"), "utf-8")
    with pytest.raises(RecordingError):
        read(path)


def test_a_run_behind_a_heading_once_more_is_not_joined(tmp_path: Path) -> None:
    path = tmp_path / "export.txt"
    path.write_text(2 * ("t (ms),acc\n" + _rows("{ms},{a}")), "utf-8")
    with pytest.raises(RecordingError) as refused:
        read(path)
    assert refused.value.finding.line == ROWS + 3
