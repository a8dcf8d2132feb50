"""The participant's pedal, or button: a board on a serial line of its own that sends ten heartbeats a second.

It sends `UP` while nobody presses, and `DOWN` at once and again and again while somebody does. Nothing is sent to it.
"""

from palpate.experiment.apparatus.tracker.serial_port import VANISHED, SerialPort, reason
from palpate.experiment.errors import PedalError, TrackerError

UP, DOWN = b".", b"!"
"""All that a pedal sends."""

LOOK_S = 0.1
"""The line is waited for so long at a time, s."""

SILENT_LOOKS = 10
"""After so many looks in a row without a byte, 1 s, the pedal is gone; a pause of the machine costs one of them."""

BEGINS_LOOKS, BEATS = 30, 3
"""A board that restarts as its port is opened is given so many looks, 3 s, until so many heartbeats have come."""


class Pedal:
    """An open pedal; one thread at a time may ask."""

    def __init__(self, port: str, baud: int) -> None:
        """Open the line, and return once the pedal is there. Raises `PedalError`, also for one that is pressed."""
        self._name, self._empty = f"pedal at {port}", 0
        try:
            self._port = SerialPort(port, baud, device="pedal")
        except TrackerError as error:
            raise PedalError.saying(error) from error
        try:
            self._await_beats()
        except PedalError:
            self.close()
            raise

    def pressed(self) -> bool:
        """Return within `LOOK_S` whether it was pressed. Raises `PedalError` for a line that is silent or gone."""
        if DOWN in (data := self._take()):
            return True
        self._empty = 0 if data else self._empty + 1
        if self._empty >= SILENT_LOOKS:
            raise self._fault(f"was silent for {SILENT_LOOKS * LOOK_S:g} s")
        return False

    def close(self) -> None:
        """Close the line; nobody may be asking any more."""
        self._port.close()

    def _await_beats(self) -> None:
        beats = 0
        for _ in range(BEGINS_LOOKS):
            if DOWN in (data := self._take()):
                raise PedalError(self._name, "is pressed", "release it, and check that its contact closes")
            beats += len(data)
            if beats >= BEATS:
                return
        raise self._fault(f"sent {beats} heartbeats in {BEGINS_LOOKS * LOOK_S:g} s")

    def _take(self) -> bytes:
        try:
            data = self._port.take() if self._port.wait(LOOK_S) else b""
        except VANISHED as error:
            raise self._fault(reason(error)) from error
        if strange := data.translate(None, UP + DOWN):
            raise self._fault(f"sent {strange[:8].hex(' ')}, which is not a pedal's message")
        return data

    def _fault(self, what: str) -> PedalError:
        allowed = f"'{UP.decode()}' ten times a second, '{DOWN.decode()}' while it is pressed"
        return PedalError(self._name, what, "plug it in, and correct [pedal] in the rig file", allowed=allowed)
