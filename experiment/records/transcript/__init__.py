"""A journal as text for people to read; a kind of trial has the lines of its own entries in the module of its name."""

import textwrap
from collections.abc import Callable, Mapping
from importlib import import_module
from typing import Any

from palpate.experiment.clock import utc
from palpate.experiment.errors import JournalError
from palpate.experiment.records import entries
from palpate.experiment.records.entries import Entry
from palpate.experiment.records.journal import Contents, Line, Unreadable
from palpate.experiment.records.progress import progress
from palpate.experiment.settings.characters import keyed, plain

WIDTH = 100
"""No line of a transcript is wider, in characters."""

PACE = {"slow": "too slow", "right": "in range", "fast": "too fast"}
"""The pace of a step, in words."""

INDENT = " " * 14
"""Stands where the time of an entry stands, in each further line of it."""

Lines = Mapping[type[Entry], Callable[[Any], str]]
"""Entries of a kind of trial, each with what makes its line."""


def text(contents: Contents, trial: int | None = None) -> str:
    """Return a verified journal, or one `trial` of it, as text. Raises `JournalError` for an unknown trial."""
    header = contents.header
    zero_ns = contents.lines[0].t_ns
    done = progress(contents.entries)
    lines = [
        *([f"{header.purpose}: not a session of a study"] if header.purpose != "STUDY" else []),
        f"Study {header.study}, participant {header.participant}, task {header.task} (number "
        f"{header.task_position} of the participant's tasks).",
        f"The session began at {header.started_utc} with {header.software} and rig {header.rig}.",
        f"The SHA-256 of the protocol is {header.protocol_sha256}.",
        f"The journal has {contents.end.count} lines. Each contains the hash of the previous line; all were verified.",
        "",
    ]
    shown = _shown_lines(contents) if trial is None else _trial_lines(contents, trial)
    lines += [f"{(line.t_ns - zero_ns) / 1e9:10.3f} s  {_entry_text(line, header.task_kind)}" for line in shown]
    if trial is not None and not shown:
        lines.append(f"Trial {trial} has not started yet.")
    lines += [
        "",
        f"{len(done.answered)} of {done.trials} trials have been answered. The last entry was written at "
        f"{utc(contents.lines[-1].t_ns)}.",
    ]
    if contents.torn:
        lines.append(f"The last line is incomplete: {len(contents.torn)} unconfirmed bytes were left out.")
    if done.footer is None:
        gone = any(isinstance(entry, entries.Withdrawal) for entry in contents.entries)
        state = "it was interrupted" if gone else "it is running, or it was interrupted and can be resumed"
        lines.append(f"The session has no footer: {state}.")
    fill = textwrap.TextWrapper(WIDTH, subsequent_indent=INDENT, break_on_hyphens=False).fill
    return "\n".join(fill(plain(line, keep="")) for line in lines)


def _shown_lines(contents: Contents) -> list[Line | Unreadable]:
    # There is an exposure every few seconds; the last one says what the others said.
    everything = contents.in_order()
    last = max((n for n, line in enumerate(everything) if _is_exposure(line)), default=0)
    return [line for n, line in enumerate(everything) if n and (n == last or not _is_exposure(line))]


def _trial_lines(contents: Contents, trial: int) -> list[Line | Unreadable]:
    order = contents.header.order
    if trial not in {planned.trial for planned in order}:
        raise JournalError(f"trial {trial}", "this session has none", "give another", allowed=f"1 to {len(order)}")
    everything = contents.in_order()
    return [line for line in everything if isinstance(line, Unreadable) or getattr(line.entry, "trial", 0) == trial]


def _is_exposure(line: Line | Unreadable) -> bool:
    return isinstance(line, Line) and isinstance(line.entry, entries.Exposure)


