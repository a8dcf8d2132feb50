"""Every error that palpate raises on purpose; each says what it got, what is allowed and what to do."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass


class PalpateError(Exception):
    """Base of all; `str()` is the line shown to the experimenter."""

    exit_code = 2


@dataclass(frozen=True)
class Problem:
    """One thing wrong in a file: where it stands, what was got, what is allowed."""

    path: str
    line: int | None
    got: str
    allowed: str

    def __str__(self) -> str:
        where = f"line {self.line}: " if self.line is not None else ""
        return f"{where}{self.path}: got {self.got}; allowed: {self.allowed}"


class ProtocolError(PalpateError):
    """A protocol file that cannot be used: `file` as the user named it, and every problem by line."""

    def __init__(self, file: str, problems: Sequence[Problem]) -> None:
        self.file = file
        self.problems = tuple(problems)
        count = len(self.problems)
        head = f"{file}: {count} error{'s' if count != 1 else ''}"
        super().__init__("\n".join(line.replace("\n", " ") for line in (head, *(f"  {p}" for p in self.problems))))

    def __reduce__(self) -> tuple[type[ProtocolError], tuple[str, tuple[Problem, ...]]]:
        """Let the error pass whole from one process to another."""
        return ProtocolError, (self.file, self.problems)


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
    file: object, what: str, got: object, known: int, *, software: str = "", remedy: str = ""
) -> OtherFormat | None:
    """Return the error of a file of this kind (`what`) whose format `got` is not the `known` one, None where it is.

    `software` wrote it. No release wrote a format below the known one, nor a file without a number.
    """
    if type(got) is int and got == known:
        return None
    newer = type(got) is int and got > known
    by = f"{'a newer' if newer else 'an unreleased'} palpate"
    number = "has no number" if got is None else f"is {got!r:.20}"
    use = "install a newer palpate" if newer else "read it with the palpate that made it"
    return OtherFormat(
        f"{file}: made by {by}{f' ({software:.80})' if software else ''}. The format of this {what} {number}; this "
        f"palpate reads format {known}. The file is not damaged. To use it, {remedy or use}"
    )


class DatasetError(PalpateError):
    """A dataset that cannot be read, or that would be overwritten."""


class PowerError(PalpateError):
    """A choice model, a number of participants or a cluster that simulated studies cannot be run with."""
