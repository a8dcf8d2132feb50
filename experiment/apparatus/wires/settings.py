"""The rig's `[[triggers]]`: lines that tell other machines of events, each by a number and nothing else."""

from collections.abc import Iterator
from typing import Annotated, Any, ClassVar

from pydantic import Field

from palpate.experiment.settings.load import ONE_LINE, Broken, Confined, Line, Name, Rules, driver_key

LSL, TTL = "lsl", "ttl"
NEEDED, ALLOWED = {LSL: ("stream",), TTL: ("port", "baud")}, {LSL: ("interface",), TTL: ()}
"""palpate's own drivers: the keys that each needs, and may have."""

Number = Annotated[int, Field(ge=1, le=254)]
Address = Annotated[str, Field(pattern=r"^(\d{1,3}\.){3}\d{1,3}$", description="an IPv4 address")]


def _event_rules(table: Any) -> Iterator[Broken]:
    """At least one event has a number, and no two have the same."""
    numbers = [number for number in table.values() if number is not None]
    if not numbers or len(set(map(str, numbers))) < len(numbers):
        yield Broken((), "a number for one event at least, and no number twice")


class TriggerEvents(Confined):
    """The number that a line sends for each event; 255 is the test of `palpate doctor`.

    Attributes:
        start: the session begins, or goes on after a pause.
        trial: an attempt at a trial is armed.
        stimulus: a stimulus of a trial begins at the actuator.
        answer: an answer is on record.
        pause: the session pauses.
        end: the session ends.
    """

    RULES: ClassVar[Rules] = _event_rules

    start: Number | None = None
    trial: Number | None = None
    stimulus: Number | None = None
    answer: Number | None = None
    pause: Number | None = None
    end: Number | None = None


def _trigger_rules(table: Any) -> Iterator[Broken]:
    """`lsl` needs `stream`, `ttl` needs `port` and `baud`, and neither takes a key of the other."""
    driver, given = table.get("driver"), {key for key, value in table.items() if value is not None}
    if driver in NEEDED:
        yield from (Broken((key,), f"this key: driver is '{driver}'") for key in NEEDED[driver] if key not in given)
        strange = given - {"driver", "events", *NEEDED[driver], *ALLOWED[driver]}
        yield from (Broken((key,), f"no such key: driver is '{driver}'") for key in sorted(strange))


class TriggerRig(Confined):
    """One line of triggers.

    Attributes:
        driver: Lab Streaming Layer, a byte on a serial line, or a class of a module beside the rig file or installed.
        stream: its name, as recorders list it.
        interface: the network interface that announces it; without it, this machine alone.
        port: device path, or URL for pyserial.
        baud: bits a second.
        events: which are sent, and as what.
    """

    RULES: ClassVar[Rules] = _trigger_rules

    driver: Annotated[str, driver_key(LSL, TTL), ONE_LINE]
    stream: Name | None = None
    interface: Address | None = None
    port: Line | None = None
    baud: Annotated[int, Field(ge=1200, le=12_000_000)] | None = None
    events: TriggerEvents
