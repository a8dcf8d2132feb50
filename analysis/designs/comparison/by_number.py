"""What the numbers of stimuli add to the quality that was compared, as sections: factors, delays and crossovers."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from palpate.analysis.designs.comparison.delays import STEP_MS, Side
from palpate.analysis.designs.comparison.estimates import Estimate
from palpate.analysis.designs.comparison.factors import Factor
from palpate.analysis.designs.comparison.results import Compared, TaskComparisons
from palpate.analysis.documents.tables import Column, Record, Section, ends, interval, number, p_is, tabulate
from palpate.analysis.report.plan import Standing

REDUCED = (
    "Some choices never varied, so the maximum-likelihood scale is infinite. This scale is bias-reduced (Firth 1993), "
    "so its longest steps are conservative."
)

BY_FACTOR = (
    Column("factor", left=True), Column("level", show="{:g}".format), Column("value", decimals=2),
    Column(("low", "high"), "95 % CI", 2), Column("doubling", "a doubling", 2),
    Column(("doubling_low", "doubling_high"), "95 % CI", 2), Column("across", "the range", 2),
    Column(("across_low", "across_high"), "95 % CI", 2),
)  # fmt: skip
BY_DELAY = (
    Column("task", left=True), Column("delay_ms", "delay, ms", show="{:g}".format), Column("value", decimals=2),
    Column(("low", "high"), "95 % CI", 2),
)  # fmt: skip
BY_CROSSOVER = (
    Column("task", left=True), Column("crossover_hz", "crossover, Hz", show="{:g}".format),
    Column("value", decimals=2), Column(("low", "high"), "95 % CI", 2),
)  # fmt: skip
FACTORS, DELAYS, CROSSOVER = "factors", "delays", "crossover"
"""The planned tests of what of a stimulus carries the quality."""


def _factor_words(task: TaskComparisons) -> str:
    """Return in a sentence what a doubling of each factor adds, and which of the first two adds more."""
    if (found := task.factors) is None:
        return "the protocol has neither two factors nor two stated numbers that vary across stimuli."
    if not found.factors:
        return f"there is no scale of factors: {found.statement}."
    each = [f"{_change(of)} adds {_adds(of.doubling or of.across)}" for of in found.factors]
    said = f"in logits, {', '.join(each)}"
    if found.apart is None:
        return f"{said}."
    one, other = (_quantity(of.name) for of in found.factors[:2])
    return f"{said}; a doubling of {one} adds {_adds(found.apart)} more than one of {other}."


def _change(of: Factor) -> str:
    """Return which change of a factor is stated: a doubling, or from end to end where it has none."""
    if of.doubling is None:
        return f"{of.name} from {of.levels[0]:g} to {of.levels[-1]:g}"
    return f"a doubling of {_quantity(of.name)}"


def _adds(one: Estimate) -> str:
    return f"{number(one.value, 2)} ({interval(one, 2)})"


def _quantity(key: str) -> str:
    """Return a number's key, in a word where there is one: a doubling has no unit."""
    return {"amplitude_m_s2": "amplitude", "frequency_hz": "frequency"}.get(key, key)


def factors(results: Compared, stands: Standing) -> tuple[Section, ...]:
    """Return the scales by factor, where stimuli have any."""
    known = [(task, task.factors) for task in results.tasks if task.factors is not None]
    tables = []
    for task, found in known:
        records: list[Record] = [
            {"task": task.task.id, "factor": of.name, "level": level, "value": one.value, **ends(one),
             "doubling": of.doubling.value if of.doubling else None, **ends(of.doubling, "doubling_"),
             "across": of.across.value, **ends(of.across, "across_")}
            for of in found.factors
            for level, one in zip(of.levels, of.effects, strict=True)
        ]  # fmt: skip
        notes = [
            "In logits, relative to each factor's lowest level. Effects of doubling and of the whole range come from a "
            "line in octaves, or in the level itself if any is 0 or below. Intervals are across participants."
        ]
        if found.p is not None:
            notes.append(
                f"A separate value for each material fits better than the sum of factors ({p_is(found.p)}, treating "
                "answers as independent)."
            )
        notes += filter(None, (REDUCED if found.reduced else "", found.statement))
        title, mark = f"{task.task.title}: by factor", stands.mark(FACTORS, task.task.id)
        tables.append(tabulate(title, BY_FACTOR, records, notes, standing=mark))
    if not known:
        return ()
    said = tuple(f"{task.task.id}: {_factor_words(task)}" for task, _ in known)
    return (Section("factors", f"Factors of {results.quality}", said, tuple(tables)),)


