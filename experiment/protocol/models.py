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
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, TypeVar

from pydantic import Field, PrivateAttr

from palpate.experiment.errors import ProtocolError, mismatch
from palpate.experiment.protocol import rules
from palpate.experiment.protocol.designs import Design, design_of
from palpate.experiment.protocol.kinds import Kind
from palpate.experiment.settings.load import ONE_LINE, Confined, Key, Label, Line, Name, Remark, Rules, Text
from palpate.experiment.storage import Place

OLDER = (2, 3)
"""Formats in which the design was a part of the kind; `older` reads them."""

ASKING = 7
"""The first format in which a design asks its own question."""


def _since_7() -> Any:
    return Field(None, json_schema_extra={"since": 7})


class Study(Confined):
    """What the study is and where it was published.

    Attributes:
        id: name of the study, files, and dataset.
        title: its name.
        source: publication or plan it follows.
        participants: number of people.
    """

    id: Label
    title: Text
    source: Text
    participants: Annotated[int, Field(ge=1, le=10_000)]


class Ethics(Confined):
    """Who approved the study. Leave the approval by your lab's board empty: it is in the seal.

    Attributes:
        board: ethics board.
        statement: what it approved.
        approval_number: only if the approval is older than the file.
        approved_on: first day.
        expires_on: last day.
        contact: for participants.
    """

    RULES: ClassVar[Rules] = rules.ethics

    board: Text
    statement: Text
    approval_number: Remark = ""
    approved_on: date | None = None
    expires_on: date | None = None
    contact: Remark = ""


class Eligibility(Confined):
    """Eligibility criteria.

    Attributes:
        criteria: one sentence for each condition.
        confirmed: whether the experimenter confirms each criterion before the first session (recorded).
    """

    criteria: Annotated[tuple[Text, ...], Field(min_length=1)]
    confirmed: bool = Field(False, json_schema_extra={"since": 7})


class Consent(Confined):
    """What participants consent to before the first session.

    Attributes:
        required: whether consent must be recorded.
        statement: what participants are told and agree to.
        voice_recordings: store audio recordings of the answers of participants who agree.
        kept_months: how long data are kept after the last session (`palpate status` warns).
    """

    required: bool
    statement: Text
    voice_recordings: bool = False
    kept_months: Annotated[int, Field(ge=1, le=1200)] | None = None


class Sharing(Confined):
    """Data sharing for participants who agree. Without this table, `palpate share` refuses.

    Attributes:
        statement: what participants are told and agree to, or not, in a separate question.
        smallest_group: smallest number of participants with the same combination of shared personal facts.
        keep_labels: whether the laboratory stores the list of old and new labels.
        facts: ids of `[[asked.people]]` that are shared.
        questionnaires: ids of `[[asked.questionnaires]]` that are shared, except free text.
    """

    statement: Text
    smallest_group: Annotated[int, Field(ge=1, le=1000)] = 5
    keep_labels: bool = False
    facts: tuple[Line, ...] = ()
    questionnaires: tuple[Line, ...] = ()


class Duration(Confined):
    """Duration of a visit with breaks, as participants are told.

    Attributes:
        shortest_min: duration of a short visit.
        longest_min: duration of a long visit.
    """

    RULES: ClassVar[Rules] = rules.duration

    shortest_min: Annotated[float, Field(gt=0)]
    longest_min: Annotated[float, Field(gt=0)]


class Exposure(Confined):
    """Limits that protect the participant. A session is one task of one participant.

    Attributes:
        vibration_peak_m_s2: largest acceleration of the panel.
        masker_level_db_a: loudest masker at the ear.
        session_min: longest session.
        force_peak_n: largest force on the hand; required for virtual surfaces.
    """

    vibration_peak_m_s2: Annotated[float, Field(gt=0, le=100)]
    masker_level_db_a: Annotated[float, Field(gt=0, le=85)]
    session_min: Annotated[float, Field(gt=0, le=240)]
    force_peak_n: Annotated[float, Field(gt=0, le=50)] | None = None


class Probe(Confined):
    """A stimulus the panel plays on request while the masker is set.

    Attributes:
        material: material that vibrates; only in virtual tasks.
        speed_mm_s: speed of the foot.
    """

    material: Name
    speed_mm_s: Annotated[float, Field(gt=0, le=1000)]


