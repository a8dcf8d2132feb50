"""The lines of a footstep's entries."""

from palpate.experiment.records.kinds.footstep import BrokenOff, FootStep, Probed, Zeroed
from palpate.experiment.records.transcript import Lines
from palpate.experiment.records.transcript.stimulus import onset_line, played_line, pressed_line


def _zeroed(entry: Zeroed) -> str:
    return f"zeroed: the foot rests at {entry.offset_mm:+.2f} mm from contact, SD {entry.spread_mm:.2f} mm"


def _probed(entry: Probed) -> str:
    return f"masker probe: {entry.material} at {entry.speed_mm_s:g} mm/s, {played_line(entry.stimulus, None)}"


def _stepped(entry: FootStep) -> str:
    link, error_ms = entry.link, entry.contact_standard_error_ms
    known = "" if error_ms is None else f"; the contact time has a standard error of {error_ms:.2f} ms"
    return (
        f"{entry.label}: {' and '.join(entry.presented)}, {entry.speed_mm_s:.1f} mm/s, "
        f"{played_line(entry.stimulus, entry.onset)}; "
        f"frames {link.received} received, {link.lost} lost, {link.damaged} damaged, {link.repeated} repeated"
        f"{onset_line(entry.onset)}{known}{pressed_line(entry.force)}{_dead(entry.dead_time_ms)}"
    )


def _broken_off(entry: BrokenOff) -> str:
    again = "postponed to the end of the block" if entry.felt else "armed again"
    presented = " and ".join(entry.presented)
    played = "" if entry.stimulus is None else f"; {played_line(entry.stimulus, None)}"
    return f"{entry.label}: {presented}, interrupted, {again}: {entry.reason}{played}{_dead(entry.dead_time_ms)}"


def _dead(dead_time_ms: float | None) -> str:
    return "" if dead_time_ms is None else f"; armed {dead_time_ms:.1f} ms after the previous answer"


LINES: Lines = {Zeroed: _zeroed, Probed: _probed, FootStep: _stepped, BrokenOff: _broken_off}
