"""The participant's buttons on a real line: presses dated by their board, boards that fail, and answers on record."""

from __future__ import annotations

import csv
import re
import time
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

from palpate.experiment import storage
from palpate.experiment.apparatus import opening
from palpate.experiment.apparatus import rig as rigs
from palpate.experiment.apparatus.doctor import doctor
from palpate.experiment.apparatus.tracker.clock_map import ClockMap
from palpate.experiment.apparatus.wires import buttons as boxes
from palpate.experiment.apparatus.wires.buttons import WRAPS_US, ButtonBox, Press
from palpate.experiment.clock import MonotonicClock
from palpate.experiment.dataset.verify import verify
from palpate.experiment.errors import ButtonsError, RigError, SessionError
from palpate.experiment.protocol import files
from palpate.experiment.protocol.files import shipped
from palpate.experiment.records import journal
from palpate.experiment.records.entries import Answer
from palpate.experiment.rehearsal import study
from palpate.experiment.rehearsal.clock import ManualClock
from palpate.experiment.rehearsal.session import simulated_far_ends
from palpate.experiment.rehearsal.wires.serial_line import SerialLine, SimulatedButtons
from palpate.experiment.session import answering
from tests.experiment.protocol.small import SMALL

pytestmark = pytest.mark.clocked

TABLE = '\n[buttons]\nport = "rehearsal"\nbaud = 115200\nnames = ["f", "k", "p", "o", "i"]\n'


@pytest.fixture
def board() -> Iterator[SimulatedButtons]:
    with SimulatedButtons(MonotonicClock(), beats=True) as made:
        yield made


def pressed(box: ButtonBox) -> Press:
    while not (came := box.read()):
        pass
    (one,) = came
    return one


def test_a_press_is_dated_by_the_board_however_late_it_is_read(board: SimulatedButtons) -> None:
    clock = MonotonicClock()
    with closing(ButtonBox(board.url, 115_200, clock=clock)) as box:
        off_ms = []
        for key in "12" * 10:
            before_ns = clock.now_ns()
            at_us = board.press(key)
            time.sleep(0.02)
            one = pressed(box)
            assert (one.key, one.device_us) == (key, at_us)
            assert box.clock_map is not None
            off_ms.append((box.clock_map.session_ns(one.device_us) - before_ns) / 1e6)
        # Whatever else this machine does: the map is made of the lines that came least late.
        assert np.median(np.abs(off_ms)) < 10
        assert box.error_s is not None


@pytest.mark.parametrize(
    ("wrong", "says"),
    [
        (lambda board: setattr(board, "sends", False), "was silent for 1 s"),
        (SimulatedButtons.unplug, "buttons at"),
        (lambda board: board.write(b"no board\n"), "which is not a message from a button board"),
    ],
)
def test_a_board_that_fails_is_noticed(
    board: SimulatedButtons, wrong: Callable[[SimulatedButtons], None], says: str
) -> None:
    with closing(ButtonBox(board.url, 115_200, clock=MonotonicClock())) as box:
        wrong(board)
        ends_s = time.monotonic() + 5
        with pytest.raises(ButtonsError) as failed:
            while time.monotonic() < ends_s:
                box.read()
        assert str(failed.value).count(says) == 1


