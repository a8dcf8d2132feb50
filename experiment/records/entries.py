"""Models of the journal entries that every kind of trial shares: a `Header`, then entries, then a `Footer`."""

from datetime import datetime
from hashlib import sha256
from typing import Annotated, ClassVar, Literal

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, SerializeAsAny

from palpate.experiment.storage import RAW

FORMAT: Literal[10] = 10
"""The format of the journal: its models and their meaning. Headers of format 9 name no seal."""

Purpose = Literal["STUDY", "PILOT", "PRACTICE", "REHEARSAL"]
"""What a session is for. Only sessions of one purpose stand in one dataset, and only a STUDY is data of its study."""

Utc = Annotated[
    str,
    Field(pattern=r"^(19|2[01])[0-9]{2}-[0-9]{2}-[0-9]{2}T[0-9]{2}:[0-9]{2}:[0-9]{2}\+00:00$"),
    AfterValidator(lambda text: datetime.fromisoformat(text) and text),
]
"""A moment as `clock.utc` writes it."""


class Record(BaseModel):
    """Base of everything that is kept on record."""

    model_config = ConfigDict(frozen=True, strict=True, extra="forbid", allow_inf_nan=False)


class Entry(Record):
    """Base of every journal entry; the journal adds number, time and the hash of the line before."""

    kind: str

    @property
    def felt_s(self) -> tuple[float, ...]:
        """How long each stimulus lasts that this entry puts on record, s."""
        stimulus = getattr(self, "stimulus", None)
        return () if stimulus is None else (stimulus.lasts_s,)

    @property
    def felt_at(self) -> tuple[tuple[str, str | None], ...]:
        """The material and the site of the body of each stimulus that this entry puts on record."""
        return ()

    @property
    def frames(self) -> "Trace | None":
        """Where the raw data stand that this entry puts on record; None where none are kept."""
        trace: Trace | None = getattr(self, "trace", None)
        return trace


class Trace(Record):
    """Where the raw tracker frames of an attempt stand in the session's file of them, and what these are called."""

    file: ClassVar[str] = RAW[0]
    recording: ClassVar[str] = "foot"
    of_what: ClassVar[tuple[str, str]] = "frames", "step"

    offset: int
    length: int
    sha256: str


class OfAttempt(Entry):
    """Base of every entry about one attempt at a trial."""

    trial: int
    attempt: int

    @property
    def label(self) -> str:
        """Trial and attempt, as a transcript names them."""
        return f"trial {self.trial}.{self.attempt}"


class Outcome(OfAttempt):
    """Base of the entry of a kind with which an attempt is over, so that it has a row in the table of its session."""

    presented: tuple[str, ...]

    asks: ClassVar[bool] = True
    """Whether an answer is asked for next."""

    @property
    def put_off(self) -> bool:
        """Whether the trial moves to the end of its block."""
        return False


class PlannedTrial(Record):
    """One place in the realised order: the trial's number from 1, and what is presented: one material, or a pair."""

    trial: int
    presented: tuple[str, ...]

    @property
    def track(self) -> str:
        """The track that it is of in a task with levels: what is presented, in whatever order."""
        return " | ".join(sorted(self.presented))


class TrainingTrial(PlannedTrial):
    """A trial of a training of so many at most."""

    of: int


class Header(Entry):
    """What this session is; the first entry.

    `software` and `source_sha256` are those of `software.this`. `session_id` are 32 unique hexadecimal digits, which
    identify copies. `recordings_sha256` is that of the manifest; None without synthesis. `floor_m_s2` is
    what the participant was measured not to feel, None without. `task_kind` and `design` are the task's. `order` falls
    into blocks of `block_trials`. `roster_sha256` is the hash of the roster's last line at the start, `seal_sha256`
    that of the seal's file under which it began, and `consent_sha256` that of the protocol to which the participant had
    consented; None in a rehearsal, and the last two in format 9.
    """

    kind: Literal["header"] = "header"
    format: Literal[9, 10] = FORMAT
    session_id: Annotated[str, Field(pattern=r"^[0-9a-f]{32}$")]
    study: str
    protocol_sha256: str
    software: str
    source_sha256: Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]
    rig: str
    rig_sha256: str
    recordings_sha256: str | None
    floor_m_s2: float | None = None
    roster_sha256: str | None
    seal_sha256: str | None = None
    consent_sha256: str | None = None
    seed: int
    participant: str
    task: str
    task_kind: str
    design: str
    task_position: int
    purpose: Purpose
    started_utc: Utc
    block_trials: int
    order: tuple[PlannedTrial, ...]

    def rehearsed_id(self, control: str) -> str:
        """Return the `session_id` of this session as a rehearsal: the same whenever it is rehearsed again."""
        facts = f"{self.protocol_sha256} {self.rig_sha256} {self.recordings_sha256} {control}"
        return sha256(f"{facts} {self.seed} {self.participant} {self.task}".encode()).hexdigest()[:32]


