"""Models of what presented stimuli leave in the journal."""

from collections.abc import Sequence
from typing import Literal

from palpate.experiment.records.entries import Entry, Outcome, Record
from palpate.experiment.records.stimulus import Delivered, Stimulus


class Interval(Record):
    """One stimulus of a trial: that of `material`, asked for at the session time `onset_ns`, at a site of the body.

    `delivered` is the loopback's result; None without one or a known fault.
    """

    material: str
    onset_ns: int
    stimulus: Stimulus
    delivered: Delivered | None
    site: str | None = None

    @property
    def began_ns(self) -> int:
        """When it began, session time: as it was heard, or else as it was asked for."""
        heard = None if self.delivered is None else self.delivered.onset_ns
        return self.onset_ns if heard is None else heard


class Presentation(Outcome):
    """What a trial presents, one stimulus after the other, set off by an `experimenter`, `participant` or `clock`."""

    kind: Literal["presentation"] = "presentation"
    intervals: tuple[Interval, ...]
    set_off: Literal["experimenter", "participant", "clock"]

    @property
    def felt_s(self) -> tuple[float, ...]:
        return tuple(one.stimulus.lasts_s for one in self.intervals)

    @property
    def felt_at(self) -> tuple[tuple[str, str | None], ...]:
        return tuple((one.material, one.site) for one in self.intervals)


class Sample(Entry):
    """A stimulus of no trial, of a material at a level, which the participant felt while getting familiar with it."""

    kind: Literal["sample"] = "sample"
    level: float
    interval: Interval

    @property
    def felt_s(self) -> tuple[float, ...]:
        return (self.interval.stimulus.lasts_s,)

    @property
    def felt_at(self) -> tuple[tuple[str, str | None], ...]:
        return ((self.interval.material, self.interval.site),)


class CutShort(Outcome):
    """A presentation that ended early, for a `reason`; the last of its `intervals` may have been cut off.

    Without any nothing was felt, and the same attempt is made again; otherwise the trial moves to the end of its block.
    """

    asks = False

    kind: Literal["cut-short"] = "cut-short"
    intervals: tuple[Interval, ...]
    reason: str

    @property
    def felt_s(self) -> tuple[float, ...]:
        return tuple(one.stimulus.lasts_s for one in self.intervals)

    @property
    def felt_at(self) -> tuple[tuple[str, str | None], ...]:
        return tuple((one.material, one.site) for one in self.intervals)

    @property
    def put_off(self) -> bool:
        return bool(self.intervals)


def all_delivered(intervals: Sequence[Interval]) -> bool | None:
    """Return whether all stimuli were delivered; None where nothing measured them."""
    heard = [one.delivered.delivered for one in intervals if one.delivered is not None]
    return all(heard) if heard else None


ENTRIES: tuple[type[Entry], ...] = (Presentation, CutShort, Sample)
