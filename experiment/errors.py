"""Every error that palpate raises on purpose; each carries what was found, what is allowed and what to do.

Whoever raises one takes what it is made of from here too.
"""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Self

from palpate.experiment.findings import Finding as Finding
from palpate.experiment.findings import Remedy as Remedy
from palpate.experiment.findings import Verdict as Verdict
from palpate.experiment.findings import counted, summary
from palpate.experiment.findings import mismatch as mismatch


class PalpateError(Exception):
    """Base of all; `str()` is the line shown to the experimenter, made of `finding` once.

    `findings` are the single ones, where `finding` sums up several of one file.
    """

    exit_code = 2

    def __init__(
        self,
        where: Path | str,
        what: str = "",
        remedy: Remedy | str = "",
        *,
        allowed: str = "",
        field: str = "",
        line: int | None = None,
    ) -> None:
        """Say what was found `where`; one argument alone is what was found, nowhere in particular."""
        where, what = (where, what) if what else ("", str(where))
        self.finding = Finding(what, where, line=line, field=field, allowed=allowed, remedy=remedy)
        self.findings: tuple[Finding, ...] = (self.finding,)
        super().__init__(self.finding.sentence())

    @classmethod
    def saying(cls, error: "PalpateError") -> Self:
        """Return an error of this class that says what another does."""
        return cls._built(str(error), error.finding, error.findings)

    @classmethod
    def at(cls, finding: Finding) -> Self:
        """Return the error of a finding."""
        return cls._built(finding.sentence(), finding, (finding,))

    @classmethod
    def in_file(cls, file: Path | str, findings: Sequence[Finding]) -> Self:
        """Return the error of all that is wrong with a file, as the user named it: a heading, and a line for each."""
        lines = (f"{file}: {counted(findings)}", *(f"  {one.clause()}" for one in findings))
        text = "\n".join(line.replace("\n", " ") for line in lines)
        return cls._built(text, summary(file, findings), tuple(replace(one, where=file) for one in findings))

    def followed_by(self, other: "PalpateError") -> Self:
        """Return this error with what came of it, in one line; both are among its findings."""
        return self._built(f"{self}; {other}", self.finding, (*self.findings, *other.findings))

    def sentence(self) -> str:
        """Return all that was found in one line, for a screen or a record that is kept."""
        return "; ".join(one.sentence() for one in self.findings)

    @classmethod
    def _built(cls, text: str, finding: Finding, findings: tuple[Finding, ...]) -> Self:
        made = cls(text)
        made.finding, made.findings = finding, findings
        return made


def cause(ended: BaseException) -> str:
    """Return why something ended, in one line: what was found, or what another error says, or its class's name."""
    return ended.sentence() if isinstance(ended, PalpateError) else str(ended) or type(ended).__name__


class ProtocolError(PalpateError):
    """A protocol file that cannot be used."""


class ScheduleError(PalpateError):
    """An order that no arrangement of trials satisfies."""


class RosterError(PalpateError):
    """An unknown participant, or one that may not run."""


class RigError(PalpateError):
    """A rig file that cannot be used."""


class PublishedError(PalpateError):
    """A file of a study's printed numbers that cannot be used."""


class RecordingError(PalpateError):
    """A recording or a manifest that cannot be used."""


class SynthesisError(PalpateError):
    """Input that no equation of synthesis/ accepts."""


class TrackerError(PalpateError):
    """The foot's serial port cannot be opened or read."""


class TrackerStopped(TrackerError):
    """No frame came within the limit, or the port has gone."""


class ActuatorError(PalpateError):
    """The stimulus could not be handed to the device."""


class PedalError(PalpateError):
    """The participant's pedal cannot be opened, or is silent: nobody could stop with it."""


class ButtonsError(PalpateError):
    """The participant's buttons cannot be opened, are silent, or send what no buttons do."""


class ServoError(PalpateError):
    """The device that pushes the hand cannot be used, or the process that drives it has ended."""


class AudioError(PalpateError):
    """The audio device cannot be opened, does not do what is asked of it, or has stopped."""


class DoseUsedUp(AudioError):
    """The masker may not play on: the dose for 24 hours is used up."""


class VoiceError(PalpateError):
    """A recording of the microphone, or an enrolment of answers, that no answer can be heard with."""


class JournalError(PalpateError):
    """A journal that cannot be trusted or continued."""


class SessionLocked(JournalError):
    """Another runner holds this participant."""


class SessionError(PalpateError):
    """A step that the session's present state does not allow."""


class ScreenGone(PalpateError):
    """The experimenter's screen takes nothing more: its terminal or pipe was closed."""


class DisplayError(PalpateError):
    """The participant's screen cannot be opened."""


class LinkError(PalpateError):
    """A session and its console cannot reach or understand one another."""


class PauseAsked(PalpateError):
    """The experimenter has the session pause."""


class Interrupted(PalpateError):
    """The experimenter ended it at the keyboard."""

    exit_code = 130


class OtherFormat(PalpateError):
    """A file of a format that this palpate does not read; it is not damaged."""


def other_format(
    file: Path,
    what: str,
    got: object,
    known: Sequence[int],
    *,
    line: int | None = None,
    software: str = "",
    mend: Remedy | str = "",
) -> OtherFormat | None:
    """Return the error of a file of this kind (`what`) whose format `got` is not `known`, None where it is.

    `software` wrote it. No release wrote a format below the known ones, nor a file without a number.
    """
    if type(got) is int and got in known:
        return None
    newer = type(got) is int and got > max(known)
    reads = f"format {known[0]}" if len(known) == 1 else f"formats {min(known)} to {max(known)}"
    by = f"{'a newer' if newer else 'an unreleased'} version of palpate"
    number = "has no number" if got is None else f"is {got!r:.20}"
    use = "update palpate" if newer else "open it with that version"
    return OtherFormat(
        file,
        f"made by {by}{f' ({software:.80})' if software else ''}. The format of this {what} {number}; this version "
        f"of palpate reads {reads}. The file is not damaged",
        mend or f"to use it, {use}",
        line=line,
    )


class DatasetError(PalpateError):
    """A dataset that cannot be read, or that would be overwritten."""


class PowerError(PalpateError):
    """A choice model, a number of participants or a cluster that simulated studies cannot be run with."""
