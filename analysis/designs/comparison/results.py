"""Study -> every number of its comparisons: shares of right choices by pair, bias to the first, and scales.

The right choice comes later among the study's materials, ordered from least to most; where they stand in no order, none
is right, and the same share is of the later one. No answer counts in no share.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from itertools import combinations_with_replacement
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc

from palpate.analysis.designs.comparison.crossover import Crossed, crossed
from palpate.analysis.designs.comparison.delays import Delayed, delayed
from palpate.analysis.designs.comparison.estimates import Estimate, estimate
from palpate.analysis.designs.comparison.factors import Factored, Numbers, factored
from palpate.analysis.published.numbers import Published
from palpate.analysis.reading.study import Study, Task
from palpate.analysis.statistics.exact import NotDefined
from palpate.analysis.statistics.inference import ConfidenceInterval, clopper_pearson
from palpate.analysis.statistics.scaling import FIRST, SECOND, TIE, Comparisons, Law, NeverCompared, Scale, fit
from palpate.experiment.errors import DatasetError
from palpate.experiment.protocol.designs import comparison as asked
from palpate.experiment.protocol.designs.comparison import Comparison
from palpate.experiment.records.events import NO_ANSWER

if TYPE_CHECKING:
    import pandas as pd

LAWS = {
    "bradley-terry": ("Bradley-Terry", "in logits"),
    "thurstone": ("Thurstone's case V", "in standard deviations of a difference"),
    "davidson": ("Davidson", "with ties, in logits"),
}
"""The name of each law, and more about it. A protocol writes the same name with capitals, as `str.title` gives it."""

AUTHORS = {"bradley-terry": "Bradley-Terry", "thurstone": "Thurstone", "davidson": "Davidson"}
"""Whose law each one is, in a sentence."""

UNNAMED = "what was compared"
"""The quality where no protocol names one."""

CHOSEN = {asked.FIRST: FIRST, asked.SECOND: SECOND, asked.TIE: TIE}


@dataclass(frozen=True)
class Share:
    """So many of the trials, with the exact interval of their share, as if independent; None without a trial."""

    count: int
    trials: int
    interval: ConfidenceInterval | None

    @property
    def value(self) -> float | None:
        """The share, or None without a trial."""
        return self.count / self.trials if self.trials else None


@dataclass(frozen=True)
class Pair:
    """Answers to a pair of places, the lower first: choices of the higher (of two same, the first), and ties."""

    low: int
    high: int
    right: Share
    ties: int

    @property
    def same(self) -> bool:
        """Whether a material was compared with itself."""
        return self.low == self.high


@dataclass(frozen=True)
class Person:
    """One participant: right choices in pairs of two materials, and first ones in pairs of the same."""

    participant: str
    right: Share
    first_of_same: Share


@dataclass(frozen=True)
class Scaled:
    """A scale of one law, or why there is none: values, `steps` to the next, `order`, and P of the deviance.

    A bias-reduced scale has no P. `part` are the places of items that were compared with no others.
    """

    law: Law
    scale: Scale | None
    statement: str
    values: tuple[Estimate, ...] = ()
    steps: tuple[Estimate, ...] = ()
    order: Estimate | None = None
    p: float | None = None
    part: tuple[int, ...] = ()


@dataclass(frozen=True)
class Beside:
    """A printed percentage of right choices beside the share here, both in percent."""

    low: int
    high: int
    printed: str
    percent: float
    here: float | None


@dataclass(frozen=True)
class InPrint:
    """The printed table of a task, cell by cell, Pearson's `r`, and `r_of_two` over the cells of two materials."""

    where: str
    cells: tuple[Beside, ...]
    r: float | None
    r_of_two: float | None


@dataclass(frozen=True)
class TaskComparisons:
    """What one task gives; `first_of_same` are all choices of the first where both materials were the same."""

    task: Task
    participants: tuple[str, ...]
    trials: int
    unanswered: int
    pairs: tuple[Pair, ...]
    first_of_same: Share
    people: tuple[Person, ...]
    scales: tuple[Scaled, ...]
    factors: Factored | None
    delays: Delayed | None
    crossover: Crossed | None
    in_print: InPrint | None

    def pair(self, one: int, other: int) -> Pair:
        """Return a pair by places of its materials, in either order."""
        places = min(one, other), max(one, other)
        return next(pair for pair in self.pairs if (pair.low, pair.high) == places)


