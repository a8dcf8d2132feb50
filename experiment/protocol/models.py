"""Frozen models of a protocol file: what a study is, as its ethics board approved it.

Unknown keys are refused. Units stand in the names. Text that a board reads is kept word for word.
"""

from __future__ import annotations

from datetime import date
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator

Text = Annotated[str, Field(min_length=1)]
Label = Annotated[str, Field(pattern=r"^[a-z][a-z0-9]*$", description="BIDS label: lower-case letters and digits")]
Key = Annotated[str, Field(min_length=1, max_length=1)]


class Confined(BaseModel):
    """Base of every model: frozen, strict, no unknown key."""

    model_config = ConfigDict(frozen=True, strict=True, extra="forbid", allow_inf_nan=False)


class Study(Confined):
    """What the study is and where it was published."""

    id: Label
    title: Text
    source: Text
    participants: Annotated[int, Field(ge=1, le=10_000)]


class Ethics(Confined):
    """Who approved the study. The fields of a lab's own approval stay empty in a published protocol."""

    board: Text
    statement: Text
    approval_number: str = ""
    approved_on: date | None = None
    expires_on: date | None = None
    contact: str = ""

    @model_validator(mode="after")
    def _in_order(self) -> Ethics:
        if self.approved_on and self.expires_on and self.expires_on <= self.approved_on:
            raise ValueError(f"expires_on must be after approved_on ({self.approved_on})")
        return self


class Eligibility(Confined):
    """Who may take part."""

    criteria: Annotated[tuple[Text, ...], Field(min_length=1)]


class Consent(Confined):
    """What participants consent to before the first session."""

    required: bool
    statement: Text
    voice_recordings: bool = False


class Exposure(Confined):
    """Limits that protect the participant; never pruned."""

    vibration_peak_m_s2: Annotated[float, Field(gt=0, le=100)]
    masker_level_db_a: Annotated[float, Field(gt=0, le=85)]
    session_min: Annotated[float, Field(gt=0, le=240)]


class Masker(Confined):
    """Noise on the headphones that hides the sound of the stimuli."""

    noise: Literal["pink", "white"]
    level_set_by: Literal["participant", "experimenter"]
    criterion: Text


class Material(Confined):
    """One of the materials a participant tells apart, and how its name is said and keyed."""

    id: Text
    key: Key
    spoken: Annotated[tuple[Text, ...], Field(min_length=1)]
    description: Text


class Synthesis(Confined):
    """Recordings from which virtual stimuli are made (section 3.1 of the source)."""

    rate_hz: Annotated[int, Field(ge=100, le=192_000)]
    samples: Annotated[int, Field(ge=2, le=1_000_000)]
    takes: Annotated[int, Field(ge=1, le=100)]
    speeds_mm_s: Annotated[tuple[Annotated[float, Field(gt=0)], ...], Field(min_length=2)]
    average: Literal["magnitude", "signed"] = "magnitude"

    @model_validator(mode="after")
    def _speeds_rise(self) -> Synthesis:
        if any(b <= a for a, b in zip(self.speeds_mm_s, self.speeds_mm_s[1:], strict=False)):
            raise ValueError(f"speeds_mm_s must rise strictly, got {list(self.speeds_mm_s)}")
        return self


class Step(Confined):
    """How a foot step is read: the gate, and the contact that ends it."""

    gate_top_mm: Annotated[float, Field(gt=0)]
    gate_bottom_mm: Annotated[float, Field(gt=0)]
    contact_mm: Annotated[float, Field(ge=0)]

    @model_validator(mode="after")
    def _downwards(self) -> Step:
        if not self.gate_top_mm > self.gate_bottom_mm > self.contact_mm:
            raise ValueError("gate_top_mm > gate_bottom_mm > contact_mm must hold")
        return self


