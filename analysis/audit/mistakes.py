"""Whether a printed number fits one of its recomputed values, and if not, the simplest mistake that gives it.

The first mistake whose values fit is named, others that fit follow. A mistake is an explanation, not a proof.
"""

import math
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from fractions import Fraction
from itertools import pairwise
from typing import Literal

from palpate.analysis.audit.bounds import Moments, effect, p_of_f, p_of_t, t_of
from palpate.analysis.audit.intervals import Interval, as_printed, either, hull, image, point, rounded, truncated
from palpate.analysis.documents.tables import plural
from palpate.analysis.published.printed import Printed

Verdict = Literal[
    "agrees",
    "agrees if truncated",
    "differs",
    "fits no one rounding",
    "impossible",
    "cannot be decided",
    "not in this dataset",
]
AGREES: tuple[Verdict, ...] = ("agrees", "agrees if truncated")


@dataclass(frozen=True)
class Line:
    """One printed number, the recomputed one as text at the printed precision, and its bounds or None."""

    where: str
    task: str
    subject: str
    quantity: str
    printed: str
    recomputed: str
    low: float | None
    high: float | None
    verdict: Verdict
    reason: str = ""

    @property
    def agrees(self) -> bool:
        """Whether the printed number stands, as rounded or as truncated."""
        return self.verdict in AGREES


def judge(
    printed: Printed, values: Sequence[Interval], *, squares: bool = False
) -> tuple[Verdict, tuple[Interval, ...]]:
    """Return the verdict on a printed number, and the `values` that fit, or all; they may be its `squares`."""
    for verdict, reading in zip(AGREES, (rounded(printed), truncated(printed)), strict=True):
        wanted = reading.squared() if squares else reading
        if fitting := tuple(value for value in values if wanted.meets(value)):
            return verdict, fitting
    return "differs", tuple(values)


def shown(
    printed: Printed, values: Sequence[Interval], *, squares: bool = False, further: int = 0
) -> tuple[str, float | None, float | None]:
    """Return the values as text, with `further` digits than are printed, and their ends; None where one is infinite."""
    both = hull(values)
    low, high = float(both.low), float(both.high)
    if squares:
        low, high = math.sqrt(max(low, 0.0)), math.sqrt(high)
    texts = ["" if math.isinf(end) else as_printed(printed, end, further) for end in (low, high)]
    if math.isinf(low) or math.isinf(high):
        words = [f"from {texts[0]}"] * bool(texts[0]) + [f"up to {texts[1]}"] * bool(texts[1])
        return " ".join(words) or "any", None if math.isinf(low) else low, None if math.isinf(high) else high
    if math.isclose(low, high, rel_tol=1e-8):
        return as_printed(printed, (low + high) / 2, further), low, high
    return texts[0] if texts[0] == texts[1] else " to ".join(texts), low, high


@dataclass(frozen=True)
class Mistake:
    """What may have gone wrong, and the values that this would have given; `squares` is as in `judge`."""

    text: str
    values: tuple[Interval, ...]
    squares: bool = False

    def gives(self, printed: Printed) -> bool:
        """Return whether the printed number can stand for one of the values."""
        return judge(printed, self.values, squares=self.squares)[0] in AGREES

    def by_chance(self, printed: Printed) -> float:
        """Return the share of numbers from a tenth to ten times the printed one that fit, evenly in logarithm."""
        size, unit = abs(printed.value), printed.unit
        if not size:
            return 0.0
        ends = []
        for value in self.values:
            low, high = (float(end) for end in (value.absolute().low, value.absolute().high))
            if self.squares:
                low, high = math.sqrt(max(low, 0.0)), math.sqrt(high)
            ends.append((max(low - unit, size / 10), min(high + unit, size * 10)))
        covered, reached = 0.0, 0.0
        for low, high in sorted(ends):
            begin = max(low, reached)
            if begin < high:
                covered += math.log10(high / begin)
                reached = high
        return covered / 2


