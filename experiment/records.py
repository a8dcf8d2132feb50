"""Models of every journal entry, and the columns of the tables made from them; shared with analysis.

A journal is one session (one participant doing one task): a `Header`, then entries, then a `Footer`.
"""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, TypeAdapter

NO_ANSWER = "(none)"
"""How a trial without an answer stands in tables."""


FORMAT: Literal[3] = 3
"""Of the journal: models and their meaning. 1 was never written down; 2 had one line from device to session time,
without drift, for all steps since the tracker was opened, and no times of scheduling and arming."""


class Entry(BaseModel):
    """Base of every entry; the journal adds number, time and the hash of the line before."""

    model_config = ConfigDict(frozen=True, strict=True, extra="forbid", allow_inf_nan=False)


class PlannedTrial(Entry):
    """One place in the realised order: trial number from 1, and the material presented there."""

    trial: int
    presented: str


class Header(Entry):
    """What this session is; written before the first trial, never again.

    `recordings_sha256` is that of the recordings' manifest, which holds the hash of every take; None without synthesis.
    `order` falls into blocks of `block_trials`; a trial that is put off is run again at the end of its block.
    """

    kind: Literal["header"] = "header"
    format: Literal[3] = FORMAT
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


class Shaping(Entry):
    """What frequency shaping could not reach: bins by cause, and the sum over them of amplitude asked minus reached.

    Asked is what the stimulus asked for, before `scale`; what `scale` alone takes from a bin is in no sum.
    `saturated`: above the highest drive level measured. `outside`: beyond the measured frequencies. `bounded`: held
    back by the rig's limit of volts per m/s^2. `scale`: factor by which the whole stimulus was taken down, so that what
    the rig's response makes of it stays within the limit of vibration; 1 where it need not be.
    """

    saturated_bins: int
    saturated_cost_m_s2: float
    outside_bins: int
    outside_cost_m_s2: float
    bounded_bins: int
    bounded_cost_m_s2: float
    scale: float


class Driven(Entry):
    """The voltages of a stimulus: what shaping did, samples that the limiter changed in volts, and its peak."""

    shaping: Shaping
    limited: int
    peak_v: float


class Computed(Entry):
    """How the stimuli of a material are computed.

    `method`: its name, with the band where bins outside it are left out. `relative_error`: what it claims at any speed.
    """

    method: str
    relative_error: float


class Stimulus(Entry):
    """What was synthesised and handed to the actuator.

    `sha256` is that of the samples as float64, little-endian. `floored_bins` counts the bins that
    extrapolation would have made negative, of the whole spectrum. `driven` is None where the actuator takes
    accelerations; `computed` in journals from before it was written.
    """

    sha256: str
    samples: int
    rate_hz: int
    floored_bins: int
    extrapolated: bool
    limited: int
    peak_m_s2: float
    driven: Driven | None = None
    computed: Computed | None = None


class Delivered(Entry):
    """What the loopback heard of one stimulus, set beside what was intended.

    `requested_ns`: session time for which its first sample was asked, as reaching the panel. `onset_ns`: when it was
    measured to reach the panel; None where nothing of it was found, as are `onset_error_ms` (measured minus asked),
    `gain` (measured by intended) and `residual_db` (what gain and delay do not explain, relative to the intended
    waveform). `xruns`: of the stream while it sounded. `reason` says why it does not count as delivered.
    """

    requested_ns: int
    onset_ns: int | None
    onset_error_ms: float | None
    gain: float | None
    residual_db: float | None
    xruns: int
    delivered: bool
    reason: str = ""


class Onset(Entry):
    """How a stimulus was brought together with the contact.

    `predicted_us`: contact as predicted last before the point of no return, device time, with its standard error and
    the newest sample it rests on; None where the foot came too fast to be predicted. `prediction_error_ms`: predicted
    minus actual contact. `contact_ns`: actual contact, session time. `scheduled_ns`: session time for which the onset
    was asked; None where the actuator cannot schedule, or was not aimed in time, so that it sounded after contact.
    `gate_to_scheduled_ms`: from the arrival of the frame that gave the gate until the onset was first scheduled; None
    where it never was, and in simulated time.
    `delivered`: what a loopback measured; None where there is none.
    """

    predicted_us: float | None
    standard_error_ms: float | None
    predicted_from_us: int | None
    prediction_error_ms: float | None
    contact_ns: int
    scheduled_ns: int | None
    gate_to_scheduled_ms: float | None
    delivered: Delivered | None


