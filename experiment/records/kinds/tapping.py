"""Models of what a comparison of two materials leaves in the journal."""

from typing import ClassVar, Literal

from palpate.experiment.records.entries import Entry, OfAttempt, Outcome, Trace
from palpate.experiment.records.stimulus import DeviceUs, Onset, Stimulus
from palpate.experiment.storage import RAW

Place = Literal["first", "second"]


class PairLaidOut(Outcome):
    """A pair lies before the participant, who taps and changes at will, from the session time `laid_ns`, ns."""

    kind: Literal["pair"] = "pair"
    laid_ns: int


class Changed(OfAttempt):
    """The participant changed to the other virtual surface of a pair: to that of `material`, at a place of the pair."""

    kind: Literal["changed"] = "changed"
    place: Place
    material: str


class Tapped(OfAttempt):
    """The hand touched a virtual surface, at `device_us` of the tracker's clock, with `speed_mm_s`.

    `fast`: too fast for the protocol, so the lamp was lit. `stimulus` is the vibration, `onset` how it met the touch.
    """

    kind: Literal["tapped"] = "tapped"
    place: Place
    material: str
    device_us: DeviceUs
    speed_mm_s: float
    fast: bool
    stimulus: Stimulus
    onset: Onset


class ForceTrace(Trace):
    """Where the force of some cycles of the servo stands in the session's file of it (`servo.record.CYCLE`)."""

    file: ClassVar[str] = RAW[1]
    recording: ClassVar[str] = "force"
    of_what: ClassVar[tuple[str, str]] = "forces", "part"
    lossy: ClassVar[tuple[str, int]] = "cycle", 48
    """What the file consists of, and the bytes of each: a dataset is built without an end that it lost."""


class Pushed(Entry):
    """The force that was sent since the entry before, in `cycles` of the servo, of which `lost` more are missing."""

    kind: Literal["pushed"] = "pushed"
    trace: ForceTrace
    cycles: int
    lost: int


ENTRIES: tuple[type[Entry], ...] = (PairLaidOut, Changed, Tapped, Pushed)