@dataclass(frozen=True)
class Compared:
    """The results of a study of comparisons; `quality` is what was compared, by which materials may be `ordered`."""

    materials: tuple[str, ...]
    quality: str
    tasks: tuple[TaskComparisons, ...]
    ordered: bool = True

    def __repr__(self) -> str:
        return f"<Compared {self.quality}: {'; '.join(_summary(one, self.ordered) for one in self.tasks)}>"

    def to_frame(self) -> pd.DataFrame:
        """Return a row for each task and pair, the lower material first, with the exact 95 % interval of the share.

        `right` are choices of the higher material, which comes later among the study's, in an order or none; of two
        that are the same, of the first.
        """
        import pandas as pd

        rows = [
            {"task": task.task.id, "lower": self.materials[pair.low], "higher": self.materials[pair.high],
             "right": pair.right.count, "trials": pair.right.trials, "ties": pair.ties, "share": pair.right.value,
             "low": pair.right.interval.low if pair.right.interval else None,
             "high": pair.right.interval.high if pair.right.interval else None}
            for task in self.tasks
            for pair in task.pairs
        ]  # fmt: skip
        return pd.DataFrame(rows).astype(dict.fromkeys(("share", "low", "high"), "float64"))


def more(results: Compared) -> str:
    """Return `more hardness`, or what to say where no protocol names what was compared."""
    return f"more of {UNNAMED}" if results.quality == UNNAMED else f"more {results.quality}"


def first_scale(task: TaskComparisons) -> Scaled | None:
    """Return the first scale of a task that could be fitted."""
    return next((one for one in task.scales if one.scale is not None), None)


def choices_words(results: Compared) -> str:
    """Return what shares of choices are called: right ones only where materials are ordered."""
    return "Right choices" if results.ordered else "Choices"


def percent(share: Share) -> str:
    """Return a share in whole percent, or `-` without a trial."""
    return "-" if share.value is None else f"{100 * share.value:.0f}"


def _summary(task: TaskComparisons, ordered: bool) -> str:
    if not ordered:
        return f"{task.task.id}, {task.trials} trials of {len(task.participants)}"
    different = [pair.right for pair in task.pairs if not pair.same]
    right, trials = sum(one.count for one in different), sum(one.trials for one in different)
    return f"{task.task.id}, {right} of {trials} right by {len(task.participants)}"


def compute(study: Study, printed: Published | None = None) -> Compared:
    """Return every result of a study of comparisons, beside what was `printed` of it.

    Raises `DatasetError` for answers that no comparison has.
    """
    if strange := {answer for one in study.designs.values() for answer in one.answers} - set(CHOSEN):
        got = f"got the answers {', '.join(sorted(strange))}"
        raise DatasetError(f"study {study.id}", got, "rebuild the dataset", allowed=", ".join(CHOSEN))
    protocols = [part.protocol.find(Comparison) for part in study.parts if part.protocol]
    quality = next((one.quality for one in protocols if one is not None), UNNAMED)
    tasks = tuple(_task(study, task, printed) for task in study.tasks if len(study.trials(task.id)))
    return Compared(study.materials, quality, tasks, is_ordered(study))


def is_ordered(study: Study) -> bool:
    """Return whether materials stand in an order of what was compared, as where no protocol says otherwise."""
    protocols = [part.protocol.find(Comparison) for part in study.parts if part.protocol]
    return all(one.ordered for one in protocols if one is not None)


def _task(study: Study, task: Task, printed: Published | None) -> TaskComparisons:
    trials = study.trials(task.id)
    answered = trials[trials["answered"] != NO_ANSWER]
    place = {material: index for index, material in enumerate(study.materials)}
    present = set(trials["participant"])
    people = tuple(who for who in study.participants if who in present)
    data = Comparisons(
        first=_codes(answered["first"], place),
        second=_codes(answered["second"], place),
        chosen=_codes(answered["answered"], CHOSEN),
        person=_codes(answered["participant"], {who: index for index, who in enumerate(people)}),
        items=len(study.materials),
    )
    same = data.first == data.second
    right = _right(data)
    first = data.chosen == FIRST
    pairs = tuple(_pair(data, right, *pair) for pair in combinations_with_replacement(range(data.items), 2))
    numbers = _numbers(study, task)
    is_planned = any(one.test == "factors" and task.id in one.tasks for one in study.plans())
    laws: tuple[Law, ...] = ("bradley-terry", "thurstone")
    if asked.TIE in study.designs[task.id].answers:
        laws = ("davidson",)
    return TaskComparisons(
        task=task,
        participants=people,
        trials=len(trials),
        unanswered=len(trials) - len(answered),
        pairs=pairs,
        first_of_same=share(first[same]),
        people=tuple(
            Person(who, share(right[~same & (data.person == n)]), share(first[same & (data.person == n)]))
            for n, who in enumerate(people)
        ),
        scales=tuple(scaled(data, law) for law in laws),
        factors=factored(data, study.materials, study.factors or numbers, 1 if is_planned and study.factors else 2),
        delays=delayed(data, study.materials, numbers),
        crossover=crossed(data, study.materials, numbers),
        in_print=_in_print(pairs, task.id, printed, study.materials),
    )