class Masker(Confined):
    """Noise on the headphones that hides the stimuli's sound.

    Attributes:
        noise: color.
        level_set_by: who sets the level.
        criterion: what must be true at the chosen level.
        probe: what can be played meanwhile, so that there is something to hide.
    """

    noise: Literal["pink", "white"]
    level_set_by: Literal["participant", "experimenter"]
    criterion: Text
    probe: Probe | None = None


class Material(Confined):
    """A material to identify or compare.

    Attributes:
        id: its name in orders, journals, tables.
        key: key that the experimenter presses for this answer; only identification.
        spoken: what participants may call it (the first is shown); only identification.
        description: make, size, weight.
    """

    RULES: ClassVar[Rules] = rules.material

    id: Name
    key: Key | None = None
    spoken: tuple[Name, ...] = ()
    description: Text


class Step(Confined):
    """How a step is measured. Heights are above the panel.

    Attributes:
        gate_top_mm: where speed measurement begins.
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

    @property
    def companions(self) -> Mapping[str, str]:
        """The files that stand beside the protocol's, by name, each with its SHA-256."""
        return {}

    @property
    def peaks_m_s2(self) -> Mapping[str, float]:
        """The peak of each material's stimulus at level 1, m/s^2, where the protocol states it."""
        return {}

    @property
    def limits_m_s2(self) -> Mapping[str | None, float]:
        """The largest acceleration at each site of the body; empty where there is one place for all."""
        return {}

    @property
    def site_of(self) -> Mapping[str, str | None]:
        """The site of the body of each material's stimulus; empty where there is one place for all."""
        return {}

    @property
    def numbers(self) -> Mapping[str, Mapping[str, float]]:
        """The numbers of each material's stimulus that is one wave or one tap, by their keys."""
        return {}

    @property
    def trial_s(self) -> float:
        """How long the stimuli of a trial take at most, with pauses between them, s; 0 where a touch makes them."""
        return 0.0


Table = TypeVar("Table", bound=Confined)


class Familiarisation(Confined):
    """Free exploration of the real materials, or presented stimuli, before a task.

    Attributes:
        min_s: shortest duration.
        max_s: longest duration.
        instruction: for the participant.
    """

    RULES: ClassVar[Rules] = rules.familiarisation

    min_s: Annotated[float, Field(ge=0)]
    max_s: Annotated[float, Field(gt=0)]
    instruction: Text


class Order(Confined):
    """How a task's trials are ordered.

    Attributes:
        kind: all trials shuffled; each repetition shuffled; at most `max_run` of a material in a row (not for pairs).
        max_run: longest run of a material.
    """

    RULES: ClassVar[Rules] = rules.order

    kind: Literal["full-random", "blocked-random", "max-run"]
    max_run: Annotated[int, Field(ge=1)] | None = None


class Levels(Confined):
    """How strong vibrations are, trial by trial.

    Each material to identify, pair to compare or signal to detect has its own track.

    Attributes:
        method: `up-down` (Levitt 1971): `down` right answers in a row lower the level one step, and a wrong one raises
            it `up` steps; or the level most informative about threshold, spread and lapse rate (`quest-plus`, Watson
            2017), or about the first two (`psi`, Prins 2013); or each level equally often (`constant`).
        grid: levels, ascending; every vibration is multiplied by its level.
        first: starting level of `up-down`.
        down: right answers in a row that lower the level: 2 for 70.7 % right, 3 for 79.4 %.
        reversals: reversals that end a track, unless repetitions end first.
        up: steps by which a wrong answer raises the level (Kaernbach 1991); 3 with a `down` of 1 for 75 %.
        steps: step sizes in levels; each lasts until the next reversal, and the last remains.
        thresholds: possible thresholds (half of unguessed answers right); all equally probable, like those of the next
            two keys.
        spreads_db: possible distances from the threshold to 84 %.
        lapses: possible lapse rates.
        guess: guess rate.
        precision_db: standard deviation of the threshold that ends a track.
    """

    RULES: ClassVar[Rules] = rules.levels

    method: Literal["up-down", "quest-plus", "psi", "constant"]
    grid: Annotated[tuple[Annotated[float, Field(gt=0, le=1)], ...], Field(min_length=2)]
    first: Annotated[float, Field(gt=0, le=1)] | None = None
    down: Annotated[int, Field(ge=1, le=10)] | None = None
    reversals: Annotated[int, Field(ge=1, le=100)] | None = None
    up: Annotated[int, Field(ge=1, le=10)] | None = _since_7()
    steps: Annotated[tuple[Annotated[int, Field(ge=1, le=100)], ...], Field(min_length=1)] | None = _since_7()
    thresholds: Annotated[tuple[Annotated[float, Field(gt=0)], ...], Field(min_length=2)] | None = _since_7()
    spreads_db: Annotated[tuple[Annotated[float, Field(gt=0)], ...], Field(min_length=1)] | None = _since_7()
    lapses: Annotated[tuple[Annotated[float, Field(ge=0, lt=0.5)], ...], Field(min_length=1)] | None = _since_7()
    guess: Annotated[float, Field(ge=0, lt=1)] | None = _since_7()
    precision_db: Annotated[float, Field(gt=0)] | None = _since_7()


