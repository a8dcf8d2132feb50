"""Texts as other programs write them: read, or refused with a remedy after which they are read right.

Layouts after the programs' own exports: Audacity 3 (Sample Data Export), OpenSignals, LabVIEW (a graph's data),
Dewesoft X, phyphox, Keysight InfiniiVision, Saleae Logic 2, Delsys EMGworks and Discover, Vicon Nexus, Brüel & Kjær
Pulse, the Arduino IDE, Noraxon MR3, AcqKnowledge, LabChart, Qualisys QTM, catman, ConsensysPRO, ActiLife, E4,
GENEActiv, Rohde & Schwarz, Tektronix TDS.
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

DISCOVER = (
    "Application:,Trigno Discover 1.6\nAvanti sensor 1 (81728),,,\n"
    "EMG 1 Time Series (s),EMG 1 (mV),ACC X Time Series (s),ACC X (G)\n2000 Hz,,150 Hz,\n" + DELSYS.partition("\n")[2]
)
NORAXON = '"Name","rec 1"\n\n"Time,s","Activity","Marker","TIB.ANT.,uV"\n'
BIOPAC = "tap.acq\n0.5 msec/sample\n1 channels\nAcceleration\ng\n{heads}\n{counts}\n"
LABCHART = "Interval=\t0.001 s\nChannelTitle=\tAcc\nRange=\t10 V\nUnitName=\tg\nBottomValue=\t-10.0\n"
QUALISYS = "NO_OF_SAMPLES\t400\nTOT_NO_OF_CHAN\t2\nFREQUENCY\t1500\nDATA_INCLUDED\tANALOG\nCHANNEL_NAMES\tacc\tforce\n"
SHIMMER = '"sep=\t"\nS_1A\tS_1A\t\nTimestamp\tAccel_X\t\nCAL\tCAL\t\nms\tm/(s^2)\t\n'
BESIDE = ("Record Length,400,Points,", "Sample Interval,4e-06,s,", "Source,CH1,,", ",,,", "Vertical Units,V,,")
UNITS = ("Sample Interval,4e-06,,", "Horizontal Units,s,,", "Source,CH1,,")
RIGOL = "X,CH1,Start,Increment,\nSequence,Volt,-2.0e-01,1.0e-03,\n"

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
    "Discover": (DISCOVER, 2000, "EMG 1", ()),
    "Noraxon": (
        NORAXON + _rows("{s:.6f},Rest,,{a}", 1500).replace("2000,Rest,,", "2000,Rest,Start,"), 1500,
        "TIB.ANT.,uV", (),
    ),
    "AcqKnowledge": (
        BIOPAC.format(heads="msec\tCH1\t", counts="\t400\t") + _rows("{ms}\t{a}\t", 2000), 2000, "CH1", (),
    ),
    "AcqKnowledge, without times": (
        BIOPAC.format(heads="CH1\tCH2\t", counts="400\t400\t") + _rows("{a}\t{b}\t"), 2000, "CH1", ("--rate", "2000"),
    ),
    "LabChart": (LABCHART + _rows("{s:g}\t{a}"), 1000, "Acc", ("--time-unit", "s")),
    "Qualisys": (QUALISYS + _rows("{a}\t{b}"), 1500, "acc", ("--rate", "1500")),
    "catman": (
        "Datum: 29.11.2026\n\nZeit\tMX840_CH1\nAbtastrate: 1200 Hz\t\ns\tg\n" + _rows("{s:.7f}\t{a}", 1200), 1200,
        "MX840_CH1", (),
    ),
    "Consensys": (SHIMMER + _rows("{ms:.3f}\t{a}\t", 500), 500, "Accel_X", ()),
    "ActiLife": (
        "--- Data File Created By ActiGraph at 100 Hz ---\nMode = 12\nX,Y\n" + _rows("{a},{b}"), 100,
        "X", ("--rate", "100"),
    ),
    "E4": (
        "1764410400.00,1764410400.00\n32.000000,32.000000\n" + _rows("{a},{b}"), 32, "column 1", ("--rate", "32"),
    ),
    "GENEActiv": (_rows("2026-11-29 10:00:00:{k:03d},{a},{b}"), 1000, "column 2", ()),
    "Rohde & Schwarz": ("in s,C1 in V\n" + _rows("{s:.9E},{a:.9E}", 1e5), 100_000, "C1", ()),
    "Tektronix, a header beside the rows": (
        "".join(f"{BESIDE[k] if k < 5 else ',,,'}{k * 4e-6:.8f},{a}\n" for k, a in enumerate(SIGNAL)), 250_000,
        "CH1", (),
    ),
    "Tektronix, names beside its header": (
        "Record Length,400,,t,v\n" + "".join(
            f"{BESIDE[k].replace(',s', ',') if 0 < k < 5 else ',,,'}{k * 4e-6:.8f},{a}\n"
            for k, a in enumerate(SIGNAL)
        ), 250_000, "v", ("--time-unit", "s"),
    ),
    "Tektronix, units of both": (
        "".join(f"{UNITS[k] if k < 3 else ',,,'}{k * 4e-6:.8f},{a},\n" for k, a in enumerate(SIGNAL)), 250_000,
        "CH1", (),
    ),
    "Rigol": (RIGOL + _rows("{k},{a},"), 1000, "CH1", ()),
    "Rigol, two channels": (RIGOL.replace(",CH1", ",CH1,CH2").replace(",Volt", ",Volt,Volt") + _rows("{k},{a},{b},,"),
                            1000, "CH1", ()),
    "an arrow behind each time": (_rows("10:15:20.{k:03d} -> {a}"), 1000, "column 2", ()),
    "times that only the rate tells": ("hh,mm,ss,acc\n" + _rows("10,0,{s:.3f},{a}", 500), 500, "acc", ("--rate", "HZ")),
    "words between numbers": ("t_ms,phase,acc\n" + _rows("{ms},rest,{a}"), 1000, "acc", ()),
    "names before numbers": ("Ready\n" + _rows("millis:{ms:.1f},x:{a},y:{b}"), 1000, "x", ()),
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
        given = {option: word.replace("HZ", f"{rate_hz:g}") for option, word in given.items()}
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


@pytest.mark.parametrize(("text", "delimiter"), [(_rows("10:15:20.{k:03d} -> {a}"), ""), (_rows("t_ms:{k} x:{a}"), "")])
def test_what_stands_between_cells_is_told_as_it_is_in_the_file(tmp_path: Path, text: str, delimiter: str) -> None:
    path = tmp_path / "log.txt"
    path.write_text(text)
    assert (read_as := read(path).read_as) is not None
    assert read_as.delimiter == delimiter


def test_a_column_that_nothing_names_is_chosen_by_its_own_number(tmp_path: Path) -> None:
    path = tmp_path / "log.txt"
    path.write_text(_rows("{s:.3f},{a},{b}"))
    stated = Stated(time_unit="s")
    assert [read(path, channel=one, stated=stated).samples[1] for one in ("2", "column 3", "3")] == [
        SIGNAL[1], SIGNAL[1] / 2, SIGNAL[1] / 2
    ]  # fmt: skip


ADC = [512 + int(300 * a / 1.51) for a in SIGNAL]


def _adc(row: str) -> str:
    return "".join(f"{row.format(k=k, v=v)}\n" for k, v in enumerate(ADC))


BOARDS = {
    "zero bytes before the heading": "\0\0\0millis,adc\n" + _adc("{k},{v}"),
    "zero bytes in a line of their own": "\0\0\nmillis,adc\n" + _adc("{k},{v}"),
    "zero bytes behind the last row": "millis,adc\n" + _adc("{k},{v}") + "\0" * 512,
    "hexadecimals": "millis,adc\n" + _adc("{k},0x{v:X}"),
    "hexadecimals with zeros": "millis,adc\n" + _adc("{k},0x{v:03x}"),
    "a counter of microseconds that runs over": "micros,adc\n" + "".join(
        f"{(2**32 - 100_500 + 1000 * k) % 2**32},{v}\n" for k, v in enumerate(ADC)),
    "a counter of milliseconds that runs over": "millis,adc\n" + "".join(
        f"{(2**32 - 100 + k) % 2**32},{v}\n" for k, v in enumerate(ADC)),
}  # fmt: skip


@pytest.mark.parametrize("name", BOARDS)
def test_what_a_board_writes_is_read_right(tmp_path: Path, name: str) -> None:
    path = tmp_path / "log.csv"
    path.write_text(BOARDS[name], newline="")
    made = read(path)
    assert (made.samples.tolist(), made.channel, round(made.rate_hz, 3)) == (ADC, "adc", 1000.0)
    assert [doubt.check for doubt in made.doubts] == (["counter"] if "runs over" in name else [])


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("millis,adc\n" + _adc("{k},{v:X}"), 3),
        ("millis,adc\n" + "".join(f"{k},0x{v - 512 & 0xFFFF:04X}\n" for k, v in enumerate(ADC)), 2),
        ("millis,adc\n" + _adc("{k},{v}").replace("\n9,", "\n9\0,"), 11),
        ("micros,adc\n" + "".join(f"{(2**32 - 9000 + 1000 * k + 5000 * (k > 8)) % 2**32},1\n" for k in range(99)), 11),
        ("Zeit (s);a (g)\n" + _rows("{s:.3f};{a}").replace(".", ",") + "Mittelwert;0,5\nMax;1,5\n", 402),
        ("time (s),a (g)\n" + _rows("{s:.3f},{a}") + "\n\nMean,0.5\n", 404),
        (",time (s),a (g)\n" + _rows(",{s:.3f},{a}") + "Mean,0.5,0.5\n", 402),
        ("time (s),a (g),\n" + _rows("{s:.3f},{a},") + "0.5,0.5,SD\n", 402),
    ],
    ids=["hexadecimals alone", "signed", "a zero byte in a cell", "a gap where a counter runs over", "German",
         "English", "labels before", "labels behind"],
)  # fmt: skip
def test_what_cannot_be_read_for_certain_is_refused_by_its_line(tmp_path: Path, text: str, line: int) -> None:
    path = tmp_path / "log.csv"
    path.write_text(text, newline="")
    with pytest.raises(RecordingError) as refused:
        read(path)
    assert refused.value.finding.line == line