OFTEN = 0.05
"""Share of random wrong numbers from which on a mistake that gives them is said to fit by chance."""


def mistake_words(text: str, by_chance: float) -> str:
    """Return a mistake in words, with the share of wrong numbers that it gives by chance where that is not small."""
    if by_chance < OFTEN:
        return text
    return f"{text} (by chance this would fit {min(100 * by_chance, 99):.0f} % of wrong numbers)"


@dataclass(frozen=True)
class Layout:
    """The df and number of values of an ANOVA, `n` of each cell or 0, and `sizes` that may be mistaken for n."""

    df: tuple[int, int]
    values: int
    n: int = 0
    sizes: tuple[int, ...] = ()

    @property
    def cells(self) -> int:
        return self.values - self.df[1]


def explain(printed: Printed, mistakes: Iterable[Mistake]) -> str:
    """Return the mistakes that give the printed number, in words and in their order; empty where none does."""
    return "; or ".join(mistake_words(one.text, one.by_chance(printed)) for one in mistakes if one.gives(printed))


SWAPPED, ONE_DIGIT, TENFOLD = "two digits are swapped", "one digit is wrong", "it is off by a power of ten"


def _places(printed: str) -> list[int]:
    """Return where the digits of a number stand, without a 0 alone before the point and the power of ten."""
    number = printed.partition("e")[0]
    bare = {i for i in range(len(number)) if number[i : i + 2] == "0." and not number[:i].strip("-<").isdigit()}
    return [i for i, sign in enumerate(number) if sign.isdigit() and i not in bare]


def slips(printed: str) -> Iterator[tuple[str, str]]:
    """Yield what a slip of one digit makes `printed` of, as the slip in words and the number, the rarest slip first."""
    places = _places(printed)
    for i, j in pairwise(places):
        if printed[i] != printed[j]:
            yield SWAPPED, printed[:i] + printed[j] + printed[i + 1 : j] + printed[i] + printed[j + 1 :]
    for i in places:
        for sign in "0123456789":
            if sign != printed[i]:
                yield ONE_DIGIT, printed[:i] + sign + printed[i + 1 :]


FEW = 50
"""Values up to which a slip is compared with each of them, and beyond with the interval around them all."""


def slip_of(printed: Printed, values: Sequence[Interval], *, squares: bool = False, explained: bool = False) -> str:
    """Return the slips of the point or a digit that give the printed number.

    Where it is `explained`, swapped digits are named and a wrong one is not.
    """
    found: list[str] = []
    for power in (-1, 1, -2, 2):
        factor = Fraction(10) ** (power * (1 + squares))
        moved = Mistake(TENFOLD, tuple(value.times(factor) for value in values), squares)
        if moved.gives(printed) and not found:
            found.append(mistake_words(TENFOLD, moved.by_chance(printed)))
    if len(values) > FEW:
        values = [hull(values)]
    fitting: dict[str, list[str]] = {}
    tried: Counter[str] = Counter()
    for slip, text in slips(printed.text):
        tried[slip] += 1
        if (slip == SWAPPED or not (found or explained)) and judge(Printed(text), values, squares=squares)[0] in AGREES:
            fitting.setdefault(slip, []).append(text)
    digits = len(_places(printed.text))
    for slip, texts in [*fitting.items()][:1]:
        by_chance = len(texts) * tried[slip] / 10 ** max(digits, 1)
        found.append(mistake_words(f"{slip}: {' or '.join(texts[:3])} would fit", by_chance))
    return "; or ".join(found)


def of_mean(means: Sequence[Interval], n: int, sizes: Iterable[int]) -> Iterator[Mistake]:
    """Yield mistakes in a mean of `n`; `sizes` are the study's other numbers of participants."""
    for size in sizes:
        values = tuple(mean.times(Fraction(n, size)) for mean in means)
        yield Mistake(f"the sum was divided by {plural(size, 'participant')}, but n is {n}", values)
    yield Mistake("it was printed as a percentage", tuple(mean.times(Fraction(100)) for mean in means))
    yield Mistake("it is 1 minus the ratio", tuple(mean.times(Fraction(-1)).plus(point(Fraction(1))) for mean in means))


