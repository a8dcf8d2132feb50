"""Analysis of variance of answer ratios: one-way, and two-way with unequal numbers in types I, II and III.

Sums of squares are exact until F is formed: integers over one common denominator. Types after SAS: I adjusts an
effect for those before it, II for every effect that does not contain it, III for every other effect with sum-to-zero
contrasts.

Variance components of two crossed random factors with unequal numbers, and the reliability formed from them.

Henderson's method III: reductions in the sum of squares are set equal to their expectations under a model in
which both factors and their interaction are random. Okamoto (section 5.2) prints an intraclass correlation of 0.97
"based on the results of this two-way ANOVA" without a formula; this is one reading of those words, not the only one.
"""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from itertools import accumulate, pairwise, product
from operator import mul
from typing import Literal

from analysis.statistics.exact import NotDefined, Number, integers, reductions, squares
from analysis.statistics.t_tests import EffectSize, partial_eta_squared

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

    def eta_squared(self, effect: Effect) -> EffectSize | None:
        """Partial eta squared of one of the effects; None where its F is not defined."""
        return None if effect.f is None else partial_eta_squared(effect.f, effect.df, self.residual.df)


@dataclass(frozen=True)
class Cells:
    """Values sorted into the cells of two crossed factors: (level of first, level of second) -> values.

    The values are integers; what they stand for is each of them divided by `denominator`.
    """

    names: tuple[str, str]
    first: tuple[Hashable, ...]
    second: tuple[Hashable, ...]
    values: dict[tuple[Hashable, Hashable], list[int]]
    denominator: int

    @cached_property
    def keys(self) -> list[tuple[Hashable, Hashable]]:
        """Every cell, first factor slowest."""
        return list(product(self.first, self.second))

    @cached_property
    def weights(self) -> list[int]:
        """Number of values in each cell."""
        return [len(self.values[key]) for key in self.keys]

    @cached_property
    def within(self) -> Fraction:
        """Sum of squares within cells: what the model of every cell's mean leaves."""
        total = sum(sum(map(mul, values, values)) for values in self.values.values())
        return Fraction(total, self.denominator**2) - self.reduction("ABX")

    def reduction(self, effects: str) -> Fraction:
        """R(model) of the values: an intercept and the effects "A", "B" and "X" (interaction), in this order."""
        return self._reductions[effects]

    def reduction_of(self, effects: str, response: Sequence[int]) -> Fraction:
        """R(model) with another response, one integer a cell, in the place of the values."""
        return self._sequential(effects, list(map(mul, self.weights, response)))[effects]

    @cached_property
    def _reductions(self) -> dict[str, Fraction]:
        """R of every model that a table of type I, II or III, or a component of variance, is made from."""
        sums = [sum(self.values[key]) for key in self.keys]
        found: dict[str, Fraction] = {}
        for order in ("ABX", "BX", "AX"):
            found |= self._sequential(order, sums)
        return {effects: reduction / self.denominator**2 for effects, reduction in found.items()}

    def _sequential(self, order: str, sums: Sequence[int]) -> dict[str, Fraction]:
        """R of the models that `order` begins with, by effects, of these sums over the values of each cell."""
        columns, across, gram = self._design
        models = [order[:end] for end in range(len(order) + 1)]
        chosen = [index for effect in ("", *order) for index in columns[effect]]
        normal = [[gram[i][j] for j in chosen] for i in chosen]
        right = [sum(map(mul, across[i], sums)) for i in chosen]
        sizes = list(accumulate(len(columns[effect]) for effect in ("", *order)))
        return dict(zip(models, reductions(normal, right, sizes), strict=True))

    @cached_property
    def _design(self) -> tuple[dict[str, range], list[tuple[int, ...]], list[list[int]]]:
        """Sum-to-zero design: the columns of each effect, every column over the cells, and the normal equations."""
        a, b = len(self.first) - 1, len(self.second) - 1
        columns = {
            "": range(1),
            "A": range(1, 1 + a),
            "B": range(1 + a, 1 + a + b),
            "X": range(1 + a + b, (1 + a) * (1 + b)),
        }
        rows = []
        for first, second in self.keys:
            main_a, main_b = _contrasts(self.first, first), _contrasts(self.second, second)
            rows.append([1, *main_a, *main_b, *(p * q for p in main_a for q in main_b)])
        across = list(zip(*rows, strict=True))
        weighted = [list(map(mul, self.weights, column)) for column in across]
        return columns, across, [[sum(map(mul, row, column)) for column in across] for row in weighted]


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
    sorted_values: dict[tuple[Hashable, Hashable], list[int]] = {key: [] for key in product(*levels)}
    whole, denominator = integers(values)
    for value, a, b in zip(whole, first, second, strict=True):
        sorted_values[a, b].append(value)
    for (a, b), held in sorted_values.items():
        if not held:
            raise NotDefined(f"two-way ANOVA needs a value in every cell, got none for {a}, {b}")
    if len(values) == len(sorted_values):
        raise NotDefined("two-way ANOVA needs two participants in a cell, got one in each: nothing is left for error")
    return Cells(names, levels[0], levels[1], sorted_values, denominator)


