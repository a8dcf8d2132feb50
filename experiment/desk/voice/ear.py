"""Listens to what a participant answers, beside the session: no key and no question ever waits for it.

From contact on, a thread takes what the microphone heard, a process computes what that was (`hearing`), and the console
proposes it. What was heard until an answer was chosen goes on record once that is confirmed, which may be after the
next trial was armed. Nothing is computed while a foot is awaited.
"""

import hashlib
import io
import multiprocessing
import signal
import threading
import wave
from collections.abc import Callable, Iterator
from concurrent.futures import BrokenExecutor, Executor, ProcessPoolExecutor
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from functools import partial
from multiprocessing import connection
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from palpate.experiment import storage
from palpate.experiment.apparatus import host
from palpate.experiment.apparatus.audio.microphone import AudioMicrophone, Microphone, Recorded, objection
from palpate.experiment.apparatus.audio.stream import AudioStream
from palpate.experiment.apparatus.host import beside
from palpate.experiment.apparatus.opening import audio_of
from palpate.experiment.apparatus.rig import Rig
from palpate.experiment.clock import Clock
from palpate.experiment.desk.messages import Lamp
from palpate.experiment.desk.questions import Console, Proposed
from palpate.experiment.desk.voice import hearing
from palpate.experiment.desk.voice.features import RATE_HZ
from palpate.experiment.desk.voice.hearing import BEFORE_S, LISTENED_S, SILENCE, Background, Heard
from palpate.experiment.desk.voice.matching import Enrolment
from palpate.experiment.errors import PalpateError, cause
from palpate.experiment.records.entries import Spoken

LOOK_S = 0.2
"""What was said is looked at so often, s."""

SETTLED_S = 0.3
"""An utterance is over after so long a silence, s: a longer one than lies within an utterance."""

LONGEST_S = 20.0
"""So long after contact nobody is listened to any more, s: what the stream keeps reaches not much farther."""

AFTER_S = 0.3
"""What is said so long after the key was chosen may still be the answer, s: its end, for whoever is quick."""

AROUND_S = 0.3
"""So much before and after what was said is kept of its sound, s."""

BEYOND_S = 0.05
"""So much more than it needs is computed with, s."""

PATIENCE_S = 10.0
"""Whoever computes is waited for so long at most, s: by this thread, and by the end of a session."""

ENDS_S = 1.0
"""A process that does not end within so long, s, stands still, and is killed."""

CLIPPED_S = 5.0
"""So long the lamp tells of a clipped sample, s."""


def open_microphone(rig: Rig, *, stream: AudioStream) -> Microphone | None:
    """Return the rig's microphone, an input of the session's stream; None where the rig has none."""
    audio = audio_of(rig)
    return AudioMicrophone(stream, audio) if audio.channels.microphone is not None else None


@contextmanager
def computing() -> Iterator[Executor]:
    """Give a process that computes what was heard, on a core and at a priority that takes nothing from the session."""
    context, others = multiprocessing.get_context("spawn"), multiprocessing.active_children()
    with storage.safe_path(), ProcessPoolExecutor(1, mp_context=context, initializer=_settle) as pool:
        with host.elsewhere(), beside.held_back():
            # It loads what it needs now, and not when the first answer is given.
            pool.submit(_ready)
        workers = [one for one in multiprocessing.active_children() if one not in others]
        try:
            yield pool
        finally:
            pool.shutdown(wait=False, cancel_futures=True)
            for one in workers:
                if not connection.wait([one.sentinel], ENDS_S):
                    one.kill()


def _settle() -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    beside.be_ordinary()
    beside.end_with_parent()


def _ready() -> None:
    """Do nothing: whoever calls it has imported this module."""


def computed(by: Executor, what: Callable[..., Any], recorded: Recorded, **facts: object) -> Any:
    """Return what is computed of a recording by another process. Raises what that raises, and `TimeoutError`."""
    return by.submit(what, recorded.microphone, recorded.played, **facts).result(PATIENCE_S)


@dataclass
class _Attempt:
    """What is listened to: from `answerable_ns` on, until `until_ns` once that is known; both session time."""

    trial: int
    attempt: int
    answerable_ns: int
    until_ns: int | None = None
    dropped: bool = False
    ended: threading.Event = field(default_factory=threading.Event)


