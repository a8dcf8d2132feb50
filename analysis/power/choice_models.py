"""How participants answer: the probabilities of simulated studies, and the drawing.

A model holds, for each task and presented material, the mean share of each answer and the spread of participants around
it. Counts are Dirichlet-multinomial; the intraclass correlation follows in closed form from printed standard
deviations. Given the shares, answers to different materials, or in two tasks, are independent, unless `alike` is set.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import Field

from palpate.analysis.documents.tables import Column, Record, plural, tabulate
from palpate.analysis.identification.companion_tests import MARGIN
from palpate.analysis.identification.confusion import confusion
from palpate.analysis.identification.planned import EQUIVALENCE
from palpate.analysis.power.planned_tests import ABOUT, APART, Design, Model, Shown, equivalent, starred
from palpate.analysis.power.planned_tests import Answers as Every
from palpate.analysis.power.planned_tests import answer as answered
from palpate.analysis.published.numbers import Published
from palpate.analysis.reading import dataset
from palpate.analysis.statistics.exact import Floats, Integers
from palpate.experiment.errors import PowerError
from palpate.experiment.protocol.models import PlannedTest, Protocol
from palpate.experiment.settings import load
from palpate.experiment.settings.load import Broken, Confined, Label, Name, Rules, Text

MOST_SPREAD = 0.999
"""The largest intraclass correlation that is fitted; beyond it every participant always gives the same answer."""

PRINTED = "tables"
"""What print has of answers."""

NUMBERS = "0.8,0.15: the proportion correct, and how much participants differ"
"""What two numbers say."""


@dataclass(frozen=True)
class Answers:
    """Answers in one task: mean shares, shape (M, M + 1), the last of "no material named", 0 where not presented.

    `spread` is the intraclass correlation of a participant's answers to each material, shape (M,): 0 when all
    participants are alike.
    """

    task: str
    shares: Floats
    spread: Floats


TOGETHER = 0.25
"""Of a participant's spread in the control, the part each of one level, one by task and one by material: ours."""


@dataclass(frozen=True)
class ChoiceModel(Model):
    """Answers that name a material, in every task; `null` is that of a control.

    `alike` is the share of the normal behind a participant's spread that is common to all tasks and materials.
    """

    tasks: tuple[Answers, ...]
    null: bool = False
    alike: float = 0.0

    has_stars = True
    undefined = "no variance"
    control_name = "guessing"

    def control(self, protocol: Protocol) -> "ChoiceModel":
        """Return participants whose answers are correct at chance on average, and who differ as much."""
        count = len(protocol.materials)
        tasks = []
        for task, own in zip(protocol.tasks, self.tasks, strict=True):
            planned = (test.chance for test in protocol.analysis if task.id in test.tasks and test.chance is not None)
            chance = next(planned, 1 / count)
            tasks.append(_evenly(own, chance))
        return ChoiceModel("guessing on average, with the same spread across participants", tuple(tasks), null=True)

    def together(self, alike: float) -> "ChoiceModel":
        if not 0 <= alike <= 1:
            raise PowerError("--alike", f"got {alike}", "give one", allowed="a number from 0 to 1")
        return replace(self, alike=alike)

    def answers(self, planned: Design, participants: int, studies: int, random: np.random.Generator) -> Every:
        """Return the answers to each question, and how many studies have a mean above chance in its family.

        In a control, equivalence is asked of tasks, or materials, that differ by the margin.
        """
        every = answered(planned, self.drawn(planned, participants, studies, random), 0.0 if self.null else APART)
        for number, test in enumerate(planned.tests if self.null else ()):
            if test.test == EQUIVALENCE:
                differing = self._differing(planned, test).drawn(planned, participants, studies, random)
                every |= dict(equivalent(number, test, planned, differing))
        return every, starred(planned, every)

    def drawn(
        self, planned: Design, participants: int, studies: int, random: np.random.Generator
    ) -> dict[str, Integers]:
        """Return the counts of each task; those of a control are of participants who differ by task and by material."""
        each = list(zip(planned.tasks, self.tasks, planned.sizes(participants), strict=True))
        if not self.null and not self.alike:
            return {
                task.id: draw(answers, trials=task.repetitions, participants=size, studies=studies, random=random)
                for task, answers, size in each
            }
        shape = studies, max(size for *_, size in each)
        by_level, by_other = (TOGETHER, TOGETHER) if self.null else (self.alike, 0.0)
        level, found = math.sqrt(by_level) * random.standard_normal(shape), {}
        by_material = math.sqrt(by_other) * random.standard_normal((len(planned.materials), *shape))
        own = math.sqrt(1 - by_level - 2 * by_other)
        for task, answers, size in each:
            common = level + math.sqrt(by_other) * random.standard_normal(shape) + by_material
            found[task.id] = draw_together(answers, common[:, :, :size], own, task.repetitions, random)
        return found

    def _differing(self, planned: Design, test: PlannedTest) -> "ChoiceModel":
        """Return participants to whom the tasks of a test, or the materials of its one task, differ by its margin."""
        count, margin = len(planned.materials), test.margin or MARGIN
        several = len(test.tasks) > 1
        tasks = []
        for own in self.tasks:
            place = test.tasks.index(own.task) if own.task in test.tasks else 0
            right = (
                0.5 + (place - (len(test.tasks) - 1) / 2) * margin if several else (1 + (count - 1) * margin) / count
            )
            tasks.append(_evenly(own, min(max(right, 0.0), 1.0)))
        return replace(self, tasks=tuple(tasks))

    def shown(self, planned: Design, said: tuple[str, ...]) -> Shown:
        """Return the mean share of each answer, with the spread."""
        common = ABOUT["together"].substitute(alike=f"{self.alike:g}") if self.alike else ABOUT["apart"].substitute()
        answers = (*planned.materials, "none")
        records: list[Record] = []
        for task in self.tasks:
            for place in planned.places(task.task):
                named = dict(zip(answers, task.shares[place].tolist(), strict=True))
                spread = float(task.spread[place])
                records.append({"task": task.task, "presented": planned.materials[place], **named, "spread": spread})
        note = (
            "Mean proportion of each answer; spread is the intraclass correlation of a participant's answers to one "
            "material."
        )
        columns = Column("task", left=True), Column("presented", left=True), *map(Column, (*answers, "spread"))
        return (*said[:2], common, *said[2:]), (tabulate("Choice model", columns, records, [note]),)


