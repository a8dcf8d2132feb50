"""A journal as lines that people read."""

from __future__ import annotations

from experiment.clock import utc
from experiment.records.entries import Answer, Footer, Header, MaskerSet, Phase, Redo, Resumed, TrackerOpened
from experiment.records.footstep import BrokenOff, FootStep, Zeroed
from experiment.records.journal import AnyEntry, Contents
from experiment.records.progress import progress
from experiment.records.stimulus import Onset


def text(contents: Contents) -> str:
    """The whole journal: what the session is, each entry with its time, and what remains.

    Args:
        contents: a journal that was read, and so verified.
    """
    header = contents.header
    zero_ns = contents.lines[0].t_ns
    done = progress(contents.entries)
    lines = [
        *(["REHEARSAL - simulated participant"] if header.rehearsal else []),
        f"Study {header.study}, participant {header.participant}, task {header.task} (number {header.task_position})",
        f"Begun {header.started_utc} with {header.software}, rig {header.rig}, seed {header.seed}",
        f"Protocol SHA-256 {header.protocol_sha256}",
        f"{len(contents.lines)} lines, each carrying the hash of the one before: verified",
        "",
    ]
    lines += [f"{(line.t_ns - zero_ns) / 1e9:10.3f} s  {_said(line.entry)}" for line in contents.lines[1:]]
    lines += ["", f"Answered {len(done.answered)} of {len(header.order)}; last entry {utc(contents.lines[-1].t_ns)}"]
    if contents.torn:
        lines.append(f"A torn last line of {len(contents.torn)} bytes was left out: it was never confirmed.")
    if done.footer is None:
        lines.append("The session has no footer: its runner ended without saying why. It can be resumed.")
    return "\n".join(lines)


def _said(entry: AnyEntry) -> str:
    match entry:
        case Header():
            return "header"
        case TrackerOpened():
            return f"tracker opened at {entry.port}, device time {entry.device_us} us"
        case Zeroed():
            return f"zeroed: the foot rests at {entry.offset_mm:+.2f} mm from contact, spread {entry.spread_mm:.2f} mm"
        case MaskerSet():
            level = "silent" if entry.level_db_a is None else f"at {entry.level_db_a:.0f} dB(A)"
            return f"masker {level}; {entry.dose:.1%} of the day's dose"
        case Phase():
            return f"{entry.state} {entry.detail}".rstrip()
        case FootStep():
            link = entry.link
            played = "a stimulus played" if entry.stimulus else "no stimulus"
            return (
                f"trial {entry.trial}.{entry.attempt}: {_presented(entry)}, {entry.speed_mm_s:.1f} mm/s, {played}; "
                f"frames {link.received} received, {link.lost} lost, {link.damaged} damaged, {link.repeated} repeated"
                f"{_met(entry.onset)}{_dead(entry.dead_time_ms)}"
            )
        case BrokenOff():
            again = "put off to the end of the block" if entry.felt else "armed again"
            said = f"trial {entry.trial}.{entry.attempt}: {_presented(entry)}, broken off and {again}: {entry.reason}"
            return f"{said}{_dead(entry.dead_time_ms)}"
        case Answer():
            answered = entry.answered or "no answer"
            return f"trial {entry.trial}.{entry.attempt}: answered {answered} after {entry.response_time_s:.2f} s"
        case Redo():
            again = "put off to the end of the block" if entry.put_off else "done again"
            return f"trial {entry.trial}.{entry.attempt} does not count and is {again}: {entry.reason}"
        case Resumed():
            torn = f"; dropped a torn line of {len(entry.torn)} characters" if entry.torn else ""
            return f"resumed with {len(entry.remaining)} trials left{torn}"
        case Footer():
            return f"ended: {entry.reason}{f' ({entry.detail})' if entry.detail else ''}"


def _presented(entry: FootStep | BrokenOff) -> str:
    return " and ".join(entry.presented)


def _met(onset: Onset | None) -> str:
    """How onset and contact met, as far as is known."""
    if onset is None:
        return ""
    said = ""
    if onset.prediction_error_ms is not None:
        said += f"; contact predicted {onset.prediction_error_ms:+.2f} ms off"
    if onset.gate_to_scheduled_ms is not None:
        said += f"; scheduled {onset.gate_to_scheduled_ms:.2f} ms after the gate"
    if onset.delivered is None:
        return said
    heard = onset.delivered
    off = f"onset {heard.onset_error_ms:+.3f} ms off what was asked" if heard.onset_error_ms is not None else "no onset"
    return f"{said}; {off}, {heard.xruns} xruns{'' if heard.delivered else f', undelivered: {heard.reason}'}"


def _dead(dead_time_ms: float | None) -> str:
    """How long after the answer before it an attempt was armed, if that is known."""
    return "" if dead_time_ms is None else f"; armed {dead_time_ms:.1f} ms after the answer before"
