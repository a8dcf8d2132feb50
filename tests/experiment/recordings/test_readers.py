"""Readers of WAV, text columns and LabVIEW files: what was written comes back, and nothing else ever gets through."""

from __future__ import annotations

import struct
import time
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy.io import wavfile
from syrupy.assertion import SnapshotAssertion

from palpate.experiment.errors import RecordingError, Remedy
from palpate.experiment.recordings.readers import read
from palpate.experiment.settings.delimited import LARGEST, NOTHING_STATED, Stated
from tests.approved import Refuses

ON_DISK = settings(suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)
IN_SECONDS = Stated(time_unit="s")
SAMPLES = st.lists(st.floats(-1e6, 1e6), min_size=2, max_size=30)


def check_outcome(path: Path) -> None:
    """A recording that can be used, or one line that says what to do."""
    try:
        made = read(path)
    except RecordingError as error:
        message = str(error)
    else:
        message = "allowed"
        assert np.all(np.isfinite(made.samples))
        assert 0 < made.rate_hz < np.inf
    assert "allowed" in message
    assert "\n" not in message


def written(tmp_path: Path, text: str, name: str = "recording.txt") -> Path:
    path = tmp_path / name
    path.write_text(text, encoding="utf-8", newline="")
    return path


def lvm(
    rows: list[str],
    *,
    headings: str = "X_Value\tAcceleration\tComment",
    decimal: str = ".",
    delta_x: str = "1.000000",
    multi_headings: str = "No",
    x_columns: str = "One",
) -> str:
    """A file laid out as the manufacturer's writer lays it out, with tabs."""
    header = [
        "LabVIEW Measurement\t",
        "Writer_Version\t2",
        "Reader_Version\t2",
        "Separator\tTab",
        f"Decimal_Separator\t{decimal}",
        f"Multi_Headings\t{multi_headings}",
        f"X_Columns\t{x_columns}",
        "Time_Pref\tAbsolute",
        "***End_of_Header***\t",
        "\t",
    ]
    return "\r\n".join(header + segment(rows, headings=headings, delta_x=delta_x)) + "\r\n"


def segment(rows: list[str], *, headings: str, delta_x: str) -> list[str]:
    columns = headings.count("\t") - (1 if headings.endswith("Comment") else 0)
    return [
        f"Channels\t{columns}" + "\t" * columns,
        "Notes\tX values guaranteed valid only for the first channel\t",
        "Samples" + f"\t{len(rows)}" * columns,
        "Y_Unit_Label" + "\tg" * columns,
        "X_Dimension" + "\tTime" * columns,
        "X0" + "\t0.0000000000000000E+0" * columns,
        "Delta_X" + f"\t{delta_x}" * columns,
        "***End_of_Header***" + "\t" * columns,
        headings,
        *rows,
    ]


# --- WAV


@pytest.mark.parametrize(
    ("stored", "expected", "unit"),
    [
        (np.array([0.5, -1.25], np.float32), [0.5, -1.25], ""),
        (np.array([0.5, -1.25], np.float64), [0.5, -1.25], ""),
        (np.array([-32768, 16384], np.int16), [-1.0, 0.5], "full scale"),
        (np.array([-(2**31), 2**30], np.int32), [-1.0, 0.5], "full scale"),
        (np.array([0, 192], np.uint8), [-1.0, 0.5], "full scale"),
    ],
)
def test_wav_of_every_common_type(tmp_path: Path, stored: np.ndarray, expected: list[float], unit: str) -> None:
    path = tmp_path / "named_like_nothing"
    wavfile.write(path, 5000, stored)
    made = read(path)
    assert made.samples.tolist() == expected
    assert (made.rate_hz, made.rate_source, made.unit) == (5000.0, "WAV header", unit)


def test_wav_channels_by_name_and_number(tmp_path: Path, refuses: Refuses) -> None:
    path = tmp_path / "two.wav"
    wavfile.write(path, 8000, np.array([[1, 2], [3, 4]], np.float32))
    assert read(path).samples.tolist() == [1, 3]
    assert read(path, channel="channel 2").samples.tolist() == [2, 4]
    assert read(path, channel="2").channel == "channel 2"
    with refuses(RecordingError):
        read(path, channel="3")


def test_a_stated_rate_counts_more_than_that_of_a_wav(tmp_path: Path) -> None:
    path = tmp_path / "slow.wav"
    wavfile.write(path, 8000, np.array([1, 2], np.float32))
    made = read(path, stated=Stated(rate_hz=100_000.0))
    assert (made.rate_hz, made.header_rate_hz) == (100_000.0, 8000)


