"""Variance components of two crossed random factors with unequal numbers, and the reliability formed from them.

Henderson's method III: reductions in the sum of squares are set equal to their expectations under a model in
which both factors and their interaction are random. Okamoto (section 5.2) prints an intraclass correlation of 0.97
"based on the results of this two-way ANOVA" without a formula; this is one reading of those words, not the only one.
"""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass
from fractions import Fraction

from analysis.anova import Cells


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
    for squares, without, effect, degrees in ((first_ss, "B", "A", df_first), (second_ss, "A", "B", df_second)):
        rest = squares - degrees * residual - _coefficient(data, "AB", without, "X") * interaction
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