class TrackerOpened(Entry):
    """The tracker's port was opened: which device time is which session time (of its first frame)."""

    kind: Literal["tracker"] = "tracker"
    port: str
    device_us: int
    t_ns: int


LOUDEST_DB_A = 200.0
"""No masker plays any louder, dB(A)."""


class MaskerSet(Entry):
    """The masker's level from now on, dB(A), None for silence; the dose so far, and L_EX,8h of that dose, None for
    none.

    `dose` is of all the participant's sessions in the 24 hours before the runner began, and of this runner's masker. A
    dose of 1 is 80 dB(A) for eight hours (Directive 2003/10/EC, lower action value).
    """

    kind: Literal["masker"] = "masker"
    level_db_a: Annotated[float, Field(le=LOUDEST_DB_A)] | None
    dose: float
    daily_level_db_a: float | None


class Exposure(Entry):
    """What a session in real time has done to the participant so far, written every few seconds.

    `dose` is that of `MaskerSet`; None without a masker. `stimuli` and `vibration_s` (s together) are of all runners of
    the session. `boot` and `up_ns` are the machine's uptime, which dates an entry whatever the clock; None if unknown.
    """

    kind: Literal["exposure"] = "exposure"
    dose: float | None
    stimuli: int
    vibration_s: float
    boot: str | None
    up_ns: int | None


class Phase(Entry):
    """The session entered a state of its transition table."""

    kind: Literal["phase"] = "phase"
    state: str
    detail: str = ""


class LevelChosen(OfAttempt):
    """The level of an attempt, from the answers on record to trials of its track; on disk before it is laid out."""

    kind: Literal["level"] = "level"
    track: str
    level: float


class TrackEnded(Entry):
    """A track has no further trial: it had its reversals, its threshold is known, or all its trials have an answer.

    Catch trials, under the name of what they present, end with the other `tracks`, one of which ended early.
    """

    kind: Literal["track"] = "track"
    track: str
    why: Literal["reversals", "trials", "precision", "tracks"]


class Armed(OfAttempt):
    """An attempt begins: from now on its stimulus may be felt. On disk before any sound of it is possible."""

    kind: Literal["armed"] = "armed"
    presented: tuple[str, ...]


class Answer(OfAttempt):
    """A confirmed answer, None where the participant gave none; one `by` the participant is not confirmed.

    `response_time_s` is from when it could be given to the choice of its key, `confirmed_s` to the confirmation.
    `pressed_ns` is the session time of the participant's press, `device_us` that of their buttons' clock, and `error_s`
    the standard error of that press by its device, s; None where nobody knows.
    """

    kind: Literal["answer"] = "answer"
    presented: tuple[str, ...]
    answered: str | None
    key: str
    response_time_s: float
    confirmed_s: float | None = None
    by: Literal["experimenter", "participant"] = "experimenter"
    pressed_ns: int | None = None
    device_us: int | None = None
    error_s: float | None = None


class Trained(Entry):
    """An entry of a training trial, by the training's own numbers from 1; no table, report or analysis has it.

    `right` is whether its answer was right; None for any other entry.
    """

    kind: Literal["training"] = "training"
    entry: SerializeAsAny[Entry]
    right: bool | None = None

    @property
    def felt_s(self) -> tuple[float, ...]:
        return self.entry.felt_s

    @property
    def felt_at(self) -> tuple[tuple[str, str | None], ...]:
        return self.entry.felt_at

    @property
    def frames(self) -> Trace | None:
        return self.entry.frames


