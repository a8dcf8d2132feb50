"""Buttons of an input device of Linux: the bytes of its events through a pipe, and through what is no device.

The events are RECORDED: those of a numeric keypad, as evtest printed them (CWE3D/lister_numpad_macros on GitHub,
documents/keyboard.md, "Ionflux (Mode 1)"), here in the bytes that `linux/input.h` says.
"""

from __future__ import annotations

import os
import struct
import threading
import time
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import pytest

from palpate.experiment.apparatus import opening
from palpate.experiment.apparatus import rig as rigs
from palpate.experiment.apparatus.doctor import doctor
from palpate.experiment.apparatus.wires import events
from palpate.experiment.apparatus.wires.buttons import Press
from palpate.experiment.apparatus.wires.events import EventButtons
from palpate.experiment.clock import MonotonicClock
from palpate.experiment.errors import ButtonsError, RigError
from palpate.experiment.rehearsal.clock import ManualClock
from palpate.experiment.rehearsal.session import simulated_far_ends
from tests.rig.test_buttons import TABLE, written

pytestmark = pytest.mark.clocked

RECORDED = [
    (1732611128, 101149, 2, 1), (1732611128, 182148, 2, 0),
    (1732611128, 519263, 3, 1), (1732611128, 600134, 3, 0),
    (1732611129, 49127, 4, 1), (1732611129, 122142, 4, 0),
    (1732611129, 995109, 5, 1), (1732611130, 76108, 5, 0),
]  # fmt: skip
"""Seconds, microseconds, code and value of each key that went down or up."""

NAMED = {2: "1", 3: "2", 4: "3"}


def in_bytes(seconds: int, microseconds: int, code: int, value: int) -> bytes:
    """Three events, as the recording has them: what the keypad sent, the key, and the end of a report."""
    scan = 0x7001C + code
    rows = ((4, 4, scan), (1, code, value), (0, 0, 0))
    return b"".join(struct.pack("@llHHi", seconds, microseconds, *row) for row in rows)


@pytest.fixture
def pipe(tmp_path: Path) -> Iterator[tuple[Path, int]]:
    path = tmp_path / "event3"
    os.mkfifo(path)
    # Open for both, so that it outlives each reader.
    end = os.open(path, os.O_RDWR)
    yield path, end
    os.close(end)


def read(box: EventButtons, presses: int) -> list[Press]:
    found: list[Press] = []
    ends_s = time.monotonic() + 5
    while len(found) < presses and time.monotonic() < ends_s:
        found.extend(box.read())
    return found


def test_recorded_presses_have_their_own_times_whole_or_in_parts(pipe: tuple[Path, int]) -> None:
    path, end = pipe
    whole = b"".join(in_bytes(*one) for one in RECORDED)
    with closing(EventButtons(str(path), NAMED, clock=ManualClock(0), recorded=True)) as box:
        os.write(end, whole[:100])
        first = read(box, 1)
        os.write(end, whole[100:])
        found = first + read(box, 2)
        assert [one.key for one in found] == ["1", "2", "3"]
        assert [one.device_us - found[0].device_us for one in found] == [0, 418114, 947978]
        # The fourth key is one that the rig does not name; what goes up, or repeats, is no press.
        assert box.unnamed == {5}
        os.write(end, in_bytes(1732611131, 0, 2, 2))
        assert box.read() == ()
        assert box.error_s is None


def test_presses_at_the_recorded_pace_are_dated_by_their_own_clock_however_late_they_are_read(
    pipe: tuple[Path, int],
) -> None:
    path, end = pipe
    clock = MonotonicClock()
    sent_ns: list[int] = []

    def play() -> None:
        begun_s, first_s = time.monotonic(), RECORDED[0][0] + RECORDED[0][1] / 1e6
        for one in RECORDED:
            time.sleep(max(begun_s + one[0] + one[1] / 1e6 - first_s - time.monotonic(), 0))
            sent_ns.append(clock.now_ns())
            os.write(end, in_bytes(*one))

    with closing(EventButtons(str(path), NAMED, clock=clock, recorded=True)) as box:
        thread = threading.Thread(target=play)
        thread.start()
        found = read(box, 3)
        thread.join()
        assert box.clock_map is not None
        times_ns = [box.clock_map.session_ns(one.device_us) for one in found]
        off_ms = [(at - sent) / 1e6 for at, sent in zip(times_ns, sent_ns[::2], strict=False)]
        assert len(off_ms) == 3
        assert len(box.late_s) == 3
        # The map is made of the press that came least late.
        assert min(map(abs, off_ms)) < 50


