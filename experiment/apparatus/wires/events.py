"""The participant's buttons as an input device of Linux: a keypad, box or pedal of class HID, by its event file.

The file, such as `/dev/input/by-id/usb-...-event-kbd`, yields `struct input_event` of `linux/input.h`: the kernel's
time, a type, a code and a value. The kernel dates an event when the device's report has come, by the monotonic clock
if asked to, which is the session's, and passes it to no other program. A press waits in the device for its report, for
up to the polling interval. RECORDED events come through a pipe, and are dated as a board's are: by their own clock.
"""

from __future__ import annotations

import os
import select
import stat
import struct
from collections import deque
from collections.abc import Iterator, Mapping
from importlib import import_module
from math import sqrt
from pathlib import Path

from palpate.experiment.apparatus.tracker import clock_map
from palpate.experiment.apparatus.tracker.clock_map import ClockMap
from palpate.experiment.apparatus.wires.buttons import DELAYS, LOOK_S, Press
from palpate.experiment.clock import Clock, monotonic_ns
from palpate.experiment.errors import ButtonsError

EVENT = struct.Struct("@llHHi")
"""Seconds, microseconds, type, code and value."""

SYN, KEY, DROPPED, DOWN = 0, 1, 3, 1
"""Types of events; the code of a SYN that tells of lost ones; the value of a press, other than of what it repeats."""

SET_CLOCK, GRAB = 0x400445A0, 0x40044590
"""EVIOCSCLOCKID and EVIOCGRAB of `linux/input.h`."""

MONOTONIC = struct.pack("i", 1)
"""CLOCK_MONOTONIC."""

TAKEN = 64 * EVENT.size
"""So many bytes are taken at a time."""

SYSTEM = Path("/sys/class/input")
"""Where Linux tells of each input device."""


class EventButtons:
    """Implements `Buttons`; one thread at a time may read."""

    def __init__(self, port: str, codes: Mapping[int, str], *, clock: Clock, recorded: bool) -> None:
        """Open the event file of buttons that have these names, by their codes, or a pipe where `recorded`.

        Raises `ButtonsError`.
        """
        self._name, self._clock, self._codes = f"buttons at {port}", clock, codes
        self._rest, self._state = b"", None if recorded else clock_map.init(monotonic_ns() // 1000, clock.now_ns())
        self._recorded, self._delays_s = recorded, deque[float](maxlen=DELAYS)
        self.unnamed: set[int] = set()
        """Codes of pressed keys that the rig does not name."""
        try:
            self._file = os.open(port, os.O_RDONLY | os.O_NONBLOCK)
        except OSError as error:
            raise self._fault(f"cannot be opened ({error.strerror})") from error
        try:
            if not (recorded and stat.S_ISFIFO(os.fstat(self._file).st_mode)):
                control = import_module("fcntl").ioctl
                control(self._file, SET_CLOCK, MONOTONIC)
                control(self._file, GRAB, 1)
        except OSError as error:
            os.close(self._file)
            raise self._fault(f"is not an input device that palpate can use exclusively ({error.strerror})") from error
        interval_s = polling_s(port)
        self._error_s = None if recorded or interval_s is None else interval_s / sqrt(12)

    @property
    def clock_map(self) -> ClockMap | None:
        """Session time of the events' clock; None before the first that was recorded."""
        return None if self._state is None else self._state.map()

    @property
    def error_s(self) -> float | None:
        """The standard error of a press, s: a press is equally probable at any time of a polling interval.

        None where Linux does not tell the interval: of recorded events, and devices without USB.
        """
        return self._error_s

    @property
    def late_s(self) -> tuple[float, ...]:
        """How long after their times the last `DELAYS` presses were read, s; recorded ones by the least late."""
        return tuple(self._delays_s)

    def read(self) -> tuple[Press, ...]:
        """Return within `LOOK_S` what was pressed. Raises `ButtonsError` for a device that is gone, or lost events."""
        if not select.select([self._file], [], [], LOOK_S)[0]:
            return ()
        try:
            data = os.read(self._file, TAKEN)
        except OSError as error:
            raise self._fault(f"is gone ({error.strerror})") from error
        arrived_ns = self._clock.now_ns()
        if not data:
            raise self._fault("is gone")
        whole = len(self._rest + data) // EVENT.size * EVENT.size
        events, self._rest = (self._rest + data)[:whole], (self._rest + data)[whole:]
        pressed = tuple(self._pressed(events))
        for one in pressed:
            self._arrive(one.device_us, arrived_ns)
        return pressed

    def close(self) -> None:
        """Close it, so that other programs get its events again; nobody may be reading any more."""
        os.close(self._file)

    def _pressed(self, events: bytes) -> Iterator[Press]:
        for seconds, microseconds, sort, code, value in EVENT.iter_unpack(events):
            if (sort, code) == (SYN, DROPPED):
                raise self._fault("lost events because palpate did not read them in time")
            if sort != KEY or value != DOWN:
                continue
            if code in self._codes:
                yield Press(self._codes[code], seconds * 1_000_000 + microseconds)
            else:
                self.unnamed.add(code)

    def _arrive(self, device_us: int, arrived_ns: int) -> None:
        if self._state is None:
            self._state = clock_map.init(device_us, arrived_ns)
        elif self._recorded and device_us > self._state.origin_us + self._state.newest_x:
            self._state = clock_map.step(self._state, device_us, arrived_ns)
        self._delays_s.append((arrived_ns - self._state.map().session_ns(device_us)) / 1e9)

    def _fault(self, what: str) -> ButtonsError:
        remedy = "plug it in, add yourself to the group `input`, and correct buttons.port in the rig file"
        return ButtonsError(
            self._name, what, remedy, allowed="an event file such as /dev/input/by-id/usb-...-event-kbd"
        )


def polling_s(port: str) -> float | None:
    """Return how often USB asks the device of an event file, s; None where Linux does not tell."""
    device = (SYSTEM / Path(port).resolve().name / "device").resolve()
    for folder in device.parents:
        for told in sorted(folder.glob("ep_8*/interval")):
            text = told.read_text("ascii").strip()
            return float(text[:-2]) * {"ms": 1e-3, "us": 1e-6}[text[-2:]]
    return None
