"""The response table of a rig: what is read, in which unit, and what is refused at which line."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from palpate.experiment.apparatus.panel.response_table import comments, is_simulated
from palpate.experiment.errors import RecordingError
from palpate.experiment.synthesis.shaping import Response
from tests.approved import Refuses
from tests.experiment.apparatus.panel.tables import GOOD, Write, read, write


def test_rms_and_peak_to_peak_become_amplitudes(written: Write) -> None:
    response = read(written(GOOD))
    assert response.frequencies_hz.tolist() == [10.0, 20.0]
    # A sinusoid of 1 V root mean square has an amplitude of sqrt 2 V; one of 4 m/s^2 peak to peak, of 2 m/s^2.
    assert response.levels_v == pytest.approx([0.1 * 2**0.5, 2**0.5], rel=1e-15)
    assert response.accelerations_m_s2.tolist() == [[0.25, 2.0], [0.5, 4.0]]


def test_a_table_says_of_itself_what_its_comments_say() -> None:
    assert comments(GOOD.encode()) == ("bench 2, load 40 N",)
    assert comments(GOOD.split("\n", 1)[1].encode()) == ()


@pytest.mark.parametrize("sign", ["# ", "#", " # ", "% ", "// ", "; ", ""])
def test_a_table_that_says_above_its_header_that_it_is_simulated_is(written: Write, sign: str) -> None:
    """A table is read with any of these lines; it counts as measured without one."""
    path = written(f"{sign}SIMULATED, for a rehearsal\n{GOOD}")
    assert read(path).levels_v.size == 2
    assert is_simulated(path.read_bytes())
    assert comments(path.read_bytes())[:-1] == (("SIMULATED, for a rehearsal",) if sign else ())
    assert not is_simulated(GOOD.encode())


def test_a_table_of_a_german_spreadsheet_is_read(tmp_path: Path) -> None:
    path = tmp_path / "response.csv"
    path.write_bytes(GOOD.replace(",", ";").replace(".", ",").encode("utf-16"))
    assert read(path).accelerations_m_s2.tolist() == [[0.25, 2.0], [0.5, 4.0]]
    assert comments(path.read_bytes()) == ("bench 2; load 40 N",)


def test_thousands_or_decimals_are_not_guessed(written: Write) -> None:
    text = "frequency_hz;drive_vrms;acceleration_pp_m_s2\n10;1;1,234\n20;1;2,345\n"
    with pytest.raises(RecordingError, match="decimal"):
        read(written(text))


@given(st.data())
def test_what_is_written_is_read_to_six_digits(tmp_path_factory: pytest.TempPathFactory, data: st.DataObject) -> None:
    rows, columns = data.draw(st.integers(2, 5)), data.draw(st.integers(1, 4))

    def rising(count: int) -> np.ndarray:
        return np.cumsum(data.draw(st.lists(st.floats(0.1, 10), min_size=count, max_size=count)))

    response = Response(rising(rows), rising(columns), np.array([rising(columns) for _ in range(rows)]))
    path = tmp_path_factory.mktemp("table") / "response.csv"
    write(path, response, comments=["simulated"])
    again = read(path)
    for name in ("frequencies_hz", "levels_v", "accelerations_m_s2"):
        assert getattr(again, name) == pytest.approx(getattr(response, name), rel=1e-5)


@pytest.mark.parametrize(
    ("line", "instead", "problem"),
    [
        (GOOD, "", r"got no rows; allowed: frequency_hz, drive_vrms, acceleration_pp_m_s2 in each"),
        (GOOD, "frequency_hz,drive_vrms,acceleration_pp_m_s2\n", "got no rows"),
        ("20, 0.1, 1.0\n20,1,8.0\n", "", "got 1 frequencies; allowed: two or more"),
        ("frequency_hz,drive_vrms", "f,V", "line 2: got 'f,V,.*'; allowed: the header frequency_hz,drive_vrms,acc"),
        ("frequency_hz,drive_vrms,acceleration_pp_m_s2\n", "", "line 3: got '10,0.1,0.5'; allowed: the header"),
        (
            "frequency_hz,drive_vrms,acceleration_pp_m_s2",
            "frequency_hz;drive_vrms;acceleration_pp_m_s2",
            "line 4: got 1 cells; allowed: 3",
        ),
        ("10,1,4.0", "10,1", "line 5: got 2 cells; allowed: 3"),
        ("10,1,4.0", "10,1,nan", "line 5: got acceleration_pp_m_s2 'nan'; allowed: a finite number of 0 or more"),
        ("10,1,4.0", "10,1,1e999", "line 5: got acceleration_pp_m_s2 '1e999'; allowed: a finite number"),
        ("10,1,4.0", "10,1,-4", "line 5: got acceleration_pp_m_s2 '-4'; allowed: a finite number of 0 or more"),
        ("10,1,4.0", "10,1,", "line 5: got acceleration_pp_m_s2 ''; allowed: a finite number"),
        ("10,0.1,0.5", "10,0,0.5", "line 4: got drive_vrms '0'; allowed: a finite number above 0"),
        ("10,0.1,0.5", "-10,0.1,0.5", "line 4: got frequency_hz '-10'; allowed: a finite number of 0 or more"),
        ("10,1,4.0", "10,0.1,4.0", "line 5: got 10 Hz at 0.1 Vrms, as in line 4; allowed: one row for each"),
        ("20,1,8.0", "10,0.1,4.0", "line 7: got 10 Hz at 0.1 Vrms, as in line 4; allowed: one row for each"),
        ("20,1,8.0", "15,1,8.0", "line 7: got 15 Hz at 1 Vrms after line 6; allowed: rising frequencies"),
        (
            "20,1,8.0",
            "20,0.01,8.0",
            "line 7: got 20 Hz at 0.01 Vrms after line 6; allowed: rising frequencies, with rising drive levels",
        ),
        (
            "20,1,8.0",
            "20,2,8.0",
            r"line 6: got drive levels \[0\.1, 2\.0\] at 20 Hz; allowed: \[0\.1, 1\.0\], as at 10",
        ),
        ("20,1,8.0\n", "", r"line 6: got drive levels \[0\.1\] at 20 Hz; allowed: \[0\.1, 1\.0\], as at 10 Hz"),
        (
            "20,1,8.0",
            "20,1,1.0",
            "line 7: acceleration_pp_m_s2: got 1 at 1 Vrms after 1 at the level below; allowed: m",
        ),
        ("20,1,8.0", "20,1,0.9", "line 7: acceleration_pp_m_s2: got 0.9 at 1 Vrms after 1 .*; measure that frequency"),
        ("20, 0.1, 1.0", "20,0.1,0", "line 6: acceleration_pp_m_s2: got 0 at 0.1 Vrms after 0 at the level below"),
    ],
)
def test_a_table_that_cannot_be_used_is_refused_at_its_line(
    written: Write, line: str, instead: str, problem: str
) -> None:
    assert line in GOOD
    with pytest.raises(RecordingError, match=rf"response\.csv: {problem}"):
        read(written(GOOD.replace(line, instead)))


def test_a_null_is_a_measurement(written: Write) -> None:
    response = read(written(GOOD.replace("20, 0.1, 1.0", "20,0.1,0").replace("20,1,8.0", "20,1,0")))
    assert response.accelerations_m_s2[1].tolist() == [0.0, 0.0]


def test_what_is_no_text(tmp_path: Path, refuses: Refuses) -> None:
    (tmp_path / "binary.csv").write_bytes(b"\xff\xfe\x00")
    with refuses(RecordingError):
        read(tmp_path / "binary.csv")


@given(st.binary(max_size=200) | st.text(max_size=200).map(str.encode))
def test_whatever_a_file_holds_is_read_or_refused(tmp_path_factory: pytest.TempPathFactory, content: bytes) -> None:
    path = tmp_path_factory.getbasetemp() / "any.csv"
    for head in (b"", b"frequency_hz,drive_vrms,acceleration_pp_m_s2\n1,1,1\n2,1,1\n"):
        path.write_bytes(head + content)
        try:
            outcome: object = read(path)
        except RecordingError as error:
            outcome = str(error)
        assert isinstance(outcome, Response) or "any.csv" in str(outcome)