class Control(Confined):
    """Makes a task a control: the vibration sounds as in another task but does not reach the skin.

    Attributes:
        of: id of the virtual task whose masking it tests.
        arrangement: what keeps the vibration from the skin; the experimenter confirms it before the trials.
        margin: difference from chance (proportion correct) that still counts as chance.
    """

    of: Label
    arrangement: Text
    margin: Annotated[float, Field(gt=0, lt=1)] = 0.1


class Ahead(Confined):
    """A footstep's vibration that begins before the predicted contact.

    Attributes:
        delay_ms: start relative to contact; negative means before it.
        error_max_ms: steps with a larger timing error are repeated; rigs that have a larger expected standard error or
            were not measured are refused.
        broken_off: if a step ends above the panel: cancel a vibration that has not begun, or play it.
    """

    delay_ms: Annotated[float, Field(ge=-200, lt=0)]
    error_max_ms: Annotated[float, Field(gt=0, le=200)] | None = None
    broken_off: Literal["nothing", "vibration"] = "nothing"


class Criterion(Confined):
    """What ends training before its last trial.

    Attributes:
        right: right answers needed
        of: among this many latest answers, or fewer.
        unmet: if the criterion is not met, the session continues, or ends without trials that count (recorded).
    """

    right: Annotated[int, Field(ge=1, le=1000)]
    of: Annotated[int, Field(ge=1, le=1000)]
    unmet: Literal["go on", "end"]


class Training(Confined):
    """Trials before those that count; recorded, never analyzed.

    Attributes:
        trials: maximum number.
        feedback: show participants after each answer whether it was right.
        told_right: text for a right answer.
        told_wrong: text for any other answer, or none.
        criterion: what ends it early.
    """

    trials: Annotated[int, Field(ge=1, le=1000)]
    feedback: bool
    told_right: Line = "That was right."
    told_wrong: Line = "That was not right."
    criterion: Criterion | None = None

    @property
    def fewest(self) -> int:
        """How many trials it takes at least."""
        return self.trials if self.criterion is None else self.criterion.right


class Picture(Confined):
    """A picture of the instructions, a PNG file beside the protocol's.

    Attributes:
        file: the name of the file.
        sha256: its hash, so that the protocol's hash identifies one picture.
    """

    file: Annotated[
        str,
        Field(pattern=r"^[^/\\\s.][^/\\\s]*\.png$", description="the name of a .png file in the protocol's folder"),
        ONE_LINE,
    ]
    sha256: Annotated[str, Field(pattern=r"^[0-9a-f]{64}$", description="64 hexadecimal digits, as sha256sum prints")]


