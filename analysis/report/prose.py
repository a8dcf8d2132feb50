"""Sections -> the paragraphs of a paper: methods and results in the form of the APA, each number with its row.

Numbers follow the Publication Manual of the American Psychological Association (7th ed., sections 6.36 to 6.44): none
that cannot exceed 1 has a zero before its point. Every sentence ends with the file and the line that have its numbers.
"""

from __future__ import annotations

import textwrap
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

from palpate.analysis.documents.tables import Record, Section, joined, plural
from palpate.analysis.reading.study import Study
from palpate.analysis.report.answers import left_and_sure
from palpate.analysis.report.plan import EXPLORATORY
from palpate.experiment.records import software

CITED = "Braces give the file in the folder `tables` and the line in it; line 1 contains the headings."


@dataclass(frozen=True)
class Row:
    """A record with the file and the line where it stands."""

    file: str
    line: int
    record: Record

    def __str__(self) -> str:
        return f"{{{self.file} {self.line}}}"


Sections = Mapping[str, Sequence[Row]]
"""The rows of each file, by the slug of its section."""


def write_up(study: Study, sections: Sequence[Section], width: int) -> str:
    """Return the paragraphs for a terminal of this width."""
    rows = {
        section.slug: [Row(f"{section.slug}.csv", line, one) for line, one in enumerate(section.records, start=2)]
        for section in sections
    }
    label = [study.label] if study.label else []
    # Answers alone are what a design has whose sections give no sentence of a paper.
    found = _results(study, rows) if "found" in rows else (one.answer for part in sections for one in part.asked)
    procedure = (said for part in sections if part.slug == "procedure" for said in part.paragraphs)
    methods, results = " ".join((*_methods(study, rows), *procedure)), " ".join(dict.fromkeys(found))
    parts = [*label, "Methods", methods, "Results", results, CITED]
    return "\n\n".join(textwrap.fill(part, width, break_long_words=False, break_on_hyphens=False) for part in parts)


def _methods(study: Study, rows: Sections) -> Iterator[str]:
    for row in rows["overview"]:
        one = row.record
        chance = f", chance {bounded(one['chance'])}" if one.get("chance") is not None else ""
        silent = f", {one['without_answer']} without an answer" if one["without_answer"] else ""
        people, trials = plural(one["participants"], "participant"), plural(one["trials"], "trial")
        yield f"In {one['title']}, {people} completed {trials}{chance}{silent} {row}."
    yield from _touched(rows.get("touched", ()))
    yield left_and_sure(study, "The command palpate verify")
    for plan in dict.fromkeys(study.plans()):
        holm = "" if plan.correction is None else f", p Holm-adjusted across the {plan.correction}"
        yield f"Planned: {plan.test} of {joined(plan.tasks)} (alpha = {bounded(plan.alpha)}{holm})."
    if "intervals" in rows:
        yield (
            "Confidence intervals for proportions come from a beta-binomial distribution across participants, with "
            "a Jeffreys prior for the mean and a flat prior for the correlation. They were widened to be valid if "
            "participants are alike or very different. If one guessed and the others did well, the interval is "
            "Gaffke's with half a participant added; for a single participant, it is Clopper and Pearson's."
        )
    yield f"All analyses used palpate {software.this().version}."


def _touched(rows: Sequence[Row]) -> Iterator[str]:
    """Yield what the skin touched: a sentence of the apparatus, and one of each thing that was recorded."""
    parts = []
    for row in (row for row in rows if row.record["quantity"] == "contactor"):
        one = row.record
        stated = one["value"] if one.get("value") else f"{one['mean']:g} {one['unit']}"
        parts.append(f"{one['of']} {stated} {row}")
    if parts:
        yield f"Apparatus: {'; '.join(parts)}."
    for row in (row for row in rows if row.record["quantity"] == "number"):
        one = row.record
        unit, spread = f" {one['unit']}" if one["unit"] else "", "" if one["sd"] is None else f", SD = {one['sd']:.2f}"
        sessions = plural(one["sessions"], "session")
        yield f"{one['of'].capitalize()}: M = {one['mean']:.2f}{unit}{spread}, in {sessions} {row}."
    chosen = [row for row in rows if row.record["quantity"] == "choice"]
    for name in dict.fromkeys(row.record["of"] for row in chosen):
        counts = [
            f"{row.record['value']} in {plural(row.record['sessions'], 'session')} {row}"
            for row in chosen
            if row.record["of"] == name
        ]
        yield f"{name.capitalize()}: {', '.join(counts)}."


