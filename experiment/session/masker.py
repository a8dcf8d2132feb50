"""The sound of one session: one audio stream, opened once and kept, with the masker on its headphones.

The participant's level is chosen before the first trial and journaled with every change. The masker plays from then to
the session's end, pauses between trials included. `+` and `-` change it whenever an answer is asked for; no protocol
has these keys for anything else.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from contextlib import ExitStack
from dataclasses import dataclass
from datetime import date
from pathlib import Path

from experiment import storage
from experiment.apparatus import opening
from experiment.apparatus.audio.masker import ROUND_S, AudioMasker
from experiment.apparatus.audio.stream import AudioStream
from experiment.apparatus.ports import Masker
from experiment.apparatus.rig import Rig
from experiment.clock import Clock, day
from experiment.desk.port import Console
from experiment.protocol.models import Protocol
from experiment.protocol.rules import LOUDER_KEY, SOFTER_KEY
from experiment.records import journal
from experiment.records.entries import MaskerSet
from experiment.records.journal import Contents
from experiment.session import scene

STEP_DB = 2.0
"""One key changes the level by this much, dB."""

FIRST_DB_A = 50.0
"""Level at which the first choice begins, dB(A): soft, so that it is turned up and not down."""

KEYS = {LOUDER_KEY: "masker louder", SOFTER_KEY: "masker softer"}


class Masking:
    """Drives a masker and puts its levels on disk."""

    def __init__(self, masker: Masker, console: Console, write: Callable[[MaskerSet], None]) -> None:
        """Begin in silence; `write` puts an entry into the journal and returns when it is on disk."""
        self._masker = masker
        self._console = console
        self._write = write

    def choose(self, criterion: str, begin_db_a: float | None) -> None:
        """Start the noise at `begin_db_a`, or at the first level if None, and have it set until `criterion` holds.

        Raises `AudioError` if the dose of the day is used up.
        """
        self._masker.start(FIRST_DB_A if begin_db_a is None else begin_db_a)
        self._note()
        while True:
            level_db_a = self._masker.level_db_a
            key = self._console.level(
                level_db_a=level_db_a if level_db_a is not None else FIRST_DB_A,
                limit_db_a=self._masker.limit_db_a,
                criterion=criterion,
                keys=KEYS,
            )
            if not self.change(key):
                return

    def change(self, key: str) -> bool:
        """Return whether `key` was one of the masker's; then the level has changed by a step, within the limit.

        Raises `AudioError` if the dose of the day is used up.
        """
        level_db_a = self._masker.level_db_a
        if key not in KEYS or level_db_a is None:
            return False
        set_db_a = self._masker.set_level(level_db_a + (STEP_DB if key == LOUDER_KEY else -STEP_DB))
        self._note()
        at_limit = " (the limit)" if set_db_a >= self._masker.limit_db_a else ""
        self._console.show(f"Masker at {set_db_a:.0f} dB(A){at_limit}.")
        return True

    def spent(self) -> str:
        """Return why no further trial may begin: the dose of the day is used up; nothing while it is not."""
        exposure = self._masker.exposure()
        if exposure.dose < 1:
            return ""
        return f"the masker's dose of the day is used up ({exposure.dose:.2f} of 1); go on another day"

    def end(self, *, note: bool) -> None:
        """Fall silent; `note` journals the dose."""
        self._masker.stop()
        if note:
            self._note()

    def _note(self) -> None:
        exposure = self._masker.exposure()
        self._write(
            MaskerSet(level_db_a=exposure.level_db_a, dose=exposure.dose, daily_level_db_a=exposure.daily_level_db_a)
        )


def dose_today(journals: Iterable[Contents], now_ns: int) -> float:
    """Return what the sessions of a participant's journals have used up of the dose of the day of `now_ns`."""
    today = day(now_ns)
    spent = [_spent(contents, today) for contents in journals]
    return max(spent, default=(0, 0.0))[1]


def _spent(contents: Contents, today: date) -> tuple[int, float]:
    """Return when a journal last told of today's dose, ns, and what the dose was by the journal's last line.

    A session that was killed has no last word of its masker: it counts as playing until its last line.
    """
    told = [(line.t_ns, line.entry) for line in contents.lines if isinstance(line.entry, MaskerSet)]
    if not told or day(told[-1][0]) != today:
        return 0, 0.0
    t_ns, last = told[-1]
    if last.level_db_a is None:
        return t_ns, last.dose
    from experiment.apparatus.audio import masker as sound_level

    played_s = (contents.lines[-1].t_ns - t_ns) / 1e9
    return t_ns, last.dose + sound_level.dose(level_db_a=last.level_db_a, duration_s=played_s)


@dataclass(frozen=True)
class Sound:
    """The stream of a session, whose sample clock masker, stimulus, microphone and loopback share, and its masker."""

    stream: AudioStream
    masker: AudioMasker


def open_sound(
    rig: Rig, protocol: Protocol, *, clock: Clock, dose_before: float, opened: ExitStack, device: str | None = None
) -> Sound:
    """Open the rig's audio device for a session; `opened` closes the stream.

    `dose_before` is the dose of the participant's earlier sessions of the day; `device` replaces the one that the rig
    names. Raises `RigError` if a calibration is too old or the device exists in simulation alone, and `AudioError` if
    the device cannot be opened.
    """
    audio = opening.audio_of(rig)
    samples = scene.masker_samples(protocol=protocol, rate_hz=audio.rate_hz, seconds=ROUND_S)
    noise = opening.masker_noise(rig, samples=samples, limit_db_a=protocol.exposure.masker_level_db_a)
    stream = opening.open_audio(
        rig,
        limit_m_s2=protocol.exposure.vibration_peak_m_s2,
        masker=noise,
        clock=clock,
        today=day(clock.now_ns()),
        device=device,
    )
    opened.callback(stream.close)
    return Sound(stream, opening.open_masker(rig, stream=stream, noise=noise, clock=clock, dose_before=dose_before))


def dose_before(dataset: Path, protocol: Protocol, participant: str, clock: Clock) -> float:
    """Return what a participant's sessions of today used up of the dose of the day.

    Raises `JournalError` if a journal cannot be trusted.
    """
    paths = (storage.journal_path(dataset, participant, task.id) for task in protocol.tasks)
    return dose_today([journal.read(path) for path in paths if path.exists()], clock.now_ns())
