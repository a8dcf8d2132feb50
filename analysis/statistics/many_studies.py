"""The analysis's statistics for many studies at once: the same numbers as `significance`, `anova`, `icc` and
`variance_components` give for each of them, from integer sums, with studies along the last axis.

What a study's values do not define is NaN here, on purpose and counted by whoever calls: no comparison with a level
is ever true of it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from analysis.statistics.anova import TYPES, SumsOfSquares

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]


@dataclass(frozen=True)
class Tested:
    """A statistic of each study and its P, shape (..., studies); NaN where the values do not define it."""

    statistic: Floats
    p: Floats


@dataclass(frozen=True)
class Ratios:
    """Answer ratios of equally many participants, by the sums of their counts.

    Args:
        trials: of each participant, in each cell.
        participants: in each cell.
        sums: of the counts, shape (..., studies).
        squares: sums of the squared counts, the same shape.
    """

    trials: int
    participants: int
    sums: Integers
    squares: Integers

    def __getitem__(self, cells: Any) -> Ratios:
        """Some of the cells."""
        return Ratios(self.trials, self.participants, self.sums[cells], self.squares[cells])

    @property
    def means(self) -> Floats:
        """Mean ratio, shape (..., studies)."""
        return self.sums / (self.participants * self.trials)

    @property
    def scatter(self) -> Integers:
        """Sum of the counts' squared differences from their mean, times the participants; exact."""
        return self.participants * self.squares - self.sums * self.sums


def ratios(counts: Integers, trials: int) -> Ratios:
    """Sums of counts, shape (..., studies, participants)."""
    sums, squares = np.einsum("...i->...", counts), np.einsum("...i,...i->...", counts, counts)
    return Ratios(trials, counts.shape[-1], sums, squares)


def t_against_chance(cells: Ratios, chance: float) -> Tested:
    """One-sample, two-tailed t-test of each cell, as `significance.t_against_chance`."""
    from scipy.special import stdtr

    n = cells.participants
    if n < 2:
        return _undefined(cells.sums.shape)
    scatter = cells.scatter
    sd = np.sqrt(np.where(scatter > 0, scatter, np.nan) / (n * (n - 1))) / cells.trials
    t = (cells.means - chance) / sd * np.sqrt(n)
    return Tested(t, 2 * stdtr(n - 1, -np.abs(t)))


def holm(p: Floats) -> Floats:
    """P adjusted within families along the first axis, as `significance.holm`; NaN counts as 1 and stays NaN."""
    family = np.where(np.isnan(p), 1.0, p)
    order = np.argsort(family, axis=0, kind="stable")
    size = len(p)
    factors = np.arange(size, 0, -1).reshape(-1, *[1] * (p.ndim - 1))
    stepped = np.maximum.accumulate(np.minimum(1.0, np.take_along_axis(family, order, axis=0) * factors), axis=0)
    adjusted = np.empty_like(stepped)
    np.put_along_axis(adjusted, order, stepped, axis=0)
    return np.where(np.isnan(p), np.nan, adjusted)


def one_way(groups: Ratios) -> Tested:
    """One-way ANOVA of the groups along the first axis, as `anova.one_way`."""
    g, n = len(groups.sums), groups.participants
    if n < 2:
        return _undefined(groups.sums.shape[1:])
    between = g * (groups.sums**2).sum(axis=0) - groups.sums.sum(axis=0) ** 2
    within = groups.scatter.sum(axis=0)
    return _f_test(between / (g - 1), np.where(within > 0, within / (n - 1), np.nan), g - 1, g * (n - 1))


def most_confused(answers: Ratios) -> tuple[Integers, Integers]:
    """The pair of materials with the largest sum of both mean confusing ratios, as `Confusion.most_confused`.

    Args:
        answers: shape (M, M, studies), presented and answered.

    Returns:
        Index of the first and of the second material, shape (studies,); both 0 where nothing was ever confused.
    """
    count = len(answers.sums)
    first, second = np.triu_indices(count, k=1)
    means = answers.means
    both = means[first, second] + means[second, first]
    chosen = both.argmax(axis=0)
    none = both.max(axis=0) == 0
    return np.where(none, 0, first[chosen]), np.where(none, 0, second[chosen])