def of_sd(possible: Iterable[Moments]) -> Iterator[Mistake]:
    """Yield mistakes in a standard deviation; none where nothing is possible."""
    moments = tuple(possible)
    population = tuple(one.variance.times(Fraction(one.n - 1, one.n)) for one in moments)
    yield Mistake("it is the population SD (computed with n, not n - 1)", population, squares=True)
    errors = tuple(one.variance.times(Fraction(1, one.n)) for one in moments)
    yield Mistake("it is the standard error", errors, squares=True)
    yield Mistake("it is the variance", tuple(one.variance for one in moments))


def of_t(
    effects: Sequence[Interval],
    moments: Sequence[Moments],
    printed: Printed,
    n: int,
    sizes: Iterable[int],
    *,
    sd_in_doubt: bool = False,
) -> Iterator[Mistake]:
    """Yield mistakes in a one-sample t, `printed`, with effect sizes `effects`; `sd_in_doubt`: the SD may be wrong."""
    wrong_sds = ("the standard error", "the population SD")
    error, population = (f", or the SD is {one}" if sd_in_doubt else "" for one in wrong_sds)
    correct = tuple(t_of(one, n) for one in effects)
    yield Mistake("its sign is lost", tuple(one.times(Fraction(-1)) for one in correct))
    alike = [one.common(either(printed)) for one in effects if one.meets(either(printed))]
    yield Mistake(f"the printed t is Cohen's d{_span(alike)}{error}", tuple(effects))
    factor = math.sqrt(n / (n - 1))
    yield Mistake("it was computed with the population SD", tuple(image(lambda t: t * factor, one) for one in correct))
    smaller = f"it was computed with sqrt(n - 1), as if from {n - 1} participants{population}"
    yield Mistake(smaller, tuple(image(lambda t: t / factor, one) for one in correct))
    for size in sizes:
        if size != n - 1:
            text = f"it is d * sqrt({size}), but n is {n}"
            yield Mistake(text, tuple(t_of(one, size) for one in effects))
    from_zero = [of_zero for one in moments if (of_zero := effect(one, Fraction(0))) is not None]
    yield Mistake("it is from a t-test against 0", tuple(t_of(one, n) for one in from_zero))
    yield Mistake("it is t squared, that is, F", tuple(one.absolute().squared() for one in correct))


def of_p(
    effects: Sequence[Interval], t: Printed, df: int, n: int, sizes: Sequence[int], *, tests: int, t_agrees: bool
) -> Iterator[Mistake]:
    """Yield mistakes in the P of a one-sample t; its family has `tests`, and `t` and `df` are printed beside it."""
    correct = [t_of(one, n) for one in effects]
    yield Mistake("it is one-tailed", tuple(p_of_t(one, n - 1).times(_HALF) for one in correct))
    if not t_agrees:
        yield Mistake("it matches the printed t", (p_of_t(either(t), df),))
        yield Mistake("it matches the printed t, one-tailed", (p_of_t(either(t), df).times(_HALF),))
    yield Mistake(f"it was computed with {n} df, but n is {n}", tuple(p_of_t(one, n) for one in correct))
    for size in sizes:
        if size - 1 != n:
            text = f"it was computed with {size - 1} df, but n is {n}"
            yield Mistake(text, tuple(p_of_t(one, size - 1) for one in correct))
    for size in sizes:
        text = f"it is the P of d * sqrt({size}) with {size - 1} df, but n is {n}"
        yield Mistake(text, tuple(p_of_t(t_of(one, size), size - 1) for one in effects))
    yield Mistake("it is from the normal distribution", tuple(image(_p_of_z, one.absolute()) for one in correct))
    if tests > 1:
        family = tuple(p_of_t(one, n - 1).times(Fraction(tests)) for one in correct)
        yield Mistake(f"it was multiplied by {tests}, the number of tests in its task", family)