def _evenly(own: Answers, right: float) -> Answers:
    """Return the same task with this share of right answers, and wrong ones that are as frequent."""
    count = len(own.shares)
    shares = np.full((count, count + 1), (1 - right) / (count - 1))
    shares[:, -1] = 0.0
    np.fill_diagonal(shares, right)
    return Answers(own.task, shares * own.shares.any(axis=1, keepdims=True), own.spread)


def from_print(printed: Published, protocol: Protocol) -> ChoiceModel:
    """Return the model with the means and standard deviations of a paper's tables.

    A row that misses 1 by its rounding is scaled to 1; a larger gap is the share without an answer; a larger surplus is
    scaled and noted. Raises `PowerError` if the tables lack a task or a material.
    """
    ids = [material.id for material in protocol.materials]
    cells = {cell.key: cell for table in printed.table for cell in printed.cells_of(table)}
    tasks: list[Answers] = []
    notes: list[str] = []
    for task in protocol.tasks:
        did = printed.task_named(task.id)
        if did is None or did.trials is None:
            raise PowerError(
                f"the tables of {printed.study}: got no number of participants and trials for task {task.id}; allowed: "
                "a study that prints both; choose another --model"
            )
        rows: dict[str, tuple[Floats, float]] = {}
        for shown in protocol.materials_of(task):
            try:
                row = [cells[task.id, shown, said] for said in ids]
            except KeyError as missing:
                lacking = " answered ".join(missing.args[0][1:])
                raise _lacking(f"the tables of {printed.study}", task.id, lacking) from None
            where = f"{task.id}, {shown}"
            means = np.array([cell.mean.value for cell in row])
            gap = 1 - float(means.sum())
            rounding = sum(cell.mean.unit for cell in row) / 2
            if gap < -rounding:
                notes.append(
                    f"{where}: the printed ratios add up to {1 - gap:.3f}, which rounding cannot explain; one of "
                    "them is a misprint, and all are scaled to add up to 1"
                )
            if gap > rounding:
                notes.append(f"{where}: the printed ratios leave {gap:.3g}, which counts as no material named")
                shares = np.array([*means, gap])
            else:
                shares = np.array([*means / means.sum(), 0.0])
            variance = sum((cell.sd.value if cell.sd else 0.0) ** 2 for cell in row)
            rows[shown] = shares, _spread(shares[:-1], variance, 1 / did.trials, did.participants, where, notes)
        tasks.append(_answers(task.id, rows, ids))
    where = " and ".join(dict.fromkeys(table.where for table in printed.table))
    source = f"means and standard deviations from {where} in {printed.source}"
    return ChoiceModel(source, tuple(tasks), tuple(notes))