def test_a_truncated_wav_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "cut.wav"
    wavfile.write(path, 5000, np.zeros(100, np.float32))
    whole = path.read_bytes()
    path.write_bytes(whole[:-40])
    with pytest.raises(RecordingError, match=f"{len(whole) - 40} of the {len(whole)} bytes"):
        read(path)


@pytest.mark.parametrize("size", [b"\0\0\0\0", b"\xff\xff\xff\xff"])
def test_a_wav_whose_recorder_wrote_no_length_is_read_as_far_as_it_goes(tmp_path: Path, size: bytes) -> None:
    """The header that scipy writes has 44 bytes; the sizes of the file and of its samples begin at 4 and at 40."""
    path = tmp_path / "unfinished.wav"
    wavfile.write(path, 5000, np.arange(100, dtype=np.int16))
    whole = path.read_bytes()
    path.write_bytes(whole[:4] + size + whole[8:40] + size + whole[44:-1])
    made = read(path)
    assert (made.samples * 2**15).tolist() == list(range(99))
    assert [(doubt.check, doubt.verdict) for doubt in made.doubts] == [("unfinished", "warns")]


def test_a_wav_with_nan_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "nan.wav"
    wavfile.write(path, 5000, np.array([0, np.nan], np.float32))
    with pytest.raises(RecordingError, match="sample 1: got nan"):
        read(path)


@ON_DISK
@given(damage=st.lists(st.tuples(st.integers(0, 99), st.integers(0, 255)), min_size=1, max_size=6))
def test_a_damaged_wav_gives_samples_or_one_error(tmp_path: Path, damage: list[tuple[int, int]]) -> None:
    path = tmp_path / "damaged.wav"
    wavfile.write(path, 5000, np.arange(24, dtype=np.int16))
    content = bytearray(path.read_bytes())
    for place, value in damage:
        content[place % len(content)] = value
    path.write_bytes(b"RIFF" + bytes(content[4:]))
    check_outcome(path)


# --- text columns


@ON_DISK
@given(
    samples=SAMPLES,
    rate_hz=st.sampled_from([100.0, 5000.0, 44_100.0, 50_000.0]),
    dialect=st.sampled_from([("\t", "."), (";", "."), (",", "."), ("  ", "."), ("\t", ","), (";", ","), (" ", ",")]),
    heading=st.sampled_from(["", "# time (s)\tacceleration (m/s^2)\n", "time [s], acceleration [m/s^2]\n"]),
)
def test_written_columns_come_back(
    tmp_path: Path, samples: list[float], rate_hz: float, dialect: tuple[str, str], heading: str
) -> None:
    separator, decimal = dialect
    rows = (f"{i / rate_hz!r}{separator}{value!r}".replace(".", decimal) for i, value in enumerate(samples))
    made = read(written(tmp_path, heading + "\n".join(rows)), stated=NOTHING_STATED if heading else IN_SECONDS)
    assert made.samples.tolist() == samples
    assert made.rate_hz == pytest.approx(rate_hz, rel=1e-9)
    assert made.jitter < 1e-6
    if heading:
        assert (made.channel, made.unit) == ("acceleration", "m/s^2")


@ON_DISK
@given(text=st.text(st.sampled_from("0123456789.,;\t -+eE#\nats()m_XV*"), max_size=200))
def test_any_text_gives_a_recording_or_one_error(tmp_path: Path, text: str) -> None:
    check_outcome(written(tmp_path, text))