class Task(Confined):
    """One task.

    Attributes:
        id: its name in commands, files, tables.
        title: its name.
        kind: what triggers and plays a stimulus.
        design: the question: which material it is, which of two has more of a quality, how much of it one has, or
            whether anything was felt. Formats 2 and 3 have no designs: there, `footstep` means identification, and
            `comparison` means tapping.
        stimulus: synthesized or rendered, or real objects laid out.
        instruction: for the participant.
        pictures: shown after the instruction.
        question: question on the participant's screen in each trial, if not the design's.
        participants: number of participants, taken in order of enrollment.
        repetitions: of each material, of each pair (half in each order), or of a detection block.
        order: how the trials are put in order.
        familiarisation: what comes before the trials.
        masker: this task's noise, if not that of `[masker]`.
        materials: materials presented, if not all, in the protocol's order; any can be the answer.
        levels: how strong its vibrations are, if not as they are made.
        phase: phases of a footstep's vibration, if not the signs of equation (4): all equal, random, or preserving the
            recorded profile.
        ahead: begins a footstep's vibration before contact.
        control: makes it a control, whose answers must be at chance.
        training: what comes between familiarisation and the trials that count.
    """

    id: Label
    title: Text
    kind: Kind
    design: Design = Field(json_schema_extra={"since": 4})
    stimulus: Literal["virtual", "real"]
    instruction: Text
    pictures: Annotated[tuple[Picture, ...], Field(min_length=1)] | None = _since_7()
    question: Text | None = Field(None, json_schema_extra={"since": 7})
    participants: Annotated[int, Field(ge=1)]
    repetitions: Annotated[int, Field(ge=1, le=1000)]
    order: Order
    familiarisation: Familiarisation
    masker: Literal["none", "pink", "white"] | None = None
    materials: Annotated[tuple[Name, ...], Field(min_length=1)] | None = None
    levels: Levels | None = Field(None, json_schema_extra={"since": 5})
    phase: Literal["zero", "random", "recorded"] | None = _since_7()
    ahead: Ahead | None = _since_7()
    control: Control | None = _since_7()
    training: Training | None = _since_7()

    @property
    def picture_files(self) -> tuple[str, ...]:
        """Names of its pictures."""
        return tuple(one.file for one in self.pictures or ())


class TaskOrder(Confined):
    """Order of tasks, and breaks between them.

    Attributes:
        kind: `counterbalanced`: each order equally often, in permuted blocks; `fixed`: as in the file.
        break_min_s: shortest break.
    """

    kind: Literal["counterbalanced", "fixed"]
    break_min_s: Annotated[float, Field(ge=0)]


class Answers(Confined):
    """How answers are given.

    Attributes:
        mode: spoken, and entered by the experimenter; or given by the participant, with buttons named like the answers'
            keys, or on the screen.
        on_screen: the participant's screen shows the materials.
        progress: that screen shows the numbers of answered and planned trials.
        reveal: the experimenter may view levels and answers by material (recorded).
        no_answer_key: no answer.
        redo_key: repeat the trial at the end of its block.
        pause_key: pause the session.
        microphone: a microphone times the voice and proposes the answer; the experimenter's key decides.
    """

    mode: rules.Mode = "oral"
    on_screen: bool = False
    progress: bool = Field(False, json_schema_extra={"since": 7})
    reveal: bool = Field(False, json_schema_extra={"since": 7})
    no_answer_key: Key
    redo_key: Key
    pause_key: Key
    microphone: bool = False


class ExclusionRule(Confined):
    """A rule that excludes a trial or a participant. A repeated trial is presented again at the end of its block.

    Attributes:
        id: its name in reports.
        when: frames lost or damaged before contact; foot's speed; stimulus not delivered (by the rig's thresholds);
            answered trials in a task; withdrawal.
        limit: number of frames, mm/s or answers: the rule applies above it for `frames-lost` and `speed-above`, else
            below it.
        action: what happens.
        reason: as in reports.
    """

    RULES: ClassVar[Rules] = rules.exclusion_rule

    id: Name
    when: Literal["frames-lost", "speed-below", "speed-above", "undelivered", "answers-below", "withdrawn"]
    limit: Annotated[float, Field(ge=0)] | None = None
    action: Literal["repeat-trial", "exclude-trial", "exclude-participant"]
    reason: Text