def _entry_text(line: Line | Unreadable, task_kind: str) -> str:
    if isinstance(line, Unreadable):
        return f"line {line.number} CANNOT BE READ: {line.why}"
    entry = line.entry
    match entry:
        case entries.Header():
            return "header"
        case entries.TrackerOpened():
            return f"the tracker was opened at {entry.port}; its clock showed {entry.device_us} us"
        case entries.MaskerSet():
            level = "silent" if entry.level_db_a is None else f"at {entry.level_db_a:.0f} dB(A)"
            return f"the masker is {level}; {entry.dose:.1%} of the 24-hour dose has been used"
        case entries.Exposure():
            dose = "" if entry.dose is None else f"; {entry.dose:.1%} of the masker's 24-hour dose has been used"
            return f"so far, {entry.stimuli} stimuli have been played, {entry.vibration_s:.1f} s in total{dose}"
        case entries.Phase():
            return f"{entry.state} {entry.detail}".rstrip()
        case entries.LevelChosen():
            return f"{entry.label}: level {entry.level:g} of track {entry.track}"
        case entries.TrackEnded():
            return f"the track {entry.track} ended: {entry.why}"
        case entries.Armed():
            return f"{entry.label}: {' and '.join(entry.presented)}, armed"
        case entries.Answer():
            answer = f"answered {entry.answered}" if entry.answered else "no answer was given"
            pressed = ", pressed by the participant" if entry.by == "participant" else ""
            return f"{entry.label}: {answer} after {entry.response_time_s:.2f} s{pressed}"
        case entries.Trained():
            right = {None: "", True: ", correct", False: ", incorrect"}[entry.right]
            return f"training, {_entry_text(Line(line.t_ns, entry.entry), task_kind)}{right}"
        case entries.TrainingEnded():
            reached = {None: "", True: "; the criterion was reached", False: "; the criterion was NOT reached"}
            ends = ", so the task has no trials" if entry.ends else ""
            return (
                f"the training ended: {entry.right} of {entry.answered} answers correct{reached[entry.reached]}{ends}"
            )
        case entries.Spoken():
            return f"{entry.label}: {_heard(entry)}"
        case entries.Correction():
            answer = entry.answered or "no answer"
            return f"{entry.label}: the answer was corrected to {answer}: {entry.reason}"
        case entries.Note():
            return f"note{'' if entry.trial is None else f' at trial {entry.trial}'}: {entry.text}"
        case entries.Visited():
            return f"{entry.step}: {entry.text}"
        case entries.Questioned():
            return f"{entry.step}: {'no answer' if entry.answer is None else entry.answer}"
        case entries.Commanded():
            refused = "" if entry.taken else f", refused: {entry.reply}"
            return f"requested by {entry.by}: {entry.command}{refused}"
        case entries.Shown():
            pace = "" if entry.pace is None else f", the previous step was {PACE[entry.pace]}"
            text = f": {entry.text}" if entry.text else ""
            return f"the participant's screen shows '{entry.show}'{pace}{text}"
        case entries.Ignored():
            return f"ignored because it was typed before the question appeared: {keyed(entry.typed)}"
        case entries.Redo():
            again = "postponed to the end of the block" if entry.put_off else "repeated"
            return f"{entry.label} does not count and is {again}: {entry.reason}"
        case entries.Triggers():
            return "triggers: " + ", ".join(map(_trigger, entry.sent))
        case entries.Resumed():
            return f"the session was resumed with {len(entry.remaining)} trials left{_torn(entry.torn)}"
        case entries.Footer():
            still = "; its last stimulus may still be playing" if entry.silent is False else ""
            return f"the session ended: {entry.reason}{f' ({entry.detail})' if entry.detail else ''}{still}"
        case entries.Withdrawal():
            return f"the participant has withdrawn ({entry.reason}){_torn(entry.torn)}: their data are not analyzed"
        case _:
            lines: Lines = import_module(f"{__name__}.{task_kind}").LINES
            return lines[type(entry)](entry)


def _trigger(one: entries.Trigger) -> str:
    late = f"LOST ({one.problem})" if one.late_ms is None else f"{one.late_ms:.2f} ms after the event"
    return f"{one.number} for {one.event} on line {one.line}, {late}"


def _heard(entry: entries.Spoken) -> str:
    if entry.problem:
        return f"the microphone recorded nothing: {entry.problem}"
    if entry.onset_s is None:
        return "the microphone detected no speech"
    what = f"and {entry.proposed} was proposed" if entry.proposed else "and no answer was proposed"
    kept = "; the recording is saved" if entry.sound else ""
    return f"speech began after {entry.onset_s:.2f} s, {what} (agreement {entry.agreement:.2f}){kept}"


def _torn(torn: str) -> str:
    return f"; an incomplete line of {len(torn)} characters was dropped" if torn else ""
