"""Frozen models of a protocol file: what a study is, as its ethics board approved it.

Unknown keys are refused. Units stand in the names. Text that a board reads is kept word for word.
What must hold between fields stands in `rules`; each model names its own. The words under `Attributes:` are what
`protocols/keys.md` says of each key.
"""

from collections.abc import Mapping
from datetime import date
from fractions import Fraction
from importlib import import_module
from itertools import combinations, combinations_with_replacement
from typing import Annotated, Any, ClassVar, Literal, TypeVar

from pydantic import Field

from palpate.experiment.errors import ProtocolError, mismatch
from palpate.experiment.protocol import rules
from palpate.experiment.protocol.designs import Design, design_of
from palpate.experiment.protocol.kinds import Kind
from palpate.experiment.settings.load import Confined, Key, Label, Name, Remark, Rules, Text
from palpate.experiment.storage import Place

OLDER = (2, 3)
"""Formats in which the design was a part of the kind; `older` reads them."""


class Study(Confined):
    """What the study is and where it was published.

    Attributes:
        id: names the study, its files and the folder of its dataset.
        title: what the study is called.
        source: the publication or plan that the study follows.
        participants: how many people take part.
    """

    id: Label
    title: Text
    source: Text
    participants: Annotated[int, Field(ge=1, le=10_000)]


class Ethics(Confined):
    """Who approved the study. The fields of a lab's own approval stay empty in a published protocol.

    Attributes:
        board: the board that approves the study.
        statement: what the board approved, in words.
        approval_number: of an approval that is older than the file; otherwise empty, for the seal holds it.
        approved_on: the first day on which the study may run, as `approval_number`.
        expires_on: the last day on which it may, as `approval_number`.
        contact: whom participants may turn to.
    """

    RULES: ClassVar[Rules] = rules.ethics

    board: Text
    statement: Text
    approval_number: Remark = ""
    approved_on: date | None = None
    expires_on: date | None = None
    contact: Remark = ""


class Eligibility(Confined):
    """Who may take part.

    Attributes:
        criteria: one sentence for each condition.
    """

    criteria: Annotated[tuple[Text, ...], Field(min_length=1)]


class Consent(Confined):
    """What participants consent to before the first session.

    Attributes:
        required: whether a participant's consent must be on record before a session.
        statement: what participants are told and agree to.
        voice_recordings: whether the sound of spoken answers is kept, of participants who agree to that.
        kept_months: how long a participant's data are kept after their last session; `palpate status` tells when they
            are due to be deleted.
    """

    required: bool
    statement: Text
    voice_recordings: bool = False
    kept_months: Annotated[int, Field(ge=1, le=1200)] | None = None


class Duration(Confined):
    """How long one participant's visit takes, all tasks and breaks included, as participants are told before.

    Attributes:
        shortest_min: a short visit.
        longest_min: a long visit.
    """

    RULES: ClassVar[Rules] = rules.duration

    shortest_min: Annotated[float, Field(gt=0)]
    longest_min: Annotated[float, Field(gt=0)]


class Exposure(Confined):
    """Limits that protect the participant; never pruned. A session is one task of one participant.

    Attributes:
        vibration_peak_m_s2: the largest acceleration of the panel, which the limiter holds for any stimulus.
        masker_level_db_a: the loudest masker at the ear.
        session_min: the longest session.
        force_peak_n: the largest force on the hand, which the servo holds for any input; a task with virtual surfaces
            needs it.
    """

    vibration_peak_m_s2: Annotated[float, Field(gt=0, le=100)]
    masker_level_db_a: Annotated[float, Field(gt=0, le=85)]
    session_min: Annotated[float, Field(gt=0, le=240)]
    force_peak_n: Annotated[float, Field(gt=0, le=50)] | None = None


class Probe(Confined):
    """A stimulus that the panel plays, whenever it is asked for, while the masker's level is chosen.

    Attributes:
        material: whose vibration it is; only a task with virtual stimuli plays it.
        speed_mm_s: the foot's speed that it is made for.
    """

    material: Name
    speed_mm_s: Annotated[float, Field(gt=0, le=1000)]