class Link(Entry):
    """Frames of the tracker between arming and contact; `received` counts those up to contact."""

    received: int
    lost: int
    damaged: int
    repeated: int


class Trace(Entry):
    """Where the raw frames of a step stand in the session's foot file."""

    offset: int
    length: int
    sha256: str


class TrackerClock(Entry):
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
    Header | TrackerOpened | MaskerSet | Phase | FootStep | BrokenOff | Answer | Redo | Resumed | Footer,
    Field(discriminator="kind"),
]
ENTRY: TypeAdapter[AnyEntry] = TypeAdapter(AnyEntry)


EVENT_COLUMNS: dict[str, dict[str, object]] = {
    "onset": {
        "Description": "Contact of the foot with the panel, from the first frame of the session's tracker; where a "
        "step broke off, when it did. n/a where no clock ran.",
        "Units": "s",
    },
    "duration": {"Description": "Length of the stimulus. n/a where none was played by the rig.", "Units": "s"},
    "trial": {"Description": "Place of the trial in the realised order, from 1."},
    "attempt": {"Description": "1 for the first attempt at this trial, 2 after one redo, and so on."},
    "counted": {
        "Description": "Whether this attempt is the one that counts.",
        "Levels": {"1": "the attempt that counts", "0": "done again: see redo_reason"},
    },
    "presented": {"Description": "Material presented."},
    "answered": {"Description": f"Material the participant named; {NO_ANSWER} where none was named."},
    "response_time": {"Description": "From contact to the confirmed answer. n/a where no clock ran.", "Units": "s"},
    "foot_speed": {"Description": "10 mm divided by the time from 20 mm to 10 mm above the panel.", "Units": "mm/s"},
    "frames_lost": {"Description": "Tracker frames lost or damaged between arming and contact."},
    "floored_bins": {"Description": "Bins of the synthesised spectrum floored at zero. n/a without synthesis."},
    "delivered": {
        "Description": "Whether the loopback heard the stimulus as it was intended. n/a where nothing measured it.",
        "Levels": {"1": "within the rig's thresholds", "0": "late, changed or not at all"},
    },
    "onset_error": {
        "Description": "Measured onset of the stimulus at the panel minus contact. n/a where nothing measured it.",
        "Units": "s",
    },
    "redo_reason": {"Description": "Why this attempt was done again. n/a where it counts."},
    "origin": {
        "Description": "What produced this row.",
        "Levels": {
            "PARTICIPANT": "a participant in the room",
            "REHEARSAL": "simulated participants, simulated materials",
            "RECONSTRUCTION": "consistent with printed tables, no original data",
        },
    },
}
"""Columns of `_events.tsv` in their order, as the sidecar describes them."""

FURTHER_COLUMNS: dict[str, dict[str, object]] = {
    "masker_level": {"Description": "Level of the masker in this attempt. n/a for silence.", "Units": "dB(A)"},
    "prediction_error": {
        "Description": "Contact as predicted last before the onset could no longer be moved, minus actual contact. n/a "
        "where it was not predicted in time.",
        "Units": "s",
    },
    "delivery_error": {
        "Description": "Measured onset of the stimulus at the panel minus the onset that was asked for. n/a where "
        "nothing measured it.",
        "Units": "s",
    },
    "gate_to_scheduled": {
        "Description": "From the arrival of the tracker's frame that gave the gate until the onset was first "
        "scheduled. n/a where it was not.",
        "Units": "s",
    },
    "dead_time": {
        "Description": "From the confirmed answer to the trial before until this attempt was armed, without the time "
        "in which an object was laid out. n/a where no answer came just before.",
        "Units": "s",
    },
}
"""Further columns, each left out where a session knows nothing of it, as simulated time of the last two."""
