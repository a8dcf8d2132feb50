"""Identification -> sections: intervals, what confusions say, models of single trials, the course of the tasks."""

import math
import statistics
from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from palpate.analysis.documents.tables import (
    Column,
    Record,
    Section,
    Table,
    bounds,
    count_of,
    ends,
    joined,
    number,
    p_is,
    plural,
    probability,
    side_by_side,
    span,
    tabulate,
    without_keys,
)
from palpate.analysis.identification.identify import CHOICE_RESAMPLES, ChoiceIntervals, Identification
from palpate.analysis.identification.results import Results
from palpate.analysis.identification.time_course import WINDOW, TimeCourse
from palpate.analysis.identification.trial_models import Term, TrialLevel, TrialModel
from palpate.analysis.report.answers import misfit_words
from palpate.analysis.report.plan import ABOUT
from palpate.analysis.statistics.participants import Jackknife
from palpate.analysis.statistics.shares import Limits

INTERVALS = (
    Column("presented", left=True), Column("answered", left=True), Column(("count", "trials"), "count", show=count_of),
    Column("ratio"), Column(("wilson_low", "wilson_high"), "Wilson"),
    Column(("clopper_pearson_low", "clopper_pearson_high"), "Clopper-Pearson"),
    Column(("low", "high"), "across participants", show=lambda *limits: bounds(Limits(*limits))),
    Column(("any_low", "any_high"), "any population", show=lambda *limits: bounds(Limits(*limits))),
)  # fmt: skip


def intervals_section(results: Results) -> Section:
    """Return every ratio with its intervals."""
    tables, brief = [], []
    for task, found in zip(results.tasks, results.identifications, strict=True):
        records: list[Record] = [
            {"task": found.task, "presented": cell.presented, "answered": cell.answered, "count": cell.count,
             "trials": cell.trials, "ratio": cell.count / cell.trials if cell.trials else None,
             **ends(cell.wilson, "wilson_"), **ends(cell.clopper_pearson, "clopper_pearson_"),
             **ends(cell.interval), **ends(cell.any_population, "any_"), "statement": cell.statement}
            for cell in found.cells
        ]  # fmt: skip
        missing = {cell.statement: cell for cell in found.cells[::-1] if cell.statement}
        notes = [
            f"Some have no interval across participants, such as {cell.presented} answered as {cell.answered}: {why}."
            for why, cell in missing.items()
        ]
        tables.append(tabulate(task.task.title, INTERVALS, records, notes))
        right = [record for record in records if record["presented"] == record["answered"]]
        where = "The report and intervals.csv give all answers."
        brief.append(tabulate(f"{task.task.title}: correct answers", INTERVALS, right, (*notes, where)))
    about = ABOUT["intervals"].substitute()
    return Section("intervals", "Intervals of the answer ratios", (about,), tuple(tables), brief=tuple(brief))


def confusions_section(results: Results, materials: tuple[str, ...]) -> Section:
    """Return information, d', the similarity-choice model, and confusion against dissimilarity."""
    found = results.identifications
    quantities = {one.task: _quantities(one, materials) for one in found}
    tables = (
        _information(found, quantities),
        _detection(found),
        *(_choice(one.task, one.choice, materials) for one in found if one.choice),
        _scaling(found),
        _mantel(found, results.dissimilarities.source),
    )
    names = {
        "information": "The information", "information interval": "The interval for the information", "d'": "The d'",
        "choice": "The similarity-choice model", "lapses": "The bias and lapse model", "scaling": "The map",
        "mantel": "Mantel's test", "joined": "What needs a participant's answers to several materials",
    }  # fmt: skip
    missing: dict[tuple[str, str], list[str]] = {}
    for one in found:
        for key, reason in one.statements.items():
            missing.setdefault((key, reason), []).append(one.task)
    reasons = tuple(f"{names[key]} is not defined for {joined(of)}: {why}." for (key, why), of in missing.items())
    # The records stand by task, not by table.
    shown = tuple(replace(table, records=()) for table in tables if table.rows)
    records = tuple(record for task in quantities.values() for record in task)
    return Section("confusions", "Information, d', similarity and bias", reasons, shown, records)


TASK = Column("task", left=True)
JACKKNIFE = "information, jackknife (companion)"
INFORMATION = (
    TASK, Column("trials"), Column("entropy presented", "presented"), Column("information, bits", "transmitted"),
    Column("information, Miller-Madow", "Miller-Madow"), Column("information, Panzeri-Treves", "Panzeri-Treves"),
    Column(JACKKNIFE, "jackknife (companion)"), Column((f"{JACKKNIFE}_low", f"{JACKKNIFE}_high"), "95 % CI"),
)  # fmt: skip