class Masker(Confined):
    """Noise on the headphones that hides the sound of the stimuli.

    Attributes:
        noise: the noise's colour.
        level_set_by: who sets its level.
        criterion: what must hold at the level that is chosen.
        probe: what can be played meanwhile, so that there is something to hide.
    """

    noise: Literal["pink", "white"]
    level_set_by: Literal["participant", "experimenter"]
    criterion: Text
    probe: Probe | None = None


class Material(Confined):
    """One of the materials a participant tells apart or compares, and, where it is an answer, how that is said and
    keyed.

    Attributes:
        id: names the material in orders, journals and tables.
        key: the experimenter's key for this answer; of the design `identification` alone.
        spoken: what participants may call it; the first is shown to the experimenter; as `key`.
        description: what the object is: make, size, weight.
    """

    RULES: ClassVar[Rules] = rules.material

    id: Name
    key: Key | None = None
    spoken: tuple[Name, ...] = ()
    description: Text


class Step(Confined):
    """How a foot step is read: the gate, and the contact that ends it. Heights are above the panel.

    Attributes:
        gate_top_mm: where the measurement of the foot's speed begins.
        gate_bottom_mm: where it ends.
        contact_mm: where the foot counts as landed.
    """

    RULES: ClassVar[Rules] = rules.step

    gate_top_mm: Annotated[float, Field(gt=0)]
    gate_bottom_mm: Annotated[float, Field(gt=0)]
    contact_mm: Annotated[float, Field(ge=0)]


class KindTable(Confined):
    """Base of the table of a kind of trial."""

    @property
    def gate(self) -> Step | None:
        """How the step is read; None where nobody steps."""
        return None


Table = TypeVar("Table", bound=Confined)


class Familiarisation(Confined):
    """Free handling of the real materials before a task.

    Attributes:
        min_s: the shortest time.
        max_s: the longest time.
        instruction: what the participant is told.
    """

    RULES: ClassVar[Rules] = rules.familiarisation

    min_s: Annotated[float, Field(ge=0)]
    max_s: Annotated[float, Field(gt=0)]
    instruction: Text


class Order(Confined):
    """How the trials of a task are put in order.

    Attributes:
        kind: all trials shuffled, each repetition shuffled by itself, or no material more often in a row than
            `max_run`; the last is not for pairs.
        max_run: how often one material may come in a row.
    """

    RULES: ClassVar[Rules] = rules.order

    kind: Literal["full-random", "blocked-random", "max-run"]
    max_run: Annotated[int, Field(ge=1)] | None = None


class Levels(Confined):
    """How strong the vibrations of a task are, trial by trial: a level follows from the answers to trials of its track.

    Each material of an identification is a track of its own, and each two materials of a comparison.

    Attributes:
        method: transformed up-down (Levitt 1971): after `down` right answers in a row a track goes one level down,
            after each wrong one it goes one up.
        grid: the levels, from the lowest to the highest; every vibration of a trial is multiplied by its level.
        first: the level at which each track begins.
        down: how many right answers in a row lower the level; 2 lead to where 70.7 % of answers are right, 3 to 79.4 %.
        reversals: a track ends after so many changes from up to down or back, or else with its last repetition.
    """

    RULES: ClassVar[Rules] = rules.levels

    method: Literal["up-down"]
    grid: Annotated[tuple[Annotated[float, Field(gt=0, le=1)], ...], Field(min_length=2)]
    first: Annotated[float, Field(gt=0, le=1)]
    down: Annotated[int, Field(ge=1, le=10)]
    reversals: Annotated[int, Field(ge=1, le=100)]


