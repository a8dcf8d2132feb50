"""Results -> sections: the tables of the report, the records behind them, and every formula by its name."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

from palpate.analysis.documents.page import ON_METHODS
from palpate.analysis.documents.tables import (
    Column,
    Record,
    Section,
    Table,
    bayes_factor,
    crossed,
    ends,
    formulas,
    joined,
    lacks_a_limit,
    number,
    plural,
    probability,
    tabulate,
)
from palpate.analysis.identification.identify import CHOICE_RESAMPLES
from palpate.analysis.identification.maps import MOST, ORDERS
from palpate.analysis.identification.results import (
    SEED,
    ComponentReliability,
    Reliability,
    Results,
    TaskResult,
    bracketed,
)
from palpate.analysis.identification.time_course import BIN_WIDTHS_MM_S, MOST_BINS, WINDOW
from palpate.analysis.published.numbers import Published
from palpate.analysis.reading.study import Study
from palpate.analysis.report import companion_tables
from palpate.analysis.report import plan as plans
from palpate.analysis.report.answers import answers_section, planned_sections
from palpate.analysis.report.found import found_section
from palpate.analysis.report.identification_sections import (
    confusions_section,
    course_section,
    intervals_section,
    trials_section,
)
from palpate.analysis.report.played_section import left_out, played_sections
from palpate.analysis.statistics.anova import Anova
from palpate.analysis.statistics.icc import NAMES
from palpate.analysis.statistics.sign_flips import DRAWS
from palpate.experiment.records.events import NO_ANSWER

FEW = 10
"""The most participants left out of a matrix that a terminal names; it counts the others."""


P = Column("p", "P", show=probability)
FORMS = (
    Column("form", "Shrout-Fleiss", left=True), Column("also", "McGraw-Wong", left=True), Column("icc", "ICC"),
    Column(("low", "high"), "95 % CI"), Column("f", "F", 2), Column("df1"), Column("df2"), P,
)  # fmt: skip

IN_SHORT = Column("matrix", left=True), *map(Column, NAMES)
COMPONENTS = Column("k"), Column("icc", "ICC"), Column(("low", "high"), "95 % CI"), Column("model", "k is", left=True)


def icc_section(results: Results) -> Section:
    """Return every ICC form for every matrix, and the variance-component form."""
    tables = []
    for one in results.reliabilities:
        records: list[Record] = [
            {"matrix": one.matrix, "form": form.shrout_fleiss, "also": form.mcgraw_wong, "model": form.model,
             "icc": form.value, "f": form.f, "df1": form.df1, "df2": form.df2, "p": form.p, "low": form.low,
             "high": form.high, "statement": form.statement}
            for form in (one.icc.forms if one.icc else ())
        ]  # fmt: skip
        tables.append(tabulate(one.matrix, FORMS, records, _icc_notes(one)))
    shown: list[Record] = [
        dict.fromkeys(NAMES) | {form.shrout_fleiss: form.value for form in forms} | {"matrix": r.matrix}
        for r in results.reliabilities
        for forms in [r.icc.forms if r.icc else ()]
    ]
    told = dict.fromkeys(note for r in results.reliabilities for note in _icc_notes(r, FEW))
    more = "The report and icc.csv contain F, P and the intervals."
    brief = [tabulate("", IN_SHORT, shown, (*told, more))]
    if results.components:
        tables.append(_components_table(results.components))
        brief.append(tables[-1])
    about = plans.ABOUT["icc"].substitute()
    why = results.two_way_statement
    missing = (f"There is no variance-component ICC: {why}.",) * bool(why)
    return Section("icc", "Intraclass correlations", (about, *missing), tuple(tables), brief=tuple(brief))


def _icc_notes(reliability: Reliability, most: int | None = None) -> tuple[str, ...]:
    of = reliability.task or "all tasks together"
    which = "ICC(2,.) and ICC(3,.) are" if reliability.icc else "The ICC is"
    notes = [f"{which} not defined: {reliability.statement}."] * bool(reliability.statement)
    forms: dict[str, list[str]] = {}
    for form in reliability.icc.forms if reliability.icc else ():
        if form.statement and (most is None or form.value is None):
            forms.setdefault(form.statement, []).append(form.shrout_fleiss)
    notes += [f"{', '.join(names)}{'' if most is None else f' of {of}'}: {why}." for why, names in forms.items()]
    if who := reliability.dropped:
        lack = "task or material" if reliability.task is None else "material"
        more = len(who[most:]) if most else 0
        named = ", ".join(who[:most]) + (f" and {more} more, listed in the report" if more else "")
        notes.append(f"The matrix of {of} leaves out participants with no trials of a {lack}: {named}.")
    return tuple(notes)


def _components_table(reliability: ComponentReliability) -> Table:
    c = reliability.components
    parts = zip((*c.names, "residual"), (c.first, c.second, c.interaction, c.residual), strict=True)
    estimates = ", ".join(f"{name} {value:.5f}" for name, value in parts)
    notes = [
        f"Variance components (Henderson's method III): {estimates}. ICC = S / (S + residual / k), where S "
        "is the sum of the other components."
    ]
    if c.negative:
        notes.append(f"These components have negative estimates and count as zero: {', '.join(c.negative)}.")
    if any(value is None for _, _, value in reliability.by_k):
        notes.append("The ICC is not defined, because no component is above zero.")
    records: list[Record] = [
        {
            "matrix": "two-way ANOVA",
            "form": f"variance-component, k = {k}",
            "model": meaning,
            "icc": value,
            "k": k,
            **ends(limits),
        }
        for (k, meaning, value), limits in zip(reliability.by_k, reliability.intervals, strict=True)
    ]
    title = "Two-way ANOVA, task x material: variance-component ICC of the mean of k participants"
    return tabulate(title, COMPONENTS, records, notes, key="components", in_print={"k"})


def sections(
    study: Study, results: Results, printed: Published | None, beside_print: Section | None
) -> tuple[Section, ...]:
    """Return every section, in reading order: what was found, what was planned, results by their standing, checks.

    `beside_print` is what an audit made of the printed numbers.
    """
    alone, common = _presented(results)
    stands = plans.standing(study, printed)
    tasks = [task.task.id for task in results.tasks]
    against = [stands.of_any(plans.CHANCE, task) for task in tasks]
    compared = (beside_print,) if beside_print else ()
    new = study.origin != "RECONSTRUCTION"
    checks = (*played_sections(study), *(replace(section, folded=new) for section in compared))
    parts = {
        stands.results: (
            *planned_sections(results),
            plans.marked(confusion_section(results), *against),
            plans.marked(tests_section(results), *against),
            anova_section(results, common, stands),
        ),
        plans.BESIDE: (
            companion_tables.beside_section(results.beside, stands, common),
            plans.marked(companion_tables.contrasts_section(results), stands.ours(plans.TWO_WAY, *tasks)),
            plans.marked(companion_tables.equivalence_section(results), f"{plans.OURS}, {plans.EXPLORATORY}"),
        ),
        "Exploratory": (
            plans.marked(confusions_section(results, study.materials), plans.EXPLORATORY),
            plans.marked(trials_section(results), plans.EXPLORATORY),
        ),
        plans.EXCLUDED: (plans.exclusions_section(study),),
        ON_METHODS: (
            plans.marked(icc_section(results), *plans.icc_marks(study, stands, results)),
            plans.marked(intervals_section(results), *(stands.ours(plans.T, task) for task in tasks)),
            plans.marked(companion_tables.lapses_section(results, study.materials), plans.EXPLORATORY),
            plans.marked(course_section(results.course), plans.EXPLORATORY),
            *(plans.marked(section, plans.DESCRIPTIVE) for section in checks),
        ),
    }
    return (
        answers_section(study, results, stands, (*common, *left_out(study))),
        found_section(study, results, alone, stands),
        overview_section(study, results),
        *(replace(section, part=part) for part, of in parts.items() for section in of),
    )


def _presented(results: Results) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return sentences on tasks that do not present every material, and on the materials over which tasks compare."""
    part = [task for task in results.tasks if task.confusion.absent]
    told = "Task {} presents only {}; answers could be any of the materials."
    alone = tuple(told.format(task.task.id, ", ".join(task.task.presented)) for task in part)
    if not part or len(results.tasks) < 2:
        return alone, ()
    every = part[0].confusion.materials
    names = [name for name in every if all(name in task.task.presented for task in results.tasks)]
    told = f"all of them present {joined(names)}" if names else "no material is in all of them"
    return alone, (f"Tasks are compared on the materials that they have in common; {told}.",)


