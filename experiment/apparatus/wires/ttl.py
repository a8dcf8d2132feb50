"""A trigger as one byte on a serial line, as trigger boxes and a microcontroller that sets its pins take it."""

from palpate.experiment.apparatus.tracker.serial_port import open_port
from palpate.experiment.apparatus.wires.settings import TriggerRig

LEAVES_S = 1.0
"""A byte that has not left for so long is lost, s."""


class SerialTrigger:
    """Implements `TriggerLine`."""

    def __init__(self, settings: TriggerRig) -> None:
        """Open the port. Raises `TrackerError`."""
        self._port = open_port(settings.port or "", settings.baud or 0, "triggers")
        self._port.write_timeout = LEAVES_S

    def send(self, number: int, late_s: float) -> None:  # noqa: ARG002
        """Send the byte. Raises `OSError` if the line is gone, or full."""
        self._port.write(bytes([number]))

    def close(self) -> None:
        """Close the port."""
        self._port.close()
