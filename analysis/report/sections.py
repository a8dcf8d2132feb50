"""Results -> sections: the tables as they are read, with the records behind them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import asdict

from analysis.audit.comparison import Comparison, comparison_section
from analysis.documents.tables import (
    Section,
    Table,
    bayes_factor,
    interval,
    lacks_a_limit,
    number,
    plural,
    probability,
)
from analysis.identification.results import ComponentReliability, Reliability, Results, TaskResult
from analysis.reading.study import Study, sentences
from analysis.report.identification_sections import course_section, identification_sections, trials_section
from analysis.statistics.anova import Anova, Effect
from analysis.statistics.icc import NAMES
from analysis.statistics.inference import EffectSize
from experiment.records.events import NO_ANSWER

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


MANY = 20
"""More exclusions than this are counted by rule in a terminal, and listed in the files."""


def sections(study: Study, results: Results, comparison: Comparison | None) -> tuple[Section, ...]:
    """Every section, in reading order."""
    compared = (comparison_section(study.origin, comparison),) if comparison else ()
    return (
        overview(study, results),
        exclusions_section(study),
        confusion_section(results),
        tests_section(results),
        *identification_sections(study, results),
        anova_section(results),
        icc_section(results),
        trials_section(results),
        course_section(results.course),
        *compared,
    )


def overview(study: Study, results: Results) -> Section:
    """What was analysed: participants and trials of each task, and the analysis that was planned."""
    records = [
        {
            "task": task.task.id,
            "title": task.task.title,
            "participants": len(task.confusion.participants),
            "trials": int(task.confusion.counts.sum()),
            "without_answer": task.confusion.unanswered,
            "chance": task.chance,
        }
        for task in results.tasks
    ]
    rows = tuple(
        (str(r["task"]), str(r["title"]), str(r["participants"]), str(r["trials"]), str(r["without_answer"]),
         f"{r['chance']:.4g}")
        for r in records
    )  # fmt: skip
    header = ("task", "title", "participants", "trials", "no answer", "chance")
    name = study.name.removeprefix(f"{study.label}: ")
    paragraphs = (
        f"{name}. Study {study.id}; {plural(len(study.participants), 'participant')} in the dataset.",
        *sentences(study),
    )
    return Section("overview", "Study", paragraphs, (Table("", header, rows, left=frozenset({0, 1})),), tuple(records))


def confusion_section(results: Results) -> Section:
    """Confusion matrices in the layout of Okamoto's Tables 1 and 2."""
    records: list[Mapping[str, object]] = []
    for task in results.tasks:
        matrix = task.confusion
        for i, presented in enumerate(matrix.materials):
            for j, answered in enumerate((*matrix.materials, NO_ANSWER)):
                records.append(
                    {
                        "task": task.task.id,
                        "presented": presented,
                        "answered": answered,
                        "participants": matrix.n(i),
                        "trials": int(matrix.trials[:, i].sum()),
                        "count": int(matrix.counts[:, i, j].sum()),
                        "mean": matrix.mean(i, j),
                        "sd": matrix.sd(i, j),
                        "stars": task.test(presented).result.stars if i == j else "",
                    }
                )
    return Section(
        "confusion", "Answer ratios", (), tuple(_confusion_table(task) for task in results.tasks), tuple(records)
    )


