"""Analysis of variance of answer ratios, one-way, and two-way with unequal numbers in SAS's types I, II and III.

Contrasts are integers, so that one study's sums are exact until F. Variance components are by Henderson's method III;
`icc_of_mean` is one reading of the ICC of 0.97 that Okamoto (section 5.2) prints without a formula.
"""

import math
from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property, lru_cache
from itertools import product
from typing import Any, Literal

import numpy as np
from scipy.special import fdtri

from palpate.analysis.statistics import exact
from palpate.analysis.statistics.inference import CONFIDENCE, EffectSize, partial_eta_squared

SumsOfSquares = Literal["I", "II", "III"]
TYPES: tuple[SumsOfSquares, ...] = ("I", "II", "III")

BEFORE: dict[SumsOfSquares, tuple[str, str, str]] = {
    "I": ("", "A", "AB"),
    "II": ("B", "A", "AB"),
    "III": ("BX", "AX", "AB"),
}
"""The effects that "A", "B" and "X", the interaction, are adjusted for in each type."""


@dataclass(frozen=True)
class Effect:
    """One line of the table; `f` and `p` are None for the residual and where F is not defined."""

    name: str
    ss: float
    df: int
    f: float | None = None
    p: float | None = None

    @property
    def ms(self) -> float:
        """The mean square."""
        return self.ss / self.df


@dataclass(frozen=True)
class Anova:
    """A table of variance; `statement` says why F is missing where it is."""

    kind: str
    effects: tuple[Effect, ...]
    residual: Effect
    statement: str = ""

    def effect(self, name: str) -> Effect:
        """Return the effect with this name; `KeyError` when there is none."""
        return {effect.name: effect for effect in self.effects}[name]

    def eta_squared(self, effect: Effect) -> EffectSize | None:
        """Return partial eta squared of one of the effects; None where its F is not defined."""
        return None if effect.f is None else partial_eta_squared(effect.f, effect.df, self.residual.df)


def one_way(groups: Sequence[Sequence[exact.Number]], name: str = "group") -> Anova:
    """Return the one-way ANOVA of independent groups, each of shape (n_i,); NotDefined where F cannot be formed."""
    sizes = [len(group) for group in groups]
    if len(sizes) < 2 or not all(sizes):
        raise exact.NotDefined(f"one-way ANOVA needs two groups with values, got sizes {sizes}")
    if sum(sizes) == len(sizes):
        raise exact.NotDefined(
            "one-way ANOVA needs two values in some group, got one in each: the error has no degrees of freedom"
        )
    cells = exact.of_groups(groups)
    return _table("one-way", [(name, ss_between(cells), len(sizes) - 1)], cells.ss_within, sum(sizes) - len(sizes))


def one_way_tests(groups: exact.Ratios) -> exact.Tested:
    """Return F and P of many studies' groups of equally many participants, which lie along the first axis."""
    count = len(groups.sums)
    return exact.f_test(ss_between(groups), groups.ss_within, count - 1, count * (groups.participants - 1))