def overview_section(study: Study, results: Results) -> Section:
    """Return what was analysed, participants, trials and tests, beside what was planned."""
    rows = tuple(
        {"task": task.task.id, "title": task.task.title, "participants": len(task.confusion.participants),
         "trials": int(task.confusion.counts.sum()), "without_answer": task.confusion.unanswered, "chance": task.chance}
        for task in results.tasks
    )  # fmt: skip
    return plans.overview(study, rows, partial(plans.done_of, results), (plans.ICC,))


def confusion_section(results: Results) -> Section:
    """Return the confusion matrices in the layout of Okamoto's Tables 1 and 2."""
    return Section("confusion", "Answer ratios", (), tuple(map(_confusion_table, results.tasks)))


TESTS = (
    Column("material", "presented", left=True), Column("n", brief=False), Column("mean"),
    Column("sd", "SD", brief=False), Column("t", decimals=2), Column("df"), P,
    Column("p_holm", "P (Holm)", show=probability), Column("stars", "", left=True), Column("cohens_d", "d", 2),
    Column(("d_low", "d_high"), "95 % CI of d", 2, brief=False),
    Column("log_bf10", "BF10", show=bayes_factor, brief=False),
    Column("p_sign_flip_ours", "sign flips: P", show=probability),
    Column("p_sign_flip_holm", "sign flips: Holm", show=probability, brief=False),
)  # fmt: skip