@dataclass(frozen=True)
class Crossed:
    """What a two-way design needs for every study: prepared once, of its numbers of participants alone.

    Args:
        weights: participants in each cell, task slowest, shape (tasks * M,).
        directions: (effect, type) -> orthonormal directions, shape (tasks * M, df), in which root-weighted cell means
            have the effect's sum of squares. Effects are "A" (task), "B" (material) and "X" (their interaction).
        tasks: how many.
        materials: how many.
    """

    weights: Floats
    directions: dict[tuple[str, SumsOfSquares], Floats]
    tasks: int
    materials: int

    @property
    def df(self) -> int:
        """Degrees of freedom within cells."""
        return round(float(self.weights.sum())) - len(self.weights)

    def same(self, effect: str) -> list[list[SumsOfSquares]]:
        """The types, grouped by whether they are one test of this effect in this design."""
        return self._same[effect]

    @cached_property
    def _same(self) -> dict[str, list[list[SumsOfSquares]]]:
        return {effect: self._grouped(effect) for effect in "ABX"}

    def _grouped(self, effect: str) -> list[list[SumsOfSquares]]:
        groups: list[list[SumsOfSquares]] = []
        for kind in TYPES:
            own = self.directions[effect, kind]
            for group in groups:
                other = self.directions[effect, group[0]]
                if np.allclose(own @ own.T, other @ other.T, atol=1e-12):
                    group.append(kind)
                    break
            else:
                groups.append([kind])
        return groups


@lru_cache(maxsize=128)
def crossed(participants: tuple[int, ...], materials: int) -> Crossed:
    """The design of tasks with so many participants each, every one of whom was presented every material.

    Raises:
        ValueError: fewer than two tasks or materials.
    """
    tasks = len(participants)
    if tasks < 2 or materials < 2:
        raise ValueError(f"got {tasks} tasks and {materials} materials; allowed: at least 2 of each")
    a, b = _sum_to_zero(tasks), _sum_to_zero(materials)
    one_a, one_b = np.ones((tasks, 1)), np.ones((materials, 1))
    columns = {"": np.kron(one_a, one_b), "A": np.kron(a, one_b), "B": np.kron(one_a, b), "X": np.kron(a, b)}
    weights = np.repeat(np.asarray(participants, dtype=np.float64), materials)
    given: dict[SumsOfSquares, tuple[str, str, str]] = {"I": ("", "A", "AB"), "II": ("B", "A", "AB")}
    given["III"] = ("BX", "AX", "AB")
    directions = {}
    for kind, others in given.items():
        for effect, other in zip("ABX", others, strict=True):
            parts = [columns[name] for name in ("", *other, effect)]
            orthonormal = np.linalg.qr(np.sqrt(weights)[:, None] * np.hstack(parts))[0]
            directions[effect, kind] = orthonormal[:, -parts[-1].shape[1] :]
    return Crossed(weights, directions, tasks, materials)


def squares(design: Crossed, means: Floats, effect: str, kind: SumsOfSquares) -> Floats:
    """Sum of squares of an effect in cell means, shape (tasks * M, studies)."""
    along = design.directions[effect, kind].T @ (np.sqrt(design.weights)[:, None] * means)
    return np.asarray(np.einsum("ds,ds->s", along, along), dtype=np.float64)


def mean_square_within(design: Crossed, correct: Sequence[Ratios]) -> Floats:
    """Residual mean square; NaN where nothing varies within any cell, or nothing is left for it."""
    within = sum(cells.scatter.sum(axis=0) / (cells.participants * cells.trials**2) for cells in correct)
    varied = np.any([cells.scatter.any(axis=0) for cells in correct], axis=0)
    return np.where(varied, within / max(design.df, 1), np.nan)


def two_way(design: Crossed, correct: Sequence[Ratios], effect: str, kind: SumsOfSquares) -> Tested:
    """Test of an effect of the two-way ANOVA, as `anova.two_way`.

    Args:
        design: see `crossed`.
        correct: ratios of correct answers of each task, shape (M, studies).
        effect: "A" (task), "B" (material) or "X".
        kind: type of sums of squares.
    """
    means = np.concatenate([cells.means for cells in correct])
    df = design.directions[effect, kind].shape[1]
    return _f_test(squares(design, means, effect, kind) / df, mean_square_within(design, correct), df, design.df)