@ON_DISK
@given(content=st.binary(max_size=300))
def test_any_bytes_give_a_recording_or_one_error(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "bytes"
    path.write_bytes(content)
    check_outcome(path)


@pytest.mark.parametrize(
    ("heading", "rate_hz"),
    [
        ("time (ms), a (g)", 1000.0),
        ("time_ms, a", 1000.0),
        ("t/s, a", 1.0),
        ("Time [us], a", 1e6),
        ("Elapsed Time (s), a", 1.0),
    ],
)
def test_the_unit_of_time_is_read_from_the_heading(tmp_path: Path, heading: str, rate_hz: float) -> None:
    made = read(written(tmp_path, f"{heading}\n0,5\n1,6\n2,7\n"))
    assert made.rate_hz == pytest.approx(rate_hz)


def test_the_time_column_may_stand_anywhere(tmp_path: Path) -> None:
    made = read(written(tmp_path, "ax (g), time (s), ay (g)\n5,0,7\n6,0.5,8\n7,1.0,9\n"), channel="ay")
    assert (made.samples.tolist(), made.rate_hz, made.channels) == ([7, 8, 9], 2.0, ("ax", "ay"))


def test_rounded_times_are_tolerated_and_the_jitter_is_reported(tmp_path: Path) -> None:
    """3 kHz in microseconds: steps of 333 and 334; the mean step gives the rate, the median one would be 0.1 % off."""
    rows = "\n".join(f"{i / 3000:.6f} {i % 7}" for i in range(3001))
    made = read(written(tmp_path, rows), stated=IN_SECONDS)
    assert made.rate_hz == pytest.approx(3000, rel=1e-6)
    assert 0 < made.jitter < 0.01


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("0 1\n0.1 2\n0.3 3\n0.4 3\n0.5 3\n", "line 3: got a time step of 0.2 s; allowed: within 50% of the median"),
        ("t v\n0 1\n0.1 2\n0.1 3\n0.2 4\n0.3 5\n", "line 4: got a time step of 0 s"),
        ("0.1 1\n0 2\n", "line 1: got values that do not increase"),
        ("0 1\n1 2\n2 2\n", "got a counter of samples"),
        ("frequency (Hz), gain\n10, 1\n20, 2\n", "got 'frequency' in the first column, and no column named time"),
        ("position, force\n10, 1\n20, 2\n", "got 'position' in the first column"),
        ("t (s);a\n0;1,0\n0,1;1.5\n0,2;1,1\n0,3;1,2\n", "line 3: got '1.5' in column 'a'; allowed"),
        ("t;a\ns;V\n0;1,0\n0,1;1.5\n0,2;1,1\n0,3;1,2\n", "line 4: got '1.5' in column 'a'; allowed"),
        ("0 1\n0.1 two\n", "line 2: got 'two' in column '2'; allowed: a number in every row"),
        ("0 1\n0.1 nan\n", "line 2: 1 of 2 samples"),
        ("0 1\n0.1 1e999\n", "line 2: got '1e999'"),
        ("0 1\n0.1\n", "line 2: got 1 numbers; allowed: 2, as in line 1"),
        ("t;a;b\n0;1;2\n1;2;3\n2;;4\n", "line 4: got 2 numbers; allowed: 3, as in line 2"),
        ("0.5 1\n", "got 1 rows; allowed: two or more"),
        ("a text about nothing\n", "got no line with two or more numbers"),
        ("", "got no line with two or more numbers"),
    ],
)
def test_columns_that_are_no_recording_are_refused(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(RecordingError, match=message):
        read(written(tmp_path, text), stated=IN_SECONDS)


@pytest.mark.parametrize(
    ("text", "rate_hz"),
    [
        ("Sample Rate: 44100 Hz. Sample values on dB scale. 1 channel (mono).\n\n-6.5\n-7.2\n-80.1\n", 44100.0),
        ("t (s);level (dB)\n0;-6.5\n0.1;-7.2\n0.2;-80.1\n", None),
        ("t (s);level (dBFS)\n0;-6.5\n0.1;-7.2\n0.2;-80.1\n", None),
    ],
)
def test_levels_in_db_are_never_taken_for_samples(tmp_path: Path, text: str, rate_hz: float | None) -> None:
    path = written(tmp_path, text)
    with pytest.raises(RecordingError, match="levels in dB"):
        read(path, stated=Stated(rate_hz=rate_hz))
    path = written(tmp_path, text.replace("dB scale", "linear scale").replace("(dB", "(g"))
    assert read(path, stated=Stated(rate_hz=rate_hz)).samples.tolist() == [-6.5, -7.2, -80.1]


@pytest.mark.parametrize("heading", ["t, a", "time (fortnights), a", "timestamp, a"])
def test_times_in_no_known_unit_are_asked_for(tmp_path: Path, heading: str) -> None:
    """The remedy is the command with the likely unit, and works."""
    path = written(tmp_path, f"{heading}\n0,1\n5,2\n10,1\n")
    with pytest.raises(RecordingError) as refused:
        read(path, stated=Stated(command=("palpate", "spectrum", str(path))))
    remedy = refused.value.finding.remedy
    assert isinstance(remedy, Remedy)
    assert remedy.command == ("palpate", "spectrum", str(path), "--time-unit", "ms")
    assert read(path, stated=Stated(time_unit="ms")).rate_hz == pytest.approx(200)


def test_an_implausible_rate_is_doubted_and_the_likely_unit_named(tmp_path: Path) -> None:
    doubts = read(written(tmp_path, "time (s), a\n0,1\n5,2\n10,1\n")).doubts
    assert [(doubt.check, doubt.verdict) for doubt in doubts] == [("rate", "warns")]
    assert "--time-unit ms" in str(doubts[0].remedy)


def test_a_name_that_two_channels_have_is_asked_about(tmp_path: Path) -> None:
    path = written(tmp_path, "time (s), a, a\n0.1,1,4\n0.2,2,5\n0.3,1,4\n")
    made = read(path, channel="2")
    assert (made.samples.tolist(), made.read_as.repeated if made.read_as else ()) == ([4, 5, 4], ("a",))
    with pytest.raises(RecordingError):
        read(path, channel="a")


def test_channels_have_the_clock_to_their_left_where_clocks_differ(tmp_path: Path) -> None:
    text = "t1 (s),a,t2 (ms),b\n0.00,1,0,4\n0.01,2,1,5\n0.02,1,2,4\n"
    assert read(written(tmp_path, text)).rate_hz == pytest.approx(100)
    assert read(written(tmp_path, text), channel="b").rate_hz == pytest.approx(1000)


def test_clocks_that_differ_side_by_side_are_asked_about(tmp_path: Path) -> None:
    path = written(tmp_path, "t1 (s),t2 (s),b\n0.00,0.0,4\n0.01,0.1,5\n0.02,0.2,4\n")
    with pytest.raises(RecordingError) as refused:
        read(path)
    assert "--time-column t1" in str(refused.value.finding.remedy)
    assert read(path, stated=Stated(time_column="t2")).rate_hz == pytest.approx(10)


def test_a_rate_that_drifts_is_refused(tmp_path: Path, refuses: Refuses) -> None:
    """Each step is near the median, but the samples wander off the grid."""
    times = np.cumsum(np.linspace(0.8, 1.2, 101))
    rows = "\n".join(f"{t:.6f} 1" for t in times)
    with refuses(RecordingError):
        read(written(tmp_path, rows), stated=IN_SECONDS)


@pytest.mark.parametrize("name", ["nothing_here.txt", "."])
def test_a_file_that_cannot_be_read_is_refused(tmp_path: Path, name: str) -> None:
    with pytest.raises(RecordingError, match="cannot be read"):
        read(tmp_path / name)


# --- LabVIEW


@ON_DISK
@given(samples=SAMPLES, decimal=st.sampled_from([".", ","]))
def test_lvm_comes_back_at_the_rate_of_its_time_column(tmp_path: Path, samples: list[float], decimal: str) -> None:
    """The header claims 1 Hz."""
    rows = [f"{i / 5000!r}\t{value!r}".replace(".", decimal) for i, value in enumerate(samples)]
    made = read(written(tmp_path, lvm(rows, decimal=decimal, delta_x=f"1{decimal}000000"), "x.lvm"))
    assert made.samples.tolist() == samples
    assert made.rate_hz == pytest.approx(5000, rel=1e-9)
    assert (made.header_rate_hz, made.channel, made.unit) == (1.0, "Acceleration", "g")
    assert made.rate_source == "time column 'X_Value'"


def test_lvm_with_commas_between_cells(tmp_path: Path) -> None:
    text = lvm(["0.0\t1.5", "0.5\t2.5"]).replace("Separator\tTab", "Separator\tComma", 1).replace("\t", ",")
    assert read(written(tmp_path, text)).samples.tolist() == [1.5, 2.5]


def test_lvm_with_an_x_column_for_each_channel(tmp_path: Path) -> None:
    headings = "X_Value\tVoltage\tX_Value\tAcceleration\tComment"
    rows = ["0.0\t1\t0.0\t5", "0.1\t2\t0.01\t6", "0.2\t3\t0.02\t7"]
    text = lvm(rows, headings=headings, multi_headings="Yes", x_columns="Multi")
    assert read(written(tmp_path, text), channel="Acceleration").rate_hz == pytest.approx(100)
    assert read(written(tmp_path, text), channel="1").rate_hz == pytest.approx(10)


def test_lvm_without_x_column_says_that_only_the_header_knows(tmp_path: Path, approved: SnapshotAssertion) -> None:
    text = lvm(["\t1\t4", "\t2\t3"], headings="X_Value\ta\tb\tComment", delta_x="0.001", x_columns="No")
    made = read(written(tmp_path, text), channel="b")
    assert made.samples.tolist() == [4, 3]
    assert made.rate_hz == pytest.approx(1000)
    assert made.rate_source == approved


@pytest.mark.parametrize("name", ["Time (s)", "Untitled"])
def test_lvm_without_x_column_may_hold_its_times_as_a_channel(tmp_path: Path, name: str) -> None:
    rows = [f"\t{i / 2000:.6f}\t{i}" for i in range(9)]
    text = lvm(rows, headings=f"X_Value\t{name}\ta\tComment", x_columns="No").replace("Y_Unit_Label\tg\tg\r\n", "")
    made = read(written(tmp_path, text))
    assert (made.channel, made.header_rate_hz) == ("a", 1.0)
    assert made.rate_hz == pytest.approx(2000)


@pytest.mark.parametrize(
    ("name", "step", "rate_hz", "channels", "doubts"),
    [
        ("Time (s)", 0.005, 200.0, ("a",), ["header"]),
        ("Untitled", 0.005, 2000.0, ("Untitled", "a"), []),
        ("Untitled", 0.5, 2000.0, ("a",), []),
    ],
)
def test_lvm_times_that_contradict_the_step_are_doubted_and_those_without_a_name_are_none(
    tmp_path: Path, name: str, step: float, rate_hz: float, channels: tuple[str, ...], doubts: list[str]
) -> None:
    rows = [f"\t{i * step + 0.5:.6f}\t{(-1) ** i}" for i in range(9)]
    text = lvm(rows, headings=f"X_Value\t{name}\ta\tComment", delta_x="0.0005", x_columns="No")
    made = read(written(tmp_path, text.replace("Y_Unit_Label\tg\tg\r\n", "")), channel="a")
    assert (round(made.rate_hz, 6), made.channels) == (rate_hz, channels)
    assert [doubt.check for doubt in made.doubts] == doubts


def test_a_rising_signal_with_a_unit_of_its_own_is_not_taken_for_times(tmp_path: Path) -> None:
    rows = [f"\t{i / 2000:.6f}\t{i}" for i in range(9)]
    made = read(written(tmp_path, lvm(rows, headings="X_Value\tUntitled\ta\tComment", x_columns="No")))
    assert (made.channel, made.unit, made.rate_hz) == ("Untitled", "g", 1.0)


def test_lvm_cells_may_be_empty_at_the_end_and_comments_stand_beside(tmp_path: Path) -> None:
    rows = ["0.0\t1\t4\tstarted", "0.1\t2\t5\t", "0.2\t3\t\t"]
    path = written(tmp_path, lvm(rows, headings="X_Value\ta\tb\tComment"))
    assert read(path, channel="a").samples.tolist() == [1, 2, 3]
    assert read(path, channel="b").samples.tolist() == [4, 5]


def test_lvm_channels_without_samples_are_left_out(tmp_path: Path) -> None:
    path = written(tmp_path, lvm(["0.0\t\t4", "0.1\t\t5"], headings="X_Value\tempty\tb\tComment"))
    assert read(path).channels == ("b",)


def test_lvm_blocks_of_another_kind_are_passed_over(tmp_path: Path) -> None:
    special = "***Start_Special***\r\nBinary_Data\r\n1\t2\r\n***End_Special***\r\n"
    text = lvm(["0.0\t1", "0.5\t2"]).replace("Channels", special + "Channels", 1)
    assert read(written(tmp_path, text)).samples.tolist() == [1, 2]


def test_lvm_segments_are_counted_and_the_first_is_read(tmp_path: Path) -> None:
    headings = "X_Value\tAcceleration\tComment"
    text = lvm(["0.0\t1", "0.5\t2"], multi_headings="Yes")
    text += "\r\n".join(["", *segment(["0.0\t8", "0.5\t9"], headings=headings, delta_x="1"), ""])
    made = read(written(tmp_path, text))
    assert (made.samples.tolist(), made.segments) == ([1, 2], 2)


def test_lvm_of_version_1_has_no_decimal_separator(tmp_path: Path) -> None:
    text = lvm(["0.0\t1.5", "0.5\t2.5"]).replace("Decimal_Separator\t.\r\n", "")
    assert read(written(tmp_path, text)).samples.tolist() == [1.5, 2.5]


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("0.5\t2", "0.5\tNaN", "line 21: got 'NaN' in column 'Acceleration'"),
        ("0.5\t2", "NaN\t2", "line 21: got 'NaN' in column 'X_Value'"),
        ("0.5\t2", "0.5\t\r\n0.6\t3", "line 22: got column 'Acceleration' empty in line 21"),
        ("0.5\t2", "\t2", "line 21: got a sample without a time"),
        ("0.5\t2", "broken\t2\r\n0.5\t3", "line 22: got numbers in a header; .*; line 21 began this header"),
        ("0.5\t2", "broken\t2", "line 21: got a segment header without rows"),
        ("X_Value\t", "0.1\t", "line 19: got numbers in a header"),
        ("Separator\tTab", "Separator\tSpace", "got Separator 'Space'"),
        ("Decimal_Separator\t.", "Decimal_Separator\t!", "with Decimal_Separator '!'"),
        ("***End_of_Header***", "***Start***", "without its last line"),
        ("0.0\t1\r\n0.5\t2\r\n", "", "got a LabVIEW header without samples"),
        ("X_Dimension\tTime", "X_Dimension\tFrequency", "has Frequency as its x axis"),
    ],
)
def test_lvm_that_is_broken_is_refused(tmp_path: Path, old: str, new: str, message: str) -> None:
    text = lvm(["0.0\t1", "0.5\t2"])
    assert old in text
    with pytest.raises(RecordingError, match=message):
        read(written(tmp_path, text.replace(old, new)))