def _results(study: Study, rows: Sections) -> Iterator[str]:
    """Yield the planned tests in their order, or else all that were published; comparisons have their steps."""
    yield from map(_control, rows.get("control", ()))
    if "tests" not in rows:
        yield from map(_step, rows["found"])
        return
    published = ("t against chance", "one-way ANOVA", "two-way ANOVA", "ICC")
    everything = tuple(task.id for task in study.tasks)
    plans = [(plan.test, plan.tasks) for plan in dict.fromkeys(study.plans())] or [
        (name, everything) for name in published
    ]
    for test, tasks in plans:
        found = PUBLISHED[test](rows, tasks) if test in PUBLISHED else _planned(rows, test, tasks)
        yield from list(found) or [f"No result: {test} of {joined(tasks)}."] * (not list(_lacking(rows, test, tasks)))
        yield from _lacking(rows, test, tasks)


def _lacking(rows: Sections, test: str, tasks: Sequence[str]) -> Iterator[str]:
    """Yield each part of a test without a result, and why."""
    slug, kind = WHERE.get(test, ("planned", ""))
    for row in rows.get(slug, ()):
        one = row.record
        if not (why := one.get("statement")):
            continue
        of = one.get("task")
        if slug == "planned" and one["test"] == test and {*one["tasks"].split(", ")} <= {*tasks}:
            yield f"No result for {one['of']} ({test}): {why} {row}."
        elif slug == "tests" and of in tasks:
            yield f"No t-test for {one['material']} in {of}: {why} {row}."
        elif slug == "anova" and one["analysis"].startswith(kind) and (of in tasks or kind == "two-way"):
            yield f"No result for {joined(tasks) if of == 'all' else of} ({test}): {why} {row}."


def _against_chance(rows: Sections, tasks: Sequence[str]) -> Iterator[str]:
    tests = {(row.record["task"], row.record["material"]): row for row in rows["tests"]}
    for row in rows["found"]:
        one = row.record
        if one["quantity"] == "correct answer ratio" and one["task"] in tasks and one["value"] is not None:
            tested = tests[one["task"], one["of"]]
            chance = bounded(tested.record["chance"])
            parts = [f"M = {bounded(one['value'])} (chance {chance})", *_interval(one, 0.95)]
            if one["p"] is not None:
                parts.append(f"t({tested.record['df']}) = {one['statistic']:.2f}, {p_value(one['p'])}")
            if (p := one["p_sign_flip_ours"]) is not None:
                parts.append(f"exact sign-flip test, {p_value(p)}")
            yield f"In {one['task']}, {one['of']} was named correctly in {', '.join(parts)} {row} {tested}."


def _one_way(rows: Sections, tasks: Sequence[str]) -> Iterator[str]:
    for row in rows["anova"]:
        one = row.record
        if one["analysis"] == "one-way" and one["task"] in tasks and one.get("f") is not None:
            mark = "exploratory " if one["standing"] == EXPLORATORY else ""
            yield f"In {one['task']}, the {mark}one-way ANOVA of {one['of']} yielded {_f(row, rows)}."


def _two_way(rows: Sections, _: Sequence[str]) -> Iterator[str]:
    for row in rows["anova"]:
        if row.record["analysis"] == "two-way, type II" and row.record.get("f") is not None:
            yield f"In the two-way ANOVA (type II), the effect of {row.record['source']} had {_f(row, rows)}."
    for row in rows.get("beside", ()):
        if (one := row.record)["analysis"].startswith("paired tasks") and one["p"] is not None:
            parts = [f"M = {bounded(one['mean'])}", *_interval(one, 0.95), f"t({one['df']}) = {one['t']:.2f}"]
            parts += [p_value(one["p"]), f"exact sign-flip test, {p_value(one['p_sign_flip'])}"]
            yield f"For the {one['n']} participants who did both tasks, {one['task']} was {', '.join(parts)} {row}."


def _icc(rows: Sections, _: Sequence[str]) -> Iterator[str]:
    # The first is of all participants together.
    for row in [row for row in rows["icc"] if row.record["form"].startswith("variance-component")][:1]:
        if (one := row.record)["icc"] is not None:
            yield ", ".join([f"The {one['form']} ICC was {bounded(one['icc'])}", *_interval(one, 0.95)]) + f" {row}."


WHERE = {
    "t against chance": ("tests", ""), "one-way ANOVA": ("anova", "one-way"), "two-way ANOVA": ("anova", "two-way"),
    "ICC": ("icc", ""),
}  # fmt: skip
"""The section in which a published test says why it has no result, and the kind of its rows."""