def fitted(folder: Path, protocol: Protocol) -> ChoiceModel:
    """Return the model with the mean shares of a dataset's answers, and the spread of its participants.

    Raises `PowerError` for a lacking task or material, or a single participant, and `DatasetError` or `ProtocolError`
    as `read`.
    """
    study = dataset.read(folder)
    ids = [material.id for material in protocol.materials]
    if missing := set(ids) - set(study.materials):
        raise _lacking(str(folder), "every task", ", ".join(sorted(missing)))
    tasks: list[Answers] = []
    notes: list[str] = []
    for task in protocol.tasks:
        trials = study.trials(task.id)
        trials = trials[trials["presented"].isin(ids)]
        columns = [trials[key].tolist() for key in ("participant", "presented", "answered")]
        answers = confusion(columns[0], columns[1], columns[2], ids)
        rows: dict[str, tuple[Floats, float]] = {}
        for shown in protocol.materials_of(task):
            people = answers.n(i := ids.index(shown))
            if people < 2:
                raise PowerError(
                    f"{folder}: task {task.id}, {shown}: got {plural(people, 'participant')}; allowed: at least "
                    "2, to fit their spread; state the model in a TOML file instead"
                )
            present = answers.trials[:, i] > 0
            done = answers.trials[present, i]
            ratios = answers.counts[present, i] / done[:, None]
            shares = ratios.mean(axis=0)
            variance = float(ratios[:, :-1].var(axis=0, ddof=1).sum())
            spread = _spread(shares[:-1], variance, float(np.mean(1 / done)), people, f"{task.id}, {shown}", notes)
            rows[shown] = shares / shares.sum(), spread
        tasks.append(_answers(task.id, rows, ids))
    label = f" ({study.label})" if study.label else ""
    return ChoiceModel(f"fitted to the answers in {folder.name}{label}", tuple(tasks), tuple(notes), study.label)


def stated(file: Path, protocol: Protocol) -> ChoiceModel:
    """Return the model of a TOML file, with one table `[[rows]]` for each task and presented material.

    Raises `PowerError` for rows that lack, repeat or do not belong to the protocol, and `ProtocolError` otherwise.
    """
    model = load.read(file, Stated)
    ids = [material.id for material in protocol.materials]
    wanted = [(task.id, shown) for task in protocol.tasks for shown in protocol.materials_of(task)]
    found = [(row.task, row.presented) for row in model.rows]
    if strange := [row for row in found if row not in wanted or found.count(row) > 1]:
        named, presented = strange[0]
        twice = strange[0] in wanted
        raise PowerError(
            file,
            f"got a row for task {named}, {presented}",
            "delete all but one of these [[rows]]" if twice else "correct its task or presented, or delete it",
            allowed=f"each task of {protocol.study.id} with each material that it presents, once",
        )
    if missing := [row for row in wanted if row not in found]:
        raise _lacking(str(file), *missing[0])
    if wrong := [row for row in model.rows if len(row.answers) != len(ids)]:
        raise PowerError(
            f"{file}: task {wrong[0].task}, {wrong[0].presented}",
            f"got {len(wrong[0].answers)} answers",
            "give a proportion for each answer, with 0 for an answer that is never given",
            allowed=f"{len(ids)}, in the order of the protocol: {', '.join(ids)}",
        )
    rows = {(row.task, row.presented): row for row in model.rows}
    tasks = []
    for task in protocol.tasks:
        own: dict[str, tuple[Floats, float]] = {}
        for shown in protocol.materials_of(task):
            row = rows[task.id, shown]
            left = 1 - sum(row.answers)
            shares = np.array([*row.answers, left if left >= ROUNDING else 0.0])
            own[shown] = shares / shares.sum(), row.spread
        tasks.append(_answers(task.id, own, ids))
    return ChoiceModel(f"stated in {file.name}: {model.source}", tuple(tasks))