class PlannedTest(Confined):
    """A test of the planned analysis.

    Attributes:
        test: test, or scale of comparisons.
        tasks: ids of its tasks.
        question: what it answers, and how.
        chance: proportion correct when guessing.
        form: form of the intraclass correlation.
        margin: difference in proportions that counts as equivalent.
        alpha: significance level.
        correction: Holm's family: materials or pairs in a task, tasks, or both; otherwise, P is unadjusted, except for
            equivalence of pairs.
        materials: materials tested; otherwise, all that are presented or, for a one-way ANOVA, the most confused pair
            (exploratory). Not in format 2.
        groups: the fact in `[[asked.people]]` whose values are the groups, or `group` for those of `[[groups]]`.
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
    groups: Name | None = Field(None, json_schema_extra={"since": 7})

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
        format: the format of the file.
        study: what the study is.
        ethics: who approved it.
        eligibility: who may take part.
        consent: what participants agree to.
        sharing: what is shared of those who agree to it.
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
    sharing: Sharing | None = Field(None, json_schema_extra={"since": 7})
    duration: Duration | None = None
    exposure: Exposure
    masker: Masker
    answers: Answers
    materials: Annotated[tuple[Material, ...], Field(min_length=2)]
    task_order: TaskOrder
    tasks: Annotated[tuple[Task, ...], Field(min_length=1)]
    exclusion: tuple[ExclusionRule, ...] = ()
    analysis: Annotated[tuple[PlannedTest, ...], Field(min_length=1)]

    _folder: Path = PrivateAttr(Path())

    def __eq__(self, other: object) -> bool:
        """Return whether another protocol says the same, in whatever folder its file is."""
        return isinstance(other, Protocol) and self.__dict__ == other.__dict__

    def task(self, task_id: str) -> Task:
        """Return the task with this id. Raises `KeyError` if there is none."""
        for task in self.tasks:
            if task.id == task_id:
                return task
        raise KeyError(task_id)

    def materials_of(self, task: Task) -> tuple[str, ...]:
        """Return the ids of the materials that a task presents, in their order."""
        return task.materials or tuple(material.id for material in self.materials)

    def question(self, task: Task) -> str:
        """Return what participants are asked in each trial of a task; empty where the words of the rig ask."""
        return task.question or (design_of(task.design).asks(self) if self.format >= ASKING else "")

    def presentations(self, task: Task) -> tuple[tuple[str, ...], ...]:
        """Return what a block of a task presents: each of its materials, or every pair of two, without levels one with
        itself; or what its design has.
        """
        design = design_of(task.design)
        if design.presentations is not None:
            return design.presentations(self, task)
        choose = combinations_with_replacement if task.levels is None else combinations
        return tuple(choose(self.materials_of(task), self.shown_together(task)))

    def shown_together(self, task: Task) -> int:
        """Return how many materials one trial of a task presents."""
        return design_of(task.design).shown_together(getattr(self, task.design, None))

    def trials(self, task: Task) -> int:
        """Return how many trials a participant has in a task, at most where it has levels."""
        return task.repetitions * len(self.presentations(task))

    def felt_trials(self, task: Task) -> int:
        """Return how many trials a participant has in a task at most, those of its training among them."""
        return self.trials(task) + (task.training.trials if task.training else 0)

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

    @property
    def limits_m_s2(self) -> dict[str | None, float]:
        """The largest acceleration at each site of the body where stimuli are felt; None is the one place for all."""
        one_place: dict[str | None, float] = {None: self.exposure.vibration_peak_m_s2}
        each = (self.kind_table(task).limits_m_s2 or one_place for task in self.tasks if task.stimulus == "virtual")
        return dict(limit for limits in each for limit in limits.items()) or one_place

    @property
    def folder(self) -> Path:
        """The folder of its file; the working folder for one that was read from none."""
        return self._folder

    @property
    def companions(self) -> Mapping[str, str]:
        """The files that stand beside its own, by name, each with its SHA-256."""
        own = {name: sha256 for task in self.tasks for name, sha256 in self.kind_table(task).companions.items()}
        return own | {one.file: one.sha256 for task in self.tasks for one in task.pictures or ()}

    def find(self, model: type[Table]) -> Table | None:
        """Return the table of a kind or a design; None in a study that has none."""
        return next((value for _, value in self if isinstance(value, model)), None)

    def table(self, model: type[Table]) -> Table:
        """Return the table of a kind or a design. Raises `ProtocolError` in a study that has none."""
        if (found := self.find(model)) is not None:
            return found
        name = model.__name__.lower()
        problem = mismatch(
            name, None, "no such table", f"a study whose protocol has the table [{name}]; give that protocol"
        )
        raise ProtocolError.in_file(f"study {self.study.id}", [problem])

    @classmethod
    def renewed(cls, document: Mapping[str, Any]) -> Mapping[str, Any]:
        return module.renewed(document) if (module := written_as(document)) else document

    @classmethod
    def stated(cls, place: Place, document: Mapping[str, Any]) -> Place:
        return module.stated(place, document) if (module := written_as(document)) else place


def written_as(document: Mapping[str, Any]) -> Any:
    """Return the module that reads a file of an older format, or one with factors; None for any other."""
    factors = "palpate.experiment.protocol.designs.factors"
    return older() if document.get("format") in OLDER else document.get("factors") and import_module(factors)


def older() -> Any:
    """Return the module that reads older formats; a file of the newest one brings it nowhere."""
    return import_module("palpate.experiment.protocol.older")
