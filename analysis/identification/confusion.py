"""Confusion matrix of one task, and d'.

A ratio is a count over all trials with the material (Okamoto, Tables 1 and 2). d' is that of m-AFC, p = integral of
phi(z - d') Phi(z)^(m - 1) (Green and Swets 1966; Hacker and Ratcliff 1979, Percept. Psychophys. 26, 168-170).
"""

import math
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from palpate.analysis.reading.study import Study
from palpate.analysis.statistics.exact import NotDefined
from palpate.experiment.errors import DatasetError


@dataclass(frozen=True)
class Confusion:
    """Counts of one task, shape (P, M, M + 1), by participant, presented and answered material, none being the last.

    `only` are the materials that the task presents, None where it presents all; rows of others are 0, and no result.
    """

    materials: tuple[str, ...]
    participants: tuple[str, ...]
    counts: NDArray[np.int64]
    only: tuple[str, ...] | None = None

    @cached_property
    def presented(self) -> tuple[int, ...]:
        """The places of the materials that the task presents."""
        return tuple(i for i, name in enumerate(self.materials) if self.only is None or name in self.only)

    @property
    def absent(self) -> tuple[str, ...]:
        """The materials that the task does not present."""
        return tuple(name for i, name in enumerate(self.materials) if i not in self.presented)

    @property
    def complete(self) -> list[str]:
        """The participants to whom every material of the task was presented."""
        places = list(self.presented)
        return [label for label, own in zip(self.participants, self.trials, strict=True) if own[places].all()]

    def rows(self, people: Iterable[str]) -> list[int]:
        """Return the rows of these participants."""
        places = {label: row for row, label in enumerate(self.participants)}
        return [places[label] for label in people]

    @cached_property
    def trials(self) -> NDArray[np.int64]:
        """Return the trials by participant and presented material, shape (P, M)."""
        return np.asarray(self.counts.sum(axis=2), dtype=np.int64)

    def cells(self) -> Iterator[tuple[str, str, str, int, int]]:
        """Return each participant, presented and answered material ("" for none), its count and the trials."""
        for p, participant in enumerate(self.participants):
            for i in self.presented:
                presented = self.materials[i]
                for j, answered in enumerate((*self.materials, "")):
                    yield participant, presented, answered, int(self.counts[p, i, j]), int(self.trials[p, i])

    @property
    def unanswered(self) -> int:
        """Return the number of trials in which no material was named."""
        return int(self.counts[:, :, -1].sum())

    def ratios(self, presented: int, answered: int) -> dict[str, Fraction]:
        """Return the exact ratio of one cell, by indices, for every participant to whom the material was presented."""
        known = {one: Fraction(*one) for one in set(self._pairs(presented, answered)) if one[1]}
        both = zip(self.participants, self._pairs(presented, answered), strict=True)
        return {label: known[one] for label, one in both if one in known}

    def _pairs(self, presented: int, answered: int) -> Iterator[tuple[int, int]]:
        """Yield each participant's count of one cell, and trials."""
        counts, trials = self.counts[:, presented, answered], self.trials[:, presented]
        return zip(counts.tolist(), trials.tolist(), strict=True)

    def _moments(self, presented: int, answered: int) -> tuple[int, Fraction, Fraction]:
        """Return how many participants have a ratio, their exact sum, and the exact sum of their squares."""
        often = [(Fraction(*one), n) for one, n in Counter(self._pairs(presented, answered)).items() if one[1]]
        total = sum((n * one for one, n in often), Fraction(0))
        return sum(n for _, n in often), total, sum((n * one * one for one, n in often), Fraction(0))

    def n(self, presented: int) -> int:
        """Return the number of participants to whom the material was presented."""
        return int(np.count_nonzero(self.trials[:, presented]))

    def mean(self, presented: int, answered: int) -> float | None:
        """Return the mean ratio among participants, or None without any."""
        n, total, _ = self._moments(presented, answered)
        return float(total / n) if n else None

    def sd(self, presented: int, answered: int) -> float | None:
        """Return the sample standard deviation (n - 1) among participants, or None below two."""
        n, total, squares = self._moments(presented, answered)
        return math.sqrt((squares - total * total / n) / (n - 1)) if n > 1 else None

    def means(self) -> NDArray[np.float64]:
        """Return the mean ratios, shape (M, M + 1); NaN where a material was never presented."""
        cells = [[self.mean(i, j) for j in range(len(self.materials) + 1)] for i in range(len(self.materials))]
        return np.array(cells, dtype=np.float64)

    def most_confused(self) -> tuple[tuple[str, str], ...]:
        """Return the pairs of the task most often taken for one another, exactly as often; none where none was."""
        pairs = {
            (a, b): sum((total / n for n, total, _ in map(self._moments, (a, b), (b, a)) if n), Fraction(0))
            for a, b in combinations(self.presented, 2)
        }
        most = max(pairs.values(), default=Fraction(0))
        return tuple((self.materials[a], self.materials[b]) for (a, b), both in pairs.items() if both == most > 0)


