"""Triggers as a stream of Lab Streaming Layer: one integer an event, at the time by this machine's clock of LSL.

Without an `interface` the stream is announced on this machine alone. liblsl has no setting for where it waits for a
recorder's connection: that port is open on every interface, and the firewall's to close.
"""

import pylsl

from palpate.experiment.apparatus.wires.settings import TriggerRig

KIND = "Markers"
"""The type of the stream, which recorders take for events."""


def scope(interface: str | None) -> str:
    """Return liblsl's settings, in place of any file of them: announced on an interface, or on this machine alone."""
    reach, address = ("machine", "127.0.0.1") if interface is None else ("link", interface)
    announced = f"[multicast]\nResolveScope = {reach}\nListenAddress = {address}\n"
    return f"[ports]\nIPv6 = disable\n{announced}[log]\nlevel = -2\n"


class LslTrigger:
    """Implements `TriggerLine`."""

    def __init__(self, settings: TriggerRig) -> None:
        """Announce the stream; settings of liblsl count from the first stream of a process on."""
        pylsl.set_config_content(scope(settings.interface))
        name = settings.stream or ""
        described = pylsl.StreamInfo(name, KIND, 1, pylsl.IRREGULAR_RATE, pylsl.cf_int32, f"palpate {name}")
        self._outlet: pylsl.StreamOutlet | None = pylsl.StreamOutlet(described)

    def send(self, number: int, late_s: float) -> None:
        """Send the number, dated at the event."""
        if self._outlet is not None:
            self._outlet.push_sample([number], pylsl.local_clock() - late_s)

    def close(self) -> None:
        """Announce the stream no longer."""
        self._outlet = None
