"""A protocol's planned tests, as `identification.results` computes them, for many simulated studies at once."""

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from itertools import combinations
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import helmert

from palpate.analysis.documents.tables import Table, blocks
from palpate.analysis.identification.companion_tests import LEAST, MARGIN, slopes_logit
from palpate.analysis.identification.confusion import Confusion, most_confused
from palpate.analysis.identification.planned import EQUIVALENCE
from palpate.analysis.identification.results import EVERY
from palpate.analysis.statistics.anova import one_way_tests, tasks_by_materials, two_way_tests, variance_component_icc
from palpate.analysis.statistics.exact import Floats, Integers, NotDefined, Ratios, of_counts
from palpate.analysis.statistics.groups import difference_tests
from palpate.analysis.statistics.icc import NAMES, icc_tests
from palpate.analysis.statistics.inference import holm, t_tests
from palpate.analysis.statistics.participants import equivalence_tests, order_tests, repeated_tests
from palpate.analysis.statistics.shares import near_edges
from palpate.analysis.statistics.sign_flips import sign_flip_tests
from palpate.experiment.errors import PowerError
from palpate.experiment.protocol.models import PlannedTest, Protocol, Task

APART = 0.1
"""What being done first, or being in the first of two groups, adds to the share of right answers where such a test is
planned, not in a null: ours."""

FITTED = 40
"""So many of a chunk's studies have the logit, of which each takes some 40 ms."""

ABOUT = blocks(Path(__file__).with_name("about.md"))

ORDER, LOGIT, GROUPS = "order of tasks", "logit with participants", "difference of groups"
ADJUSTED = "Holm"
FLIPS = ", sign flips (companion)"
REPEATED = "repeated measures (companion)"
MOST_CONFUSED = "most confused in each study"
VARIANCE_COMPONENTS = "variance components"