class Task(Confined):
    """One task: its kind and design of trial, which stimuli, how often, in which order, for how many participants.

    Attributes:
        id: names the task in commands, files and tables.
        title: what the task is called.
        kind: the kind of trial: what sets a stimulus off, and what plays it.
        design: what a trial presents and asks: which material it is, or which of two has more of a quality. A file of
            format 2 or 3 has none: `footstep` stands for identification there, and the kind `comparison` for tapping.
        stimulus: what the rig makes: synthesised vibration, or rendered surfaces; or real objects that the
            experimenter lays out.
        instruction: what the participant is told.
        participants: how many do this task: those who enrol first.
        repetitions: how often each material is presented, or each pair of materials, half of these in either order.
        order: how the trials are put in order.
        familiarisation: what comes before the trials.
        masker: the colour of this task's noise, or none, where it is not that of `[masker]`.
        materials: the materials that this task presents, in their order, if not all; participants may answer any.
        levels: how strong its vibrations are, if not as they are made.
    """

    id: Label
    title: Text
    kind: Kind
    design: Design = Field(json_schema_extra={"since": 4})
    stimulus: Literal["virtual", "real"]
    instruction: Text
    participants: Annotated[int, Field(ge=1)]
    repetitions: Annotated[int, Field(ge=1, le=1000)]
    order: Order
    familiarisation: Familiarisation
    masker: Literal["none", "pink", "white"] | None = None
    materials: Annotated[tuple[Name, ...], Field(min_length=1)] | None = None
    levels: Levels | None = Field(None, json_schema_extra={"since": 5})


class TaskOrder(Confined):
    """In which order a participant does the tasks, and the break between them.

    Attributes:
        kind: `fixed`: as in the file; `counterbalanced`: each order for as many participants, by permuted blocks.
        break_min_s: the shortest break between two tasks.
    """

    kind: Literal["counterbalanced", "fixed"]
    break_min_s: Annotated[float, Field(ge=0)]


class Answers(Confined):
    """How answers are given and logged.

    Attributes:
        mode: the participant says the answer, and the experimenter keys it.
        on_screen: the participant's screen, where there is one, shows what may be answered, materials in their order.
        no_answer_key: the key for a trial without an answer.
        redo_key: the key that has the trial done again, at the end of its block.
        pause_key: the key that pauses the session.
        microphone: whether a microphone listens, which tells when the voice began and proposes the answer; the
            experimenter's key decides.
    """

    mode: Literal["oral"]
    on_screen: bool = False
    no_answer_key: Key
    redo_key: Key
    pause_key: Key
    microphone: bool = False


class ExclusionRule(Confined):
    """One rule that leaves out a trial or a participant, and says so.

    A trial that a rule repeats may have been felt, so it comes again at the end of its block.

    Attributes:
        id: names the rule in reports.
        when: frames lost or damaged between arming and contact; the foot's speed; a stimulus that the loopback heard
            early, late, changed or not at all, by the rig's thresholds, or that the audio stream missed or limited;
            answered trials in a task; or a participant who withdrew.
        limit: frames, mm/s or answers, by `when`; the rule holds for `frames-lost` and `speed-above` where there are
            more, for the others where there are fewer.
        action: what the rule does.
        reason: why, as it stands in reports.
    """

    RULES: ClassVar[Rules] = rules.exclusion_rule

    id: Name
    when: Literal["frames-lost", "speed-below", "speed-above", "undelivered", "answers-below", "withdrawn"]
    limit: Annotated[float, Field(ge=0)] | None = None
    action: Literal["repeat-trial", "exclude-trial", "exclude-participant"]
    reason: Text


class PlannedTest(Confined):
    """One test of the planned analysis, by name.

    Attributes:
        test: which test, or which scale from comparisons.
        tasks: the tasks that it is about, by id.
        question: what it is to answer, and how.
        chance: the share of right answers of somebody who guesses.
        form: the form of the intraclass correlation.
        margin: the difference in shares of right answers, or of a pair told apart, below which they count as the same.
        alpha: the level of significance.
        correction: the family of tests over which Holm's method adjusts P: the materials, or their pairs, of a task, or
            those of all `tasks`, or the pairs of these; without it P is not adjusted, unless of equivalent pairs.
        materials: those that the test is of; without them it is of all that its tasks present, but a one-way ANOVA,
            of two, of the pair most confused, and exploratory. A file of format 2 has none.
    """

    RULES: ClassVar[Rules] = rules.planned_test

    test: Name
    tasks: Annotated[tuple[Label, ...], Field(min_length=1)]
    question: Text
    chance: Annotated[float, Field(gt=0, lt=1)] | None = None
    form: Text | None = None
    margin: Annotated[float, Field(gt=0, lt=1)] | None = None
    alpha: Annotated[float, Field(gt=0, lt=1)] = 0.05
    correction: Literal["materials", "materials and tasks", "tasks"] | None = None
    materials: Annotated[tuple[Name, ...], Field(min_length=1)] | None = Field(None, json_schema_extra={"since": 3})

    def exact_chance(self, materials: int) -> Fraction:
        """Return `chance`, or else that of a guess among so many materials; of a guess also where not all of its digits
        are written.

        Sign flips are counted in its denominator, and in that of 0.333333333 none can be.
        """
        guess = Fraction(1, materials)
        return guess if self.chance is None or abs(self.chance - guess) < 1e-6 else Fraction(repr(self.chance))


