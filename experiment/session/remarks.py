"""What the experimenter says beside answers: notes, corrections of answers, and what was typed too early."""

from __future__ import annotations

from experiment.desk.port import Console, Corrected, Noted, Remark
from experiment.protocol.models import Answers
from experiment.records.entries import Correction, Ignored, Note
from experiment.session.kind import Kind, Log


class Remarks:
    """Puts on record what the experimenter says; an answer of the session can be corrected until its end."""

    def __init__(self, *, spoken: Answers, kind: Kind, console: Console, log: Log) -> None:
        self._spoken = spoken
        self._kind = kind
        self._console = console
        self._log = log

    def take(self, remark: Remark, trial: int | None) -> None:
        """Put a remark on record that was made at `trial`, or say why it is refused."""
        if isinstance(remark, Noted):
            self._log.write(Note(trial=trial, text=remark.text))
            self._console.show("The note is on disk.")
        else:
            self._correct(remark)

    def note_ignored(self, trial: int | None) -> None:
        """Put on record what was typed before it was asked for."""
        if typed := self._console.ignored():
            self._log.write(Ignored(trial=trial, typed=typed))

    def _correct(self, asked: Corrected) -> None:
        done = self._log.done
        if asked.trial not in done.answered:
            self._console.show(f"Trial {asked.trial} has no answer that counts; nothing was corrected.")
            return
        planned = next(one for one in done.header.order if one.trial == asked.trial)
        meanings = {key: meaning.answer for key, meaning in self._kind.answers(planned).items()}
        answers: dict[str, str | None] = {**meanings, self._spoken.no_answer_key: None}
        if asked.key not in answers:
            allowed = " ".join(answers)
            self._console.show(
                f"'{asked.key}' does not stand for an answer; type one of {allowed}. Nothing was corrected."
            )
            return
        answered = answers[asked.key]
        self._log.write(
            Correction(
                trial=asked.trial,
                attempt=done.attempts[asked.trial],
                answered=answered,
                key=asked.key,
                reason=asked.reason,
            )
        )
        self._console.show(f"Trial {asked.trial}: the correction is on disk: {answered or 'no answer'}.")