def tests_section(results: Results) -> Section:
    """Return the tests of correct answers against chance."""
    tables, brief = [], []
    for task in results.tasks:
        tests: list[Record] = [
            {"task": task.task.id, "material": test.material, "n": r.n, "mean": r.mean, "sd": r.sd, "chance": r.chance,
             "t": r.t, "df": r.df, "p": r.p, "p_holm": test.p_holm, "cohens_d": r.d, **ends(test.d, "d_"),
             "log_bf10": test.log_bf10, "p_sign_flip_ours": test.flip and test.flip.p,
             "p_sign_flip_holm": test.flip_holm, "least_p_sign_flip": test.flip and test.flip.least,
             "stars": task.stars(test), "statement": r.statement}
            for test in task.tests for r in (test.result,)
        ]  # fmt: skip
        absent: list[Record] = [
            {"task": task.task.id, "material": material, "n": 0, "statement": f"{material} {ABSENT}"}
            for material in task.confusion.absent
        ]
        notes = [f"{test.material}: {test.result.statement}." for test in task.tests if test.result.statement]
        notes += [f"{material} {ABSENT}." for material in task.confusion.absent]
        notes += companion_tables.sampled((test.material, test.flip) for test in task.tests)
        gaps = sum(test.p_holm is None for test in task.tests)
        notes += [f"Holm's correction counts {plural(gaps, 'planned test')} without a P as if P were 1."] * bool(gaps)
        notes += [
            f"{test.material}: d has no interval, because the noncentral t cannot be computed that far into its tail."
            for test in task.tests
            if lacks_a_limit(test.d)
        ]
        title = f"{task.task.title}: correct answers against chance, {task.chance:.4g}"
        key = task.task.id
        tables.append(replace(tabulate(title, TESTS, tests, notes, key=key), records=(*tests, *absent)))
        said = f"The exact test uses sign flips.{bracketed([task])}"
        brief.append(tabulate(title, TESTS, tests, (*notes, said), brief=True, key=key))
    about = plans.ABOUT["tests"].substitute()
    families = tuple(_families(results))
    return Section("tests", "Tests against chance", families, tuple(tables), brief=tuple(brief), aside=(about,))


