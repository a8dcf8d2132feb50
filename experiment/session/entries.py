"""What a step leaves in the journal."""

from __future__ import annotations

from dataclasses import dataclass

from experiment.apparatus.clock_map import ClockMap
from experiment.apparatus.samples import LinkCounts
from experiment.records import BrokenOff, FootStep, Link, PlannedTrial, Trace, TrackerClock
from experiment.session.step import BrokenStep, WatchedStep


@dataclass(frozen=True)
class Armed:
    """An attempt that was armed.

    Attributes:
        planned: the trial.
        attempt: its number, from 1.
        dead_time_ms: since the answer just before, ms; None without one, and in simulated time.
    """

    planned: PlannedTrial
    attempt: int
    dead_time_ms: float | None


def entry(armed: Armed, seen: WatchedStep | BrokenStep, trace: Trace) -> FootStep | BrokenOff:
    """The entry of a step.

    Args:
        armed: the attempt.
        seen: what was seen of it.
        trace: where its raw frames stand.
    """
    if isinstance(seen, BrokenStep):
        return _broken_off(armed, seen, trace)
    return FootStep(
        trial=armed.planned.trial,
        attempt=armed.attempt,
        presented=armed.planned.presented,
        clock=_clock(seen.clock),
        dead_time_ms=armed.dead_time_ms,
        gate_top_us=seen.gate.top_us,
        gate_bottom_us=seen.gate.bottom_us,
        contact_us=seen.contact.us,
        speed_mm_s=seen.gate.speed_mm_s,
        link=_link(seen.link),
        trace=trace,
        stimulus=seen.stimulus,
        onset=seen.onset,
    )


def _broken_off(armed: Armed, seen: BrokenStep, trace: Trace) -> BrokenOff:
    gate = seen.gate
    return BrokenOff(
        trial=armed.planned.trial,
        attempt=armed.attempt,
        presented=armed.planned.presented,
        reason=seen.reason,
        felt=seen.felt,
        clock=_clock(seen.clock) if seen.clock else None,
        dead_time_ms=armed.dead_time_ms,
        at_us=seen.at_us,
        gate_top_us=gate.top_us if gate else None,
        gate_bottom_us=gate.bottom_us if gate else None,
        speed_mm_s=gate.speed_mm_s if gate else None,
        link=_link(seen.link),
        trace=trace,
    )


def _clock(known: ClockMap) -> TrackerClock:
    return TrackerClock(anchor_us=known.anchor_us, anchor_ns=known.anchor_ns, drift_ppm=known.drift_ppm)


def _link(counts: LinkCounts) -> Link:
    return Link(received=counts.received, lost=counts.lost, damaged=counts.damaged, repeated=counts.repeated)
