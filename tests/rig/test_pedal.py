"""The participant's pedal on a real line: a press, a board that stops, a cable that is pulled, and what is no pedal."""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Iterator
from contextlib import closing, suppress
from datetime import date
from pathlib import Path

import pytest

from palpate.experiment.apparatus import opening
from palpate.experiment.apparatus import rig as rigs
from palpate.experiment.apparatus.doctor import doctor
from palpate.experiment.apparatus.tracker import pedal as pedals
from palpate.experiment.apparatus.tracker.pedal import Pedal
from palpate.experiment.apparatus.tracker.serial_port import SerialPort
from palpate.experiment.clock import MonotonicClock
from palpate.experiment.errors import PedalError, RigError
from palpate.experiment.protocol.files import shipped
from palpate.experiment.rehearsal.session import simulated_far_ends
from palpate.experiment.rehearsal.wires.serial_line import SerialLine, SimulatedPedal

STOPS_S = 0.2
"""Everything is silent so long after a press."""

TABLE = '\n[pedal]\nport = "rehearsal"\nbaud = 9600\ntried_on = 2026-05-01\ntried_days = 30\n'


@pytest.fixture
def board() -> Iterator[SimulatedPedal]:
    with SimulatedPedal() as made:
        yield made


def faulty(pedal: Pedal, within_s: float) -> str:
    """Return what is wrong with the pedal, which is found within so long."""
    ends_s = time.monotonic() + within_s
    with pytest.raises(PedalError) as failed:
        while not pedal.pressed():
            assert time.monotonic() < ends_s
    return str(failed.value)


def test_a_press_is_seen_at_once_and_again_by_whoever_opens_it_later(board: SimulatedPedal) -> None:
    for _ in range(2):
        with closing(Pedal(board.url, 9600)) as pedal:
            assert [pedal.pressed() for _ in range(5)] == [False] * 5
            begun_s = time.monotonic()
            board.press()
            while not pedal.pressed():
                pass
            assert time.monotonic() - begun_s < STOPS_S


def test_a_press_counts_behind_all_that_nobody_read(board: SimulatedPedal) -> None:
    with closing(Pedal(board.url, 9600)) as pedal:
        board.offer(b"." * 3000)
        board.press()
        # A line hands over what came in a few pieces.
        assert any(pedal.pressed() for _ in range(5))


@pytest.mark.parametrize(
    ("wrong", "says"),
    [
        (lambda board: setattr(board, "sends", False), "was silent for 1 s"),
        (SimulatedPedal.unplug, "pedal at"),
        (lambda board: board.write(b"\x00\xff" * 3000), "which is not a pedal's message"),
    ],
)
def test_a_pedal_with_which_nobody_could_stop_is_noticed(
    board: SimulatedPedal, wrong: Callable[[SimulatedPedal], None], says: str
) -> None:
    with closing(Pedal(board.url, 9600)) as pedal:
        wrong(board)
        assert says in faulty(pedal, 3.0)


@pytest.mark.parametrize("sends", [b"", b"..", b"!", b"...\x80"])
def test_a_line_without_a_pedal_that_is_released_opens_none(sends: bytes, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pedals, "BEGINS_LOOKS", 3)
    with SerialLine() as line:

        class Sent(SerialPort):
            def __init__(self, name: str, baud: int, *, device: str) -> None:
                super().__init__(name, baud, device=device)
                line.write(sends)

        monkeypatch.setattr(pedals, "SerialPort", Sent)
        with pytest.raises(PedalError):
            Pedal(line.url, 9600)
        # Its port is free again.
        with suppress(PedalError):
            Pedal(line.url, 9600)


def test_a_port_that_is_not_there_names_the_table(tmp_path: Path) -> None:
    with pytest.raises(PedalError) as refused:
        Pedal(str(tmp_path / "nothing"), 9600)
    assert refused.value.finding.where == f"pedal at {tmp_path / 'nothing'}"


def written(folder: Path, table: str, *, simulated: bool = True) -> rigs.Rig:
    text = shipped("rigs/rehearsal.toml").read_text("utf-8")
    text = re.sub(r"format = \d", "format = 3", text) + table
    text = text if simulated else text.replace("simulated = true", "simulated = false").replace('"rehearsal"', '"x:1"')
    (folder / "rig.toml").write_text(text, "utf-8")
    (folder / "rehearsal-response.csv").write_bytes(shipped("rigs/rehearsal-response.csv").read_bytes())
    return rigs.load(folder / "rig.toml")


def test_a_pedal_came_with_the_third_format_and_makes_no_other_rig(tmp_path: Path) -> None:
    with_one, without = written(tmp_path, TABLE), written(tmp_path, "")
    assert with_one.pedal is not None
    assert without.pedal is None
    assert rigs.sha256(with_one) == rigs.sha256(without)
    with pytest.raises(RigError, match="format"):
        (tmp_path / "rig.toml").write_text((tmp_path / "rig.toml").read_text().replace("= 3", "= 2") + TABLE)
        rigs.load(tmp_path / "rig.toml")
    with pytest.raises(RigError, match="simulated"):
        opening.open_pedal(with_one)
    assert opening.open_pedal(without) is None


@pytest.mark.parametrize(("day", "refused"), [(1, False), (31, False), (32, True)])
def test_a_real_pedal_has_to_be_tried(tmp_path: Path, day: int, refused: bool) -> None:
    real = written(tmp_path, TABLE, simulated=False)
    today = date.fromordinal(date(2026, 5, 1).toordinal() + day - 1)
    problem = None
    try:
        rigs.check_stops(real, {}, today)
    except RigError as error:
        problem = error.finding.allowed
    assert (problem is not None) == refused


def test_doctor_opens_the_pedal_and_names_it_as_the_participants_stop(tmp_path: Path) -> None:
    written(tmp_path, TABLE)
    found = {
        one.check: one.verdict
        for one in doctor.examine(
            rig_path=tmp_path / "rig.toml",
            protocol_path=None,
            root=tmp_path,
            clock=MonotonicClock(),
            simulate=simulated_far_ends,
        )
    }
    assert (found["pedal"], found["participant's stop"]) == ("passes", "passes")
