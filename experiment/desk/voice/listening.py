"""What a session has of its participant's voice: the microphone with what computes, an ear, and the enrolment."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from concurrent.futures import Executor
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

from palpate.experiment.apparatus.audio.microphone import Microphone
from palpate.experiment.apparatus.audio.stream import AudioStream
from palpate.experiment.apparatus.rig import Rig
from palpate.experiment.clock import Clock
from palpate.experiment.desk.questions import Console, Notice
from palpate.experiment.desk.voice import ear, enrolling
from palpate.experiment.desk.voice.ear import Ear
from palpate.experiment.records.entries import Spoken


@dataclass(frozen=True)
class Listening:
    """A microphone, and what computes what it heard."""

    microphone: Microphone
    computing: Executor

    def begin(
        self, console: Console, clock: Clock, *, write: Callable[[Spoken], None], task: str, voices: Path | None
    ) -> Ear:
        """Return what listens to the answers of one session, as `Ear`."""
        return Ear(
            microphone=self.microphone,
            computing=self.computing,
            console=console,
            clock=clock,
            write=write,
            task=task,
            voices=voices,
        )

    def enrol(self, listener: Ear, answers: Mapping[str, str], dataset: Path, participant: str) -> str:
        """Have the answers said, to compare with, once in a visit; return in words what is proposed, and how come."""
        listener.enrolment, how = enrolling.Enroller(
            answers=answers,
            microphone=self.microphone,
            computing=self.computing,
            console=listener.console,
            clock=listener.clock,
            file=enrolling.place(dataset, participant),
        ).enrol()
        return f"the microphone {'proposes answers' if listener.enrolment else 'proposes nothing'}: {how}"


def open_listening(rig: Rig, stream: AudioStream | None, console: Console, opened: ExitStack) -> Listening | None:
    """Open the rig's microphone on the session's stream, and what computes; tell the console where there is none."""
    microphone = None if stream is None else ear.open_microphone(rig, stream=stream)
    if microphone is None:
        console.tell(Notice("The rig has no microphone (audio.channels.microphone), so no answers are proposed."))
        return None
    return Listening(microphone, opened.enter_context(ear.computing()))
