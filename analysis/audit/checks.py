"""Every check of a study's printed numbers: each number beside the recomputed one, from print or from a dataset.

A number agrees when rounding, or cutting, some recomputed value prints it; what print leaves open never differs.
"""

import functools
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from fractions import Fraction

from palpate.analysis.audit import mistakes
from palpate.analysis.audit.bounds import Moments, effect, p_of_f, p_of_t, t_of
from palpate.analysis.audit.evidence import NO_STEPS, Evidence, Misreading, Sample, Variances
from palpate.analysis.audit.intervals import Interval, either, hull, image
from palpate.analysis.audit.mistakes import AGREES, Citation, Layout, Line, Mistake, Verdict, judge
from palpate.analysis.published.numbers import PrintedCell, PrintedClaim, PrintedF, PrintedLevel, PrintedT, Published
from palpate.analysis.published.printed import Printed
from palpate.analysis.statistics.inference import stars


def stars_of(p: Printed, levels: Sequence[PrintedLevel]) -> str:
    """Return the stars that a printed P earns; an upper bound earns those of everything below it."""
    return _earned(math.nextafter(p.value, 0.0) if p.is_bound else p.value, levels) or "none"


def stars_by_p(p: Printed, levels: Sequence[PrintedLevel]) -> tuple[str, ...]:
    """Return the stars that the values behind a printed P can earn, most first; "none" stands for no stars."""
    behind = either(p)
    high = math.nextafter(float(behind.high), 0.0) if behind.open_high else float(behind.high)
    return tuple(
        mark or "none" for mark in sorted(_stars_between(float(behind.low), high, levels), key=len, reverse=True)
    )


def stars_reached(sample: Sample, effects: Sequence[Interval], levels: Sequence[PrintedLevel]) -> tuple[str, ...]:
    """Return the stars that a mean can have, most first; "none" stands for no stars."""
    found = {""} if effects and any(one.variance.low == 0 for one in sample.moments) else set()
    below = [one for one in levels if not one.above]
    sides = (Interval(Fraction(0), math.inf), levels), (Interval(-math.inf, Fraction(0)), below)
    for side, given in sides:
        for one in effects:
            if side.meets(one):
                p = p_of_t(t_of(one.common(side), sample.n), sample.n - 1)
                found |= _stars_between(float(p.low), float(p.high), given)
    return tuple(mark or "none" for mark in sorted(found, key=len, reverse=True))


def _stars_between(low: float, high: float, levels: Sequence[PrintedLevel]) -> set[str]:
    """Return the stars of every P from `low` to `high`."""
    steps = ["", *(level.stars for level in reversed(levels))]
    reached = [steps.index(_earned(end, levels)) for end in (low, high)]
    return set(steps[min(reached) : max(reached) + 1])


def _earned(p: float, levels: Sequence[PrintedLevel]) -> str:
    return stars(p, [(level.p.value, level.stars) for level in levels])


NO_NULL = "the value that it was tested against is not printed"
CONSTANT = "every value is the same, so t and P are not defined"

INSTEAD: Mapping[Misreading, str] = {
    "the population SD": "t was computed with sqrt(n - 1), and P follows from it",
    "the standard error": "the printed t is Cohen's d, and P follows from it",
}
"""What gives the same t and P as a misread SD does."""