def test_an_input_device_is_asked_for_the_session_s_clock_and_kept_from_other_programs(
    pipe: tuple[Path, int], monkeypatch: pytest.MonkeyPatch
) -> None:
    path, end = pipe
    asked: list[tuple[int, object]] = []

    class Control:
        @staticmethod
        def ioctl(_: int, request: int, given: object) -> None:
            asked.append((request, given))

    monkeypatch.setattr(events, "import_module", lambda _: Control)
    clock = MonotonicClock()
    with closing(EventButtons(str(path), NAMED, clock=clock, recorded=False)) as box:
        assert asked == [(0x400445A0, b"\x01\0\0\0"), (0x40044590, 1)]
        now_ns, pressed_ns = time.monotonic_ns(), clock.now_ns()
        os.write(end, in_bytes(now_ns // 10**9, now_ns % 10**9 // 1000, 2, 1))
        (one,) = read(box, 1)
        assert box.clock_map is not None
        assert abs(box.clock_map.session_ns(one.device_us) - pressed_ns) < 1_000_000
        assert box.late_s[0] >= -1e-3


def test_what_is_no_input_device_is_refused_and_one_that_goes_is_noticed(
    pipe: tuple[Path, int], tmp_path: Path
) -> None:
    path, end = pipe
    with pytest.raises(ButtonsError):
        EventButtons(str(path), NAMED, clock=ManualClock(0), recorded=False)
    with pytest.raises(ButtonsError):
        EventButtons(str(tmp_path / "missing"), NAMED, clock=ManualClock(0), recorded=True)
    with closing(EventButtons(str(path), NAMED, clock=ManualClock(0), recorded=True)) as box:
        os.write(end, struct.pack("@llHHi", 0, 0, 0, 3, 0))
        with pytest.raises(ButtonsError):
            read(box, 1)
    gone = tmp_path / "gone"
    os.mkfifo(gone)
    with closing(EventButtons(str(gone), NAMED, clock=ManualClock(0), recorded=True)) as box:
        os.close(os.open(gone, os.O_WRONLY))
        with pytest.raises(ButtonsError):
            read(box, 1)


def test_the_standard_error_is_that_of_how_often_usb_asks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    device = tmp_path / "usb1" / "1-2" / "1-2:1.0" / "0003:1" / "input" / "input7"
    device.mkdir(parents=True)
    monkeypatch.setattr(events, "SYSTEM", tmp_path / "class")
    event = tmp_path / "class" / "event3"
    event.mkdir(parents=True)
    (event / "device").symlink_to(device)
    assert events.polling_s("/dev/input/event3") is None
    for interval, seconds in (("8ms", 0.008), ("125us", 0.000125)):
        endpoint = tmp_path / "usb1" / "1-2" / "1-2:1.0" / "ep_81"
        endpoint.mkdir(exist_ok=True)
        (endpoint / "interval").write_text(interval + "\n", "ascii")
        assert events.polling_s("/dev/input/event3") == pytest.approx(seconds)


def table(path: Path) -> str:
    return f'\n[buttons]\nport = "{path}"\nnames = ["1", "2", "3"]\ncodes = [2, 3, 4]\n'


@pytest.mark.parametrize(
    "wrong",
    [
        lambda text: text.replace("codes = [2, 3, 4]", "codes = [2, 3]"),
        lambda text: text.replace("codes = [2, 3, 4]", "codes = [2, 3, 3]"),
        lambda text: text.replace("codes = [2, 3, 4]", ""),
        lambda text: text + "baud = 115200\n",
    ],
)
def test_codes_are_those_of_the_names(tmp_path: Path, wrong: object) -> None:
    with pytest.raises(RigError) as refused:
        rigs.load(written(tmp_path, wrong(table(tmp_path))))  # type: ignore[operator]
    assert "buttons" in str(refused.value)


@pytest.mark.parametrize(("dead", "verdict"), [(False, "passes"), (True, "refuses")])
def test_doctor_has_each_button_pressed_and_names_a_dead_one(
    pipe: tuple[Path, int], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, dead: bool, verdict: str
) -> None:
    from palpate.experiment.apparatus.doctor import buttons

    path, end = pipe
    monkeypatch.setattr(buttons, "PRESS_S", 1.0)
    folder = tmp_path / "rig"
    folder.mkdir()
    rig = rigs.load(written(folder, table(path)))
    with closing(opening.open_buttons(rig, "keys", clock=MonotonicClock()) or pytest.fail("none")) as box:
        assert isinstance(box, EventButtons)
    for one in RECORDED:
        if not (dead and one[2] == 3):
            os.write(end, in_bytes(*one))
    found = {
        one.check: one
        for one in doctor.examine(
            rig_path=folder / "rig.toml",
            protocol_path=None,
            root=tmp_path,
            clock=MonotonicClock(),
            simulate=simulated_far_ends,
            presses=1,
        )
    }
    assert found["buttons"].verdict == "passes"
    assert found["buttons"].what.startswith("RECORDED")
    assert found["each button"].verdict == verdict
    assert str(found["each button"].remedy).endswith(" 2") == dead


def test_without_presses_doctor_says_that_nobody_was_asked(tmp_path: Path) -> None:
    found = doctor.examine(
        rig_path=written(tmp_path, TABLE),
        protocol_path=None,
        root=tmp_path,
        clock=MonotonicClock(),
        simulate=simulated_far_ends,
    )
    assert next(one for one in found if one.check == "each button").verdict == "unknown"