def observer(right: float, spread: float, protocol: Protocol) -> ChoiceModel:
    """Return participants who are right in this share of trials of every material, and err evenly.

    Raises `PowerError` for a share that is not between 0 and 1, or a spread that is not from 0 to `MOST_SPREAD`.
    """
    if not (0 < right < 1 and 0 <= spread <= MOST_SPREAD):
        allowed = f"a proportion correct above 0 and below 1, and a spread from 0 to {MOST_SPREAD}"
        raise PowerError("--model", f"got {right:g},{spread:g}", "give two numbers", allowed=allowed)
    ids = [material.id for material in protocol.materials]
    tasks = []
    for task in protocol.tasks:
        shown = [[1.0 * (name in protocol.materials_of(task))] * (len(ids) + 1) for name in ids]
        tasks.append(_evenly(Answers(task.id, np.array(shown), np.full(len(ids), spread)), right))
    said = f"participants whose proportion correct is {right:g}, with an intraclass correlation of {spread:g}"
    seeks = any("between" in test.test or "ANOVA" in test.test for test in protocol.analysis)
    return ChoiceModel(said, tuple(tasks), (ABOUT["no difference"].substitute(),) if seeks else ())


def _answers(task: str, rows: Mapping[str, tuple[Floats, float]], ids: Sequence[str]) -> Answers:
    """Return the answers of a task from shares and spread of each material that it presents."""
    each = [rows.get(material, (np.zeros(len(ids) + 1), 0.0)) for material in ids]
    return Answers(task, np.array([shares for shares, _ in each]), np.array([spread for _, spread in each]))


ROUNDING = 1e-9
"""Shares add up to 1 where their sum differs from it by no more than this."""


def _shares_add_up(table: Mapping[str, Any]) -> Iterator[Broken]:
    answers = table.get("answers")
    numbers = answers if isinstance(answers, tuple) else ()
    if all(isinstance(share, int | float) for share in numbers) and sum(numbers) > 1 + ROUNDING:
        yield Broken(("answers",), "proportions that add up to at most 1; the rest counts as no material named")


class StatedRow(Confined):
    """Answers to one material in one task, as mean shares in the protocol's order, and their intraclass correlation."""

    RULES: ClassVar[Rules] = _shares_add_up

    task: Label
    presented: Name
    answers: Annotated[tuple[Annotated[float, Field(ge=0, le=1)], ...], Field(min_length=2)]
    spread: Annotated[float, Field(ge=0, le=MOST_SPREAD)]


class Stated(Confined):
    """A choice model as a file states it."""

    format: Literal[1]
    source: Text
    rows: Annotated[tuple[StatedRow, ...], Field(min_length=1)]


def _spread(shares: Floats, variance: float, shortness: float, people: int, where: str, notes: list[str]) -> float:
    """Return the intraclass correlation by moments, and note where it is moved to a value that can be drawn from.

    The variance of a ratio of m trials is p (1 - p) (rho + (1 - rho) / m), and both sides are added up over the
    answers. `variance` is the sum of the variances (n - 1) of `shares`, `shortness` the mean of 1 / m, `people` n.
    """
    largest = float((shares * (1 - shares)).sum()) + variance / people
    if largest == 0 or shortness == 1:
        return 0.0
    fit = (variance / largest - shortness) / (1 - shortness)
    if fit < 0:
        notes.append(f"{where}: participants differ less than expected by chance; their spread is set to 0")
    elif fit > MOST_SPREAD:
        notes.append(f"{where}: each participant gives only one answer; their spread is set to {MOST_SPREAD}")
    return min(max(fit, 0.0), MOST_SPREAD)


def _lacking(what: str, task: str, materials: str) -> PowerError:
    return PowerError(
        f"{what}: got no proportions for task {task}, {materials}; allowed: every task and material of the protocol; "
        "add it, or choose another --model"
    )


GUIDE = 1024
"""Cells of the unit interval; a power of 2, so that a number is put into its cell without rounding."""

MOST_GUIDED = 40
"""The most trials for which a guide is kept, of less than 350 kB; the counts of more trials are searched for."""


def draw(answers: Answers, *, trials: int, participants: int, studies: int, random: np.random.Generator) -> Integers:
    """Return counts of every answer, Dirichlet-multinomial, shape (M, M + 1, studies, participants).

    Each answer is beta-binomial given those before it, found from a uniform number in the table of its distribution.
    """
    materials = len(answers.shares)
    counts = np.zeros((materials, materials + 1, studies, participants), dtype=np.int64)
    for row, shares, spread in zip(counts, answers.shares.tolist(), answers.spread.tolist(), strict=True):
        left = np.full((studies, participants), trials, dtype=np.int64)
        for answer, share in enumerate(shares):
            rest = sum(shares[answer + 1 :])
            if share == 0:
                continue
            if rest == 0:
                row[answer] = left
                break
            inverse = _guided if trials <= MOST_GUIDED else Inverse
            row[answer] = inverse(trials, share, rest, spread).counts(left, random.random(left.shape))
            left -= row[answer]
    return counts


