"""What the experimenter says beside answers, at questions or at any moment: all of it goes on record."""

from __future__ import annotations

import threading
from collections.abc import Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

from palpate.experiment.clock import Clock
from palpate.experiment.desk.messages import Correct, Gauges, Lamp, Prompt, Repeat, Reveal, TakeNote, TellIncident
from palpate.experiment.desk.questions import REVEALED, Question, Remark, Report
from palpate.experiment.errors import RosterError
from palpate.experiment.protocol import files
from palpate.experiment.records import entries, journal
from palpate.experiment.records.progress import Progress, progress
from palpate.experiment.session.exposure import SLOW_S, Exposed
from palpate.experiment.session.kind import Kind, Lent
from palpate.experiment.settings import characters
from palpate.experiment.storage import protocol_path
from palpate.experiment.study.admission import own_journals

if TYPE_CHECKING:
    from palpate.experiment.desk.voice.ear import Ear
    from palpate.experiment.protocol.models import Protocol

LITTLE_BYTES = 500_000_000
"""Less free space than this on the dataset's disk is told, bytes."""

REPORTS: Mapping[str, Question] = {
    "report": Report("What does the participant report about the session, in their own words? Do not name anyone."),
    "payment": Report("What was paid or given to the participant? Do not name anyone."),
}
"""What is asked at the end of a visit, by its step: the text or the words of the choice go on record, if any."""

CLOSED = "The session has ended; nothing was changed."


class Remarks:
    """Puts the experimenter's remarks and corrections on record, from any thread; `trial` is None outside of trials."""

    def __init__(self, lent: Lent, kind: Kind, dataset: Path) -> None:
        self.lent, self.kind, self._dataset = lent, kind, dataset
        self.trial: int | None = None
        self.training = False
        """Whether trials are those of the training, so that what is said is of no trial that counts."""
        self._lock = threading.Lock()
        self._open = True

    def close(self) -> None:
        """Take nothing more: the session's last entry follows."""
        with self._lock:
            self._open = False

    def take(self, remark: Remark) -> tuple[bool, str]:
        """Return whether a remark was put on record, and in words what was done, or why not."""
        with self._lock:
            if not self._open:
                return False, CLOSED
            if self.training and isinstance(remark, TakeNote | TellIncident):
                remark = remark.model_copy(update={"trial": None})
            if isinstance(remark, TakeNote):
                if refused := _no_trial(remark, self.lent.log.done.header):
                    return False, refused
                self.lent.log.write(entries.Note(trial=remark.trial, text=remark.text))
                return True, "The note is saved."
            if isinstance(remark, TellIncident):
                note, words = record_incident(self.lent.protocol, self._dataset, self.lent.log.done.header, remark)
                if note is not None:
                    self.lent.log.write(note)
                return note is not None, words
            if isinstance(remark, Reveal):
                return self._reveal()
            done = self.lent.log.done
            if isinstance(remark, Repeat) and done.armed is not None and done.armed[0] == remark.trial:
                self.lent.limits.skip(remark.reason)
                return True, f"Trial {remark.trial} is postponed to the end of its block."
            if remark.trial not in done.answered:
                return False, f"Trial {remark.trial} has no answer that counts; nothing was changed."
            if isinstance(remark, Correct):
                return self._correct(remark)
            if self.lent.protocol.task(done.header.task).levels is not None:
                return (
                    False,
                    f"The answer to trial {remark.trial} determined later levels; correct the answer instead.",
                )
            attempt = done.attempts[remark.trial]
            self.lent.log.write(entries.Redo(trial=remark.trial, attempt=attempt, reason=remark.reason, put_off=True))
            return True, f"Trial {remark.trial} will be repeated; its earlier answer no longer counts."

    def _reveal(self) -> tuple[bool, str]:
        """Put on record that results are shown from now on, if the protocol allows it."""
        if not self.lent.protocol.answers.reveal:
            return False, "The protocol does not allow results to be shown during a session."
        if REVEALED not in self.lent.log.done.visited:
            shown = "the levels of the tracks and the answers by material are shown to the experimenter"
            self.lent.log.write(entries.Visited(step=REVEALED, text=shown))
        return True, "Levels and answers by material are shown from now on. This is recorded."

    def ask_report(self) -> None:
        """Ask, at the end of a visit, for what was not asked or told yet."""
        self.trial = None
        for step, question in REPORTS.items():
            if step in self.lent.log.done.visited:
                continue
            reply = self.lent.console.ask(question)
            if said := reply.text or {one.key: one.words for one in question.choices}.get(reply.key, ""):
                self.lent.log.write(entries.Visited(step=step, text=said))

    def note_ignored(self) -> None:
        """Put on record what was typed before it was asked for."""
        if typed := self.lent.console.ignored():
            self.lent.log.write(entries.Ignored(trial=None if self.training else self.trial, typed=typed))

    def commanded(self, *, by: str, command: str, taken: bool, words: str) -> None:
        """Put on record what was asked for at a console, by whom, and what was replied."""
        with self._lock:
            if self._open:
                self.lent.log.write(entries.Commanded(by=by, command=command, taken=taken, reply=words))

    def shown(self, prompt: Prompt, since_ns: int) -> None:
        """Put on record what the participant's screen shows, since the session time `since_ns`."""
        with self._lock:
            if self._open:
                self.lent.log.write(
                    entries.Shown(show=prompt.on_record, text=prompt.text, pace=prompt.pace, since_ns=since_ns)
                )

    def _correct(self, asked: Correct) -> tuple[bool, str]:
        done = self.lent.log.done
        planned = next(one for one in done.header.order if one.trial == asked.trial)
        meanings = {key: meaning.answer for key, meaning in self.lent.answers(planned).items()}
        answers: dict[str, str | None] = {**meanings, self.lent.protocol.answers.no_answer_key: None}
        if asked.key not in answers:
            allowed = " ".join(answers)
            shown = characters.quoted(asked.key)
            return False, f"{shown} is not the key of an answer; type one of {allowed}. Nothing was corrected."
        answered = answers[asked.key]
        if answered == dict(done.said)[asked.trial]:
            return (
                False,
                f"The answer to trial {asked.trial} is already {answered or 'no answer'}. Nothing was corrected.",
            )
        self.lent.log.write(
            entries.Correction(
                trial=asked.trial,
                attempt=done.attempts[asked.trial],
                answered=answered,
                key=asked.key,
                reason=asked.reason,
            )
        )
        return True, f"Trial {asked.trial}: correction saved: {answered or 'no answer'}."