class Familiarisation(Confined):
    """Free handling of the real materials before a task."""

    min_s: Annotated[float, Field(ge=0)]
    max_s: Annotated[float, Field(gt=0)]
    instruction: Text

    @model_validator(mode="after")
    def _in_order(self) -> Familiarisation:
        if self.max_s < self.min_s:
            raise ValueError(f"max_s must be at least min_s ({self.min_s})")
        return self


class Order(Confined):
    """How the trials of a task are put in order."""

    kind: Literal["full-random", "blocked-random", "max-run"]
    max_run: Annotated[int, Field(ge=1)] | None = None

    @model_validator(mode="after")
    def _run_length(self) -> Order:
        if (self.kind == "max-run") != (self.max_run is not None):
            raise ValueError("max_run is given with kind 'max-run' and only then")
        return self


class Task(Confined):
    """One task: which stimuli, how often, in which order, for how many participants."""

    id: Label
    title: Text
    stimulus: Literal["virtual", "real"]
    instruction: Text
    participants: Annotated[int, Field(ge=1)]
    repetitions: Annotated[int, Field(ge=1, le=1000)]
    order: Order
    familiarisation: Familiarisation


class TaskOrder(Confined):
    """In which order a participant does the tasks, and the break between them."""

    kind: Literal["counterbalanced", "fixed"]
    break_min_s: Annotated[float, Field(ge=0)]


class Answers(Confined):
    """How answers are given and logged."""

    mode: Literal["oral"]
    no_answer_key: Key
    redo_key: Key
    pause_key: Key


class ExclusionRule(Confined):
    """One rule that leaves out a trial or a participant, and says so.

    `when` is one of: `frames-lost` (more than `limit` frames lost or damaged between gate and contact),
    `speed-below` / `speed-above` (foot speed, mm/s, against `limit`), `answers-below` (fewer than `limit`
    answered trials in a task), `withdrawn`.
    """

    id: Text
    when: Literal["frames-lost", "speed-below", "speed-above", "answers-below", "withdrawn"]
    limit: float | None = None
    action: Literal["repeat-trial", "exclude-trial", "exclude-participant"]
    reason: Text

    @model_validator(mode="after")
    def _limit_and_action(self) -> ExclusionRule:
        if (self.when == "withdrawn") == (self.limit is not None):
            raise ValueError("limit is given with every rule but 'withdrawn'")
        if (self.when in ("answers-below", "withdrawn")) != (self.action == "exclude-participant"):
            raise ValueError("'answers-below' and 'withdrawn' exclude a participant, the others a trial")
        return self


class PlannedTest(Confined):
    """One test of the planned analysis, by name."""

    test: Literal["t against chance", "one-way ANOVA", "two-way ANOVA", "ICC"]
    tasks: Annotated[tuple[Label, ...], Field(min_length=1)]
    question: Text
    chance: Annotated[float, Field(gt=0, lt=1)] | None = None
    form: Text | None = None
    alpha: Annotated[float, Field(gt=0, lt=1)] = 0.05

    @model_validator(mode="after")
    def _completely_named(self) -> PlannedTest:
        if (self.test == "t against chance") != (self.chance is not None):
            raise ValueError("chance is given with 't against chance' and only then")
        if (self.test == "ICC") != (self.form is not None):
            raise ValueError("form is given with 'ICC' and only then")
        return self


class Protocol(Confined):
    """A whole study. Names are unique and every reference between parts holds."""

    format: Literal[1]
    study: Study
    ethics: Ethics
    eligibility: Eligibility
    consent: Consent
    exposure: Exposure
    masker: Masker
    answers: Answers
    synthesis: Synthesis
    step: Step
    materials: Annotated[tuple[Material, ...], Field(min_length=2)]
    task_order: TaskOrder
    tasks: Annotated[tuple[Task, ...], Field(min_length=1)]
    exclusion: tuple[ExclusionRule, ...] = ()
    analysis: Annotated[tuple[PlannedTest, ...], Field(min_length=1)]

    def task(self, task_id: str) -> Task:
        """The task with this id; `KeyError` when there is none."""
        for task in self.tasks:
            if task.id == task_id:
                return task
        raise KeyError(task_id)
