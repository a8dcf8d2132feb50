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
    """At least one event has a number, and no two events share a number."""
    numbers = [number for number in table.values() if number is not None]
    if not numbers or len(set(map(str, numbers))) < len(numbers):
        yield Broken((), "a number for at least one event, with no number used twice")


class TriggerEvents(Confined):
    """The number that is sent for each event; `palpate doctor` sends 255 as a test.

    Attributes:
        start: the session begins, or continues after a pause.
        trial: an attempt at a trial is armed.
        stimulus: a stimulus of a trial begins at the actuator.
        answer: an answer is recorded.
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
    """`lsl` needs `stream`, `ttl` needs `port` and `baud`, and neither may have the other's keys."""
    driver, given = table.get("driver"), {key for key, value in table.items() if value is not None}
    if driver in NEEDED:
        yield from (Broken((key,), f"this key with driver '{driver}'") for key in NEEDED[driver] if key not in given)
        strange = given - {"driver", "events", *NEEDED[driver], *ALLOWED[driver]}
        yield from (Broken((key,), f"no such key with driver '{driver}'") for key in sorted(strange))


class TriggerRig(Confined):
    """One trigger line.

    Attributes:
        driver: Lab Streaming Layer, a byte on a serial line, or a class of a module in this folder or installed.
        stream: the stream's name, as recorders list it.
        interface: network interface on which it is announced; if omitted, only on this machine.
        port: device path, or URL for pyserial.
        baud: bits per second.
        events: which are sent, and as what.
    """

    RULES: ClassVar[Rules] = _trigger_rules

    driver: Annotated[str, driver_key(LSL, TTL), ONE_LINE]
    stream: Name | None = None
    interface: Address | None = None
    port: Line | None = None
    baud: Annotated[int, Field(ge=1200, le=12_000_000)] | None = None
    events: TriggerEvents
