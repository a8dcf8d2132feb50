"""Models of single trials -> a section: odds of each term, and what could not be used.

Course of a study -> a section: right answers by speed and by trial number, onset errors, timing, masker levels.
"""

from __future__ import annotations

import math
import statistics
from collections.abc import Mapping

from analysis.documents.tables import Section, Table, interval, number, plural, probability
from analysis.identification.results import Results
from analysis.identification.time_course import WINDOW, TimeCourse
from analysis.identification.trial_models import TrialLevel, TrialModel
from analysis.statistics.intervals import RESAMPLES

HEADER = ("term", "odds ratio", "95 % CI", "P")


def trials_section(results: Results) -> Section:
    """Both models, one below the other."""
    found = results.trials
    paragraphs = (
        "Whether an answer was right, trial by trial. Odds ratios are per step that the term names; trials of one "
        "participant, in whatever task, count as alike.",
        *(f"Not in the models: {name}: {why}." for name, why in found.absent.items()),
        *_left_out(found),
        *(f"Not defined: {name}: {why}." for name, why in found.statements.items()),
    )
    tables = [table for table in (_gee(found), _mixed(found)) if table]
    records = [*_records("GEE logit", found.gee), *_records("mixed logit", found.mixed)]
    return Section("trials", "Single trials", paragraphs, tuple(tables), tuple(records))


def _left_out(found: TrialLevel) -> list[str]:
    if not found.left_out:
        return []
    by_task = ", ".join(f"{count} in {task}" for task, count in found.left_out.items())
    who = f"; nothing is left of the participants {', '.join(found.gone)}" if found.gone else ""
    trials = plural(sum(found.left_out.values()), "trial")
    return [f"Left out, without one of the values used: {trials} ({by_task}){who}."]


def _gee(found: TrialLevel) -> Table | None:
    if (model := found.gee) is None:
        return None
    notes = (
        _wald(model),
        f"Correlation within a participant: {model.spread:.3f}. Standard errors of Mancl and DeRouen.",
        *(f"statsmodels said on the way: {said}." for said in model.warned),
    )
    title = f"GEE logit: {model.trials} trials of {model.participants} participants"
    return Table(title, HEADER, _rows(model), notes=notes)


def _mixed(found: TrialLevel) -> Table | None:
    if (model := found.mixed) is None:
        return None
    notes = (
        _wald(model),
        f"SD of the random intercepts: {model.spread:.2f}. Maximum likelihood; these are the odds of one participant, "
        "further from 1 than those of the population above, the more participants differ.",
    )
    title = f"Mixed logit, a random intercept a participant: {model.trials} trials"
    return Table(title, HEADER, _rows(model), notes=notes)


def _rows(model: TrialModel) -> tuple[tuple[str, ...], ...]:
    return tuple(
        (one.name, number(math.exp(one.estimate), 2), f"{math.exp(one.low):.2f} to {math.exp(one.high):.2f}",
         probability(one.p))
        for one in model.coefficients
    )  # fmt: skip


def _wald(model: TrialModel) -> str:
    tests = "; ".join(f"{t.name}: chi2({t.df}) = {t.chi2:.2f}, P = {probability(t.p)}" for t in model.terms)
    return f"Wald tests: {tests}."


def _records(kind: str, model: TrialModel | None) -> list[Mapping[str, object]]:
    if model is None:
        return []
    records: list[Mapping[str, object]] = [
        {"model": kind, "term": one.name, "log_odds": one.estimate, "se": one.error, "low": one.low, "high": one.high,
         "p": one.p}
        for one in model.coefficients
    ]  # fmt: skip
    records += [{"model": kind, "term": t.name, "chi2": t.chi2, "df": t.df, "p": t.p} for t in model.terms]
    spread = "correlation within a participant" if kind.startswith("GEE") else "SD of the random intercepts"
    return [*records, {"model": kind, "term": spread, "value": model.spread}]


def course_section(found: TimeCourse) -> Section:
    """Tables of what there is, and a statement on what there is not."""
    paragraphs = [
        f"Share of right answers over all participants: in runs of {WINDOW} trials, with BCa intervals from "
        f"{RESAMPLES} resamples of whole participants; and by the speed of the foot, with Wilson's intervals, which "
        "take all trials as independent. Every run of trials stands in course.csv."
    ]
    paragraphs += [f"No {what}, {task}: {why}." for (task, what), why in found.statements.items()]
    for task, windows in found.learning.items():
        reasons = dict.fromkeys(one.statement for one in windows if one.statement)
        paragraphs += [f"No interval of some runs of trials, {task}: {why}." for why in reasons]
    tables = (_learning(found), _speed(found), _onsets(found), _timing(found), _masker(found))
    return Section(
        "course",
        "Course of the tasks",
        tuple(paragraphs if found.learning or found.speed else paragraphs[1:]),
        tuple(table for table in tables if table.rows),
        tuple(_course_records(found)),
    )