def tests_section(results: Results) -> Section:
    """Correct answers against chance."""
    tables, records = [], []
    for task in results.tasks:
        rows = []
        for test in task.tests:
            r = test.result
            rows.append(
                (test.material, str(r.n), number(r.mean), number(r.sd), number(r.t, 2), str(r.df), probability(r.p),
                 probability(test.p_holm), number(r.d, 2), interval(test.d, 2), bayes_factor(test.log_bf10), r.stars)
            )  # fmt: skip
            records.append(
                {"task": task.task.id, "material": test.material, "n": r.n, "mean": r.mean, "sd": r.sd,
                 "chance": r.chance, "t": r.t, "df": r.df, "p": r.p, "p_holm": test.p_holm, "cohens_d": r.d,
                 "d_low": test.d.low if test.d else None, "d_high": test.d.high if test.d else None,
                 "log_bf10": test.log_bf10, "stars": r.stars, "statement": r.statement}
            )  # fmt: skip
        notes = [f"{test.material}: {test.result.statement}." for test in task.tests if test.result.statement]
        notes += [
            f"{test.material}: no interval of d, the noncentral t cannot be computed so far out."
            for test in task.tests
            if lacks_a_limit(test.d)
        ]
        header = ("presented", "n", "mean", "SD", "t", "df", "P", "P (Holm)", "d", "95 % CI of d", "BF10", "")
        title = f"{task.task.title}: correct answers against chance, {task.chance:.4g}"
        tables.append(Table(title, header, tuple(rows), left=frozenset({0, 11}), notes=tuple(notes)))
    about = (
        "One-sample t-tests, two-tailed. Holm's correction is taken over the materials of a task; stars follow P; d is "
        "Cohen's. BF10 is the JZS Bayes factor, above 1 for a mean that differs from chance."
    )
    return Section("tests", "Tests against chance", (about,), tuple(tables), tuple(records))


def anova_section(results: Results) -> Section:
    """One-way ANOVA of confused materials; two-way ANOVA of correct ratios in types I to III."""
    header = ("source", "SS", "df", "MS", "F", "P", "partial η²", "90 % CI")
    one_way = [
        (pair.task, f"{' and '.join(pair.pair)} ({pair.chosen})", line)
        for pair in results.pairs
        for line in _lines(pair.anova)
    ]
    reasons = {f"{pair.task}, one-way": pair.statement for pair in results.pairs if pair.statement}
    reasons |= {f"{p.task}, one-way": p.anova.statement for p in results.pairs if p.anova and p.anova.statement}
    reasons |= {anova.kind: anova.statement for anova in results.two_way if anova.statement}
    two_way = [(anova.kind.removeprefix("two-way, type "), line) for anova in results.two_way for line in _lines(anova)]
    tables = [
        Table(
            "One-way: the four answer ratios of two materials taken for one another",
            ("task", "materials", *header),
            tuple((task, pair, *_cells(line)) for task, pair, line in one_way),
            left=frozenset({0, 1, 2}),
        )
    ] * bool(one_way)
    tables += [
        Table(
            "Two-way: correct ratios by task and material",
            ("type", *header),
            tuple((kind, *_cells(line)) for kind, line in two_way),
            left=frozenset({0, 1}),
        )
    ] * bool(two_way)
    records = [{"analysis": "one-way", "task": task, "of": pair, **_record(line)} for task, pair, line in one_way]
    records += [{"analysis": f"two-way, type {kind}", "task": "all", **_record(line)} for kind, line in two_way]
    paragraphs = [
        "Every ratio of a participant counts as an independent value. The ratios of one presented material add up to "
        "one, and a participant may stand in both tasks, so F and P are approximate."
    ]
    paragraphs += [f"Not defined: {name}: {reason}." for name, reason in reasons.items()]
    tested = {pair.task for pair in results.pairs}
    paragraphs += [
        f"No one-way ANOVA of {task.task.id}: no material was taken for another."
        for task in results.tasks
        if task.task.id not in tested
    ]
    sized = [(f"{task}, {pair}", line) for task, pair, line in one_way]
    sized += [(f"two-way, type {kind}", line) for kind, line in two_way]
    paragraphs += [
        f"Not defined: {of}, {effect.name}: interval of partial η²; the noncentral F cannot be computed so far out."
        for of, (effect, size) in sized
        if lacks_a_limit(size)
    ]
    if results.two_way_statement:
        paragraphs.append(f"No two-way ANOVA: {results.two_way_statement}.")
    return Section("anova", "Analysis of variance", tuple(paragraphs), tuple(tables), tuple(records))