def _information(found: tuple[Identification, ...], quantities: Mapping[str, list[Record]]) -> Table:
    notes = [ABOUT["information"].substitute()]
    records: list[Record] = []
    for one in found:
        if (bits := one.information) is None:
            continue
        of_all = side_by_side(record for record in quantities[one.task] if not record["of"])[0]
        missing = {JACKKNIFE: None, **ends(None, f"{JACKKNIFE}_")}
        records.append({"task": one.task, "trials": bits.trials, **missing, **of_all})
        if max(bits.miller_madow, bits.panzeri_treves) > bits.presented:
            notes.append(
                f"{one.task}: a corrected value is above the bits presented, which is impossible; the correction "
                "overshoots when each material receives few different answers."
            )
        if min(bits.miller_madow, bits.panzeri_treves) < 0:
            notes.append(f"{one.task}: a corrected value is below 0, which is impossible.")
    return tabulate("Information, bits a trial", INFORMATION, records, notes)


def _among(values: Sequence[float]) -> str:
    """Return the mean and the SD of the values of participants."""
    if not values:
        return "-"
    spread = f" ± {statistics.stdev(values):.2f}" if len(values) > 1 else ""
    return f"{statistics.mean(values):.2f}{spread}"


DETECTION = (
    TASK, Column("alternatives", "m"), Column("correct"), Column("d'", decimals=2),
    Column(("low", "high"), "95 % CI", show=lambda *limits: bounds(Limits(*limits), 2)),
    Column("each", "among participants", show=_among),
)  # fmt: skip


def _detection(found: tuple[Identification, ...]) -> Table:
    records: list[Record] = []
    notes = []
    for one in found:
        if (d := one.detection) is None:
            continue
        records.append(
            {"task": one.task, "alternatives": d.alternatives, "correct": d.proportion, "d'": d.d_prime,
             **ends(d.interval), "each": tuple(d.by_participant.values())}
        )  # fmt: skip
        if d.statement:
            notes.append(f"{one.task}: {d.statement}.")
        if d.moved:
            notes.append(f"{one.task}: proportions of 0 or 1 were moved inward by half a trial: {', '.join(d.moved)}.")
    notes.append("This d' of m-alternative identification assumes unbiased answers and equally spaced materials.")
    return tabulate("d'", DETECTION, records, notes)


def _estimate(value: float, limits: NDArray[np.float64] | None) -> Record:
    """Return an estimate with its interval, (2,) or None, as values of a record."""
    low, high = (None, None) if limits is None else limits.tolist()
    return {"value": float(value), "low": low, "high": high}


def _similarity(fitted: ChoiceIntervals, i: int, j: int) -> Record:
    limits = None if fitted.similarities is None else fitted.similarities[i, j]
    return _estimate(fitted.model.similarities[i, j], limits)


def _biases(fitted: ChoiceIntervals) -> list[Record]:
    """Return the bias to each material, none where they are not defined."""
    if (biases := fitted.model.biases) is None:
        return []
    limits = [None] * len(biases) if fitted.biases is None else fitted.biases
    return list(map(_estimate, biases, limits))


def _shown(estimate: Record | None) -> str:
    """Return an estimate with its interval in brackets, or `-` for None."""
    if estimate is None:
        return "-"
    limits = "" if estimate["low"] is None else f" ({span(estimate['low'], estimate['high'])})"
    return f"{number(estimate['value'])}{limits}"


def _choice(task: str, fitted: ChoiceIntervals, materials: tuple[str, ...]) -> Table:
    model = fitted.model
    biases: Sequence[Record | None] = _biases(fitted) or [None] * len(materials)
    records: list[Record] = [
        {"material": first, **{f"to {second}": _similarity(fitted, i, j) for j, second in enumerate(materials[:i])},
         f"to {first}": None, "bias": biases[i]}
        for i, first in enumerate(materials)
    ]  # fmt: skip
    columns = (
        Column("material", "", left=True),
        *(Column(f"to {name}", name, show=lambda of: "1" if of is None else _shown(of)) for name in materials),
        Column("bias", show=_shown),
    )
    tested = f"G² = {model.g2:.2f}, {model.df} df{f'; {misfit_words(fitted.misfit)}' if fitted.misfit else ''}"
    bracketed = f" Brackets show 95 % percentile intervals from {CHOICE_RESAMPLES} resamples of participants."
    resampled = fitted.similarities is not None or fitted.biases is not None
    notes = [f"Test of the fit: {tested}.{bracketed * resampled} Trials without an answer are left out."]
    if fitted.statement:
        notes.append(f"{fitted.statement}." if resampled else f"There are no intervals: {fitted.statement}.")
    if model.biases is None:
        notes.append("The biases are not defined, because some groups of materials were never confused.")
    return tabulate(f"{task}: similarity-choice model, similarities and biases", columns, records, notes)