@dataclass(frozen=True, kw_only=True)
class Attendance:
    """Implements `Attended`: a session under way, for a desk that asks at any time."""

    remarks: Remarks
    exposed: Exposed
    ear: Ear | None

    def gauges(self) -> Gauges:
        measured, done = self.remarks.kind.measured(), self.exposed.log.done
        masker = self.exposed.masking.exposure if self.exposed.masking is not None else None
        heard = () if self.ear is None else (self.ear.lamp(),)
        return Gauges(
            left_s=self.exposed.left_s,
            masker_db_a=masker.level_db_a if masker else None,
            masker_limit_db_a=self.exposed.masking.limit_db_a if self.exposed.masking is not None else None,
            dose=masker.dose if masker else None,
            stimuli=done.stimuli,
            vibration_s=done.vibration_s,
            **(dict(measured) | {"lamps": (*measured.lamps, *self._audio(), *heard, self._disk())}),
        )

    def done(self) -> Progress:
        return self.exposed.log.done

    def remark(self, remark: Remark) -> tuple[bool, str]:
        return self.remarks.take(remark)

    def pause(self, why: str) -> None:
        self.exposed.pause(why)

    def commanded(self, *, by: str, command: str, taken: bool, words: str) -> None:
        self.remarks.commanded(by=by, command=command, taken=taken, words=words)

    def shown(self, prompt: Prompt, ago_ns: int) -> None:
        self.remarks.shown(prompt, self.exposed.clock.now_ns() - ago_ns)

    def _audio(self) -> tuple[Lamp, ...]:
        if self.exposed.stream is None:
            return ()
        marked, gaps = self.exposed.stream.xruns, self.exposed.stream.gaps
        return (Lamp(name="audio", good=not gaps, words=f"gaps: {gaps}, late blocks: {marked}"),)

    def _disk(self) -> Lamp:
        # Nothing is asked of the disk here: whoever shows this must not wait for it.
        if (waiting_s := self.exposed.log.waiting_s) > SLOW_S:
            return Lamp(name="disk", good=False, words=f"no answer for {waiting_s:.0f} s")
        free = self.exposed.free_bytes
        if free is None:
            return Lamp(name="disk", good=None, words="free space not known")
        return Lamp(
            name="disk",
            good=free > LITTLE_BYTES,
            words=f"{free / 1e9:.1f} GB free" if free >= 1e9 else f"{free / 1e6:.0f} MB free",
        )