class Checks:
    """All lines of a study's printed numbers beside one evidence, in the order of the paper's tables."""

    def __init__(self, published: Published, evidence: Evidence, *, diagnose: bool) -> None:
        self._published = published
        self._evidence = evidence
        self._diagnose = diagnose
        self._sizes = sorted({task.participants for task in published.task if task.participants > 1}, reverse=True)
        self._everybody = sum(task.participants for task in published.task)

    def lines(self) -> Iterator[Line]:
        """Yield the lines of cells, t-tests, ANOVAs and claims."""
        for cell in self._published.cells:
            yield from self._cell(cell)
        for test in self._published.tests:
            yield from self._test(test)
        for printed in self._published.anovas:
            yield from self._f(printed)
        for claim in self._published.claim:
            yield self._claim(claim)

    def about(self, cell: PrintedCell) -> Iterator[Line]:
        """Yield the lines of a cell, wherever it stands, and of its test."""
        for other in self._published.cells_by_key.get(cell.key, ()):
            yield from self._cell(other)
        for test in self._published.tests_by_key.get(cell.key, ()):
            yield from self._test(test)

    def ratios_of(self, cells: Sequence[PrintedCell]) -> Iterator[Line]:
        """Yield the lines of every F that one of these cells is in."""
        for printed in self._published.anovas:
            if any(is_in(printed, cell) for cell in cells):
                yield from self._f(printed)

    def effects(self, test: PrintedT) -> tuple[Interval, ...]:
        """Return the effect sizes that agree with the printed t, read as t or else as d, or all where none does."""
        sample = self._evidence.tested(test)
        effects = _effects(sample, test.null)
        as_t = image(lambda t: t / math.sqrt(max(sample.n, 1)), either(test.t))
        for pin in (as_t, either(test.t)):
            if pinned := tuple(one.common(pin) for one in effects if one.meets(pin)):
                return pinned
        return effects

    def _tried(self, found: Iterable[Mistake]) -> Iterable[Mistake] | None:
        return found if self._diagnose else None

    def _citation(self, where: str, task: str, subject: str, statement: str = "") -> Citation:
        return Citation(where, task, subject, self._evidence.missing, statement)

    def _others(self, n: int, df: int | None = None) -> list[int]:
        """Return what may have been taken for n, the likeliest first; `df` is printed beside it."""
        sizes = [*self._sizes, *([df + 1] if df else []), self._everybody, n - 1, n + 1]
        return [size for size in dict.fromkeys(sizes) if size > 1 and size != n]

    def _cell(self, cell: PrintedCell) -> Iterator[Line]:
        known, sample, test = self._evidence.mean(cell), self._evidence.sample(cell), self._test_of(cell)
        cited = self._citation(cell.where, cell.task, cell.subject, known.statement)
        no_counts = f"no whole-number counts from {sample.n} participants give it"
        otherwise = self._evidence.refuted, no_counts if self._evidence.refuted == "impossible" else ""
        contradiction: tuple[Verdict, str] = otherwise if cell.in_table else ("differs", "")
        why = self._tried(mistakes.of_mean(known.values, sample.n, self._others(sample.n)))
        yield cited.number("mean", cell.mean, known.values, why, otherwise=contradiction)
        if not known.values and not known.statement:
            return
        if cell.sd is not None:
            no_steps = "no whole-number counts give the mean" if cell.scale else NO_STEPS
            cited = replace(cited, statement=known.statement or sample.statement or no_steps)
            yield self._sd(cited, cell, cell.sd, contradiction)
        null = test.null if test else None if cell.is_score else self._published.chance
        if self._published.levels and cell.stars is not None and cell.presented == cell.answered:
            yield self._stars(cited, cell, null, test)

    def _sd(self, cited: Citation, cell: PrintedCell, printed: Printed, contradiction: tuple[Verdict, str]) -> Line:
        sample, test, fitting = self._evidence.sample(cell), self._test_of(cell), self.that_give(cell)
        misreading = self._evidence.misreading(cell)
        if misreading:
            # Where whole counts give the printed SD, a mistake in t and P explains as much.
            instead = f"; or {INSTEAD[misreading]}" if self._evidence.sd_stands(cell) else ""
            why_so = f"its t and P follow from the SD{instead}" if test else "as in the rest of the table"
            contradiction = "differs", f"it is {misreading}: {why_so}"

        def possible() -> Iterator[Moments]:
            yield from sample.every
            if not test:
                yield from self._evidence.beyond(cell)

        why = None if misreading else self._tried(mistakes.of_sd(possible()))
        variances = [one.variance for one in fitting or sample.every]
        line = cited.number("SD", printed, variances, why, squares=True, otherwise=contradiction)
        truncated = line.verdict == "agrees if truncated" and fitting
        return replace(line, reason=_cut(printed, fitting)) if truncated else line

    def that_give(self, cell: PrintedCell) -> tuple[Moments, ...]:
        """Return those means and variances behind the printed mean and SD that give the printed t, read as t or d."""
        test = self._test_of(cell)
        if test is None or not self._diagnose:
            return ()
        pins = self.effects(test)
        sizes = ((one, effect(one, test.null)) for one in self._evidence.sample(cell).moments)
        return tuple(one for one, size in sizes if size is not None and any(size.meets(pin) for pin in pins))

    def _test_of(self, cell: PrintedCell) -> PrintedT | None:
        return next(iter(self._published.tests_by_key.get(cell.key, ())), None)

    def _stars(self, cited: Citation, cell: PrintedCell, null: Fraction | None, test: PrintedT | None) -> Line:
        if null is None:
            return cited.text("stars", cell.stars or "none", "-", "cannot be decided", NO_NULL)
        sample = self._evidence.sample(cell)
        every = stars_reached(sample, _effects(sample, null), self._published.levels)
        pinned = stars_reached(sample, self.effects(test), self._published.levels) if test else every
        printed = cell.stars or "none"
        by_p = self._by_printed_p(test) if test else ()
        if not every and not by_p:
            verdict = cited.missing if sample.statement or sample.n < 2 else "cannot be decided"
            return cited.text("stars", printed, "none", "agrees" if printed == "none" else verdict, CONSTANT)
        found = pinned if printed in pinned or printed not in every else every
        from_p = by_p if printed in found or not every else ()
        earned = from_p or found
        if printed in earned:
            return cited.text("stars", printed, " or ".join(earned), "agrees")
        reason = self._why_other_stars(test, printed, sample.n, from_p=bool(from_p))
        return cited.text("stars", printed, " or ".join(earned), "differs", reason)

    def _why_other_stars(self, test: PrintedT | None, printed: str, n: int, *, from_p: bool) -> str:
        """Return what the printed P of a test says of stars that it, or else its t, does not earn."""
        if test is None or test.p is None:
            return ""
        if from_p:
            return f"the P printed with them is {test.p.text}"
        if not self._diagnose or stars_of(test.p, self._published.levels) != printed:
            return ""
        both = hull([p_of_t(t_of(one, n), n - 1) for one in self.effects(test)])
        value = " to ".join(dict.fromkeys(f"{float(p):.2g}" for p in (both.low, both.high)))
        return f"they match the printed P = {test.p.text}; recomputed P = {value}"

    def _by_printed_p(self, test: PrintedT) -> tuple[str, ...]:
        """Return the stars that the test's printed P earns, or none where that P is missing or does not stand."""
        if not self._diagnose or test.p is None:
            return ()
        n, effects = self._evidence.tested(test).n, self.effects(test)
        found = [p_of_t(t_of(one, n), n - 1) for one in effects] or [p_of_t(either(test.t), test.df)]
        levels = [one for one in self._published.levels if test.t.exact > 0 or not one.above]
        return stars_by_p(test.p, levels) if judge(test.p, found)[0] in AGREES else ()

    def _test(self, test: PrintedT) -> Iterator[Line]:
        sample = self._evidence.tested(test)
        effects = _effects(sample, test.null)
        statement = sample.statement or (CONSTANT if sample.moments and not effects else "")
        cited = self._citation(test.where, test.task, test.material, statement)
        n, others = sample.n, self._others(sample.n, test.df)
        remark = f" at {n - 1} df" if effects and n - 1 != test.df else ""
        p_stands = test.p is None or judge(test.p, [p_of_t(either(test.t), max(n - 1, 1))])[0] in AGREES
        sd_in_doubt = self._evidence.sd_in_doubt and p_stands
        why = mistakes.of_t(effects, sample.moments, test.t, n, others, sd_in_doubt=sd_in_doubt)
        ts = [t_of(one, n) for one in effects]
        t = cited.number(f"t({test.df})", test.t, ts, self._tried(why), remark=remark)
        yield t
        if test.p is not None:
            yield self._p(cited, test, test.p, n, effects, t_agrees=t.agrees)
        of_df = mistakes.of_df(n, self._others(n)) if self._diagnose else ()
        yield _df(cited, test.df, n - 1 if n > 1 else None, of_df)

    def _p(
        self, cited: Citation, test: PrintedT, p: Printed, n: int, effects: Sequence[Interval], *, t_agrees: bool
    ) -> Line:
        if not effects and cited.missing == "cannot be decided":
            # Nothing else is printed, but P can still be compared with the t and df beside it.
            return cited.number("P", p, [p_of_t(either(test.t), test.df)], mistakes.of_lone_p(test.t, test.df))
        pinned = self.effects(test)
        every, narrow = ([p_of_t(t_of(one, n), n - 1) for one in sizes] for sizes in (effects, pinned))
        # Where t itself is wrong, a P that the means and SDs allow is not accused.
        lenient = not t_agrees and judge(p, narrow)[0] not in AGREES and judge(p, every)[0] in AGREES
        family = sum(one.task == test.task for one in self._published.tests)
        sizes = self._others(n, test.df)
        why = mistakes.of_p(pinned, test.t, test.df, n, sizes, tests=family, t_agrees=t_agrees)
        return cited.number("P", p, every if lenient else narrow, self._tried(why))

    def _f(self, printed: PrintedF) -> Iterator[Line]:
        found = self._evidence.variances(printed)
        cited = self._citation(printed.where, printed.task or "both", ratio_subject(printed), found.statement)
        own, values = found.df, list(found.f.values())
        fitting = judge(printed.f, values)[1]
        layout = self._layout(printed, found) if self._diagnose else None
        why = self._tried(mistakes.of_f(values, layout, printed.df) if layout else ())
        name = f"F({printed.df[0]},{printed.df[1]})"
        line = cited.number(name, printed.f, values, why, remark=_remark_on_f(printed, found))
        if own is None or not values:
            yield line
            from_print = [p_of_f(either(printed.f), printed.df)] if cited.missing == "cannot be decided" else []
            yield cited.number("P", printed.p, from_print)
        else:
            narrow = [one.common(either(printed.f)) if line.agrees else one for one in fitting]
            if self._diagnose and line.agrees and (slip := _slip_of_f(printed, narrow, values, own)):
                line, narrow = replace(line, verdict="differs", reason=slip), values
            yield line
            why = self._tried(mistakes.of_p_of_f(values, printed.f, layout, printed.df) if layout else ())
            yield cited.number("P", printed.p, [p_of_f(one, own) for one in narrow], why)
        effect, residual = own or (None, None)
        of_effect = mistakes.of_df_of_effect(layout) if layout else ()
        of_residual = mistakes.of_df_of_residual(layout) if layout else ()
        yield _df(cited, printed.df[0], effect, of_effect, "df of the effect")
        yield _df(cited, printed.df[1], residual, of_residual, "df of the residual")

    def _layout(self, printed: PrintedF, found: Variances) -> Layout | None:
        if found.df is None:
            return None
        n, rest = divmod(found.values, found.values - found.df[1])
        alike = printed.task is not None and not rest
        return Layout(found.df, found.values, n, tuple(self._others(n))) if alike else Layout(found.df, found.values)

    def _claim(self, claim: PrintedClaim) -> Line:
        cited = self._citation(claim.where, claim.task, "materials above chance")
        cells = [cell for cell in self._published.tables() if cell.task == claim.task and not cell.is_score]
        above = [level.model_copy(update={"above": True}) for level in self._published.levels]
        least = most = known = 0
        for cell in cells:
            test = self._test_of(cell)
            if cell.presented != cell.answered or test is None:
                continue
            found = stars_reached(self._evidence.tested(test), self.effects(test), above)
            known += bool(found)
            least += bool(found) and "none" not in found
            most += any(mark != "none" for mark in found)
        text, printed = f"{claim.significant} of {claim.of}", f"{least}" if least == most else f"{least} to {most}"
        if known != claim.of:
            return cited.text("significant", text, "-", cited.missing, "not every material is tested")
        verdict: Verdict = "agrees" if least <= claim.significant <= most else "differs"
        return cited.text("significant", text, f"{printed} of {known}", verdict)


