"""Frozen models of a protocol file: what a study is, as its ethics board approved it.

Unknown keys are refused. Units stand in the names. Text that a board reads is kept word for word.
What must hold between fields stands in `rules`; each model names its own.
"""

from __future__ import annotations

from datetime import date
from typing import Annotated, ClassVar, Literal

from pydantic import Field

from experiment.protocol import rules
from experiment.settings.load import Confined, Key, Label, Name, Rules, Text


class Study(Confined):
    """What the study is and where it was published."""

    id: Label
    title: Text
    source: Text
    participants: Annotated[int, Field(ge=1, le=10_000)]


class Ethics(Confined):
    """Who approved the study. The fields of a lab's own approval stay empty in a published protocol."""

    RULES: ClassVar[Rules] = rules.ethics

    board: Text
    statement: Text
    approval_number: str = ""
    approved_on: date | None = None
    expires_on: date | None = None
    contact: str = ""


class Eligibility(Confined):
    """Who may take part."""

    criteria: Annotated[tuple[Text, ...], Field(min_length=1)]


class Consent(Confined):
    """What participants consent to before the first session."""

    required: bool
    statement: Text
    voice_recordings: bool = False


class Duration(Confined):
    """How long one participant's visit takes, all tasks and breaks included, as participants are told before."""

    RULES: ClassVar[Rules] = rules.duration

    shortest_min: Annotated[float, Field(gt=0)]
    longest_min: Annotated[float, Field(gt=0)]


class Exposure(Confined):
    """Limits that protect the participant; never pruned. A session is one task of one participant."""

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

    RULES: ClassVar[Rules] = rules.material

    id: Name
    key: Key
    spoken: Annotated[tuple[Name, ...], Field(min_length=1)]
    description: Text


class Synthesis(Confined):
    """Recordings from which virtual stimuli are made (section 3.1 of the source)."""

    RULES: ClassVar[Rules] = rules.synthesis

    rate_hz: Annotated[int, Field(ge=100, le=192_000)]
    samples: Annotated[int, Field(ge=2, le=1_000_000)]
    takes: Annotated[int, Field(ge=1, le=100)]
    speeds_mm_s: Annotated[tuple[Annotated[float, Field(gt=0)], ...], Field(min_length=2)]
    average: Literal["magnitude", "signed"] = "magnitude"


class Tactile(Confined):
    """What skin and actuator can pass; what lies outside may be left out where it stays below the floor.

    `low_hz` to `high_hz`: the frequencies that count. `floor_m_s2`: rms of all that lies outside the band together,
    below which it is not felt; decided for all materials of a task at once. `source`: where both come from.
    """

    RULES: ClassVar[Rules] = rules.tactile

    low_hz: Annotated[float, Field(ge=0)]
    high_hz: Annotated[float, Field(gt=0)]
    floor_m_s2: Annotated[float, Field(gt=0)]
    source: Text

    @property
    def band_hz(self) -> tuple[float, float]:
        """Lowest and highest frequency that count, Hz."""
        return self.low_hz, self.high_hz


class Step(Confined):
    """How a foot step is read: the gate, and the contact that ends it."""

    RULES: ClassVar[Rules] = rules.step

    gate_top_mm: Annotated[float, Field(gt=0)]
    gate_bottom_mm: Annotated[float, Field(gt=0)]
    contact_mm: Annotated[float, Field(ge=0)]


class Footstep(Confined):
    """What trials of the kind `footstep` need: how the step is read, and what its stimuli are made of."""

    step: Step
    synthesis: Synthesis
    tactile: Tactile


class Familiarisation(Confined):
    """Free handling of the real materials before a task."""

    RULES: ClassVar[Rules] = rules.familiarisation

    min_s: Annotated[float, Field(ge=0)]
    max_s: Annotated[float, Field(gt=0)]
    instruction: Text


class Order(Confined):
    """How the trials of a task are put in order."""

    RULES: ClassVar[Rules] = rules.order

    kind: Literal["full-random", "blocked-random", "max-run"]
    max_run: Annotated[int, Field(ge=1)] | None = None


class Task(Confined):
    """One task: which kind of trial, which stimuli, how often, in which order, for how many participants."""

    id: Label
    title: Text
    kind: Literal["footstep"]
    stimulus: Literal["virtual", "real"]
    instruction: Text
    participants: Annotated[int, Field(ge=1)]
    repetitions: Annotated[int, Field(ge=1, le=1000)]
    order: Order
    familiarisation: Familiarisation


class TaskOrder(Confined):
    """In which order a participant does the tasks, and the break between them.

    `fixed` is the order of the file; `counterbalanced` gives each order to as many participants, by permuted blocks.
    """

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

    `when` is one of: `frames-lost` (more than `limit` frames lost or damaged between arming and contact),
    `speed-below` / `speed-above` (foot speed, mm/s, against `limit`), `undelivered` (the loopback heard the stimulus
    early, late, changed or not at all, by the rig's thresholds), `answers-below` (fewer than `limit` answered trials in
    a task), `withdrawn`. A trial that a rule repeats may have been felt, so it comes again at the end of its block.
    """

    RULES: ClassVar[Rules] = rules.exclusion_rule

    id: Name
    when: Literal["frames-lost", "speed-below", "speed-above", "undelivered", "answers-below", "withdrawn"]
    limit: Annotated[float, Field(ge=0)] | None = None
    action: Literal["repeat-trial", "exclude-trial", "exclude-participant"]
    reason: Text


class PlannedTest(Confined):
    """One test of the planned analysis, by name."""

    RULES: ClassVar[Rules] = rules.planned_test

    test: Literal["t against chance", "one-way ANOVA", "two-way ANOVA", "ICC"]
    tasks: Annotated[tuple[Label, ...], Field(min_length=1)]
    question: Text
    chance: Annotated[float, Field(gt=0, lt=1)] | None = None
    form: Text | None = None
    alpha: Annotated[float, Field(gt=0, lt=1)] = 0.05


class Protocol(Confined):
    """A whole study. Names are unique and every reference between parts holds."""

    RULES: ClassVar[Rules] = rules.protocol

    format: Literal[2]
    study: Study
    ethics: Ethics
    eligibility: Eligibility
    consent: Consent
    duration: Duration | None = None
    exposure: Exposure
    masker: Masker
    answers: Answers
    footstep: Footstep
    materials: Annotated[tuple[Material, ...], Field(min_length=2)]
    task_order: TaskOrder
    tasks: Annotated[tuple[Task, ...], Field(min_length=1)]
    exclusion: tuple[ExclusionRule, ...] = ()
    analysis: Annotated[tuple[PlannedTest, ...], Field(min_length=1)]

    def task(self, task_id: str) -> Task:
        """Return the task with this id. Raises `KeyError` if there is none."""
        for task in self.tasks:
            if task.id == task_id:
                return task
        raise KeyError(task_id)