def _families(results: Results) -> list[str]:
    """Return which P the stars follow in each task, and what Holm's family is."""
    found: dict[str | None, list[str]] = {}
    for task in results.tasks:
        found.setdefault(task.correction, []).append(task.task.id)
    if set(found) == {None}:
        return [
            "The stars follow the unadjusted P, because no protocol names a correction. Holm's correction "
            "covers the materials of one task."
        ]
    return [
        f"In {' and '.join(tasks)}, the stars follow "
        + ("the unadjusted P; Holm's correction covers the materials of one task." if family is None else
           f"the Holm-adjusted P, as the protocol plans; the family is the {family}.")
        for family, tasks in found.items()
    ]  # fmt: skip


EFFECTS = (
    Column("source", left=True), Column("ss", "SS", 4), Column("df"), Column("ms", "MS", 4), Column("f", "F", 2),
    P, Column("partial_eta_squared", "partial η²"), Column(("eta_low", "eta_high"), "90 % CI"),
)  # fmt: skip
TYPE = Column("analysis", "type", show=lambda kind: kind.removeprefix("two-way, type "), left=True)


def anova_section(results: Results, remark: tuple[str, ...], stands: plans.Standing) -> Section:
    """Return the ANOVAs: one-way of confused materials, two-way of correct ratios in types I to III."""
    tables = []
    for pair in results.pairs:
        if pair.anova is not None:
            of = f"{' and '.join(pair.pair)} ({pair.chosen})"
            mark = stands.of_pair(pair)
            lines = _effects(pair.anova, analysis="one-way", task=pair.task, of=of, standing=mark)
            title = f"One-way, {pair.task}: the four answer ratios of {of}"
            tables.append(tabulate(title, EFFECTS, lines, standing=mark))
    mark = stands.mark(plans.TWO_WAY, *(task.task.id for task in results.tasks))
    of_tasks = {"task": "all", "standing": mark}
    if two_way := [line for each in results.two_way for line in _effects(each, analysis=each.kind, **of_tasks)]:
        title = "Two-way: correct ratios by task and material"
        tables.append(tabulate(title, (TYPE, *EFFECTS), two_way, standing=mark))
    lines_of = [line for table in tables for line in table.records]
    undefined = tuple(plans.undefined(results))
    about = (*remark, *_about_anova(undefined, lines_of))
    lacking = tuple({"analysis": kind, "task": task, "statement": reason} for kind, task, reason in undefined)
    return Section("anova", "Analysis of variance", about, tuple(tables), lacking)


def _effects(anova: Anova, **of: str) -> Iterator[Record]:
    """Yield a record of each effect, and of the residual, which has no F."""
    for effect in (*anova.effects, anova.residual):
        line = {**of, "source": effect.name, "ss": effect.ss, "df": effect.df, "ms": effect.ms}
        if effect is not anova.residual:
            size = anova.eta_squared(effect)
            line |= {"f": effect.f, "p": effect.p, "partial_eta_squared": size and size.value, **ends(size, "eta_")}
        yield line


def _about_anova(undefined: Sequence[tuple[str, str, str]], lines: list[Record]) -> Iterator[str]:
    """Yield what the analyses assume, and why one of them, or an interval, is missing."""
    yield plans.ABOUT["anova"].substitute()
    for kind, task, reason in undefined:
        name = f"one-way ANOVA of {task}" if kind == "one-way" else kind.replace(",", " ANOVA of")
        if reason == plans.NEVER:
            yield f"There is no {name}: {reason}."
        elif kind != plans.NONE_OF_TWO_WAY:
            yield f"The {name} is not defined: {reason}."
    for line in lines:
        if line.get("partial_eta_squared") is not None and None in (line["eta_low"], line["eta_high"]):
            of = f"{line['task']}, {line['of']}" if "of" in line else line["analysis"]
            yield (
                f"The interval of partial η² is not defined for {of}, {line['source']}: the noncentral F cannot be "
                "computed that far into its tail."
            )
    yield from (
        f"There is no two-way ANOVA: {reason}." for kind, _, reason in undefined if kind == plans.NONE_OF_TWO_WAY
    )