def ss_between(groups: exact.Ratios) -> exact.Values:
    """Return the sum of squares between groups, which lie along the first axis; their denominator is one."""
    sizes = np.broadcast_to(groups.participants, (len(groups.sums), 1)).ravel().tolist()
    common, everybody = math.lcm(*sizes), sum(sizes)
    shared = math.gcd(common, everybody)
    shape = (len(sizes), *[1] * (groups.sums.ndim - 1))
    parts = np.array([common // size for size in sizes], dtype=groups.sums.dtype).reshape(shape)
    squares, total = (parts * groups.sums**2).sum(axis=0), groups.sums.sum(axis=0)
    spread = everybody // shared * squares - common // shared * total**2
    return exact.quotient(spread, common * everybody // shared * groups.denominator**2)


@dataclass(frozen=True)
class Crossed:
    """A two-way design from the participants in each cell, the first factor slowest, and the levels of each factor."""

    weights: tuple[int, ...]
    levels: tuple[int, int]

    @property
    def df(self) -> int:
        """Degrees of freedom within cells."""
        return sum(self.weights) - len(self.weights)

    def df_of(self, effect: str) -> int:
        """Return the degrees of freedom of an effect: "A", "B" or "X"."""
        a, b = (count - 1 for count in self.levels)
        return {"A": a, "B": b, "X": a * b}[effect]

    def squares(self, effect: str, kind: SumsOfSquares, sums: exact.Values, denominator: Any = 1) -> exact.Values:
        """Return the sum of squares of "A", "B" or "X", shape (studies,), from the cells' sums, shape (cells, studies).

        The values have one `denominator`, or one for each cell, shape (cells, 1).
        """
        key = effect, BEFORE[kind]["ABX".index(effect)]
        if sums.dtype == object:
            contrasts, sizes = self._contrasts[key]
            common = math.lcm(*sizes[:, 0].tolist())
            return exact.quotient((common // sizes * (contrasts @ sums) ** 2).sum(axis=0), common * denominator**2)
        along = self._directions[key] @ (sums / denominator)
        return np.asarray(np.einsum("ds,ds->s", along, along))

    @cached_property
    def same(self) -> dict[str, list[list[SumsOfSquares]]]:
        """Effect -> the types, grouped by whether they are one test of it in this design."""
        found = {}
        for place, effect in enumerate("ABX"):
            groups: dict[tuple[Fraction, ...], list[SumsOfSquares]] = {}
            for kind in TYPES:
                contrasts, sizes = self._contrasts[effect, BEFORE[kind][place]]
                form = exact.quotient(contrasts[:, :, None] * contrasts[:, None], sizes[:, :, None]).sum(axis=0)
                groups.setdefault(tuple(form.ravel().tolist()), []).append(kind)
            found[effect] = list(groups.values())
        return found

    @cached_property
    def _directions(self) -> dict[tuple[str, str], exact.Floats]:
        return {
            key: exact.floats(contrasts) / np.sqrt(exact.floats(sizes))
            for key, (contrasts, sizes) in self._contrasts.items()
        }

    @cached_property
    def coefficients(self) -> dict[str, Fraction]:
        """Effect and component -> how often the component enters the expectation of the sum of squares of type II."""
        first, second = np.divmod(np.arange(len(self.weights)), self.levels[1])
        of = {"A": first, "B": second, "X": np.arange(len(self.weights))}
        weights = np.array(self.weights, dtype=object)[:, None]
        found = {}
        for pair in ("AA", "AX", "BB", "BX", "XX"):
            indicators = weights * np.equal.outer(of[pair[1]], np.unique(of[pair[1]])).astype(int).astype(object)
            found[pair] = sum(self.squares(pair[0], "II", indicators).tolist(), Fraction(0))
        return found

    @cached_property
    def _contrasts(self) -> dict[tuple[str, str], tuple[exact.Values, exact.Values]]:
        """Effect and those before it -> its contrasts, shape (df, cells), and their squared sizes, shape (df, 1)."""
        a, b = (np.vstack([np.eye(n - 1, dtype=int), -np.ones(n - 1, dtype=int)]).astype(object) for n in self.levels)
        ones = [np.ones((n, 1), dtype=int).astype(object) for n in self.levels]
        columns = {"": np.kron(*ones), "A": np.kron(a, ones[1]), "B": np.kron(ones[0], b), "X": np.kron(a, b)}
        wanted = {(effect, before) for orders in BEFORE.values() for effect, before in zip("ABX", orders, strict=True)}
        return {(effect, before): self._orthogonal(columns, ("", *before, effect)) for effect, before in sorted(wanted)}

    def _orthogonal(
        self, columns: dict[str, exact.Values], order: tuple[str, ...]
    ) -> tuple[exact.Values, exact.Values]:
        """Return Gram and Schmidt's orthogonal form of the last of these blocks, in integers."""
        weights = np.array(self.weights, dtype=object)
        found: list[tuple[exact.Values, exact.Values, int]] = []
        for column in np.hstack([columns[name] for name in order]).T:
            for other, weighted, size in found:
                column = column * size - other * (weighted @ column)
            column = column // math.gcd(*column.tolist())
            found.append((column, weights * column, (weights * column) @ column))
        last = found[-columns[order[-1]].shape[1] :]
        return np.array([u for u, _, _ in last], dtype=object), np.array([[size] for _, _, size in last], dtype=object)


@lru_cache(maxsize=128)
def crossed(weights: tuple[int, ...], levels: tuple[int, int]) -> Crossed:
    """Return the design with these participants in each cell; NotDefined for a factor of fewer than two levels."""
    if min(levels) < 2:
        raise exact.NotDefined(f"got {levels[0]} and {levels[1]} levels of two factors; allowed: at least 2 of each")
    return Crossed(weights, levels)


@dataclass(frozen=True)
class Cells:
    """One study's values in the cells of two crossed factors with these names."""

    names: tuple[str, str]
    design: Crossed
    ratios: exact.Ratios


def cells(
    values: Sequence[exact.Number], first: Sequence[Hashable], second: Sequence[Hashable], names: tuple[str, str]
) -> Cells:
    """Return values, shape (n,), sorted by the levels of two factors, each of shape (n,).

    Raises `NotDefined`: a factor has fewer than two levels, a cell is empty, or no cell holds two values.
    """
    levels = tuple(dict.fromkeys(first)), tuple(dict.fromkeys(second))
    for name, found in zip(names, levels, strict=True):
        if len(found) < 2:
            raise exact.NotDefined(f"two-way ANOVA needs two levels of {name}, got {len(found)}")
    sorted_values: dict[tuple[Hashable, Hashable], list[exact.Number]] = {key: [] for key in product(*levels)}
    for value, a, b in zip(values, first, second, strict=True):
        sorted_values[a, b].append(value)
    for (a, b), held in sorted_values.items():
        if not held:
            raise exact.NotDefined(f"two-way ANOVA needs a value in every cell, got none for {a}, {b}")
    if len(values) == len(sorted_values):
        raise exact.NotDefined(
            "two-way ANOVA needs two participants in some cell, got one in each: the error has no degrees of freedom"
        )
    weights = tuple(len(held) for held in sorted_values.values())
    return Cells(
        names, crossed(weights, (len(levels[0]), len(levels[1]))), exact.of_groups(list(sorted_values.values()))
    )


def tasks_by_materials(correct: Sequence[exact.Ratios]) -> tuple[Crossed, exact.Ratios]:
    """Return the design and the cells of many studies, from each task's ratios, shape (M, studies)."""
    materials = len(correct[0].sums)
    people = np.repeat([cells.participants for cells in correct], materials)
    trials = np.repeat([cells.denominator for cells in correct], materials)
    sums, squares = np.concatenate([c.sums for c in correct]), np.concatenate([c.squares for c in correct])
    cells = exact.Ratios(trials[:, None], people[:, None], sums, squares)
    return crossed(tuple(people.tolist()), (len(correct), materials)), cells


def two_way(data: Cells, kind: SumsOfSquares) -> Anova:
    """Return the two-way ANOVA with interaction; in type I the first factor enters first."""
    a, b = data.names
    lines = [
        (name, data.design.squares(effect, kind, data.ratios.sums, data.ratios.denominator), data.design.df_of(effect))
        for name, effect in ((a, "A"), (b, "B"), (f"{a} x {b}", "X"))
    ]
    return _table(f"two-way, type {kind}", lines, data.ratios.ss_within, data.design.df)


def two_way_tests(design: Crossed, cells: exact.Ratios, effect: str, kind: SumsOfSquares) -> exact.Tested:
    """Return F and P of an effect, "A", "B" or "X", in many studies; see `tasks_by_materials`."""
    return exact.f_test(
        design.squares(effect, kind, cells.sums, cells.denominator), cells.ss_within, design.df_of(effect), design.df
    )


def _table(kind: str, lines: Sequence[tuple[str, exact.Values, int]], within: exact.Values, df: int) -> Anova:
    names, sums, dfs = zip(*lines, strict=True)
    tested = exact.f_test(np.concatenate(sums), within, np.array(dfs), df)
    residual = Effect("residual", float(within[0]), df)
    if not within[0]:
        bare = tuple(Effect(name, float(ss[0]), own) for name, ss, own in lines)
        return Anova(kind, bare, residual, "there is no variance within the groups, so F and P are not defined")
    columns = names, map(float, np.concatenate(sums)), dfs, tested.statistic.tolist(), tested.p.tolist()
    return Anova(kind, tuple(Effect(*line) for line in zip(*columns, strict=True)), residual)


@dataclass(frozen=True)
class VarianceComponents:
    """Estimates in the squared unit of the values; they may be negative."""

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
    """Return the components of both factors, their interaction and the residual, by Henderson's method III."""
    first, second = data.names
    found = (float(part) for part in _components(data.design, data.ratios)[:, 0])
    return VarianceComponents((first, second, f"{first} x {second}"), *found)


def icc_of_mean(components: VarianceComponents, k: int) -> float | None:
    """Return S / (S + residual / k), the ICC of the mean of `k` participants; None without variance.

    S is the sum of the components of both factors and their interaction, each at least zero.
    """
    parts = [[components.first], [components.second], [components.interaction], [components.residual]]
    value = float(_share(exact.floats(parts), k)[0])
    return None if math.isnan(value) else value


def icc_limits(data: Cells, k: int) -> EffectSize:
    """Return the limits of the ICC of the mean of `k` participants, by F of all cells as one random factor.

    With S / residual = (F / F' - 1) / n, n a cell's mean size (Searle 1971, Linear Models, section 9.9), it is exact
    where cells have as many participants. Its value need not be that of the components. Raises `NotDefined` without F.
    """
    sizes, within = data.design.weights, data.ratios.ss_within
    if not within:
        raise exact.NotDefined("no variance within cells")
    df1, df2 = len(sizes) - 1, data.design.df
    f = float(ss_between(data.ratios)[0] / df1 / (within[0] / df2))
    size = (sum(sizes) - sum(n * n for n in sizes) / sum(sizes)) / df1
    tail = (1 + CONFIDENCE) / 2
    ratios = (max(one - 1, 0.0) / size for one in (f, f / fdtri(df1, df2, tail), f * fdtri(df2, df1, tail)))
    value, low, high = (float(k * ratio / (1 + k * ratio)) for ratio in ratios)
    return EffectSize(value, low, high, CONFIDENCE)


def variance_component_icc(design: Crossed, cells: exact.Ratios, k: int) -> exact.Floats:
    """Return `icc_of_mean` of many studies; NaN where there is no variance at all."""
    if design.df == 0:
        return exact.undefined(cells.sums.shape[1:]).statistic
    # Equal ratios have equal floating-point numbers; sums of squares formed from them need not be zero.
    varied = (cells.ss_within > 0) | (np.ptp(cells.means, axis=0) > 0)
    return np.where(varied, _share(_components(design, cells), k), np.nan)


def _components(design: Crossed, cells: exact.Ratios) -> exact.Values:
    """Return the components of both factors, their interaction and the residual, shape (4, studies)."""
    residual = cells.ss_within / design.df
    times: Mapping[str, Any] = design.coefficients
    if not cells.exact:
        times = {pair: float(n) for pair, n in times.items()}
    squares = {effect: design.squares(effect, "II", cells.sums, cells.denominator) for effect in "ABX"}
    left = {effect: ss - design.df_of(effect) * residual for effect, ss in squares.items()}
    interaction = left["X"] / times["XX"]
    factors = [(left[e] - times[f"{e}X"] * interaction) / times[e + e] for e in "AB"]
    return np.stack([*factors, interaction, residual])


def _share(components: exact.Floats, k: int) -> exact.Floats:
    signal = np.maximum(components[:3], 0.0).sum(axis=0)
    whole = signal + components[3] / k
    return exact.floats(exact.ratio(signal, whole))