def one_way(groups: Sequence[Sequence[Number]], name: str = "group") -> Anova:
    """One-way ANOVA of independent groups, each of shape (n_i,).

    Raises:
        NotDefined: with fewer than two groups, an empty group, or one value in each.
    """
    sizes = [len(group) for group in groups]
    if len(sizes) < 2 or not all(sizes):
        raise NotDefined(f"one-way ANOVA needs two groups with values, got sizes {sizes}")
    total = sum(sizes)
    if total == len(sizes):
        raise NotDefined("one-way ANOVA needs two values in a group, got one in each: nothing is left for error")
    whole, denominator = integers([value for group in groups for value in group])
    ends = list(accumulate(sizes, initial=0))
    parts = (Fraction(squares(whole[start:end]), end - start) for start, end in pairwise(ends))
    within = sum(parts, Fraction(0)) / denominator**2
    between = Fraction(squares(whole), total * denominator**2) - within
    return _table("one-way", [(name, between, len(sizes) - 1)], within, total - len(sizes))


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
        bare = tuple(Effect(name, float(ss), degrees) for name, ss, degrees in lines)
        return Anova(kind, bare, residual, "no variance within the groups: F and P are not defined")
    effects = []
    for name, ss, degrees in lines:
        f = (ss.numerator * within.denominator * df) / (ss.denominator * within.numerator * degrees)
        effects.append(Effect(name, float(ss), degrees, f, float(fdtrc(degrees, df, f))))
    return Anova(kind, tuple(effects), residual)


@dataclass(frozen=True)
class VarianceComponents:
    """Estimates as they come out, negative ones included; squared units of the values."""

    names: tuple[str, str, str]
    first: float
    second: float
    interaction: float
    residual: float

    @property
    def negative(self) -> tuple[str, ...]:
        """Names of the components estimated below zero, which `icc_of_mean` takes as zero."""
        components = (self.first, self.second, self.interaction)
        return tuple(name for name, value in zip(self.names, components, strict=True) if value < 0)


def variance_components(data: Cells) -> VarianceComponents:
    """Components of both factors, their interaction and the residual, by Henderson's method III."""
    first, second = data.names
    df = sum(data.weights) - len(data.keys)
    residual = data.within / df
    interaction_ss = data.reduction("ABX") - data.reduction("AB")
    first_ss = data.reduction("AB") - data.reduction("B")
    second_ss = data.reduction("AB") - data.reduction("A")
    df_first, df_second = len(data.first) - 1, len(data.second) - 1

    interaction = (interaction_ss - df_first * df_second * residual) / _coefficient(data, "ABX", "AB", "X")
    component = []
    for of_effect, without, effect, degrees in ((first_ss, "B", "A", df_first), (second_ss, "A", "B", df_second)):
        rest = of_effect - degrees * residual - _coefficient(data, "AB", without, "X") * interaction
        component.append(rest / _coefficient(data, "AB", without, effect))
    return VarianceComponents(
        (first, second, f"{first} x {second}"),
        float(component[0]),
        float(component[1]),
        float(interaction),
        float(residual),
    )


def icc_of_mean(components: VarianceComponents, k: int) -> float | None:
    """Variance-component ICC of the mean of `k` participants.

    ICC = S / (S + residual / k), where S is the sum of the components of both factors and their interaction,
    each taken as zero where it is negative. None when there is no variance at all.
    """
    signal = sum(max(value, 0.0) for value in (components.first, components.second, components.interaction))
    noise = components.residual / k
    return signal / (signal + noise) if signal + noise > 0 else None


def _coefficient(data: Cells, model: str, without: str, effect: str) -> Fraction:
    """How often the component of `effect` enters the expectation of R(model) - R(without).

    It is the sum, over the levels of `effect`, of that difference for the level's indicator as the response.
    """

    def level_of(key: tuple[Hashable, Hashable]) -> Hashable:
        return {"A": key[0], "B": key[1], "X": key}[effect]

    total = Fraction(0)
    for level in dict.fromkeys(map(level_of, data.keys)):
        indicator = [int(level_of(key) == level) for key in data.keys]
        total += data.reduction_of(model, indicator) - data.reduction_of(without, indicator)
    return total
