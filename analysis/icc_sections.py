"""Reliabilities -> a section: every ICC form under its names, and the variance-component form."""

from __future__ import annotations

from collections.abc import Mapping

from analysis.icc import NAMES
from analysis.results import ComponentReliability, Reliability, Results
from analysis.tables import Section, Table, number, probability

FEW = 10
"""Participants left out of a matrix, beyond whom a terminal counts the rest."""


def icc_section(results: Results) -> Section:
    """Every ICC form for every matrix, and the variance-component form."""
    header = ("Shrout-Fleiss", "McGraw-Wong", "ICC", "95 % CI", "F", "df1", "df2", "P")
    tables = [
        Table(table.matrix, header, _icc_rows(table), left=frozenset({0, 1}), notes=_icc_notes(table))
        for table in results.reliabilities
    ]
    brief = [_icc_brief(results)]
    records: list[Mapping[str, object]] = [
        {"matrix": table.matrix, "form": form.shrout_fleiss, "also": form.mcgraw_wong, "model": form.model,
         "icc": form.value, "f": form.f, "df1": form.df1, "df2": form.df2, "p": form.p, "low": form.low,
         "high": form.high, "statement": form.statement}
        for table in results.reliabilities if table.icc for form in table.icc.forms
    ]  # fmt: skip
    if results.components:
        tables.append(_components_table(results.components))
        brief.append(tables[-1])
        records += [
            {"matrix": "two-way ANOVA", "form": f"variance-component, k = {k}", "model": meaning, "icc": value}
            for k, meaning, value in results.components.by_k
        ]
    about = (
        "Targets are the cells, raters the participants. ICC(1,.) = ICC(1), ICC(k): one-way random. ICC(2,.) = "
        "ICC(A,.): two-way, absolute agreement. ICC(3,.) = ICC(C,.): two-way, consistency. The second names are McGraw "
        "and Wong's, whose random and mixed cases share these formulas. (.,1): a single participant; (.,k): the mean "
        "of k. Where all cells are targets, the ratios of one presented material add up to one: P and intervals are "
        "approximate."
    )
    missing = (f"No variance-component ICC: {results.two_way_statement}.",) * bool(results.two_way_statement)
    return Section("icc", "Intraclass correlations", (about, *missing), tuple(tables), tuple(records), tuple(brief))


def _icc_rows(reliability: Reliability) -> tuple[tuple[str, ...], ...]:
    forms = reliability.icc.forms if reliability.icc else ()
    return tuple(
        (f.shrout_fleiss, f.mcgraw_wong, number(f.value),
         "-" if f.low is None or f.high is None else f"{f.low:.3f} to {f.high:.3f}",
         number(f.f, 2), str(f.df1), str(f.df2), probability(f.p))
        for f in forms
    )  # fmt: skip


def _icc_notes(reliability: Reliability, most: int | None = None) -> tuple[str, ...]:
    of = reliability.task or "every task together"
    notes = [f"Not defined: {reliability.statement}."] * bool(reliability.statement)
    forms: dict[str, list[str]] = {}
    for form in reliability.icc.forms if reliability.icc else ():
        if form.statement and (most is None or form.value is None):
            forms.setdefault(form.statement, []).append(form.shrout_fleiss)
    notes += [f"{', '.join(names)}{f' of {of}' * (most is not None)}: {why}." for why, names in forms.items()]
    if who := reliability.dropped:
        lack = "a task or a material" if reliability.task is None else "a material"
        more = len(who[most:]) if most else 0
        named = ", ".join(who[:most]) + f" and {more} more, named in the report" * bool(more)
        notes.append(f"Left out of {of}, having had no trial of {lack}: {named}.")
    return tuple(notes)


def _icc_brief(results: Results) -> Table:
    names = tuple(NAMES)
    rows = tuple(
        (r.matrix, *(number(r.icc.form(name).value) if r.icc else "-" for name in names)) for r in results.reliabilities
    )
    notes = dict.fromkeys(note for r in results.reliabilities for note in _icc_notes(r, FEW))
    return Table("", ("matrix", *names), rows, notes=(*notes, "F, P and intervals stand in the report and in icc.csv."))


def _components_table(reliability: ComponentReliability) -> Table:
    c = reliability.components
    parts = zip((*c.names, "residual"), (c.first, c.second, c.interaction, c.residual), strict=True)
    estimates = ", ".join(f"{name} {value:.5f}" for name, value in parts)
    notes = [
        f"Components of variance (Henderson's method III): {estimates}. ICC = S / (S + residual / k), S the sum of the "
        "others."
    ]
    if c.negative:
        notes.append(f"Estimated below zero and taken as zero: {', '.join(c.negative)}.")
    if any(value is None for _, _, value in reliability.by_k):
        notes.append("Not defined: no component is above zero, so there is no variance to be a share of.")
    rows = tuple((str(k), number(value), meaning) for k, meaning, value in reliability.by_k)
    title = "Two-way ANOVA, task x material: variance-component ICC of the mean of k participants"
    return Table(title, ("k", "ICC", "k is"), rows, left=frozenset({2}), notes=tuple(notes))