def _df(cited: Citation, printed: int, found: int | None, other: Iterable[tuple[int, str]], name: str = "df") -> Line:
    if found is None:
        return cited.text(name, str(printed), "-", cited.missing, cited.statement)
    reason = "; or ".join(text for value, text in other if value == printed) if printed != found else ""
    verdict: Verdict = "agrees" if printed == found else "differs"
    return cited.text(name, str(printed), str(found), verdict, reason, float(found))


def _remark_on_f(printed: PrintedF, found: Variances) -> str:
    """Return other df than the printed ones, and the sums of squares that agree, where not all of them do."""
    remark = f" at {found.df[0]}, {found.df[1]} df" if found.df and found.df != printed.df else ""
    verdict, fitting = judge(printed.f, list(found.f.values()))
    if len(found.f) > 1 and (verdict not in AGREES or len(fitting) < len(found.f)):
        remark += f" by {' or '.join(kind for kind, f in found.f.items() if f in fitting)}"
    return remark


def _slip_of_f(printed: PrintedF, narrow: Sequence[Interval], values: Sequence[Interval], df: tuple[int, int]) -> str:
    """Return the slip of a digit in F that explains why its P does not follow it, where no slip of P does."""
    ps = [p_of_f(one, df) for one in narrow]
    if judge(printed.p, ps)[0] in AGREES or mistakes.slip_of(printed.p, ps) or not printed.f.exact:
        return ""
    for slip, text in mistakes.slips(printed.f.text):
        held = [one.common(either(Printed(text))) for one in values if one.meets(either(Printed(text)))]
        if held and judge(printed.p, [p_of_f(one, df) for one in held])[0] in AGREES:
            return f"{slip}: {text} would fit, and gives the printed P"
    return ""


def ratio_subject(printed: PrintedF) -> str:
    """Return what the lines of an F are about."""
    return f"{'one-way' if printed.task else 'two-way'} ANOVA, {' and '.join(printed.subject)}"


def is_in(printed: PrintedF, cell: PrintedCell) -> bool:
    """Return whether an F is computed from a cell."""
    if printed.task is None:
        return cell.presented == cell.answered and not cell.is_score
    return printed.task == cell.task and {cell.presented, cell.answered} <= set(printed.subject)


def _cut(sd: Printed, held: Sequence[Moments]) -> str:
    """Return why an SD has to be truncated beside its t, and whether rounding the population SD prints it as well."""
    population = [one.variance.times(Fraction(one.n - 1, one.n)) for one in held]
    either = "; or it is the population SD (computed with n, not n - 1)"
    return "the printed t requires this" + either * (judge(sd, population, squares=True)[0] == "agrees")


@functools.lru_cache(maxsize=16)
def _effects(sample: Sample, null: Fraction) -> tuple[Interval, ...]:
    return tuple(dict.fromkeys(size for one in sample.moments if (size := effect(one, null)) is not None))