PUBLISHED: Mapping[str, Callable[[Sections, Sequence[str]], Iterator[str]]] = {
    "t against chance": _against_chance,
    "one-way ANOVA": _one_way,
    "two-way ANOVA": _two_way,
    "ICC": _icc,
}
"""The sentences of each published test, by its name in a protocol."""


def _f(row: Row, rows: Sections) -> str:
    """Return F with both df; those of the residual stand in the next row of the same analysis without an F."""
    one = row.record
    rest = next(
        other for other in rows["anova"][rows["anova"].index(row) :] if other.record.get("source") == "residual"
    )
    size = f", partial η² = {bounded(one['partial_eta_squared'])}"
    limits = "".join(f", {part}" for part in _interval({"low": one["eta_low"], "high": one["eta_high"]}, 0.9))
    tested = f"F({one['df']}, {rest.record['df']}) = {one['f']:.2f}, {p_value(one['p'])}"
    return f"{tested}{size}{limits} {row} {rest}"


VERDICTS = {
    "sign flips against chance": ("was named correctly more often than chance", "was not shown to be above chance"),
    "equivalence": ("was shown to be equivalent within the margin", "was not shown to be equivalent within the margin"),
}
"""What a planned test shows, or does not, of its subject; of others, that it is significant."""


def _planned(rows: Sections, test: str, tasks: Sequence[str]) -> Iterator[str]:
    for row in rows.get("planned", ()):
        one = row.record
        if "p" not in one or one["test"] != test or not {*one["tasks"].split(", ")} <= {*tasks}:
            continue
        shown, other = VERDICTS.get(test, ("was significant", "was not significant"))
        parts = [] if one["value"] is None else [f"M = {bounded(one['value'])}"]
        parts += _interval(one, one["confidence"] or 0.95)
        if one["f"] is not None:
            parts.append(f"F({one['df']}) = {one['f']:.2f}")
        parts.append(p_value(one["p"] if one["p_holm"] is None else one["p_holm"]))
        subject = one["of"] or "the difference"
        verdict = shown if one["shown"] == "shown" else other
        yield f"In {one['tasks'].replace(', ', ' and ')}, {subject} {verdict} ({test}), {', '.join(parts)} {row}."


def _control(row: Row) -> str:
    """Return whether a control, where nothing could be felt, was at chance."""
    one = row.record
    shown = {"at chance": "was at chance", "above chance": "was above chance"}
    parts = [f"M = {bounded(one['share'])} (chance {bounded(one['chance'])})", *_interval(one, 0.95)]
    parts += [f"exact binomial, {p_value(one['p_binomial'])}", f"exact sign-flip test, {p_value(one['p_sign_flip'])}"]
    verdict = shown.get(one["verdict"], "was not shown to be at chance")
    margin = f" within {bounded(one['margin'])}" if one["verdict"] != "above chance" else ""
    return f"Identification in {one['task']}, a control of {one['of']}, {verdict}{margin}, {', '.join(parts)} {row}."


def _step(row: Row) -> str:
    """Return how often neighbours were told apart, and the step between them on their scale."""
    one = row.record
    share = "" if one["share"] is None else f" ({100 * one['share']:.0f}%)"
    parts = [f"In {one['task']}, {one['of']} was right in {one['right']} of {plural(one['trials'], 'trial')}{share}"]
    if one["step"] is not None:
        limits = "" if one["low"] is None else f", 95% CI [{one['low']:.2f}, {one['high']:.2f}]"
        parts.append(f"the {one['law'].title()} step was {one['step']:.2f}{limits}")
    return f"{', and '.join(parts)} {row}."


def _interval(one: Record, level: float) -> list[str]:
    """Return an interval, or its known end where the other is open, if there is any."""
    low, high, name = one.get("low"), one.get("high"), f"{100 * level:g}% CI"
    if low is not None and high is not None:
        return [f"{name} [{bounded(low)}, {bounded(high)}]"]
    if low is not None:
        return [f"{name} at least {bounded(low)}"]
    return [] if high is None else [f"{name} at most {bounded(high)}"]


def bounded(value: float | None) -> str:
    """Return a number that cannot exceed 1, to two decimals and without a zero before the point."""
    if value is None:
        return "-"
    text = f"{value:.2f}".removeprefix("-")
    minus = "−" if value < 0 and text != "0.00" else ""
    return f"{minus}{text.removeprefix('0')}"


def p_value(p: float) -> str:
    """Return `p = .017`, or `p < .001`."""
    return "p < .001" if p < 0.001 else f"p = {min(p, 1.0):.3f}".replace("= 0.", "= .")
