"""The sound of one session: one audio stream, opened once and kept, with the masker on its headphones.

The participant's level is chosen before the first trial and journaled with every change. The masker plays until every
trial is answered, or its time or dose is used up. `+` and `-`, which no protocol uses otherwise, change it at answers.
"""

import threading
from collections import deque
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass

from palpate.experiment.apparatus import opening
from palpate.experiment.apparatus.audio.masker import RESERVE_S, ROUND_S, AudioMasker, MaskerNoise, masker_noise
from palpate.experiment.apparatus.audio.stream import AudioStream
from palpate.experiment.apparatus.ports import Masker, MaskerExposure
from palpate.experiment.apparatus.rig import Rig
from palpate.experiment.clock import Clock, day
from palpate.experiment.desk.questions import MASKER, YES, Agree, Console, Level, Notice
from palpate.experiment.errors import DoseUsedUp
from palpate.experiment.protocol.models import Masker as Wanted
from palpate.experiment.protocol.models import Protocol
from palpate.experiment.protocol.rules import HEARD_KEY, LOUDER_KEY, PROBE_KEY
from palpate.experiment.records.entries import MaskerSet, Note
from palpate.experiment.session import scene

STEP_DB = 2.0
"""One key changes the level by this much, dB."""

RISE_NS = 500_000_000
"""The level rises by one step in so long at most, ns, whoever presses: loudness is heard in full after about 0.2 s."""

LOOK_NS = 20_000_000
"""Between two looks at whether a remembered step may be, ns."""

FIRST_DB_A = 50.0
"""Level at which the first choice begins, dB(A): soft, so that it is turned up and not down."""


@dataclass(eq=False)
class Masking:
    """Drives a masker and puts its levels on disk by `write`; a second thread may silence it for good.

    Its lock is never held while an entry is written, and who silences writes nothing: `record` does, later.
    """

    masker: Masker
    console: Console
    write: Callable[[MaskerSet | Note], None]
    clock: Clock

    def __post_init__(self) -> None:
        self.limit_db_a = self.masker.limit_db_a
        """The loudest level allowed, dB(A)."""
        self._rises_ns = self.clock.now_ns()
        self._lock = threading.Lock()
        self._writing = threading.Lock()
        self._unwritten = deque[MaskerSet]()
        self._noted_db_a: float | None = None
        self._wanted = False
        self._falls = 0
        self._silenced = self._used_up = False

    def choose(self, wanted: Wanted, begin_db_a: float | None, probe: Callable[[], None] | None) -> None:
        """Start the noise at `begin_db_a`, or at the first level if None, and have it set as is `wanted`.

        `probe` plays what is to be hidden, None where nothing can. Where that is heard at the limit, it goes on record.
        """
        criterion = wanted.criterion
        if probe is None:
            criterion += (
                " No vibration is played while the level is set: have the participant touch the object as in a "
                "trial, and listen."
            )
        self._rise(self.masker.start, begin_db_a or FIRST_DB_A)
        while not self._silenced:
            # The question is to state the level that is kept: a step up that is remembered comes before it.
            while self._wanted:
                if said := self.keep_up():
                    self.console.tell(Notice(said))
                else:
                    self.clock.sleep_ns(LOOK_NS)
            level_db_a, limit_db_a = self.exposure.level_db_a or FIRST_DB_A, self.limit_db_a
            question = Level(level_db_a, limit_db_a, criterion, probe is not None, wanted.level_set_by)
            key = self.console.ask(question).key
            if key == PROBE_KEY and probe is not None:
                probe()
            elif key == HEARD_KEY:
                if self._heard_at_limit(limit_db_a):
                    return
            elif not self.change(key):
                # What is kept is the level that is heard.
                self.drop()
                return

    def _heard_at_limit(self, limit_db_a: float) -> bool:
        """Return whether the session goes on although the masker hides too little; that goes on record."""
        told = f"The participant can still hear the sound to be masked at the limit of {limit_db_a:.0f} dB(A)."
        asked = f"{told} The masker cannot be louder. Continue anyway? To stop instead, choose no, then pause."
        question = Agree(asked, "continue anyway; this is recorded", "no, adjust the level again")
        if self.console.ask(question).key != YES:
            return False
        self.write(Note(trial=None, text=told))
        self.console.tell(Notice(f"Recorded: {told}"))
        return True

    def change(self, key: str) -> bool:
        """Return whether `key` was one of the masker's; then the level has changed by a step, within the limit.

        One step up that comes too soon after the one before is remembered, for `keep_up`, until a step down or silence.
        A masker that was silenced stays silent.
        """
        if key not in MASKER:
            return False
        if key == LOUDER_KEY and (said := self.keep_up()):
            self.console.tell(Notice(said))
        with self._lock:
            level_db_a = self.masker.level_db_a
            soon = key == LOUDER_KEY and not self._may_rise() and level_db_a is not None
            self._wanted = soon
            if key != LOUDER_KEY and level_db_a is not None:
                self._falls += 1
                level_db_a = self.masker.set_level(level_db_a - STEP_DB)
                self._note(level_db_a)
        if key == LOUDER_KEY and not soon and level_db_a is not None:
            level_db_a = self._rise(self.masker.set_level, level_db_a + STEP_DB)
        self.record()
        later = f": it can rise only once in {RISE_NS / 1e9:g} s; the next step follows" if soon else ""
        self.console.tell(Notice(self._in_words(level_db_a, later)))
        return True

    def keep_up(self) -> str:
        """Carry out the step up that is remembered, once it may be, and `record`; return what is to be told of it."""
        with self._lock:
            level_db_a = self.masker.level_db_a
            due = self._wanted and self._may_rise()
            self._wanted = self._wanted and not due
        said = ""
        if due:
            in_force = None if level_db_a is None else self._rise(self.masker.set_level, level_db_a + STEP_DB)
            said = self._in_words(in_force)
        self.record()
        return said

    def drop(self) -> None:
        """Remember no step up any more."""
        with self._lock:
            self._wanted = False

    def _may_rise(self) -> bool:
        """Return whether a step up may be now, of which the lock is held; then no other one may be for `RISE_NS`."""
        if (now_ns := self.clock.now_ns()) < self._rises_ns:
            return False
        self._rises_ns = now_ns + RISE_NS
        return True

    def _in_words(self, level_db_a: float | None, later: str = "") -> str:
        if level_db_a is None:
            return "The masker is silent."
        at_limit = " (the limit)" if level_db_a >= self.limit_db_a else ""
        return f"Masker {'still ' if later else ''}at {level_db_a:.0f} dB(A){at_limit}{later}."

    @property
    def exposure(self) -> MaskerExposure:
        """What the masker has done to the ears until now."""
        with self._lock:
            return self.masker.exposure()

    def spent(self) -> str:
        """Return that the dose is used up, or will be before anybody looks again; nothing while it is not."""
        told = self.exposure
        self._used_up |= told.dose >= 1 or (told.left_s is not None and told.left_s <= RESERVE_S)
        if not self._used_up:
            return ""
        return f"the masker's dose for 24 hours is used up ({told.dose:.2f} of 1); continue a day later"

    def silence(self) -> None:
        """Fall silent for good; it returns at once, whatever the disk does."""
        self._silenced = True
        self.end()

    def end(self) -> None:
        """Fade out until the level is chosen anew; it returns at once, whatever the disk does."""
        with self._lock:
            self._wanted = False
            self.masker.stop()
            if self._noted_db_a is not None:
                self._note(None)

    def record(self) -> None:
        """Put every change of the level on disk, in order; this waits for the disk. Raises `JournalError`."""
        with self._writing:
            while self._unwritten:
                self.write(self._unwritten[0])
                self._unwritten.popleft()

    def _rise(self, play: Callable[[float], float], level_db_a: float) -> float | None:
        """Play louder once that is on disk, so that what is heard is on record however long a disk takes.

        Return the level in force; None where the masker was silenced meanwhile, or the dose is used up.
        """
        with self._lock:
            if self._silenced:
                return None
            falls = self._falls
            self._note(min(level_db_a, self.limit_db_a))
        self.record()
        in_force = None
        with self._lock:
            try:
                if falls != self._falls:
                    # A step down came while the disk was waited for.
                    in_force = self.masker.level_db_a
                elif not self._silenced:
                    in_force = play(level_db_a)
                    # However long the disk took.
                    self._rises_ns = self.clock.now_ns() + RISE_NS
            except DoseUsedUp:
                self._silenced = self._used_up = True
            if in_force != self._noted_db_a:
                self._note(in_force)
        self.record()
        return in_force

    def _note(self, level_db_a: float | None) -> None:
        """Have a level recorded, beside the exposure until now."""
        told, self._noted_db_a = self.masker.exposure(), level_db_a
        self._unwritten.append(MaskerSet(level_db_a=level_db_a, dose=told.dose, daily_level_db_a=told.daily_level_db_a))