def of_lone_p(t: Printed, df: int) -> Iterator[Mistake]:
    """Yield mistakes in a P that has nothing but a t and its df beside it."""
    yield Mistake("it is one-tailed", (p_of_t(either(t), df).times(_HALF),))
    for other in (df + 1, df - 1):
        if other > 0:
            yield Mistake(f"it was computed with {other} df", (p_of_t(either(t), other),))
    yield Mistake("it is from the normal distribution", (image(_p_of_z, either(t).absolute()),))


def of_any_f(f: Sequence[Interval], df: tuple[int, int]) -> Iterator[Mistake]:
    """Yield what else could have been printed in the place of an F with these df."""
    yield Mistake(
        "it is the square root of F, that is, t", tuple(image(lambda one: math.sqrt(max(one, 0.0)), f_) for f_ in f)
    )
    eta = tuple(image(lambda one: df[0] / (df[0] + df[1] / one) if one > 0 else 0.0, f_) for f_ in f)
    yield Mistake("the printed F is eta squared", eta)


def of_f(f: Sequence[Interval], layout: Layout, printed: tuple[int, int]) -> Iterator[Mistake]:
    """Yield mistakes in an F; `printed` are the df beside it."""
    df = layout.df
    yield from of_any_f(f, df)
    population = Fraction(layout.values, df[1])
    yield Mistake("its residual was divided by the number of values", tuple(one.times(population) for one in f))
    if printed != df:
        factor = Fraction(df[0] * printed[1], printed[0] * df[1])
        yield Mistake("it was computed with its printed df", tuple(one.times(factor) for one in f))
    for size in layout.sizes:
        text = f"it was computed from {size} participants, but n is {layout.n}"
        yield Mistake(text, tuple(one.times(Fraction(size, layout.n)) for one in f))


def of_p_of_f(f: Sequence[Interval], beside: Printed, layout: Layout, printed: tuple[int, int]) -> Iterator[Mistake]:
    """Yield mistakes in the P of an F; `beside` is the F beside it, `printed` its df."""
    df = layout.df
    yield Mistake("it matches the printed F", (p_of_f(either(beside), df),))
    if printed != df:
        yield Mistake("it was computed with its printed df", tuple(p_of_f(one, printed) for one in f))
        yield Mistake("it matches the printed F with its printed df", (p_of_f(either(beside), printed),))
    yield Mistake("it is one-tailed", tuple(p_of_f(one, df).times(_HALF) for one in f))
    for other in (layout.values, layout.values - 1, df[1] - df[0]):
        if other > 0:
            text = f"it was computed with {df[0]}, {other} df"
            yield Mistake(text, tuple(p_of_f(one, (df[0], other)) for one in f))
    for size in layout.sizes:
        larger = [one.times(Fraction(size, layout.n)) for one in f]
        text = f"it was computed from {size} participants, but n is {layout.n}"
        yield Mistake(text, tuple(p_of_f(one, (df[0], layout.cells * (size - 1))) for one in larger))


def of_df_of_effect(layout: Layout) -> Iterator[tuple[int, str]]:
    """Yield what else could have been printed as the df of an effect."""
    yield layout.df[0] + 1, "it is the number of levels"


def of_df_of_residual(layout: Layout) -> Iterator[tuple[int, str]]:
    """Yield what else could have been printed as the df of the residual."""
    levels = layout.df[0] + 1
    yield layout.values - 1, "it is the total df, from which the effects' df were not subtracted"
    yield layout.values, "it is the number of values"
    if layout.cells > levels:
        yield layout.values - levels - layout.cells // levels + 1, "its residual includes the interaction"
    yield layout.values - layout.df[0], "it is the number of values minus the effect's df"
    for size in layout.sizes:
        if size != layout.n + 1:
            yield layout.cells * (size - 1), f"it was computed from {size} participants, but n is {layout.n}"
    if layout.n:
        yield layout.df[0] * (layout.n - 1), "it was computed as if for repeated measures"


