"""The participant's buttons, a box or pedals on a serial line of its own, whose board dates each press.

The board sends lines of ASCII: a name and its counter of microseconds, modulo 2**32 as `micros()` of an Arduino is.
The name `.` is a heartbeat, ten a second or more; any other one is a button that was pressed. Nothing is sent to it.
"""

from __future__ import annotations

import re
from collections import deque
from dataclasses import dataclass
from statistics import stdev

from palpate.experiment.apparatus.tracker import clock_map
from palpate.experiment.apparatus.tracker.clock_map import ClockMap
from palpate.experiment.apparatus.tracker.serial_port import VANISHED, SerialPort, reason
from palpate.experiment.clock import Clock
from palpate.experiment.errors import ButtonsError, TrackerError

LINE = re.compile(rb"([!-~]) ([0-9]{1,20})\r?")
"""One line of a board, without its end."""

HEARTBEAT = "."
"""The name that no button has."""

WRAPS_US = 1 << 32
"""A counter begins anew after so many microseconds."""

LOOK_S, SILENT_LOOKS = 0.1, 10
"""The line is waited for so long at a time, s; after so many looks in a row without a line the board is gone."""

BEGINS_LOOKS, BEATS = 30, 5
"""A board that restarts as its port is opened is given so many looks, 3 s, until so many lines have come."""

DELAYS, BIN = 100, 10
"""Of so many lines it is kept how late they came, and of so many together the least."""


@dataclass(frozen=True)
class Press:
    """A button that was pressed at `device_us` of the board's counter, which never goes back."""

    key: str
    device_us: int


class ButtonBox:
    """Implements `Buttons`; one thread at a time may read."""

    def __init__(self, port: str, baud: int, *, clock: Clock, known: ClockMap | None = None) -> None:
        """Open the line, and return once the board is there, at once with a `known` clock. Raises `ButtonsError`."""
        self._name, self._clock, self._known = f"buttons at {port}", clock, known
        self._rest, self._silent = b"", 0
        self._state: clock_map.ClockState | None = None
        self._last_us: int | None = None
        self._delays_s: deque[float] = deque(maxlen=DELAYS)
        self.lines = 0
        """How many lines have come."""
        try:
            self._port = SerialPort(port, baud, device="buttons")
        except TrackerError as error:
            raise ButtonsError.saying(error) from error
        try:
            for _ in range(0 if known else BEGINS_LOOKS):
                self.read()
                if self.lines >= BEATS:
                    break
            if not known and self.lines < BEATS:
                raise self._fault(f"sent {self.lines} lines in {BEGINS_LOOKS * LOOK_S:g} s")
        except ButtonsError:
            self.close()
            raise

    @property
    def clock_map(self) -> ClockMap | None:
        """Session time of the board's counter; None before its first line."""
        return self._known or (None if self._state is None else self._state.map())

    @property
    def error_s(self) -> float | None:
        """The standard error of a press on the session's clock, s; None for a clock that was known.

        The map takes the lines that come least late for true, so this is the spread of the least late of each `BIN`. By
        how much even these are late, some 1 ms on USB, no line tells.
        """
        late_s = self.late_s
        if self._known or len(late_s) < BEATS:
            return None
        least_s = [min(late_s[n : n + BIN]) for n in range(0, len(late_s), BIN)]
        return stdev(least_s if len(least_s) > 2 else late_s)

    @property
    def late_s(self) -> tuple[float, ...]:
        """How long after the map says the last `DELAYS` lines came, s."""
        return tuple(self._delays_s)

    def read(self) -> tuple[Press, ...]:
        """Return within `LOOK_S` what was pressed. Raises `ButtonsError` for a line that is silent, strange or gone."""
        try:
            data = self._port.take() if self._port.wait(LOOK_S) else b""
        except VANISHED as error:
            raise self._fault(reason(error)) from error
        arrived_ns = self._clock.now_ns()
        *lines, self._rest = (self._rest + data).split(b"\n")
        self._silent = 0 if lines or self._known else self._silent + 1
        if self._silent >= SILENT_LOOKS:
            raise self._fault(f"was silent for {SILENT_LOOKS * LOOK_S:g} s")
        told = list(filter(None, map(self._press, lines)))
        if told:
            self._arrive(told[-1].device_us, arrived_ns)
        return tuple(one for one in told if one.key != HEARTBEAT)

    def close(self) -> None:
        """Close the line; nobody may be reading any more."""
        self._port.close()

    def _press(self, line: bytes) -> Press | None:
        if (found := LINE.fullmatch(line)) is None:
            if not self.lines:
                # It had begun before the port was opened.
                return None
            raise self._fault(f"sent {line[:16].hex(' ')}, which is not a message from a button board")
        self.lines += 1
        counted = int(found[2])
        before = self._last_us
        self._last_us = counted if before is None else before + (counted - before) % WRAPS_US
        return Press(found[1].decode(), self._last_us)

    def _arrive(self, device_us: int, arrived_ns: int) -> None:
        if self._known or self._last_us is None:
            return
        if self._state is None:
            self._state = clock_map.init(device_us, arrived_ns)
        elif device_us > self._state.origin_us + self._state.newest_x:
            self._state = clock_map.step(self._state, device_us, arrived_ns)
        self._delays_s.append((arrived_ns - self._state.map().session_ns(device_us)) / 1e9)

    def _fault(self, what: str) -> ButtonsError:
        allowed = f"lines such as '{HEARTBEAT} 123456' ten times a second, and '1 123456' for each button press"
        return ButtonsError(self._name, what, "plug it in, and correct [buttons] in the rig file", allowed=allowed)