SCORES = np.linspace(-6.0, 6.0, 2001)
"""Normal scores between which the shares of participants are interpolated."""


def draw_together(answers: Answers, common: Floats, own: float, trials: int, random: np.random.Generator) -> Integers:
    """Return counts as `draw`, from the part of a normal score that tasks and materials have in `common`.

    `common` has shape (M, studies, participants); `own` is the SD of the rest of each score, whose variance is 1.
    """
    from scipy.special import betaincinv, ndtr

    materials, *shape = common.shape
    counts = np.zeros((materials, materials + 1, *shape), dtype=np.int64)
    for place in np.flatnonzero(answers.shares.any(axis=1)).tolist():
        shares, spread = answers.shares[place].tolist(), float(answers.spread[place])
        right, scores = shares[place], common[place] + own * random.standard_normal(shape)
        each: Floats = np.full(shape, right)
        if spread > 0 and 0 < right < 1:
            c = 1 / spread - 1
            each = np.interp(scores, SCORES, betaincinv(right * c, (1 - right) * c, ndtr(SCORES)))
        counts[place, place] = random.binomial(trials, each)
        left = trials - counts[place, place]
        others = [answer for answer, share in enumerate(shares) if share and answer != place]
        for answer, rest in zip(others, np.cumsum([shares[one] for one in others])[::-1], strict=True):
            last = answer == others[-1]
            inverse = _guided if trials <= MOST_GUIDED else Inverse
            own_counts = (
                left
                if last
                else inverse(trials, shares[answer], float(rest) - shares[answer], spread).counts(
                    left, random.random(left.shape)
                )
            )
            counts[place, answer] = own_counts
            left = left - own_counts
    return counts


class Inverse:
    """Finds the counts of uniform numbers by a search in the table of `distribution`."""

    def __init__(self, trials: int, share: float, rest: float, spread: float) -> None:
        self._row = trials + 1
        self._table = distribution(trials, share, rest, spread)

    def counts(self, left: Integers, uniform: Floats) -> Integers:
        """Return the counts of this answer in `left` remaining trials, of the same shape."""
        # Row r of the table begins at r (trials + 1) and its values lie from r to r + 1.
        places = np.searchsorted(self._table, left + uniform, side="right")
        return np.asarray(np.minimum(places - left * self._row, left), dtype=np.int64)


class Guided(Inverse):
    """The same counts, most of them without a search (Chen and Asau 1974, AIIE Transactions 6, 163-166)."""

    def __init__(self, trials: int, share: float, rest: float, spread: float) -> None:
        super().__init__(trials, share, rest, spread)
        left = np.arange(trials + 1)[:, None]
        ends = super().counts(left, np.arange(GUIDE + 1) / GUIDE)
        self._guide = np.where(ends[:, :-1] == ends[:, 1:], ends[:, :-1], -1).ravel()

    def counts(self, left: Integers, uniform: Floats) -> Integers:
        """Return the counts of this answer in `left` remaining trials, of the same shape."""
        cells = (uniform * GUIDE).astype(np.int64)
        cells += left * GUIDE
        found = self._guide.take(cells)
        searched = np.flatnonzero(found < 0)
        np.put(found, searched, super().counts(left.take(searched), uniform.take(searched)))
        return found


_guided = lru_cache(maxsize=256)(Guided)


def distribution(trials: int, share: float, rest: float, spread: float) -> Floats:
    """Return the cumulative distribution of the count of an answer in 0..`trials` remaining trials, row after row.

    Shape ((trials + 1)^2,): place r (trials + 1) + k holds r + P(count <= k | r remain). `rest` is the share of later
    answers.
    """
    from scipy.special import betaln, xlog1py, xlogy

    left, count = np.arange(trials + 1.0)[:, None], np.arange(trials + 1.0)[None, :]
    inside = count <= left
    missed = np.where(inside, left - count, 0.0)
    ways = -np.log(left + 1) - betaln(missed + 1, count + 1)
    if spread > 0:
        a, b = share * (1 / spread - 1), rest * (1 / spread - 1)
        log_p = ways + betaln(count + a, missed + b) - betaln(a, b)
    else:
        p = share / (share + rest)
        log_p = ways + xlogy(count, p) + xlog1py(missed, -p)
    below = np.cumsum(np.where(inside, np.exp(log_p), 0.0), axis=1)
    below[count >= left] = 1.0
    return np.asarray(np.ravel(left + np.minimum(below, 1.0)), dtype=np.float64)
