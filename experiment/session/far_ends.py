"""What stands at the far ends of a session's ports: the devices that a rig names, or a simulated laboratory.

It is the one difference between a session with a participant and a rehearsal.
"""

from __future__ import annotations

from contextlib import ExitStack
from typing import TYPE_CHECKING, Protocol

from experiment.apparatus.ports import Tracker
from experiment.apparatus.rig import Rig
from experiment.apparatus.tracker import calibration
from experiment.apparatus.tracker.clock_map import ClockMap
from experiment.desk.port import Console

if TYPE_CHECKING:
    from experiment.synthesis.waveforms import Basis


class FarEnds(Protocol):
    """What stands at the far ends of a session's ports.

    A session calls these in the order in which it opens its parts; what `opened` is given is closed in reverse order.
    """

    @property
    def real_time(self) -> bool:
        """Whether the session runs by the wall clock, so that its priority matters."""
        ...

    @property
    def reconnect_s(self) -> float:
        """How long the session waits for a device that fell silent, s; then it is paused."""
        ...

    def sound_device(self, opened: ExitStack) -> str | None:
        """Return the audio device to open; None for the one that the rig names."""
        ...

    def wire_sound(self) -> None:
        """Lay what cables the audio device needs, now that the stream on it is open."""
        ...

    def panel(self, opened: ExitStack) -> str | None:
        """Set the panel up; return where its actuator answers, or None for the address that the rig names."""
        ...

    def presented(self, materials: dict[str, Basis]) -> dict[str, Basis]:
        """Return what is presented for each material, by its id: itself, unless a rehearsal controls for it."""
        ...

    def tracker(self, opened: ExitStack) -> tuple[str | None, ClockMap | None]:
        """Return the tracker's port, None for the one that the rig names, and its clock where that is known."""
        ...

    def check(self, tracker: Tracker, rig: Rig) -> None:
        """Refuse a tracker that cannot be used, before anybody is on the panel. Raises `TrackerError`."""
        ...

    def console(self) -> Console:
        """Return the experimenter's screen and keys."""
        ...


class RealEnds:
    """Implements `FarEnds`: the devices that the rig names, and an experimenter at a console."""

    real_time = True
    reconnect_s = 300.0

    def __init__(self, console: Console) -> None:
        """Take the experimenter's console."""
        self._console = console

    def sound_device(self, opened: ExitStack) -> None:  # noqa: ARG002
        return None

    def wire_sound(self) -> None:
        return None

    def panel(self, opened: ExitStack) -> None:  # noqa: ARG002
        return None

    def presented(self, materials: dict[str, Basis]) -> dict[str, Basis]:
        return materials

    def tracker(self, opened: ExitStack) -> tuple[None, None]:  # noqa: ARG002
        return None, None

    def check(self, tracker: Tracker, rig: Rig) -> None:
        calibration.check_reading(tracker, rig.tracker)

    def console(self) -> Console:
        return self._console