@dataclass(frozen=True)
class Design:
    """What a study consists of and what it tests, as planned; `pairs` are the published pairs of materials, by task."""

    materials: tuple[str, ...]
    tasks: tuple[Task, ...]
    participants: int
    tests: tuple[PlannedTest, ...]
    pairs: Mapping[str, tuple[str, str]]

    def places(self, *tasks: str) -> list[int]:
        """Return the places of the materials that each of these tasks presents."""
        own = [task.materials or self.materials for task in self.tasks if task.id in tasks]
        return [place for place, name in enumerate(self.materials) if all(name in of for of in own)]

    def chosen(self, test: PlannedTest, *tasks: str) -> list[int]:
        """Return the places of a test's materials in these tasks: those that it names, or all."""
        return [k for k in self.places(*tasks) if test.materials is None or self.materials[k] in test.materials]

    def trials(self, task: str) -> int:
        """Return how often a task repeats each material."""
        return next(one.repetitions for one in self.tasks if one.id == task)

    def sizes(self, participants: int) -> tuple[int, ...]:
        """Return the participants of each task in a study of this size: in the plan's proportion, at least one."""
        return tuple(
            max(1, (2 * participants * task.participants + self.participants) // (2 * self.participants))
            for task in self.tasks
        )


@dataclass(frozen=True)
class Question:
    """One thing that a planned test, at place `plan` from 0, asks of each study: a material, pair, effect or form.

    `alpha` is None where the estimate itself is wanted; P may be `adjusted` by Holm's method.
    """

    plan: int
    test: str
    tasks: tuple[str, ...]
    subject: str
    alpha: float | None
    adjusted: bool = False

    @property
    def flips(self) -> bool:
        """Whether its P is of sign flips."""
        return self.subject.endswith(FLIPS) or self.test.startswith("sign flips")


@dataclass(frozen=True)
class Answer:
    """Every study's answer to one question: arrays of shape (studies,), or None where the question has no such value.

    `above` says whether the mean lies above chance. P and the estimate are NaN where a study does not define them.
    """

    p: Floats | None = None
    above: NDArray[np.bool_] | None = None
    estimate: Floats | None = None


Answers = tuple[dict[Question, Answer], dict[Question, int]]
"""The answers to each question, and how many studies err in its family where any can."""

Shown = tuple[tuple[str, ...], tuple[Table, ...]]
"""The paragraphs and tables of a model."""


@dataclass(frozen=True)
class Model(ABC):
    """How participants answer in every task, the `source`, `notes` on what was decided, and a fitted dataset's `label`.

    Each design has a class of its own, in the module that its `AnalysisDesign` names.
    """

    source: str
    tasks: tuple[Any, ...]
    notes: tuple[str, ...] = ()
    label: str = ""

    has_stars: ClassVar[bool]
    """Whether a mean above chance earns stars, so that a family may err together."""
    undefined: ClassVar[str]
    """Why several participants may give no statistic."""
    control_name: ClassVar[str]
    """The name of its control among `ABOUT`."""

    @abstractmethod
    def control(self, protocol: Protocol) -> "Model":
        """Return the model in which every null hypothesis holds, while participants differ as much."""

    def together(self, alike: float) -> "Model":
        """Return participants who have so much of their spread in common to all tasks. Raises `PowerError`."""
        raise PowerError("--alike", f"got {alike}", "leave it out", allowed="a study in which materials are named")

    @abstractmethod
    def answers(self, planned: Design, participants: int, studies: int, random: np.random.Generator) -> Answers:
        """Draw studies, and return what they answer."""

    @abstractmethod
    def shown(self, planned: Design, said: tuple[str, ...]) -> Shown:
        """Return what a report shows of the model; `said` has its source, the sizes of tasks, and notes."""


def design(protocol: Protocol, pairs: Mapping[str, tuple[str, str]], alpha: float | None = None) -> Design:
    """Return what a protocol plans, with `alpha` as every test's level where it is given; `pairs` as in `Design`."""
    materials = tuple(material.id for material in protocol.materials)
    changed = {} if alpha is None else {"alpha": alpha}
    tests = tuple(test.model_copy(update=changed) for test in protocol.analysis)
    of = {task.id: protocol.materials_of(task) for task in protocol.tasks}
    known = {task: pair for task, pair in pairs.items() if set(pair) <= set(of.get(task, ()))}
    return Design(materials, protocol.tasks, protocol.study.participants, tests, known)


def otherwise(planned: Design, simulated: Collection[int]) -> tuple[str, ...]:
    """Return one sentence for each planned test that is not simulated, or not as the others are.

    `simulated` are the places of planned tests of which something was asked.
    """
    unlike: Mapping[str, Callable[[PlannedTest], bool]] = {
        "another scale": lambda test: test.test in ("Thurstone", "Davidson"),
        ORDER: lambda test: test.test == ORDER,
        GROUPS: lambda test: test.test == GROUPS,
        LOGIT: lambda test: test.test == LOGIT,
        "another form": lambda test: test.test == "ICC" and _form(test) is None,
        "not simulated": lambda test: test.test != "ICC" and planned.tests.index(test) not in simulated,
    }
    facts = {"first": f"{APART:g}", "fitted": FITTED}
    return tuple(
        ABOUT[name].substitute(test=test.test, tasks=" and ".join(test.tasks), form=test.form, **facts)
        for name, is_so in unlike.items()
        for test in planned.tests
        if is_so(test)
    )


def answer(planned: Design, drawn: Mapping[str, Integers], first: float = 0.0) -> dict[Question, Answer]:
    """Return every planned test of every study; `drawn` holds each task's counts from `choice_models.draw`.

    Being done, or in a group that comes, `first` adds so much to the share of right answers.
    """
    trials = {task.id: task.repetitions for task in planned.tasks}
    every = {task: of_counts(counts, trials[task]) for task, counts in drawn.items()}
    found: dict[Question, Answer] = {}
    for number, test in enumerate(planned.tests):
        if test.test == "t against chance":
            found |= _t(number, test, planned, every, drawn)
        elif test.test == "one-way ANOVA":
            found |= _one_way(number, test, planned, every)
        elif test.test == "two-way ANOVA":
            found |= dict(_two_way(number, test, planned, every))
            found |= dict(_repeated(number, test, planned, drawn))
        elif test.test == "ICC":
            found |= _icc(number, test, planned, every, drawn)
        elif test.test == ORDER:
            found |= dict(_order(number, test, planned, drawn, first))
        elif test.test == GROUPS:
            found |= dict(_groups(number, test, planned, drawn, first))
        elif test.test in OVER_PEOPLE:
            found |= dict(OVER_PEOPLE[test.test](number, test, planned, drawn))
    return found


def fewest(question: Question, planned: Design, most: int) -> int:
    """Return the fewest participants, up to `most`, with whom P can be below alpha."""
    alpha = question.alpha or 1.0

    def can(people: int) -> bool:
        """Return whether it can: sign flips have a least P of 2 / 2^n, orders one in all, or two, a logit a least n."""
        if question.flips:
            return 2.0 ** (1 - people) < alpha
        if question.test in (ORDER, GROUPS):
            first = (people + 1) // 2
            return people - first > 1 and (1 + (people % 2 == 0)) / math.comb(people, first) < alpha
        return people >= (LEAST if question.test == LOGIT else 2)

    needed = next((n for n in range(2, most) if can(n)), most)
    places = [place for place, task in enumerate(planned.tasks) if task.id in question.tasks]
    every = ((size, planned.sizes(size)) for size in range(1, most))
    return next((size for size, sizes in every if any(sizes[place] >= needed for place in places)), most)


def starred(planned: Design, found: Mapping[Question, Answer]) -> dict[Question, int]:
    """Return in how many studies one test or more of a question's family, by its kind of P, has a mean above chance."""
    shown: dict[tuple[object, ...], NDArray[np.bool_]] = {}
    of: dict[Question, tuple[object, ...]] = {}
    for asked, one in found.items():
        if one.p is not None and one.above is not None and asked.alpha is not None:
            tasks = planned.tests[asked.plan].correction == EVERY or asked.tasks
            of[asked] = asked.plan, tasks, asked.adjusted, asked.flips
            own = (one.p < asked.alpha) & one.above
            shown[of[asked]] = shown.get(of[asked], np.zeros_like(own)) | own
    return {asked: int(np.count_nonzero(shown[family])) for asked, family in of.items()}


def _t(
    number: int, test: PlannedTest, planned: Design, every: Mapping[str, Ratios], drawn: Mapping[str, Integers]
) -> Iterator[tuple[Question, Answer]]:
    chance = test.exact_chance(len(planned.materials))
    trials = {task.id: task.repetitions for task in planned.tasks}
    places = {task: planned.places(task) for task in test.tasks}
    tested = {task: t_tests(every[task][places[task], places[task]], chance).p for task in test.tasks}
    if test.correction == EVERY:
        family = holm(np.concatenate(list(tested.values())))
        ends = np.cumsum([len(p) for p in tested.values()])[:-1]
        adjusted_p = dict(zip(tested, np.split(family, ends), strict=True))
    else:
        adjusted_p = {task: holm(p) for task, p in tested.items()}
    for task in test.tasks:
        own = places[task]
        above = every[task][own, own].means > float(chance)
        flips = sign_flip_tests(drawn[task][own, own], trials[task], chance)
        asked = ((tested[task], "", False), (adjusted_p[task], "", True), (flips, FLIPS, False))
        for p, how, adjusted in asked:
            for i, place in enumerate(own):
                subject = f"{planned.materials[place]}{how}"
                question = Question(number, test.test, (task,), subject, test.alpha, adjusted)
                yield question, Answer(p=p[i], above=above[i])


def _one_way(
    number: int, test: PlannedTest, planned: Design, every: Mapping[str, Ratios]
) -> Iterator[tuple[Question, Answer]]:
    for task in test.tasks:
        places = planned.places(task)
        answers = every[task][np.ix_(places, places)]
        if pair := test.materials or planned.pairs.get(task):
            first, second = (places.index(planned.materials.index(material)) for material in pair)
            groups = answers[[first, second, first, second], [first, second, second, first]]
            subject = f"{pair[0]} and {pair[1]}"
            yield Question(number, test.test, (task,), subject, test.alpha), Answer(p=one_way_tests(groups).p)
        one, other = most_confused(answers.means)
        studies = np.arange(len(one))
        groups = answers[np.stack([one, other, one, other]), np.stack([one, other, other, one]), studies]
        # As in `Confusion.most_confused`, there is no pair to test where nothing was confused, and of ties.
        p = np.where(one == other, np.nan, one_way_tests(groups).p)
        yield Question(number, test.test, (task,), MOST_CONFUSED, test.alpha), Answer(p=p)


def _two_way(
    number: int, test: PlannedTest, planned: Design, every: Mapping[str, Ratios]
) -> Iterator[tuple[Question, Answer]]:
    places = planned.places(*test.tasks)
    correct = [every[task][places, places] for task in test.tasks]
    layout, cells = tasks_by_materials(correct)
    for effect, name in (("A", "task"), ("B", "material"), ("X", "task x material")):
        for same in layout.same[effect]:
            subject = f"{name}, {'types' if same[1:] else 'type'} {', '.join(same)}"
            p = two_way_tests(layout, cells, effect, same[0]).p
            yield Question(number, test.test, test.tasks, subject, test.alpha), Answer(p=p)


def _repeated(
    number: int, test: PlannedTest, planned: Design, drawn: Mapping[str, Integers]
) -> Iterator[tuple[Question, Answer]]:
    """Yield ours beside the two-way ANOVA: the materials of each task by repeated measures."""
    for task in planned.tasks:
        if task.id in test.tasks:
            places = planned.places(task.id)
            ratios = np.moveaxis(drawn[task.id][places, places] / task.repetitions, 0, -1)
            studies, people = ratios.shape[:2]
            p = np.full(studies, np.nan) if people < 2 else repeated_tests(ratios @ helmert(len(places)).T)[2]
            yield Question(number, REPEATED, (task.id,), "material", test.alpha), Answer(p=p)


def _against_chance(
    number: int, test: PlannedTest, planned: Design, drawn: Mapping[str, Integers]
) -> Iterator[tuple[Question, Answer]]:
    chance = test.exact_chance(len(planned.materials))
    found: list[tuple[str, str, Floats, NDArray[np.bool_]]] = []
    for task in test.tasks:
        places = planned.chosen(test, task)
        right, trials = drawn[task][places, places], planned.trials(task)
        above = right.sum(axis=-1) > float(chance) * trials * right.shape[-1]
        names = [planned.materials[place] for place in places]
        found += [(task, *one) for one in zip(names, sign_flip_tests(right, trials, chance), above, strict=True)]
    yield from _in_families(number, test, [((task,), name, p, up) for task, name, p, up in found])


def _between_tasks(
    number: int, test: PlannedTest, planned: Design, drawn: Mapping[str, Integers]
) -> Iterator[tuple[Question, Answer]]:
    """Yield the pairs of tasks, over as many participants as did both."""
    pairs = ((pair, *_task_gaps(test, planned, drawn, pair)) for pair in combinations(test.tasks, 2))
    found = [(pair, " less ".join(pair), _flipped(gaps, most), None) for pair, gaps, most in pairs]
    yield from _in_families(number, test, found)


def _task_gaps(
    test: PlannedTest, planned: Design, drawn: Mapping[str, Integers], pair: tuple[str, str]
) -> tuple[Integers, int]:
    """Return the differences of two tasks, shape (studies, participants), as whole numbers, and the largest of all."""
    places = planned.chosen(test, *pair)
    people = min(drawn[task].shape[-1] for task in pair)
    common = math.lcm(*map(planned.trials, pair))
    one, other = (
        drawn[task][places, places, :, :people].sum(axis=0) * (common // planned.trials(task)) for task in pair
    )
    return one - other, len(places) * common


def _task_shares(test: PlannedTest, planned: Design, drawn: Mapping[str, Integers], pair: tuple[str, str]) -> Floats:
    """Return the shares of right answers of participants who did both tasks, shape (2, studies, participants)."""
    places = planned.chosen(test, *pair)
    people = min(drawn[task].shape[-1] for task in pair)
    return np.stack([drawn[task][places, places, :, :people].mean(axis=0) / planned.trials(task) for task in pair])


def _between_materials(
    number: int, test: PlannedTest, planned: Design, drawn: Mapping[str, Integers]
) -> Iterator[tuple[Question, Answer]]:
    found = []
    for task in test.tasks:
        for one, other in combinations(planned.chosen(test, task), 2):
            gaps = drawn[task][one, one] - drawn[task][other, other]
            name = f"{planned.materials[one]} minus {planned.materials[other]}"
            found.append(((task,), name, _flipped(gaps, planned.trials(task)), None))
    yield from _in_families(number, test, found)


def _flipped(gaps: Integers, most: int) -> Floats:
    """Return P of sign flips of gaps from -most to most: k of them are k + most of 2 most against a half."""
    return sign_flip_tests(gaps + most, 2 * most, Fraction(1, 2))


def _in_families(
    number: int, test: PlannedTest, found: Sequence[tuple[tuple[str, ...], str, Floats, NDArray[np.bool_] | None]]
) -> Iterator[tuple[Question, Answer]]:
    """Yield every P of a test, and, where the plan names a family, the same adjusted by Holm's method."""
    for tasks, name, p, above in found:
        yield Question(number, test.test, tasks, name, test.alpha), Answer(p=p, above=above)
    pairs = test.test == EQUIVALENCE and len(test.tasks) == 1
    families = [tasks if test.correction == "materials" else () for tasks, *_ in found]
    for family in dict.fromkeys(families) if test.correction or pairs else ():
        own = [one for one, other in zip(found, families, strict=True) if other == family]
        for (tasks, name, _, above), p in zip(own, holm(np.stack([p for _, _, p, _ in own])), strict=True):
            yield Question(number, test.test, tasks, name, test.alpha, adjusted=True), Answer(p=p, above=above)


def _repeated_measures(
    number: int, test: PlannedTest, planned: Design, drawn: Mapping[str, Integers]
) -> Iterator[tuple[Question, Answer]]:
    """Yield the effects of materials and of tasks, over as many participants as did them all."""
    places = planned.chosen(test, *test.tasks)
    people = min(drawn[task].shape[-1] for task in test.tasks)
    each = [drawn[task][places, places, :, :people] / planned.trials(task) for task in test.tasks]
    values = np.moveaxis(np.concatenate(each), 0, -1)
    tasks, materials = len(each), len(places)
    mean, apart = ([np.full((count, 1), 1 / math.sqrt(count)) for count in (tasks, materials)],
                   [helmert(count).T if count > 1 else np.ones((1, 0)) for count in (tasks, materials)])  # fmt: skip
    several = {"task": (apart[0], mean[1]), "material": (mean[0], apart[1]), "task x material": (apart[0], apart[1])}
    for name, (of_tasks, of_materials) in several.items() if tasks > 1 else [("material", several["material"])]:
        projected = values @ np.kron(of_tasks, of_materials)
        p = np.full(values.shape[0], np.nan) if people < 2 else repeated_tests(projected)[2]
        yield Question(number, test.test, test.tasks, name, test.alpha), Answer(p=p)


def equivalent(
    number: int, test: PlannedTest, planned: Design, drawn: Mapping[str, Integers]
) -> Iterator[tuple[Question, Answer]]:
    """Yield the pairs of tasks, but for those near 0 or 1, or of materials in one task, each within the margin."""
    found: list[tuple[tuple[str, ...], str, Floats, None]] = []
    margin = test.margin or MARGIN
    for pair in combinations(test.tasks, 2):
        shares = _task_shares(test, planned, drawn, pair)
        p = np.where(near_edges(shares), np.nan, _equal(shares[0] - shares[1], margin))
        found.append((pair, " and ".join(pair), p, None))
    for task in test.tasks if len(test.tasks) == 1 else ():
        ratios = drawn[task] / planned.trials(task)
        for a, b in combinations(planned.chosen(test, task), 2):
            apart = (ratios[a, a] - ratios[b, a] + ratios[b, b] - ratios[a, b]) / 2
            name = f"{planned.materials[a]} and {planned.materials[b]}"
            found.append(((task,), name, _equal(apart, margin), None))
    yield from _in_families(number, test, found)


def _equal(values: Floats, margin: float) -> Floats:
    return equivalence_tests(values, margin) if values.shape[-1] > 1 else np.full(values.shape[0], np.nan)


def _order(
    number: int, test: PlannedTest, planned: Design, drawn: Mapping[str, Integers], first: float
) -> Iterator[tuple[Question, Answer]]:
    """Yield what being first adds, of participants who begin with the tasks in turn."""
    begins = [task.id for task in planned.tasks]
    found = []
    for pair in combinations(test.tasks, 2):
        gaps, most = _task_gaps(test, planned, drawn, pair)
        one, other = (gaps[:, begins.index(task) :: len(begins)] / most for task in pair)
        found.append((pair, " and ".join(pair), order_tests(one + first, other - first), None))
    yield from _in_families(number, test, found)


def _groups(
    number: int, test: PlannedTest, planned: Design, drawn: Mapping[str, Integers], first: float
) -> Iterator[tuple[Question, Answer]]:
    """Yield the difference of two groups, of which participants are in turn."""
    found = []
    for task in test.tasks:
        places = planned.chosen(test, task)
        shares = drawn[task][places, places].mean(axis=0) / planned.trials(task)
        p = difference_tests(shares[:, ::2] + first, shares[:, 1::2])
        found.append(((task,), f"two groups by {test.groups}", p, None))
    yield from _in_families(number, test, found)


def _logit(
    number: int, test: PlannedTest, planned: Design, drawn: Mapping[str, Integers]
) -> Iterator[tuple[Question, Answer]]:
    """Yield the terms of the logit of as many studies as can be fitted; one without a fit has no P."""
    people = tuple(map(str, range(max(drawn[task].shape[-1] for task in test.tasks))))
    factors = {"task": test.tasks, "material": planned.chosen(test, *test.tasks)}
    found: dict[str, list[float]] = {name: [] for name, of in factors.items() if len(of) > 1}
    for study in range(min(FITTED, drawn[test.tasks[0]].shape[2])):
        own = {
            task: Confusion(planned.materials, people[: of.shape[-1]], np.moveaxis(of[:, :, study], 2, 0))
            for task, of in drawn.items()
            if task in test.tasks
        }
        try:
            terms = {one.name: one.p for one in slopes_logit(own).terms}
        except NotDefined:
            terms = {}
        for name, each in found.items():
            each.append(terms.get(name, math.nan))
    for name, each in found.items():
        yield Question(number, test.test, test.tasks, name, test.alpha), Answer(p=np.array(each))


OVER_PEOPLE: Mapping[
    str, Callable[[int, PlannedTest, Design, Mapping[str, Integers]], Iterator[tuple[Question, Answer]]]
] = {
    "sign flips against chance": _against_chance,
    "sign flips between tasks": _between_tasks,
    "sign flips between materials": _between_materials,
    "repeated measures": _repeated_measures,
    LOGIT: _logit,
    EQUIVALENCE: equivalent,
}
"""What answers planned tests over participants, by their names."""


def _icc(
    number: int, test: PlannedTest, planned: Design, every: Mapping[str, Ratios], drawn: Mapping[str, Integers]
) -> Iterator[tuple[Question, Answer]]:
    form = _form(test)
    if form == VARIANCE_COMPONENTS:
        if len(test.tasks) > 1:
            places = planned.places(*test.tasks)
            correct = [every[task][places, places] for task in test.tasks]
            value = variance_component_icc(*tasks_by_materials(correct), sum(cells.participants for cells in correct))
            subject = "variance components, mean over all participants"
            yield Question(number, test.test, test.tasks, subject, None), Answer(estimate=value)
    elif form is not None:
        for task in test.tasks:
            counts, places = drawn[task], planned.places(task)
            right = counts[places, places]
            cells = counts[places, : len(planned.materials)].reshape(-1, *counts.shape[2:])
            for matrix, targets in ((f"{len(cells)} cells", cells), (f"{len(right)} correct ratios", right)):
                value, tested = icc_tests(targets, form)
                question = Question(number, test.test, (task,), f"{form} of {matrix}", test.alpha)
                yield question, Answer(p=tested.p, estimate=value)


def _form(test: PlannedTest) -> str | None:
    """Return what a planned ICC asks for: a Shrout-Fleiss name, `VARIANCE_COMPONENTS`, or None for neither."""
    text = test.form or ""
    for name, (also, _) in NAMES.items():
        if name in text or also in text:
            return name
    return VARIANCE_COMPONENTS if VARIANCE_COMPONENTS in text else None