def test_a_line_without_a_board_opens_none(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(boxes, "BEGINS_LOOKS", 3)
    with SerialLine() as line, pytest.raises(ButtonsError):
        ButtonBox(line.url, 115_200, clock=MonotonicClock())


def test_a_counter_that_begins_anew_goes_on_and_a_line_may_come_in_parts() -> None:
    known = ClockMap(anchor_us=0, anchor_ns=0)
    with SerialLine() as line, closing(ButtonBox(line.url, 115_200, clock=ManualClock(0), known=known)) as box:
        line.write(f"45\n1 {WRAPS_US - 10}\r\n2 ".encode())
        assert pressed(box) == Press("1", WRAPS_US - 10)
        line.write(b"5\n. 7\n")
        assert pressed(box) == Press("2", WRAPS_US + 5)


def written(folder: Path, table: str = TABLE, *, simulated: bool = True) -> Path:
    text = re.sub(r"format = \d", "format = 6", shipped("rigs/rehearsal.toml").read_text("utf-8")) + table
    text = text if simulated else text.replace("simulated = true", "simulated = false").replace('"rehearsal"', '"x:1"')
    (folder / "rig.toml").write_text(text, "utf-8")
    (folder / "rehearsal-response.csv").write_bytes(shipped("rigs/rehearsal-response.csv").read_bytes())
    return folder / "rig.toml"


def protocol_file(folder: Path, mode: str) -> Path:
    text = SMALL.replace("format = 4", "format = 7").replace('mode = "oral"', f'mode = "{mode}"')
    (folder / f"{mode}.toml").write_text(text.replace("repetitions = 3", "repetitions = 2"), "utf-8")
    return folder / f"{mode}.toml"


@pytest.mark.parametrize(
    ("mode", "table", "refused"),
    [
        ("oral", "", False),
        ("keys", "", True),
        ("keys", TABLE, False),
        ("keys", TABLE.replace('"f", ', ""), True),
        ("screen", "", True),
        ("screen", "\n[screen]\n", False),
    ],
)
def test_a_rig_on_which_participants_cannot_answer_is_refused_and_so_are_lines_of_text(
    tmp_path: Path, mode: str, table: str, refused: bool
) -> None:
    protocol = files.load(protocol_file(tmp_path, mode))
    rig = rigs.load(written(tmp_path, table, simulated=False))
    found: list[type[Exception]] = []
    try:
        answering.check(protocol, rig)
    except RigError as error:
        found.append(type(error))
    try:
        answering.check_lines(protocol)
    except SessionError as error:
        found.append(type(error))
    assert found == [*([RigError] if refused else []), *([SessionError] if mode != "oral" else [])]


def test_buttons_came_with_the_sixth_format_and_the_oral_mode_opens_none(tmp_path: Path) -> None:
    rig = rigs.load(written(tmp_path))
    assert opening.open_buttons(rig, "oral", clock=ManualClock(0)) is None
    with pytest.raises(RigError):
        opening.open_buttons(rig, "keys", clock=ManualClock(0))
    file = tmp_path / "rig.toml"
    file.write_text(file.read_text("utf-8").replace("format = 6", "format = 5"), "utf-8")
    with pytest.raises(RigError):
        rigs.load(file)


def test_doctor_measures_how_late_the_buttons_come(tmp_path: Path) -> None:
    found = {
        one.check: one
        for one in doctor.examine(
            rig_path=written(tmp_path),
            protocol_path=None,
            root=tmp_path,
            clock=MonotonicClock(),
            simulate=simulated_far_ends,
        )
    }
    assert found["buttons"].verdict == "passes"
    assert {"buttons to record"} <= found.keys()


@pytest.mark.parametrize("mode", ["keys", "screen"])
def test_a_rehearsed_participant_answers_alone_and_the_table_says_so(tmp_path: Path, mode: str) -> None:
    root = study.rehearse(
        protocol_file=protocol_file(tmp_path, mode),
        rig_file=written(tmp_path),
        out=tmp_path / "out",
        participants=1,
        seed=1,
    )
    assert verify(root).verdict is not None
    for path in storage.journals(root):
        answers = [one for one in journal.read(path).entries if isinstance(one, Answer)]
        assert {(one.by, one.confirmed_s) for one in answers} == {("participant", None)}
        assert all((one.device_us is not None) == (mode == "keys") for one in answers)
        assert all(one.pressed_ns is not None and one.response_time_s > 0 for one in answers)
    events = next(root.glob("sub-01/beh/*_events.tsv"))
    with events.open(encoding="utf-8") as table:
        rows = [row for row in csv.DictReader(table, delimiter="\t") if row["counted"] == "1"]
    assert {(row["answered_by"], row["response_end"]) for row in rows} == {("participant", "press")}