def _numbers(study: Study, task: Task) -> Numbers:
    """Return the numbers of each material's stimulus, the same in every protocol of a study; nothing of others."""
    protocols = [part.protocol for part in study.parts if part.protocol is not None and task.id in part.tasks]
    stated = [one.kind_table(one.task(task.id)).numbers for one in protocols]
    return stated[0] if stated and all(one == stated[0] for one in stated) else {}


def _codes(column: Iterable[str], code: Mapping[str, int]) -> NDArray[np.int64]:
    return np.array([code[one] for one in column], dtype=np.int64)


def _right(data: Comparisons) -> NDArray[np.bool_]:
    """Return whether each choice named the higher material, or, of the same, the one presented first."""
    wanted = np.where(data.first >= data.second, FIRST, SECOND)
    return np.asarray(data.chosen == wanted)


def _pair(data: Comparisons, right: NDArray[np.bool_], low: int, high: int) -> Pair:
    here = (np.minimum(data.first, data.second) == low) & (np.maximum(data.first, data.second) == high)
    return Pair(low, high, share(right[here]), int((data.chosen[here] == TIE).sum()))


def share(of: NDArray[np.bool_]) -> Share:
    """Return how many of these, shape (trials,), are true."""
    count, trials = int(of.sum()), len(of)
    return Share(count, trials, clopper_pearson(count, trials) if trials else None)


def scaled(data: Comparisons, law: Law) -> Scaled:
    """Return a scale of one law with its intervals, or why there is none."""
    if not len(data.first):
        return Scaled(law, None, "no trial has an answer")
    try:
        scale = fit(data, law)
    except NeverCompared as error:
        return Scaled(law, None, str(error), part=error.part)
    except NotDefined as error:
        return Scaled(law, None, str(error))
    people = len(np.unique(data.person))
    errors = np.sqrt(np.diag(scale.covariance))
    steps = (scale.difference(above, above - 1) for above in range(1, data.items))
    return Scaled(
        law=law,
        scale=scale,
        statement="",
        values=tuple(estimate(*pair, people) for pair in zip(scale.values.tolist(), errors.tolist(), strict=False)),  # noqa: PD011
        steps=tuple(estimate(*step, people) for step in steps),
        order=estimate(scale.order, float(errors[data.items]), people),
        p=float(chdtrc(scale.df, scale.deviance)) if scale.df > 0 and not scale.reduced else None,
    )


def _in_print(
    pairs: tuple[Pair, ...], task: str, printed: Published | None, materials: tuple[str, ...]
) -> InPrint | None:
    """Return the printed percentages of a task; a printed pair names materials, or their places among the study's."""
    found = next((block for block in printed.choices if block.task == task), None) if printed else None
    if found is None:
        return None
    place: Mapping[str, int] = {
        **{str(number): index for index, number in enumerate(range(1, len(materials) + 1))},
        **{material: index for index, material in enumerate(materials)},
    }
    here = {(pair.low, pair.high): pair.right.value for pair in pairs}
    cells = []
    for cell in found.cells:
        if not {*cell.pair} <= set(place):
            return None
        low, high = sorted(place[name] for name in cell.pair)
        value = here[low, high]
        cells.append(
            Beside(
                low, high, cell.correct.text, 100 * float(cell.correct.value), None if value is None else 100 * value
            )
        )
    return InPrint(found.where, tuple(cells), _r(cells), _r([cell for cell in cells if cell.low != cell.high]))


def _r(cells: list[Beside]) -> float | None:
    known = [(cell.percent, cell.here) for cell in cells if cell.here is not None]
    printed, here = np.array(known, dtype=np.float64).reshape(-1, 2).T
    if len(known) < 3 or not printed.std() or not here.std():
        return None
    return float(np.corrcoef(printed, here)[0, 1])
