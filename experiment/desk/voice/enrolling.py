"""Has a participant say every answer twice, to compare with, and saves their cepstra, never a sound, for the visit.

Its file is for its owner alone, outside of every dataset. The end of the visit deletes it.
"""

import io
import zipfile
from collections.abc import Mapping, Sequence
from concurrent.futures import BrokenExecutor, Executor
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from palpate.experiment import storage
from palpate.experiment.apparatus.audio.microphone import Microphone
from palpate.experiment.clock import Clock, wall_ns
from palpate.experiment.desk.console import transport
from palpate.experiment.desk.questions import WITHOUT, Console, Notice, Say
from palpate.experiment.desk.voice import ear, hearing
from palpate.experiment.desk.voice.hearing import BEFORE_S, LISTENED_S
from palpate.experiment.desk.voice.matching import Enrolment, Take, enrolled, unlike
from palpate.experiment.errors import LinkError, VoiceError

TAKES = 2
"""Of each answer: fewer do not say how far apart they are."""

MOST_ROUNDS = 4
"""So often at most unlike takes are taken again; then the session goes on without the microphone."""

WAITS_S = 6.0
"""For an answer that was announced so long, s."""

HOLDS_S = 12 * 3600.0
"""No visit is longer: what was kept before is of another one, s."""

FORMAT = "palpate voice 1"


@dataclass(frozen=True)
class Enroller:
    """Who is enrolled, and with what; `answers` are what is said for each answer, and `file` keeps what is computed."""

    answers: Mapping[str, str]
    microphone: Microphone
    computing: Executor
    console: Console
    clock: Clock
    file: Path | None

    def enrol(self) -> tuple[Enrolment | None, str]:
        """Return the enrolment, None to go on without the microphone, and how that came about, in words.

        Raises `PalpateError` if the device has stopped, or the experimenter pauses.
        """
        if kept := load(self.file, self.answers):
            return enrolled(kept), "it uses the participant's recordings from earlier in this visit"
        takes: dict[str, list[Take]] = {}
        due, again = tuple(self.answers), 0
        while again < MOST_ROUNDS:
            takes |= {answer: [] for answer in due}
            for number in range(1, TAKES + 1):
                for answer in due:
                    try:
                        take = self._take(answer, number)
                    except (BrokenExecutor, TimeoutError) as error:
                        return None, f"the recorded speech could not be analyzed ({error or type(error).__name__})"
                    if take is None:
                        return None, "the experimenter chose to continue without it"
                    takes[answer].append(take)
            wrong = unlike(takes)
            if not wrong:
                save(self.file, self.answers, takes)
                return enrolled(takes), f"the participant said each of {len(takes)} answers {TAKES} times"
            due, again = tuple(answer for answer in takes if answer in {*wrong, *wrong.values()}), again + 1
            pairs = "; ".join(f"'{self.answers[a]}' sounded more like '{self.answers[b]}'" for a, b in wrong.items())
            self.console.tell(
                Notice(
                    f"The recordings of some answers differ: {pairs}. Record these answers again, spoken as in a trial."
                )
            )
        return None, f"recordings of the same answer differed in {MOST_ROUNDS} attempts"

    def _take(self, answer: str, number: int) -> Take | None:
        """Return a take of an answer, asked for until there is one; None if it is not to be asked for."""
        why = ""
        while self.console.ask(Say(self.answers[answer], number, TAKES, why)).key != WITHOUT:
            try:
                return self._next_take()
            except VoiceError as error:
                said = error.finding.clause()
                why = f"{said[:1].upper()}{said[1:]}."
        return None

    def _next_take(self) -> Take:
        """Return what is said from now on, once it is over. Raises `VoiceError`."""
        microphone, begun_ns = self.microphone, self.clock.now_ns()
        rate_hz = microphone.rate_hz
        before = microphone.heard(from_ns=begun_ns - int(LISTENED_S * 1e9), until_ns=begun_ns)
        computed = partial(ear.computed, self.computing, rate_hz=rate_hz)
        background = computed(hearing.listen, before)
        from_ns = begun_ns - int((BEFORE_S + ear.BEYOND_S) * 1e9)
        while True:
            self.clock.sleep_ns(int(ear.LOOK_S * 1e9))
            now_ns = self.clock.now_ns()
            recorded = microphone.heard(from_ns=from_ns, until_ns=now_ns)
            lasts_s, answerable_s = len(recorded.microphone) / rate_hz, (begun_ns - recorded.begins_ns) / 1e9
            ended_s = computed(hearing.ended_s, recorded, answerable_s=answerable_s, background=background)
            over = now_ns - begun_ns > WAITS_S * 1e9
            if over or (ended_s is not None and lasts_s - ended_s > ear.SETTLED_S):
                taken: Take = computed(hearing.take, recorded, answerable_s=answerable_s, background=background)
                return taken


def place(dataset: Path, participant: str) -> Path | None:
    """Return where a participant's takes are kept during a visit; None where the system has no such place."""
    try:
        return transport.place(dataset, participant).with_suffix(".voice")
    except LinkError:
        return None


def save(file: Path | None, answers: Mapping[str, str], takes: Mapping[str, Sequence[Take]]) -> None:
    """Keep takes of answers, each with what is said for it; where that is not possible they are asked for again."""
    if file is None:
        return
    made = io.BytesIO()
    said = np.array([[answer, answers[answer]] for answer in takes])
    arrays = {f"{i}.{n}": take for i, every in enumerate(takes.values()) for n, take in enumerate(every)}
    np.savez(made, format=np.array(FORMAT), said=said, **arrays)  # type: ignore[arg-type]
    with suppress(OSError):
        ear.keep(file, made.getvalue())


def load(file: Path | None, answers: Mapping[str, str]) -> dict[str, list[Take]] | None:
    """Return the takes that are kept of these answers; None without any, of other answers, or of another visit."""
    try:
        if file is None or not 0 <= wall_ns() / 1e9 - file.stat().st_mtime < HOLDS_S:
            return None
        with np.load(io.BytesIO(storage.read_bytes(file)), allow_pickle=False) as kept:
            if str(kept["format"]) != FORMAT or kept["said"].tolist() != [list(pair) for pair in answers.items()]:
                return None
            takes = {answer: [kept[f"{i}.{n}"] for n in range(TAKES)] for i, answer in enumerate(answers)}
    except (OSError, EOFError, ValueError, KeyError, zipfile.BadZipFile):
        return None
    return takes if not unlike(takes) else None


def forget(file: Path | None) -> None:
    """Delete what is kept, at the end of a visit."""
    if file is not None:
        file.unlink(missing_ok=True)