def _percent(share: float) -> str:
    return f"{100 * share:.0f} %"


SCALING = TASK, Column("explained", "in two dimensions", show=_percent), Column("negative", show=_percent)


def _scaling(found: tuple[Identification, ...]) -> Table:
    records: list[Record] = [
        {"task": one.task, "explained": one.scaling.explained, "negative": one.scaling.negative}
        for one in found
        if one.scaling
    ]
    notes = (
        "The map is the classical scaling of 1 - (p_ij + p_ji) / (p_ii + p_jj). The columns give the two axes' "
        "share of the positive eigenvalues, and the negative eigenvalues' share of all eigenvalues.",
    )
    return tabulate("Map of the materials", SCALING, records, notes)


MANTEL = (
    TASK, Column("pairs"), Column("r"), Column("orders"),
    Column("p_less", "P, fewer confusions", show=partial(probability, decimals=4)),
    Column("p_two", "P, two-sided", show=partial(probability, decimals=4)),
)  # fmt: skip


def _mantel(found: tuple[Identification, ...], source: str) -> Table:
    records: list[Record] = [{"task": one.task, **asdict(one.mantel)} for one in found if one.mantel]
    notes = (ABOUT["Mantel"].substitute(source=source),)
    return tabulate("Confusion against dissimilarity (Mantel's test)", MANTEL, records, notes)


def _quantities(one: Identification, materials: tuple[str, ...]) -> list[Record]:
    """Return a record of each number of a task."""
    records: list[Record] = []

    def add(quantity: str, value: float | None, limits: Limits | Jackknife | None = None, of: str = "") -> None:
        records.append({"task": one.task, "quantity": quantity, "of": of, "value": value, **ends(limits)})

    if bits := one.information:
        add("information, bits", bits.transmitted)
        add("information, Miller-Madow", bits.miller_madow)
        add("information, Panzeri-Treves", bits.panzeri_treves)
        add("entropy presented", bits.presented)
        if one.jackknife:
            add(JACKKNIFE, one.jackknife.value, one.jackknife)
    if d := one.detection:
        add("d'", d.d_prime, d.interval)
        for label, value in d.by_participant.items():
            add("d'", value, of=f"sub-{label}")
    if fitted := one.choice:
        biases = _biases(fitted)
        for i, first in enumerate(materials):
            for j, second in enumerate(materials[i + 1 :], i + 1):
                of = f"{first}, {second}"
                records.append({"task": one.task, "quantity": "similarity", "of": of, **_similarity(fitted, i, j)})
            if biases:
                records.append({"task": one.task, "quantity": "bias", "of": first, **biases[i]})
        add("choice model, G2", fitted.model.g2, of=f"{fitted.model.df} df")
        if astray := fitted.misfit:
            add("choice model, F", astray.f, of=f"{astray.df1} and {astray.df2} df")
            add("choice model, P", astray.p)
    if one.scaling:
        for material, (x, y) in zip(materials, one.scaling.points.tolist(), strict=True):
            add("map, first axis", x, of=material)
            add("map, second axis", y, of=material)
    if test := one.mantel:
        add("Mantel r", test.r, of=f"{test.pairs} pairs, {'exact' if test.exact else 'random orders'}")
        add("Mantel P, fewer confusions", test.p_less, of=f"{test.orders} orders")
        add("Mantel P, two-sided", test.p_two, of=f"{test.orders} orders")
    return records


def trials_section(results: Results) -> Section:
    """Return both models of single trials, one below the other."""
    found = results.trials
    paragraphs = (
        "These models predict whether each answer was right. They allow for correlation among one participant's "
        "trials across tasks. Each odds ratio is for the change that its term names.",
        *(f"The models do not use the term '{name}': {why}." for name, why in found.absent.items()),
        *_left_out(found),
        *(f"The {name} could not be fitted: {why}." for name, why in found.statements.items()),
    )
    models = (
        ("GEE logit", "", "within-participant correlation", found.gee),
        ("mixed logit", ", with a random intercept for each participant", "SD of the random intercepts", found.mixed),
    )
    tables = tuple(
        _model_table(name, more, spread, model, GEE if model is found.gee else MIXED)
        for name, more, spread, model in models
        if model is not None
    )
    return Section("trials", "Single trials", paragraphs, tables)


