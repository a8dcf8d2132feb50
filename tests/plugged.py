"""A simulated serial line whose device can be plugged in again, as a real one can."""

from __future__ import annotations

from pathlib import Path

from palpate.experiment.rehearsal.wires.serial_line import HERE, Kind, PseudoTerminal, SerialLine, Server


class PluggedLine(SerialLine):
    """A line whose port has a name that outlasts unplugging: `link`, as Linux gives one under /dev/serial/by-id.

    A TCP server keeps its port instead.
    """

    def __init__(self, kind: Kind = HERE, *, link: Path) -> None:
        super().__init__(kind)
        self._link = link if kind == "pty" else None
        self._name()

    def _name(self) -> None:
        if self._link is not None:
            self._link.symlink_to(self.url)
            self.url = str(self._link)

    def unplug(self) -> None:
        super().unplug()
        if self._link is not None:
            self._link.unlink(missing_ok=True)

    def replug(self) -> None:
        """Bring the device's end back after `unplug`, on an empty line."""
        with self._lock:
            self._end = Server(int(self.url.rpartition(":")[2])) if self._link is None else PseudoTerminal()
            self.url = self._end.url
            self._unplugged = False
        self._name()