def shared(tasks: Iterable[Confusion]) -> tuple[int, ...]:
    """Return the places of the materials that each of these tasks presents."""
    return tuple(sorted(set.intersection(*({*task.presented} for task in tasks))))


def in_every(tasks: Sequence[Confusion]) -> list[str]:
    """Return the participants who did every one of these tasks with each of its materials."""
    others = [set(task.complete) for task in tasks[1:]]
    return [label for label in tasks[0].complete if all(label in complete for complete in others)]


def most_confused(means: NDArray[np.float64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the indices of the pair with the largest sum of both confusing ratios; both 0 where no pair alone has it.

    That is so where nothing was confused, and of ties, which are sums that differ by less than 1e-9 of them. `means`
    holds the mean ratios by presented and answered material, shape (M, M, studies).
    """
    first, second = np.triu_indices(len(means), k=1)
    both = means[first, second] + means[second, first]
    chosen, most = both.argmax(axis=0), both.max(axis=0)
    none = (most == 0) | (np.isclose(both, most, rtol=1e-9, atol=0.0).sum(axis=0) > 1)
    return np.where(none, 0, first[chosen]), np.where(none, 0, second[chosen])


def confusion(
    participants: Sequence[str],
    presented: Sequence[str],
    answered: Sequence[str],
    materials: Sequence[str],
    only: tuple[str, ...] | None = None,
) -> Confusion:
    """Return the counts of one task from its trials; an answer that is not among the materials counts as none."""
    if unknown := set(presented) - set(materials):
        raise ValueError(f"presented materials {sorted(unknown)} are not among {list(materials)}")
    labels = tuple(dict.fromkeys(participants))
    row, place = ({name: index for index, name in enumerate(names)} for names in (labels, materials))
    counts = np.zeros((len(labels), len(materials), len(materials) + 1), dtype=np.int64)
    for label, shown, said in zip(participants, presented, answered, strict=True):
        counts[row[label], place[shown], place.get(said, len(materials))] += 1
    return Confusion(tuple(materials), labels, counts, only)


def confusion_of(study: Study, task: str) -> Confusion:
    """Return the counts of the included trials of one task of a study. Raises `DatasetError` for comparisons."""
    if study.design != "identification":
        raise DatasetError(
            study.id, "got comparisons of pairs", "use another dataset", allowed="trials in which a material is named"
        )
    trials = study.trials(task)
    who, presented, answered = (trials[name].tolist() for name in ("participant", "presented", "answered"))
    only = next(one.presented for one in study.tasks if one.id == task)
    return confusion(who, presented, answered, study.materials, only)


STEP = 0.05
REACH = 12.0
"""The sum over phi runs to this many standard deviations in these steps, which is exact to rounding."""

LARGEST = 20.0
"""A larger |d'| cannot be told from infinity."""


def proportion_correct(d_prime: float, alternatives: int) -> float:
    """Return the share of correct answers of an observer with this d' among m alternatives."""
    from scipy.special import ndtr

    x = np.arange(-REACH, REACH + STEP / 2, STEP)
    density = np.exp(-x * x / 2) / np.sqrt(2 * np.pi)
    return float(STEP * (density * ndtr(x + d_prime) ** (alternatives - 1)).sum())


def d_prime(proportion: float, alternatives: int) -> float:
    """Return the d' of a share of correct answers among m alternatives; it is negative below chance, 1/m.

    Raises `NotDefined` for a share of 0 or 1, and `ValueError` outside of that or for m below two.
    """
    if alternatives < 2 or not 0 <= proportion <= 1:
        raise ValueError(f"got a proportion of {proportion} among {alternatives}; allowed: 0 to 1 among two or more")
    low, high = -LARGEST, LARGEST
    if not proportion_correct(low, alternatives) < proportion < proportion_correct(high, alternatives):
        raise NotDefined(f"d' is infinite when the proportion correct is {proportion:.3g}")
    while low < (middle := (low + high) / 2) < high:
        below = proportion_correct(middle, alternatives) < proportion
        low, high = (middle, high) if below else (low, middle)
    return middle


def corrected(count: int, trials: int) -> float:
    """Return the share of correct answers with 0 and 1 moved in by half a trial (Macmillan and Kaplan 1985)."""
    return min(max(count, 0.5), trials - 0.5) / trials