# `files.ProtocolFile` adds the tables of kinds and designs.
class Protocol(Confined):
    """A whole study.

    Attributes:
        format: the form of the file.
        study: what the study is.
        ethics: who approved it.
        eligibility: who may take part.
        consent: what participants agree to.
        duration: how long a visit takes.
        exposure: limits that protect the participant.
        masker: the noise on the headphones.
        answers: how answers are given.
        materials: the materials to tell apart, or to compare.
        task_order: the order of the tasks.
        tasks: the tasks.
        exclusion: what leaves out a trial or a participant.
        analysis: the planned tests.
    """

    RULES: ClassVar[Rules] = rules.protocol

    format: Literal[2, 3, 4, 5, 6, 7]
    study: Study
    ethics: Ethics
    eligibility: Eligibility
    consent: Consent
    duration: Duration | None = None
    exposure: Exposure
    masker: Masker
    answers: Answers
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

    def materials_of(self, task: Task) -> tuple[str, ...]:
        """Return the ids of the materials that a task presents, in their order."""
        return task.materials or tuple(material.id for material in self.materials)

    def presentations(self, task: Task) -> tuple[tuple[str, ...], ...]:
        """Return what a task presents: each of its materials, or every pair of two, without levels one with itself."""
        choose = combinations_with_replacement if task.levels is None else combinations
        return tuple(choose(self.materials_of(task), design_of(task.design).intervals))

    def trials(self, task: Task) -> int:
        """Return how many trials a participant has in a task, at most where it has levels."""
        return task.repetitions * len(self.presentations(task))

    @property
    def renders(self) -> bool:
        """Whether any task has virtual stimuli."""
        return any(task.stimulus == "virtual" for task in self.tasks)

    @property
    def gate(self) -> Step | None:
        """How the steps of a study are read; None in a study without any."""
        return next((gate for task in self.tasks if (gate := self.kind_table(task).gate) is not None), None)

    def kind_table(self, task: Task) -> KindTable:
        """Return the table of the kind of a task's trials, which has the kind's name; an empty one if left out."""
        table: KindTable | None = getattr(self, task.kind)
        return table or KindTable()

    def find(self, model: type[Table]) -> Table | None:
        """Return the table of a kind or a design; None in a study that has none."""
        return next((value for _, value in self if isinstance(value, model)), None)

    def table(self, model: type[Table]) -> Table:
        """Return the table of a kind or a design. Raises `ProtocolError` in a study that has none."""
        if (found := self.find(model)) is not None:
            return found
        name = model.__name__.lower()
        problem = mismatch(name, None, "no such table", f"a study with a table [{name}]; name the protocol of one")
        raise ProtocolError.in_file(f"study {self.study.id}", [problem])

    @classmethod
    def renewed(cls, document: Mapping[str, Any]) -> Mapping[str, Any]:
        return older().renewed(document) if document.get("format") in OLDER else document

    @classmethod
    def stated(cls, place: Place, document: Mapping[str, Any]) -> Place:
        return older().stated(place) if document.get("format") in OLDER else place


def older() -> Any:
    """Return the module that reads older formats; a file of the newest one brings it nowhere."""
    return import_module("palpate.experiment.protocol.older")