def _left_out(found: TrialLevel) -> list[str]:
    if not found.left_out:
        return []
    by_task = ", ".join(f"{count} in {task}" for task, count in found.left_out.items())
    who = f"; no trials remain for participants {', '.join(found.gone)}" if found.gone else ""
    trials = plural(sum(found.left_out.values()), "trial")
    return [f"The models leave out {trials} that lack at least one of the values used ({by_task}){who}."]


GEE = (
    "The {spread} is {value:.3f}. The standard errors are Kauermann and Carroll's. F is Hotelling's. It rejected a "
    "true null in 4 to 6 % of SIMULATED studies of 6 to 25 participants (nominal: 5 %). Treated as chi-squared, "
    "tests of four materials did so in 19 to 20 % with 10 participants."
)
MIXED = (
    "The {spread} is {value:.2f}. The fit is by maximum likelihood. The odds are those of one participant. The more "
    "participants differ, the farther these are from 1 than the population's odds. P for material and task is valid "
    "only if participants differ only in level: when they also differed by material and task, these tests rejected "
    "a true null in 25 to 47 % of SIMULATED studies (nominal: 5 %). The logit model with the ANOVA allows for that."
)
ODDS = (
    Column("term", left=True), Column("log_odds", "odds ratio", show=lambda odds: number(math.exp(odds), 2)),
    Column(("low", "high"), "95 % CI", show=lambda low, high: span(math.exp(low), math.exp(high), 2)),
    Column("p", "P", show=probability),
)  # fmt: skip


def _model_table(name: str, more: str, spread: str, model: TrialModel, about: str) -> Table:
    records: list[Record] = [
        {"model": name, "term": one.name, "log_odds": one.estimate, "se": one.error, "low": one.low, "high": one.high,
         "p": one.p}
        for one in model.coefficients
    ]  # fmt: skip
    tests: list[Record] = [
        {"model": name, "term": term.name, "chi2" if term.df2 is None else "f": term.statistic, "df": term.df,
         "df2": term.df2, "p": term.p}
        for term in model.terms
    ]  # fmt: skip
    notes = (
        f"Wald tests: {'; '.join(map(_tested, model.terms))}.",
        about.format(spread=spread, value=model.spread),
        *(f"statsmodels warned during the fit: {said}." for said in model.warned),
    )
    title = f"{name[0].upper()}{name[1:]}{more}: {model.trials} trials of {model.participants} participants"
    last = {"model": name, "term": spread, "value": model.spread}
    return replace(tabulate(title, ODDS, records, notes), records=(*records, *tests, last))


def _tested(term: Term) -> str:
    """Return Wald's test of a term in words."""
    name, df = ("chi2", f"{term.df}") if term.df2 is None else ("F", f"{term.df}, {term.df2}")
    return f"{term.name}: {name}({df}) = {term.statistic:.2f}, {p_is(term.p)}"


def course_section(found: TimeCourse) -> Section:
    """Return tables of what the dataset holds, and a statement on each thing that it lacks."""
    paragraphs = [ABOUT["course"].substitute(window=WINDOW)] * bool(found.learning or found.speed)
    lacking: dict[tuple[str, str], list[str]] = {}
    for (task, what), why in found.statements.items():
        lacking.setdefault((what, why), []).append(task)
    paragraphs += [f"The dataset gives no {what} for {' and '.join(of)}: {why}." for (what, why), of in lacking.items()]
    for task, windows in found.learning.items():
        reasons = dict.fromkeys(one.statement for one in windows if one.statement)
        paragraphs += [f"Some runs of trials of {task} have no interval: {why}." for why in reasons]
    tables = (_learning_table(found), _speed_table(found), _onsets(found), _timing(found), _masker(found))
    missing: tuple[Record, ...] = tuple(
        {"task": task, "quantity": what, "statement": f"n/a: {why}"} for (task, what), why in found.statements.items()
    )
    shown = tuple(table for table in tables if table.rows)
    return Section("course", "Course of the tasks", tuple(paragraphs), shown, missing)