def _learning(found: TimeCourse) -> Table:
    rows = []
    for task, windows in found.learning.items():
        for one in dict.fromkeys((windows[0], windows[len(windows) // 2], windows[-1])):
            share = number(one.right / one.trials)
            rows.append((task, f"{one.first} to {one.last}", f"{one.right} of {one.trials}", share,
                         interval(one.interval)))  # fmt: skip
    header = ("task", "trials", "right", "ratio", "95 % CI")
    return Table("Right answers in the first, the middle and the last run of trials", header, tuple(rows))


def _speed(found: TimeCourse) -> Table:
    rows = tuple(
        (task, f"{one.low_mm_s:g} to {one.high_mm_s:g}", number(one.mean_mm_s, 0), f"{one.right} of {one.trials}",
         number(one.right / one.trials), interval(one.interval))
        for task, bins in found.speed.items() for one in bins
    )  # fmt: skip
    header = ("task", "speed (mm/s)", "mean", "right", "ratio", "95 % CI")
    return Table("Right answers by the speed of the foot", header, rows)


def _onsets(found: TimeCourse) -> Table:
    rows = tuple(
        (task, str(len(one.errors_ms)), number(one.mean_ms), number(one.sd_ms), number(one.largest_ms))
        for task, one in found.onsets.items()
    )
    header = ("task", "trials", "mean (ms)", "SD (ms)", "largest, either way (ms)")
    return Table("Measured onset minus contact", header, rows)


def _timing(found: TimeCourse) -> Table:
    rows = tuple(
        (task, one.quantity, str(one.attempts),
         *map(number, (one.median_ms, one.sd_ms, one.p99_ms, one.p999_ms, one.largest_ms)))
        for task, quantities in found.timing.items() for one in quantities
    )  # fmt: skip
    header = ("task", "what", "attempts", "median (ms)", "SD (ms)", "p99", "p99.9", "largest")
    notes = (
        "All attempts, those that were done again among them; p99, p99.9 and largest: either way, in ms; - : too few.",
    )
    return Table("Timing", header, rows, left=frozenset({0, 1}), notes=notes)


def _masker(found: TimeCourse) -> Table:
    rows = tuple(
        (task, str(len(levels)), number(statistics.median(one.median_db_a for one in levels), 1),
         f"{min(one.low_db_a for one in levels):.1f} to {max(one.high_db_a for one in levels):.1f}")
        for task, levels in found.masker.items()
    )  # fmt: skip
    notes = ("Median of the participants' medians; lowest and highest level of any trial.",)
    return Table("Masker, dB(A)", ("task", "participants", "median", "range"), rows, notes=notes)


def _course_records(found: TimeCourse) -> list[Mapping[str, object]]:
    records: list[Mapping[str, object]] = []
    for task, windows in found.learning.items():
        records += [
            {"task": task, "quantity": "right in a run of trials", "from": one.first, "to": one.last,
             "value": one.right / one.trials, "trials": one.trials, "low": one.interval.low if one.interval else None,
             "high": one.interval.high if one.interval else None, "statement": one.statement}
            for one in windows
        ]  # fmt: skip
    for task, bins in found.speed.items():
        records += [
            {"task": task, "quantity": "right at speeds, mm/s", "from": one.low_mm_s, "to": one.high_mm_s,
             "value": one.right / one.trials, "trials": one.trials, "low": one.interval.low, "high": one.interval.high}
            for one in bins
        ]  # fmt: skip
    for task, errors in found.onsets.items():
        about = {"task": task, "quantity": "onset minus contact, ms", "trials": len(errors.errors_ms)}
        records.append({**about, "value": errors.mean_ms, "sd": errors.sd_ms})
    for task, quantities in found.timing.items():
        records += [
            {"task": task, "quantity": f"{one.quantity}, ms", "trials": one.attempts, "value": one.median_ms,
             "sd": one.sd_ms, "p99": one.p99_ms, "p99.9": one.p999_ms, "largest": one.largest_ms}
            for one in quantities
        ]  # fmt: skip
    for task, levels in found.masker.items():
        records += [
            {"task": task, "quantity": "masker, dB(A)", "of": one.participant, "value": one.median_db_a,
             "low": one.low_db_a, "high": one.high_db_a}
            for one in levels
        ]  # fmt: skip
    records += [
        {"task": task, "quantity": what, "statement": f"n/a: {why}"} for (task, what), why in found.statements.items()
    ]
    return records