@dataclass(frozen=True)
class Sound:
    """The stream of a session, whose sample clock all of its sound shares, and its masker, if it has one."""

    stream: AudioStream
    masker: AudioMasker | None


def open_sound(
    rig: Rig,
    protocol: Protocol,
    *,
    planned: scene.Scene,
    clock: Clock,
    dose_before: float,
    opened: ExitStack,
    device: str | None = None,
) -> Sound:
    """Open what a session's scene `planned` needs of the rig's audio device; `opened` closes the stream.

    `dose_before` is of the 24 hours before; `device` replaces the rig's. Raises `RigError` for an old calibration or a
    simulated device, and `AudioError` if it cannot be opened.
    """
    audio = opening.audio_of(rig)
    noise: MaskerNoise | None = None
    if planned.masker is not None:
        samples = scene.masker_samples(colour=planned.masker, rate_hz=audio.rate_hz, seconds=ROUND_S)
        noise = masker_noise(
            samples,
            rate_hz=audio.rate_hz,
            pink_full_scale_db_a=audio.headphones.full_scale_db_a,
            limit_db_a=protocol.exposure.masker_level_db_a,
        )
    stream = opening.open_audio(
        rig,
        limits_m_s2=protocol.limits_m_s2 if planned.actuator else {},
        listens=planned.listens,
        masker=noise,
        clock=clock,
        today=day(clock.now_ns()),
        device=device,
    )
    opened.callback(stream.close)
    if noise is None:
        return Sound(stream, None)
    channels = audio.channels.headphones
    return Sound(stream, AudioMasker(stream, noise, channels=channels, clock=clock, dose_before=dose_before))