def of_df(n: int, sizes: Iterable[int]) -> Iterator[tuple[int, str]]:
    """Yield what else could have been printed as the df of a t."""
    yield n, "it is the number of participants"
    for size in sizes:
        if size - 1 != n:
            yield size - 1, f"it was computed from {plural(size, 'participant')}, but n is {n}"


def _nearest(printed: Printed, values: Sequence[Interval], *, squares: bool) -> str:
    """Return the values beside a number that lies between them and is none; nothing where it lies beyond them all."""
    at = printed.exact**2 if squares else printed.exact
    ends = (
        max((float(one.high) for one in values if one.high < at), default=None),
        min((float(one.low) for one in values if one.low > at), default=None),
    )
    beside = [math.sqrt(max(end, 0.0)) if squares else end for end in ends if end is not None]
    return " or ".join(as_printed(printed, end, 1) for end in beside) if len(beside) == 2 else ""


def _above_zero(p: str) -> str:
    """Return a P as text, and one of which no digit is left as the bound that its digits set."""
    return f"<{p[:-1]}1" if re.fullmatch(r"0\.0+", p) else p


def _p_of_z(z: float) -> float:
    return math.erfc(z / math.sqrt(2))


def _span(effects: Sequence[Interval]) -> str:
    if not effects:
        return ""
    both = hull(effects)
    texts = [as_printed(Printed("0.00"), float(end)) for end in (both.low, both.high)]
    return f" = {texts[0]}" if texts[0] == texts[1] else f" = {texts[0]} to {texts[1]}"


_HALF = Fraction(1, 2)


@dataclass(frozen=True)
class Citation:
    """Where a printed number stands and what it is about; `missing` is its verdict where there are no values."""

    where: str
    task: str
    subject: str
    missing: Verdict
    statement: str = ""

    def number(
        self,
        quantity: str,
        printed: Printed,
        values: Sequence[Interval],
        why: Iterable[Mistake] | None = (),
        *,
        squares: bool = False,
        remark: str = "",
        otherwise: tuple[Verdict, str] = ("differs", ""),
    ) -> Line:
        """Return the line of a number that can have `values`; `squares` is as in `judge`.

        `why` are mistakes to try before slips, or None; `remark` follows the number; `otherwise` is the verdict where
        nothing fits.
        """
        if not values:
            return self.text(quantity, printed.text, "-", self.missing, self.statement)
        verdict, fitting = judge(printed, values, squares=squares)
        # One more digit where a number does not stand, lest it look like the one that is shown beside it.
        text, low, high = shown(printed, fitting, squares=squares, further=verdict not in AGREES)
        if verdict == "differs" and (nearest := _nearest(printed, values, squares=squares)):
            text = f"{nearest}, of {text}"
        if quantity == "P":
            text = " to ".join(dict.fromkeys(_above_zero(part) for part in text.split(" to ")))
        reason = ""
        if verdict == "differs":
            found = "" if why is None else explain(printed, why)
            slip = "" if why is None else slip_of(printed, values, squares=squares, explained=bool(found))
            verdict, reason = otherwise[0], "; or ".join(filter(None, (found, slip))) or otherwise[1]
        recomputed = text + remark
        return Line(self.where, self.task, self.subject, quantity, printed.text, recomputed, low, high, verdict, reason)

    def text(
        self, quantity: str, printed: str, found: str, verdict: Verdict, reason: str = "", value: float | None = None
    ) -> Line:
        """Return the line of what is compared as text, or as one exact value."""
        return Line(self.where, self.task, self.subject, quantity, printed, found, value, value, verdict, reason)