def test_lvm_without_any_rate_is_refused(tmp_path: Path, refuses: Refuses) -> None:
    text = lvm(["\t1", "\t2"], delta_x="0.000000", x_columns="No")
    with refuses(RecordingError):
        read(written(tmp_path, text))


@ON_DISK
@given(noise=st.text(st.sampled_from("0123456789.,\t-eN\r\nX_Valuedrt*"), max_size=120))
def test_any_body_of_an_lvm_gives_a_recording_or_one_error(tmp_path: Path, noise: str) -> None:
    text = lvm(["0.0\t1", "0.5\t2"])
    at = text.index("X_Value")
    for body in (text[:at] + noise, text + noise, text[:at] + noise + text[at:]):
        check_outcome(written(tmp_path, body))


@pytest.mark.parametrize(
    "heading", ["time (s){}signal (g)", "{}time\tsignal", "time # {}x", "time{}(s)(\tsignal", "a{}"]
)
def test_blanks_in_a_heading_take_no_time(heading: str, tmp_path: Path) -> None:
    path = written(tmp_path, heading.format(" " * 100_000) + "\n0\t1\n1\t2\n2\t1\n")
    begun_s = time.monotonic()
    check_outcome(path)
    assert time.monotonic() - begun_s < 2.0


def test_a_recording_that_is_too_large_is_refused_before_it_is_read(tmp_path: Path) -> None:
    path = tmp_path / "long.wav"
    path.write_bytes(b"RIFF")
    with path.open("ab") as file:
        file.truncate(LARGEST + 1)
    with pytest.raises(RecordingError, match=f"at most {LARGEST // 2**20} MiB"):
        read(path)


