"""Models of single trials -> a section: odds of each term, and what could not be used."""

from __future__ import annotations

import math
from collections.abc import Mapping

from analysis.results import Results
from analysis.tables import Section, Table, number, probability
from analysis.trial_level import TrialLevel
from analysis.trial_models import TrialModel
from analysis.words import number_of

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
    trials = number_of(sum(found.left_out.values()), "trial")
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
