"""Models of every journal entry.

A journal is one session (one participant doing one task): a `Header`, then entries, then a `Footer`.
"""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, TypeAdapter

from experiment.records.stimulus import Onset, Record, Stimulus

FORMAT: Literal[3] = 3
"""Of the journal: models and their meaning. 1 was never written down; 2 had one line from device to session time,
without drift, for all steps since the tracker was opened, and no times of scheduling and arming."""


class Entry(Record):
    """Base of every entry; the journal adds number, time and the hash of the line before."""


class PlannedTrial(Record):
    """One place in the realised order: trial number from 1, and the material presented there."""

    trial: int
    presented: str


class Header(Entry):
    """What this session is; written before the first trial, never again.

    `session_id` are 32 hexadecimal digits that no other session has: copies of one in two datasets are told by it.
    `recordings_sha256` is that of the recordings' manifest, which holds the hash of every take; None without synthesis.
    `order` falls into blocks of `block_trials`; a trial that is put off is run again at the end of its block.
    """

    kind: Literal["header"] = "header"
    format: Literal[3] = FORMAT
    session_id: Annotated[str, Field(pattern=r"^[0-9a-f]{32}$")]
    study: str
    protocol_sha256: str
    software: str
    rig: str
    rig_sha256: str
    recordings_sha256: str | None
    seed: int
    participant: str
    task: str
    task_position: int
    rehearsal: bool
    started_utc: str
    block_trials: int
    order: tuple[PlannedTrial, ...]


class TrackerOpened(Entry):
    """The tracker's port was opened: which device time is which session time (of its first frame)."""

    kind: Literal["tracker"] = "tracker"
    port: str
    device_us: int
    t_ns: int


class Zeroed(Entry):
    """Heights count from where the foot rested on the panel, from now on.

    `offset_mm`: how far above the protocol's contact the calibration had it, median of `samples`; `spread_mm`: their
    standard deviation.
    """

    kind: Literal["zeroed"] = "zeroed"
    offset_mm: float
    spread_mm: float
    samples: int


class MaskerSet(Entry):
    """The masker's level from now on, dB(A), None for silence; the day's dose so far, and L_EX,8h of that dose.

    A dose of 1 is 80 dB(A) for eight hours (Directive 2003/10/EC, lower action value); None where there is none.
    """

    kind: Literal["masker"] = "masker"
    level_db_a: float | None
    dose: float
    daily_level_db_a: float | None


class Phase(Entry):
    """The session entered a state of its transition table."""

    kind: Literal["phase"] = "phase"
    state: str
    detail: str = ""


class Link(Record):
    """Frames of the tracker between arming and contact; `received` counts those up to contact."""

    received: int
    lost: int
    damaged: int
    repeated: int


class Trace(Record):
    """Where the raw frames of a step stand in the session's foot file."""

    offset: int
    length: int
    sha256: str


class TrackerClock(Record):
    """Which session time a device time is, as it was known at the end of a step: a straight line.

    `anchor_us` was at `anchor_ns`, and since then the session's clock ran ahead of the device's by `drift_ppm`.
    """

    anchor_us: int
    anchor_ns: int
    drift_ppm: float


class FootStep(Entry):
    """One step of the foot, in device time, with the stimulus it set off.

    `dead_time_ms`: from the confirmed answer to the trial before until this one was armed, without the time in which
    its object was laid out; None where no answer came just before, and in simulated time.
    """

    kind: Literal["step"] = "step"
    trial: int
    attempt: int
    presented: str
    clock: TrackerClock
    dead_time_ms: float | None
    gate_top_us: float
    gate_bottom_us: float
    contact_us: float
    speed_mm_s: float
    link: Link
    trace: Trace
    stimulus: Stimulus | None
    onset: Onset | None


class BrokenOff(Entry):
    """A step that ended before the foot had landed, or before its landing was on file; its stimulus was withdrawn
    where it still could be.

    `gate_top_us`, `gate_bottom_us` and `speed_mm_s` are None where the foot had not passed the gate, `at_us` (device
    time of the newest sample) and `clock` where none had come. `felt`: something may have been felt, so the trial is
    put off to the end of its block; else it is armed again at once. `dead_time_ms`: as in `FootStep`.
    """

    kind: Literal["broken-off"] = "broken-off"
    trial: int
    attempt: int
    presented: str
    reason: str
    felt: bool
    clock: TrackerClock | None
    dead_time_ms: float | None
    at_us: int | None
    gate_top_us: float | None
    gate_bottom_us: float | None
    speed_mm_s: float | None
    link: Link
    trace: Trace


class Answer(Entry):
    """A confirmed answer; `answered` is None where the participant gave none."""

    kind: Literal["answer"] = "answer"
    trial: int
    attempt: int
    presented: str
    answered: str | None
    key: str
    response_time_s: float


class Redo(Entry):
    """An attempt that does not count, and why; the trial is run again as the next attempt.

    `put_off`: at the end of its block; else at once.
    """

    kind: Literal["redo"] = "redo"
    trial: int
    attempt: int
    reason: str
    put_off: bool


class Resumed(Entry):
    """A runner took the session up again; `torn` is what stood after the last whole line."""

    kind: Literal["resumed"] = "resumed"
    torn: str
    remaining: tuple[int, ...]


class Footer(Entry):
    """Why the session ended. Only `paused` and `error` can be resumed."""

    kind: Literal["footer"] = "footer"
    reason: Literal["complete", "paused", "error"]
    detail: str = ""
    answered: int


AnyEntry = Annotated[
    Header | TrackerOpened | Zeroed | MaskerSet | Phase | FootStep | BrokenOff | Answer | Redo | Resumed | Footer,
    Field(discriminator="kind"),
]
ENTRY: TypeAdapter[AnyEntry] = TypeAdapter(AnyEntry)