class Paused:
    """`Attended` for a paused or complete session: notes follow its footer; no file is held in between."""

    def __init__(self, dataset: Path, path: Path, contents: journal.Contents, clock: Clock) -> None:
        """Tell of the session of a dataset whose journal at `path` has these contents."""
        self._dataset, self._path = dataset, path
        self._header = contents.header
        self._done = progress(contents.entries)
        self.clock = clock

    def gauges(self) -> None:
        return None

    def done(self) -> Progress:
        return self._done

    def remark(self, remark: Remark) -> tuple[bool, str]:
        if isinstance(remark, TellIncident):
            protocol = files.load(protocol_path(self._dataset))
            note, words = record_incident(protocol, self._dataset, self._header, remark)
            if note is not None and not self._write(note):
                words += " It cannot be recorded in the journal now."
            return note is not None, words
        if not isinstance(remark, TakeNote):
            return False, "The session is paused, so nothing was changed. Continue the session, then try again."
        if refused := _no_trial(remark, self._header):
            return False, refused
        if not self._write(entries.Note(trial=remark.trial, text=remark.text)):
            return False, "No note can be saved in this session now. Write it down on paper, then run palpate status."
        return True, "The note is saved."

    def pause(self, why: str) -> None:
        """Do nothing: it is paused."""

    def commanded(self, *, by: str, command: str, taken: bool, words: str) -> None:
        self._write(entries.Commanded(by=by, command=command, taken=taken, reply=words))

    def shown(self, prompt: Prompt, ago_ns: int) -> None:
        since_ns = self.clock.now_ns() - ago_ns
        self._write(entries.Shown(show=prompt.on_record, text=prompt.text, pace=prompt.pace, since_ns=since_ns))

    def _write(self, entry: entries.Note | entries.Commanded | entries.Shown) -> bool:
        """Put an entry on record; return False where none may follow: after a withdrawal, or a line cut off."""
        with journal.locked(self._path.parent, self._header.participant):
            contents = journal.read_if_begun(self._path)
            if not contents.lines or contents.torn or isinstance(contents.entries[-1], entries.Withdrawal):
                return False
            with closing(journal.Journal(self._path, self.clock, contents)) as opened:
                opened.append(entry)
            return True


def paused(dataset: Path, participant: str, tasks: Sequence[str], task_id: str, clock: Clock) -> Paused | None:
    """Return a person's session of a task, or of the last of these tasks in order that has begun; None without."""
    for path in own_journals(dataset, participant, (task_id, *reversed(tasks))).values():
        contents = journal.read_if_begun(path)
        if contents.lines:
            return Paused(dataset, path, contents, clock)
    return None


def record_incident(
    protocol: Protocol, dataset: Path, header: entries.Header, told: TellIncident
) -> tuple[entries.Note | None, str]:
    """Put an incident into the roster; practice has none. Return its note, None if it was refused, and a reply."""
    if header.purpose not in ("STUDY", "PILOT"):
        text = f"{told.sort.capitalize()}: {told.text.rstrip('.')}. Done: {told.done}"
        return entries.Note(trial=told.trial, text=text), "The note is saved. Practice has no roster."
    incidents = import_module("palpate.experiment.study.people.incidents")
    try:
        made = incidents.report(protocol, dataset, told.sort, what=told.text, done=told.done)
    except RosterError as refused:
        return None, refused.sentence()
    text = f"{made.kind} {made.number} in the roster"
    inform = f"palpate incident PROTOCOL --number {made.number} --informed-on DAY"
    words = f"Recorded as {text}. After informing the board, run: {inform}"
    return entries.Note(trial=told.trial, text=f"{text[:1].upper()}{text[1:]}."), words


def _no_trial(note: TakeNote, header: entries.Header) -> str:
    """Return why a note cannot go on record: its trial is not one of the session's; or nothing."""
    if note.trial is None or note.trial in {planned.trial for planned in header.order}:
        return ""
    return f"Trial {note.trial}: this session has trials 1 to {len(header.order)}; the note was not written."