class TrainingEnded(Entry):
    """The training is over, with so many answers; `reached` is whether its criterion was, None without one.

    It `ends` the session where no trial that counts is begun without the criterion.
    """

    kind: Literal["training-ended"] = "training-ended"
    answered: int
    right: int
    reached: bool | None
    ends: bool = False


class Spoken(OfAttempt):
    """What the microphone heard until the answer to an attempt was chosen; it decides nothing, and may follow later.

    `onset_s` is from when an answer could be given to the voice, None for no voice. `proposed` is the proposed answer,
    None for none; `agreement` and `lead` are those of `desk.voice.hearing.Heard`. `sound` is the file beside the
    journal with its SHA-256, None if none is saved. `problem` says why nothing could be heard.
    """

    kind: Literal["spoken"] = "spoken"
    onset_s: float | None
    proposed: str | None
    agreement: float
    lead: float
    sound: Annotated[str, Field(pattern=r"^[0-9A-Za-z_-]+\.wav$")] | None = None
    sound_sha256: Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")] | None = None
    problem: str = ""


class Correction(OfAttempt):
    """Another answer takes the place of one that was confirmed in this session; both stay on record."""

    kind: Literal["correction"] = "correction"
    answered: str | None
    key: str
    reason: str


class Visited(Entry):
    """A step of the visit beside the trials, `identity` or one of `remarks.REPORTS`, and what was said or done."""

    kind: Literal["visit"] = "visit"
    step: Annotated[str, Field(pattern=r"^[a-z]+$")]
    text: str


class Questioned(Entry):
    """What the participant answered to an item of a questionnaire; None where they did not."""

    kind: Literal["questioned"] = "questioned"
    questionnaire: str
    item: str
    answer: str | int | float | None

    @property
    def step(self) -> str:
        """The item as a step of the visit."""
        return f"{self.questionnaire}.{self.item}"


class Note(Entry):
    """What the experimenter noted, during a trial or, where `trial` is None, outside of trials."""

    kind: Literal["note"] = "note"
    trial: int | None
    text: str


class Commanded(Entry):
    """A request at a console or at the participant's screen, who made it, and the reply; texts are in other entries."""

    kind: Literal["command"] = "command"
    by: str
    command: str
    taken: bool
    reply: str


class Shown(Entry):
    """What the participant's screen shows, since the session time `since_ns`; `text` is the protocol's."""

    kind: Literal["shown"] = "shown"
    show: str
    text: str
    pace: str | None
    since_ns: int


class Ignored(Entry):
    """What was typed before it was asked for, and answered nothing."""

    kind: Literal["ignored"] = "ignored"
    trial: int | None
    typed: str


class Redo(OfAttempt):
    """An attempt that does not count, and why; the trial is run again, at the end of its block if `put_off`."""

    kind: Literal["redo"] = "redo"
    reason: str
    put_off: bool


ASKED_FOR, PAUSED = "asked for by the experimenter", "paused before the answer"
"""Why a trial is done again after a key of the experimenter, who types no reason."""


class Trigger(Record):
    """A number for an event at `due_ns` on a line of the rig, from 1; it left `late_ms` after, None for one lost."""

    line: int
    event: str
    number: int
    due_ns: int
    late_ms: float | None
    problem: str = ""


class Triggers(Entry):
    """What the rig's trigger lines were to send since the last entry of this kind."""

    kind: Literal["triggers"] = "triggers"
    sent: tuple[Trigger, ...]


class Resumed(Entry):
    """A runner continued the session; `torn` is what stood after the last whole line."""

    kind: Literal["resumed"] = "resumed"
    torn: str
    remaining: tuple[int, ...]


class Footer(Entry):
    """Why the session ended. Only `paused` and `error` can be resumed.

    `silent`: nothing that the session played sounds any more; None where it plays nothing, and in older journals.
    """

    kind: Literal["footer"] = "footer"
    reason: Literal["complete", "paused", "error"]
    detail: str = ""
    answered: int
    silent: bool | None = None


class Withdrawal(Entry):
    """The participant withdrew after this session, also under an older roster; `torn` followed the last whole line."""

    kind: Literal["withdrawal"] = "withdrawal"
    reason: str
    torn: str
