"""Models of what a comparison of two materials leaves in the journal."""

from typing import ClassVar, Literal

from palpate.experiment.records.entries import Entry, Lines, OfAttempt, Outcome, Trace
from palpate.experiment.records.stimulus import DeviceUs, Onset, Stimulus, onset_line, played_line
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


def _laid_out(entry: PairLaidOut) -> str:
    return f"{entry.label}: {' and '.join(entry.presented)} are laid out"


def _changed(entry: Changed) -> str:
    return f"{entry.label}: changed to the {entry.place} surface, {entry.material}"


def _tapped(entry: Tapped) -> str:
    return (
        f"{entry.label}: tapped the {entry.place} surface, {entry.material}, at "
        f"{entry.speed_mm_s:.1f} mm/s{' (too fast)' if entry.fast else ''}; "
        f"{played_line(entry.stimulus, entry.onset)}{onset_line(entry.onset)}"
    )


def _pushed(entry: Pushed) -> str:
    return f"the force of {entry.cycles} cycles of the servo is on record, and {entry.lost} are lost"


LINES: Lines = {PairLaidOut: _laid_out, Changed: _changed, Tapped: _tapped, Pushed: _pushed}