@dataclass(kw_only=True, eq=False)
class Ear:
    """Listens to the answers of one session, once there is an `enrolment`; nothing is listened to yet.

    `write` puts an entry into the journal; sounds of the `task` are kept in `voices`, which is None where none is.
    """

    microphone: Microphone
    computing: Executor
    console: Console
    clock: Clock
    write: Callable[[Spoken], None]
    task: str
    voices: Path | None

    def __post_init__(self) -> None:
        self.enrolment: Enrolment | None = None
        self._computed = partial(computed, self.computing, rate_hz=self.microphone.rate_hz)
        self._lock = threading.Lock()
        self._open = True
        self._now: _Attempt | None = None
        self._thread: threading.Thread | None = None
        self._problem = ""
        self._clipped_ns: int | None = None

    def listen(self, trial: int, attempt: int, answerable_ns: int) -> None:
        """Listen from now on to the answer of an attempt, which could be given from a session time on."""
        if self.enrolment is None:
            return
        self._now = _Attempt(trial, attempt, answerable_ns)
        with host.elsewhere():
            self._thread = threading.Thread(target=self._follow, args=(self._now, self._thread), name="ear")
            self._thread.daemon = True
            self._thread.start()

    def answered(self, chosen_ns: int) -> None:
        """Have what was heard until the key was chosen, at a session time, put on record as soon as it is computed."""
        if (one := self._now) is not None:
            one.until_ns = min(self.clock.now_ns(), chosen_ns + int(AFTER_S * 1e9))
            one.ended.set()
            self._now = None

    def stop(self) -> None:
        """Listen no longer; what was not answered is forgotten."""
        if (one := self._now) is not None:
            one.dropped = True
            one.ended.set()
            self._now = None

    def close(self) -> None:
        """Put on record what is computed within `ENDS_S`, and nothing more."""
        self.stop()
        if self._thread is not None:
            self._thread.join(ENDS_S)
        with self._lock:
            self._open = False

    def lamp(self) -> Lamp:
        """Return how well the microphone is."""
        try:
            loud = self.microphone.loudness()
        except PalpateError as error:
            return Lamp(name="mic", good=False, words=error.sentence())
        now_ns = self.clock.now_ns()
        if loud.clipped:
            self._clipped_ns = now_ns
        recent = self._clipped_ns is not None and now_ns - self._clipped_ns < CLIPPED_S * 1e9
        words = (
            self._problem or objection(loud) or ("clipped a moment ago: turn the input level down" if recent else "")
        )
        if words or self.enrolment is not None:
            return Lamp(name="mic", good=not words, words=words or f"{loud.rms_db:.0f} dB re full scale")
        return Lamp(name="mic", good=None, words=f"{loud.rms_db:.0f} dB re full scale; proposes no answers")

    def _follow(self, one: _Attempt, before: threading.Thread | None) -> None:
        if before is not None:
            before.join()
        try:
            spoken = self._heard(one)
            self._problem = ""
        except (PalpateError, BrokenExecutor, OSError, TimeoutError) as error:
            self._problem = cause(error)
            one.ended.wait()
            spoken = self._record(one, SILENCE, 0.0).model_copy(update={"problem": self._problem})
        with suppress(PalpateError), self._lock:
            # The session meets a journal that takes nothing more by itself.
            if self._open and not one.dropped:
                self.write(spoken)

    def _heard(self, one: _Attempt) -> Spoken:
        """Return what was heard until the answer was chosen; meanwhile the console is told what to propose."""
        microphone, told = self.microphone, ""
        begins_ns = one.answerable_ns - int(LISTENED_S * 1e9)
        before = microphone.heard(from_ns=begins_ns, until_ns=one.answerable_ns)
        background: Background = self._computed(hearing.listen, before)
        while True:
            last = one.ended.wait(LOOK_S)
            if one.dropped:
                return self._record(one, SILENCE, 0.0)
            over_ns = one.answerable_ns + int(LONGEST_S * 1e9)
            until_ns = min(one.until_ns or self.clock.now_ns(), over_ns)
            from_ns = one.answerable_ns - int((BEFORE_S + BEYOND_S) * 1e9)
            recorded = microphone.heard(from_ns=from_ns, until_ns=max(until_ns, one.answerable_ns))
            heard: Heard = self._computed(
                hearing.hear,
                recorded,
                answerable_s=-_offset_s(one, recorded),
                enrolment=self.enrolment,
                background=background,
            )
            if last:
                kept = self._keep(one, recorded, background, heard)
                return self._record(one, heard, _offset_s(one, recorded)).model_copy(update=kept)
            settled = len(recorded.microphone) / microphone.rate_hz - (heard.until_s or np.inf) > SETTLED_S
            if settled and (words := in_words(heard)) != told:
                told = words
                self.console.tell(Proposed(words))
            if until_ns == over_ns:
                one.ended.wait()

    def _record(self, one: _Attempt, heard: Heard, offset_s: float) -> Spoken:
        onset_s = None if heard.onset_s is None else max(offset_s + heard.onset_s, 0.0)
        return Spoken(
            trial=one.trial,
            attempt=one.attempt,
            onset_s=onset_s,
            proposed=heard.proposed,
            agreement=heard.agreement,
            lead=heard.lead,
        )

    def _keep(self, one: _Attempt, recorded: Recorded, background: Background, heard: Heard) -> dict[str, str]:
        """Keep the sound of what was said, or of all if nobody was heard, without the masker."""
        if self.voices is None:
            return {}
        samples = self._computed(hearing.without_masker, recorded, background=background)
        if heard.onset_s is not None and heard.until_s is not None:
            first, end = round((heard.onset_s - AROUND_S) * RATE_HZ), round((heard.until_s + AROUND_S) * RATE_HZ)
            samples = samples[max(first, 0) : end]
        name = f"task-{self.task}_trial-{one.trial:03d}_attempt-{one.attempt}.wav"
        content = wav(samples)
        keep(self.voices / name, content)
        return {"sound": name, "sound_sha256": hashlib.sha256(content).hexdigest()}


def _offset_s(one: _Attempt, recorded: Recorded) -> float:
    """Return when a recording begins, s after the answer could be given."""
    return (recorded.begins_ns - one.answerable_ns) / 1e9


def in_words(heard: Heard) -> str:
    """Return what an experimenter is told of what was heard; it is a proposal."""
    if heard.onset_s is None:
        return ""
    return f"heard: {heard.proposed or 'none of the answers'} ({heard.agreement:.2f})"


def wav(samples: NDArray[np.float64]) -> bytes:
    """Return samples at `RATE_HZ`, 1 being full scale, as a WAV file of 16 bits."""
    made = io.BytesIO()
    with wave.open(made, "wb") as file:
        file.setnchannels(1)
        file.setsampwidth(2)
        file.setframerate(RATE_HZ)
        file.writeframes((np.clip(samples, -1, 1) * 32767).astype("<i2").tobytes())
    return made.getvalue()


def keep(path: Path, content: bytes) -> None:
    """Put what people said, or what was computed of it, into a file that its owner alone may open. Raises `OSError`."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.parent.chmod(0o700)
    storage.write(path, content)
    path.chmod(0o600)