RIGHT = (
    Column(("right", "trials"), "right", show=count_of), Column("value", "ratio"), Column(("low", "high"), "95 % CI"),
)  # fmt: skip
RUNS = (TASK, Column(("from", "to"), "trials", show="{} to {}".format), *RIGHT)
SPEEDS = (
    TASK, Column(("from", "to"), "speed (mm/s)", show="{:g} to {:g}".format), Column("mean_mm_s", "mean", 0), *RIGHT,
)  # fmt: skip
ONSETS = (
    TASK, Column("trials"), Column("value", "mean (ms)"), Column("sd", "SD (ms)"),
    Column("largest_ms", "largest, either way (ms)"),
)  # fmt: skip
TIMING = (
    TASK, Column("of", "what", left=True), Column("trials", "attempts"), Column("value", "median (ms)"),
    Column("sd", "SD (ms)"), Column("p99"), Column("p99.9"), Column("largest"),
)  # fmt: skip
MASKER = (TASK, Column("participants"), Column("median", decimals=1), Column(("low", "high"), "range", 1))


def _learning_table(found: TimeCourse) -> Table:
    every: list[Record] = []
    shown: list[Record] = []
    for task, windows in found.learning.items():
        records: list[Record] = [
            {"task": task, "quantity": "right in a run of trials", "from": one.first, "to": one.last,
             "value": one.right / one.trials, "right": one.right, "trials": one.trials, **ends(one.interval),
             "statement": one.statement}
            for one in windows
        ]  # fmt: skip
        every += records
        shown += [records[place] for place in sorted({0, len(windows) // 2, len(windows) - 1})]
    title = "Proportion correct in the first, the middle and the last run of trials"
    return replace(tabulate(title, RUNS, shown), records=without_keys(every, {"right"}))


def _speed_table(found: TimeCourse) -> Table:
    records: list[Record] = [
        {"task": task, "quantity": "right at speeds, mm/s", "from": one.low_mm_s, "to": one.high_mm_s,
         "mean_mm_s": one.mean_mm_s, "value": one.right / one.trials, "right": one.right, "trials": one.trials,
         **ends(one.interval)}
        for task, bins in found.speed.items() for one in bins
    ]  # fmt: skip
    return tabulate("Proportion correct by foot speed", SPEEDS, records, in_print={"mean_mm_s", "right"})


def _onsets(found: TimeCourse) -> Table:
    records: list[Record] = [
        {"task": task, "quantity": "onset minus contact, ms", "trials": len(one.errors_ms), "value": one.mean_ms,
         "sd": one.sd_ms, "largest_ms": one.largest_ms}
        for task, one in found.onsets.items()
    ]  # fmt: skip
    notes = [
        f"In {task}, the stimulus was planned to begin {ms:g} ms before contact, so {-ms:g} ms is on time."
        for task, ms in found.ahead_ms.items()
    ]
    return tabulate("Measured onset minus contact", ONSETS, records, notes, in_print={"largest_ms"})


def _timing(found: TimeCourse) -> Table:
    records: list[Record] = [
        {"task": task, "of": one.quantity, "quantity": f"{one.quantity}, ms", "trials": one.attempts,
         "value": one.median_ms, "sd": one.sd_ms, "p99": one.p99_ms, "p99.9": one.p999_ms, "largest": one.largest_ms}
        for task, quantities in found.timing.items() for one in quantities
    ]  # fmt: skip
    notes = (
        "All attempts count, including repeated ones. p99, p99.9 and largest are magnitudes in ms; - means that there "
        "are too few attempts for a percentile.",
    )
    return tabulate("Timing", TIMING, records, notes, in_print={"of"})


def _masker(found: TimeCourse) -> Table:
    records: list[Record] = [
        {"task": task, "quantity": "masker, dB(A)", "of": f"sub-{one.participant}", "value": one.median_db_a,
         "low": one.low_db_a, "high": one.high_db_a}
        for task, levels in found.masker.items() for one in levels
    ]  # fmt: skip
    by_task: list[Record] = [
        {"task": task, "participants": len(levels), "median": statistics.median(one.median_db_a for one in levels),
         "low": min(one.low_db_a for one in levels), "high": max(one.high_db_a for one in levels)}
        for task, levels in found.masker.items()
    ]  # fmt: skip
    notes = ("The table shows the median of the participants' medians, and the lowest and highest level in any trial.",)
    return replace(tabulate("Masker, dB(A)", MASKER, by_task, notes), records=tuple(records))