def _delay_words(task: TaskComparisons) -> str:
    """Return in sentences what a vibration further from the touch adds, and which delay is just noticed."""
    if (found := task.delays) is None:
        return "the protocol does not state different delays."
    if not found.sides:
        return f"there is no scale of delays: {found.statement}."
    return " ".join(map(_side_words, found.sides))


def _side_words(side: Side) -> str:
    name = "earlier" if side.early else "later"
    said = f"{STEP_MS:g} ms {name} adds {number(side.slope.value, 2)} logits ({interval(side.slope, 2)})"
    if side.noticed_high_ms is None or side.noticed_ms is None or side.noticed_low_ms is None:
        return f"{said}; no just noticeable delay can be determined."
    within = f"{side.noticed_low_ms:.0f} to {side.noticed_high_ms:.0f} ms"
    return f"{said}; {side.noticed_ms:.0f} ms {name} is just noticeable (95 % CI {within})."


def delays(results: Compared, stands: Standing) -> tuple[Section, ...]:
    """Return what each delay adds, where surfaces have delays."""
    known = [(task, task.delays) for task in results.tasks if task.delays is not None]
    tables = []
    for task, found in known:
        records: list[Record] = [
            {"task": task.task.id, "delay_ms": delay_ms, "value": one.value, **ends(one)}
            for delay_ms, one in zip(found.delays_ms, found.effects, strict=True)
        ]
        notes = ["In logits, relative to the delay nearest the touch. Intervals are across participants."]
        if found.p is not None:
            notes.append(
                "A separate value for each delay fits better than a line on each side of the touch "
                f"({p_is(found.p)}, treating answers as independent)."
            )
        notes += filter(None, (REDUCED if found.reduced else "", found.statement))
        mark = stands.mark(DELAYS, task.task.id)
        tables.append(tabulate(f"{task.task.title}: by delay", BY_DELAY, records, notes, standing=mark))
    if not known:
        return ()
    said = tuple(f"{task.task.id}: {_delay_words(task)}" for task, _ in known)
    return (Section("delays", f"Delays and {results.quality}", said, tuple(tables)),)


def _crossover_words(task: TaskComparisons) -> str:
    """Return in a sentence which crossover is best, and how sure that is."""
    if (found := task.crossover) is None:
        return "the protocol states fewer than three different crossovers."
    if (bend := found.bend) is None:
        return f"there is no scale of crossovers: {found.statement}."
    bent = f"the fitted parabola falls {number(bend.value, 2)} logits ({interval(bend, 2)}) one octave from its peak"
    if found.best_hz is None:
        return f"{bent}; none of these crossovers is best."
    if found.best_low_hz is None and found.best_high_hz is None:
        return f"{bent}; its peak is at {found.best_hz:.3g} Hz, without an interval."
    low, high = ("open" if end is None else f"{end:.3g}" for end in (found.best_low_hz, found.best_high_hz))
    return f"{found.best_hz:.3g} Hz is best (95 % CI {low} to {high} Hz); {bent}."


def crossovers(results: Compared, stands: Standing) -> tuple[Section, ...]:
    """Return what each crossover adds, where surfaces have crossovers."""
    known = [(task, task.crossover) for task in results.tasks if task.crossover is not None]
    tables = []
    for task, found in known:
        records: list[Record] = [
            {"task": task.task.id, "crossover_hz": hz, "value": one.value, **ends(one)}
            for hz, one in zip(found.crossovers_hz, found.effects, strict=True)
        ]
        notes = ["In logits, relative to the lowest crossover. Intervals are across participants."]
        if found.p is not None:
            notes.append(
                f"A separate value for each crossover fits better than a parabola in octaves ({p_is(found.p)}, "
                "treating answers as independent)."
            )
        notes += filter(None, (REDUCED if found.reduced else "", found.statement))
        mark = stands.mark(CROSSOVER, task.task.id)
        tables.append(tabulate(f"{task.task.title}: by crossover", BY_CROSSOVER, records, notes, standing=mark))
    if not known:
        return ()
    said = tuple(f"{task.task.id}: {_crossover_words(task)}" for task, _ in known)
    return (Section("crossover", f"Crossovers and {results.quality}", said, tuple(tables)),)


WORDS: Mapping[str, Callable[[TaskComparisons], str]] = {
    FACTORS: _factor_words,
    DELAYS: _delay_words,
    CROSSOVER: _crossover_words,
}
"""What each planned test of these says of a task."""
