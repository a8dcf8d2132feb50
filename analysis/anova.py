"""Analysis of variance of answer ratios: one-way, and two-way with unequal numbers in types I, II and III.

Sums of squares are rational numbers until F is formed. Types after SAS: I adjusts an effect for those before
it, II for every effect that does not contain it, III for every other effect with sum-to-zero contrasts.
"""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import dataclass
from fractions import Fraction
from itertools import product
from typing import Literal

from analysis.exact import NotDefined, Number, fractions, mean, reduction, sum_of_squares

SumsOfSquares = Literal["I", "II", "III"]
TYPES: tuple[SumsOfSquares, ...] = ("I", "II", "III")


@dataclass(frozen=True)
class Effect:
    """One line of the table; `f` and `p` are None for the residual, and where F is not defined."""

    name: str
    ss: float
    df: int
    f: float | None = None
    p: float | None = None

    @property
    def ms(self) -> float:
        """Mean square."""
        return self.ss / self.df


@dataclass(frozen=True)
class Anova:
    """A table of variance; `statement` says why F is missing, where it is."""

    kind: str
    effects: tuple[Effect, ...]
    residual: Effect
    statement: str = ""

    def effect(self, name: str) -> Effect:
        """The effect with this name; `KeyError` when there is none."""
        for effect in self.effects:
            if effect.name == name:
                return effect
        raise KeyError(name)


@dataclass(frozen=True)
class Cells:
    """Values sorted into the cells of two crossed factors: (level of first, level of second) -> values."""

    names: tuple[str, str]
    first: tuple[Hashable, ...]
    second: tuple[Hashable, ...]
    values: dict[tuple[Hashable, Hashable], list[Fraction]]

    @property
    def keys(self) -> list[tuple[Hashable, Hashable]]:
        """Every cell, first factor slowest."""
        return list(product(self.first, self.second))

    @property
    def weights(self) -> list[int]:
        """Number of values in each cell."""
        return [len(self.values[key]) for key in self.keys]

    @property
    def within(self) -> Fraction:
        """Sum of squares within cells."""
        return sum((sum_of_squares(values) for values in self.values.values()), Fraction(0))

    def columns(self, effects: str) -> list[list[int]]:
        """Design matrix: an intercept and the sum-to-zero columns of the effects "A", "B" and "X" (interaction)."""
        rows = []
        for a, b in self.keys:
            main_a = _contrasts(self.first, a)
            main_b = _contrasts(self.second, b)
            parts = {"A": main_a, "B": main_b, "X": [p * q for p in main_a for q in main_b]}
            rows.append([1, *(value for effect in effects for value in parts[effect])])
        return rows

    def reduction(self, effects: str, means: Sequence[Fraction] | None = None) -> Fraction:
        """R(model) of the cell means, or of `means` in their place."""
        response = [mean(self.values[key]) for key in self.keys] if means is None else means
        return reduction(self.columns(effects), self.weights, response)


def cells(
    values: Sequence[Number], first: Sequence[Hashable], second: Sequence[Hashable], names: tuple[str, str]
) -> Cells:
    """Sort values, shape (n,), by the levels of two factors, each of shape (n,).

    Raises:
        NotDefined: when a factor has fewer than two levels, a cell is empty, or no cell holds two values.
    """
    levels = tuple(dict.fromkeys(first)), tuple(dict.fromkeys(second))
    for name, found in zip(names, levels, strict=True):
        if len(found) < 2:
            raise NotDefined(f"two-way ANOVA needs two levels of {name}, got {len(found)}")
    sorted_values: dict[tuple[Hashable, Hashable], list[Fraction]] = {key: [] for key in product(*levels)}
    for value, a, b in zip(fractions(values), first, second, strict=True):
        sorted_values[a, b].append(value)
    for (a, b), held in sorted_values.items():
        if not held:
            raise NotDefined(f"two-way ANOVA needs a value in every cell, got none for {a}, {b}")
    if len(values) == len(sorted_values):
        raise NotDefined("two-way ANOVA needs two participants in a cell, got one in each: nothing is left for error")
    return Cells(names, levels[0], levels[1], sorted_values)


def one_way(groups: Sequence[Sequence[Number]], name: str = "group") -> Anova:
    """One-way ANOVA of independent groups, each of shape (n_i,).

    Raises:
        NotDefined: with fewer than two groups, an empty group, or one value in each.
    """
    exact = [fractions(group) for group in groups]
    if len(exact) < 2 or not all(exact):
        raise NotDefined(f"one-way ANOVA needs two groups with values, got sizes {[len(group) for group in exact]}")
    total = sum(len(group) for group in exact)
    if total == len(exact):
        raise NotDefined("one-way ANOVA needs two values in a group, got one in each: nothing is left for error")
    centre = mean([value for group in exact for value in group])
    between = sum((len(group) * (mean(group) - centre) ** 2 for group in exact), Fraction(0))
    within = sum((sum_of_squares(group) for group in exact), Fraction(0))
    return _table("one-way", [(name, between, len(exact) - 1)], within, total - len(exact))


def two_way(data: Cells, kind: SumsOfSquares) -> Anova:
    """Two-way ANOVA with interaction.

    Args:
        data: see `cells`.
        kind: "I" (the first factor enters first), "II" or "III".
    """
    a, b = data.names
    full, main = data.reduction("ABX"), data.reduction("AB")
    if kind == "I":
        squares_a = data.reduction("A") - data.reduction("")
        squares_b = main - data.reduction("A")
    elif kind == "II":
        squares_a = main - data.reduction("B")
        squares_b = main - data.reduction("A")
    else:
        squares_a = full - data.reduction("BX")
        squares_b = full - data.reduction("AX")
    df_a, df_b = len(data.first) - 1, len(data.second) - 1
    lines = [(a, squares_a, df_a), (b, squares_b, df_b), (f"{a} x {b}", full - main, df_a * df_b)]
    return _table(f"two-way, type {kind}", lines, data.within, sum(data.weights) - len(data.keys))


def _contrasts(levels: Sequence[Hashable], level: Hashable) -> list[int]:
    last = level == levels[-1]
    return [-1 if last else int(level == other) for other in levels[:-1]]


def _table(kind: str, lines: Sequence[tuple[str, Fraction, int]], within: Fraction, df: int) -> Anova:
    from scipy.special import fdtrc

    residual = Effect("residual", float(within), df)
    if within == 0:
        bare = tuple(Effect(name, float(squares), degrees) for name, squares, degrees in lines)
        return Anova(kind, bare, residual, "no variance within the groups: F and P are not defined")
    effects = []
    for name, squares, degrees in lines:
        f = float(squares / degrees / (within / df))
        effects.append(Effect(name, float(squares), degrees, f, float(fdtrc(degrees, df, f))))
    return Anova(kind, tuple(effects), residual)