def variance_component_icc(design: Crossed, correct: Sequence[Ratios], k: int) -> Floats:
    """ICC of the mean of `k` participants from Henderson's method III, as `variance_components.icc_of_mean`."""
    means = np.concatenate([cells.means for cells in correct])
    within = sum(cells.scatter.sum(axis=0) / (cells.participants * cells.trials**2) for cells in correct)
    if design.df == 0:
        return np.full(means.shape[-1], np.nan)
    residual = within / design.df
    of_task, of_material = np.repeat(np.arange(design.tasks), design.materials), np.arange(design.materials)
    levels = {
        "A": _indicators(of_task),
        "B": _indicators(np.tile(of_material, design.tasks)),
        "X": _indicators(np.arange(len(design.weights))),
    }

    def coefficient(effect: str, of: str) -> float:
        """How often the component `of` enters the expectation of the sum of squares of `effect`."""
        return float(squares(design, levels[of], effect, "II").sum())

    df_x = design.directions["X", "II"].shape[1]
    interaction = (squares(design, means, "X", "II") - df_x * residual) / coefficient("X", "X")
    signal = np.maximum(interaction, 0.0)
    for effect in "AB":
        df = design.directions[effect, "II"].shape[1]
        rest = squares(design, means, effect, "II") - df * residual - coefficient(effect, "X") * interaction
        signal = signal + np.maximum(rest / coefficient(effect, effect), 0.0)
    whole: Floats = signal + residual / k
    # Equal ratios have equal floating-point numbers; sums of squares formed from them need not be zero.
    varied = (residual > 0) | (np.ptp(means, axis=0) > 0)
    return _ratio(signal, whole, varied & (whole > 0))


def icc(counts: Integers, form: str) -> tuple[Floats, Tested]:
    """One form of the intraclass correlation of each study, and its test, as `icc.icc`.

    Args:
        counts: shape (targets, studies, raters); ratios to one number of trials have the same ICC.
        form: its name in Shrout and Fleiss.

    Returns:
        Its value, and F with P.
    """
    n, _, k = counts.shape
    if n < 2 or k < 2:
        nothing = _undefined(counts.shape[1:2])
        return nothing.statistic, nothing
    everything = counts.sum(axis=(0, 2))
    total = n * k * np.einsum("isk,isk->s", counts, counts) - everything**2
    targets = n * (counts.sum(axis=2) ** 2).sum(axis=0) - everything**2
    raters = k * (counts.sum(axis=0) ** 2).sum(axis=1) - everything**2
    ms_r, ms_c = targets / (n - 1), raters / (k - 1)
    ms_w, ms_e = (total - targets) / (n * (k - 1)), (total - targets - raters) / ((n - 1) * (k - 1))
    kind, unit = form.removeprefix("ICC(").removesuffix(")").split(",")
    ms, df = (ms_w, n * (k - 1)) if kind == "1" else (ms_e, (n - 1) * (k - 1))
    agreement = (ms_c - ms_e) / n if kind == "2" else np.zeros_like(ms_r)
    below = ms_r + agreement if unit == "k" else ms_r + (k - 1) * ms + k * agreement
    value = _ratio(ms_r - ms, below, below > 0)
    return value, _f_test(ms_r, np.where(ms > 0, ms, np.nan), n - 1, df)


def _f_test(effect: Floats, residual: Floats, df1: int, df2: int) -> Tested:
    from scipy.special import fdtrc

    f = effect / residual
    return Tested(f, fdtrc(df1, max(df2, 1), f))


def _undefined(shape: tuple[int, ...]) -> Tested:
    return Tested(np.full(shape, np.nan), np.full(shape, np.nan))


def _sum_to_zero(levels: int) -> Floats:
    return np.vstack([np.eye(levels - 1), -np.ones(levels - 1)])


def _indicators(levels: Integers) -> Floats:
    """A column for each level, 1 where it is."""
    return np.asarray(levels[:, None] == np.unique(levels), dtype=np.float64)


def _ratio(above: Floats, below: Floats, defined: NDArray[np.bool_]) -> Floats:
    return np.asarray(np.divide(above, below, out=np.full(above.shape, np.nan), where=defined), dtype=np.float64)
