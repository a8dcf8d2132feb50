"""The lines of the entries of presented vibrations."""

from collections.abc import Sequence

from palpate.experiment.records.kinds.presented import CutShort, Interval, Presentation, Sample
from palpate.experiment.records.transcript import Lines
from palpate.experiment.records.transcript.stimulus import played_line


def _shown(intervals: Sequence[Interval]) -> str:
    return "; ".join(f"{one.material}{f' at {one.site}' if one.site else ''}: {_one(one)}" for one in intervals)


def _one(interval: Interval) -> str:
    heard = interval.delivered
    said = played_line(interval.stimulus, None)
    if heard is None:
        return said
    said = said.removesuffix("; delivery was not measured")
    off = "no onset was measured"
    if heard.onset_error_ms is not None:
        off = f"the onset was {heard.onset_error_ms:+.3f} ms off the requested time"
    return f"{said}; {off}, {heard.xruns} xruns{'' if heard.delivered else f', undelivered: {heard.reason}'}"


def _presented(entry: Presentation) -> str:
    by = "the clock" if entry.set_off == "clock" else f"the {entry.set_off}"
    return f"{entry.label}: started by {by}; {_shown(entry.intervals)}"


def _cut_short(entry: CutShort) -> str:
    again = "postponed to the end of the block" if entry.put_off else "prepared again"
    felt = f"; {_shown(entry.intervals)}" if entry.intervals else ""
    return f"{entry.label}: interrupted, {again}: {entry.reason}{felt}"


def _sample(entry: Sample) -> str:
    at = "" if entry.level == 1.0 else f", at level {entry.level:g}"
    return f"familiarization{at}: {_shown((entry.interval,))}"


LINES: Lines = {Presentation: _presented, CutShort: _cut_short, Sample: _sample}