def exclusions_section(study: Study) -> Section:
    """Everything that was left out, and why."""
    records = tuple(asdict(one) for one in study.exclusions)
    if not records:
        about = "Nothing: every attempt in the dataset is analysed."
        return Section("exclusions", "Left out", (about, *_unasked(study)), records=({},))
    rows = tuple(tuple("-" if cell is None else str(cell) for cell in record.values()) for record in records)
    table = Table("", ("participant", "task", "trial", "attempt", "rule", "reason"), rows, left=frozenset({0, 1, 4, 5}))
    count = len(study.attempts) - int(study.attempts["included"].sum())
    about = f"{count} of {len(study.attempts)} attempts are not analysed."
    by_rule = Counter(e.rule for e in study.exclusions)
    counted = tuple((rule, str(times)) for rule, times in by_rule.items())
    brief = Table("", ("rule", "times"), counted, notes=("Each is listed in the report and in exclusions.csv.",))
    return Section(
        "exclusions", "Left out", (about, *_unasked(study)), (table,), records, (brief,) if len(records) > MANY else ()
    )


def _unasked(study: Study) -> list[str]:
    """A sentence a rule and task on trials that stay in because what the rule judges is not known of them."""
    counts: Counter[tuple[str, str, str]] = Counter()
    totals = study.attempts.loc[study.attempts["counted"], "task"].value_counts()
    for one in study.unasked:
        counts[one.rule, one.missing, one.task] += one.trials
    return [
        f"Rule {rule} could not be asked of {trials} of {totals[task]} trials of {task}, {missing} not being known of "
        "them; they stay in."
        for (rule, missing, task), trials in counts.items()
    ]


def _confusion_table(task: TaskResult) -> Table:
    matrix = task.confusion
    answers = range(len(matrix.materials) + bool(matrix.unanswered))
    rows = []
    for i, presented in enumerate(matrix.materials):
        cells = []
        for j in answers:
            mean, sd = matrix.mean(i, j), matrix.sd(i, j)
            spread = "" if sd is None else f" ± {sd:.3f}"
            cells.append(f"{number(mean)}{spread}{task.test(presented).result.stars if i == j else ''}")
        rows.append((presented, *cells))
    header = ("presented", *matrix.materials, NO_ANSWER)[: len(answers) + 1]
    people = len(matrix.participants)
    notes = [
        f"Columns: answer. *, **, ***: correct answers above chance ({task.chance:.4g}), P below 0.05, 0.01, 0.001, "
        "unadjusted."
    ]
    notes += [
        f"{material}: presented to {matrix.n(i)} of {plural(people, 'participant')}."
        for i, material in enumerate(matrix.materials)
        if matrix.n(i) != people
    ]
    spread = "mean ± SD among" if people > 1 else "of"
    title = f"{task.task.title}: answer ratios, {spread} {plural(people, 'participant')}"
    marked = frozenset((i, i + 1) for i in range(len(matrix.materials)))
    return Table(title, header, tuple(rows), marked=marked, notes=tuple(notes))


Line = tuple[Effect, EffectSize | None]


def _lines(anova: Anova | None) -> tuple[Line, ...]:
    if anova is None:
        return ()
    return (*((effect, anova.eta_squared(effect)) for effect in anova.effects), (anova.residual, None))


def _cells(line: Line) -> tuple[str, ...]:
    effect, size = line
    tested = ("", "", "", "")
    if size is not None:
        tested = number(effect.f, 2), probability(effect.p), number(size.value), interval(size)
    return effect.name, number(effect.ss, 4), str(effect.df), number(effect.ms, 4), *tested


def _record(line: Line) -> dict[str, object]:
    effect, size = line
    sizes = (size.value, size.low, size.high) if size else (None, None, None)
    return {
        "source": effect.name, "ss": effect.ss, "df": effect.df, "ms": effect.ms, "f": effect.f, "p": effect.p,
        **dict(zip(("partial_eta_squared", "eta_low", "eta_high"), sizes, strict=True)),
    }  # fmt: skip