def test_an_empty_column_of_remarks_keeps_the_headings_and_a_channel_is_named_as_its_heading(
    tmp_path: Path,
) -> None:
    path = tmp_path / "logger.csv"
    rows = [f"{i};{i % 5},5;{i % 7},25;" for i in range(60)]
    path.write_text("\n".join(["Messung 3;Sensor A;;", "Zeit [ms];Weg [mm];Kraft [N];Bemerkung", *rows, ""]))
    for asked in ("Kraft", "Kraft [N]", "2"):
        made = read(path, channel=asked)
        assert (made.channels, made.channel, made.unit, made.rate_hz) == (("Weg", "Kraft"), "Kraft", "N", 1000.0)


def test_a_compressed_wav_is_refused_by_the_name_of_its_form(tmp_path: Path) -> None:
    path = tmp_path / "a.wav"
    path.write_bytes(
        b"RIFF" + struct.pack("<I", 46) + b"WAVEfmt " + struct.pack("<IHHIIHHH", 18, 6, 1, 8000, 8000, 1, 8, 0)
        + b"data" + struct.pack("<I", 8) + bytes(8)
    )  # fmt: skip
    with pytest.raises(RecordingError) as refused:
        read(path)
    assert "0x0006 (A-law)" in refused.value.finding.what