def _ratio(cell: Record) -> str:
    """Return a mean ± SD, with its stars."""
    spread = "" if cell["sd"] is None else f" ± {cell['sd']:.3f}"
    return f"{number(cell['mean'])}{spread}{cell['stars']}"


def _confusion_table(task: TaskResult) -> Table:
    matrix = task.confusion
    answers = (*matrix.materials, NO_ANSWER)
    records: list[Record] = [
        {"task": task.task.id, "presented": presented, "answered": answered, "participants": matrix.n(i),
         "trials": int(matrix.trials[:, i].sum()), "count": int(matrix.counts[:, i, j].sum()),
         "mean": matrix.mean(i, j), "sd": matrix.sd(i, j), "stars": task.stars(task.test(presented)) if i == j else ""}
        for i, presented in enumerate(matrix.materials) if i in matrix.presented
        for j, answered in enumerate(answers)
    ]  # fmt: skip
    named = answers if matrix.unanswered else matrix.materials
    columns = Column("", "presented", left=True), *(Column(name, show=_ratio) for name in named)
    people = len(matrix.participants)
    notes = [
        f"Each column is an answer. *, ** and *** mark correct answers above chance ({task.chance:.4g}) with "
        f"{'an unadjusted P' if task.correction is None else 'a Holm-adjusted P'} below 0.05, 0.01 and 0.001."
        + bracketed([task])
    ]
    notes += _never(task)
    spread = "mean ± SD across" if people > 1 else "of"
    title = f"{task.task.title}: answer ratios, {spread} {plural(people, 'participant')}"
    places = frozenset((row, i + 1) for row, i in enumerate(matrix.presented))
    table = tabulate(title, columns, crossed(records, "presented", "answered"), notes, marked=places)
    return replace(table, matrix=True, records=tuple(records))


ABSENT = "is not presented in this task"


def _never(task: TaskResult) -> Iterator[str]:
    """Yield to whom a material was not presented, who answered in no trial with it, and who never gave it as answer."""
    matrix = task.confusion
    for i, material in enumerate(matrix.materials):
        shown = matrix.trials[:, i] > 0
        silent = shown & (matrix.counts[:, i, -1] == matrix.trials[:, i])
        unnamed = shown & ~silent & (matrix.counts[:, :, i].sum(axis=1) == 0)
        to = f"{material} was presented to {shown.sum()} of {plural(len(shown), 'participant')}"
        if not shown.any():
            yield f"{material} {ABSENT}." if material in matrix.absent else f"{to}."
            continue
        for which, said in (
            (~shown, f"{to}, and not to"),
            (silent, f"No answer to {material} was given by"),
            (unnamed, f"The answer {material} was never given by"),
        ):
            if who := [f"sub-{label}" for label, one in zip(matrix.participants, which, strict=True) if one]:
                more = f" and {len(who) - FEW} more" if len(who) > FEW else ""
                yield f"{said} {', '.join(who[:FEW])}{more}."


def methods() -> tuple[tuple[str, str], ...]:
    """Return the name and formula of everything that these sections hold."""
    course = {"window": WINDOW, "widths": ", ".join(map(str, BIN_WIDTHS_MM_S)), "most_bins": MOST_BINS}
    drawn = {"seed": SEED, "choice_resamples": CHOICE_RESAMPLES, "orders": ORDERS,
             "draws": f"{DRAWS:,}"}  # fmt: skip
    return formulas(Path(__file__).with_name("methods.md"), **course, **drawn, most_materials=MOST)
