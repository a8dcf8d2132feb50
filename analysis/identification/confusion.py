"""Confusion matrix of one task: who answered what to which material, as ratios per participant.

A ratio is the count of an answer over the trials in which the material was presented, trials without an answer
included (Okamoto, Tables 1 and 2). Means and standard deviations (n - 1) are taken among participants.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from analysis.statistics.exact import mean, sum_of_squares


@dataclass(frozen=True)
class Confusion:
    """Counts of one task, and what follows from them.

    Args:
        materials: presented materials, and answers; length M.
        participants: labels, length P.
        counts: shape (P, M, M + 1): participant, presented, answered; the last answer is "no material named".
    """

    materials: tuple[str, ...]
    participants: tuple[str, ...]
    counts: NDArray[np.int64]

    @cached_property
    def trials(self) -> NDArray[np.int64]:
        """Trials by participant and presented material, shape (P, M)."""
        return np.asarray(self.counts.sum(axis=2), dtype=np.int64)

    @property
    def unanswered(self) -> int:
        """Trials in which no material was named."""
        return int(self.counts[:, :, -1].sum())

    def ratios(self, presented: int, answered: int) -> dict[str, Fraction]:
        """Exact ratio of one cell for every participant to whom the material was presented.

        Args:
            presented: index of the material, 0..M-1.
            answered: index of the answer, 0..M, where M is "no material named".
        """
        trials = self.trials
        return {
            label: Fraction(int(self.counts[index, presented, answered]), int(trials[index, presented]))
            for index, label in enumerate(self.participants)
            if trials[index, presented]
        }

    def n(self, presented: int) -> int:
        """Participants to whom the material was presented."""
        return int(np.count_nonzero(self.trials[:, presented]))

    def mean(self, presented: int, answered: int) -> float | None:
        """Mean ratio among participants; None when there is none."""
        values = list(self.ratios(presented, answered).values())
        return float(mean(values)) if values else None

    def sd(self, presented: int, answered: int) -> float | None:
        """Sample standard deviation (n - 1) among participants; None below two."""
        values = list(self.ratios(presented, answered).values())
        return math.sqrt(sum_of_squares(values) / (len(values) - 1)) if len(values) > 1 else None

    def means(self) -> NDArray[np.float64]:
        """Mean ratios, shape (M, M + 1); NaN where a material was never presented."""
        cells = [[self.mean(i, j) for j in range(len(self.materials) + 1)] for i in range(len(self.materials))]
        return np.array(cells, dtype=np.float64)

    def most_confused(self) -> tuple[str, str] | None:
        """The two materials most often taken for one another: largest sum of both mean confusing ratios.

        None where no material was ever taken for another.
        """
        first, second = (int(index[0]) for index in most_confused(np.nan_to_num(self.means()[:, :-1, None])))
        return None if first == second else (self.materials[first], self.materials[second])


def most_confused(means: NDArray[np.float64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the indices of the pair with the largest sum of both confusing ratios; both 0 where nothing was confused.

    Args:
        means: mean ratios, presented and answered, shape (M, M, studies).
    """
    first, second = np.triu_indices(len(means), k=1)
    both = means[first, second] + means[second, first]
    chosen = both.argmax(axis=0)
    none = both.max(axis=0) == 0
    return np.where(none, 0, first[chosen]), np.where(none, 0, second[chosen])


def confusion(
    participants: Sequence[str], presented: Sequence[str], answered: Sequence[str], materials: Sequence[str]
) -> Confusion:
    """Count the answers of one task.

    Args:
        participants: label per trial, shape (trials,).
        presented: material per trial, shape (trials,).
        answered: material named per trial, or any other text where none was, shape (trials,).
        materials: the order of rows and columns.

    Raises:
        ValueError: for a presented material that is not in `materials`.
    """
    if unknown := set(presented) - set(materials):
        raise ValueError(f"presented materials {sorted(unknown)} are not among {list(materials)}")
    labels = tuple(dict.fromkeys(participants))
    place = {material: index for index, material in enumerate(materials)}
    row = {label: index for index, label in enumerate(labels)}
    counts = np.zeros((len(labels), len(materials), len(materials) + 1), dtype=np.int64)
    for label, shown, said in zip(participants, presented, answered, strict=True):
        counts[row[label], place[shown], place.get(said, len(materials))] += 1
    return Confusion(tuple(materials), labels, counts)
